//! Scatter plot of an estimate against the truth.

use super::figure::{Anchor, Colour, Figure, Frame, TITLE};
use super::panel::{ColourBar, ColourScale, PanelAxis, draw_axes, draw_map};
use crate::error::{Error, Result};
use crate::grid::Volume;
use crate::metrics::{check_truth, score};
use glam::DVec2;
use ndarray::Array2;

/// Number of cells of the plot along each axis.
const CELLS: usize = 75;
const WHITE: Colour = [255, 255, 255];
const RED: Colour = [220, 20, 30];

/// Draw the estimated against the true extinction as in Sde-Chen et al. (2021,
/// figure 6). Colours show the number of voxels in each cell on a logarithmic scale; a red line
/// marks a perfect reconstruction.
///
/// # Errors
/// Returns an error if the volumes are on different grids, if values are negative or not finite, or
/// if the truth is empty.
pub fn scatter_figure(truth: &Volume, estimate: &Volume, title: &str) -> Result<Figure> {
    check_pair(truth, estimate)?;
    check_truth(truth)?;
    let frame = Frame { left: 90, top: 110, width: 600, height: 600 };
    let mut figure = Figure::new(title, [840, 790])?;
    figure.text(title, TITLE, Anchor::On, frame.middle(), 40);
    draw_scatter(&mut figure, frame, truth, estimate);
    Ok(figure)
}

/// Draw the plot into `frame` with the colour bar to its right.
pub(super) fn draw_scatter(figure: &mut Figure, frame: Frame, truth: &Volume, estimate: &Volume) {
    let both = truth.values.iter().chain(&estimate.values);
    let greatest = f64::from(both.copied().fold(0.0, f32::max)).max(f64::MIN_POSITIVE);
    let counts = count_voxels(truth, estimate, greatest);
    let most = counts.iter().copied().max().unwrap_or(1).max(10);
    let scale = ColourScale::new(colorous::VIRIDIS, f64::from(most).log10());
    draw_map(figure, frame, counts.dim(), |at| match counts[at] {
        0 => WHITE,
        count => scale.colour(f64::from(count).log10()),
    });
    let corner = |x: i32, y: i32| DVec2::new(f64::from(x), f64::from(y));
    let (from, to) = (corner(frame.left, frame.bottom()), corner(frame.right(), frame.top));
    figure.line(from, to, 2.0, RED);
    let axis = |label| PanelAxis { label, range: 0.0..greatest };
    let right = axis("true extinction (km\u{207b}\u{b9})");
    let up = axis("estimated extinction (km\u{207b}\u{b9})");
    draw_axes(figure, frame, &caption(truth, estimate), &right, &up);
    let bar = Frame { left: frame.right() + 24, width: 18, ..frame };
    let numbers = (0..=most.ilog10())
        .map(|power| (f64::from(power), 10_u64.pow(power).to_string()))
        .collect();
    ColourBar { scale, label: "voxels", numbers }.draw(figure, bar);
}

/// The scores; empty if the truth is empty.
fn caption(truth: &Volume, estimate: &Volume) -> String {
    score(truth, estimate).map_or(String::new(), |scores| {
        format!("\u{3b5} = {:.3}, \u{3b4} = {:.3}", scores.relative_error, scores.mass_error)
    })
}

/// The number of voxels by estimate (row) and truth (column), both from zero to `greatest`.
fn count_voxels(truth: &Volume, estimate: &Volume, greatest: f64) -> Array2<u32> {
    let mut counts = Array2::zeros((CELLS, CELLS));
    let cell = |value: f32| ((f64::from(value) / greatest * CELLS as f64) as usize).min(CELLS - 1);
    for (&truth, &estimate) in truth.values.iter().zip(&estimate.values) {
        counts[[cell(estimate), cell(truth)]] += 1;
    }
    counts
}

/// Check that two volumes can be compared.
///
/// # Errors
/// Returns an error if the volumes are on different grids or if values are negative or not finite.
pub(super) fn check_pair(truth: &Volume, estimate: &Volume) -> Result<()> {
    truth.check_non_negative("true extinction")?;
    estimate.check_non_negative("extinction")?;
    if truth.grid.matches(&estimate.grid) {
        return Ok(());
    }
    Err(Error::mismatch(
        "grids of truth and estimate",
        format!("{:?}", truth.grid),
        format!("{:?}", estimate.grid),
        "resample both to the same grid",
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;
    use crate::math::DVec3;
    use ndarray::Array3;

    #[test]
    fn every_voxel_is_in_one_cell() {
        let grid = Grid::new(DVec3::ZERO, DVec3::ONE, [3, 4, 5]).unwrap();
        let truth = Array3::from_shape_fn(grid.shape, |(k, j, i)| (k + j + i) as f32);
        let truth = Volume::new(grid, truth).unwrap();
        let counts = count_voxels(&truth, &Volume::constant(grid, 9.0), 9.0);
        assert_eq!(counts.sum(), 60);
        assert_eq!(counts.row(CELLS - 1).sum(), 60);
        assert_eq!((counts[[CELLS - 1, 0]], counts[[CELLS - 1, CELLS - 1]]), (1, 1));
    }
}
