//! The surface below the scene, an infinite horizontal plane.

use crate::error::{Error, Result};
use crate::math::DVec3;
use crate::optics::water_refractive_index;
use crate::rng::{RngExt, Stream};
use std::f64::consts::PI;

/// The refractive index of sea water at 0.55 um (Quan and Fry 1995).
const SEA_WATER: f64 = 1.34;
/// The index of sea water minus that of pure water (Quan and Fry 1995; Friedman 1969 measured 0.006
/// in the infrared).
const SALT: f64 = 0.0065;
/// Lowest altitude of a surface (km), below any on Earth.
const LOWEST: f64 = -12.0;

/// A Lambertian surface, which in addition reflects light like an ocean surface roughened by wind
/// if it has [`Waves`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surface {
    /// Lambertian albedo in `[0, 1]`. For an ocean surface with waves it represents the light that
    /// emerges from the water.
    pub albedo: f64,
    /// Altitude of the plane (km), at or below the bottom of the medium.
    pub altitude: f64,
    /// The waves that reflect light specularly; `None` for a purely Lambertian surface.
    pub waves: Option<Waves>,
}

/// The ocean surface as an ensemble of specular facets whose slopes depend on the wind speed (Cox
/// and Munk 1954), with mutual shadowing at grazing angles (Smith 1967). Foam is not included, and
/// light that is reflected by a second facet is lost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Waves {
    /// Wind speed (m/s).
    wind_speed: f64,
    /// Mean square slope, the sum of the components along and across the wind.
    slope_variance: f64,
    /// The refractive index of the water.
    index: f64,
}

impl Surface {
    /// A black surface.
    pub const BLACK: Self = Self::lambertian(0.0);
    /// The dark ocean surface in the simulations of Sde-Chen et al. (2021).
    pub const OCEAN: Self = Self::lambertian(0.05);

    /// A Lambertian surface at sea level.
    pub const fn lambertian(albedo: f64) -> Self {
        Self { albedo, altitude: 0.0, waves: None }
    }

    /// Returns an error unless the albedo is between 0 and 1, and the altitude one on Earth.
    pub(super) fn check(&self) -> Result<()> {
        if !(0.0..=1.0).contains(&self.albedo) {
            return Err(Error::out_of_range("surface albedo", self.albedo, "between 0 and 1"));
        }
        if !(self.altitude.is_finite() && self.altitude >= LOWEST) {
            let range = format!("at least {LOWEST} km, above the deepest sea floor");
            return Err(Error::out_of_range("surface_altitude_km", self.altitude, range));
        }
        Ok(())
    }

    /// The same surface at a wavelength (um), on which the refractive index of water depends.
    ///
    /// # Errors
    /// As [`Waves::at`].
    pub fn at(self, wavelength: f64) -> Result<Self> {
        let waves = self.waves.map(|waves| waves.at(wavelength)).transpose()?;
        Ok(Self { waves, ..self })
    }

    /// Whether the surface reflects no light.
    pub fn is_black(&self) -> bool {
        self.albedo == 0.0 && self.waves.is_none()
    }

    /// The bidirectional reflectance distribution function (1/sr) for two directions that point
    /// away from the surface.
    #[inline]
    pub fn reflectance(&self, one: DVec3, other: DVec3) -> f64 {
        let mirrored = self.waves.map_or(0.0, |waves| waves.reflectance(one, other));
        self.albedo / PI + mirrored
    }
}

impl Waves {
    /// The waves for a wind speed (m/s) at 12.5 m above the ocean surface, with the mean square
    /// slope of a clean surface independent of wind direction (Cox and Munk 1954), in green light.
    ///
    /// # Errors
    /// Returns an error if the wind speed is outside 0.5 to 20 m/s; Cox and Munk measured at 1 to
    /// 14 m/s.
    pub fn new(wind_speed: f64) -> Result<Self> {
        if !(0.5..=20.0).contains(&wind_speed) {
            return Err(Error::out_of_range("wind speed", wind_speed, "from 0.5 to 20 m/s"));
        }
        let slope_variance = 0.003 + 0.00512 * wind_speed;
        Ok(Self { wind_speed, slope_variance, index: SEA_WATER })
    }

    /// The same waves at a wavelength (um).
    ///
    /// # Errors
    /// Returns an error if the wavelength is outside 0.2 to 4 um.
    pub fn at(self, wavelength: f64) -> Result<Self> {
        Ok(Self { index: water_refractive_index(wavelength)?.re + SALT, ..self })
    }

    /// The wind speed (m/s).
    pub fn wind_speed(&self) -> f64 {
        self.wind_speed
    }

    /// The bidirectional reflectance distribution function (1/sr) for two directions that point
    /// away from the surface: the density of facets whose normal bisects the directions, times the
    /// Fresnel reflectance and the shadowing factor, divided by four times both cosines.
    #[inline]
    pub fn reflectance(&self, one: DVec3, other: DVec3) -> f64 {
        if one.z <= 0.0 || other.z <= 0.0 {
            return 0.0;
        }
        let facing = (one + other).normalize();
        let density = self.facing_density(facing.z);
        let seen = 1.0 / (1.0 + self.hidden(one.z) + self.hidden(other.z));
        fresnel(facing.dot(one), self.index) * density * seen / (4.0 * one.z * other.z)
    }

    /// Samples the direction into which light that arrives from the direction `away` is reflected.
    /// The facet is drawn in proportion to its horizontally projected area. The direction may point
    /// downwards; such light is lost.
    #[inline]
    pub fn sample(&self, away: DVec3, rng: &mut Stream) -> DVec3 {
        let steepness = (-self.slope_variance * (1.0 - rng.random::<f64>()).ln()).sqrt();
        let (sine, cosine) = (2.0 * PI * rng.random::<f64>()).sin_cos();
        let facing = DVec3::new(steepness * cosine, steepness * sine, 1.0).normalize();
        2.0 * facing.dot(away) * facing - away
    }

    /// The probability density (1/sr) with which [`Waves::sample`] returns `other`.
    #[inline]
    pub fn sample_density(&self, away: DVec3, other: DVec3) -> f64 {
        let facing = (away + other).normalize();
        if facing.z <= 0.0 {
            return 0.0;
        }
        self.facing_density(facing.z) * facing.z / (4.0 * facing.dot(away).abs())
    }

    /// Area of the facets per horizontal area and per solid angle of their normal (1/sr), as a
    /// function of the cosine of the zenith angle of the normal.
    #[inline]
    fn facing_density(&self, cosine: f64) -> f64 {
        let square = cosine * cosine;
        (-(1.0 - square) / (square * self.slope_variance)).exp()
            / (PI * self.slope_variance * square * square)
    }

    /// Ratio of the shadowed to the visible area of the facets as a function of the cosine of the
    /// zenith angle: the rational fit to Smith's function by Walter et al. (2007), section 5.2.
    #[inline]
    fn hidden(&self, cosine: f64) -> f64 {
        let a = cosine / ((1.0 - cosine * cosine).max(1e-12) * self.slope_variance).sqrt();
        if a >= 1.6 {
            return 0.0;
        }
        (1.0 - 1.259 * a + 0.396 * a * a) / (3.535 * a + 2.181 * a * a)
    }
}

/// The Fresnel reflectance for unpolarised light incident from air on a medium with a refractive
/// index, as a function of the cosine of the angle of incidence.
#[inline]
fn fresnel(cosine: f64, index: f64) -> f64 {
    let inside = (1.0 - (1.0 - cosine * cosine) / (index * index)).sqrt();
    let across = (cosine - index * inside) / (cosine + index * inside);
    let along = (index * cosine - inside) / (index * cosine + inside);
    0.5 * (across * across + along * along)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::towards;
    use crate::rng::{Purpose, stream};

    #[test]
    fn straight_on_water_reflects_two_per_cent() {
        assert!((fresnel(1.0, 1.34) - (0.34_f64 / 2.34).powi(2)).abs() < 1e-12);
        assert!((fresnel(1e-9, 1.34) - 1.0).abs() < 1e-6);
        // At Brewster's angle only light polarised normal to the plane of incidence is reflected.
        let brewster = 1.34_f64.atan().cos();
        let across = ((1.0_f64 - 1.34 * 1.34) / (1.0 + 1.34 * 1.34)).powi(2);
        assert!((fresnel(brewster, 1.34) - 0.5 * across).abs() < 1e-12);
    }

    /// The glint in the shortwave infrared, where water refracts less, is a fifth darker than in
    /// red light.
    #[test]
    fn the_glint_depends_on_the_wavelength() {
        let direction = towards(0.3, 0.0);
        let glint = |wavelength| {
            let waves = Waves::new(5.0).unwrap().at(wavelength).unwrap();
            waves.reflectance(direction, towards(0.3, PI))
        };
        let index = |pure: f64| ((pure + 0.0065 - 1.0) / (pure + 0.0065 + 1.0)).powi(2);
        let expected = index(1.2949) / index(1.3308);
        assert!((glint(2.1) / glint(0.672) / expected - 1.0).abs() < 2e-3, "{expected}");
        assert!(Waves::new(5.0).unwrap().at(10.0).is_err());
    }

    #[test]
    fn a_surface_is_on_earth() {
        for altitude in [f64::NEG_INFINITY, f64::NAN, -500.0] {
            assert!(Surface { altitude, ..Surface::OCEAN }.check().is_err(), "{altitude}");
        }
        Surface { altitude: -0.4, ..Surface::OCEAN }.check().unwrap();
    }

    #[test]
    fn light_may_go_both_ways() {
        let waves = Waves::new(7.0).unwrap();
        let (one, other) = (towards(0.5, 1.0), towards(0.7, 3.8));
        assert!((waves.reflectance(one, other) - waves.reflectance(other, one)).abs() < 1e-15);
        assert!(waves.reflectance(one, other) > 0.03);
    }

    /// The reflectance times the cosine over the probability density of a sampled direction.
    fn weight(waves: &Waves, away: DVec3, rng: &mut Stream) -> f64 {
        let other = waves.sample(away, rng);
        let wanted = waves.reflectance(away, other) * other.z;
        if wanted > 0.0 { wanted / waves.sample_density(away, other) } else { 0.0 }
    }

    /// The mean weight of sampled directions and the integral of the reflectance times the cosine
    /// on a fine grid of directions are both equal to the reflected flux.
    #[test]
    fn drawn_directions_have_the_reflectance() {
        for (wind, zenith) in [(2.0, 0.3), (7.0, 0.9), (12.0, 1.3)] {
            let waves = Waves::new(wind).unwrap();
            let away = towards(zenith, 0.4);
            let mut rng = stream(3, Purpose::Transport, &[]);
            let (draws, mut sum, mut squares) = (200_000, 0.0, 0.0);
            for _ in 0..draws {
                let weight = weight(&waves, away, &mut rng);
                sum += weight;
                squares += weight * weight;
            }
            let mean = sum / f64::from(draws);
            let error = ((squares / f64::from(draws) - mean * mean) / f64::from(draws)).sqrt();
            let (rings, sectors) = (1500, 1500);
            let mut flux = 0.0;
            for ring in 0..rings {
                let cosine = (f64::from(ring) + 0.5) / f64::from(rings);
                for sector in 0..sectors {
                    let azimuth = 2.0 * PI * (f64::from(sector) + 0.5) / f64::from(sectors);
                    flux += cosine * waves.reflectance(away, towards(cosine.acos(), azimuth));
                }
            }
            flux *= 2.0 * PI / f64::from(rings * sectors);
            let allowed = 4.0 * error + 1e-3 * flux;
            assert!((mean - flux).abs() < allowed, "{wind} m/s: {mean} +- {error}, {flux}");
            assert!(flux > 0.015 && flux < 1.0);
        }
    }

    /// At normal incidence, a calm ocean surface reflects the fraction given by Fresnel.
    #[test]
    fn a_calm_sea_is_a_mirror() {
        let waves = Waves::new(0.5).unwrap();
        let mut rng = stream(4, Purpose::Transport, &[]);
        let draws = 20_000;
        let sum: f64 = (0..draws).map(|_| weight(&waves, DVec3::Z, &mut rng)).sum();
        assert!((sum / f64::from(draws) / fresnel(1.0, 1.34) - 1.0).abs() < 0.01);
        assert!(Waves::new(0.0).is_err() && Waves::new(f64::NAN).is_err());
    }
}
