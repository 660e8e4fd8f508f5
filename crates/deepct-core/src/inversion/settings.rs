//! Settings of an inversion.

use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// Settings of an inversion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct InversionSettings {
    /// Maximum number of iterations on the full-resolution grid, for each correction.
    pub iterations: usize,
    /// Side lengths (voxels) of the blocks that are solved for first, such as `[4, 2]`; only used
    /// with a uniform start.
    pub coarse: Vec<usize>,
    /// Maximum number of iterations on each coarse grid, and on the full-resolution grid before the
    /// first correction.
    pub coarse_iterations: usize,
    /// Number of corrections of a fast solver's images by those of an accurate solver: the first
    /// one where the iterations near the solution begin, each further one where the iterations
    /// after the previous correction ended.
    pub corrections: usize,
    /// Number of steps that the optimiser stores (L-BFGS memory).
    pub memory: usize,
    /// The variable in which the optimiser works.
    pub variable: Variable,
    /// Extinction (1/km) around which [`Variable::Logarithmic`] changes from linear to logarithmic.
    pub softness: f64,
    /// Largest extinction of a voxel (1/km).
    pub greatest: f64,
    /// Number of random combinations of the pixels from which the sensitivity to each voxel is
    /// estimated before the first iteration; with 0, all voxels are assumed to be equally
    /// sensitive.
    pub probes: usize,
    /// Whether a uniform start is first multiplied by the factor that fits the images best.
    pub scale_start: bool,
    /// Standard error of a pixel relative to its radiance, used if the images have no standard
    /// error.
    pub relative_noise: f64,
    /// Standard error of the forward model relative to the radiance, added in quadrature.
    pub model_error: f64,
    /// Standard error of every pixel relative to the largest radiance, added in quadrature.
    pub least_error: f64,
    /// Standard error of the forward model on a grid of blocks, relative to the radiance and per
    /// voxel of the side length of a block; added in quadrature.
    pub coarse_error: f64,
    /// Typical gradient of the extinction (1/km over 1 km), or of its difference from a start that
    /// is not uniform. The cost of a gradient is proportional to its square. 0 disables this term
    /// of the prior.
    pub typical_gradient: f64,
    /// Standard error of each voxel of the start relative to the uncertainty that the network
    /// estimates; 0 disables this term of the prior.
    pub start_error: f64,
    /// The unknowns that describe the effective radius.
    pub radius: Radius,
    /// With [`Radius::Field`], the standard error of the logarithm of the radius of each voxel relative to
    /// the profile.
    pub radius_error: f64,
    /// With [`Radius::Field`], the typical gradient of this logarithm (per km); 0 disables this term of the
    /// prior.
    pub radius_gradient: f64,
    /// Standard error of the gain of each camera, relative to the calibrated one; the gains are then
    /// unknowns. 0 for gains that are known.
    pub camera_gain_error: f64,
    /// Standard error (pixels, along rows and along columns) of the direction in which each camera
    /// points; the directions are then unknowns. 0 for directions that are known.
    pub pointing_error: f64,
    /// Number of further inversions, of images with other noise and with another prior, whose spread
    /// gives the standard errors of the result; 0 for no standard errors.
    pub members: usize,
    /// Stop when the misfit, the mean square of the residuals over their standard errors, is at
    /// most this value (discrepancy principle of Morozov 1966: 1). 0 disables this criterion. A
    /// start whose uncertainty is used disables it too, because the inversion then seeks the most
    /// likely extinction.
    pub misfit: f64,
    /// Stop when the last five iterations reduced the objective function by less than this fraction
    /// of it.
    pub change: f64,
}

/// The variable in which the optimiser works.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Variable {
    /// The extinction itself.
    Linear,
    /// `s ln(1 + extinction / s)` with `s` the softness: a change of the variable changes large
    /// extinctions by a relative amount and small ones by an absolute amount.
    Logarithmic,
}

/// The unknowns that describe the effective radius of the droplets.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Radius {
    /// None: the effective radius is that of the scene illumination.
    #[default]
    Given,
    /// One effective radius of the whole cloud.
    Uniform,
    /// The radius at one altitude and the altitude of the cloud base, for an adiabatic profile: the
    /// cube of the effective radius is proportional to the height above the base.
    Adiabatic,
    /// The effective radius of each voxel; the prior expects small and smooth deviations from an
    /// adiabatic profile, which is unknown too.
    Field,
}

impl Default for InversionSettings {
    fn default() -> Self {
        Self {
            iterations: 50,
            coarse: vec![4, 2],
            coarse_iterations: 15,
            corrections: 3,
            memory: 10,
            variable: Variable::Logarithmic,
            softness: 30.0,
            greatest: 1000.0,
            probes: 2,
            scale_start: true,
            relative_noise: 0.01,
            model_error: 0.005,
            least_error: 0.002,
            coarse_error: 0.03,
            typical_gradient: 1200.0,
            start_error: 2.0,
            radius: Radius::Given,
            radius_error: 0.5,
            radius_gradient: 10.0,
            camera_gain_error: 0.0,
            pointing_error: 0.0,
            members: 0,
            misfit: 0.0,
            change: 1e-3,
        }
    }
}

impl InversionSettings {
    /// Returns the settings with [`QUICK_ITERATIONS`](super::QUICK_ITERATIONS) and one correction.
    pub fn quick(self) -> Self {
        Self { iterations: super::QUICK_ITERATIONS, corrections: 1, ..self }
    }

    /// Returns an error unless the settings are valid.
    ///
    /// # Errors
    /// An [`Error::OutOfRange`] that names the first invalid value.
    pub fn check(&self) -> Result<()> {
        let positive = [("softness", self.softness), ("greatest", self.greatest)];
        for (name, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return Err(Error::out_of_range(name, value, "positive and finite (1/km)"));
            }
        }
        let not_negative = [
            ("relative_noise", self.relative_noise),
            ("model_error", self.model_error),
            ("least_error", self.least_error),
            ("coarse_error", self.coarse_error),
            ("typical_gradient", self.typical_gradient),
            ("start_error", self.start_error),
            ("radius_gradient", self.radius_gradient),
            ("camera_gain_error", self.camera_gain_error),
            ("pointing_error", self.pointing_error),
            ("misfit", self.misfit),
            ("change", self.change),
        ];
        for (name, value) in not_negative {
            if !(value.is_finite() && value >= 0.0) {
                return Err(Error::out_of_range(name, value, "finite and not negative"));
            }
        }
        if !(0.001..=1.0).contains(&self.radius_error) {
            let range =
                "from 0.001 to 1: a radius deviates by at most a factor of 2 from the profile";
            return Err(Error::out_of_range("radius_error", self.radius_error, range));
        }
        if self.pointing_error > 1.0 {
            let range = "at most 1 pixel: images are shifted to first order";
            return Err(Error::out_of_range("pointing_error", self.pointing_error, range));
        }
        if self.members == 1 {
            return Err(Error::out_of_range("members", 1, "0 or at least 2"));
        }
        if self.corrections == 0 {
            return Err(Error::out_of_range("corrections", 0, "at least 1"));
        }
        if let Some(block) = self.coarse.iter().find(|block| !(2..=64).contains(*block)) {
            return Err(Error::out_of_range("coarse", block, "blocks of 2 to 64 voxels"));
        }
        Ok(())
    }
}
