//! The local Cartesian system of a scene on the Earth.

use crate::error::{Error, Result};
use crate::math::DVec3;

/// Equatorial radius (km) and flattening of the ellipsoid WGS 84.
const EQUATORIAL_RADIUS: f64 = 6378.137;
const FLATTENING: f64 = 1.0 / 298.257_223_563;

/// Distances from the centre of the Earth (km) that are plausible for a camera above the atmosphere:
/// from the poles to beyond geostationary orbits.
const DISTANCES: std::ops::RangeInclusive<f64> = 6357.0..=100_000.0;

/// The position of a camera in the local system of a scene: x to the east, y to the north and z up,
/// along the vertical of the ellipsoid WGS 84, from the point of the ellipsoid with the geodetic
/// `latitude` and `longitude` (radians). `position` is Earth-centred and Earth-fixed (ECEF). Lengths
/// are in km.
///
/// The vertical towards the centre of the Earth differs by up to 0.19 degrees. Altitudes in the local
/// system refer to the ellipsoid, not to the geoid.
///
/// # Errors
/// Returns an error if the latitude is beyond a pole, if a number is not finite, if the distance from
/// the centre of the Earth is not that of a satellite, or if the camera is below the horizon.
pub fn camera_from_ecef(position: DVec3, latitude: f64, longitude: f64) -> Result<DVec3> {
    if !(latitude.abs() <= 90_f64.to_radians() && longitude.is_finite()) {
        let found = format!("{} and {}", latitude.to_degrees(), longitude.to_degrees());
        return Err(Error::out_of_range("latitude and longitude", found, "in degrees"));
    }
    if !DISTANCES.contains(&position.length()) {
        let range = "in km, from 6357 to 100000 km away from the centre of the Earth";
        return Err(Error::out_of_range("camera position", position, range));
    }
    let (sin_lat, cos_lat) = latitude.sin_cos();
    let (sin_lon, cos_lon) = longitude.sin_cos();
    let up = DVec3::new(cos_lat * cos_lon, cos_lat * sin_lon, sin_lat);
    let east = DVec3::new(-sin_lon, cos_lon, 0.0);
    let north = up.cross(east);
    // The radius of curvature in the prime vertical, along the vertical to the axis of the Earth.
    let eccentricity_squared = FLATTENING * (2.0 - FLATTENING);
    let radius = EQUATORIAL_RADIUS / (1.0 - eccentricity_squared * sin_lat * sin_lat).sqrt();
    let polar = 1.0 - eccentricity_squared;
    let offset = position - radius * up * DVec3::new(1.0, 1.0, polar);
    let local = DVec3::new(offset.dot(east), offset.dot(north), offset.dot(up));
    if local.z <= 0.0 {
        let problem = format!("{} km above the horizontal plane of the scene", local.z);
        return Err(Error::out_of_range("camera position", problem, "above the horizon"));
    }
    Ok(local)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn local(position: [f64; 3], latitude: f64, longitude: f64) -> DVec3 {
        camera_from_ecef(position.into(), latitude.to_radians(), longitude.to_radians()).unwrap()
    }

    #[test]
    fn a_satellite_is_seen_as_by_pymap3d() {
        // Skyfield 1.55 and pymap3d 3.2.0 give these angles and this distance.
        let found = local([5060.686587, 3417.321727, 3364.022757], 32.0, 35.0);
        assert!(found.distance(DVec3::new(-103.3845, -363.3982, 588.3358)) < 1e-6, "{found}");
        let zenith = found.truncate().length().atan2(found.z).to_degrees();
        let azimuth = found.x.atan2(found.y).to_degrees().rem_euclid(360.0);
        assert!((zenith - 32.70781).abs() < 1e-5 && (azimuth - 195.88072).abs() < 1e-5);
        assert!((found.length() - 699.2036).abs() < 1e-4);
    }

    #[test]
    fn the_vertical_is_that_of_the_ellipsoid() {
        let above = DVec3::new(0.0, 0.0, 600.0);
        for (position, latitude, longitude) in [
            ([6978.137, 0.0, 0.0], 0.0, 0.0),
            ([0.0, -6978.137, 0.0], 0.0, 270.0),
            // The semi-minor axis of WGS 84 is 6356.752314245 km.
            ([0.0, 0.0, 6_956.752_314_245], 90.0, 12.0),
            ([0.0, 0.0, -6_956.752_314_245], -90.0, 0.0),
        ] {
            let found = local(position, latitude, longitude);
            assert!(found.distance(above) < 1e-8, "{found}");
        }
    }

    #[test]
    fn positions_that_are_none_of_a_satellite_in_view_are_refused() {
        let refused = |position: [f64; 3], latitude: f64, names: &str| {
            let problem = camera_from_ecef(position.into(), latitude, 0.0).unwrap_err().to_string();
            assert!(problem.contains(names), "{problem}");
        };
        refused([6_978_137.0, 0.0, 0.0], 0.0, "in km");
        refused([0.0, 0.0, f64::NAN], 0.0, "in km");
        refused([6978.137, 0.0, 0.0], 32.0, "latitude");
        refused([-6978.137, 0.0, 0.0], 0.0, "above the horizon");
    }
}
