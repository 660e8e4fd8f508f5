//! Traversal of the voxels of a grid along a ray, shared by radiative transfer and space carving.
//!
//! Amanatides and Woo (1987), "A fast voxel traversal algorithm for ray tracing".

use crate::grid::Grid;
use crate::math::{DVec3, Ray};

/// One voxel that a ray crosses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// The voxel `[k, j, i]` (z, y, x).
    pub voxel: [usize; 3],
    /// Distance from the origin of the ray to the point where it enters the voxel (km).
    pub enter: f64,
    /// Distance from the origin of the ray to the point where it leaves the voxel (km).
    pub exit: f64,
}

/// Distances (km) at which a ray enters and leaves the box between two corners, without the part
/// behind the origin of the ray; `None` if the ray misses the box.
#[inline]
pub fn clip(ray: &Ray, lower: DVec3, upper: DVec3) -> Option<(f64, f64)> {
    let inverse = ray.direction.recip();
    let (mut enter, mut exit) = (0.0_f64, f64::INFINITY);
    for axis in 0..3 {
        if ray.direction[axis] == 0.0 {
            if ray.origin[axis] < lower[axis] || ray.origin[axis] >= upper[axis] {
                return None;
            }
            continue;
        }
        let a = (lower[axis] - ray.origin[axis]) * inverse[axis];
        let b = (upper[axis] - ray.origin[axis]) * inverse[axis];
        enter = enter.max(a.min(b));
        exit = exit.min(a.max(b));
    }
    (enter < exit).then_some((enter, exit))
}

/// The voxels of `grid` that `ray` crosses, in order and without gaps.
#[inline]
pub fn walk(grid: &Grid, ray: &Ray) -> Walk {
    let shape = [grid.shape[2] as i64, grid.shape[1] as i64, grid.shape[0] as i64];
    let mut walk = Walk {
        index: [0; 3],
        step: [0; 3],
        next: [0.0; 3],
        delta: [0.0; 3],
        shape,
        at: 0.0,
        end: 0.0,
    };
    let Some((enter, exit)) = clip(ray, grid.lower(), grid.upper()) else {
        return walk;
    };
    (walk.at, walk.end) = (enter, exit);
    let start = (ray.at(enter) - grid.origin) / grid.spacing;
    for axis in 0..3 {
        let direction = ray.direction[axis];
        // If the start is on a face, or beyond it by a rounding error, this is the voxel that the
        // ray enters.
        let index = (start[axis].floor() as i64).clamp(0, shape[axis] - 1);
        walk.index[axis] = index;
        if direction == 0.0 {
            walk.next[axis] = f64::INFINITY;
            continue;
        }
        let face = index + i64::from(direction > 0.0);
        walk.step[axis] = if direction > 0.0 { 1 } else { -1 };
        walk.delta[axis] = grid.spacing[axis] / direction.abs();
        walk.next[axis] =
            (grid.origin[axis] + face as f64 * grid.spacing[axis] - ray.origin[axis]) / direction;
    }
    walk
}

/// The iterator returned by [`walk`].
#[derive(Debug, Clone)]
pub struct Walk {
    index: [i64; 3],
    step: [i64; 3],
    next: [f64; 3],
    delta: [f64; 3],
    shape: [i64; 3],
    at: f64,
    end: f64,
}

impl Iterator for Walk {
    type Item = Step;

    #[inline]
    fn next(&mut self) -> Option<Step> {
        while self.at < self.end {
            let [x, y, z] = self.next;
            let axis = if x <= y && x <= z {
                0
            } else if y <= z {
                1
            } else {
                2
            };
            let voxel = [self.index[2] as usize, self.index[1] as usize, self.index[0] as usize];
            let enter = self.at;
            let exit = self.next[axis].min(self.end);
            self.index[axis] += self.step[axis];
            self.next[axis] += self.delta[axis];
            if (0..self.shape[axis]).contains(&self.index[axis]) {
                self.at = self.at.max(exit);
            } else {
                self.at = self.end;
            }
            // At a corner the ray crosses voxels over a length of zero, which are omitted.
            if exit > enter {
                return Some(Step { voxel, enter, exit });
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::towards;

    fn grid() -> Grid {
        Grid::new(DVec3::new(-0.3, 0.1, 0.5), DVec3::new(0.05, 0.07, 0.04), [9, 5, 7]).unwrap()
    }

    #[test]
    fn steps_are_contiguous_and_inside_their_voxels() {
        let grid = grid();
        for number in 0..500 {
            let angle = f64::from(number);
            let direction = towards(0.006 * angle, 2.4 * angle);
            let aim = grid.lower()
                + grid.extent()
                    * DVec3::new(
                        (0.618 * angle).fract(),
                        (0.317 * angle).fract(),
                        (0.733 * angle).fract(),
                    );
            let ray = Ray { origin: aim - 3.0 * direction, direction };
            let (enter, exit) = clip(&ray, grid.lower(), grid.upper()).unwrap();
            let mut at = enter;
            for step in walk(&grid, &ray) {
                assert!((step.enter - at).abs() < 1e-9, "gap at {at} in ray {number}");
                let middle = ray.at(0.5 * (step.enter + step.exit));
                let offset = (middle - grid.voxel_center(step.voxel)).abs() / grid.spacing;
                assert!(offset.max_element() <= 0.5 + 1e-6, "{step:?} in ray {number}");
                at = step.exit;
            }
            assert!((at - exit).abs() < 1e-9, "ray {number} stops at {at}, not {exit}");
        }
    }

    #[test]
    fn a_ray_that_misses_passes_no_voxel() {
        let ray = Ray { origin: DVec3::new(0.0, 0.0, 9.0), direction: DVec3::Z };
        assert_eq!(walk(&grid(), &ray).count(), 0);
    }

    #[test]
    fn an_axis_parallel_ray_passes_a_column() {
        let grid = grid();
        let ray = Ray { origin: grid.voxel_center([8, 2, 3]) + DVec3::Z, direction: -DVec3::Z };
        let voxels: Vec<_> = walk(&grid, &ray).map(|step| step.voxel).collect();
        assert_eq!(voxels, (0..9).rev().map(|k| [k, 2, 3]).collect::<Vec<_>>());
    }
}
