//! The refractive index of liquid water.

use crate::error::{Error, Result};
use num_complex::Complex64;
use std::sync::LazyLock;

/// Wavelength (um), real and imaginary part of the refractive index at 25 degrees Celsius:
/// Segelstein (1981), "The complex refractive index of water", University of Missouri, in whose
/// table the bands of absorption are resolved.
static TABLE: LazyLock<Vec<[f64; 3]>> = LazyLock::new(|| {
    let row = |line: &str| -> [f64; 3] {
        let mut numbers = line.split(' ').map(|number| number.parse().expect("a number"));
        std::array::from_fn(|_| numbers.next().expect("three numbers"))
    };
    include_str!("water.txt").lines().map(row).collect()
});

/// The wavelengths (um) of the index.
const RANGE: [f64; 2] = [0.2, 4.0];

/// The wavelength (um) up to which the real part is that of the dispersion formula, and that from
/// which on it is that of the table. Between the fundamental bands beyond 2.5 um the formula has
/// no meaning; at shorter wavelengths it agrees better with measurements of the refraction than
/// the table, which is 0.005 lower at 1.6 um.
const FORMULA_TO: f64 = 2.2;
const TABLE_FROM: f64 = 2.3;

/// The refractive index `n + i k` of liquid water at a wavelength (um). `k` is that of Segelstein
/// (1981), whose logarithm is interpolated linearly. `n` is that of Kedenburg et al. (2012, Optical
/// Materials Express 2, 1588) up to 2.2 um, and that of Segelstein from 2.3 um.
///
/// # Errors
/// Returns an error if the wavelength is outside 0.2 to 4 um.
pub fn water_refractive_index(wavelength: f64) -> Result<Complex64> {
    let [first, last] = RANGE;
    if !(first..=last).contains(&wavelength) {
        let range = format!("from {first} to {last} um, where the index of water is tabulated");
        return Err(Error::out_of_range("wavelength", wavelength, range));
    }
    let [real, imaginary] = tabulated(wavelength);
    let share = ((wavelength - FORMULA_TO) / (TABLE_FROM - FORMULA_TO)).clamp(0.0, 1.0);
    let measured = if share < 1.0 { dispersion(wavelength.min(FORMULA_TO)) } else { real };
    Ok(Complex64::new(measured + share * (real - measured), imaginary))
}

fn tabulated(wavelength: f64) -> [f64; 2] {
    let above = TABLE.partition_point(|row| row[0] <= wavelength).clamp(1, TABLE.len() - 1);
    let ([a, n, k], [b, next_n, next_k]) = (TABLE[above - 1], TABLE[above]);
    let share = (wavelength - a) / (b - a);
    [n + share * (next_n - n), k * (next_k / k).powf(share)]
}

/// The dispersion formula of Kedenburg et al. (2012) for 20 degrees Celsius.
fn dispersion(wavelength: f64) -> f64 {
    let square = wavelength * wavelength;
    let terms = [(0.75831, 0.01007), (0.08495, 8.91377)];
    (1.0 + terms.iter().map(|(b, c)| b * square / (square - c)).sum::<f64>()).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The smallest and largest of the imaginary parts of four measured sets (Segelstein 1981,
    /// Wang 2008, Kedenburg 2012, Rowe 2020).
    const ABSORPTION: [(f64, f64, f64); 11] = [
        (1.05, 1.40e-6, 1.40e-6),
        (1.1, 1.66e-6, 1.74e-6),
        (1.24, 1.13e-5, 1.15e-5),
        (1.375, 5.1e-5, 6.6e-5),
        (1.45, 3.2e-4, 3.8e-4),
        (1.6, 9.3e-5, 9.9e-5),
        (1.65, 7.6e-5, 8.1e-5),
        (1.94, 1.9e-3, 2.1e-3),
        (2.0, 1.10e-3, 1.10e-3),
        (2.13, 3.9e-4, 4.3e-4),
        (2.25, 3.8e-4, 3.8e-4),
    ];

    #[test]
    fn absorption_is_within_the_measured_sets() {
        for (wavelength, least, most) in ABSORPTION {
            let found = water_refractive_index(wavelength).unwrap().im;
            assert!((0.97 * least..1.1 * most).contains(&found), "{wavelength}: {found}");
        }
    }

    /// Refraction in the visible (Hale and Querry 1973, table I) and at 2.1 um, where measured sets
    /// are between 1.292 and 1.297.
    #[test]
    fn refraction_is_the_measured_one() {
        for (wavelength, expected) in
            [(0.4, 1.339), (0.5, 1.335), (0.6, 1.332), (0.675, 1.331), (0.8, 1.329), (1.0, 1.327)]
        {
            let found = water_refractive_index(wavelength).unwrap().re;
            assert!((found - expected).abs() < 0.006, "{wavelength}: {found}");
        }
        let sodium = water_refractive_index(0.5893).unwrap().re;
        assert!((sodium - 1.3330).abs() < 5e-4, "{sodium}");
        let infrared = water_refractive_index(2.1).unwrap().re;
        assert!((1.292..=1.297).contains(&infrared), "{infrared}");
    }

    #[test]
    fn the_index_is_continuous_and_bounded_by_the_table() {
        let index = |wavelength| water_refractive_index(wavelength).unwrap();
        for number in 0..3800 {
            let wavelength = 0.2 + 1e-3 * f64::from(number);
            let (one, next) = (index(wavelength), index((wavelength + 1e-3).min(4.0)));
            assert!((next.re - one.re).abs() < 0.012, "{wavelength}: {one} {next}");
            assert!((0.4..2.5).contains(&(next.im / one.im)), "{wavelength}: {one} {next}");
        }
        assert!(water_refractive_index(0.19).is_err() && water_refractive_index(4.1).is_err());
        assert!(water_refractive_index(f64::NAN).is_err());
    }
}
