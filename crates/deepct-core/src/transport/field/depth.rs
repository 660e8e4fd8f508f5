//! Optical depths and free paths along rays through a field.

use super::walk::Segment;
use super::{Field, Heading, floor};
use crate::math::{DVec3, GAUSS_TWO};
use rayon::prelude::*;

impl Field {
    /// Optical depth from a point to the end of the medium; infinite as soon as it exceeds `limit`.
    #[inline]
    pub(in crate::transport) fn optical_depth(
        &self,
        origin: DVec3,
        heading: &Heading,
        limit: f64,
    ) -> f64 {
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

    /// Distance (km) from a point at which the optical depth reaches `depth`; `None` if the ray
    /// leaves the medium first.
    #[inline]
    pub(in crate::transport) fn free_path(
        &self,
        origin: DVec3,
        heading: &Heading,
        depth: f64,
    ) -> Option<f64> {
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

    /// Optical depth from the centre of each cell to the end of the medium.
    pub(in crate::transport) fn depths_from_cells(&self, heading: &Heading) -> Vec<f32> {
        let [_, sy, sz] = self.stride;
        let depth = |cell: i32| {
            let index =
                DVec3::new(f64::from(cell % sy), f64::from(cell % sz / sy), f64::from(cell / sz));
            self.optical_depth(index - 0.5, heading, f64::INFINITY) as f32
        };
        (0..self.majorant.len() as i32).into_par_iter().map(depth).collect()
    }
}

/// Part of a ray in one cell of a trilinear field, starting at the entry point.
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
        let start = segment.origin + segment.enter * heading.local - floor(middle).as_dvec3();
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

    /// Optical depth of the first `length` km, by the two-point Gauss-Legendre rule.
    #[inline]
    fn depth(&self, length: f64) -> f64 {
        let [first, second] = GAUSS_TWO;
        0.5 * length * (self.extinction(first * length) + self.extinction(second * length))
    }

    /// Distance at which the optical depth reaches `target`, where `total` is the optical depth of
    /// `length`: Newton's method, restricted to a bracket by bisection.
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
