//! Tangent-linear model: the derivative of the images in one direction.
//!
//! All steps of a solution are differentiated in their own order. The result is the transpose of
//! [`super::derivative`], up to the tolerance of the solver.

use super::beam::Rays;
use super::diffuse::{Origin, Transport};
use super::quadrature::Octant;
use super::surroundings::OnSurface;
use super::{OrdinatesModel, OrdinatesSettings, State, camera, diffuse, standard};
use crate::error::{Error, Result};
use crate::grid::Volume;
use crate::image::ViewStack;
use ndarray::Array3;
use rayon::prelude::*;

impl OrdinatesModel {
    /// Derivative of the images in a direction, that is their change (1/sr) per change of the
    /// extinction by `direction` (1/km), at the extinction of the last [`Self::images`]. Changes of
    /// voxels that the model takes as empty have no effect.
    ///
    /// # Errors
    /// Fails if the direction is on another grid or not finite, or if no images have been computed.
    pub fn directional_derivative(&self, direction: &Volume) -> Result<ViewStack> {
        self.scene.medium.extinction.grid.check_same("the direction", &direction.grid)?;
        if let Some(value) = direction.values.iter().find(|value| !value.is_finite()) {
            return Err(Error::out_of_range("direction", value, "finite"));
        }
        let Some(state) = self.state.as_ref() else {
            return Err(Error::out_of_range("images", "missing", "computed before the derivative"));
        };
        let direction = standard(&direction.values);
        let change = self.rays(&direction);
        let sun_depths = change.sun_depth_changes(self.scene.sun.towards());
        let shade = self.surroundings.shade_change(&change, &state.shade);
        let field = self.field_change(state, &change, &sun_depths, &shade);
        self.check_stop()?;
        let change = camera::Change {
            extinction: &direction,
            sun_depths: &sun_depths,
            on_surface: OnSurface { shade: &shade, irradiance: &field.irradiance },
            moments: &field.moments,
        };
        let images = self.seen_change(state, &change);
        self.check_stop()?;
        ViewStack::new(images)
    }

    /// Change of the diffuse radiance.
    fn field_change(
        &self,
        state: &State,
        change: &Rays,
        sun_depths: &[[f32; 8]],
        shade: &[f32],
    ) -> diffuse::Field {
        let rays = self.rays(&state.extinction);
        let stopped = rays.stopped_change(&state.sun_depths, change, sun_depths);
        let (unscaled, scaled) = self.coefficients(change.extinction);
        let blurred: Vec<f32> =
            self.surroundings.blurred(shade).into_iter().map(|shade| shade as f32).collect();
        let incoming =
            |octant: &Octant| self.surroundings.incoming_change(&self.lattice, octant, &blurred);
        let outside = match shade.is_empty() {
            true => Vec::new(),
            false => self.quadrature.octants.par_iter().map(incoming).collect(),
        };
        let change = diffuse::Change {
            unscaled: &unscaled,
            scaled: &scaled,
            own: &self.first(&stopped),
            outside: &outside,
        };
        let transport: Transport = self.transport(rays, &state.unscaled, &state.scaled);
        let origin = Origin { own: &state.first, outside: &state.outside, ..Origin::default() };
        let unscattered = transport.unscattered_change(&state.field, origin, change);
        let OrdinatesSettings { tolerance, most_sweeps, .. } = self.settings;
        let origin = Origin { swept: Some(&unscattered), ..Origin::default() };
        let go_on = |_| !self.stop.is_requested();
        transport.solve(origin, unscattered.clone(), tolerance, most_sweeps, &go_on).0
    }

    /// Change of the images.
    fn seen_change(&self, state: &State, change: &camera::Change) -> Array3<f32> {
        let camera = self.camera(state);
        let [rows, cols] = [self.views[0].rows, self.views[0].cols];
        let mut images = Array3::zeros((self.views.len(), rows, cols));
        let values: Vec<Vec<_>> = self
            .tiles
            .par_iter()
            .map(|tile| {
                let view = &self.views[tile.view];
                let prepared = camera.prepare(tile, view);
                let scattered = camera.scattered_change(tile, view, change);
                let changed = |pixel: [usize; 2]| {
                    let value = camera.radiance_change(view, pixel, &prepared, change, &scattered);
                    (pixel, self.brightness(view, pixel) * value)
                };
                self.looked_at(tile).into_par_iter().map(changed).collect()
            })
            .collect();
        for (tile, values) in self.tiles.iter().zip(values) {
            for ([row, col], value) in values {
                images[[tile.view, row, col]] = value as f32;
            }
        }
        images
    }
}

#[cfg(test)]
mod tests;
