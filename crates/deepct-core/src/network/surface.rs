//! Images as they would be above the surface of the training.
//!
//! A network that was trained above one surface takes a brighter one for a cloud. The radiance of
//! the clear surface is estimated from the images and replaced by that of the training.

use crate::error::Result;
use crate::image::{ImagingGeometry, ViewStack};
use crate::math::{DVec3, towards};
use crate::optics::air::Air;
use ndarray::Array3;
use std::f64::consts::PI;

/// Share of the pixels, by the albedo that would explain them, below which the surface is found:
/// more than those in the shadow of the clouds, less than those that are not cloudy.
const CLEAR_SHARE: f64 = 0.25;

/// Largest albedo of a surface. Pixels that are brighter than that everywhere show clouds.
const LARGEST_ALBEDO: f64 = 0.3;

/// Radiance over the cosine of the solar zenith angle (1/sr), above that of the surface, at which a
/// cloud hides about two thirds of the surface.
const HIDING: f64 = 0.15;

/// Altitude above which the molecular atmosphere is neglected (km).
const TOP_KM: f64 = 86.0;

/// The radiance of a clear Lambertian surface as `path + albedo * factor`, with single scattering by
/// the molecular atmosphere.
#[derive(Debug, Clone, Copy)]
struct Clear {
    path: f64,
    factor: f64,
}

impl Clear {
    /// The radiances for the view towards `camera`, for a solar irradiance of 1; `depth` is the
    /// optical depth of the atmosphere.
    fn new(sun: DVec3, camera: DVec3, depth: f64) -> Self {
        let air_mass = 1.0 / sun.z + 1.0 / camera.z;
        let phase = 0.75 * (1.0 + sun.dot(camera).powi(2)) / (4.0 * PI);
        let scattered = 1.0 - (-depth * air_mass).exp();
        // Half of the light scattered by the atmosphere goes on in the forward hemisphere.
        let transmitted = (-0.5 * depth * air_mass).exp();
        Self {
            path: phase * sun.z / (sun.z + camera.z) * scattered,
            factor: sun.z / PI * transmitted,
        }
    }

    /// As [`Clear::new`], for each view.
    fn of_views(geometry: &ImagingGeometry) -> Result<Vec<Self>> {
        let views = &geometry.views;
        let direction =
            |zenith: f64, azimuth: f64| towards(zenith.to_radians(), azimuth.to_radians());
        let sun = direction(views.sun_zenith_deg, views.sun_azimuth_deg);
        let depth = Air::new(geometry.wavelength_um)?.optical_depth(0.0, TOP_KM);
        let angles = views.view_zenith_deg.iter().zip(&views.view_azimuth_deg);
        Ok(angles
            .map(|(zenith, azimuth)| Self::new(sun, direction(*zenith, *azimuth), depth))
            .collect())
    }
}

/// The albedo of the surface that explains the darkest pixels of all views together.
///
/// # Errors
/// A wavelength for which the molecular atmosphere is unknown.
pub(super) fn surface_albedo(images: &ViewStack, geometry: &ImagingGeometry) -> Result<f64> {
    Ok(albedo(images, &Clear::of_views(geometry)?, geometry.solar_irradiance))
}

/// As [`surface_albedo`], for a solar irradiance of `unit`.
fn albedo(images: &ViewStack, clear: &[Clear], unit: f64) -> f64 {
    let mut albedos: Vec<f32> = Vec::with_capacity(images.values.len());
    for (image, clear) in images.values.outer_iter().zip(clear) {
        let (path, scale) = ((clear.path * unit) as f32, (1.0 / (clear.factor * unit)) as f32);
        albedos.extend(image.iter().map(|radiance| (radiance - path) * scale));
    }
    let dark = (CLEAR_SHARE * albedos.len() as f64) as usize;
    let (_, &mut albedo, _) = albedos.select_nth_unstable_by(dark, f32::total_cmp);
    f64::from(albedo)
}

/// The images with the radiance of the clear surface replaced by that of a surface with the albedo
/// `reference`; `None` for a darker surface, or if no surface is visible.
///
/// # Errors
/// A wavelength for which the molecular atmosphere is unknown.
pub(super) fn above_surface(
    images: &ViewStack,
    geometry: &ImagingGeometry,
    reference: f64,
) -> Result<Option<ViewStack>> {
    let unit = geometry.solar_irradiance;
    let clear = Clear::of_views(geometry)?;
    let albedo = albedo(images, &clear, unit);
    // A network takes a brighter surface for a cloud, but not a darker one; where shadows cover much
    // of the images, the albedo that is found is too low.
    if !(reference..=LARGEST_ALBEDO).contains(&albedo) {
        return Ok(None);
    }
    let mut values: Array3<f32> = images.values.clone();
    for (mut image, clear) in values.outer_iter_mut().zip(&clear) {
        let surface = (unit * (clear.path + albedo * clear.factor)) as f32;
        let change = (unit * (reference - albedo) * clear.factor) as f32;
        let hiding =
            (-1.0 / (HIDING * geometry.views.sun_zenith_deg.to_radians().cos() * unit)) as f32;
        image.mapv_inplace(|radiance| {
            radiance + change * ((radiance - surface).max(0.0) * hiding).exp()
        });
    }
    Ok(Some(ViewStack::new(values)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::ViewGeometry;

    fn geometry(solar_irradiance: f64) -> ImagingGeometry {
        let views = ViewGeometry {
            sun_zenith_deg: 40.0,
            sun_azimuth_deg: 130.0,
            view_zenith_deg: vec![0.0, 35.0, 60.0],
            view_azimuth_deg: vec![0.0, 140.0, 320.0],
            pixel_km: vec![0.05; 3],
            camera_distance_km: vec![None; 3],
        };
        ImagingGeometry {
            views,
            target_km: [0.0, 0.0, 1.0],
            wavelength_um: 0.672,
            solar_irradiance,
            shifts: Vec::new(),
        }
    }

    /// A surface of an albedo with some bright pixels, under a solar irradiance.
    fn images(albedo: f64, irradiance: f64) -> ViewStack {
        let geometry = geometry(irradiance);
        let sun = towards(40_f64.to_radians(), 130_f64.to_radians());
        let depth = Air::new(0.672).unwrap().optical_depth(0.0, TOP_KM);
        let values = Array3::from_shape_fn((3, 10, 10), |(view, row, col)| {
            let camera = towards(
                geometry.views.view_zenith_deg[view].to_radians(),
                geometry.views.view_azimuth_deg[view].to_radians(),
            );
            let clear = Clear::new(sun, camera, depth);
            let cloud = if row > 6 && col > 6 { 0.3 } else { 0.0 };
            (irradiance * (clear.path + albedo * clear.factor + cloud)) as f32
        });
        ViewStack::new(values).unwrap()
    }

    /// A bright surface becomes the one of the training in whatever unit; thick clouds, which hide
    /// it, change less; images of a darker surface, or with large shadows, do not change.
    #[test]
    fn another_surface_becomes_that_of_the_training() {
        for irradiance in [1.0, 1500.0] {
            let (dark, bright) = (images(0.05, irradiance), images(0.2, irradiance));
            let found = above_surface(&bright, &geometry(irradiance), 0.05).unwrap().unwrap();
            let scale = irradiance as f32;
            for ((view, row, col), value) in found.values.indexed_iter() {
                let (wanted, before) =
                    (dark.values[[view, row, col]], bright.values[[view, row, col]]);
                if row > 6 && col > 6 {
                    assert!(*value > wanted && *value < before, "{value} {wanted} {before}");
                } else {
                    assert!((value - wanted).abs() < 1e-6 * scale, "{value} {wanted}");
                }
            }
            let darker = images(0.04, irradiance);
            assert!(above_surface(&darker, &geometry(irradiance), 0.05).unwrap().is_none());
        }
    }

    #[test]
    fn images_of_clouds_only_are_unchanged() {
        let overcast = images(0.6, 1.0);
        assert!(above_surface(&overcast, &geometry(1.0), 0.05).unwrap().is_none());
    }
}
