//! Droplet size spectra in bins, as simulated by bin microphysics schemes.

use super::{LARGEST_RADIUS, Microphysics};
use crate::error::{Error, Result};
use ndarray::{Array3, Zip};
use std::f64::consts::PI;

/// Upper bound of the effective variance (dimensionless).
pub const LARGEST_VARIANCE: f32 = 2.0;

/// Sums over the size bins of a droplet spectrum in each voxel.
///
/// The effective radius and effective variance are the mean and the relative variance of the
/// radius, weighted by the cross-sectional area of the droplets: Hansen and Travis (1974),
/// equations 2.53 and 2.54.
#[derive(Debug, Clone, PartialEq)]
pub struct Spectrum {
    /// Liquid water content (g/m3).
    water: Array3<f64>,
    /// Sums of 1 / r and of r (r in um), weighted by liquid water content.
    inverse: Array3<f64>,
    radius: Array3<f64>,
}

/// The radii (um) of `count` bins in which the droplet mass doubles from one bin to the next:
/// 33 bins starting at 2 um end at 3.25 mm (Khain et al. 2004).
pub fn doubling_radii(smallest: f64, count: usize) -> Vec<f64> {
    (0..count).map(|bin| smallest * (bin as f64 / 3.0).exp2()).collect()
}

impl Spectrum {
    /// A spectrum without droplets on voxels `[z, y, x]`.
    pub fn empty(shape: [usize; 3]) -> Self {
        let zeros = Array3::zeros(shape);
        Self { water: zeros.clone(), inverse: zeros.clone(), radius: zeros }
    }

    /// Adds droplets of one radius (um) given by their liquid water content (g/m3, `[z, y, x]`).
    ///
    /// # Errors
    /// Returns an error if the radius is not positive and finite, if the shape differs from that
    /// of the spectrum, or if a liquid water content is negative or not finite.
    pub fn add_water(&mut self, radius: f64, water: &Array3<f32>) -> Result<()> {
        if !(radius.is_finite() && radius > 0.0) {
            return Err(Error::out_of_range("radius of a bin", radius, "positive (um)"));
        }
        if water.dim() != self.water.dim() {
            return Err(Error::mismatch(
                "shape [z, y, x] of a bin",
                format!("{:?}", self.water.dim()),
                format!("{:?}", water.dim()),
                "give all bins on the same voxels",
            ));
        }
        if let Some(wrong) = water.iter().find(|water| !(water.is_finite() && **water >= 0.0)) {
            let range = "finite and not negative (g/m3)";
            return Err(Error::out_of_range("liquid water of a bin", wrong, range));
        }
        let (inverse, radii) = (&mut self.inverse, &mut self.radius);
        Zip::from(&mut self.water).and(inverse).and(radii).and(water).for_each(
            |sum, inverse, radii, &water| {
                let water = f64::from(water);
                *sum += water;
                *inverse += water / radius;
                *radii += water * radius;
            },
        );
        Ok(())
    }

    /// Adds droplets of one radius (um) given by their number concentration (per cm3,
    /// `[z, y, x]`).
    ///
    /// # Errors
    /// As [`Spectrum::add_water`].
    pub fn add_number(&mut self, radius: f64, number: &Array3<f32>) -> Result<()> {
        // 1 um3 of water weighs 1e-12 g, and 1 per cm3 equals 1e6 per m3.
        let each = 1e-6 * 4.0 / 3.0 * PI * radius.powi(3);
        self.add_water(radius, &number.mapv(|number| (each * f64::from(number)) as f32))
    }

    /// The liquid water content, effective radius (at most [`LARGEST_RADIUS`]) and effective
    /// variance (at most [`LARGEST_VARIANCE`]) of each voxel. The latter two are zero without
    /// water.
    pub fn microphysics(&self) -> Microphysics {
        let ratio = |value: f64, water: f64| if water > 0.0 { value } else { 0.0 };
        let effective_radius =
            Zip::from(&self.water).and(&self.inverse).map_collect(|&water, &inverse| {
                (ratio(water / inverse, water) as f32).min(LARGEST_RADIUS)
            });
        // The area is proportional to water / r, so the area-weighted mean of r^2 is
        // radius / inverse.
        let effective_variance = Zip::from(&self.water)
            .and(&self.inverse)
            .and(&self.radius)
            .map_collect(|&water, &inverse, &radius| {
                let variance = ratio(radius * inverse / (water * water) - 1.0, water);
                (variance.max(0.0) as f32).min(LARGEST_VARIANCE)
            });
        Microphysics {
            liquid_water_content: self.water.mapv(|water| water as f32),
            effective_radius,
            effective_variance,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one(value: f32) -> Array3<f32> {
        Array3::from_elem((1, 1, 1), value)
    }

    #[test]
    fn bins_reach_from_two_micrometres_to_three_millimetres() {
        let radii = doubling_radii(2.0, 33);
        assert!((radii[3] - 4.0).abs() < 1e-12 && (radii[32] - 3251.0).abs() < 0.1);
    }

    /// Two droplets of 5 um for each one of 10 um, computed by hand: areas 50 and 100, volumes
    /// 250 and 1000, reff = 1250 / 150, and the variance of 5 and 10 with weights 1/3 and 2/3.
    #[test]
    fn two_sizes_by_hand() {
        let mut spectrum = Spectrum::empty([1, 1, 1]);
        spectrum.add_number(5.0, &one(60.0)).unwrap();
        spectrum.add_number(10.0, &one(30.0)).unwrap();
        let found = spectrum.microphysics();
        let mean = 25.0 / 3.0;
        let variance = ((5.0_f64 - mean).powi(2) + 2.0 * (10.0 - mean).powi(2)) / 3.0;
        assert!((f64::from(found.effective_radius[[0, 0, 0]]) - mean).abs() < 1e-5);
        let expected = variance / (mean * mean);
        assert!((f64::from(found.effective_variance[[0, 0, 0]]) - expected).abs() < 1e-6);
        let water = 4.0 / 3.0 * PI * (60.0 * 125.0 + 30.0 * 1000.0) * 1e-6;
        assert!((f64::from(found.liquid_water_content[[0, 0, 0]]) / water - 1.0).abs() < 1e-6);
    }

    /// A gamma distribution (Hansen and Travis 1974) of known effective radius and variance,
    /// in bins much narrower than the distribution.
    #[test]
    fn a_gamma_distribution_in_bins() {
        let (a, b) = (9.0_f64, 0.12_f64);
        let mut spectrum = Spectrum::empty([1, 1, 1]);
        for radius in (1..1200).map(|i| 0.05 * f64::from(i)) {
            let density = ((1.0 - 3.0 * b) / b * (radius / a).ln() - radius / (a * b)).exp();
            spectrum.add_number(radius, &one((1e4 * density) as f32)).unwrap();
        }
        let found = spectrum.microphysics();
        assert!((f64::from(found.effective_radius[[0, 0, 0]]) - a).abs() < 1e-4);
        assert!((f64::from(found.effective_variance[[0, 0, 0]]) - b).abs() < 1e-5);
    }

    #[test]
    fn drizzle_is_capped_and_clear_air_stays_clear() {
        let mut spectrum = Spectrum::empty([1, 1, 1]);
        assert_eq!(spectrum.microphysics().effective_radius, one(0.0));
        assert_eq!(spectrum.microphysics().effective_variance, one(0.0));
        spectrum.add_water(10.0, &one(0.02)).unwrap();
        spectrum.add_water(800.0, &one(0.5)).unwrap();
        let found = spectrum.microphysics();
        assert_eq!(found.effective_radius, one(LARGEST_RADIUS));
        assert_eq!(found.effective_variance, one(LARGEST_VARIANCE));
        assert!(spectrum.add_water(0.0, &one(0.1)).is_err());
        assert!(spectrum.add_water(3.0, &one(-0.1)).is_err());
        assert!(spectrum.add_water(3.0, &Array3::zeros((1, 1, 2))).is_err());
    }
}
