//! The refractive index of liquid water.

use crate::error::{Error, Result};
use num_complex::Complex64;

/// Wavelength (um), real and imaginary part of the refractive index at 25 degrees Celsius: Hale
/// and Querry (1973), "Optical constants of water in the 200-nm to 200-um wavelength region",
/// table I.
const TABLE: [(f64, f64, f64); 40] = [
    (0.200, 1.396, 1.10e-7),
    (0.225, 1.373, 4.90e-8),
    (0.250, 1.362, 3.35e-8),
    (0.275, 1.354, 2.35e-8),
    (0.300, 1.349, 1.60e-8),
    (0.325, 1.346, 1.08e-8),
    (0.350, 1.343, 6.50e-9),
    (0.375, 1.341, 3.50e-9),
    (0.400, 1.339, 1.86e-9),
    (0.425, 1.338, 1.30e-9),
    (0.450, 1.337, 1.02e-9),
    (0.475, 1.336, 9.35e-10),
    (0.500, 1.335, 1.00e-9),
    (0.525, 1.334, 1.32e-9),
    (0.550, 1.333, 1.96e-9),
    (0.575, 1.333, 3.60e-9),
    (0.600, 1.332, 1.09e-8),
    (0.625, 1.332, 1.39e-8),
    (0.650, 1.331, 1.64e-8),
    (0.675, 1.331, 2.23e-8),
    (0.700, 1.331, 3.35e-8),
    (0.725, 1.330, 9.15e-8),
    (0.750, 1.330, 1.56e-7),
    (0.775, 1.330, 1.48e-7),
    (0.800, 1.329, 1.25e-7),
    (0.825, 1.329, 1.82e-7),
    (0.850, 1.329, 2.93e-7),
    (0.875, 1.328, 3.91e-7),
    (0.900, 1.328, 4.86e-7),
    (0.925, 1.328, 1.06e-6),
    (0.950, 1.327, 2.93e-6),
    (0.975, 1.327, 3.48e-6),
    (1.000, 1.327, 2.89e-6),
    (1.200, 1.324, 9.89e-6),
    (1.400, 1.321, 1.38e-4),
    (1.600, 1.317, 8.55e-5),
    (1.800, 1.312, 1.15e-4),
    (2.000, 1.306, 1.10e-3),
    (2.200, 1.296, 2.89e-4),
    (2.400, 1.279, 9.56e-4),
];

/// The refractive index `n + i k` of liquid water at a wavelength (um) after Hale and Querry
/// (1973). `n` and the logarithm of `k` are interpolated linearly between their wavelengths.
///
/// # Errors
/// Returns an error if the wavelength is outside 0.2 to 2.4 um.
pub fn water_refractive_index(wavelength: f64) -> Result<Complex64> {
    let (first, last) = (TABLE[0].0, TABLE[TABLE.len() - 1].0);
    if !(first..=last).contains(&wavelength) {
        let range = format!("from {first} to {last} um, where the index of water is tabulated");
        return Err(Error::out_of_range("wavelength", wavelength, range));
    }
    let above = TABLE.partition_point(|row| row.0 <= wavelength).min(TABLE.len() - 1);
    let (a, b) = (TABLE[above - 1], TABLE[above]);
    let fraction = (wavelength - a.0) / (b.0 - a.0);
    let real = a.1 + fraction * (b.1 - a.1);
    let imaginary = a.2 * (b.2 / a.2).powf(fraction);
    Ok(Complex64::new(real, imaginary))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_index_is_the_published_one_and_in_between() {
        for (wavelength, real, imaginary) in TABLE {
            let found = water_refractive_index(wavelength).unwrap();
            assert!((found.re - real).abs() < 1e-12);
            assert!((found.im / imaginary - 1.0).abs() < 1e-9);
        }
        let red = water_refractive_index(0.672).unwrap();
        assert!((red.re - 1.331).abs() < 1e-12 && (red.im - 2.15e-8).abs() < 2e-10, "{red}");
        assert!(water_refractive_index(0.1).is_err() && water_refractive_index(3.0).is_err());
    }
}
