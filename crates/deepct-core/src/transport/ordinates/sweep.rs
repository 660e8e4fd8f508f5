//! The sweep: radiance in all directions of an octant, cell by cell in the direction of
//! light.
//!
//! In a cell the radiance of an ordinate is a linear function, `I_0 + sqrt(3) (I_1 x +
//! I_2 y + I_3 z)` with coordinates from -1 to 1, and the transfer equation holds for its
//! mean and its first moments: the linear discontinuous finite element method (Adams 2001,
//! "Discontinuous finite element transport solutions in thick diffusive problems"). The
//! mean makes it conserve energy whatever the optical depth of a cell. The equations of
//! direction `-n` are the transpose of those of `n`, which the gradient lives on.

use super::lattice::Lattice;
use super::quadrature::Octant;
use pulp::{Arch, Simd, WithSimd};

/// Radiance that enters or leaves through faces of the grid in the ordinates of an octant:
/// mean and the slopes along the two axes of the face, `[3][ordinate]` for each face of a
/// cell.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Faces {
    /// Through the sides across x, `[z][y]`.
    pub(super) x: Vec<f32>,
    /// Through the sides across y, `[z][x]`.
    pub(super) y: Vec<f32>,
    /// Through the top or bottom, `[y][x]`.
    pub(super) z: Vec<f32>,
}

impl Faces {
    /// No radiance.
    pub(super) fn dark(lattice: &Lattice, octant: &Octant) -> Self {
        let [nz, ny, nx] = lattice.grid.shape;
        let face = 3 * octant.ordinates;
        Self {
            x: vec![0.0; nz * ny * face],
            y: vec![0.0; nz * nx * face],
            z: vec![0.0; ny * nx * face],
        }
    }
}

/// What a sweep goes through.
#[derive(Debug, Clone, Copy)]
pub(super) struct Medium<'a> {
    /// The cells.
    pub(super) lattice: &'a Lattice,
    /// Extinction (1/km): mean and slopes of each active cell.
    pub(super) extinction: &'a [[f32; 4]],
}

/// What is done with the radiance of an active cell.
pub(super) trait Visit {
    /// `radiance` is `[4][ordinate]`: mean and slopes.
    fn cell<S: Simd>(&mut self, simd: S, octant: &Octant, slot: usize, radiance: &[f32]);
}

/// Sweep octants whose light goes the same way along y and z, row of cells by row: what a row
/// holds is then in the cache for all of them. `source` is `[slot][4][harmonic]`; with each
/// octant comes what flows in through the faces and, after the call, what flows out.
pub(super) fn sweep<V: Visit>(
    medium: Medium,
    octants: &mut [(&Octant, Faces)],
    source: &[f32],
    visit: &mut V,
) {
    Arch::new().dispatch(Sweep { medium, octants, source, visit });
}

struct Sweep<'a, 'b, V> {
    medium: Medium<'a>,
    octants: &'a mut [(&'b Octant, Faces)],
    source: &'a [f32],
    visit: &'a mut V,
}

impl<V: Visit> WithSimd for Sweep<'_, '_, V> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { medium, octants, source, visit } = self;
        let lattice = medium.lattice;
        let [nz, ny, _] = lattice.grid.shape;
        let Some((first, _)) = octants.first() else { return };
        let [_, forward_y, forward_z] = first.signs.map(|sign| sign > 0.0);
        let constants: Vec<_> =
            octants.iter().map(|(octant, _)| Constants::new(simd, octant, lattice)).collect();
        let mut room = vec![0.0; 8 * first.ordinates];
        for step_z in 0..nz {
            let k = if forward_z { step_z } else { nz - 1 - step_z };
            for step_y in 0..ny {
                let j = if forward_y { step_y } else { ny - 1 - step_y };
                for ((octant, faces), constants) in octants.iter_mut().zip(&constants) {
                    let row = Row { medium, octant, source, k, j };
                    row.sweep(simd, constants, faces, &mut room, visit);
                }
            }
        }
    }
}

/// A row of cells in an octant.
struct Row<'a> {
    medium: Medium<'a>,
    octant: &'a Octant,
    source: &'a [f32],
    k: usize,
    j: usize,
}

impl Row<'_> {
    #[inline(always)]
    fn sweep<S: Simd, V: Visit>(
        &self,
        simd: S,
        constants: &Constants<S>,
        faces: &mut Faces,
        room: &mut [f32],
        visit: &mut V,
    ) {
        let Self { medium, octant, source, k, j } = *self;
        let [_, ny, nx] = medium.lattice.grid.shape;
        let face = 3 * octant.ordinates;
        let harmonics = octant.to_moments.len() / octant.ordinates;
        let (cell_source, radiance) = room.split_at_mut(4 * octant.ordinates);
        let x_face = &mut faces.x[(k * ny + j) * face..][..face];
        for step_x in 0..nx {
            let i = if octant.signs[0] > 0.0 { step_x } else { nx - 1 - step_x };
            let y_face = &mut faces.y[(k * nx + i) * face..][..face];
            let z_face = &mut faces.z[(j * nx + i) * face..][..face];
            let Some(slot) = medium.lattice.slot((k * ny + j) * nx + i) else {
                constants.empty(simd, [&mut *x_face, y_face, z_face]);
                continue;
            };
            let moments = &source[slot * 4 * harmonics..][..4 * harmonics];
            to_ordinates(simd, octant, moments, cell_source);
            constants.solve(
                simd,
                medium.extinction[slot],
                cell_source,
                [&mut *x_face, y_face, z_face],
                radiance,
            );
            visit.cell(simd, octant, slot, radiance);
        }
    }
}

/// What all cells have in common, a vector of ordinates after the other.
struct Constants<S: Simd> {
    vectors: usize,
    /// Cosine over cell size along each axis (1/km).
    streaming: [Vec<S::f32s>; 3],
    /// The same times `sqrt(3)` and the sign of the direction.
    slanted: [Vec<S::f32s>; 3],
    /// Outgoing mean and slopes by incoming ones, in an empty cell.
    empty_inverse: [Vec<S::f32s>; 4],
    edge: [S::f32s; 3],
}

impl<S: Simd> Constants<S> {
    #[inline(always)]
    fn new(simd: S, octant: &Octant, lattice: &Lattice) -> Self {
        let root = 3.0_f32.sqrt();
        let spacing = lattice.grid.spacing.as_vec3().to_array();
        let scaled = |axis: usize, factor: f32| {
            let values: Vec<f32> =
                octant.cosines[axis].iter().map(|cosine| cosine * factor / spacing[axis]).collect();
            S::as_simd_f32s(&values).0.to_vec()
        };
        let streaming = [0, 1, 2].map(|axis| scaled(axis, 1.0));
        let slanted = [0, 1, 2].map(|axis| scaled(axis, root * octant.signs[axis]));
        let vectors = streaming[0].len();
        let one = simd.splat_f32s(1.0);
        let mut empty_inverse = [const { Vec::new() }; 4];
        for v in 0..vectors {
            let total = sum(simd, [0, 1, 2].map(|axis| streaming[axis][v]));
            let mut mean = total;
            for axis in 0..3 {
                let a = streaming[axis][v];
                let inverse = simd.div_f32s(one, simd.add_f32s(total, simd.add_f32s(a, a)));
                let square = simd.mul_f32s(slanted[axis][v], slanted[axis][v]);
                mean = simd.mul_add_e_f32s(square, inverse, mean);
                empty_inverse[axis + 1].push(inverse);
            }
            empty_inverse[0].push(simd.div_f32s(one, mean));
        }
        let edge = octant.signs.map(|sign| simd.splat_f32s(root * sign));
        Self { vectors, streaming, slanted, empty_inverse, edge }
    }

    /// The moments of the light that comes in through the faces.
    #[inline(always)]
    fn incoming(&self, simd: S, v: usize, [x, y, z]: [&[S::f32s]; 3]) -> [S::f32s; 4] {
        let n = self.vectors;
        let [a, b, c] = [self.streaming[0][v], self.streaming[1][v], self.streaming[2][v]];
        let of = |face: &[S::f32s], moment: usize| face[moment * n + v];
        let add =
            |first: S::f32s, value: S::f32s, rest: S::f32s| simd.mul_add_e_f32s(first, value, rest);
        let means = [of(x, 0), of(y, 0), of(z, 0)];
        let minus = |axis: usize| simd.neg_f32s(simd.mul_f32s(self.slanted[axis][v], means[axis]));
        [
            add(a, means[0], add(b, means[1], simd.mul_f32s(c, means[2]))),
            add(b, of(y, 1), add(c, of(z, 1), minus(0))),
            add(a, of(x, 1), add(c, of(z, 2), minus(1))),
            add(a, of(x, 2), add(b, of(y, 2), minus(2))),
        ]
    }

    /// Write what flows out of a cell of the given radiance.
    #[inline(always)]
    fn outgoing(
        &self,
        simd: S,
        v: usize,
        [mean, i, j, k]: [S::f32s; 4],
        [x, y, z]: [&mut [S::f32s]; 3],
    ) {
        let n = self.vectors;
        let edge = |axis: usize, slope| simd.mul_add_e_f32s(self.edge[axis], slope, mean);
        (x[v], x[n + v], x[2 * n + v]) = (edge(0, i), j, k);
        (y[v], y[n + v], y[2 * n + v]) = (edge(1, j), i, k);
        (z[v], z[n + v], z[2 * n + v]) = (edge(2, k), i, j);
    }

    /// A cell with a medium in it. The four equations are solved by elimination of the
    /// slopes, which meet each other only in the mean.
    #[inline(always)]
    fn solve(
        &self,
        simd: S,
        extinction: [f32; 4],
        source: &[f32],
        faces: [&mut [f32]; 3],
        radiance: &mut [f32],
    ) {
        let n = self.vectors;
        let [x, y, z] = faces;
        let (x, y, z) =
            (S::as_mut_simd_f32s(x).0, S::as_mut_simd_f32s(y).0, S::as_mut_simd_f32s(z).0);
        let source = S::as_simd_f32s(source).0;
        let radiance = S::as_mut_simd_f32s(radiance).0;
        let one = simd.splat_f32s(1.0);
        for v in 0..n {
            let mut right = self.incoming(simd, v, [x, y, z]);
            for (moment, right) in right.iter_mut().enumerate() {
                *right = simd.add_f32s(*right, source[moment * n + v]);
            }
            let streaming = [self.streaming[0][v], self.streaming[1][v], self.streaming[2][v]];
            let total = simd.add_f32s(simd.splat_f32s(extinction[0]), sum(simd, streaming));
            let (mut above, mut below) = (right[0], total);
            let mut slopes = [right[0]; 3];
            let mut coupling = [right[0]; 3];
            for axis in 0..3 {
                let (a, slanted) = (streaming[axis], self.slanted[axis][v]);
                let inverse = simd.div_f32s(one, simd.add_f32s(total, simd.add_f32s(a, a)));
                let slope = simd.splat_f32s(extinction[axis + 1]);
                let to_mean = simd.add_f32s(slope, slanted);
                let from_mean = simd.sub_f32s(slope, slanted);
                slopes[axis] = simd.mul_f32s(right[axis + 1], inverse);
                coupling[axis] = simd.mul_f32s(from_mean, inverse);
                above = simd.negate_mul_add_e_f32s(to_mean, slopes[axis], above);
                below = simd.negate_mul_add_e_f32s(to_mean, coupling[axis], below);
            }
            let mean = simd.div_f32s(above, below);
            for (slope, coupling) in slopes.iter_mut().zip(coupling) {
                *slope = simd.negate_mul_add_e_f32s(coupling, mean, *slope);
            }
            let values = [mean, slopes[0], slopes[1], slopes[2]];
            for (moment, value) in values.into_iter().enumerate() {
                radiance[moment * n + v] = value;
            }
            self.outgoing(simd, v, values, [&mut *x, &mut *y, &mut *z]);
        }
    }

    /// A cell with nothing in it.
    #[inline(always)]
    fn empty(&self, simd: S, faces: [&mut [f32]; 3]) {
        let [x, y, z] = faces;
        let (x, y, z) =
            (S::as_mut_simd_f32s(x).0, S::as_mut_simd_f32s(y).0, S::as_mut_simd_f32s(z).0);
        for v in 0..self.vectors {
            let right = self.incoming(simd, v, [x, y, z]);
            let inverse = |moment: usize| self.empty_inverse[moment][v];
            let mut mean = right[0];
            let mut slopes = [right[0]; 3];
            for axis in 0..3 {
                slopes[axis] = simd.mul_f32s(right[axis + 1], inverse(axis + 1));
                mean = simd.negate_mul_add_e_f32s(self.slanted[axis][v], slopes[axis], mean);
            }
            mean = simd.mul_f32s(mean, inverse(0));
            for (axis, slope) in slopes.iter_mut().enumerate() {
                let coupling = simd.mul_f32s(self.slanted[axis][v], inverse(axis + 1));
                *slope = simd.mul_add_e_f32s(coupling, mean, *slope);
            }
            let values = [mean, slopes[0], slopes[1], slopes[2]];
            self.outgoing(simd, v, values, [&mut *x, &mut *y, &mut *z]);
        }
    }
}

#[inline(always)]
fn sum<S: Simd>(simd: S, [a, b, c]: [S::f32s; 3]) -> S::f32s {
    simd.add_f32s(a, simd.add_f32s(b, c))
}

/// `[4][harmonic]` to `[4][ordinate]`.
#[inline(always)]
fn to_ordinates<S: Simd>(simd: S, octant: &Octant, moments: &[f32], radiance: &mut [f32]) {
    rows_times_table(simd, moments, &octant.to_ordinates, |index, sum| {
        S::as_mut_simd_f32s(&mut radiance[index..]).0[0] = sum;
    });
}

/// Add the moments of a cell's radiance: `[4][ordinate]` to `[4][harmonic]`.
#[inline(always)]
pub(super) fn add_moments<S: Simd>(
    simd: S,
    octant: &Octant,
    radiance: &[f32],
    moments: &mut [f32],
) {
    rows_times_table(simd, radiance, &octant.to_moments, |index, sum| {
        let into = &mut S::as_mut_simd_f32s(&mut moments[index..]).0[0];
        *into = simd.add_f32s(*into, sum);
    });
}

/// The product of four rows with a table whose rows are whole vectors; `keep` is given each
/// vector of the result and where it belongs in four rows. Two vectors of all four rows at
/// a time keep both multipliers of a core busy.
#[inline(always)]
fn rows_times_table<S: Simd>(
    simd: S,
    rows: &[f32],
    table: &[f32],
    mut keep: impl FnMut(usize, S::f32s),
) {
    let length = rows.len() / 4;
    let width = table.len() / length;
    let (a, rest) = rows.split_at(length);
    let (b, rest) = rest.split_at(length);
    let (c, d) = rest.split_at(length);
    let mut first = 0;
    while first < width {
        let pair = first + 2 * S::F32_LANES <= width;
        let mut sums = [[simd.splat_f32s(0.0); 2]; 4];
        for n in 0..length {
            let row =
                &table[n * width + first..][..if pair { 2 * S::F32_LANES } else { S::F32_LANES }];
            let weights = S::as_simd_f32s(row).0;
            for (sum, value) in sums.iter_mut().zip([a[n], b[n], c[n], d[n]]) {
                let value = simd.splat_f32s(value);
                sum[0] = simd.mul_add_e_f32s(weights[0], value, sum[0]);
                if pair {
                    sum[1] = simd.mul_add_e_f32s(weights[1], value, sum[1]);
                }
            }
        }
        for (row, sum) in sums.into_iter().enumerate() {
            keep(row * width + first, sum[0]);
            if pair {
                keep(row * width + first + S::F32_LANES, sum[1]);
            }
        }
        first += if pair { 2 } else { 1 } * S::F32_LANES;
    }
}
