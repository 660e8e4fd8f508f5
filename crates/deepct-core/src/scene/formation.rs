//! Formations of satellites that look at one cloud together.

use super::View;
use crate::error::{Error, Result};
use crate::math::{DVec3, towards};

/// Mean radius of the Earth (km).
pub const EARTH_RADIUS_KM: f64 = 6371.0;

/// Satellites on one orbital arc over the scene, all with the same camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Formation {
    /// Altitude of the orbit (km).
    pub altitude: f64,
    /// Azimuth in which the track runs, clockwise from north (radians).
    pub track_azimuth: f64,
    /// View zenith of each satellite at the scene (radians); negative for one that
    /// is behind the scene on the track.
    pub view_zeniths: Vec<f64>,
    /// Size of a pixel on the ground at nadir (km).
    pub pixel_km: f64,
}

/// The view zeniths of the paper's 10 satellites (degrees; Sde-Chen et al. 2021,
/// section 4.2).
const CLOUDCT_10_DEG: [f64; 10] = [-46.0, -34.0, -26.0, -18.0, -9.0, 0.0, 9.0, 18.0, 26.0, 34.0];

/// The view zeniths of the paper's 32 satellites on the side of the track where the
/// list has one less (degrees; Sde-Chen et al. 2021, section 4.2).
const PEARLS_32_DEG: [f64; 16] =
    [0.0, 9.0, 18.0, 26.0, 34.0, 40.6, 46.0, 51.0, 55.2, 58.8, 62.0, 64.8, 67.4, 69.6, 71.7, 73.5];

impl Formation {
    /// The paper's 10 views, after the CloudCT mission: a northbound orbit at 600 km,
    /// pixels of 50 m at nadir.
    pub fn cloudct_10() -> Self {
        Self::northbound(CLOUDCT_10_DEG.to_vec())
    }

    /// The paper's 32 views: satellites 100 km apart on a northbound orbit at 600 km,
    /// pixels of 50 m at nadir.
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

    /// The preset of that name.
    pub fn preset(name: &str) -> Option<Self> {
        match name {
            "cloudct-10" => Some(Self::cloudct_10()),
            "pearls-32" => Some(Self::pearls_32()),
            _ => None,
        }
    }

    /// A string of pearls: satellite `k` of `satellites` flies `arc` km further along
    /// the orbit than the one before it, and number `overhead` is at the zenith.
    ///
    /// The scene sees a satellite at the geocentric angle `gamma` from it under the
    /// zenith angle `atan2((R + h) sin gamma, (R + h) cos gamma - R)`.
    ///
    /// # Errors
    /// An altitude or arc that is not positive, no satellite, or one below the
    /// horizon of the scene.
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
        let orbit = EARTH_RADIUS_KM + altitude;
        let view_zeniths: Vec<f64> = satellites
            .map(|k| {
                let gamma = f64::from(k) * arc / orbit;
                (orbit * gamma.sin()).atan2(orbit * gamma.cos() - EARTH_RADIUS_KM)
            })
            .collect();
        let worst = view_zeniths.iter().map(|zenith| zenith.abs()).reduce(f64::max);
        match worst {
            None => Err(Error::out_of_range("number of satellites", 0, "at least 1")),
            Some(zenith) if zenith.to_degrees() > 89.0 => Err(Error::out_of_range(
                "view zenith",
                format!("{:.1} degrees", zenith.to_degrees()),
                "at most 89 degrees: bring the satellites closer together",
            )),
            Some(_) => Ok(Self { altitude, track_azimuth: 0.0, view_zeniths, pixel_km: 0.05 }),
        }
    }

    /// Distance (km) between the scene and a satellite that it sees at `zenith`.
    pub fn distance(&self, zenith: f64) -> f64 {
        let down = EARTH_RADIUS_KM * zenith.cos();
        (down * down + self.altitude * (2.0 * EARTH_RADIUS_KM + self.altitude)).sqrt() - down
    }

    /// The views of `target` (km), all with images of `[rows, cols]` pixels. Every
    /// camera has the field of view that gives `pixel_km` from straight above.
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The 17 angles that follow from 100 km on the orbit at 600 km, which the
    /// paper's list rounds.
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
        // Negative angles are behind the scene on the northbound track: south.
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
