//! The scene illumination: all input of the solvers apart from the cloud and the views.

mod table;

pub use table::LightTable;

use super::{Boundary, Scene, Sun, Surface};
use crate::cloud::{Cloud, Microphysics};
use crate::error::{Error, Result};
use crate::grid::Volume;
use crate::optics::air::Air;
use crate::optics::{
    CLOUD_ASYMMETRY, DropletSettings, DropletTable, Medium, PhaseFunction, SizeDistribution,
    droplet_extinction, extinction, extinction_per_water,
};
use ndarray::{Array3, Zip};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// The scene illumination: Sun, wavelength, droplet optics, molecular atmosphere, surface and
/// lateral boundaries.
///
/// A renderer stores it with the images, and an inversion reads it from their file.
/// [`Light::scene`] combines it with a cloud to a scene. In TOML, JSON and netCDF it is represented
/// by a table of plain values ([`LightTable`]), which is checked when it is read.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(into = "LightTable", try_from = "LightTable")]
#[non_exhaustive]
pub struct Light {
    /// Direction and irradiance of the Sun.
    pub sun: Sun,
    /// Wavelength (um).
    pub wavelength: f64,
    /// Model of the droplet optics.
    pub optics: DropletOpticsModel,
    /// Whether the molecular atmosphere (Rayleigh scattering of the standard atmosphere) is
    /// included.
    pub air: bool,
    /// Vertical optical depth of the gases above the clouds that absorb at the wavelength, such as water
    /// vapour and carbon dioxide: sunlight passes through them before, and what the cameras observe
    /// after, it is scattered.
    pub gas_optical_depth: f64,
    /// The surface below the cloud.
    pub surface: Surface,
    /// The lateral boundary condition.
    pub boundary: Boundary,
}

/// Largest vertical optical depth of absorbing gases.
const MOST_GAS: f64 = 5.0;

/// Model of the droplet optics: extinction, phase function and single-scattering albedo.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
#[non_exhaustive]
pub struct DropletOpticsModel {
    /// Computation of the extinction of a cloud from its droplets, used if the cloud has no
    /// extinction of its own.
    pub extinction: ExtinctionModel,
    /// The phase function.
    pub phase: PhaseModel,
    /// Asymmetry parameter; used with [`PhaseModel::HenyeyGreenstein`].
    pub asymmetry: f64,
    /// Single-scattering albedo; used with all phase functions except [`PhaseModel::Mie`].
    pub single_scattering_albedo: f64,
    /// Shape of the droplet size distribution (Mie).
    pub distribution: SizeDistribution,
    /// Width of the spectral band (um) around the wavelength (Mie); 0 for a single wavelength.
    pub bandwidth: f64,
    /// Effective variance of the droplet size distribution (Mie); if not given, the mean over the
    /// cloud.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub effective_variance: Option<f64>,
    /// Effective radius (um) of all droplets of a cloud that is given by its extinction only (Mie).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub effective_radius: Option<f64>,
}

/// Computation of extinction from liquid water content and effective radius.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum ExtinctionModel {
    /// Extinction efficiency of 2, the limit for large droplets, at any wavelength.
    #[default]
    Geometric,
    /// Extinction efficiency of Mie theory, which is several per cent larger in visible light.
    Mie,
}

/// Model of the phase function.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum PhaseModel {
    /// Henyey-Greenstein phase function, the same in every voxel.
    #[default]
    #[serde(rename = "hg", alias = "henyey-greenstein")]
    HenyeyGreenstein,
    /// Mie theory with the effective radius of each voxel.
    Mie,
    /// Isotropic scattering.
    Isotropic,
}

impl Default for DropletOpticsModel {
    fn default() -> Self {
        Self {
            extinction: ExtinctionModel::default(),
            phase: PhaseModel::default(),
            asymmetry: CLOUD_ASYMMETRY,
            single_scattering_albedo: 1.0,
            distribution: SizeDistribution::default(),
            bandwidth: 0.0,
            effective_variance: None,
            effective_radius: None,
        }
    }
}

impl Default for Light {
    /// The Sun of Sde-Chen et al. (2021), a wavelength of 0.672 um, a Henyey-Greenstein phase
    /// function, no molecular atmosphere, a dark ocean surface and open sides.
    fn default() -> Self {
        Self {
            sun: Sun::default(),
            wavelength: 0.672,
            optics: DropletOpticsModel::default(),
            air: false,
            gas_optical_depth: 0.0,
            surface: Surface::OCEAN,
            boundary: Boundary::Open,
        }
    }
}

impl From<Sun> for Light {
    /// The default scene illumination with the given Sun.
    fn from(sun: Sun) -> Self {
        Self { sun, ..Self::default() }
    }
}

impl Light {
    /// The default scene illumination with droplet optics by Mie theory (phase function and
    /// extinction) and with the molecular atmosphere. The built-in networks were trained with it.
    pub fn realistic() -> Self {
        let optics = DropletOpticsModel {
            extinction: ExtinctionModel::Mie,
            phase: PhaseModel::Mie,
            ..DropletOpticsModel::default()
        };
        Self { air: true, optics, ..Self::default() }
    }

    /// What the discrete-ordinates solver neglects in this illumination, as warnings for the user.
    pub fn neglected_by_ordinates(&self) -> Vec<&'static str> {
        let waves = self.surface.waves.is_some().then_some(
            "the discrete-ordinates solver neglects the light of the cloud that ocean waves reflect: \
             dark pixels may be up to 40 % too dark, the mean of a view up to 18 %; the Monte Carlo \
             solver includes it",
        );
        let air = (self.air && self.boundary == Boundary::Periodic).then_some(
            "between periodic sides, the discrete-ordinates solver neglects the light of the clouds \
             that the air scatters back: views may be up to 2 % too dark in green light; the Monte \
             Carlo solver includes it",
        );
        waves.into_iter().chain(air).collect()
    }

    /// Checks that every value is in its range.
    ///
    /// # Errors
    /// Returns an error that names the first value out of range.
    pub fn check(&self) -> Result<()> {
        let Sun { zenith, azimuth, irradiance } = self.sun;
        Sun::from_degrees(zenith.to_degrees(), azimuth.to_degrees())?;
        let positive = |value: f64| value.is_finite() && value > 0.0;
        if !positive(irradiance) {
            return Err(Error::out_of_range("solar_irradiance", irradiance, "positive"));
        }
        if !(0.1..=100.0).contains(&self.wavelength) {
            let range = "from 0.1 to 100 um (red light has 0.672 um)";
            return Err(Error::out_of_range("wavelength", self.wavelength, range));
        }
        if !(0.0..=MOST_GAS).contains(&self.gas_optical_depth) {
            let range = format!("from 0 to {MOST_GAS}: with more, there is no light to see");
            return Err(Error::out_of_range("gas_optical_depth", self.gas_optical_depth, range));
        }
        let width = self.optics.bandwidth;
        if !(0.0..2.0 * self.wavelength).contains(&width) {
            let range = "from 0 to less than twice the wavelength (um)";
            return Err(Error::out_of_range("optics.bandwidth", width, range));
        }
        if self.air {
            Air::new(self.wavelength)?;
        }
        self.surface.check()?;
        self.surface.at(self.wavelength)?;
        self.optics.check()
    }

    /// The scene of a cloud with this illumination.
    ///
    /// # Errors
    /// Returns an error if a value is out of range, if Mie theory requires an effective radius that
    /// neither the cloud nor the settings provide, if both provide one, or if the surface is above
    /// the bottom of the grid.
    pub fn scene(&self, cloud: &Cloud) -> Result<Scene> {
        self.check()?;
        self.scene_with(cloud, self.table_up_to(cloud, largest_radius(cloud))?)
    }

    /// The scene of a cloud given by its extinction (1/km) with this illumination.
    ///
    /// # Errors
    /// As [`Light::scene`].
    pub fn scene_of(&self, extinction: Volume) -> Result<Scene> {
        self.scene(&Cloud::from_extinction(extinction)?)
    }

    /// The scene of a cloud given by its extinction (1/km) with this illumination, for droplets whose
    /// effective radii are unknown: the table of droplet optics covers [`TABLE_RADII`](crate::optics::TABLE_RADII), and the radius
    /// is 10 um until it is replaced.
    ///
    /// # Errors
    /// As [`Light::scene`], and if the phase function does not depend on the effective radius.
    pub fn scene_of_any_droplets(&self, extinction: Volume) -> Result<Scene> {
        if self.optics.phase != PhaseModel::Mie {
            return Err(Error::out_of_range(
                "optics.phase",
                "independent of the effective radius",
                "mie if the effective radius is to be retrieved",
            ));
        }
        let radii = Array3::from_elem(extinction.grid.shape, 10.0);
        let cloud = Cloud::from_extinction_and_radii(extinction, radii)?;
        let mut light = self.clone();
        light.optics.effective_radius = None;
        light.check()?;
        light.scene_with(&cloud, light.droplet_table(&cloud)?)
    }

    /// The droplets of a given effective radius (um) that have an extinction (1/km), as the inverse of
    /// [`Light::extinction`].
    ///
    /// # Errors
    /// Returns an error if a value is out of range or the volumes are on different grids.
    pub fn droplets_of(
        &self,
        extinction: &Volume,
        effective_radius: &Volume,
    ) -> Result<Microphysics> {
        extinction.grid.check_same("the effective radius", &effective_radius.grid)?;
        let radii = effective_radius.values.clone();
        let cloud = Cloud::from_extinction_and_radii(extinction.clone(), radii)?;
        let geometric = cloud.microphysics.expect("made from droplets");
        let settings = self.droplet_settings(None);
        let mut liquid_water_content = geometric.liquid_water_content;
        if self.optics.extinction == ExtinctionModel::Mie {
            let table = DropletTable::shared(&settings, self.optics.bandwidth, None)?;
            Zip::from(&mut liquid_water_content)
                .and(&extinction.values)
                .and(&effective_radius.values)
                .for_each(|water, extinction, radius| {
                    let per_water = table.mixture(f64::from(*radius)).extinction_per_water;
                    *water = extinction / per_water as f32;
                });
        }
        let variance = settings.effective_variance as f32;
        Ok(Microphysics {
            liquid_water_content,
            effective_variance: Array3::from_elem(extinction.grid.shape, variance),
            effective_radius: geometric.effective_radius,
        })
    }

    /// The extinction per liquid water content (1/km per g/m3) of droplets of the given effective radii
    /// (um), and its derivative (per um): `1500 / r` in the geometric limit, otherwise that of Mie theory,
    /// with the derivative of [`DropletTable::mixture_derivative`].
    ///
    /// # Errors
    /// Returns an error if a value of the light is out of range, or if a radius is not positive or beyond
    /// the table of droplet optics.
    pub fn extinction_per_water(
        &self,
        effective_radius: &Array3<f32>,
    ) -> Result<(Array3<f32>, Array3<f32>)> {
        self.check()?;
        let table = match self.optics.extinction {
            ExtinctionModel::Geometric => None,
            ExtinctionModel::Mie => Some(DropletTable::shared(
                &self.droplet_settings(None),
                self.optics.bandwidth,
                None,
            )?),
        };
        let last = table.as_ref().and_then(|table| table.nodes().last());
        // The last radius of the table must pass when it is stored in single precision.
        let most = last.map_or(f64::INFINITY, |node| node.effective_radius * (1.0 + 1e-6));
        let is_outside = |radius: &&f32| !(**radius > 0.0 && f64::from(**radius) <= most);
        if let Some(radius) = effective_radius.iter().find(is_outside) {
            let range = format!("above 0 and at most {most:.4} um");
            return Err(Error::out_of_range("effective radius", radius, range));
        }
        let part = |number: usize| {
            effective_radius.mapv(|radius| {
                extinction_per_water(table.as_deref(), f64::from(radius))[number] as f32
            })
        };
        Ok((part(0), part(1)))
    }

    /// As [`Light::scene`], with the droplet optics of [`Light::droplet_table`], which can be used
    /// for several clouds.
    ///
    /// # Errors
    /// As [`Light::scene`].
    pub fn scene_with(&self, cloud: &Cloud, table: Option<Arc<DropletTable>>) -> Result<Scene> {
        let medium = self.medium(cloud, table)?;
        let surface = self.surface.at(self.wavelength)?;
        let scene = Scene::new(medium, self.sun, surface)?.with_boundary(self.boundary);
        let scene = Scene { gas_optical_depth: self.gas_optical_depth, ..scene };
        Ok(match self.air {
            true => scene.with_air(Air::new(self.wavelength)?),
            false => scene,
        })
    }

    /// The extinction (1/km) of a cloud at this wavelength: the prescribed one if the cloud has it,
    /// otherwise that of its droplets.
    ///
    /// # Errors
    /// Returns an error if the cloud has neither extinction nor droplets, or if an effective radius
    /// is beyond the table of Mie theory.
    pub fn extinction(&self, cloud: &Cloud) -> Result<Volume> {
        if !self.is_extinction_by_droplets(cloud) {
            return extinction(cloud);
        }
        match self.table_up_to(cloud, largest_radius(cloud))? {
            Some(table) => droplet_extinction(cloud, &table),
            None => extinction(cloud),
        }
    }

    /// The table of droplet optics by Mie theory for clouds whose droplets have the same distribution
    /// and any effective radius up to 25 um; `None` if Mie theory is not used.
    ///
    /// # Errors
    /// Returns an error if a value is out of range.
    pub fn droplet_table(&self, cloud: &Cloud) -> Result<Option<Arc<DropletTable>>> {
        self.table_up_to(cloud, f64::INFINITY)
    }

    /// [`Light::droplet_table`] for effective radii up to `largest` (um).
    fn table_up_to(&self, cloud: &Cloud, largest: f64) -> Result<Option<Arc<DropletTable>>> {
        if self.optics.phase != PhaseModel::Mie && !self.is_extinction_by_droplets(cloud) {
            return Ok(None);
        }
        let settings = self.droplet_settings(cloud.microphysics.as_ref());
        let width = self.optics.bandwidth;
        let table = match (&cloud.microphysics, self.optics.effective_radius) {
            (None, Some(radius)) => DropletTable::shared(&settings, width, Some(&[radius]))?,
            _ => DropletTable::shared_up_to(&settings, width, largest)?,
        };
        Ok(Some(table))
    }

    /// The scene illumination as recorded with the images of a cloud. If the phase function is that
    /// of Mie theory and no effective radius is prescribed, the mean effective radius of the cloud
    /// is recorded, because an inversion uses a single value.
    pub fn recorded(&self, cloud: &Cloud) -> Self {
        let mut light = self.clone();
        if let (PhaseModel::Mie, Some(droplets)) = (light.optics.phase, &cloud.microphysics) {
            let variance = || Some(droplets.mean_effective_variance());
            light.optics.effective_radius =
                light.optics.effective_radius.or_else(|| cloud.mean_effective_radius());
            light.optics.effective_variance = light.optics.effective_variance.or_else(variance);
        }
        light
    }

    /// The droplets of a cloud; those of one without known droplets if `None`.
    fn droplet_settings(&self, droplets: Option<&Microphysics>) -> DropletSettings {
        let water = DropletSettings::water(self.wavelength);
        let mean = droplets.map(Microphysics::mean_effective_variance);
        let variance = self.optics.effective_variance.or(mean);
        DropletSettings {
            effective_variance: variance.unwrap_or(water.effective_variance),
            distribution: self.optics.distribution,
            ..water
        }
    }

    fn is_extinction_by_droplets(&self, cloud: &Cloud) -> bool {
        self.optics.extinction == ExtinctionModel::Mie && cloud.extinction.is_none()
    }

    fn medium(&self, cloud: &Cloud, table: Option<Arc<DropletTable>>) -> Result<Medium> {
        let values = match &table {
            Some(table) if self.is_extinction_by_droplets(cloud) => {
                droplet_extinction(cloud, table)?
            }
            _ => extinction(cloud)?,
        };
        let optics = &self.optics;
        let phase = match (optics.phase, table) {
            (PhaseModel::Mie, Some(table)) => {
                let droplets = self.droplets(cloud)?;
                return Medium::of_droplets(values, droplets.effective_radius, table);
            }
            (PhaseModel::Isotropic, _) => PhaseFunction::Isotropic,
            _ => PhaseFunction::henyey_greenstein(optics.asymmetry)?,
        };
        Medium::new(values, optics.single_scattering_albedo, phase)
    }

    /// The droplets of the cloud, or those of the prescribed effective radius.
    fn droplets(&self, cloud: &Cloud) -> Result<Microphysics> {
        let setting = "optics.effective_radius";
        match (&cloud.microphysics, self.optics.effective_radius) {
            (Some(droplets), None) => Ok(droplets.clone()),
            (None, Some(radius)) => Ok(Microphysics::of_one_size(cloud.grid.shape, radius as f32)),
            (Some(_), Some(radius)) => {
                let range = "omitted, because the cloud has its own effective radii";
                Err(Error::out_of_range(setting, radius, range))
            }
            (None, None) => {
                let range = "set (um), because the cloud is given by its extinction only";
                Err(Error::out_of_range(setting, "not set", range))
            }
        }
    }
}

/// The largest effective radius (um) of a cloud where it is not clear, 0 if it has no droplets.
fn largest_radius(cloud: &Cloud) -> f64 {
    let Some(droplets) = &cloud.microphysics else { return 0.0 };
    let extinction = cloud.extinction.as_ref();
    let is_clear = |voxel| {
        droplets.liquid_water_content[voxel] == 0.0
            && extinction.is_none_or(|extinction| extinction[voxel] == 0.0)
    };
    let radii = droplets.effective_radius.indexed_iter();
    let radii = radii.filter(|(voxel, _)| !is_clear(*voxel)).map(|(_, radius)| f64::from(*radius));
    radii.fold(0.0, f64::max)
}

impl DropletOpticsModel {
    fn check(&self) -> Result<()> {
        PhaseFunction::henyey_greenstein(self.asymmetry)?;
        let albedo = self.single_scattering_albedo;
        if !(0.0..=1.0).contains(&albedo) {
            let range = "between 0 and 1";
            return Err(Error::out_of_range("optics.single_scattering_albedo", albedo, range));
        }
        if self.effective_radius.is_some_and(|radius| !(0.1..=50.0).contains(&radius)) {
            let radius = self.effective_radius.unwrap_or_default();
            return Err(Error::out_of_range(
                "optics.effective_radius",
                radius,
                "from 0.1 to 50 um",
            ));
        }
        if self.effective_variance.is_some_and(|variance| !(variance > 0.0 && variance <= 0.4)) {
            let variance = self.effective_variance.unwrap_or_default();
            let range = "above 0 and at most 0.4";
            return Err(Error::out_of_range("optics.effective_variance", variance, range));
        }
        self.check_effect()
    }

    /// Returns an error if a value is given that has no effect with the other ones.
    fn check_effect(&self) -> Result<()> {
        let default = Self::default();
        let (is_mie, is_hg) = match self.phase {
            PhaseModel::Mie => (true, false),
            PhaseModel::HenyeyGreenstein => (false, true),
            PhaseModel::Isotropic => (false, false),
        };
        let by_mie = is_mie || self.extinction == ExtinctionModel::Mie;
        let phase = if is_mie { "mie" } else { "isotropic" };
        let unused = |name, value: f64, of: &str| {
            let range = format!("omitted, as it has no effect with {of}");
            Err(Error::out_of_range(name, value, range))
        };
        if !is_hg && self.asymmetry != default.asymmetry {
            return unused("optics.asymmetry", self.asymmetry, &format!("optics.phase = {phase}"));
        }
        let albedo = self.single_scattering_albedo;
        if is_mie && albedo != default.single_scattering_albedo {
            return unused("optics.single_scattering_albedo", albedo, "optics.phase = mie");
        }
        let variance = self.effective_variance.unwrap_or(0.0);
        for (name, value) in
            [("optics.bandwidth", self.bandwidth), ("optics.effective_variance", variance)]
        {
            if !by_mie && value != 0.0 {
                return unused(name, value, "optics that are not by Mie theory");
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
