//! Matrix products whose sums stay in registers.
//!
//! A block of `ROWS` rows (pixels or tiles) by `VECTORS` vectors of output channels is summed
//! together. For each index along the depth, one vector of weights is loaded per vector of
//! channels, and one value of the left matrix is broadcast to all lanes per row.

use super::vector::{Element, Vector};

/// A batch of matrix products `out[point] = left[point] right[point]`, one for each point of
/// Winograd's filtering; `E` is an [`Element`].
#[derive(Debug)]
pub(crate) struct PointProducts<'a, E> {
    /// Number of products.
    pub(crate) points: usize,
    /// Number of rows of the left matrix and of the result: tiles.
    pub(crate) rows: usize,
    /// Number of columns of the left matrix: elements that contain the input channels.
    pub(crate) depth: usize,
    /// Number of vectors of output channels.
    pub(crate) vectors: usize,
    /// `[point, row, column]`.
    pub(crate) left: &'a [E],
    /// Distance between points and between rows of `left`.
    pub(crate) left_pitch: [usize; 2],
    /// `[point, column of the left matrix, output channel]`, contiguous, in whole vectors.
    pub(crate) right: &'a [E],
    /// Distance between points and between rows of the result.
    pub(crate) out_pitch: [usize; 2],
}

/// A row of pixels computed as a sum of several products with bias and ReLU:
/// `out = relu(bias + sum over segments of left[segment] right[segment])`.
#[derive(Debug)]
pub(crate) struct SegmentSum<'a> {
    /// The left matrices, each from its first row on.
    pub(crate) segments: &'a [&'a [f32]],
    /// Distance between the rows of a left matrix.
    pub(crate) left_pitch: usize,
    /// Number of rows of the result: pixels.
    pub(crate) rows: usize,
    /// Number of columns of a left matrix.
    pub(crate) depth: usize,
    /// Number of vectors of output channels.
    pub(crate) vectors: usize,
    /// `[segment, column of the left matrix, output channel]`, contiguous, in whole vectors.
    pub(crate) right: &'a [f32],
    /// One value for each output channel, in whole vectors.
    pub(crate) bias: &'a [f32],
    /// Whether negative sums are set to 0.
    pub(crate) relu: bool,
    /// Distance between the rows of the result.
    pub(crate) out_pitch: usize,
}

/// The sums of a block.
type Sums<V, const ROWS: usize, const VECTORS: usize> = [[V; VECTORS]; ROWS];

/// Add `left right` to the sums.
///
/// # Safety
/// As for [`Vector`]. In addition, `left` must be readable at `row * pitch + column` for all
/// rows and `depth` columns, and `right` must contain `depth * VECTORS` vectors.
#[allow(unsafe_code)]
#[inline(always)]
unsafe fn accumulate<V: Vector, E: Element<V>, const ROWS: usize, const VECTORS: usize>(
    sums: &mut Sums<V, ROWS, VECTORS>,
    left: *const E,
    pitch: usize,
    right: *const E,
    depth: usize,
) {
    for column in 0..depth {
        // SAFETY: `column` is below `depth`; the caller upholds the rest.
        unsafe {
            let right = right.add(column * VECTORS * V::LANES);
            let weights: [E::Vector; VECTORS] =
                std::array::from_fn(|vector| E::load(right.add(vector * V::LANES)));
            for (row, sums) in sums.iter_mut().enumerate() {
                let value = (*left.add(row * pitch + column)).splat();
                for (sum, weight) in sums.iter_mut().zip(weights) {
                    *sum = E::multiply_add(weight, value, *sum);
                }
            }
        }
    }
}

/// Compute one block of rows of every product, from row `first` on.
///
/// # Safety
/// As for [`Vector`]. In addition, the slices must satisfy [`check_points`].
#[allow(unsafe_code)]
#[inline(always)]
pub(super) unsafe fn point_block<V, E, const ROWS: usize, const VECTORS: usize>(
    products: &PointProducts<'_, E>,
    first: usize,
    out: &mut [f32],
) where
    V: Vector,
    E: Element<V>,
{
    let PointProducts { points, depth, left, right, .. } = *products;
    let ([left_point, left_row], [out_point, out_row]) = (products.left_pitch, products.out_pitch);
    for point in 0..points {
        // SAFETY: the caller has checked the slices for all points and rows.
        unsafe {
            let mut sums: Sums<V, ROWS, VECTORS> = [[V::splat(0.0); VECTORS]; ROWS];
            let left = left.as_ptr().add(point * left_point + first * left_row);
            let right = right.as_ptr().add(point * depth * VECTORS * V::LANES);
            accumulate(&mut sums, left, left_row, right, depth);
            let out = out.as_mut_ptr().add(point * out_point + first * out_row);
            for (row, sums) in sums.into_iter().enumerate() {
                for (vector, sum) in sums.into_iter().enumerate() {
                    sum.store(out.add(row * out_row + vector * V::LANES));
                }
            }
        }
    }
}

/// Compute one block of rows of a sum over segments, from row `first` on.
///
/// # Safety
/// As for [`Vector`]. In addition, the slices must satisfy [`check_segments`].
#[allow(unsafe_code)]
#[inline(always)]
pub(super) unsafe fn segment_block<V: Vector, const ROWS: usize, const VECTORS: usize>(
    product: &SegmentSum<'_>,
    first: usize,
    out: &mut [f32],
) {
    let SegmentSum { left_pitch, depth, right, bias, out_pitch, .. } = *product;
    // SAFETY: the caller has checked the slices for all segments and rows.
    unsafe {
        let bias: [V; VECTORS] = std::array::from_fn(|v| V::load(bias.as_ptr().add(v * V::LANES)));
        let mut sums: Sums<V, ROWS, VECTORS> = [bias; ROWS];
        for (segment, left) in product.segments.iter().enumerate() {
            let left = left.as_ptr().add(first * left_pitch);
            let right = right.as_ptr().add(segment * depth * VECTORS * V::LANES);
            accumulate(&mut sums, left, left_pitch, right, depth);
        }
        let out = out.as_mut_ptr().add(first * out_pitch);
        let zero = V::splat(0.0);
        for (row, sums) in sums.into_iter().enumerate() {
            for (vector, sum) in sums.into_iter().enumerate() {
                let sum = if product.relu { sum.max(zero) } else { sum };
                sum.store(out.add(row * out_pitch + vector * V::LANES));
            }
        }
    }
}

/// Assert that the slices of a batch of products have the stated lengths.
pub(super) fn check_points<E>(products: &PointProducts<'_, E>, lanes: usize, out: &[f32]) {
    let PointProducts { points, rows, depth, vectors, left_pitch, out_pitch, .. } = *products;
    assert!(points > 0 && rows > 0);
    let last = |pitch: [usize; 2]| (points - 1) * pitch[0] + (rows - 1) * pitch[1];
    assert!(products.left.len() >= last(left_pitch) + depth);
    assert!(products.right.len() >= points * depth * vectors * lanes);
    assert!(out.len() >= last(out_pitch) + vectors * lanes);
}

/// Assert that the slices of a sum have the stated lengths.
pub(super) fn check_segments(product: &SegmentSum<'_>, lanes: usize, out: &[f32]) {
    let SegmentSum { rows, depth, vectors, left_pitch, out_pitch, segments, .. } = *product;
    assert!(rows > 0);
    let needed = (rows - 1) * left_pitch + depth;
    assert!(segments.iter().all(|left| left.len() >= needed));
    assert!(product.right.len() >= segments.len() * depth * vectors * lanes);
    assert!(product.bias.len() >= vectors * lanes);
    assert!(out.len() >= (rows - 1) * out_pitch + vectors * lanes);
}
