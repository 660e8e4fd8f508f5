//! Clouds: liquid water content and droplet sizes on a grid.
//!
//! A [`Cloud`] comes from a large-eddy simulation (read by `io`) or from the generator in
//! this module; the `optics` module converts it into a scattering medium.

mod droplets;
mod generate;
mod isolate;
pub mod resample;
mod spectrum;
mod tile;
mod turbulence;

pub use droplets::{LARGEST_RADIUS, effective_radius};
pub use generate::{CumulusSettings, FieldSettings, adiabatic_liquid_water, cumulus, field};
pub use isolate::{IsolateSettings, LeftOut, Piece, isolate, isolate_and_count};
pub use spectrum::{LARGEST_VARIANCE, Spectrum, doubling_radii};
pub use tile::tile;

use crate::error::{Error, Result};
use crate::grid::{Grid, Volume};
use ndarray::Array3;

/// Default effective variance of the droplet size distribution (dimensionless).
pub const EFFECTIVE_VARIANCE: f32 = 0.1;

/// A cloud or a field of clouds on a grid, given by its droplets, its extinction or both.
#[derive(Debug, Clone, PartialEq)]
pub struct Cloud {
    /// The grid of the voxels.
    pub grid: Grid,
    /// Liquid water content and droplet sizes; `None` if they are unknown.
    pub microphysics: Option<Microphysics>,
    /// Extinction (1/km), array `[z, y, x]`; `None` if it is to be computed from the droplets.
    pub extinction: Option<Array3<f32>>,
}

/// Liquid water content and droplet sizes of each voxel, arrays `[z, y, x]`.
#[derive(Debug, Clone, PartialEq)]
pub struct Microphysics {
    /// Liquid water content (g/m3).
    pub liquid_water_content: Array3<f32>,
    /// Effective radius (um); zero in voxels without water.
    pub effective_radius: Array3<f32>,
    /// Effective variance (dimensionless).
    pub effective_variance: Array3<f32>,
}

impl Microphysics {
    /// The mean effective variance of the cloud, weighted by the liquid water content;
    /// [`EFFECTIVE_VARIANCE`] if there is no water.
    pub fn mean_effective_variance(&self) -> f64 {
        let (mut sum, mut total) = (0.0, 0.0);
        for (water, variance) in self.liquid_water_content.iter().zip(&self.effective_variance) {
            sum += f64::from(*water) * f64::from(*variance);
            total += f64::from(*water);
        }
        if total > 0.0 { sum / total } else { f64::from(EFFECTIVE_VARIANCE) }
    }
}

/// Extinction (1/km) up to which a voxel holds a trace of water, which is not visible: simulations have
/// droplets of any size there.
const TRACE_EXTINCTION: f32 = 1e-3;

/// Range of effective radii of droplets (um). Smaller numbers are often in m, larger ones in nm.
const LEAST_RADIUS: f32 = 0.1;
const MOST_RADIUS: f32 = 100.0;

impl Cloud {
    /// The mean effective radius of the cloud (um), weighted by the extinction; `None`
    /// without droplets.
    pub fn mean_effective_radius(&self) -> Option<f64> {
        let droplets = self.microphysics.as_ref()?;
        let (mut sum, mut total) = (0.0, 0.0);
        for (water, radius) in droplets.liquid_water_content.iter().zip(&droplets.effective_radius)
        {
            // Extinction is proportional to liquid water content divided by effective radius.
            let (water, radius) = (f64::from(*water), f64::from(*radius));
            if water > 0.0 {
                sum += water;
                total += water / radius;
            }
        }
        (total > 0.0).then(|| sum / total)
    }

    /// A cloud given by its droplets.
    ///
    /// # Errors
    /// Returns an error if an array differs in shape from the grid, if a value is negative or
    /// not finite, or if a voxel holds water but has no effective radius.
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

    /// A cloud given by its extinction (1/km) only.
    ///
    /// # Errors
    /// Returns an error if an extinction is negative or not finite.
    pub fn from_extinction(extinction: Volume) -> Result<Self> {
        extinction.check_non_negative("extinction")?;
        Ok(Self { grid: extinction.grid, microphysics: None, extinction: Some(extinction.values) })
    }

    /// A cloud given by its extinction (1/km) and effective radius (um, `[z, y, x]`). The liquid
    /// water content follows from an extinction efficiency of 2.
    ///
    /// # Errors
    /// As [`Cloud::from_extinction`] and [`Cloud::from_microphysics`].
    pub fn from_extinction_and_radii(
        extinction: Volume,
        effective_radius: Array3<f32>,
    ) -> Result<Self> {
        let cloud = Self::from_extinction(extinction)?;
        cloud.grid.check_shape("the effective radius", effective_radius.shape())?;
        let extinctions = cloud.extinction.iter().flatten();
        let unknown =
            extinctions.zip(effective_radius.indexed_iter()).find(|(extinction, radius)| {
                **extinction > TRACE_EXTINCTION && !(LEAST_RADIUS..=MOST_RADIUS).contains(radius.1)
            });
        if let Some((extinction, ((k, j, i), radius))) = unknown {
            return Err(Error::out_of_range(
                "effective radius",
                format!(
                    "{radius} at voxel [z {k}, y {j}, x {i}], where the extinction is {extinction}"
                ),
                format!("from {LEAST_RADIUS} to {MOST_RADIUS} (um) where there is extinction"),
            ));
        }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::DVec3;

    /// Simulations have droplets of any size in traces of water.
    #[test]
    fn radii_in_traces_of_water_do_not_matter() {
        let grid = Grid::new(DVec3::ZERO, DVec3::splat(0.05), [1, 1, 2]).unwrap();
        let cloud = |extinction: f32, radius: f32| {
            let extinction = Volume::new(grid, ndarray::array![[[extinction, 10.0]]]).unwrap();
            Cloud::from_extinction_and_radii(extinction, ndarray::array![[[radius, 8.0]]])
        };
        assert!(cloud(4e-13, 7e-5).is_ok() && cloud(1e-4, 0.0).is_ok());
        assert!(cloud(1.0, 7e-5).is_err() && cloud(1.0, 1000.0).is_err());
    }
}
