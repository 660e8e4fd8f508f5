//! The cells of the solver, and the extinction in them.

use crate::grid::Grid;
use crate::math::{DVec3, Ray};
use crate::optics::Interpolation;
use crate::scene::Boundary;
use crate::traverse::walk;

/// Mark of a cell that is not active.
const NONE: u32 = u32::MAX;

/// The cells: voxels of a constant medium, boxes between voxel centres of a trilinear one,
/// split where they are too thick. Those that hold medium, or may come to hold some, are
/// active and have a slot each.
#[derive(Debug)]
pub(super) struct Lattice {
    /// Where the cells are: a block around all that is active.
    pub(super) grid: Grid,
    /// The sides.
    pub(super) boundary: Boundary,
    /// The cells of a voxel or box along x, y, z.
    split: DVec3,
    /// Slot of each cell, or [`NONE`].
    slots: Vec<u32>,
    active: Vec<Active>,
    /// The voxels at the corners of the box of each slot, x fastest; the one voxel that it
    /// is a part of where the medium is constant.
    corners: Vec<u32>,
    corners_each: usize,
}

/// An active cell.
#[derive(Debug, Clone, Copy)]
struct Active {
    cell: u32,
    /// Its lower corner in its voxel or box, from 0 to 1 along each axis.
    offset: DVec3,
}

/// A part of a ray, in one active cell.
#[derive(Debug, Clone, Copy)]
pub(super) struct Segment {
    /// The slot of the cell.
    pub(super) slot: usize,
    /// Distance from the ray's origin at which it enters, and length (km).
    pub(super) enter: f64,
    pub(super) length: f64,
    /// Where it enters and leaves, from 0 to 1 along x, y, z of the cell.
    pub(super) from: DVec3,
    pub(super) to: DVec3,
}

impl Lattice {
    /// The cells of a grid of voxels, split along x, y, z; `active` tells whether a voxel
    /// matters.
    pub(super) fn new(
        voxels: &Grid,
        interpolation: Interpolation,
        boundary: Boundary,
        split: [usize; 3],
        active: impl Fn(usize) -> bool,
    ) -> Self {
        let (boxes, corners_each) = match interpolation {
            Interpolation::Constant => (*voxels, 1),
            Interpolation::Trilinear => (boxes(voxels, boundary), 8),
        };
        let holds = |place: [usize; 3]| {
            corners(voxels, place, corners_each).iter().any(|voxel| active(*voxel as usize))
        };
        // Between open sides nothing happens beyond the last active box.
        let [first, shape] = bounds(&boxes, boundary, holds);
        let parts = DVec3::from_array(split.map(|n| n as f64));
        let [sx, sy, sz] = split;
        let start = DVec3::new(first[2] as f64, first[1] as f64, first[0] as f64);
        let grid = Grid {
            origin: boxes.origin + start * boxes.spacing,
            spacing: boxes.spacing / parts,
            shape: [shape[0] * sz, shape[1] * sy, shape[2] * sx],
        };
        let mut lattice = Self {
            grid,
            boundary,
            split: parts,
            slots: vec![NONE; grid.len()],
            active: Vec::new(),
            corners: Vec::new(),
            corners_each,
        };
        for (cell, slot) in lattice.slots.iter_mut().enumerate() {
            let [k, j, i] = index(&grid, cell);
            let place = [first[0] + k / sz, first[1] + j / sy, first[2] + i / sx];
            if holds(place) {
                *slot = lattice.active.len() as u32;
                let part = DVec3::new((i % sx) as f64, (j % sy) as f64, (k % sz) as f64);
                lattice.active.push(Active { cell: cell as u32, offset: part / parts });
                lattice.corners.extend(corners(voxels, place, corners_each));
            }
        }
        lattice
    }

    /// Number of active cells.
    pub(super) fn len(&self) -> usize {
        self.active.len()
    }

    /// Size of the voxels or boxes that cells are parts of (km).
    pub(super) fn voxel_spacing(&self) -> DVec3 {
        self.grid.spacing * self.split
    }

    /// The slot of a cell, if it is active.
    #[inline(always)]
    pub(super) fn slot(&self, cell: usize) -> Option<usize> {
        let slot = self.slots[cell];
        (slot != NONE).then_some(slot as usize)
    }

    /// The voxels that a slot takes its properties from.
    #[inline]
    pub(super) fn voxels_of(&self, slot: usize) -> &[u32] {
        &self.corners[slot * self.corners_each..][..self.corners_each]
    }

    /// The extinction at a place in a cell, from 0 to 1 along each axis.
    #[inline]
    pub(super) fn value(&self, voxels: &[f32], slot: usize, at: DVec3) -> f64 {
        match self.voxels_of(slot) {
            [voxel] => f64::from(voxels[*voxel as usize]),
            corners => {
                let weights = corner_weights(self.active[slot].offset + at / self.split);
                let pairs = corners.iter().zip(weights);
                pairs.map(|(voxel, weight)| weight * f64::from(voxels[*voxel as usize])).sum()
            }
        }
    }

    /// The transpose of [`Lattice::value`].
    #[inline]
    pub(super) fn spread(&self, voxels: &mut [f64], slot: usize, at: DVec3, value: f64) {
        match self.voxels_of(slot) {
            [voxel] => voxels[*voxel as usize] += value,
            corners => {
                let weights = corner_weights(self.active[slot].offset + at / self.split);
                for (voxel, weight) in corners.iter().zip(weights) {
                    voxels[*voxel as usize] += weight * value;
                }
            }
        }
    }

    /// Mean and slopes of the extinction of a cell.
    pub(super) fn coefficients(&self, voxels: &[f32], slot: usize) -> [f32; 4] {
        let mut coefficients = [0.0; 4];
        for corner in 0..8 {
            let value = self.value(voxels, slot, place_of(corner)) as f32;
            for (sum, weight) in coefficients.iter_mut().zip(corner_coefficients(corner)) {
                *sum += weight * value;
            }
        }
        coefficients
    }

    /// The transpose of [`Lattice::coefficients`].
    pub(super) fn spread_coefficients(&self, voxels: &mut [f64], slot: usize, values: [f32; 4]) {
        for corner in 0..8 {
            let weights = corner_coefficients(corner);
            let value: f32 = values.iter().zip(weights).map(|(value, weight)| value * weight).sum();
            self.spread(voxels, slot, place_of(corner), f64::from(value));
        }
    }

    /// A place in a cell, from 0 to 1 along each axis, in km.
    pub(super) fn point(&self, slot: usize, at: DVec3) -> DVec3 {
        let [k, j, i] = index(&self.grid, self.active[slot].cell as usize);
        let corner = DVec3::new(i as f64, j as f64, k as f64);
        self.grid.origin + self.grid.spacing * (corner + at)
    }

    /// The active cells that a ray passes, in order.
    pub(super) fn segments(&self, ray: Ray) -> impl Iterator<Item = Segment> {
        let grid = self.unfolded(&ray);
        let [_, ny, nx] = self.grid.shape;
        // Most cells of a block are not active, and most rays stay in one copy of it.
        let folded = |index: usize, count: usize| if index < count { index } else { index % count };
        let origin = (ray.origin - grid.origin) / grid.spacing;
        let direction = ray.direction / grid.spacing;
        walk(&grid, &ray).filter_map(move |step| {
            let [k, j, i] = step.voxel;
            let slot = self.slot((k * ny + folded(j, ny)) * nx + folded(i, nx))?;
            let corner = DVec3::new(i as f64, j as f64, k as f64);
            let local = |distance: f64| origin + distance * direction - corner;
            Some(Segment {
                slot,
                enter: step.enter,
                length: step.exit - step.enter,
                from: local(step.enter),
                to: local(step.exit),
            })
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

/// The boxes between neighbouring voxel centres.
fn boxes(voxels: &Grid, boundary: Boundary) -> Grid {
    let [nz, ny, nx] = voxels.shape;
    let shape = match boundary {
        Boundary::Open => [nz - 1, ny - 1, nx - 1],
        Boundary::Periodic => [nz - 1, ny, nx],
    };
    Grid { origin: voxels.origin + 0.5 * voxels.spacing, shape, ..*voxels }
}

/// The first box and the number of boxes along z, y, x of the smallest block that holds all
/// active ones; between periodic sides all of a level. One box where none is active.
fn bounds(boxes: &Grid, boundary: Boundary, holds: impl Fn([usize; 3]) -> bool) -> [[usize; 3]; 2] {
    let mut ends: Option<[[usize; 3]; 2]> = None;
    for place in (0..boxes.len()).map(|number| index(boxes, number)) {
        if holds(place) {
            let [first, last] = ends.unwrap_or([place; 2]);
            ends = Some([
                std::array::from_fn(|axis| first[axis].min(place[axis])),
                std::array::from_fn(|axis| last[axis].max(place[axis])),
            ]);
        }
    }
    let [mut first, last] = ends.unwrap_or_default();
    let mut shape = std::array::from_fn(|axis| last[axis] + 1 - first[axis]);
    if boundary == Boundary::Periodic {
        (first[1], first[2]) = (0, 0);
        (shape[1], shape[2]) = (boxes.shape[1], boxes.shape[2]);
    }
    [first, shape]
}

/// The voxels at the first `count` corners of a box; those beyond the last are the first
/// ones again.
fn corners(voxels: &Grid, [k, j, i]: [usize; 3], count: usize) -> Vec<u32> {
    let [_, ny, nx] = voxels.shape;
    let corner = |n: usize| {
        let (dx, dy, dz) = (n & 1, n >> 1 & 1, n >> 2);
        (((k + dz) * ny + (j + dy) % ny) * nx + (i + dx) % nx) as u32
    };
    (0..count).map(corner).collect()
}

/// The index `[z, y, x]` of a cell.
pub(super) fn index(grid: &Grid, cell: usize) -> [usize; 3] {
    let [_, ny, nx] = grid.shape;
    [cell / nx / ny, cell / nx % ny, cell % nx]
}

/// Where a corner is, from 0 to 1 along each axis.
fn place_of(corner: usize) -> DVec3 {
    DVec3::new((corner & 1) as f64, (corner >> 1 & 1) as f64, (corner >> 2) as f64)
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
