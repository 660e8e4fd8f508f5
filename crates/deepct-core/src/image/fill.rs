//! Interpolation of missing pixels from known ones.

use ndarray::{Array2, ArrayView2, ArrayViewMut2, s};

/// Number of passes over the missing pixels at each resolution. What the coarser one leaves are errors of
/// the scale of a few pixels, which few passes remove.
const PASSES: usize = 32;

/// Distance (pixels) from the known pixels from which on missing ones are in a gap.
const GAP: usize = 3;

/// Replace missing pixels, which are NaN, by a discrete harmonic function of the known ones: each becomes
/// the mean of its neighbours. It is found at half the resolution first, where a pixel is the mean of the
/// known ones in it (cascadic multigrid). Images without known pixels become 0.
pub(super) fn fill(mut image: ArrayViewMut2<'_, f32>) {
    let missing: Vec<[usize; 2]> = image
        .indexed_iter()
        .filter(|(_, value)| value.is_nan())
        .map(|((row, col), _)| [row, col])
        .collect();
    if missing.len() == image.len() {
        image.fill(0.0);
        return;
    }
    if missing.is_empty() {
        return;
    }
    let mut coarse = halved(image.view());
    fill(coarse.view_mut());
    for &[row, col] in &missing {
        image[[row, col]] = coarse[[row / 2, col / 2]];
    }
    let (rows, cols) = image.dim();
    for _ in 0..PASSES {
        for &[row, col] in &missing {
            let neighbours = [
                (row > 0).then(|| image[[row - 1, col]]),
                (row + 1 < rows).then(|| image[[row + 1, col]]),
                (col > 0).then(|| image[[row, col - 1]]),
                (col + 1 < cols).then(|| image[[row, col + 1]]),
            ];
            let known = neighbours.into_iter().flatten();
            image[[row, col]] = known.clone().sum::<f32>() / known.count() as f32;
        }
    }
}

/// The mean of the known pixels in each square of 2 x 2; NaN if there are none.
fn halved(image: ArrayView2<'_, f32>) -> Array2<f32> {
    let (rows, cols) = image.dim();
    Array2::from_shape_fn((rows.div_ceil(2), cols.div_ceil(2)), |(row, col)| {
        let (row, col) = (2 * row, 2 * col);
        let square = image.slice(s![row..(row + 2).min(rows), col..(col + 2).min(cols)]);
        let known = square.iter().filter(|value| !value.is_nan());
        known.clone().sum::<f32>() / known.count() as f32
    })
}

/// The share of the pixels that are missing and far from known ones, within the rows and columns that
/// have known pixels.
pub(super) fn share_in_gaps(image: ArrayView2<'_, f32>) -> f64 {
    let (rows, cols) = image.dim();
    let has_known = |line: ArrayView2<'_, f32>| line.iter().any(|value| !value.is_nan());
    let filled_rows: Vec<bool> =
        (0..rows).map(|row| has_known(image.slice(s![row..=row, ..]))).collect();
    let filled_cols: Vec<bool> =
        (0..cols).map(|col| has_known(image.slice(s![.., col..=col]))).collect();
    let ends = |filled: &[bool]| {
        let first = filled.iter().position(|any| *any);
        first.zip(filled.iter().rposition(|any| *any))
    };
    let Some(((top, bottom), (left, right))) = ends(&filled_rows).zip(ends(&filled_cols)) else {
        return 0.0;
    };
    let is_inside =
        |row: usize, col: usize| (top..=bottom).contains(&row) && (left..=right).contains(&col);
    let mut near = image.mapv(|value| !value.is_nan());
    for _ in 1..GAP {
        near = Array2::from_shape_fn((rows, cols), |(row, col)| {
            let around = s![
                row.saturating_sub(1)..(row + 2).min(rows),
                col.saturating_sub(1)..(col + 2).min(cols)
            ];
            near.slice(around).iter().any(|near| *near)
        });
    }
    let gaps = near.indexed_iter().filter(|((row, col), near)| !**near && is_inside(*row, *col));
    gaps.count() as f64 / image.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A linear function is harmonic, and a small hole in it is filled exactly; beyond the edge of what is
    /// known, the values continue.
    #[test]
    fn holes_are_filled_by_a_harmonic_function() {
        let plane = |row: usize, col: usize| 1.0 + 0.3 * row as f32 - 0.2 * col as f32;
        let whole = Array2::from_shape_fn((40, 37), |(row, col)| plane(row, col));
        for (hole, tolerance) in
            [([7..8, 9..10], 1e-5), ([5..9, 30..33], 1e-3), ([10..26, 8..24], 0.3)]
        {
            let mut image = whole.clone();
            image.slice_mut(s![hole[0].clone(), hole[1].clone()]).fill(f32::NAN);
            fill(image.view_mut());
            let most = (&image - &whole).iter().fold(0.0_f32, |most, error| most.max(error.abs()));
            assert!(most < tolerance, "{hole:?} {most}");
        }
        let mut image = whole.clone();
        image.slice_mut(s![.., 20..]).fill(f32::NAN);
        fill(image.view_mut());
        // Nothing flows through the edges of the image, so that all of its columns have the same mean.
        let mean = |image: &Array2<f32>, col: usize| image.column(col).mean().unwrap();
        for col in [20, 28, 36] {
            let (found, expected) = (mean(&image, col), mean(&whole, 19));
            assert!((found - expected).abs() < 0.3, "{col} {found} {expected}");
        }
        let mut none = Array2::from_elem((3, 4), f32::NAN);
        fill(none.view_mut());
        assert_eq!(none, Array2::<f32>::zeros((3, 4)));
    }

    #[test]
    fn gaps_are_far_from_known_pixels() {
        let mut image = Array2::<f32>::zeros((20, 30));
        image.slice_mut(s![3..8, 4..9]).fill(f32::NAN);
        assert_eq!(share_in_gaps(image.view()), 1.0 / 600.0);
        // A corner of 6 x 6: the 4 x 4 pixels at its end are far from the others.
        image.slice_mut(s![14.., 24..]).fill(f32::NAN);
        assert_eq!(share_in_gaps(image.view()), 17.0 / 600.0);
        image.fill(0.0);
        image.slice_mut(s![10.., ..]).fill(f32::NAN);
        assert_eq!(share_in_gaps(image.view()), 0.0);
        image.fill(f32::NAN);
        assert_eq!(share_in_gaps(image.view()), 0.0);
    }
}
