//! Sweep: the radiance in all directions of an octant, computed cell by cell in the direction of
//! propagation.
//!
//! In a cell the radiance of an ordinate is a linear function,
//! `I_0 + sqrt(3) (I_1 x + I_2 y + I_3 z)` with coordinates from -1 to 1, and the transfer equation
//! holds for its mean and its first moments: the linear discontinuous finite element method (Adams
//! 2001, "Discontinuous finite element transport solutions in thick diffusive problems"). The
//! equation for the mean conserves energy for any optical depth of a cell. The equations of
//! direction `-n` are the transpose of those of `n`, on which the gradient relies.
//!
//! Optically thick voxels are split into as many cells as each of them requires; empty voxels are
//! not split. Between voxels with different numbers of parts, the radiance is projected from the
//! cells of one onto those of the other.

use super::lattice::{Active, Lattice, MOST_PARTS};
use super::quadrature::Octant;
use crate::math::with_vectors;
use pulp::{Simd, WithSimd};
use std::sync::LazyLock;

/// Radiance that enters or leaves through the faces of the grid in the ordinates of an octant: mean
/// and slopes along the two axes of the face, `[3][ordinate]` for each face of a voxel.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Faces {
    /// Through the sides normal to x, `[z][y]`.
    pub(super) x: Vec<f32>,
    /// Through the sides normal to y, `[z][x]`.
    pub(super) y: Vec<f32>,
    /// Through the top or bottom, `[y][x]`.
    pub(super) z: Vec<f32>,
}

impl Faces {
    /// Zero radiance.
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

/// The medium through which radiance is swept.
#[derive(Debug, Clone, Copy)]
pub(super) struct Medium<'a> {
    /// The cells.
    pub(super) lattice: &'a Lattice,
    /// Extinction (1/km): mean and slopes of each active cell.
    pub(super) extinction: &'a [[f32; 4]],
}

/// Operation on the radiance of each active cell.
pub(super) trait Visit {
    /// Change the source of a cell, `[4][ordinate]`, before its radiance is computed.
    #[inline(always)]
    fn source(&mut self, _octant: &Octant, _slot: usize, _source: &mut [f32]) {}

    /// Process the radiance of a cell, `[4][ordinate]`: mean and slopes.
    fn cell<S: Simd>(&mut self, simd: S, octant: &Octant, slot: usize, radiance: &[f32]);
}

/// Sweep octants with the same direction of propagation along y and z, one row of cells after
/// another, so that the data of a row are in the cache for all of them. `source` is
/// `[slot][4][harmonic]`. The [`Faces`] of each octant contain the radiance that flows in and,
/// after the call, the radiance that flows out.
pub(super) fn sweep<V: Visit>(
    medium: Medium,
    octants: &mut [(&Octant, Faces)],
    source: &[f32],
    visit: &mut V,
) {
    with_vectors(Sweep { medium, octants, source, visit });
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
        let [nz, ny, nx] = lattice.grid.shape;
        let Some((first, _)) = octants.first() else { return };
        let [_, forward_y, forward_z] = first.signs.map(|sign| sign > 0.0);
        let mut waves: Vec<_> =
            octants.iter().map(|(octant, faces)| Wave::new(simd, octant, lattice, faces)).collect();
        for step_z in 0..nz {
            let k = if forward_z { step_z } else { nz - 1 - step_z };
            for ((octant, faces), wave) in octants.iter().zip(&mut waves) {
                let face = 3 * octant.ordinates;
                for (i, patch) in wave.y.iter_mut().enumerate() {
                    patch.set(&faces.y[(k * nx + i) * face..][..face]);
                }
            }
            for step_y in 0..ny {
                let j = if forward_y { step_y } else { ny - 1 - step_y };
                for ((octant, faces), wave) in octants.iter_mut().zip(&mut waves) {
                    let face = 3 * octant.ordinates;
                    wave.x.set(&faces.x[(k * ny + j) * face..][..face]);
                    let row = Row { medium, octant, source, k, j };
                    row.sweep(simd, wave, visit);
                    let Wave { x, scratch, .. } = wave;
                    let whole = x.of_parts(1, lattice, 0, octant.ordinates, scratch);
                    faces.x[(k * ny + j) * face..][..face].copy_from_slice(whole);
                }
            }
            for ((octant, faces), wave) in octants.iter_mut().zip(&mut waves) {
                let face = 3 * octant.ordinates;
                let Wave { y, scratch, .. } = wave;
                for (i, patch) in y.iter_mut().enumerate() {
                    let whole = patch.of_parts(1, lattice, 1, octant.ordinates, scratch);
                    faces.y[(k * nx + i) * face..][..face].copy_from_slice(whole);
                }
            }
        }
        for ((octant, faces), wave) in octants.iter_mut().zip(&mut waves) {
            let face = 3 * octant.ordinates;
            let Wave { z, scratch, .. } = wave;
            for (column, patch) in z.iter_mut().enumerate() {
                let whole = patch.of_parts(1, lattice, 2, octant.ordinates, scratch);
                faces.z[column * face..][..face].copy_from_slice(whole);
            }
        }
    }
}

/// Radiance of an octant between voxels, at the current position of the sweep.
struct Wave<S: Simd> {
    /// Entering the next voxel of the row.
    x: Patch,
    /// Entering the next row of the level, by column.
    y: Vec<Patch>,
    /// Entering the next level, by row and column.
    z: Vec<Patch>,
    /// By number of parts of a voxel; the constants of unsplit voxels also serve empty voxels.
    constants: Vec<Option<Constants<S>>>,
    scratch: Vec<f32>,
    /// Workspace for the source and the radiance of a cell.
    room: Vec<f32>,
}

impl<S: Simd> Wave<S> {
    #[inline(always)]
    fn new(simd: S, octant: &Octant, lattice: &Lattice, faces: &Faces) -> Self {
        let [_, ny, nx] = lattice.grid.shape;
        let face = 3 * octant.ordinates;
        let z = (0..ny * nx).map(|column| {
            let mut patch = Patch::default();
            patch.set(&faces.z[column * face..][..face]);
            patch
        });
        let mut constants: Vec<_> = (0..=MOST_PARTS).map(|_| None).collect();
        let used = lattice.active().iter().map(|active| active.parts);
        for parts in used.chain([1]) {
            constants[parts as usize]
                .get_or_insert_with(|| Constants::new(simd, octant, lattice, parts));
        }
        Self {
            x: Patch::default(),
            y: (0..nx).map(|_| Patch::default()).collect(),
            z: z.collect(),
            constants,
            scratch: Vec::new(),
            room: vec![0.0; 8 * octant.ordinates],
        }
    }
}

/// Radiance through a face of a voxel, cell by cell: mean and slopes along columns and rows,
/// `[row][col][3][ordinate]`.
#[derive(Debug, Default)]
struct Patch {
    parts: u32,
    values: Vec<f32>,
}

impl Patch {
    /// Set to a face of a single cell.
    #[inline(always)]
    fn set(&mut self, values: &[f32]) {
        self.parts = 1;
        self.values.clear();
        self.values.extend_from_slice(values);
    }

    /// Project the values onto the cells of a voxel with `parts` parts, behind the face normal to
    /// `axis`. The projection conserves the flux, and its transpose is the projection in the
    /// opposite direction.
    #[inline(always)]
    fn of_parts(
        &mut self,
        parts: u32,
        lattice: &Lattice,
        axis: usize,
        ordinates: usize,
        scratch: &mut Vec<f32>,
    ) -> &mut [f32] {
        if self.parts != parts {
            let (row_axis, col_axis) = [(2, 1), (2, 0), (1, 0)][axis];
            let [from, to] = [self.parts, parts].map(|parts| lattice.parts_along(parts));
            let rows = projection(from[row_axis], to[row_axis]);
            let cols = projection(from[col_axis], to[col_axis]);
            let face = 3 * ordinates;
            scratch.clear();
            scratch.resize(to[row_axis] * to[col_axis] * face, 0.0);
            for Overlap { into: row, of: of_row, weights: r } in rows {
                for Overlap { into: col, of: of_col, weights: c } in cols {
                    let of = &self.values[(of_row * from[col_axis] + of_col) * face..][..face];
                    let into = &mut scratch[(row * to[col_axis] + col) * face..][..face];
                    let (m, slopes) = of.split_at(ordinates);
                    let (u, v) = slopes.split_at(ordinates);
                    // By moment of the target and of the source: mean, along columns, along rows.
                    let table = [
                        [r[0][0] * c[0][0], r[0][0] * c[0][1], r[0][1] * c[0][0]],
                        [r[0][0] * c[1][0], r[0][0] * c[1][1], r[0][1] * c[1][0]],
                        [r[1][0] * c[0][0], r[1][0] * c[0][1], r[1][1] * c[0][0]],
                    ];
                    for (into, [a, b, d]) in into.chunks_exact_mut(ordinates).zip(table) {
                        for (n, value) in into.iter_mut().enumerate() {
                            *value += a * m[n] + b * u[n] + d * v[n];
                        }
                    }
                }
            }
            std::mem::swap(&mut self.values, scratch);
            self.parts = parts;
        }
        &mut self.values
    }
}

/// Contribution of cell `of` of one partition of an edge to cell `into` of another one. `weights`
/// are indexed by moment (mean, slope) of the latter, then of the former.
#[derive(Debug, Clone, Copy)]
struct Overlap {
    into: usize,
    of: usize,
    weights: [[f32; 2]; 2],
}

/// Projection of functions that are linear in each of `from` equal parts of an edge onto functions
/// that are linear in each of `to` parts.
fn projection(from: usize, to: usize) -> &'static [Overlap] {
    static TABLES: LazyLock<Vec<Vec<Overlap>>> = LazyLock::new(|| {
        let pairs = (0..MOST_PARTS).flat_map(|a| (0..MOST_PARTS).map(move |b| (a + 1, b + 1)));
        pairs.map(|(from, to)| overlaps(from, to)).collect()
    });
    &TABLES[(from - 1) * MOST_PARTS + to - 1]
}

fn overlaps(from: usize, to: usize) -> Vec<Overlap> {
    let mut overlaps = Vec::new();
    for into in 0..to {
        for of in 0..from {
            let edge = |index: usize, count: usize| index as f64 / count as f64;
            let low = edge(into, to).max(edge(of, from));
            let high = edge(into + 1, to).min(edge(of + 1, from));
            if high - low < 1e-9 {
                continue;
            }
            // Integrals of products of linear functions, by the two-point Gauss rule.
            let mut weights = [[0.0; 2]; 2];
            for side in [-1.0, 1.0] {
                let x = 0.5 * (low + high) + side * 0.5 * (high - low) / 3.0_f64.sqrt();
                let functions = |index: usize, count: usize| {
                    [1.0, 3.0_f64.sqrt() * (2.0 * (x * count as f64 - index as f64) - 1.0)]
                };
                let (target, source) = (functions(into, to), functions(of, from));
                let weight = 0.5 * (high - low) * to as f64;
                for (row, target) in weights.iter_mut().zip(target) {
                    for (sum, source) in row.iter_mut().zip(source) {
                        *sum += weight * target * source;
                    }
                }
            }
            let weights = weights.map(|row| row.map(|weight: f64| weight as f32));
            overlaps.push(Overlap { into, of, weights });
        }
    }
    overlaps
}

/// A row of voxels in an octant.
struct Row<'a> {
    medium: Medium<'a>,
    octant: &'a Octant,
    source: &'a [f32],
    k: usize,
    j: usize,
}

impl Row<'_> {
    #[inline(always)]
    fn sweep<S: Simd, V: Visit>(&self, simd: S, wave: &mut Wave<S>, visit: &mut V) {
        let Self { medium, octant, k, j, .. } = *self;
        let lattice = medium.lattice;
        let [_, ny, nx] = lattice.grid.shape;
        let n = octant.ordinates;
        let Wave { x, y, z, constants, scratch, room } = wave;
        for step_x in 0..nx {
            let i = if octant.signs[0] > 0.0 { step_x } else { nx - 1 - step_x };
            let active = lattice.at((k * ny + j) * nx + i);
            let parts = active.map_or(1, |active| active.parts);
            let constants = constants[parts as usize].as_ref().expect("exists for all used parts");
            let x = x.of_parts(parts, lattice, 0, n, scratch);
            let y = y[i].of_parts(parts, lattice, 1, n, scratch);
            let z = z[j * nx + i].of_parts(parts, lattice, 2, n, scratch);
            match active {
                None => constants.empty(simd, [x, y, z]),
                Some(active) => self.voxel(simd, active, constants, [x, y, z], room, visit),
            }
        }
    }

    /// Sweep the cells of an active voxel.
    #[inline(always)]
    fn voxel<S: Simd, V: Visit>(
        &self,
        simd: S,
        active: &Active,
        constants: &Constants<S>,
        [x, y, z]: [&mut [f32]; 3],
        room: &mut [f32],
        visit: &mut V,
    ) {
        let Self { medium, octant, source, .. } = *self;
        let [px, py, pz] = medium.lattice.parts_along(active.parts);
        let face = 3 * octant.ordinates;
        let harmonics = octant.to_moments.len() / octant.ordinates;
        let (cell_source, radiance) = room.split_at_mut(4 * octant.ordinates);
        let along = |axis: usize, step: usize, count: usize| {
            if octant.signs[axis] > 0.0 { step } else { count - 1 - step }
        };
        for step_z in 0..pz {
            let k = along(2, step_z, pz);
            for step_y in 0..py {
                let j = along(1, step_y, py);
                for step_x in 0..px {
                    let i = along(0, step_x, px);
                    let slot = active.first as usize + (k * py + j) * px + i;
                    let moments = &source[slot * 4 * harmonics..][..4 * harmonics];
                    to_ordinates(simd, octant, moments, cell_source);
                    visit.source(octant, slot, cell_source);
                    let faces = [
                        &mut x[(k * py + j) * face..][..face],
                        &mut y[(k * px + i) * face..][..face],
                        &mut z[(j * px + i) * face..][..face],
                    ];
                    let extinction = medium.extinction[slot];
                    constants.solve(simd, extinction, cell_source, faces, radiance);
                    visit.cell(simd, octant, slot, radiance);
                }
            }
        }
    }
}

/// Coefficients shared by all cells of one size, one vector of ordinates after another.
struct Constants<S: Simd> {
    vectors: usize,
    /// Direction cosine over cell size along each axis (1/km).
    streaming: [Vec<S::f32s>; 3],
    /// The same times `sqrt(3)` and the sign of the direction.
    slanted: [Vec<S::f32s>; 3],
    /// Inverse pivots of the equations of an empty cell: mean and slopes.
    empty_inverse: [Vec<S::f32s>; 4],
    edge: [S::f32s; 3],
}

impl<S: Simd> Constants<S> {
    #[inline(always)]
    fn new(simd: S, octant: &Octant, lattice: &Lattice, parts: u32) -> Self {
        let root = 3.0_f32.sqrt();
        let whole = lattice.grid.spacing.as_vec3().to_array();
        let along = lattice.parts_along(parts);
        let spacing: [f32; 3] = std::array::from_fn(|axis| whole[axis] / along[axis] as f32);
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

    /// Moments of the light that enters through the faces.
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

    /// Write the radiance that leaves a cell of the given radiance.
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

    /// Solve an active cell. The four equations are solved by elimination of the slopes, which are
    /// coupled only through the mean.
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

    /// Solve an empty cell.
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

/// Convert `[4][harmonic]` to `[4][ordinate]`.
#[inline(always)]
fn to_ordinates<S: Simd>(simd: S, octant: &Octant, moments: &[f32], radiance: &mut [f32]) {
    rows_times_table(simd, moments, &octant.to_ordinates, |index, sum| {
        S::as_mut_simd_f32s(&mut radiance[index..]).0[0] = sum;
    });
}

/// Add the moments of the radiance of a cell: `[4][ordinate]` to `[4][harmonic]`.
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

/// Product of four rows with a table whose rows are whole vectors. `keep` receives the position of
/// each vector of the result in the four rows, and the vector. Two vectors of all four rows are
/// processed at a time, which keeps both multipliers of a core busy.
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
