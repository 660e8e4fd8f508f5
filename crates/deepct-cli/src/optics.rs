//! The settings of `deepct render` and `deepct score` that tell what a cloud does to light.

use deepct_core::cloud::{Cloud, Microphysics};
use deepct_core::grid::Volume;
use deepct_core::optics::{
    DropletSettings, DropletTable, Medium, PhaseFunction, SizeDistribution, droplet_extinction,
    extinction,
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
    extinction: Extinction,
    phase: Phase,
    asymmetry: f64,
    single_scattering_albedo: f64,
    distribution: SizeDistribution,
    /// Width of the band of wavelengths (um).
    bandwidth: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    effective_variance: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    effective_radius: Option<f32>,
}

/// Where the extinction of droplets comes from, by its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
enum Extinction {
    Geometric,
    Mie,
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
    pub(crate) fn medium(&self, mut cloud: Cloud) -> Result<Medium> {
        let optics = &self.optics;
        if optics.phase == Phase::Mie {
            cloud.microphysics = Some(self.droplets(&cloud)?);
        }
        let by_droplets = optics.extinction == Extinction::Mie && cloud.extinction.is_none();
        let table = match optics.phase == Phase::Mie || by_droplets {
            true => Some(Arc::new(self.table(&cloud)?)),
            false => None,
        };
        let extinction = match &table {
            Some(table) if by_droplets => droplet_extinction(&cloud, table)?,
            _ => extinction(&cloud)?,
        };
        let phase = match (optics.phase, table) {
            (Phase::Mie, Some(table)) => {
                cloud.extinction = Some(extinction.values);
                return Medium::from_droplets(&cloud, table);
            }
            (Phase::Isotropic, _) => PhaseFunction::Isotropic,
            _ => PhaseFunction::henyey_greenstein(optics.asymmetry)?,
        };
        Medium::new(extinction, optics.single_scattering_albedo, phase)
    }

    /// The extinction (1/km) of that medium.
    pub(crate) fn extinction(&self, cloud: &Cloud) -> Result<Volume> {
        if self.optics.extinction == Extinction::Geometric || cloud.extinction.is_some() {
            return extinction(cloud);
        }
        droplet_extinction(cloud, &self.table(cloud)?)
    }

    /// The droplets of the cloud, or those of one size that the settings give it.
    fn droplets(&self, cloud: &Cloud) -> Result<Microphysics> {
        match (&cloud.microphysics, self.optics.effective_radius) {
            (Some(droplets), None) => Ok(droplets.clone()),
            (None, Some(radius)) => Ok(Microphysics::of_one_size(cloud.grid.shape, radius)),
            (Some(_), Some(radius)) => {
                let range = "left out, as the cloud has its own radii";
                Err(Error::out_of_range("optics.effective_radius", radius, range))
            }
            (None, None) => {
                let range = "set (um) for a cloud that is known by its extinction alone";
                Err(Error::out_of_range("optics.effective_radius", "not set", range))
            }
        }
    }

    /// The optics of the cloud's droplets in the light of the band.
    fn table(&self, cloud: &Cloud) -> Result<DropletTable> {
        let water = DropletSettings::water(self.wavelength);
        let mean = cloud.microphysics.as_ref().map(Microphysics::mean_effective_variance);
        let variance = self.optics.effective_variance.or(mean);
        let settings = DropletSettings {
            effective_variance: variance.unwrap_or(water.effective_variance),
            distribution: self.optics.distribution,
            ..water
        };
        DropletTable::of_band(&settings, self.optics.bandwidth)
    }
}
