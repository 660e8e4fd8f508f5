//! Traversal of the cells of a field by a ray.

use super::{Field, OUTSIDE, floor};
use crate::math::DVec3;

/// Number of periods after which a ray that stays between top and bottom is abandoned.
const MOST_PERIODS: u32 = 100_000;

/// A direction of travel, with the quantities that a traversal of the cells requires.
#[derive(Debug, Clone, Copy)]
pub(in crate::transport) struct Heading {
    /// Unit vector.
    pub(in crate::transport) direction: DVec3,
    /// The unit vector in cells per km.
    pub(in crate::transport) local: DVec3,
    inverse: DVec3,
    delta: DVec3,
    stride: [i32; 3],
}

/// The part of a ray in one cell.
#[derive(Debug, Clone, Copy)]
pub(super) struct Segment {
    pub(super) cell: usize,
    pub(super) majorant: f64,
    /// Origin of the ray, shifted by the periods crossed.
    pub(super) origin: DVec3,
    pub(super) enter: f64,
    pub(super) exit: f64,
}

/// End point of a jump.
struct Landing {
    at: f64,
    axis: usize,
    index: [i32; 3],
}

impl Field {
    /// Prepare a direction (unit vector) for traversal.
    #[inline]
    pub(in crate::transport) fn heading(&self, direction: DVec3) -> Heading {
        let local = direction * self.inverse_cell;
        let inverse = local.recip();
        let signed = |axis: usize| {
            if local[axis] > 0.0 { self.stride[axis] } else { -self.stride[axis] }
        };
        let stride = [signed(0), signed(1), signed(2)];
        Heading { direction, local, inverse, delta: inverse.abs(), stride }
    }

    /// Pass the non-empty cells to `visit`, in order, until it returns `true` or the ray leaves the
    /// field. Returns whether `visit` stopped the traversal.
    ///
    /// Method of Amanatides and Woo (1987) with jumps: each empty cell stores the size of an empty
    /// cube around it, and the ray advances to the end of that cube in one step.
    #[inline(always)]
    pub(super) fn walk(
        &self,
        mut origin: DVec3,
        heading: &Heading,
        mut visit: impl FnMut(Segment) -> bool,
    ) -> bool {
        let Some(mut at) = self.enter(&mut origin, heading) else {
            return false;
        };
        let start = floor(origin + at * heading.local).to_array();
        let mut index = [0; 3];
        for axis in 0..3 {
            // On a face, or displaced by a rounding error: use the cell that the ray enters.
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
                // At a corner the ray crosses cells over zero length; skip them.
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
                // Leave through one side and re-enter through the opposite one.
                periods += 1;
                let forward = heading.local[axis] > 0.0;
                let period = if forward { self.cells[axis] } else { -self.cells[axis] };
                origin[axis] -= f64::from(period);
                cell -= period * self.stride[axis];
            }
        }
    }

    /// Distance at which a ray enters the field, zero if it starts inside; the origin is moved into
    /// the first period. `None` if the ray misses the field.
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

    /// Point where a ray leaves the empty cube that extends `reach - 1` cells to all sides of
    /// `cell`; `None` if that is outside of an open field.
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
        let position = floor(origin + at * heading.local);
        let mut index = [0; 3];
        for other in 0..3 {
            let inside =
                position[other].clamp(center[other] - (reach - 1), center[other] + (reach - 1));
            index[other] = inside.clamp(0, self.cells[other] - 1);
            // Outside along an axis other than that of the exit: a rounding error at an edge.
            if inside != index[other] && other != axis && !(self.periodic && other < 2) {
                return None;
            }
        }
        index[axis] = center[axis] + if heading.local[axis] > 0.0 { reach } else { -reach };
        let outside = !(0..self.cells[axis]).contains(&index[axis]);
        (!outside || (self.periodic && axis < 2)).then_some(Landing { at, axis, index })
    }
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

/// Axis of the smallest component.
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
