//! Scattering properties of a medium: single-scattering albedo and phase function.

use super::{DropletTable, Mixture, PhaseFunction};
use crate::error::{Error, Result};
use ndarray::Array3;
use std::sync::Arc;

/// Single-scattering albedo and phase function of each voxel.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub enum Scattering {
    /// The same properties in all voxels.
    Uniform {
        /// Single-scattering albedo, the probability that a collision is a scattering event.
        single_scattering_albedo: f64,
        /// Phase function.
        phase_function: PhaseFunction,
    },
    /// Properties that depend on the effective radius of each voxel. Between two nodes of the table
    /// the droplets are a mixture of those of both nodes, see [`DropletTable::mixture`].
    Droplets {
        /// Effective radius (um), array `[z, y, x]`.
        effective_radius: Array3<f32>,
        /// Optical properties as a function of effective radius.
        table: Arc<DropletTable>,
    },
}

/// The scattering properties of one voxel: a single-scattering albedo and a weighted sum of two
/// phase functions.
#[derive(Debug, Clone, Copy)]
pub struct Collision<'a> {
    /// Single-scattering albedo, the probability that a collision is a scattering event.
    pub single_scattering_albedo: f64,
    /// The two phase functions; in a uniform medium both are the same.
    pub phase_functions: [&'a PhaseFunction; 2],
    /// The fraction of the scattered light that follows the second phase function.
    pub share: f64,
}

impl Scattering {
    /// Uniform scattering properties.
    ///
    /// # Errors
    /// Returns an error if the single-scattering albedo is outside `[0, 1]`.
    pub fn uniform(single_scattering_albedo: f64, phase_function: PhaseFunction) -> Result<Self> {
        check_albedo(single_scattering_albedo)?;
        Ok(Self::Uniform { single_scattering_albedo, phase_function })
    }

    /// The scattering properties of voxel `[k, j, i]`. They are constant within a voxel even if the
    /// extinction is interpolated.
    ///
    /// # Panics
    /// Panics if the voxel is outside the grid of the droplets.
    #[inline]
    pub fn at(&self, voxel: [usize; 3]) -> Collision<'_> {
        match self {
            Self::Uniform { single_scattering_albedo, phase_function } => Collision {
                single_scattering_albedo: *single_scattering_albedo,
                phase_functions: [phase_function; 2],
                share: 0.0,
            },
            Self::Droplets { effective_radius, table } => {
                table.collision(&table.mixture(f64::from(effective_radius[voxel])))
            }
        }
    }

    /// The phase functions of which those of all voxels are weighted sums.
    pub fn phase_functions(&self) -> Vec<&PhaseFunction> {
        match self {
            Self::Uniform { phase_function, .. } => vec![phase_function],
            Self::Droplets { table, .. } => {
                table.nodes().iter().map(|node| &node.phase_function).collect()
            }
        }
    }

    /// The two [`Scattering::phase_functions`] of voxel `[k, j, i]`, each as its index and the
    /// probability that a collision scatters according to it. The probabilities add up to the
    /// single-scattering albedo.
    ///
    /// # Panics
    /// Panics if the voxel is outside the grid of the droplets.
    pub fn shares(&self, voxel: [usize; 3]) -> [(usize, f64); 2] {
        match self {
            Self::Uniform { single_scattering_albedo, .. } => {
                [(0, *single_scattering_albedo), (0, 0.0)]
            }
            Self::Droplets { effective_radius, table } => {
                let mixture = table.mixture(f64::from(effective_radius[voxel]));
                let Mixture { first, share, single_scattering_albedo: albedo, .. } = mixture;
                [(first, albedo * (1.0 - share)), (table.second(first), albedo * share)]
            }
        }
    }

    /// The derivatives of the probabilities of [`Scattering::shares`] with respect to the effective
    /// radius of voxel `[k, j, i]` (1/um); 0 for uniform properties.
    ///
    /// # Panics
    /// Panics if the voxel is outside the grid of the droplets.
    pub fn share_derivatives(&self, voxel: [usize; 3]) -> [(usize, f64); 2] {
        match self {
            Self::Uniform { .. } => [(0, 0.0); 2],
            Self::Droplets { effective_radius, table } => {
                let radius = f64::from(effective_radius[voxel]);
                let [first, second] = table.mixture_derivative(radius).scattering;
                let number = table.mixture(radius).first;
                [(number, first), (table.second(number), second)]
            }
        }
    }
}

impl Collision<'_> {
    /// The phase function (1/sr) at the given cosine of the scattering angle.
    #[inline]
    pub fn density(&self, cosine: f64) -> f64 {
        let [first, second] = self.phase_functions;
        if self.share == 0.0 {
            return first.density(cosine);
        }
        (1.0 - self.share) * first.density(cosine) + self.share * second.density(cosine)
    }

    /// Samples the cosine of the scattering angle from a number uniform in `[0, 1)`. The number
    /// first selects one of the phase functions and is then rescaled to `[0, 1)`.
    #[inline]
    pub fn sample(&self, uniform: f64) -> f64 {
        let [first, second] = self.phase_functions;
        if uniform < self.share {
            second.sample(uniform / self.share)
        } else {
            first.sample((uniform - self.share) / (1.0 - self.share))
        }
    }

    /// The asymmetry parameter, the mean cosine of the scattering angle.
    pub fn asymmetry(&self) -> f64 {
        let [first, second] = self.phase_functions;
        (1.0 - self.share) * first.asymmetry() + self.share * second.asymmetry()
    }
}

pub(super) fn check_albedo(single_scattering_albedo: f64) -> Result<()> {
    if (0.0..=1.0).contains(&single_scattering_albedo) {
        return Ok(());
    }
    Err(Error::out_of_range(
        "single-scattering albedo",
        single_scattering_albedo,
        "between 0 and 1",
    ))
}
