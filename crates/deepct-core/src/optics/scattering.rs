//! What a collision in a medium does to light.

use super::{DropletTable, Mixture, PhaseFunction};
use crate::error::{Error, Result};
use ndarray::Array3;
use std::sync::Arc;

/// What a collision does, voxel by voxel: how likely it scatters, and whereto.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub enum Scattering {
    /// The same everywhere.
    Uniform {
        /// Probability that a collision scatters and does not absorb.
        single_scattering_albedo: f64,
        /// Where scattered light goes.
        phase_function: PhaseFunction,
    },
    /// By the size of the droplets. Between two nodes of the table the droplets of a
    /// voxel are a mixture of both, see [`DropletTable::mixture`].
    Droplets {
        /// Effective radius (um), array `[z, y, x]`.
        effective_radius: Array3<f32>,
        /// Optics by effective radius.
        table: Arc<DropletTable>,
    },
}

/// A collision in one voxel: it scatters with the probability `single_scattering_albedo`,
/// after one of two phase functions.
#[derive(Debug, Clone, Copy)]
pub struct Collision<'a> {
    /// Probability that the collision scatters and does not absorb.
    pub single_scattering_albedo: f64,
    /// The two phase functions; the same one twice where the medium is uniform.
    pub phase_functions: [&'a PhaseFunction; 2],
    /// The share of the scattered light that follows the second phase function.
    pub share: f64,
}

impl Scattering {
    /// The same scattering everywhere.
    ///
    /// # Errors
    /// An albedo outside `[0, 1]`.
    pub fn uniform(single_scattering_albedo: f64, phase_function: PhaseFunction) -> Result<Self> {
        check_albedo(single_scattering_albedo)?;
        Ok(Self::Uniform { single_scattering_albedo, phase_function })
    }

    /// What a collision in voxel `[k, j, i]` does. Scattering is constant in a voxel,
    /// also where extinction is trilinear.
    ///
    /// # Panics
    /// When the voxel is outside the grid of the droplets.
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

    /// The phase functions that the scattering of every voxel is a mixture of.
    pub fn phase_functions(&self) -> Vec<&PhaseFunction> {
        match self {
            Self::Uniform { phase_function, .. } => vec![phase_function],
            Self::Droplets { table, .. } => {
                table.nodes().iter().map(|node| &node.phase_function).collect()
            }
        }
    }

    /// What a collision in voxel `[k, j, i]` does, by number of the
    /// [`Scattering::phase_functions`]: the probability that it scatters after that one. They
    /// add up to the single-scattering albedo; there is none of all others.
    ///
    /// # Panics
    /// When the voxel is outside the grid of the droplets.
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
}

impl Collision<'_> {
    /// The density of scattering by an angle of the given cosine (1/sr).
    #[inline]
    pub fn density(&self, cosine: f64) -> f64 {
        let [first, second] = self.phase_functions;
        if self.share == 0.0 {
            return first.density(cosine);
        }
        (1.0 - self.share) * first.density(cosine) + self.share * second.density(cosine)
    }

    /// The cosine of a scattering angle drawn with this density, from a number uniform
    /// in `[0, 1)`: its upper part chooses the phase function, the rest is stretched
    /// to `[0, 1)` again.
    #[inline]
    pub fn sample(&self, uniform: f64) -> f64 {
        let [first, second] = self.phase_functions;
        if uniform < self.share {
            second.sample(uniform / self.share)
        } else {
            first.sample((uniform - self.share) / (1.0 - self.share))
        }
    }

    /// The mean cosine of the scattering angle.
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
