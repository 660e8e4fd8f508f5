//! Effective radius from liquid water content and droplet number concentration.

use super::{EFFECTIVE_VARIANCE, Microphysics};
use crate::error::{Error, Result};
use ndarray::Array3;

/// Upper bound of the effective radius (um). Larger droplets collide and fall out as drizzle,
/// and the default tables of droplet optics end at 25 um.
pub const LARGEST_RADIUS: f32 = 20.0;

/// The factor k, the cube of the ratio of volume-mean radius to effective radius: 0.80 in
/// maritime and 0.67 in continental stratocumulus (Martin, Johnson and Spice 1994).
const SHAPE_FACTOR: f64 = 0.8;

/// The density of liquid water (g/m3).
const WATER_DENSITY: f64 = 1e6;

/// The effective radius (um) for a liquid water content `water` (g/m3) and a droplet number
/// concentration `number` (per cm3): `reff = (3 LWC / (4 pi rho_w k N))^(1/3)` with k = 0.8
/// (Martin, Johnson and Spice 1994, "The measurement and parameterization of effective radius
/// of droplets in warm stratocumulus clouds", equation 10). The result is at most
/// [`LARGEST_RADIUS`], and zero without water.
pub fn effective_radius(water: f32, number: f64) -> f32 {
    let per_cubic_metre = 1e6 * number;
    let cube = 3.0 * f64::from(water)
        / (4.0 * std::f64::consts::PI * WATER_DENSITY * SHAPE_FACTOR * per_cubic_metre);
    ((1e6 * cube.cbrt()) as f32).min(LARGEST_RADIUS)
}

impl Microphysics {
    /// Droplets with a uniform number concentration (per cm3) and a given liquid water content
    /// (g/m3, `[z, y, x]`). The effective variance is 0.1.
    ///
    /// # Errors
    /// Returns an error if the number concentration is not from 0.1 to 100,000 per cm3.
    pub fn from_droplet_number(liquid_water_content: Array3<f32>, number: f64) -> Result<Self> {
        if !(0.1..=1e5).contains(&number) {
            let range =
                "from 0.1 to 100000 per cm3 (the sea has about 50, the land several hundred)";
            return Err(Error::out_of_range("droplet number", number, range));
        }
        let effective_radius =
            liquid_water_content.mapv(|water| self::effective_radius(water, number));
        let effective_variance =
            Array3::from_elem(liquid_water_content.raw_dim(), EFFECTIVE_VARIANCE);
        Ok(Self { liquid_water_content, effective_radius, effective_variance })
    }

    /// Droplets with a uniform effective radius (um), for a cloud of which only the extinction
    /// is known. The liquid water content is set to 1 g/m3, which has no effect if the
    /// extinction is given, and the effective variance to 0.1.
    pub fn of_one_size(shape: [usize; 3], effective_radius: f32) -> Self {
        Self {
            liquid_water_content: Array3::ones(shape),
            effective_radius: Array3::from_elem(shape, effective_radius),
            effective_variance: Array3::from_elem(shape, EFFECTIVE_VARIANCE),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Droplets of volume-mean radius r have a liquid water content of `N 4/3 pi r^3 rho`, and
    /// their effective radius is `r / k^(1/3)`.
    #[test]
    fn the_water_of_a_known_number_of_droplets() {
        let (radius, number) = (8e-6_f64, 120.0);
        let water = 1e6 * number * 4.0 / 3.0 * std::f64::consts::PI * radius.powi(3) * 1e6;
        let expected = 1e6 * radius / 0.8_f64.cbrt();
        let found = f64::from(effective_radius(water as f32, number));
        assert!((found - expected).abs() < 1e-5 * expected, "{found} um, not {expected}");
    }

    #[test]
    fn the_radius_has_a_cap_and_is_zero_without_water() {
        assert_eq!(effective_radius(0.0, 100.0), 0.0);
        assert_eq!(effective_radius(1e3, 10.0), LARGEST_RADIUS);
        assert!(Microphysics::from_droplet_number(Array3::zeros((1, 1, 1)), 0.0).is_err());
    }
}
