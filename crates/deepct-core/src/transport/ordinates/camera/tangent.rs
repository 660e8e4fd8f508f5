//! Change of the radiances at the cameras: the derivative of [`super`] in one direction.

use super::{Camera, POINTS, Path, Prepared, Step, Tile, before, pixel_rays};
use crate::scene::View;
use crate::transport::ordinates::beam::sun_depth_change;
use crate::transport::ordinates::lattice::basis;
use crate::transport::ordinates::surroundings::OnSurface;

/// Changes of the quantities on which the radiances depend.
#[derive(Debug, Clone, Copy)]
pub(in super::super) struct Change<'a> {
    pub(in super::super) extinction: &'a [f32],
    pub(in super::super) sun_depths: &'a [[f32; 8]],
    pub(in super::super) on_surface: OnSurface<'a>,
    /// Moments of radiance, `[slot][4][harmonic]`.
    pub(in super::super) moments: &'a [f32],
}

impl Camera<'_> {
    /// Change of the light that each active cell scatters towards the camera, over extinction: mean
    /// and slopes.
    pub(in super::super) fn scattered_change(
        &self,
        tile: &Tile,
        view: &View,
        change: &Change,
    ) -> Vec<[f32; 4]> {
        Camera { moments: change.moments, ..*self }.scattered(tile, view)
    }

    /// Change of [`Camera::radiance`], with the result of [`Camera::scattered_change`].
    pub(in super::super) fn radiance_change(
        &self,
        view: &View,
        pixel: [usize; 2],
        prepared: &Prepared,
        change: &Change,
        scattered: &[[f32; 4]],
    ) -> f64 {
        let mut path = Path::default();
        let before = POINTS.map(before);
        let before_middle = self::before(0.5);
        let mut sum = 0.0;
        for ray in pixel_rays(view, pixel, prepared.rays) {
            let beyond = self.walk(ray, prepared, true, &mut path);
            // Change of the optical depth in front of a step.
            let mut depth = 0.0;
            for step in &path.steps {
                let Step { slot, points, scaling, length, .. } = *step;
                let values =
                    points.map(|point| self.rays.lattice.value(change.extinction, slot, point.at));
                let part = |weights: [f64; 2]| {
                    scaling * length * (weights[0] * values[0] + weights[1] * values[1])
                };
                sum -= step.before * depth + step.air * (depth + part(before_middle));
                for (number, point) in points.iter().enumerate() {
                    let to_camera = depth + part(before[number]);
                    let (depths, changes) = (&self.sun_depths[slot], &change.sun_depths[slot]);
                    let to_sun = sun_depth_change(depths, changes, point.at);
                    let diffuse: f64 = basis(point.at)
                        .iter()
                        .zip(&scattered[slot])
                        .map(|(function, value)| function * f64::from(*value))
                        .sum();
                    let source = diffuse
                        - (point.source - point.broadening) * to_camera
                        - (point.sunlight - point.broadening) * to_sun;
                    let light = values[number] * point.source + point.extinction * source;
                    sum += 0.5 * length * point.transmittance * light;
                }
                depth += part([0.5, 0.5]);
            }
            let outside = self.surroundings.outside_change(&beyond.outside, change.on_surface);
            sum += beyond.transmittance * (outside - depth * beyond.outside.radiance());
        }
        sum / prepared.rays as f64
    }
}
