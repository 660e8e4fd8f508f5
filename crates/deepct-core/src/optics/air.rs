//! The molecular atmosphere: Rayleigh scattering in a standard atmosphere.
//!
//! The cross-section is that of Bodhaine, Wood, Dutton and Slusser (1999), "On Rayleigh
//! optical depth calculations", with its refractive index (Peck and Reeder 1972) and
//! depolarisation (Bates 1984). The density profile is that of the U.S. Standard Atmosphere 1976
//! (NOAA, NASA and USAF 1976).

use super::PhaseFunction;
use crate::error::{Error, Result};
use std::f64::consts::PI;

/// Volume mixing ratio of carbon dioxide (Bodhaine et al. 1999).
const CARBON_DIOXIDE: f64 = 360e-6;
/// Molecular number density (per cm3) at 288.15 K and 1013.25 hPa.
const STANDARD_NUMBER: f64 = 2.546_899e19;
/// Temperature and pressure at the surface of the standard atmosphere (K, hPa).
const SURFACE_TEMPERATURE: f64 = 288.15;
const SURFACE_PRESSURE: f64 = 1013.25;
/// Molar mass of air times standard gravity over the gas constant (K/km).
const HYDROSTATIC: f64 = 34.163_195;
/// The Earth's radius in the standard atmosphere (km).
const EARTH_RADIUS: f64 = 6356.766;
/// Altitude (km) above which the atmosphere, a fraction of 4e-6, is neglected.
const TOP: f64 = 86.0;
/// Geopotential altitude (km) of the base of each layer and its vertical temperature gradient
/// (K/km).
const LAYERS: [(f64, f64); 7] =
    [(0.0, -6.5), (11.0, 0.0), (20.0, 1.0), (32.0, 2.8), (47.0, 0.0), (51.0, -2.8), (71.0, -2.0)];

/// The molecular atmosphere at one wavelength, which scatters and does not absorb.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Air {
    cross_section: f64,
    depolarisation: f64,
}

impl Air {
    /// The molecular atmosphere at a wavelength (um).
    ///
    /// # Errors
    /// Returns an error if the wavelength is outside 0.2 to 4 um.
    pub fn new(wavelength: f64) -> Result<Self> {
        if !(0.2..=4.0).contains(&wavelength) {
            return Err(Error::out_of_range("wavelength", wavelength, "from 0.2 to 4 um"));
        }
        let king = king_factor(wavelength);
        // The King factor is F = (6 + 3 d) / (6 - 7 d) with the depolarisation factor d.
        let depolarisation = 6.0 * (king - 1.0) / (3.0 + 7.0 * king);
        Ok(Self { cross_section: cross_section(wavelength), depolarisation })
    }

    /// Scattering cross-section of a molecule (cm2).
    pub fn cross_section(&self) -> f64 {
        self.cross_section
    }

    /// Extinction (1/km) at an altitude above sea level (km); zero above 86 km.
    pub fn extinction(&self, altitude: f64) -> f64 {
        /// Centimetres per kilometre.
        const CM: f64 = 1e5;
        self.cross_section * number_density(altitude) * CM
    }

    /// Optical depth between two altitudes (km).
    pub fn optical_depth(&self, lower: f64, upper: f64) -> f64 {
        // Three-point Gauss-Legendre quadrature on intervals that are much thinner than the scale
        // height of about 7 km and do not cross the boundary between two layers.
        let reach = 0.5 * 0.6_f64.sqrt();
        let bottom = lower.min(TOP);
        let top = upper.min(TOP);
        let between = LAYERS.iter().map(|(base, _)| geometric(*base));
        let inner: Vec<f64> = between.filter(|z| *z > bottom && *z < top).collect();
        let ends = [vec![bottom], inner, vec![top]].concat();
        let mut sum = 0.0;
        for piece in ends.windows(2) {
            let count = (piece[1] - piece[0]).abs().ceil().max(1.0);
            let step = (piece[1] - piece[0]) / count;
            for number in 0..count as usize {
                let middle = piece[0] + (number as f64 + 0.5) * step;
                let at = |offset: f64| self.extinction(middle + offset * step);
                sum += step * (5.0 * at(-reach) + 8.0 * at(0.0) + 5.0 * at(reach)) / 18.0;
            }
        }
        sum
    }

    /// The Rayleigh phase function with the depolarisation factor of air.
    pub fn phase_function(&self) -> PhaseFunction {
        PhaseFunction::Rayleigh { depolarisation: self.depolarisation }
    }
}

/// The scattering cross-section (cm2): Bodhaine et al. (1999), equation 2.
fn cross_section(wavelength: f64) -> f64 {
    let square = refractive_index(wavelength).powi(2);
    let lorentz = (square - 1.0) / (square + 2.0);
    let length = 1e-4 * wavelength;
    24.0 * PI.powi(3) * lorentz.powi(2) / (length.powi(4) * STANDARD_NUMBER.powi(2))
        * king_factor(wavelength)
}

/// The refractive index of dry air at 288.15 K and 1013.25 hPa: Bodhaine et al. (1999),
/// equations 18 and 19.
fn refractive_index(wavelength: f64) -> f64 {
    let inverse = wavelength.powi(-2);
    let at_300_ppm = 8060.51 + 2_480_990.0 / (132.274 - inverse) + 17_455.7 / (39.329_57 - inverse);
    1.0 + 1e-8 * at_300_ppm * (1.0 + 0.54 * (CARBON_DIOXIDE - 300e-6))
}

/// The King factor, which accounts for the anisotropy of the molecules: Bodhaine et al. (1999),
/// equations 5, 6 and 23, weighted by the volume percentages of nitrogen, oxygen, argon and carbon
/// dioxide.
fn king_factor(wavelength: f64) -> f64 {
    let inverse = wavelength.powi(-2);
    let nitrogen = 1.034 + 3.17e-4 * inverse;
    let oxygen = 1.096 + 1.385e-3 * inverse + 1.448e-4 * inverse * inverse;
    let carbon_dioxide = 100.0 * CARBON_DIOXIDE;
    (78.084 * nitrogen + 20.946 * oxygen + 0.934 + 1.15 * carbon_dioxide)
        / (78.084 + 20.946 + 0.934 + carbon_dioxide)
}

/// Molecular number density (per cm3) at an altitude (km). The lowest layer is extrapolated below
/// sea level.
fn number_density(altitude: f64) -> f64 {
    if altitude > TOP {
        return 0.0;
    }
    let geopotential = EARTH_RADIUS * altitude / (EARTH_RADIUS + altitude);
    let (mut temperature, mut pressure) = (SURFACE_TEMPERATURE, SURFACE_PRESSURE);
    for (number, (base, lapse)) in LAYERS.into_iter().enumerate() {
        let end = LAYERS.get(number + 1).map_or(f64::INFINITY, |next| next.0);
        let thickness = geopotential.min(end) - base;
        let warmer = temperature + lapse * thickness;
        pressure *= if lapse == 0.0 {
            (-HYDROSTATIC * thickness / temperature).exp()
        } else {
            (temperature / warmer).powf(HYDROSTATIC / lapse)
        };
        temperature = warmer;
        if geopotential <= end {
            break;
        }
    }
    STANDARD_NUMBER * (pressure / SURFACE_PRESSURE) * (SURFACE_TEMPERATURE / temperature)
}

/// The geometric altitude (km) that corresponds to a geopotential altitude (km).
fn geometric(geopotential: f64) -> f64 {
    EARTH_RADIUS * geopotential / (EARTH_RADIUS - geopotential)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The reference is equation 29 of Bodhaine et al. (1999), a fit to their cross-sections that
    /// is accurate to 0.01 % from 0.25 to 0.85 um.
    #[test]
    fn cross_sections_follow_the_published_fit() {
        for step in 0..=12 {
            let wavelength = 0.25 + 0.05 * f64::from(step);
            let (square, inverse) = (wavelength * wavelength, wavelength.powi(-2));
            let fit = 1e-28 * (1.0455996 - 341.29061 * inverse - 0.90230850 * square)
                / (1.0 + 0.0027059889 * inverse - 85.968563 * square);
            let found = Air::new(wavelength).unwrap().cross_section();
            assert!((found / fit - 1.0).abs() < 3e-4, "{wavelength} um: {found}, not {fit}");
        }
    }

    /// The reference is equation 30 of Bodhaine et al. (1999) for sea level, 45 degrees north and
    /// 1013.25 hPa, with the gravity of their own standard atmospheric profile.
    #[test]
    fn the_whole_atmosphere_has_the_published_optical_depth() {
        for wavelength in [0.3, 0.412, 0.55, 0.672, 0.85] {
            let (square, inverse) = (wavelength * wavelength, f64::powi(wavelength, -2));
            let published = 0.0021520 * (1.0455996 - 341.29061 * inverse - 0.90230850 * square)
                / (1.0 + 0.0027059889 * inverse - 85.968563 * square);
            let found = Air::new(wavelength).unwrap().optical_depth(0.0, 100.0);
            assert!((found / published - 1.0).abs() < 1e-3, "{wavelength}: {found} {published}");
        }
    }

    /// The reference is table 1 of the U.S. Standard Atmosphere 1976: the ratio of the pressure to
    /// the surface pressure times 288.15 K over temperature, that is the ratio of the densities.
    #[test]
    fn density_is_that_of_the_standard_atmosphere() {
        for (altitude, ratio) in [
            (-1.0, 1.0996),
            (0.0, 1.0),
            (1.0, 9.0748e-1),
            (5.0, 6.0117e-1),
            (11.0, 2.9780e-1),
            (20.0, 7.2580e-2),
            (30.0, 1.5029e-2),
            (50.0, 8.3827e-4),
            (70.0, 6.7616e-5),
        ] {
            let found = number_density(altitude) / number_density(0.0);
            assert!((found / ratio - 1.0).abs() < 1e-4, "{altitude} km: {found}, not {ratio}");
        }
        assert_eq!(number_density(90.0), 0.0);
    }

    #[test]
    fn optical_depths_of_layers_add_up() {
        let air = Air::new(0.672).unwrap();
        let whole = air.optical_depth(-0.2, 90.0);
        let parts = air.optical_depth(-0.2, 1.3) + air.optical_depth(1.3, 90.0);
        assert!((whole - parts).abs() < 1e-7 * whole);
        let thin = air.optical_depth(0.999, 1.001) / 0.002;
        assert!((thin / air.extinction(1.0) - 1.0).abs() < 1e-6);
        assert!((air.optical_depth(1.0, 0.0) + air.optical_depth(0.0, 1.0)).abs() < 1e-15);
        assert_eq!(air.optical_depth(87.0, 95.0), 0.0);
    }

    #[test]
    fn air_depolarises_a_little_and_has_a_range() {
        let PhaseFunction::Rayleigh { depolarisation } = Air::new(0.55).unwrap().phase_function()
        else {
            panic!("air scatters as molecules do");
        };
        // Young (1980) gives 0.0279 in the visible.
        assert!((depolarisation - 0.0279).abs() < 1e-3, "{depolarisation}");
        assert!(Air::new(0.1).is_err() && Air::new(f64::NAN).is_err());
    }
}
