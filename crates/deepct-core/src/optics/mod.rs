//! Optics: what a cloud does to light, voxel by voxel.
//!
//! [`Medium`] is what the transport room sees: extinction by voxel, and what a
//! collision does ([`Scattering`]): single-scattering albedo and phase function, the
//! same everywhere or by the size of each voxel's droplets ([`DropletTable`]).

pub mod air;
mod droplet_table;
mod phase;
mod scattering;

pub use droplet_table::{DropletOptics, DropletTable, Mixture};
pub use phase::{PhaseFunction, PhaseTable};
pub use scattering::{Collision, Scattering};

use crate::cloud::Cloud;
use crate::error::{Error, Result};
use crate::grid::Volume;

/// The asymmetry parameter of water clouds at visible wavelengths: Mie theory gives
/// 0.861 for an effective radius of 10 um at 672 nm.
pub const CLOUD_ASYMMETRY: f64 = 0.86;

/// How extinction varies between the values of a grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
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

    /// The medium that a cloud is in visible light: nothing absorbed, the forward
    /// peak of droplets of about 10 um.
    ///
    /// # Errors
    /// As [`extinction`].
    pub fn from_cloud(cloud: &Cloud) -> Result<Self> {
        Self::new(extinction(cloud)?, 1.0, PhaseFunction::henyey_greenstein(CLOUD_ASYMMETRY)?)
    }
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
    use crate::cloud::Microphysics;
    use crate::grid::Grid;
    use crate::math::DVec3;
    use ndarray::Array3;

    #[test]
    fn a_third_of_a_gram_in_droplets_of_ten_micrometres() {
        let grid = Grid::new(DVec3::ZERO, DVec3::ONE, [1, 1, 2]).unwrap();
        let at = |value| Array3::from_shape_vec((1, 1, 2), vec![value, 0.0]).unwrap();
        let droplets = Microphysics {
            liquid_water_content: at(0.3),
            effective_radius: at(10.0),
            effective_variance: at(0.1),
        };
        let cloud = Cloud::from_microphysics(grid, droplets).unwrap();
        let extinction = extinction(&cloud).unwrap();
        assert!((extinction.values[[0, 0, 0]] - 45.0).abs() < 1e-4);
        assert_eq!(extinction.values[[0, 0, 1]], 0.0);
    }
}
