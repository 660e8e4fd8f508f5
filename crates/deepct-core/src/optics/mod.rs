//! Optics: what a cloud does to light, voxel by voxel.
//!
//! [`Medium`] is what the transport room sees: extinction by voxel, and what a
//! collision does ([`Scattering`]): single-scattering albedo and phase function, the
//! same everywhere or by the size of each voxel's droplets ([`DropletTable`]).

pub mod air;
mod band;
mod droplet_table;
mod mie;
mod moments;
mod phase;
mod population;
mod scattering;
mod water;

pub use droplet_table::{DropletOptics, DropletTable, Mixture};
pub use mie::{Efficiencies, Sphere};
pub use phase::{PhaseFunction, PhaseTable};
pub use population::{DropletSettings, SizeDistribution};
pub use scattering::{Collision, Scattering};
pub use water::water_refractive_index;

use crate::cloud::{Cloud, Microphysics};
use crate::error::{Error, Result};
use crate::grid::Volume;
use ndarray::Array3;
use std::sync::Arc;

/// The asymmetry parameter of water clouds at visible wavelengths: Mie theory gives
/// 0.861 for an effective radius of 10 um at 672 nm.
pub const CLOUD_ASYMMETRY: f64 = 0.86;

/// How extinction varies between the values of a grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Interpolation {
    /// Constant in each voxel.
    #[default]
    Constant,
    /// Trilinear between voxel centres; outside the outermost centres the medium is
    /// empty, as in codes that keep their values at grid nodes.
    Trilinear,
}

/// A scattering medium on a grid.
#[derive(Debug, Clone)]
pub struct Medium {
    /// Extinction coefficient (1/km).
    pub extinction: Volume,
    /// How extinction varies between voxel centres.
    pub interpolation: Interpolation,
    /// What a collision does.
    pub scattering: Scattering,
}

impl Medium {
    /// A medium with voxels of constant extinction that scatters alike everywhere.
    ///
    /// # Errors
    /// A negative or non-finite extinction; an albedo outside `[0, 1]`.
    pub fn new(
        extinction: Volume,
        single_scattering_albedo: f64,
        phase_function: PhaseFunction,
    ) -> Result<Self> {
        extinction.check_non_negative("extinction")?;
        Ok(Self {
            extinction,
            interpolation: Interpolation::Constant,
            scattering: Scattering::uniform(single_scattering_albedo, phase_function)?,
        })
    }

    /// The same medium with another interpolation.
    pub fn with_interpolation(self, interpolation: Interpolation) -> Self {
        Self { interpolation, ..self }
    }

    /// The medium that a cloud is in visible light when all droplets scatter alike:
    /// nothing absorbed, the forward peak of droplets of about 10 um.
    ///
    /// # Errors
    /// As [`extinction`].
    pub fn from_cloud(cloud: &Cloud) -> Result<Self> {
        Self::new(extinction(cloud)?, 1.0, PhaseFunction::henyey_greenstein(CLOUD_ASYMMETRY)?)
    }

    /// The medium of a cloud's droplets: each voxel scatters as droplets of its own
    /// effective radius do. Extinction is that of the droplets, unless the cloud was given
    /// with one.
    ///
    /// Droplets smaller than the first of the table count as those: there is next to no
    /// water in them.
    ///
    /// # Errors
    /// A cloud without droplets; water in droplets larger than the last of the table.
    pub fn from_droplets(cloud: &Cloud, table: Arc<DropletTable>) -> Result<Self> {
        let extinction = droplet_extinction(cloud, &table)?;
        Self::of_droplets(extinction, microphysics(cloud)?.effective_radius.clone(), table)
    }

    /// A medium of the given extinction, made of droplets of the given effective radii (um).
    ///
    /// # Errors
    /// A negative or non-finite extinction; radii on another grid, or beyond the last of the
    /// table where there is extinction.
    pub fn of_droplets(
        extinction: Volume,
        effective_radius: Array3<f32>,
        table: Arc<DropletTable>,
    ) -> Result<Self> {
        extinction.check_non_negative("extinction")?;
        extinction.grid.check_shape("the effective radius", effective_radius.shape())?;
        check_radii(&effective_radius, &extinction.values, &table)?;
        Ok(Self {
            extinction,
            interpolation: Interpolation::Constant,
            scattering: Scattering::Droplets { effective_radius, table },
        })
    }
}

/// An error unless the table reaches to the radius of each voxel that holds something.
fn check_radii(radii: &Array3<f32>, amounts: &Array3<f32>, table: &DropletTable) -> Result<()> {
    let largest = table.nodes()[table.nodes().len() - 1].effective_radius;
    // A radius of single precision may be the last of the table.
    let beyond = |radius: f32| f64::from(radius) > largest * (1.0 + 1e-6);
    match radii.indexed_iter().find(|(voxel, r)| beyond(**r) && amounts[*voxel] > 0.0) {
        None => Ok(()),
        Some((voxel, radius)) => Err(Error::out_of_range(
            "effective radius",
            format!("{radius} um at voxel [z, y, x] {voxel:?}"),
            format!("at most {largest} um, where the table of droplet optics ends"),
        )),
    }
}

/// Extinction (1/km) of a cloud at the wavelength of a table: the one it was given, or
/// that of its water in droplets of each voxel's effective radius.
///
/// # Errors
/// As [`Medium::from_droplets`].
pub fn droplet_extinction(cloud: &Cloud, table: &DropletTable) -> Result<Volume> {
    let droplets = microphysics(cloud)?;
    check_radii(&droplets.effective_radius, &droplets.liquid_water_content, table)?;
    if let Some(values) = &cloud.extinction {
        return Volume::new(cloud.grid, values.clone());
    }
    let values = ndarray::Zip::from(&droplets.liquid_water_content)
        .and(&droplets.effective_radius)
        .map_collect(|&water, &radius| {
            if water > 0.0 {
                water * table.mixture(f64::from(radius)).extinction_per_water as f32
            } else {
                0.0
            }
        });
    Volume::new(cloud.grid, values)
}

fn microphysics(cloud: &Cloud) -> Result<&Microphysics> {
    cloud.microphysics.as_ref().ok_or_else(|| {
        Error::out_of_range(
            "cloud",
            "known by its extinction alone",
            "known by its liquid water and effective radius, or be given one radius for all",
        )
    })
}

/// Extinction (1/km) of a cloud: the one it was given, or the large-droplet limit
/// `beta = 3 Q LWC / (4 rho_w reff)` with the extinction efficiency Q = 2 (Stephens
/// 1978), that is 1500 LWC / reff with LWC in g/m3 and reff in um.
///
/// # Errors
/// When the cloud has neither extinction nor droplets.
pub fn extinction(cloud: &Cloud) -> Result<Volume> {
    if let Some(values) = &cloud.extinction {
        return Volume::new(cloud.grid, values.clone());
    }
    let Some(droplets) = &cloud.microphysics else {
        return Err(Error::out_of_range(
            "cloud",
            "empty",
            "known by its extinction or by its liquid water and effective radius",
        ));
    };
    let values = ndarray::Zip::from(&droplets.liquid_water_content)
        .and(&droplets.effective_radius)
        .map_collect(|&water, &radius| if water > 0.0 { 1500.0 * water / radius } else { 0.0 });
    Volume::new(cloud.grid, values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;
    use crate::math::DVec3;
    use ndarray::Array3;

    /// Two voxels: one of water in droplets, one of nothing.
    fn cloud(water: f32, radius: f32) -> Cloud {
        let grid = Grid::new(DVec3::ZERO, DVec3::ONE, [1, 1, 2]).unwrap();
        let at = |value| Array3::from_shape_vec((1, 1, 2), vec![value, 0.0]).unwrap();
        let droplets = Microphysics {
            liquid_water_content: at(water),
            effective_radius: at(radius),
            effective_variance: at(0.1),
        };
        Cloud::from_microphysics(grid, droplets).unwrap()
    }

    #[test]
    fn a_third_of_a_gram_in_droplets_of_ten_micrometres() {
        let extinction = extinction(&cloud(0.3, 10.0)).unwrap();
        assert!((extinction.values[[0, 0, 0]] - 45.0).abs() < 1e-4);
        assert_eq!(extinction.values[[0, 0, 1]], 0.0);
    }

    #[test]
    fn droplets_take_their_optics_from_the_table() {
        let table =
            Arc::new(DropletTable::mie(&DropletSettings::water(0.672), &[9.0, 11.0]).unwrap());
        let medium = Medium::from_droplets(&cloud(0.3, 10.0), table.clone()).unwrap();
        // The efficiency of droplets of 10 um is 2.104, not 2 (and 2.103 as a mixture).
        let found = f64::from(medium.extinction.values[[0, 0, 0]]);
        assert!((found / 45.0 - 2.104 / 2.0).abs() < 2e-3, "{found}");
        assert_eq!(medium.extinction.values[[0, 0, 1]], 0.0);
        let asymmetry = medium.scattering.at([0, 0, 0]).asymmetry();
        assert!((asymmetry - 0.861).abs() < 1e-3, "{asymmetry}");
        let error = Medium::from_droplets(&cloud(0.3, 15.0), table.clone()).unwrap_err();
        assert!(error.to_string().contains("15 um"), "{error}");
        let grid = Grid::new(DVec3::ZERO, DVec3::ONE, [1, 1, 2]).unwrap();
        let bare = Cloud::from_extinction(Volume::constant(grid, 3.0)).unwrap();
        assert!(Medium::from_droplets(&bare, table).is_err());
    }
}
