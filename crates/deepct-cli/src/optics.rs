//! The settings of `deepct render` that tell what a cloud does to light.

use deepct_core::cloud::{Cloud, Microphysics};
use deepct_core::optics::{
    DropletSettings, DropletTable, Medium, PhaseFunction, SizeDistribution, extinction,
};
use deepct_core::{Error, Result};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// The settings of `deepct render`.
#[derive(Debug, Clone, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RenderSettings {
    /// Wavelength (um).
    pub(crate) wavelength: f64,
    pub(crate) optics: OpticsSettings,
}

/// What a cloud does to light.
#[derive(Debug, Clone, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct OpticsSettings {
    phase: Phase,
    asymmetry: f64,
    single_scattering_albedo: f64,
    distribution: SizeDistribution,
    #[serde(skip_serializing_if = "Option::is_none")]
    effective_variance: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    effective_radius: Option<f32>,
}

/// A phase function by its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
enum Phase {
    Hg,
    Mie,
    Isotropic,
}

impl RenderSettings {
    /// The medium that the settings make of a cloud.
    pub(crate) fn medium(&self, cloud: Cloud) -> Result<Medium> {
        let optics = &self.optics;
        let phase = match optics.phase {
            Phase::Mie => return self.droplets(cloud),
            Phase::Hg => PhaseFunction::henyey_greenstein(optics.asymmetry)?,
            Phase::Isotropic => PhaseFunction::Isotropic,
        };
        Medium::new(extinction(&cloud)?, optics.single_scattering_albedo, phase)
    }

    fn droplets(&self, mut cloud: Cloud) -> Result<Medium> {
        let droplets = match (cloud.microphysics.take(), self.optics.effective_radius) {
            (Some(droplets), None) => droplets,
            (None, Some(radius)) => Microphysics::of_one_size(cloud.grid.shape, radius),
            (Some(_), Some(radius)) => {
                let range = "left out, as the cloud has its own radii";
                return Err(Error::out_of_range("optics.effective_radius", radius, range));
            }
            (None, None) => {
                let range = "set (um) for a cloud that is known by its extinction alone";
                return Err(Error::out_of_range("optics.effective_radius", "not set", range));
            }
        };
        let mean = droplets.mean_effective_variance();
        let settings = DropletSettings {
            effective_variance: self.optics.effective_variance.unwrap_or(mean),
            distribution: self.optics.distribution,
            ..DropletSettings::water(self.wavelength)
        };
        cloud.microphysics = Some(droplets);
        Medium::from_droplets(&cloud, Arc::new(DropletTable::of(&settings)?))
    }
}
