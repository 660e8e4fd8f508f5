//! Clouds: where the liquid water is and how large its droplets are.
//!
//! A [`Cloud`] comes from a large-eddy simulation (read by `io`) or from the
//! generator here; optics turns it into a scattering medium.

mod droplets;
mod generate;
mod isolate;
pub mod resample;
mod spectrum;
mod tile;
mod turbulence;

pub use droplets::{LARGEST_RADIUS, effective_radius};
pub use generate::{CumulusSettings, FieldSettings, adiabatic_liquid_water, cumulus, field};
pub use isolate::{IsolateSettings, Piece, isolate};
pub use spectrum::{LARGEST_VARIANCE, Spectrum, doubling_radii};
pub use tile::tile;

use crate::error::{Error, Result};
use crate::grid::{Grid, Volume};
use ndarray::Array3;

/// The effective variance of droplet sizes taken where none is known.
pub const EFFECTIVE_VARIANCE: f32 = 0.1;

/// A cloud, or a field of clouds, on a grid: droplets, or extinction, or both.
#[derive(Debug, Clone, PartialEq)]
pub struct Cloud {
    /// Where the voxels are.
    pub grid: Grid,
    /// What the droplets are like, where it is known.
    pub microphysics: Option<Microphysics>,
    /// Extinction (1/km), where it is given and not to be computed from droplets.
    pub extinction: Option<Array3<f32>>,
}

/// Liquid water and droplet sizes by voxel, arrays `[z, y, x]`.
#[derive(Debug, Clone, PartialEq)]
pub struct Microphysics {
    /// Liquid water content (g/m3).
    pub liquid_water_content: Array3<f32>,
    /// Effective radius (um); zero where there is no water.
    pub effective_radius: Array3<f32>,
    /// Effective variance (dimensionless).
    pub effective_variance: Array3<f32>,
}

impl Microphysics {
    /// The effective variance of the whole cloud: the mean, weighted by the water;
    /// [`EFFECTIVE_VARIANCE`] without water.
    pub fn mean_effective_variance(&self) -> f64 {
        let (mut sum, mut total) = (0.0, 0.0);
        for (water, variance) in self.liquid_water_content.iter().zip(&self.effective_variance) {
            sum += f64::from(*water) * f64::from(*variance);
            total += f64::from(*water);
        }
        if total > 0.0 { sum / total } else { f64::from(EFFECTIVE_VARIANCE) }
    }
}

impl Cloud {
    /// The effective radius of the whole cloud (um): the mean, weighted by the extinction.
    /// `None` without droplets.
    pub fn mean_effective_radius(&self) -> Option<f64> {
        let droplets = self.microphysics.as_ref()?;
        let (mut sum, mut total) = (0.0, 0.0);
        for (water, radius) in droplets.liquid_water_content.iter().zip(&droplets.effective_radius)
        {
            // Extinction is in proportion to the water over the radius.
            let (water, radius) = (f64::from(*water), f64::from(*radius));
            if water > 0.0 {
                sum += water;
                total += water / radius;
            }
        }
        (total > 0.0).then(|| sum / total)
    }

    /// A cloud known by its droplets.
    ///
    /// # Errors
    /// A shape other than the grid's, a negative or non-finite value, or water
    /// without an effective radius.
    pub fn from_microphysics(grid: Grid, microphysics: Microphysics) -> Result<Self> {
        let Microphysics { liquid_water_content, effective_radius, effective_variance } =
            &microphysics;
        for (name, values) in [
            ("liquid water content", liquid_water_content),
            ("effective radius", effective_radius),
            ("effective variance", effective_variance),
        ] {
            Volume::new(grid, values.clone())?.check_non_negative(name)?;
        }
        let dry = liquid_water_content
            .indexed_iter()
            .find(|(voxel, water)| **water > 0.0 && effective_radius[*voxel] <= 0.0);
        if let Some(((k, j, i), water)) = dry {
            return Err(Error::out_of_range(
                "effective radius",
                format!("0 at voxel [z {k}, y {j}, x {i}], where there is {water} g/m3 of water"),
                "positive (um) where there is water",
            ));
        }
        Ok(Self { grid, microphysics: Some(microphysics), extinction: None })
    }

    /// A cloud known by its extinction alone.
    ///
    /// # Errors
    /// A negative or non-finite extinction.
    pub fn from_extinction(extinction: Volume) -> Result<Self> {
        extinction.check_non_negative("extinction")?;
        Ok(Self { grid: extinction.grid, microphysics: None, extinction: Some(extinction.values) })
    }

    /// A cloud of a given extinction in droplets of given effective radii (um); its liquid water is
    /// that of droplets with an extinction efficiency of 2.
    ///
    /// # Errors
    /// As [`Cloud::from_extinction`] and [`Cloud::from_microphysics`].
    pub fn from_extinction_and_radii(
        extinction: Volume,
        effective_radius: Array3<f32>,
    ) -> Result<Self> {
        let cloud = Self::from_extinction(extinction)?;
        cloud.grid.check_shape("the effective radius", effective_radius.shape())?;
        let droplets = Microphysics {
            liquid_water_content: cloud.extinction.as_ref().expect("just given")
                * &effective_radius
                / 1500.0,
            effective_variance: Array3::from_elem(cloud.grid.shape, EFFECTIVE_VARIANCE),
            effective_radius,
        };
        let extinction = cloud.extinction;
        Ok(Self { extinction, ..Self::from_microphysics(cloud.grid, droplets)? })
    }
}
