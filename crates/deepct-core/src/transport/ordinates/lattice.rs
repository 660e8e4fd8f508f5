//! The cells of the solver, and the extinction in them.

use crate::grid::Grid;
use crate::math::{DVec3, Ray};
use crate::optics::Interpolation;
use crate::scene::Boundary;
use crate::traverse::walk;

/// Mark of a cell that is not active.
const NONE: u32 = u32::MAX;

/// The cells: voxels of a constant medium, boxes between voxel centres of a trilinear one.
/// Those that hold medium, or may come to hold some, are active and have a slot each.
#[derive(Debug)]
pub(super) struct Lattice {
    /// Where the cells are.
    pub(super) grid: Grid,
    /// The sides.
    pub(super) boundary: Boundary,
    interpolation: Interpolation,
    /// Number of voxels along z, y, x.
    voxels: [usize; 3],
    slots: Vec<u32>,
    /// The cell of each slot.
    active: Vec<u32>,
}

/// A part of a ray, in one cell.
#[derive(Debug, Clone, Copy)]
pub(super) struct Segment {
    /// The slot of the cell, if it is active.
    pub(super) slot: Option<usize>,
    /// Length (km).
    pub(super) length: f64,
    /// Where it enters and leaves, from 0 to 1 along x, y, z of the cell.
    pub(super) from: DVec3,
    pub(super) to: DVec3,
}

impl Lattice {
    /// The cells of a grid of voxels; `active` tells whether a voxel matters.
    pub(super) fn new(
        voxels: &Grid,
        interpolation: Interpolation,
        boundary: Boundary,
        active: impl Fn(usize) -> bool,
    ) -> Self {
        let [nz, ny, nx] = voxels.shape;
        let (grid, periodic) = (*voxels, boundary == Boundary::Periodic);
        let grid = match interpolation {
            Interpolation::Constant => grid,
            Interpolation::Trilinear => Grid {
                origin: grid.origin + 0.5 * grid.spacing,
                shape: if periodic { [nz - 1, ny, nx] } else { [nz - 1, ny - 1, nx - 1] },
                ..grid
            },
        };
        let mut lattice = Self {
            grid,
            boundary,
            interpolation,
            voxels: voxels.shape,
            slots: vec![NONE; grid.len()],
            active: Vec::new(),
        };
        for cell in 0..grid.len() {
            if lattice.corners(cell).into_iter().any(&active) {
                lattice.slots[cell] = lattice.active.len() as u32;
                lattice.active.push(cell as u32);
            }
        }
        lattice
    }

    /// Number of active cells.
    pub(super) fn len(&self) -> usize {
        self.active.len()
    }

    /// The slot of a cell, if it is active.
    #[inline(always)]
    pub(super) fn slot(&self, cell: usize) -> Option<usize> {
        let slot = self.slots[cell];
        (slot != NONE).then_some(slot as usize)
    }

    /// The voxels at the corners of a cell, x fastest; the same one eight times where the
    /// medium is constant.
    pub(super) fn corners(&self, cell: usize) -> [usize; 8] {
        if self.interpolation == Interpolation::Constant {
            return [cell; 8];
        }
        let [_, rows, cols] = self.grid.shape;
        let [_, ny, nx] = self.voxels;
        let (k, j, i) = (cell / (rows * cols), cell / cols % rows, cell % cols);
        std::array::from_fn(|corner| {
            let (dx, dy, dz) = (corner & 1, corner >> 1 & 1, corner >> 2);
            ((k + dz) * ny + (j + dy) % ny) * nx + (i + dx) % nx
        })
    }

    /// As [`Lattice::corners`], of a slot.
    pub(super) fn corners_of(&self, slot: usize) -> [usize; 8] {
        self.corners(self.active[slot] as usize)
    }

    /// The extinction at a place in a cell, from 0 to 1 along each axis.
    #[inline]
    pub(super) fn value(&self, voxels: &[f32], slot: usize, at: DVec3) -> f64 {
        if self.interpolation == Interpolation::Constant {
            return f64::from(voxels[self.active[slot] as usize]);
        }
        let corners = self.corners_of(slot).into_iter().zip(corner_weights(at));
        corners.map(|(voxel, weight)| weight * f64::from(voxels[voxel])).sum()
    }

    /// The transpose of [`Lattice::value`].
    #[inline]
    pub(super) fn spread(&self, voxels: &mut [f64], slot: usize, at: DVec3, value: f64) {
        if self.interpolation == Interpolation::Constant {
            voxels[self.active[slot] as usize] += value;
            return;
        }
        for (voxel, weight) in self.corners_of(slot).into_iter().zip(corner_weights(at)) {
            voxels[voxel] += weight * value;
        }
    }

    /// Mean and slopes of the extinction of a cell.
    pub(super) fn coefficients(&self, voxels: &[f32], slot: usize) -> [f32; 4] {
        let mut coefficients = [0.0; 4];
        for (corner, voxel) in self.corners_of(slot).into_iter().enumerate() {
            for (sum, weight) in coefficients.iter_mut().zip(corner_coefficients(corner)) {
                *sum += weight * voxels[voxel];
            }
        }
        coefficients
    }

    /// The transpose of [`Lattice::coefficients`].
    pub(super) fn spread_coefficients(&self, voxels: &mut [f64], slot: usize, values: [f32; 4]) {
        for (corner, voxel) in self.corners_of(slot).into_iter().enumerate() {
            for (value, weight) in values.iter().zip(corner_coefficients(corner)) {
                voxels[voxel] += f64::from(value * weight);
            }
        }
    }

    /// A place in a cell, from 0 to 1 along each axis, in km.
    pub(super) fn point(&self, slot: usize, at: DVec3) -> DVec3 {
        let cell = self.active[slot] as usize;
        let [_, ny, nx] = self.grid.shape;
        let corner =
            DVec3::new((cell % nx) as f64, (cell / nx % ny) as f64, (cell / nx / ny) as f64);
        self.grid.origin + self.grid.spacing * (corner + at)
    }

    /// The cells that a ray passes, in order.
    pub(super) fn segments(&self, ray: Ray) -> impl Iterator<Item = Segment> {
        let grid = self.unfolded(&ray);
        let [_, ny, nx] = self.grid.shape;
        walk(&grid, &ray).map(move |step| {
            let [k, j, i] = step.voxel;
            let corner = DVec3::new(i as f64, j as f64, k as f64);
            let local = |distance: f64| (ray.at(distance) - grid.origin) / grid.spacing - corner;
            Segment {
                slot: self.slot((k * ny + j % ny) * nx + i % nx),
                length: step.exit - step.enter,
                from: local(step.enter),
                to: local(step.exit),
            }
        })
    }

    /// The grid; between periodic sides as many of its copies as a ray passes.
    fn unfolded(&self, ray: &Ray) -> Grid {
        let mut grid = self.grid;
        if self.boundary == Boundary::Open || ray.direction.z == 0.0 {
            return grid;
        }
        let ends = [self.grid.lower().z, self.grid.upper().z]
            .map(|z| ray.at(((z - ray.origin.z) / ray.direction.z).max(0.0)));
        let extent = self.grid.extent();
        let period = |point: DVec3| ((point - self.grid.origin) / extent).floor();
        let (first, last) = (
            period(ends[0].min(ends[1])).min(DVec3::ZERO),
            period(ends[0].max(ends[1])).max(DVec3::ZERO),
        );
        for (axis, index) in [(0, 2), (1, 1)] {
            grid.origin[axis] += first[axis] * extent[axis];
            grid.shape[index] *= (last[axis] - first[axis]) as usize + 1;
        }
        grid
    }
}

/// The weights of the eight corners at a place in a cell.
#[inline]
pub(super) fn corner_weights(at: DVec3) -> [f64; 8] {
    let pairs = [at.x, at.y, at.z].map(|x| [1.0 - x, x]);
    std::array::from_fn(|c| pairs[0][c & 1] * pairs[1][c >> 1 & 1] * pairs[2][c >> 2])
}

/// What a corner adds to mean and slopes.
fn corner_coefficients(corner: usize) -> [f32; 4] {
    let slope = 0.125 / 3.0_f32.sqrt();
    let side = |axis: usize| if corner >> axis & 1 == 1 { slope } else { -slope };
    [0.125, side(0), side(1), side(2)]
}

/// The functions in which radiance and sources are expanded, at a place in a cell.
#[inline]
pub(super) fn basis(at: DVec3) -> [f64; 4] {
    let [x, y, z] = (3.0_f64.sqrt() * (2.0 * at - 1.0)).to_array();
    [1.0, x, y, z]
}
