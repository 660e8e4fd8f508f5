//! Formations of satellites that observe one cloud simultaneously.

use super::View;
use crate::error::{Error, Result};
use crate::math::{DVec3, towards};

/// Largest number of satellites of a formation.
const MOST_SATELLITES: i64 = 1000;

/// Mean radius of the Earth (km).
pub const EARTH_RADIUS_KM: f64 = 6371.0;

/// Satellites with identical cameras on one orbital arc over the scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Formation {
    /// Altitude of the orbit above the scene (km).
    pub altitude: f64,
    /// Azimuth of the flight direction, clockwise from north (radians).
    pub track_azimuth: f64,
    /// View zenith angle of each satellite at the scene (radians), negative for a satellite that
    /// has not yet passed over the scene.
    pub view_zeniths: Vec<f64>,
    /// Pixel size at nadir (km).
    pub pixel_km: f64,
}

/// View zenith angles of the 10 satellites (degrees; Sde-Chen et al. 2021, section 4.2).
const CLOUDCT_10_DEG: [f64; 10] = [-46.0, -34.0, -26.0, -18.0, -9.0, 0.0, 9.0, 18.0, 26.0, 34.0];

/// View zenith angles of the 32 satellites on the side of the track that has one satellite less,
/// starting at nadir (degrees; Sde-Chen et al. 2021, section 4.2).
const PEARLS_32_DEG: [f64; 16] =
    [0.0, 9.0, 18.0, 26.0, 34.0, 40.6, 46.0, 51.0, 55.2, 58.8, 62.0, 64.8, 67.4, 69.6, 71.7, 73.5];

impl Formation {
    /// The 10 views of Sde-Chen et al. (2021) after the CloudCT mission: a northbound orbit at
    /// 600 km with pixels of 50 m at nadir.
    pub fn cloudct_10() -> Self {
        Self::northbound(CLOUDCT_10_DEG.to_vec())
    }

    /// The 32 views of Sde-Chen et al. (2021): satellites 100 km apart on a northbound orbit at
    /// 600 km with pixels of 50 m at nadir.
    pub fn pearls_32() -> Self {
        let behind = PEARLS_32_DEG[1..].iter().rev().map(|angle| -angle);
        Self::northbound(
            std::iter::once(-75.2).chain(behind).chain(PEARLS_32_DEG.iter().copied()).collect(),
        )
    }

    fn northbound(view_zeniths_deg: Vec<f64>) -> Self {
        Self {
            altitude: 600.0,
            track_azimuth: 0.0,
            view_zeniths: view_zeniths_deg.into_iter().map(f64::to_radians).collect(),
            pixel_km: 0.05,
        }
    }

    /// The names of the presets.
    pub const PRESETS: [&'static str; 2] = ["cloudct-10", "pearls-32"];

    /// The preset with the given name.
    pub fn preset(name: &str) -> Option<Self> {
        match name {
            "cloudct-10" => Some(Self::cloudct_10()),
            "pearls-32" => Some(Self::pearls_32()),
            _ => None,
        }
    }

    /// A string-of-pearls formation: satellites at equal distances of `arc` km along an orbit at
    /// `altitude` km. The indices `satellites` are counted from the zenith of the scene, so that
    /// satellite 0 is overhead.
    ///
    /// A satellite at the geocentric angle `gamma` from the scene has the view zenith angle
    /// `atan2((R + h) sin gamma, (R + h) cos gamma - R)`.
    ///
    /// # Errors
    /// Returns an error if `altitude` or `arc` is not positive, if there is no satellite or more than
    /// 1000, or if the view zenith angle of a satellite exceeds 89 degrees.
    pub fn string_of_pearls(
        altitude: f64,
        arc: f64,
        satellites: std::ops::RangeInclusive<i32>,
    ) -> Result<Self> {
        for (name, value) in [("orbit altitude", altitude), ("distance between satellites", arc)] {
            if !(value.is_finite() && value > 0.0) {
                return Err(Error::out_of_range(name, value, "positive (km)"));
            }
        }
        let count = i64::from(*satellites.end()) - i64::from(*satellites.start()) + 1;
        if !(1..=MOST_SATELLITES).contains(&count) {
            let range = format!("from 1 to {MOST_SATELLITES}");
            return Err(Error::out_of_range("number of satellites", count.max(0), range));
        }
        let orbit = EARTH_RADIUS_KM + altitude;
        let view_zeniths: Vec<f64> = satellites
            .map(|k| {
                let gamma = f64::from(k) * arc / orbit;
                (orbit * gamma.sin()).atan2(orbit * gamma.cos() - EARTH_RADIUS_KM)
            })
            .collect();
        let worst = view_zeniths.iter().map(|zenith| zenith.abs()).reduce(f64::max);
        match worst {
            Some(zenith) if zenith.to_degrees() > 89.0 => Err(Error::out_of_range(
                "view zenith",
                format!("{:.1} degrees", zenith.to_degrees()),
                "at most 89 degrees: bring the satellites closer together",
            )),
            _ => Ok(Self { altitude, track_azimuth: 0.0, view_zeniths, pixel_km: 0.05 }),
        }
    }

    /// Distance (km) between the scene and a satellite at the view zenith angle `zenith` (radians).
    pub fn distance(&self, zenith: f64) -> f64 {
        distance_on_sphere(zenith, 0.0, self.altitude)
    }

    /// The views of `target` (km) with images of `[rows, cols]` pixels. All cameras have the field
    /// of view for which the pixel size at nadir is `pixel_km`.
    ///
    /// # Errors
    /// As [`View::perspective`].
    pub fn views(&self, target: DVec3, size: [usize; 2]) -> Result<Vec<View>> {
        self.view_zeniths
            .iter()
            .map(|&zenith| {
                let position = target + self.distance(zenith) * towards(zenith, self.track_azimuth);
                View::perspective(position, target, self.pixel_km / self.altitude, size)
            })
            .collect()
    }
}

/// Distance (km) from a point at the altitude `from` to one at the altitude `to` (km) above a
/// spherical Earth, which it sees at the angle `zenith` (radians); NaN if it cannot see it.
pub(super) fn distance_on_sphere(zenith: f64, from: f64, to: f64) -> f64 {
    let (radius, climb) = (EARTH_RADIUS_KM + from, to - from);
    let down = radius * zenith.cos();
    let root = (down * down + climb * (2.0 * radius + climb)).sqrt();
    if climb < 0.0 { -root - down } else { root - down }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The 17 angles that follow from a distance of 100 km along the orbit at 600 km; the list of
    /// Sde-Chen et al. (2021) contains rounded values.
    #[test]
    fn the_string_of_pearls_gives_the_angles_of_the_paper() {
        let expected = [
            0.0, 9.5, 18.5, 26.8, 34.2, 40.6, 46.2, 51.1, 55.2, 58.9, 62.1, 64.9, 67.4, 69.7, 71.7,
            73.6, 75.3,
        ];
        let pearls = Formation::string_of_pearls(600.0, 100.0, 0..=16).unwrap();
        for (zenith, angle) in pearls.view_zeniths.iter().zip(expected) {
            assert!((zenith.to_degrees() - angle).abs() < 0.051, "{} {angle}", zenith.to_degrees());
        }
        let ours = Formation::string_of_pearls(600.0, 100.0, -16..=15).unwrap().view_zeniths;
        let listed = Formation::pearls_32().view_zeniths;
        assert_eq!(listed.len(), 32);
        for (computed, listed) in ours.iter().zip(&listed) {
            assert!((computed - listed).to_degrees().abs() < 0.9, "{computed} {listed}");
        }
    }

    #[test]
    fn a_satellite_stands_on_its_orbit() {
        let formation = Formation::cloudct_10();
        for zenith in formation.view_zeniths.iter().copied() {
            let satellite = DVec3::new(0.0, 0.0, EARTH_RADIUS_KM)
                + formation.distance(zenith) * towards(zenith, 0.0);
            assert!((satellite.length() - EARTH_RADIUS_KM - 600.0).abs() < 1e-6);
        }
    }

    #[test]
    fn the_footprint_at_nadir_is_32_pixels_of_50_m() {
        let target = DVec3::new(0.8, 0.8, 1.0);
        let views = Formation::cloudct_10().views(target, [32, 32]).unwrap();
        assert!((views[5].pixel_km() - 0.05).abs() < 1e-12);
        assert!((views[5].zenith()).abs() < 1e-12);
        // Negative angles denote satellites to the south of the scene on the northbound track.
        assert!(views[0].towards().y < -0.7 && views[9].towards().y > 0.5);
    }

    #[test]
    fn impossible_formations_are_refused() {
        assert!(Formation::string_of_pearls(600.0, 100.0, 0..=40).is_err());
        assert!(Formation::string_of_pearls(-1.0, 100.0, 0..=4).is_err());
        #[allow(clippy::reversed_empty_ranges)]
        let none = Formation::string_of_pearls(600.0, 100.0, 1..=0);
        assert!(none.is_err());
    }
}
