//! Extinction prepared for ray tracing: cells, and the distances that a ray may skip through empty
//! cells.
//!
//! The cells of a constant medium are its voxels; those of a trilinear medium are the boxes between
//! neighbouring voxel centres. Along a ray a trilinear field is a cubic polynomial in each cell,
//! which the two-point Gauss-Legendre rule integrates without error. Optical depths are therefore
//! exact in both cases.
//!
//! A free path ends where the optical depth reaches a given value, which is found by inversion in
//! the cell where this occurs: delta tracking (Woodcock et al. 1965) in the limit in which the
//! local majorant equals the extinction and there are no null collisions.

mod depth;
mod walk;

pub(super) use walk::Heading;

use crate::grid::Grid;
use crate::math::DVec3;
use crate::optics::{Interpolation, Medium};
use crate::scene::Boundary;
use glam::IVec3;

/// Majorant that marks the cells around the field.
const OUTSIDE: f32 = 0.0;

/// A medium in its own coordinates: the unit of length along each axis is a cell, the origin is the
/// corner of the first cell. Distances along rays remain in km.
///
/// Only the part that contains medium is stored, surrounded by a layer of [`OUTSIDE`].
#[derive(Debug)]
pub(super) struct Field {
    lower: DVec3,
    inverse_cell: DVec3,
    /// Corner of the first cell and number of voxels of the grid, in voxels along x, y, z.
    corner: DVec3,
    voxels: [i32; 3],
    /// Number of cells along x, y, z.
    cells: [i32; 3],
    /// Strides in the arrays to the next cell along x, y, z.
    stride: [i32; 3],
    /// By cell: the extinction (the largest value in a trilinear cell); in an empty cell, minus the
    /// distance in cells to the nearest non-empty cell.
    majorant: Vec<f32>,
    /// Extinction at the lower corner of each cell, for trilinear media only.
    nodes: Vec<f32>,
    periodic: bool,
}

impl Field {
    /// Field of a medium with the given lateral boundary.
    pub(super) fn new(medium: &Medium, boundary: Boundary) -> Self {
        let periodic = boundary == Boundary::Periodic;
        let trilinear = medium.interpolation == Interpolation::Trilinear;
        let grid = &medium.extinction.grid;
        let all = lattice(grid, trilinear, periodic);
        let values = medium.extinction.values.as_standard_layout();
        let values = values.as_slice().expect("standard layout");
        let [nz, ny, nx] = grid.shape;
        // Nodes beyond the last one wrap around to the first; only a periodic field uses them.
        let node = |[i, j, k]: [usize; 3]| values[(k % nz * ny + j % ny) * nx + i % nx];
        let largest = |[i, j, k]: [usize; 3]| {
            if trilinear {
                let corner = |c: usize| node([i + (c & 1), j + (c >> 1 & 1), k + (c >> 2)]);
                (0..8).map(corner).fold(0.0, f32::max)
            } else {
                node([i, j, k])
            }
        };
        let (first, cells) = occupied(all, periodic, largest);
        let half = if trilinear { 0.5 } else { 0.0 };
        let corner = DVec3::new(first[0] as f64, first[1] as f64, first[2] as f64) + half;
        let stride = [1, cells[0] + 2, (cells[0] + 2) * (cells[1] + 2)];
        let mut field = Self {
            lower: grid.lower() + grid.spacing * corner,
            inverse_cell: grid.spacing.recip(),
            corner,
            voxels: [nx, ny, nz].map(|n| n as i32),
            cells: cells.map(|n| n as i32),
            stride: stride.map(|n| n as i32),
            majorant: vec![OUTSIDE; stride[2] * (cells[2] + 2)],
            nodes: Vec::new(),
            periodic,
        };
        for [i, j, k] in indices(cells) {
            field.majorant[i + 1 + (j + 1) * stride[1] + (k + 1) * stride[2]] =
                largest([i + first[0], j + first[1], k + first[2]]);
        }
        if trilinear {
            field.nodes = vec![0.0; field.majorant.len()];
            for [i, j, k] in indices(cells.map(|n| n + 1)) {
                field.nodes[i + 1 + (j + 1) * stride[1] + (k + 1) * stride[2]] =
                    node([i + first[0], j + first[1], k + first[2]]);
            }
        }
        field.mark_empty_air();
        field
    }

    /// Store in each empty cell minus its distance (the largest of the three components, in cells)
    /// to the nearest non-empty cell, in two passes over the neighbours.
    fn mark_empty_air(&mut self) {
        let far = 1_000_000;
        let distance = |majorant: f32| if majorant > 0.0 { 0 } else { far };
        let mut distances: Vec<i32> = self.majorant.iter().map(|m| distance(*m)).collect();
        let [nx, ny, nz] = self.cells.map(|n| n as usize);
        let [_, sy, sz] = self.stride.map(|n| n as usize);
        if self.periodic {
            // A jump must end at the sides, where the ray re-enters.
            for (index, distance) in distances.iter_mut().enumerate() {
                let (i, j) = (index % sy, index % sz / sy);
                if i == 0 || i == nx + 1 || j == 0 || j == ny + 1 {
                    *distance = 0;
                }
            }
        }
        let before: Vec<usize> = (0..13)
            .map(|n: usize| {
                let (k, j, i) = (n / 9, n / 3 % 3, n % 3);
                // Offsets (k, j, i) in -1..=1 that come before (0, 0, 0).
                (1 - k) * sz + sy + 1 - (j * sy + i)
            })
            .collect();
        let cell = |[i, j, k]: [usize; 3]| i + 1 + (j + 1) * sy + (k + 1) * sz;
        for index in indices([nx, ny, nz]) {
            let at = cell(index);
            let nearest = before.iter().map(|offset| distances[at - offset]).min().unwrap_or(far);
            distances[at] = distances[at].min(nearest + 1);
        }
        for [i, j, k] in indices([nx, ny, nz]) {
            let at = cell([nx - 1 - i, ny - 1 - j, nz - 1 - k]);
            let nearest = before.iter().map(|offset| distances[at + offset]).min().unwrap_or(far);
            distances[at] = distances[at].min(nearest + 1);
            if distances[at] > 0 {
                self.majorant[at] = -(distances[at] as f32);
            }
        }
    }

    /// Convert a point (km) to the coordinates of the field.
    pub(super) fn local(&self, point: DVec3) -> DVec3 {
        (point - self.lower) * self.inverse_cell
    }

    /// Convert a point in the coordinates of the field to km.
    pub(super) fn point(&self, local: DVec3) -> DVec3 {
        self.lower + local / self.inverse_cell
    }

    /// Voxel `[z, y, x]` of the grid that contains a point in the coordinates of the field.
    #[inline]
    pub(super) fn voxel(&self, local: DVec3) -> [usize; 3] {
        let index = floor(local + self.corner).to_array();
        let inside = |axis: usize| self.inside(axis, index[axis], self.voxels[axis]) as usize;
        [inside(2), inside(1), inside(0)]
    }

    /// Index along an axis of `count` cells, wrapped into the first period or clamped to the ends.
    #[inline]
    fn inside(&self, axis: usize, index: i32, count: i32) -> i32 {
        if self.periodic && axis < 2 { index.rem_euclid(count) } else { index.clamp(0, count - 1) }
    }

    /// Cell that contains a point in the coordinates of the field, or the nearest one.
    #[inline]
    pub(super) fn cell_at(&self, local: DVec3) -> usize {
        let index = floor(local).to_array();
        let inside = |axis: usize| self.inside(axis, index[axis], self.cells[axis]);
        self.cell([inside(0), inside(1), inside(2)]) as usize
    }

    #[inline]
    fn cell(&self, index: [i32; 3]) -> i32 {
        (index[0] + 1) + (index[1] + 1) * self.stride[1] + (index[2] + 1) * self.stride[2]
    }
}

/// Component-wise floor. It avoids the call of the mathematics library to which `f64::floor`
/// compiles for processors that are only guaranteed to have SSE2.
#[inline]
fn floor(v: DVec3) -> IVec3 {
    let whole = v.as_ivec3();
    let below = |axis: usize| whole[axis] - i32::from(f64::from(whole[axis]) > v[axis]);
    IVec3::new(below(0), below(1), below(2))
}

/// Number of cells of a grid along x, y, z.
fn lattice(grid: &Grid, trilinear: bool, periodic: bool) -> [usize; 3] {
    let [nz, ny, nx] = grid.shape;
    match (trilinear, periodic) {
        (false, _) => [nx, ny, nz],
        (true, true) => [nx, ny, nz - 1],
        (true, false) => [nx - 1, ny - 1, nz - 1],
    }
}

/// First cell and number of cells of the smallest box that contains all medium; a periodic field
/// retains its full width. A field without medium has one empty cell.
fn occupied(
    cells: [usize; 3],
    periodic: bool,
    largest: impl Fn([usize; 3]) -> f32,
) -> ([usize; 3], [usize; 3]) {
    let (mut first, mut last) = (cells, [0; 3]);
    for index in indices(cells).filter(|index| largest(*index) > 0.0) {
        for axis in 0..3 {
            first[axis] = first[axis].min(index[axis]);
            last[axis] = last[axis].max(index[axis]);
        }
    }
    if (0..3).any(|axis| first[axis] == cells[axis]) {
        return ([0; 3], [1; 3]);
    }
    if periodic {
        (first[0], first[1], last[0], last[1]) = (0, 0, cells[0] - 1, cells[1] - 1);
    }
    (first, std::array::from_fn(|axis| last[axis] + 1 - first[axis]))
}

/// All indices `[i, j, k]` below the given ones, x fastest.
fn indices([nx, ny, nz]: [usize; 3]) -> impl Iterator<Item = [usize; 3]> {
    (0..nz).flat_map(move |k| (0..ny).flat_map(move |j| (0..nx).map(move |i| [i, j, k])))
}

#[cfg(test)]
mod tests;
