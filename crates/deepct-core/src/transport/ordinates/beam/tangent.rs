//! Change of the sunlight with the extinction: the derivative of [`super`] in one direction.

use super::{Rays, basis, linear_sun_depth, sun_depth};
use crate::math::{DVec3, Ray};
use rayon::prelude::*;

impl Rays<'_> {
    /// Change of the optical depth along a ray, where the field is a change of the extinction.
    pub(in super::super) fn depth_change(&self, ray: Ray) -> f64 {
        self.lattice.segments(ray).map(|segment| self.depth_of(&segment)).sum()
    }

    /// Change of [`Rays::sun_depths`], where the field is a change of the extinction.
    pub(in super::super) fn sun_depth_changes(&self, sun: DVec3) -> Vec<[f32; 8]> {
        let from = |slot: usize| {
            std::array::from_fn(|point| self.depth_change(self.sun_ray(slot, point, sun)) as f32)
        };
        (0..self.lattice.len()).into_par_iter().map(from).collect()
    }

    /// Change of [`Rays::stopped`] with the extinction of `change` and with the depths.
    pub(in super::super) fn stopped_change(
        &self,
        depths: &[[f32; 8]],
        change: &Rays,
        depth_changes: &[[f32; 8]],
    ) -> Vec<[f32; 4]> {
        let stopped = |slot: usize| {
            let mut sums = [0.0; 4];
            for &(at, weight) in self.cubature {
                let value = self.lattice.value(self.extinction, slot, at);
                let moved = self.lattice.value(change.extinction, slot, at);
                let deeper = sun_depth_change(&depths[slot], &depth_changes[slot], at);
                let light = weight * (-sun_depth(&depths[slot], at)).exp();
                for (sum, function) in sums.iter_mut().zip(basis(at)) {
                    *sum += light * (moved - value * deeper) * function;
                }
            }
            sums.map(|sum| sum as f32)
        };
        (0..self.lattice.len()).into_par_iter().map(stopped).collect()
    }
}

/// Change of [`sun_depth`] at `depths` with these.
#[inline]
pub(in super::super) fn sun_depth_change(depths: &[f32; 8], changes: &[f32; 8], at: DVec3) -> f64 {
    if linear_sun_depth(depths, at) > 0.0 { linear_sun_depth(changes, at) } else { 0.0 }
}
