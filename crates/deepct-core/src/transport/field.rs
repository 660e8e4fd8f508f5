//! Extinction made ready for rays: cells, and how far a ray may jump through empty air.
//!
//! Constant voxels are the cells of a constant medium; the boxes between neighbouring
//! voxel centres are the cells of a trilinear one. Along a ray a trilinear field is a
//! cubic in each cell, so the Gauss-Legendre rule with two points integrates it
//! without error: optical depths are exact in both.
//!
//! A free path ends where the optical depth reaches a given value, found by inversion
//! in the cell where it happens: delta tracking (Woodcock et al. 1965) in the limit
//! where the local majorant is the extinction itself and no collision is null.

use crate::grid::Grid;
use crate::math::DVec3;
use crate::optics::{Interpolation, Medium};
use crate::scene::Boundary;

/// Mark of the cells around the field.
const OUTSIDE: f32 = 0.0;
/// Number of periods after which a ray that stays between top and bottom is given up.
const MOST_PERIODS: u32 = 100_000;

/// A medium in its own coordinates: the unit of length along each axis is a cell, the
/// origin is the corner of the first cell. Distances along rays stay in km.
///
/// Only the part that holds medium is kept, with a layer of [`OUTSIDE`] around it.
#[derive(Debug)]
pub(super) struct Field {
    lower: DVec3,
    inverse_cell: DVec3,
    /// The corner of the first cell and the number of voxels of the grid, in voxels
    /// along x, y, z.
    corner: DVec3,
    voxels: [i32; 3],
    /// Number of cells along x, y, z.
    cells: [i32; 3],
    /// Steps in the arrays to the next cell along x, y, z.
    stride: [i32; 3],
    /// By cell: the extinction (the largest one of a trilinear cell); in empty air
    /// minus the distance in cells to the nearest one that is not empty.
    majorant: Vec<f32>,
    /// Extinction at the lower corner of each cell, for trilinear media only.
    nodes: Vec<f32>,
    periodic: bool,
}

/// A direction of travel, with what a walk through the cells needs of it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Heading {
    /// Unit vector.
    pub(super) direction: DVec3,
    /// The same in cells per km.
    pub(super) local: DVec3,
    inverse: DVec3,
    delta: DVec3,
    stride: [i32; 3],
}

/// The part of a ray in one cell.
#[derive(Debug, Clone, Copy)]
struct Segment {
    cell: usize,
    majorant: f64,
    /// The ray's origin, moved by the periods passed.
    origin: DVec3,
    enter: f64,
    exit: f64,
}

impl Field {
    /// The field of a medium between the given sides.
    pub(super) fn new(medium: &Medium, boundary: Boundary) -> Self {
        let periodic = boundary == Boundary::Periodic;
        let trilinear = medium.interpolation == Interpolation::Trilinear;
        let grid = &medium.extinction.grid;
        let all = lattice(grid, trilinear, periodic);
        let values = medium.extinction.values.as_standard_layout();
        let values = values.as_slice().expect("standard layout");
        let [nz, ny, nx] = grid.shape;
        // Nodes beyond the last one are the first ones again; only a periodic field
        // asks for them.
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

    /// Write into each empty cell minus its distance (the larger of the three, in
    /// cells) to the nearest one that is not empty: two sweeps over the neighbours.
    fn mark_empty_air(&mut self) {
        let far = 1_000_000;
        let distance = |majorant: f32| if majorant > 0.0 { 0 } else { far };
        let mut distances: Vec<i32> = self.majorant.iter().map(|m| distance(*m)).collect();
        let [nx, ny, nz] = self.cells.map(|n| n as usize);
        let [_, sy, sz] = self.stride.map(|n| n as usize);
        if self.periodic {
            // A jump must end at the sides, where the ray comes in again.
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

    /// A point (km) in the field's coordinates.
    pub(super) fn local(&self, point: DVec3) -> DVec3 {
        (point - self.lower) * self.inverse_cell
    }

    /// A point in the field's coordinates, in km.
    pub(super) fn point(&self, local: DVec3) -> DVec3 {
        self.lower + local / self.inverse_cell
    }

    /// The grid's voxel `[z, y, x]` that holds a point of the field's coordinates.
    #[inline]
    pub(super) fn voxel(&self, local: DVec3) -> [usize; 3] {
        let index = (local + self.corner).floor().as_ivec3().to_array();
        let inside = |axis: usize| {
            let count = self.voxels[axis];
            let index = if self.periodic && axis < 2 {
                index[axis].rem_euclid(count)
            } else {
                index[axis].clamp(0, count - 1)
            };
            index as usize
        };
        [inside(2), inside(1), inside(0)]
    }

    /// A direction (unit vector) made ready.
    #[inline]
    pub(super) fn heading(&self, direction: DVec3) -> Heading {
        let local = direction * self.inverse_cell;
        let inverse = local.recip();
        let signed = |axis: usize| {
            if local[axis] > 0.0 { self.stride[axis] } else { -self.stride[axis] }
        };
        let stride = [signed(0), signed(1), signed(2)];
        Heading { direction, local, inverse, delta: inverse.abs(), stride }
    }

    /// Optical depth from a point to the end of the medium; infinity as soon as it is
    /// beyond `limit`.
    #[inline]
    pub(super) fn optical_depth(&self, origin: DVec3, heading: &Heading, limit: f64) -> f64 {
        let mut depth = 0.0;
        let stopped = if self.nodes.is_empty() {
            self.walk(origin, heading, |segment| {
                depth += segment.majorant * (segment.exit - segment.enter);
                depth > limit
            })
        } else {
            self.walk(origin, heading, |segment| {
                let ray = CellRay::new(self, heading, segment);
                depth += ray.depth(segment.exit - segment.enter);
                depth > limit
            })
        };
        if stopped { f64::INFINITY } else { depth }
    }

    /// The distance (km) from a point at which the optical depth reaches `depth`;
    /// `None` when the ray leaves the medium before.
    #[inline]
    pub(super) fn free_path(&self, origin: DVec3, heading: &Heading, depth: f64) -> Option<f64> {
        let mut left = depth;
        let mut distance = 0.0;
        let stopped = if self.nodes.is_empty() {
            self.walk(origin, heading, |segment| {
                let here = segment.majorant * (segment.exit - segment.enter);
                let inside = here > left;
                if inside {
                    distance = segment.enter + left / segment.majorant;
                } else {
                    left -= here;
                }
                inside
            })
        } else {
            self.walk(origin, heading, |segment| {
                let ray = CellRay::new(self, heading, segment);
                let length = segment.exit - segment.enter;
                let here = ray.depth(length);
                let inside = here > left;
                if inside {
                    distance = segment.enter + ray.invert(left, length, here);
                } else {
                    left -= here;
                }
                inside
            })
        };
        stopped.then_some(distance)
    }

    /// Pass the cells that are not empty to `visit`, in order, until it says stop or
    /// the ray leaves; whether it was stopped.
    ///
    /// Amanatides and Woo (1987) with jumps: a cell in empty air knows a cube around
    /// itself that is empty too, and the ray goes to the end of that cube at once.
    #[inline(always)]
    fn walk(
        &self,
        mut origin: DVec3,
        heading: &Heading,
        mut visit: impl FnMut(Segment) -> bool,
    ) -> bool {
        let Some(mut at) = self.enter(&mut origin, heading) else {
            return false;
        };
        let start = (origin + at * heading.local).floor().as_ivec3().to_array();
        let mut index = [0; 3];
        for axis in 0..3 {
            // On a face, or off by a rounding error: the cell that the ray goes into.
            index[axis] = start[axis].clamp(0, self.cells[axis] - 1);
        }
        let mut cell = self.cell(index);
        let mut next = faces(origin, heading, index);
        let mut axis;
        let mut periods = 0;
        loop {
            let majorant = self.majorant[cell as usize];
            if majorant > -1.5 {
                axis = least(next);
                let exit = next[axis];
                // A corner is passed through cells of no thickness: leave them out.
                if majorant > 0.0 && exit > at {
                    let majorant = f64::from(majorant);
                    let segment =
                        Segment { cell: cell as usize, majorant, origin, enter: at, exit };
                    if visit(segment) {
                        return true;
                    }
                }
                at = at.max(exit);
                cell += heading.stride[axis];
                next[axis] += heading.delta[axis];
            } else {
                let Some(landing) = self.jump(origin, heading, cell, -majorant as i32) else {
                    return false;
                };
                axis = landing.axis;
                at = at.max(landing.at);
                cell = self.cell(landing.index);
                next = faces(origin, heading, landing.index);
            }
            if self.majorant[cell as usize] == OUTSIDE {
                if !self.periodic || axis == 2 || periods == MOST_PERIODS {
                    return false;
                }
                // Leave through one side, come in through the other.
                periods += 1;
                let forward = heading.local[axis] > 0.0;
                let period = if forward { self.cells[axis] } else { -self.cells[axis] };
                origin[axis] -= f64::from(period);
                cell -= period * self.stride[axis];
            }
        }
    }

    /// The distance at which a ray comes into the field, which is zero inside; the
    /// origin moves into the first period. `None` when it misses.
    #[inline]
    fn enter(&self, origin: &mut DVec3, heading: &Heading) -> Option<f64> {
        let sides = if self.periodic { 2..3 } else { 0..3 };
        let (mut enter, mut exit) = (0.0_f64, f64::INFINITY);
        for axis in sides {
            let size = f64::from(self.cells[axis]);
            if heading.local[axis] == 0.0 {
                if origin[axis] < 0.0 || origin[axis] >= size {
                    return None;
                }
                continue;
            }
            let a = -origin[axis] * heading.inverse[axis];
            let b = (size - origin[axis]) * heading.inverse[axis];
            enter = enter.max(a.min(b));
            exit = exit.min(a.max(b));
        }
        if enter >= exit {
            return None;
        }
        if self.periodic {
            for axis in 0..2 {
                let size = f64::from(self.cells[axis]);
                let position = origin[axis] + enter * heading.local[axis];
                origin[axis] -= (position / size).floor() * size;
            }
        }
        Some(enter)
    }

    #[inline]
    fn cell(&self, index: [i32; 3]) -> i32 {
        (index[0] + 1) + (index[1] + 1) * self.stride[1] + (index[2] + 1) * self.stride[2]
    }

    /// Where a ray leaves the empty cube that reaches `reach - 1` cells to all sides
    /// of `cell`; `None` when that is outside of an open field.
    fn jump(&self, origin: DVec3, heading: &Heading, cell: i32, reach: i32) -> Option<Landing> {
        let (layer, rest) = (cell / self.stride[2], cell % self.stride[2]);
        let center = [rest % self.stride[1] - 1, rest / self.stride[1] - 1, layer - 1];
        let mut exits = DVec3::INFINITY;
        for axis in 0..3 {
            if heading.local[axis] != 0.0 {
                let forward = heading.local[axis] > 0.0;
                let face = center[axis] + if forward { reach } else { 1 - reach };
                exits[axis] = (f64::from(face) - origin[axis]) * heading.inverse[axis];
            }
        }
        let axis = least(exits);
        let at = exits[axis];
        let position = origin + at * heading.local;
        let mut index = [0; 3];
        for other in 0..3 {
            let inside = (position[other].floor() as i32)
                .clamp(center[other] - (reach - 1), center[other] + (reach - 1));
            index[other] = inside.clamp(0, self.cells[other] - 1);
            // Outside in an axis that is not the last one: a rounding error at an edge.
            if inside != index[other] && other != axis && !(self.periodic && other < 2) {
                return None;
            }
        }
        index[axis] = center[axis] + if heading.local[axis] > 0.0 { reach } else { -reach };
        let outside = !(0..self.cells[axis]).contains(&index[axis]);
        (!outside || (self.periodic && axis < 2)).then_some(Landing { at, axis, index })
    }
}

/// Where a jump ends.
struct Landing {
    at: f64,
    axis: usize,
    index: [i32; 3],
}

/// A ray in one cell of a trilinear field, from where it enters.
struct CellRay {
    corners: [f64; 8],
    start: DVec3,
    direction: DVec3,
}

impl CellRay {
    #[inline]
    fn new(field: &Field, heading: &Heading, segment: Segment) -> Self {
        let [sx, sy, sz] = field.stride.map(|n| n as usize);
        let corner = |c: usize| {
            let index = segment.cell + (c & 1) * sx + (c >> 1 & 1) * sy + (c >> 2) * sz;
            f64::from(field.nodes[index])
        };
        let corners = std::array::from_fn(corner);
        let middle = segment.origin + 0.5 * (segment.enter + segment.exit) * heading.local;
        let start = segment.origin + segment.enter * heading.local - middle.floor();
        Self { corners, start, direction: heading.local }
    }

    /// Extinction (1/km) at a distance (km).
    #[inline]
    fn extinction(&self, distance: f64) -> f64 {
        let p = self.start + distance * self.direction;
        let c = &self.corners;
        let mix = |a: f64, b: f64, t: f64| a + t * (b - a);
        let low = mix(mix(c[0], c[1], p.x), mix(c[2], c[3], p.x), p.y);
        let high = mix(mix(c[4], c[5], p.x), mix(c[6], c[7], p.x), p.y);
        mix(low, high, p.z).max(0.0)
    }

    /// Optical depth of the first `length` km: Gauss-Legendre with two points.
    #[inline]
    fn depth(&self, length: f64) -> f64 {
        /// (1 - 1 / sqrt(3)) / 2
        const NODE: f64 = 0.211_324_865_405_187_1;
        0.5 * length * (self.extinction(NODE * length) + self.extinction((1.0 - NODE) * length))
    }

    /// The distance at which the optical depth is `target`, of `total` over `length`:
    /// Newton's method, kept inside the bracket by halving it.
    fn invert(&self, target: f64, length: f64, total: f64) -> f64 {
        let (mut low, mut high) = (0.0, length);
        let mut distance = length * (target / total);
        for _ in 0..50 {
            let excess = self.depth(distance) - target;
            if excess.abs() <= 1e-12 * total {
                break;
            }
            if excess > 0.0 {
                high = distance;
            } else {
                low = distance;
            }
            distance -= excess / self.extinction(distance);
            if !(distance > low && distance < high) {
                distance = 0.5 * (low + high);
            }
        }
        distance
    }
}

/// Number of cells along x, y, z of a grid.
fn lattice(grid: &Grid, trilinear: bool, periodic: bool) -> [usize; 3] {
    let [nz, ny, nx] = grid.shape;
    match (trilinear, periodic) {
        (false, _) => [nx, ny, nz],
        (true, true) => [nx, ny, nz - 1],
        (true, false) => [nx - 1, ny - 1, nz - 1],
    }
}

/// The first cell and the number of cells of the smallest box that holds all medium;
/// a periodic field keeps its width. A field without medium keeps one empty cell.
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

/// All `[i, j, k]` below the given ones, x fastest.
fn indices([nx, ny, nz]: [usize; 3]) -> impl Iterator<Item = [usize; 3]> {
    (0..nz).flat_map(move |k| (0..ny).flat_map(move |j| (0..nx).map(move |i| [i, j, k])))
}

/// Distances at which a ray leaves a cell through its faces, by axis.
#[inline]
fn faces(origin: DVec3, heading: &Heading, index: [i32; 3]) -> DVec3 {
    let face = |axis: usize| {
        if heading.local[axis] == 0.0 {
            return f64::INFINITY;
        }
        let face = index[axis] + i32::from(heading.local[axis] > 0.0);
        (f64::from(face) - origin[axis]) * heading.inverse[axis]
    };
    DVec3::new(face(0), face(1), face(2))
}

/// The axis of the least component.
#[inline]
fn least(v: DVec3) -> usize {
    if v.x < v.y {
        if v.x < v.z { 0 } else { 2 }
    } else if v.y < v.z {
        1
    } else {
        2
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Volume;
    use crate::math::{Ray, towards};
    use crate::optics::PhaseFunction;
    use crate::traverse::walk;
    use ndarray::Array3;

    /// Two lumps in much empty air.
    fn sparse() -> Medium {
        let spacing = DVec3::new(0.05, 0.04, 0.03);
        let grid = Grid::new(DVec3::new(-0.2, 0.3, 0.5), spacing, [17, 15, 19]).unwrap();
        let values = Array3::from_shape_fn(grid.shape, |(k, j, i)| {
            let lump = |z: i32, y: i32, x: i32| {
                (k as i32 - z).pow(2) + (j as i32 - y).pow(2) + (i as i32 - x).pow(2) < 6
            };
            let inside = lump(3, 4, 4) || lump(12, 9, 15);
            if inside { 1.0 + ((i * 7 + j * 3 + k) % 5) as f32 } else { 0.0 }
        });
        let extinction = Volume::new(grid, values).unwrap();
        Medium::new(extinction, 1.0, PhaseFunction::Isotropic).unwrap()
    }

    /// Rays through all of the grid, from outside and from inside.
    fn rays(grid: &Grid) -> Vec<Ray> {
        let ray = |number: u32| {
            let angle = f64::from(number);
            let part = DVec3::new(0.618, 0.317, 0.733) * angle;
            let aim = grid.lower() + grid.extent() * (part - part.floor());
            let direction = towards(0.0041 * angle, 2.4 * angle);
            let back = if number.is_multiple_of(3) { 0.0 } else { 2.0 };
            Ray { origin: aim - back * direction, direction }
        };
        let axes = [DVec3::X, -DVec3::X, DVec3::Y, -DVec3::Y, DVec3::Z, -DVec3::Z];
        let along =
            axes.map(|axis| Ray { origin: grid.voxel_center([3, 4, 4]) - axis, direction: axis });
        (0..750).map(ray).chain(along).collect()
    }

    fn depth(field: &Field, ray: &Ray) -> f64 {
        field.optical_depth(field.local(ray.origin), &field.heading(ray.direction), f64::INFINITY)
    }

    /// Trilinear extinction at a point, by the definition.
    fn trilinear(medium: &Medium, point: DVec3, periodic: bool) -> f64 {
        let grid = &medium.extinction.grid;
        let [nz, ny, nx] = grid.shape.map(|n| n as i64);
        let place = (point - grid.lower()) / grid.spacing - 0.5;
        let base = place.floor();
        let mut sum = 0.0;
        for corner in 0..8 {
            let offset = DVec3::new(
                f64::from(corner & 1),
                f64::from(corner >> 1 & 1),
                f64::from(corner >> 2),
            );
            let node = base + offset;
            let [mut i, mut j, k] = [node.x as i64, node.y as i64, node.z as i64];
            let weight = (DVec3::ONE - (place - node).abs()).max(DVec3::ZERO);
            if periodic {
                (i, j) = (i.rem_euclid(nx), j.rem_euclid(ny));
            }
            // Outside the outermost centres there is nothing, not a slope to nothing.
            let low = if periodic { place.z } else { place.min_element() };
            let high = DVec3::new(nx as f64, ny as f64, nz as f64) - 1.0 - place;
            let high = if periodic { high.z } else { high.min_element() };
            let known = (0..nx).contains(&i) && (0..ny).contains(&j) && (0..nz).contains(&k);
            if known && low >= 0.0 && high >= 0.0 {
                let value = medium.extinction.values[[k as usize, j as usize, i as usize]];
                sum += weight.x * weight.y * weight.z * f64::from(value);
            }
        }
        sum
    }

    #[test]
    fn optical_depth_of_voxels_is_the_sum_over_a_plain_walk() {
        let medium = sparse();
        let grid = medium.extinction.grid;
        let field = Field::new(&medium, Boundary::Open);
        let mut met = 0;
        for ray in rays(&grid) {
            let expected: f64 = walk(&grid, &ray)
                .map(|step| {
                    (step.exit - step.enter) * f64::from(medium.extinction.values[step.voxel])
                })
                .sum();
            let found = depth(&field, &ray);
            assert!((found - expected).abs() < 1e-9, "{ray:?}: {found} {expected}");
            met += u32::from(expected > 0.0);
        }
        assert!(met > 50, "{met}");
    }

    #[test]
    fn optical_depth_between_centres_is_the_integral() {
        for boundary in [Boundary::Open, Boundary::Periodic] {
            let medium = sparse().with_interpolation(Interpolation::Trilinear);
            let grid = medium.extinction.grid;
            let field = Field::new(&medium, boundary);
            for ray in rays(&grid).iter().step_by(11).filter(|ray| ray.direction.z.abs() > 0.3) {
                let steps = 8_000;
                let width = 6.0 / f64::from(steps);
                let expected: f64 = (0..steps)
                    .map(|step| ray.at(width * (f64::from(step) + 0.5)))
                    .map(|point| width * trilinear(&medium, point, boundary == Boundary::Periodic))
                    .sum();
                let found = depth(&field, ray);
                assert!((found - expected).abs() < 1e-4, "{ray:?}: {found} {expected}");
            }
        }
    }

    #[test]
    fn a_periodic_field_is_a_field_of_copies() {
        let medium = sparse();
        let grid = medium.extinction.grid;
        let field = Field::new(&medium, Boundary::Periodic);
        let [nz, ny, nx] = grid.shape;
        let copies = 9;
        let shift = grid.extent() * DVec3::new(1.0, 1.0, 0.0) * (copies / 2) as f64;
        let wide = Grid::new(grid.origin - shift, grid.spacing, [nz, copies * ny, copies * nx]);
        let values = Array3::from_shape_fn(wide.as_ref().unwrap().shape, |(k, j, i)| {
            medium.extinction.values[[k, j % ny, i % nx]]
        });
        let wide = Medium { extinction: Volume::new(wide.unwrap(), values).unwrap(), ..medium };
        let open = Field::new(&wide, Boundary::Open);
        for ray in rays(&grid).iter().filter(|ray| ray.direction.z.abs() > 0.3) {
            let (found, expected) = (depth(&field, ray), depth(&open, ray));
            assert!((found - expected).abs() < 1e-9, "{ray:?}: {found} {expected}");
        }
    }

    #[test]
    fn a_free_path_ends_where_the_optical_depth_is_reached() {
        for interpolation in [Interpolation::Constant, Interpolation::Trilinear] {
            for boundary in [Boundary::Open, Boundary::Periodic] {
                let medium = sparse().with_interpolation(interpolation);
                let field = Field::new(&medium, boundary);
                for ray in rays(&medium.extinction.grid) {
                    let total = depth(&field, &ray);
                    let heading = field.heading(ray.direction);
                    let origin = field.local(ray.origin);
                    if ray.direction.z.abs() < 0.1 || total == 0.0 {
                        continue;
                    }
                    let target = 0.37 * total;
                    let distance = field.free_path(origin, &heading, target).unwrap();
                    let rest = Ray { origin: ray.at(distance), ..ray };
                    assert!((total - depth(&field, &rest) - target).abs() < 1e-9, "{ray:?}");
                    assert!(field.free_path(origin, &heading, 1.001 * total).is_none());
                }
            }
        }
    }

    #[test]
    fn a_point_knows_its_voxel() {
        for interpolation in [Interpolation::Constant, Interpolation::Trilinear] {
            for boundary in [Boundary::Open, Boundary::Periodic] {
                let medium = sparse().with_interpolation(interpolation);
                let grid = medium.extinction.grid;
                let field = Field::new(&medium, boundary);
                for voxel in [[0, 0, 0], [3, 4, 5]] {
                    let point = grid.voxel_center(voxel) + 0.4 * grid.spacing;
                    assert_eq!(field.voxel(field.local(point)), voxel);
                    let next = point + DVec3::new(grid.extent().x, -grid.extent().y, 0.0);
                    if boundary == Boundary::Periodic {
                        assert_eq!(field.voxel(field.local(next)), voxel);
                    }
                }
            }
        }
    }

    #[test]
    fn an_empty_field_has_no_depth() {
        let grid = sparse().extinction.grid;
        let empty =
            Medium::new(Volume::constant(grid, 0.0), 1.0, PhaseFunction::Isotropic).unwrap();
        for boundary in [Boundary::Open, Boundary::Periodic] {
            let field = Field::new(&empty, boundary);
            let ray = Ray { origin: grid.center(), direction: towards(1.0, 1.0) };
            assert_eq!(depth(&field, &ray), 0.0);
        }
    }
}
