//! The transforms of Winograd's minimal filtering, applied to a vector of channels at a time.
//!
//! A tile of `OUT x OUT` pixels depends on `IN x IN` input pixels, IN = OUT + 2. The input
//! values `d` of the tile are transformed to `B^T d B`, multiplied point by point with the
//! weights `G g G^T` and summed over the input channels to `m`; the pixels are `A^T m A`
//! (Winograd 1980; Lavin and Gray 2016, sections 4.1 and 4.3). The matrices of F(2x2) are those
//! of the latter paper; the matrices of F(4x4) are constructed from other points by the
//! Toom-Cook algorithm (Barabasz et al. 2020, section 2).

use super::vector::{Element, Vector};

/// The transforms along one direction.
pub(super) trait Filtering<const IN: usize, const OUT: usize> {
    /// `B^T d`.
    ///
    /// # Safety
    /// As for [`Vector`].
    #[allow(unsafe_code)]
    unsafe fn input<V: Vector>(values: [V; IN]) -> [V; IN];

    /// `A^T m`.
    ///
    /// # Safety
    /// As for [`Vector`].
    #[allow(unsafe_code)]
    unsafe fn output<V: Vector>(values: [V; IN]) -> [V; OUT];
}

/// F(2x2, 3x3): 2.25 times fewer multiplications.
#[derive(Debug)]
pub(super) struct Two;

/// F(4x4, 3x3): 4 times fewer multiplications.
#[derive(Debug)]
pub(super) struct Four;

#[allow(unsafe_code)]
impl Filtering<4, 2> for Two {
    #[inline(always)]
    unsafe fn input<V: Vector>([d0, d1, d2, d3]: [V; 4]) -> [V; 4] {
        // SAFETY: upheld by the caller.
        unsafe { [d0.sub(d2), d1.add(d2), d2.sub(d1), d1.sub(d3)] }
    }

    #[inline(always)]
    unsafe fn output<V: Vector>([m0, m1, m2, m3]: [V; 4]) -> [V; 2] {
        // SAFETY: upheld by the caller.
        unsafe { [m0.add(m1).add(m2), m1.sub(m2).sub(m3)] }
    }
}

/// The points at which the polynomials of F(4x4, 3x3) are evaluated, in addition to 0 and
/// infinity: plus and minus each. With the common choice of 1 and 2, rounding errors are two to
/// three times as large, because the powers of these numbers differ more. The powers of the
/// points used here are exact in floating point.
const NEAR: f32 = 0.75;
const FAR: f32 = 1.5;

#[allow(unsafe_code)]
impl Filtering<6, 4> for Four {
    #[inline(always)]
    unsafe fn input<V: Vector>([d0, d1, d2, d3, d4, d5]: [V; 6]) -> [V; 6] {
        const NEAR_2: f32 = NEAR * NEAR;
        const FAR_2: f32 = FAR * FAR;
        // SAFETY: upheld by the caller.
        unsafe {
            let (sum, product) = (V::splat(-(NEAR_2 + FAR_2)), V::splat(NEAR_2 * FAR_2));
            let near_even = V::splat(-FAR_2).mul_add(d2, d4);
            let near_odd = V::splat(-FAR_2).mul_add(d1, d3);
            let far_even = V::splat(-NEAR_2).mul_add(d2, d4);
            let far_odd = V::splat(-NEAR_2).mul_add(d1, d3);
            [
                sum.mul_add(d2, product.mul_add(d0, d4)),
                V::splat(NEAR).mul_add(near_odd, near_even),
                V::splat(-NEAR).mul_add(near_odd, near_even),
                V::splat(FAR).mul_add(far_odd, far_even),
                V::splat(-FAR).mul_add(far_odd, far_even),
                sum.mul_add(d3, product.mul_add(d1, d5)),
            ]
        }
    }

    #[inline(always)]
    unsafe fn output<V: Vector>([m0, m1, m2, m3, m4, m5]: [V; 6]) -> [V; 4] {
        // SAFETY: upheld by the caller.
        unsafe {
            let (near, far) = (m1.add(m2), m3.add(m4));
            let (near_difference, far_difference) = (m1.sub(m2), m3.sub(m4));
            let weighted = |of_near: f32, near: V, of_far: f32, far: V| {
                V::splat(of_far).mul_add(far, V::splat(of_near).mul(near))
            };
            [
                m0.add(near).add(far),
                weighted(NEAR, near_difference, FAR, far_difference),
                weighted(NEAR.powi(2), near, FAR.powi(2), far),
                weighted(NEAR.powi(3), near_difference, FAR.powi(3), far_difference).add(m5),
            ]
        }
    }
}

/// `G g G^T` of the nine taps for F(2x2, 3x3), computed in f64 and rounded once.
pub(crate) fn weights_two(taps: &[f32; 9]) -> [f32; 16] {
    transform([[1.0, 0.0, 0.0], [0.5, 0.5, 0.5], [0.5, -0.5, 0.5], [0.0, 0.0, 1.0]], taps)
}

/// `G g G^T` of the nine taps for F(4x4, 3x3), computed in f64 and rounded once.
pub(crate) fn weights_four(taps: &[f32; 9]) -> [f32; 36] {
    let points = [0.0, NEAR, -NEAR, FAR, -FAR].map(f64::from);
    // The value of the taps' polynomial at the point, divided by the product of the differences
    // from the other points.
    let row = |index: usize| {
        let point = points[index];
        let others = points.iter().filter(|other| **other != point);
        let distances: f64 = others.map(|other| point - other).product();
        [1.0 / distances, point / distances, point * point / distances]
    };
    let infinity = [0.0, 0.0, 1.0];
    transform([row(0), row(1), row(2), row(3), row(4), infinity], taps)
}

fn transform<const IN: usize, const POINTS: usize>(
    matrix: [[f64; 3]; IN],
    taps: &[f32; 9],
) -> [f32; POINTS] {
    std::array::from_fn(|point| {
        let (left, right) = (matrix[point / IN], matrix[point % IN]);
        let terms = (0..9).map(|tap| left[tap / 3] * right[tap % 3] * f64::from(taps[tap]));
        terms.sum::<f64>() as f32
    })
}

/// A row of tiles of one band.
#[derive(Debug)]
pub(crate) struct TileRow<'a> {
    /// The `IN` input rows on which the tiles depend, each `[column, channel]`. The first tile
    /// starts at the first column.
    pub(crate) rows: &'a [&'a [f32]],
    /// Number of tiles.
    pub(crate) tiles: usize,
    /// Distance between the columns of the input.
    pub(crate) column_pitch: usize,
    /// Number of vectors of channels.
    pub(crate) vectors: usize,
    /// Distance between points and between tiles of the result.
    pub(crate) out_pitch: [usize; 2],
}

/// The products of a row of tiles, to be transformed to pixels.
#[derive(Debug)]
pub(crate) struct ProductRow<'a> {
    /// `[point, tile, channel]`.
    pub(crate) products: &'a [f32],
    /// Distance between points and between tiles of `products`.
    pub(crate) pitch: [usize; 2],
    /// Number of tiles.
    pub(crate) tiles: usize,
    /// Number of vectors of channels.
    pub(crate) vectors: usize,
    /// One value for each output channel, in whole vectors.
    pub(crate) bias: &'a [f32],
    /// Whether negative sums are set to 0.
    pub(crate) relu: bool,
    /// Distance between the rows and between the columns of the result.
    pub(crate) out_pitch: [usize; 2],
}

/// Write `B^T d B` of every tile: `[point, tile, element]`.
///
/// # Safety
/// As for [`Vector`]. In addition, the slices must satisfy [`check_tiles`].
#[allow(unsafe_code)]
#[inline(always)]
pub(super) unsafe fn input<V, E, F, const IN: usize, const OUT: usize>(
    source: &TileRow<'_>,
    out: &mut [E],
) where
    V: Vector,
    E: Element<V>,
    F: Filtering<IN, OUT>,
{
    let [point_pitch, tile_pitch] = source.out_pitch;
    let rows: [*const f32; IN] = std::array::from_fn(|row| source.rows[row].as_ptr());
    for tile in 0..source.tiles {
        for vector in 0..source.vectors {
            let from = tile * OUT * source.column_pitch + vector * V::LANES;
            // SAFETY: the caller has checked the slices for all tiles and vectors.
            unsafe {
                let mut half = [[V::splat(0.0); IN]; IN];
                for col in 0..IN {
                    let at = from + col * source.column_pitch;
                    let column = F::input(std::array::from_fn(|row| V::load(rows[row].add(at))));
                    for (half, value) in half.iter_mut().zip(column) {
                        half[col] = value;
                    }
                }
                let element = vector * V::LANES / E::CHANNELS;
                let out = out.as_mut_ptr().add(tile * tile_pitch + element);
                for (row, values) in half.into_iter().enumerate() {
                    for (col, value) in F::input(values).into_iter().enumerate() {
                        E::store(value, out.add((row * IN + col) * point_pitch));
                    }
                }
            }
        }
    }
}

/// Write the pixels `A^T m A` of every tile, with bias and ReLU: `[row, column, channel]`.
///
/// # Safety
/// As for [`Vector`]. In addition, the slices must satisfy [`check_products`].
#[allow(unsafe_code)]
#[inline(always)]
pub(super) unsafe fn output<V, F, const IN: usize, const OUT: usize>(
    source: &ProductRow<'_>,
    out: &mut [f32],
) where
    V: Vector,
    F: Filtering<IN, OUT>,
{
    let [point_pitch, tile_pitch] = source.pitch;
    let [row_pitch, column_pitch] = source.out_pitch;
    for tile in 0..source.tiles {
        for vector in 0..source.vectors {
            // SAFETY: the caller has checked the slices for all tiles and vectors.
            unsafe {
                let from = source.products.as_ptr().add(tile * tile_pitch + vector * V::LANES);
                let mut half = [[V::splat(0.0); IN]; OUT];
                for col in 0..IN {
                    let load = |row| V::load(from.add((row * IN + col) * point_pitch));
                    let column = F::output(std::array::from_fn(load));
                    for (half, value) in half.iter_mut().zip(column) {
                        half[col] = value;
                    }
                }
                let bias = V::load(source.bias.as_ptr().add(vector * V::LANES));
                let lowest = V::splat(if source.relu { 0.0 } else { f32::NEG_INFINITY });
                let out = out.as_mut_ptr().add(tile * OUT * column_pitch + vector * V::LANES);
                for (row, values) in half.into_iter().enumerate() {
                    for (col, value) in F::output(values).into_iter().enumerate() {
                        let value = value.add(bias).max(lowest);
                        value.store(out.add(row * row_pitch + col * column_pitch));
                    }
                }
            }
        }
    }
}

/// Assert that the slices have the stated lengths; an element of the output contains `channels`
/// channels.
pub(super) fn check_tiles<E>(
    source: &TileRow<'_>,
    lanes: usize,
    out_size: usize,
    (out, channels): (&[E], usize),
) {
    let in_size = out_size + 2;
    let TileRow { rows, tiles, column_pitch, vectors, out_pitch } = *source;
    assert!(tiles > 0 && rows.len() == in_size);
    let columns = (tiles - 1) * out_size + in_size;
    let needed = (columns - 1) * column_pitch + vectors * lanes;
    assert!(rows.iter().all(|row| row.len() >= needed));
    let last = (in_size * in_size - 1) * out_pitch[0] + (tiles - 1) * out_pitch[1];
    assert!(out.len() >= last + vectors * lanes / channels);
}

/// Assert that the slices have the stated lengths.
pub(super) fn check_products(source: &ProductRow<'_>, lanes: usize, out_size: usize, out: &[f32]) {
    let ProductRow { products, pitch, tiles, vectors, bias, out_pitch, .. } = *source;
    let points = (out_size + 2) * (out_size + 2);
    assert!(tiles > 0);
    let last = (points - 1) * pitch[0] + (tiles - 1) * pitch[1];
    assert!(products.len() >= last + vectors * lanes);
    assert!(bias.len() >= vectors * lanes);
    let last = (out_size - 1) * out_pitch[0] + (tiles * out_size - 1) * out_pitch[1];
    assert!(out.len() >= last + vectors * lanes);
}
