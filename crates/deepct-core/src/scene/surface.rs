//! The surface below the scene, an infinite horizontal plane.

use crate::error::{Error, Result};
use crate::math::DVec3;
use crate::rng::{RngExt, Stream};
use std::f64::consts::PI;

/// The refractive index of sea water in visible light (Quan and Fry 1995: 1.34 at 550 nm).
const WATER: f64 = 1.34;

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

    /// Returns an error unless the albedo is between 0 and 1.
    pub(super) fn check(&self) -> Result<()> {
        if (0.0..=1.0).contains(&self.albedo) {
            return Ok(());
        }
        Err(Error::out_of_range("surface albedo", self.albedo, "between 0 and 1"))
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
    /// slope of a clean surface independent of wind direction (Cox and Munk 1954).
    ///
    /// # Errors
    /// Returns an error if the wind speed is outside 0.5 to 20 m/s; Cox and Munk measured at 1 to
    /// 14 m/s.
    pub fn new(wind_speed: f64) -> Result<Self> {
        if !(0.5..=20.0).contains(&wind_speed) {
            return Err(Error::out_of_range("wind speed", wind_speed, "from 0.5 to 20 m/s"));
        }
        Ok(Self { wind_speed, slope_variance: 0.003 + 0.00512 * wind_speed })
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
        fresnel(facing.dot(one)) * density * seen / (4.0 * one.z * other.z)
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

/// The Fresnel reflectance for unpolarised light incident from air, as a function of the cosine of
/// the angle of incidence.
#[inline]
fn fresnel(cosine: f64) -> f64 {
    let inside = (1.0 - (1.0 - cosine * cosine) / (WATER * WATER)).sqrt();
    let across = (cosine - WATER * inside) / (cosine + WATER * inside);
    let along = (WATER * cosine - inside) / (WATER * cosine + inside);
    0.5 * (across * across + along * along)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::towards;
    use crate::rng::{Purpose, stream};

    #[test]
    fn straight_on_water_reflects_two_per_cent() {
        assert!((fresnel(1.0) - (0.34_f64 / 2.34).powi(2)).abs() < 1e-12);
        assert!((fresnel(1e-9) - 1.0).abs() < 1e-6);
        // At Brewster's angle only light polarised normal to the plane of incidence is reflected.
        let brewster = WATER.atan().cos();
        let across = ((1.0 - WATER * WATER) / (1.0 + WATER * WATER)).powi(2);
        assert!((fresnel(brewster) - 0.5 * across).abs() < 1e-12);
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
        assert!((sum / f64::from(draws) / fresnel(1.0) - 1.0).abs() < 0.01);
        assert!(Waves::new(0.0).is_err() && Waves::new(f64::NAN).is_err());
    }
}
