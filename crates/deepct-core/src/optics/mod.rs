//! Optics: the optical properties of a cloud in each voxel.
//!
//! A [`Medium`] is the input of radiative transfer: the extinction of each voxel and its
//! [`Scattering`] properties. Single-scattering albedo and phase function are uniform or depend
//! on the effective radius of each voxel ([`DropletTable`]).

pub mod air;
mod band;
mod droplet_table;
mod mie;
mod moments;
mod phase;
mod population;
mod scattering;
mod water;

pub use droplet_table::{DropletOptics, DropletTable, Mixture, MixtureDerivative};
pub use mie::{Efficiencies, Sphere};
pub use phase::{PhaseFunction, PhaseTable};
pub use population::{DropletSettings, SizeDistribution, TABLE_RADII};
pub use scattering::{Collision, Scattering};
pub use water::water_refractive_index;

use crate::cloud::{Cloud, Microphysics};
use crate::error::{Error, Result};
use crate::grid::Volume;
use ndarray::Array3;
use std::sync::Arc;

/// Asymmetry parameter of water clouds at visible wavelengths. Mie theory gives 0.861 for an
/// effective radius of 10 um at 672 nm.
pub const CLOUD_ASYMMETRY: f64 = 0.86;

/// Extinction per liquid water content times effective radius (1/km per g/m3, times um) for an
/// extinction efficiency of 2: `3 Q / (4 rho_w)`.
pub const GEOMETRIC_EXTINCTION: f64 = 1500.0;

/// Interpolation of extinction between the values of a grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Interpolation {
    /// Constant in each voxel.
    #[default]
    Constant,
    /// Trilinear between voxel centres. Outside the outermost centres the medium is empty, as in
    /// models that define extinction at grid nodes.
    Trilinear,
}

/// A scattering medium on a grid.
#[derive(Debug, Clone)]
pub struct Medium {
    /// Extinction (1/km).
    pub extinction: Volume,
    /// Interpolation of the extinction between voxel centres.
    pub interpolation: Interpolation,
    /// Single-scattering albedo and phase function.
    pub scattering: Scattering,
}

impl Medium {
    /// A medium with constant extinction in each voxel and uniform scattering properties.
    ///
    /// # Errors
    /// Returns an error if an extinction is negative or not finite, or if the single-scattering
    /// albedo is outside `[0, 1]`.
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

    /// The same medium with the given interpolation.
    pub fn with_interpolation(self, interpolation: Interpolation) -> Self {
        Self { interpolation, ..self }
    }

    /// The medium of a cloud in visible light with uniform scattering properties: a
    /// single-scattering albedo of 1 and a Henyey-Greenstein phase function with the asymmetry
    /// parameter [`CLOUD_ASYMMETRY`].
    ///
    /// # Errors
    /// As [`extinction`].
    pub fn from_cloud(cloud: &Cloud) -> Result<Self> {
        Self::new(extinction(cloud)?, 1.0, PhaseFunction::henyey_greenstein(CLOUD_ASYMMETRY)?)
    }

    /// The medium of a cloud in which the scattering properties of each voxel follow from its
    /// effective radius. The extinction is that of the droplets, unless the cloud has its own.
    ///
    /// Droplets smaller than the first node of the table are treated as that node, because they
    /// hold almost no water.
    ///
    /// # Errors
    /// Returns an error if the cloud has no droplets, or if a voxel with water has an effective
    /// radius beyond the last node of the table.
    pub fn from_droplets(cloud: &Cloud, table: Arc<DropletTable>) -> Result<Self> {
        let extinction = droplet_extinction(cloud, &table)?;
        Self::of_droplets(extinction, microphysics(cloud)?.effective_radius.clone(), table)
    }

    /// A medium with the given extinction (1/km) and effective radius (um, `[z, y, x]`).
    ///
    /// # Errors
    /// Returns an error if an extinction is negative or not finite, if the effective radii do not
    /// have the shape of the grid, or if the effective radius of a voxel with extinction is beyond
    /// the last node of the table.
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

/// Returns an error unless the table covers the radius of each voxel with a positive amount.
fn check_radii(radii: &Array3<f32>, amounts: &Array3<f32>, table: &DropletTable) -> Result<()> {
    let largest = table.nodes()[table.nodes().len() - 1].effective_radius;
    // The last radius of the table must pass when it is stored in single precision.
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

/// Extinction (1/km) of a cloud at the wavelength of a table: the prescribed one if the cloud has
/// it, otherwise that of its liquid water content at the effective radius of each voxel.
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

/// The extinction per liquid water content (1/km per g/m3) of droplets of an effective radius (um), and
/// its derivative (per um): of a table, or in the large-droplet limit of [`extinction`].
pub(crate) fn extinction_per_water(
    table: Option<&DropletTable>,
    effective_radius: f64,
) -> [f64; 2] {
    match table {
        Some(table) => [
            table.mixture(effective_radius).extinction_per_water,
            table.mixture_derivative(effective_radius).extinction_per_water,
        ],
        None => {
            let value = GEOMETRIC_EXTINCTION / effective_radius;
            [value, -value / effective_radius]
        }
    }
}

fn microphysics(cloud: &Cloud) -> Result<&Microphysics> {
    cloud.microphysics.as_ref().ok_or_else(|| {
        Error::out_of_range(
            "cloud",
            "given by its extinction only",
            "given by its liquid water content and effective radius, or have one prescribed radius",
        )
    })
}

/// Extinction (1/km) of a cloud: the prescribed one if the cloud has it, otherwise the
/// large-droplet limit `beta = 3 Q LWC / (4 rho_w reff)` with the extinction efficiency Q = 2
/// (Stephens 1978), that is 1500 LWC / reff with LWC in g/m3 and reff in um.
///
/// # Errors
/// Returns an error if the cloud has neither extinction nor droplets.
pub fn extinction(cloud: &Cloud) -> Result<Volume> {
    if let Some(values) = &cloud.extinction {
        return Volume::new(cloud.grid, values.clone());
    }
    let Some(droplets) = &cloud.microphysics else {
        return Err(Error::out_of_range(
            "cloud",
            "empty",
            "given by its extinction or by its liquid water content and effective radius",
        ));
    };
    let values =
        ndarray::Zip::from(&droplets.liquid_water_content)
            .and(&droplets.effective_radius)
            .map_collect(|&water, &radius| {
                if water > 0.0 { GEOMETRIC_EXTINCTION as f32 * water / radius } else { 0.0 }
            });
    Volume::new(cloud.grid, values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;
    use crate::math::DVec3;
    use ndarray::Array3;

    /// Two voxels, one with droplets and one without.
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
        // The extinction efficiency for an effective radius of 10 um is 2.104 instead of 2, and
        // 2.103 as a mixture of two nodes.
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
