//! The light of the surface in images of a cloud, in a few products.
//!
//! The deterministic solver stands above nothing. What a pixel sees of a dull surface is
//! its clear-sky radiance, weakened on the way from the Sun and on the way to the camera.
//! Sunlight that a cloud scatters arrives far from its shadow, so that the shadow is as
//! dark as the direct beam. The surface shines on the cloud from all sides below, and what
//! is scattered out of one sight is scattered into others: through a layer that does not
//! absorb pass `1 / (1 + 3/4 (1 - g) optical depth)` of diffuse light (two streams; Bohren
//! 1987, "Multiple scattering of light and some of its observable consequences"), through
//! a cloud of about the same size along all axes, which is lit on its sides too, about half
//! of that loss is seen.

use crate::error::Result;
use crate::grid::Volume;
use crate::image::ViewStack;
use crate::math::Ray;
use crate::scene::{Scene, View};
use crate::traverse::walk;
use ndarray::Array3;
use rayon::prelude::*;

/// Loss of the surface's light by similarity-scaled optical depth.
const LOSS: f64 = 0.375;

/// The surface of a scene as views see it through and under a cloud.
#[derive(Debug, Clone)]
pub(super) struct SurfaceLight {
    /// Radiance without a cloud (1/sr).
    clear: f64,
    /// Loss by optical depth on the way to the camera.
    loss: f64,
    views: Vec<View>,
    altitude: f64,
    sun: crate::math::DVec3,
}

impl SurfaceLight {
    /// The light of the scene's surface; waves count as the dull part alone.
    pub(super) fn new(scene: &Scene, views: &[View]) -> Self {
        let asymmetry = scene.medium.scattering.at([0; 3]).asymmetry();
        let flux = scene.sun.irradiance * scene.sun.zenith.cos();
        Self {
            clear: scene.surface.albedo * flux / std::f64::consts::PI,
            loss: LOSS * (1.0 - asymmetry),
            views: views.to_vec(),
            altitude: scene.surface.altitude,
            sun: scene.sun.towards(),
        }
    }

    /// The ways to the camera and to the Sun from what the middle of a pixel sees.
    fn ways(&self, [view, row, col]: [usize; 3]) -> [Ray; 2] {
        let sight = self.views[view].ray(row as f64 + 0.5, col as f64 + 0.5);
        let distance = (self.altitude - sight.origin.z) / sight.direction.z;
        [sight, Ray { origin: sight.at(distance), direction: self.sun }]
    }

    /// The shares that pass on both ways, and their logarithmic derivatives by optical
    /// depth.
    fn passed(&self, extinction: &Volume, [sight, sun]: &[Ray; 2]) -> [(f64, f64); 2] {
        let depth = |ray: &Ray| -> f64 {
            walk(&extinction.grid, ray)
                .map(|step| f64::from(extinction.values[step.voxel]) * (step.exit - step.enter))
                .sum()
        };
        let seen = 1.0 / (1.0 + self.loss * depth(sight));
        [(seen, -self.loss * seen), ((-depth(sun)).exp(), -1.0)]
    }

    /// Add what the pixels see of the surface.
    ///
    /// # Errors
    /// None for images of the views.
    pub(super) fn add(&self, extinction: &Volume, images: ViewStack) -> Result<ViewStack> {
        if self.clear == 0.0 {
            return Ok(images);
        }
        let shape = images.values.raw_dim();
        let pixels: Vec<_> = images.values.indexed_iter().collect();
        let values = pixels.into_par_iter().map(|((view, row, col), &radiance)| {
            let ways = self.ways([view, row, col]);
            let [(seen, _), (lit, _)] = self.passed(extinction, &ways);
            radiance + (self.clear * seen * lit) as f32
        });
        let values = Array3::from_shape_vec(shape, values.collect());
        ViewStack::new(values.expect("as many pixels as before"))
    }

    /// Add the derivative of the weighted sum of what the pixels see of the surface.
    pub(super) fn differentiate(
        &self,
        extinction: &Volume,
        weights: &ViewStack,
        gradient: &mut Volume,
    ) {
        if self.clear == 0.0 {
            return;
        }
        for ((view, row, col), &weight) in weights.values.indexed_iter() {
            let ways = self.ways([view, row, col]);
            let passed = self.passed(extinction, &ways);
            let light = self.clear * f64::from(weight) * passed[0].0 * passed[1].0;
            for (way, (_, slope)) in ways.iter().zip(passed) {
                for step in walk(&extinction.grid, way) {
                    let derivative = light * slope * (step.exit - step.enter);
                    gradient.values[step.voxel] += derivative as f32;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;
    use crate::math::DVec3;
    use crate::optics::{Medium, PhaseFunction};
    use crate::scene::{Formation, Sun, Surface};

    /// Against central differences in every voxel.
    #[test]
    fn the_derivative_is_that_of_the_light() {
        let grid = Grid::new(DVec3::new(0.0, 0.0, 0.5), DVec3::splat(0.2), [2, 3, 3]).unwrap();
        let values = Array3::from_shape_fn(grid.shape, |(k, j, i)| (2 * k + j + 3 * i) as f32);
        let extinction = Volume::new(grid, values).unwrap();
        let phase = PhaseFunction::henyey_greenstein(0.8).unwrap();
        let medium = Medium::new(extinction.clone(), 1.0, phase).unwrap();
        let scene = Scene::new(medium, Sun::default(), Surface::lambertian(0.3)).unwrap();
        let views = Formation::cloudct_10().views(grid.center(), [12, 12]).unwrap();
        let light = SurfaceLight::new(&scene, &views);
        let dark = ViewStack::new(Array3::zeros((10, 12, 12))).unwrap();
        let weight = |(view, row, col): (usize, usize, usize)| ((view + 2 * row + col) % 5) as f32;
        let weights = ViewStack::new(Array3::from_shape_fn((10, 12, 12), weight)).unwrap();
        let sum = |extinction: &Volume| -> f64 {
            let images = light.add(extinction, dark.clone()).unwrap();
            let terms = images.values.iter().zip(&weights.values);
            terms.map(|(value, weight)| f64::from(value * weight)).sum()
        };
        let mut gradient = Volume::constant(grid, 0.0);
        light.differentiate(&extinction, &weights, &mut gradient);
        for (voxel, found) in gradient.values.indexed_iter() {
            let [mut above, mut below] = [extinction.clone(), extinction.clone()];
            above.values[voxel] += 0.02;
            below.values[voxel] -= 0.02;
            let expected = (sum(&above) - sum(&below)) / 0.04;
            let error = (f64::from(*found) - expected).abs();
            assert!(error < 2e-3 * expected.abs() + 1e-4, "{voxel:?}: {found} {expected}");
        }
        let clear = light.add(&Volume::constant(grid, 0.0), dark).unwrap().values[[0, 0, 0]];
        let expected = 0.3 * 30_f64.to_radians().cos() / std::f64::consts::PI;
        assert!((f64::from(clear) - expected).abs() < 1e-6, "{clear} {expected}");
    }
}
