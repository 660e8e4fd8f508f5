//! How an inversion is done.

use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// How an inversion is done.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct InversionSettings {
    /// The most steps on the grid itself.
    pub iterations: usize,
    /// Sides of the blocks of voxels that are solved for first, such as `[4, 2]`; only
    /// where the start is the same everywhere.
    pub coarse: Vec<usize>,
    /// The most steps on each of the coarse grids, and on the grid itself before the first
    /// correction.
    pub coarse_iterations: usize,
    /// How often the images of a cheap solver are corrected by those of an accurate one: where the
    /// steps begin near the answer, and where those after the last correction came to rest.
    pub corrections: usize,
    /// Steps that the optimiser remembers.
    pub memory: usize,
    /// What the optimiser varies.
    pub variable: Variable,
    /// Extinction (1/km) around which [`Variable::Logarithmic`] turns from linear to
    /// logarithmic.
    pub softness: f64,
    /// The greatest extinction that a voxel may have (1/km).
    pub greatest: f64,
    /// Random combinations of the pixels by which the sensitivity to each voxel is
    /// estimated before the first step; 0 leaves all voxels alike.
    pub probes: usize,
    /// Whether a start that is the same everywhere is first multiplied by the factor that
    /// fits the images best.
    pub scale_start: bool,
    /// Standard error of a pixel over its radiance, where the images do not tell it.
    pub relative_noise: f64,
    /// Standard error of the model over the radiance, added in quadrature.
    pub model_error: f64,
    /// Standard error of every pixel over the brightest one, added in quadrature.
    pub least_error: f64,
    /// Standard error of the model on a grid of blocks over the radiance, by the side of
    /// the blocks; added in quadrature.
    pub coarse_error: f64,
    /// Gradient of the extinction (1/km over 1 km) that is taken as typical, or of what
    /// differs from a start that is not the same everywhere: steeper ones cost, in
    /// proportion to their square. 0 leaves this out.
    pub typical_gradient: f64,
    /// Standard error of each voxel of the start over the uncertainty that the network told of
    /// it; 0 leaves this out.
    pub start_error: f64,
    /// Stop when the misfit, the mean square of the residuals over their standard error,
    /// is no greater than this (discrepancy principle of Morozov 1966: 1). 0 leaves this
    /// out, as does a start that tells its uncertainty: its most likely change is looked for.
    pub misfit: f64,
    /// Stop when the last five steps lowered the value by less than this share of it.
    pub change: f64,
}

/// What the optimiser varies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Variable {
    /// Extinction.
    Linear,
    /// `s ln(1 + extinction / s)`: of thick voxels a share, of thin ones an amount.
    Logarithmic,
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
            misfit: 0.0,
            change: 1e-3,
        }
    }
}

impl InversionSettings {
    /// The same with [`QUICK_ITERATIONS`](super::QUICK_ITERATIONS) and one correction.
    pub fn quick(self) -> Self {
        Self { iterations: super::QUICK_ITERATIONS, corrections: 1, ..self }
    }

    /// An error unless the settings can be used.
    ///
    /// # Errors
    /// Names the first number at fault.
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
            ("misfit", self.misfit),
            ("change", self.change),
        ];
        for (name, value) in not_negative {
            if !(value.is_finite() && value >= 0.0) {
                return Err(Error::out_of_range(name, value, "finite and not negative"));
            }
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
