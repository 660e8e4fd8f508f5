//! Plane-parallel layers by the discrete-ordinates solver.
//!
//! The values have no noise, so they are judged by a fixed tolerance instead of standard errors.
//! Each layer is computed with thin voxels and with voxels of optical depth 2.

use super::slabs::{FLUXES, RADIANCES, SEMI_INFINITE};
use super::{Reference, Report};
use crate::error::Result;
use crate::grid::{Grid, Volume};
use crate::math::{DVec3, towards};
use crate::scene::{Boundary, Scene, View};
use crate::transport::{OrdinatesModel, OrdinatesSettings, Share};
use ndarray::Array2;
use std::f64::consts::PI;

/// Accepted relative error of a reflectance.
const ACCURACY: f64 = 5e-3;
/// Finer than a cloud requires. The default of 8 zenith angles and cells of optical depth 2.5 is
/// accurate to 1 % for most of these layers, but its error is 2 % in thin layers with forward
/// scattering and 4 % for oblique illumination and viewing.
const ZENITH_ANGLES: usize = 12;
const CELL_DEPTH: f64 = 0.25;
/// In thick layers the change by one sweep is only a small part of the remaining error.
const TOLERANCE: f64 = 1e-5;
/// Optical depths of a voxel.
const VOXEL_DEPTHS: [f64; 2] = [0.5, 2.0];
/// The positive half of the eight-point Gauss-Legendre rule on [-1, 1], with which fluxes are
/// integrated over the cosine of the zenith angle.
const RULE: [(f64, f64); 4] = [
    (0.183_434_642_495_649_8, 0.362_683_783_378_362),
    (0.525_532_409_916_329, 0.313_706_645_877_887_3),
    (0.796_666_477_413_626_7, 0.222_381_034_453_374_5),
    (0.960_289_856_497_536_3, 0.101_228_536_290_376_3),
];
/// Optical depth of a layer that is practically semi-infinite for a single-scattering albedo of
/// 0.99: less than exp(-0.17 DEEP) of the light reaches its bottom, and the same fraction of that
/// returns to its top.
const DEEP: f64 = 40.0;
/// Number of azimuths on one side of the solar principal plane; the other side is symmetric.
const AZIMUTHS: usize = 12;

pub(super) fn run(mut report: Report) -> Result<()> {
    for voxel_depth in VOXEL_DEPTHS {
        for (depth, albedo, asymmetry, solar_cosine, reflected, _) in FLUXES {
            let layer = Layer { depth, albedo, asymmetry, solar_cosine, voxel_depth };
            let found = layer.reflectance()?;
            report.compare(&[(layer.name("reflected"), exact(found), within(reflected))]);
        }
        for (solar_cosine, reflected) in SEMI_INFINITE {
            let layer =
                Layer { depth: DEEP, albedo: 0.99, asymmetry: 0.0, solar_cosine, voxel_depth };
            let found = layer.reflectance()?;
            report.compare(&[(layer.name("reflected"), exact(found), within(reflected))]);
        }
        let layer =
            Layer { depth: 8.0, albedo: 1.0, asymmetry: 0.75, solar_cosine: 1.0, voxel_depth };
        let directions = RADIANCES.map(|(cosine, ..)| towards(cosine.acos(), 0.4));
        let found = layer.radiances(&directions)?;
        let rows: Vec<_> = RADIANCES
            .iter()
            .zip(found)
            .map(|((cosine, up, _), radiance)| {
                let case = layer.name(&format!("pi I at mu {cosine}"));
                (case, exact(PI * radiance), within(*up))
            })
            .collect();
        report.compare(&rows);
    }
    Ok(())
}

fn exact(mean: f64) -> Share {
    Share { mean, standard_error: 0.0 }
}

fn within(value: f64) -> Reference {
    Reference { value, standard_error: 0.0, systematic: ACCURACY * value }
}

/// A layer 1 km thick.
struct Layer {
    depth: f64,
    albedo: f64,
    asymmetry: f64,
    solar_cosine: f64,
    voxel_depth: f64,
}

impl Layer {
    fn name(&self, what: &str) -> String {
        let Self { depth, albedo, asymmetry, solar_cosine, voxel_depth } = self;
        format!(
            "tau {depth} by {voxel_depth}, w {albedo}, g {asymmetry}, mu0 {solar_cosine:.4}: {what}"
        )
    }

    fn scene(&self) -> Result<Scene> {
        let voxels = (self.depth / self.voxel_depth).ceil().max(1.0) as usize;
        // The voxels are so wide that no light crosses from one side to the other.
        let spacing = DVec3::new(1e3, 1e3, 1.0 / voxels as f64);
        let grid = Grid::new(DVec3::ZERO, spacing, [voxels, 1, 1])?;
        let extinction = Volume::constant(grid, self.depth as f32);
        let scene = super::scene(extinction, self.albedo, self.asymmetry, self.solar_cosine)?;
        Ok(scene.with_boundary(Boundary::Periodic))
    }

    /// Radiances (1/sr) at the top towards the given directions, for a Sun of unit irradiance.
    fn radiances(&self, directions: &[DVec3]) -> Result<Vec<f64>> {
        let scene = self.scene()?;
        let target = DVec3::new(500.0, 500.0, 1.0);
        let views: Vec<View> = directions
            .iter()
            .map(|direction| View::orthographic(*direction, target, 1e-3, [1, 1]))
            .collect::<Result<_>>()?;
        let settings = OrdinatesSettings {
            zenith_angles: ZENITH_ANGLES,
            cell_depth: CELL_DEPTH,
            most_parts: 8,
            tolerance: TOLERANCE,
            ..Default::default()
        };
        let images = OrdinatesModel::new(&scene, &views, None, &settings)?
            .images(&scene.medium.extinction)?;
        Ok(images.values.iter().map(|value| f64::from(*value)).collect())
    }

    /// The ratio of the upward to the incident flux at the top, by integration of radiances.
    fn reflectance(&self) -> Result<f64> {
        let rule = RULE.map(|(x, w)| [(0.5 - 0.5 * x, 0.5 * w), (0.5 + 0.5 * x, 0.5 * w)]);
        let rule = rule.as_flattened();
        // All azimuths are equivalent if the Sun is in the zenith.
        let azimuths = if self.solar_cosine == 1.0 { 1 } else { AZIMUTHS };
        let azimuth = |n: usize| PI * (n as f64 + 0.5) / azimuths as f64;
        // The Sun is in the east.
        let directions: Vec<DVec3> = rule
            .iter()
            .flat_map(|(cosine, _)| {
                (0..azimuths).map(|n| towards(cosine.acos(), 0.5 * PI + azimuth(n)))
            })
            .collect();
        let radiances =
            Array2::from_shape_vec((rule.len(), azimuths), self.radiances(&directions)?)
                .expect("one for each direction");
        let flux: f64 = rule
            .iter()
            .zip(radiances.outer_iter())
            .map(|((cosine, weight), row)| cosine * weight * 2.0 * PI * row.mean().unwrap_or(0.0))
            .sum();
        Ok(flux / self.solar_cosine)
    }
}
