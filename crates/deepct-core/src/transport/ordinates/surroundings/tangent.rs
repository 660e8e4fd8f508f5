//! Change of the radiance from outside: the derivative of [`super`] in one direction.

use super::{OnSurface, Outside, Surroundings, each_face, number};
use crate::math::Ray;
use crate::transport::ordinates::beam::Rays;
use crate::transport::ordinates::lattice::Lattice;
use crate::transport::ordinates::quadrature::Octant;
use crate::transport::ordinates::sweep::Faces;
use rayon::prelude::*;

impl Surroundings {
    /// Change of [`Surroundings::shade`] at the values `shade`, where the field of `change` is a
    /// change of the extinction.
    pub(in super::super) fn shade_change(&self, change: &Rays, shade: &[f32]) -> Vec<f32> {
        let changed = |(point, shade): (usize, &f32)| {
            let ray = Ray { origin: self.shadow.point(point), direction: self.sun };
            ((1.0 - f64::from(*shade)) * change.depth_change(ray)) as f32
        };
        shade.par_iter().enumerate().map(changed).collect()
    }

    /// Change of [`Surroundings::incoming`] with the blurred shade.
    pub(in super::super) fn incoming_change(
        &self,
        lattice: &Lattice,
        octant: &Octant,
        blurred_change: &[f32],
    ) -> Faces {
        let mut faces = Faces::dark(lattice, octant);
        let mut feet = self.feet[number(octant)].iter();
        each_face(lattice, octant, |place, _| {
            let Some(foot) = feet.next() else { return };
            let shade = foot.shadow.interpolate(blurred_change);
            *place.mean(&mut faces, octant) = -foot.unshaded * shade;
        });
        faces
    }

    /// Change of the radiance of `outside` with the effect of the cloud on the surface.
    pub(in super::super) fn outside_change(&self, outside: &Outside, change: OnSurface) -> f64 {
        let mut sum = 0.0;
        if outside.unshaded != 0.0 {
            sum -= outside.unshaded * self.shadow.interpolate(change.shade, outside.foot);
        }
        if outside.share != 0.0 && !change.irradiance.is_empty() {
            sum += outside.share * self.lit.interpolate(change.irradiance, outside.foot);
        }
        sum
    }
}
