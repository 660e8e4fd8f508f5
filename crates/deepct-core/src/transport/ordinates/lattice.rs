//! Cells of the solver, and the extinction in them.

use crate::grid::Grid;
use crate::math::{DVec3, Ray, corner_weights};
use crate::optics::Interpolation;
use crate::scene::Boundary;
use crate::traverse::walk;

/// Marks a voxel that is not active.
const NONE: u32 = u32::MAX;
/// Maximum number of cells into which a voxel is split along an axis.
pub(super) const MOST_PARTS: usize = 8;

/// Cells of the solver. Voxels of a constant medium and boxes between the voxel centres of a
/// trilinear medium are both called voxels here. Those that contain medium, or may come to contain
/// some, are active, and are split into cells where they are optically thick. Each cell of an
/// active voxel has an index, its slot.
#[derive(Debug)]
pub(super) struct Lattice {
    /// Block of voxels around all active ones.
    pub(super) grid: Grid,
    /// Lateral boundary.
    pub(super) boundary: Boundary,
    /// Number of each voxel of the block among the active ones, or [`NONE`].
    numbers: Vec<u32>,
    active: Vec<Active>,
    /// Number of the active voxel of each slot.
    owners: Vec<u32>,
    /// Whether voxels are split along x, y, z.
    splits: [bool; 3],
    /// Voxels of the medium at the corners of each active voxel, x fastest; for a constant medium,
    /// the voxel itself.
    corners: Vec<u32>,
    corners_each: usize,
}

/// An active voxel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Active {
    /// Index in the block.
    voxel: u32,
    /// Number of parts along each split axis, and slot of the first part.
    pub(super) parts: u32,
    pub(super) first: u32,
    /// Extinction (1/km) for which the voxel is prepared.
    pub(super) prepared: f32,
}

/// Part of a ray in one active voxel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Segment {
    /// Number of the voxel among the active ones.
    pub(super) number: usize,
    /// Distance from the origin of the ray to the entry point, and length (km).
    pub(super) enter: f64,
    pub(super) length: f64,
    /// Entry and exit points, from 0 to 1 along x, y, z of the voxel.
    pub(super) from: DVec3,
    pub(super) to: DVec3,
}

/// Part of a ray in one cell.
#[derive(Debug, Clone, Copy)]
pub(super) struct CellSegment {
    /// The slot of the cell.
    pub(super) slot: usize,
    /// As in [`Segment`], but along x, y, z of the cell.
    pub(super) enter: f64,
    pub(super) length: f64,
    pub(super) from: DVec3,
    pub(super) to: DVec3,
}

impl Lattice {
    /// Cells of a grid of voxels. `prepared` returns the extinction (1/km) for which a voxel is
    /// prepared, or `None` for a voxel that stays empty; `parts` returns the number of cells along
    /// an axis of a voxel prepared for an extinction. A periodic axis with a single voxel is not
    /// split.
    pub(super) fn new(
        voxels: &Grid,
        interpolation: Interpolation,
        boundary: Boundary,
        prepared: impl Fn(usize) -> Option<f32>,
        parts: impl Fn(f32) -> usize,
    ) -> Self {
        let (boxes, corners_each) = match interpolation {
            Interpolation::Constant => (*voxels, 1),
            Interpolation::Trilinear => (boxes(voxels, boundary), 8),
        };
        let of_box = |place: [usize; 3]| {
            let corners = corners(voxels, place, corners_each);
            corners.iter().filter_map(|voxel| prepared(*voxel as usize)).reduce(f32::max)
        };
        // Between open sides, nothing beyond the outermost active boxes has an effect.
        let [first, shape] = bounds(&boxes, boundary, |place| of_box(place).is_some());
        let start = DVec3::new(first[2] as f64, first[1] as f64, first[0] as f64);
        let grid = Grid { origin: boxes.origin + start * boxes.spacing, shape, ..boxes };
        let alone = |index: usize| boundary == Boundary::Periodic && voxels.shape[index] == 1;
        let mut lattice = Self {
            grid,
            boundary,
            numbers: vec![NONE; grid.len()],
            active: Vec::new(),
            owners: Vec::new(),
            splits: [!alone(2), !alone(1), true],
            corners: Vec::new(),
            corners_each,
        };
        for voxel in 0..grid.len() {
            let [k, j, i] = index(&grid, voxel);
            let place = [first[0] + k, first[1] + j, first[2] + i];
            let Some(prepared) = of_box(place) else { continue };
            let parts = parts(prepared).clamp(1, MOST_PARTS) as u32;
            let number = lattice.active.len() as u32;
            let first = lattice.owners.len() as u32;
            lattice.numbers[voxel] = number;
            lattice.active.push(Active { voxel: voxel as u32, parts, first, prepared });
            lattice.corners.extend(corners(voxels, place, corners_each));
            let cells: usize = lattice.parts_along(parts).iter().product();
            lattice.owners.resize(first as usize + cells, number);
        }
        lattice
    }

    /// Number of slots.
    pub(super) fn len(&self) -> usize {
        self.owners.len()
    }

    /// The active voxels.
    pub(super) fn active(&self) -> &[Active] {
        &self.active
    }

    /// The active voxel at an index of the block.
    #[inline(always)]
    pub(super) fn at(&self, voxel: usize) -> Option<&Active> {
        self.active.get(self.numbers[voxel] as usize)
    }

    /// The number of the active voxel of a slot.
    #[inline(always)]
    pub(super) fn owner(&self, slot: usize) -> usize {
        self.owners[slot] as usize
    }

    /// Number of cells along x, y, z of a voxel with the given number of parts.
    #[inline(always)]
    pub(super) fn parts_along(&self, parts: u32) -> [usize; 3] {
        self.splits.map(|split| if split { parts as usize } else { 1 })
    }

    /// The longest side (km) of the cells of a voxel that is split into `parts`, except along axes
    /// without any structure.
    pub(super) fn longest_side(&self, parts: u32) -> f64 {
        let split = (0..3).filter(|&axis| self.splits[axis]);
        split.map(|axis| self.grid.spacing[axis] / f64::from(parts)).fold(0.0, f64::max)
    }

    /// Number of cells along x, y, z of the voxel of a slot, and position of the slot among them.
    #[inline]
    fn place(&self, slot: usize) -> (DVec3, DVec3) {
        let active = &self.active[self.owner(slot)];
        let [px, py, pz] = self.parts_along(active.parts);
        let cell = slot - active.first as usize;
        let place = [cell % px, cell / px % py, cell / px / py].map(|n| n as f64);
        (DVec3::new(px as f64, py as f64, pz as f64), DVec3::from_array(place))
    }

    /// Volume of a cell relative to that of a voxel.
    #[inline]
    pub(super) fn share(&self, slot: usize) -> f32 {
        let cells: usize = self.parts_along(self.active[self.owner(slot)].parts).iter().product();
        1.0 / cells as f32
    }

    /// Voxels of the medium from which an active voxel takes its properties.
    #[inline]
    pub(super) fn voxels_of(&self, number: usize) -> &[u32] {
        &self.corners[number * self.corners_each..][..self.corners_each]
    }

    /// Extinction at a position in an active voxel, from 0 to 1 along each axis.
    #[inline]
    pub(super) fn value_in(&self, voxels: &[f32], number: usize, at: DVec3) -> f64 {
        match self.voxels_of(number) {
            [voxel] => f64::from(voxels[*voxel as usize]),
            corners => {
                let pairs = corners.iter().zip(corner_weights(at));
                pairs.map(|(voxel, weight)| weight * f64::from(voxels[*voxel as usize])).sum()
            }
        }
    }

    /// The transpose of [`Lattice::value_in`].
    #[inline]
    pub(super) fn spread_in(&self, voxels: &mut [f64], number: usize, at: DVec3, value: f64) {
        match self.voxels_of(number) {
            [voxel] => voxels[*voxel as usize] += value,
            corners => {
                for (voxel, weight) in corners.iter().zip(corner_weights(at)) {
                    voxels[*voxel as usize] += weight * value;
                }
            }
        }
    }

    /// Convert a position in a cell to one in its voxel, both from 0 to 1 along each axis.
    #[inline]
    fn in_voxel(&self, slot: usize, at: DVec3) -> DVec3 {
        if self.corners_each == 1 {
            return at;
        }
        let (parts, place) = self.place(slot);
        (place + at) / parts
    }

    /// Extinction at a position in a cell, from 0 to 1 along each axis.
    #[inline]
    pub(super) fn value(&self, voxels: &[f32], slot: usize, at: DVec3) -> f64 {
        self.value_in(voxels, self.owner(slot), self.in_voxel(slot, at))
    }

    /// The transpose of [`Lattice::value`].
    #[inline]
    pub(super) fn spread(&self, voxels: &mut [f64], slot: usize, at: DVec3, value: f64) {
        self.spread_in(voxels, self.owner(slot), self.in_voxel(slot, at), value);
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

    /// Convert a position in a cell, from 0 to 1 along each axis, to km.
    pub(super) fn point(&self, slot: usize, at: DVec3) -> DVec3 {
        let [k, j, i] = index(&self.grid, self.active[self.owner(slot)].voxel as usize);
        let corner = DVec3::new(i as f64, j as f64, k as f64);
        let (parts, place) = self.place(slot);
        self.grid.origin + self.grid.spacing * (corner + (place + at) / parts)
    }

    /// Active voxels that a ray crosses, in order.
    pub(super) fn segments(&self, ray: Ray) -> impl Iterator<Item = Segment> {
        let grid = self.unfolded(&ray);
        let [_, ny, nx] = self.grid.shape;
        // Most voxels of a block are not active, and most rays stay in one copy of the block.
        let folded = |index: usize, count: usize| if index < count { index } else { index % count };
        let origin = (ray.origin - grid.origin) / grid.spacing;
        let direction = ray.direction / grid.spacing;
        walk(&grid, &ray).filter_map(move |step| {
            let [k, j, i] = step.voxel;
            let number = self.numbers[(k * ny + folded(j, ny)) * nx + folded(i, nx)];
            if number == NONE {
                return None;
            }
            let corner = DVec3::new(i as f64, j as f64, k as f64);
            let local = |distance: f64| origin + distance * direction - corner;
            Some(Segment {
                number: number as usize,
                enter: step.enter,
                length: step.exit - step.enter,
                from: local(step.enter),
                to: local(step.exit),
            })
        })
    }

    /// Pass the cells that a segment crosses to `visit`, in order.
    #[inline]
    pub(super) fn cells(&self, segment: &Segment, mut visit: impl FnMut(CellSegment)) {
        let Segment { number, enter, length, from, to } = *segment;
        let Active { parts, first, .. } = self.active[number];
        if parts == 1 {
            visit(CellSegment { slot: first as usize, enter, length, from, to });
            return;
        }
        let along = self.parts_along(parts);
        let parts = DVec3::new(along[0] as f64, along[1] as f64, along[2] as f64);
        let (from, reach) = (from * parts, (to - from) * parts);
        // Fractions of the segment at which the ray crosses from one cell to the next.
        let mut crossings = [1.0; 3 * MOST_PARTS];
        let mut count = 0;
        for axis in 0..3 {
            for plane in 1..along[axis] {
                let share = (plane as f64 - from[axis]) / reach[axis];
                if share > 0.0 && share < 1.0 {
                    crossings[count] = share;
                    count += 1;
                }
            }
        }
        crossings[..count].sort_unstable_by(f64::total_cmp);
        let mut before = 0.0;
        for &share in &crossings[..=count] {
            let middle = from + 0.5 * (before + share) * reach;
            let last = parts - 1.0;
            let place = middle.floor().clamp(DVec3::ZERO, last);
            let [i, j, k] = place.to_array().map(|n| n as usize);
            if share > before {
                visit(CellSegment {
                    slot: first as usize + (k * along[1] + j) * along[0] + i,
                    enter: enter + before * length,
                    length: (share - before) * length,
                    from: from + before * reach - place,
                    to: from + share * reach - place,
                });
            }
            before = share;
        }
    }

    /// The grid; between periodic sides, extended by as many copies of it as a ray crosses.
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

/// First box and number of boxes along z, y, x of the smallest block that contains all active
/// boxes; between periodic sides, it contains whole levels. One box if none is active.
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

/// Voxels at the first `count` corners of a box; indices beyond the last voxel wrap around to the
/// first.
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

/// Position of a corner, from 0 to 1 along each axis.
fn place_of(corner: usize) -> DVec3 {
    DVec3::new((corner & 1) as f64, (corner >> 1 & 1) as f64, (corner >> 2) as f64)
}

/// Contribution of a corner to the mean and the slopes.
fn corner_coefficients(corner: usize) -> [f32; 4] {
    let slope = 0.125 / 3.0_f32.sqrt();
    let side = |axis: usize| if corner >> axis & 1 == 1 { slope } else { -slope };
    [0.125, side(0), side(1), side(2)]
}

/// Basis functions of radiance and sources at a position in a cell.
#[inline]
pub(super) fn basis(at: DVec3) -> [f64; 4] {
    let [x, y, z] = (3.0_f64.sqrt() * (2.0 * at - 1.0)).to_array();
    [1.0, x, y, z]
}
