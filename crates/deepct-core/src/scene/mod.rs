//! The scene (medium, Sun, surface, molecular atmosphere) and the views of it.

mod formation;
mod light;
mod lines;
mod local;
mod meeting;
mod surface;
mod tiles;
mod view;
mod view_list;

pub use formation::{EARTH_RADIUS_KM, Formation};
pub use light::{DropletOpticsModel, ExtinctionModel, Light, LightTable, PhaseModel};
pub use lines::LinesOfSight;
pub use local::camera_from_ecef;
pub use meeting::Meeting;
pub use surface::{Surface, Waves};
pub use tiles::Tile;
pub(crate) use view::Projector;
pub use view::{Projection, View, target};
pub use view_list::{VIEW_FILE_HELP, ViewList};

use crate::error::{Error, Result};
use crate::image::{Image, ImagingGeometry, ViewGeometry, ViewStack, first_of_padded};
use crate::math::{DVec3, towards};
use crate::optics::air::Air;
use crate::optics::{Interpolation, Medium};
use ndarray::{Array3, Axis, Zip};
use std::borrow::Cow;

/// Difference of two altitudes (km) that is due to rounding.
const ROUNDING: f64 = 1e-9;

/// The Sun: a beam of parallel light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sun {
    /// Solar zenith angle (radians).
    pub zenith: f64,
    /// Azimuth towards the Sun, clockwise from north (radians).
    pub azimuth: f64,
    /// Irradiance on a surface normal to the beam.
    pub irradiance: f64,
}

impl Sun {
    /// A Sun of unit irradiance with zenith and azimuth angles in degrees.
    ///
    /// # Errors
    /// Returns an error if the zenith is outside `[0, 90)` degrees or the azimuth is not finite.
    pub fn from_degrees(zenith_deg: f64, azimuth_deg: f64) -> Result<Self> {
        if !(0.0..90.0).contains(&zenith_deg) {
            // Some codes state the direction in which light travels.
            let range = match zenith_deg {
                90.0..=180.0 => {
                    let (zenith, azimuth) =
                        (180.0 - zenith_deg, (azimuth_deg + 180.0).rem_euclid(360.0));
                    format!(
                        "in [0, 90) degrees; if it is that of the direction in which the light \
                         travels, give {zenith} and the azimuth towards the Sun, {azimuth}"
                    )
                }
                _ => "in [0, 90) degrees".into(),
            };
            return Err(Error::out_of_range("solar zenith", zenith_deg, range));
        }
        if !azimuth_deg.is_finite() {
            return Err(Error::out_of_range("solar azimuth", azimuth_deg, "finite (degrees)"));
        }
        let (zenith, azimuth) = (zenith_deg.to_radians(), azimuth_deg.to_radians());
        Ok(Self { zenith, azimuth, irradiance: 1.0 })
    }

    /// Unit vector from the scene towards the Sun.
    pub fn towards(&self) -> DVec3 {
        towards(self.zenith, self.azimuth)
    }
}

impl Default for Sun {
    /// The Sun of Sde-Chen et al. (2021): zenith 30 degrees, azimuth 45 degrees, unit irradiance.
    fn default() -> Self {
        let (zenith, azimuth) = (30_f64.to_radians(), 45_f64.to_radians());
        Self { zenith, azimuth, irradiance: 1.0 }
    }
}

/// The lateral boundary condition of the grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Boundary {
    /// Cloud-free surroundings: light enters and leaves through the sides.
    #[default]
    Open,
    /// Periodic continuation of the grid in both horizontal directions.
    Periodic,
}

/// The complete input of a forward model apart from the views.
#[derive(Debug, Clone)]
pub struct Scene {
    /// The cloud as a scattering medium.
    pub medium: Medium,
    /// The Sun.
    pub sun: Sun,
    /// The surface below the cloud.
    pub surface: Surface,
    /// The lateral boundary condition.
    pub boundary: Boundary,
    /// The molecular atmosphere around and above the cloud; `None` omits it.
    pub air: Option<Air>,
    /// Vertical optical depth of the absorbing gases above the cloud.
    pub gas_optical_depth: f64,
}

impl Scene {
    /// A scene with open sides and without molecular atmosphere.
    ///
    /// # Errors
    /// Returns an error if the surface albedo is outside `[0, 1]`, or if the surface is above the
    /// bottom of the medium.
    pub fn new(medium: Medium, sun: Sun, surface: Surface) -> Result<Self> {
        surface.check()?;
        let bottom = medium.extinction.grid.lower().z;
        if surface.altitude.is_nan() || surface.altitude > bottom + ROUNDING {
            return Err(Error::out_of_range(
                "surface altitude",
                format!("{} km", surface.altitude),
                format!("at or below the bottom of the grid ({bottom} km)"),
            ));
        }
        let (boundary, air, gas_optical_depth) = (Boundary::Open, None, 0.0);
        Ok(Self { medium, sun, surface, boundary, air, gas_optical_depth })
    }

    /// The factor of what a line of sight shows: the solar irradiance that gases above the cloud let
    /// through and, of what is seen from above, the share that they let through on the way back.
    pub(crate) fn brightness(&self, line_of_sight: DVec3) -> f64 {
        let seen = if line_of_sight.z < 0.0 { -1.0 / line_of_sight.z } else { 0.0 };
        let paths = 1.0 / self.sun.towards().z + seen;
        self.sun.irradiance * (-self.gas_optical_depth * paths).exp()
    }

    /// The same scene with the given lateral boundary condition.
    pub fn with_boundary(self, boundary: Boundary) -> Self {
        Self { boundary, ..self }
    }

    /// The same scene with an extinction that is linear between the centres of voxels.
    ///
    /// # Errors
    /// Returns an error if the outermost voxels are not clear: a trilinear medium ends at their
    /// centres, so that half of them would be lost. Those at periodic sides continue.
    pub fn with_trilinear_extinction(mut self) -> Result<Self> {
        let axes: &[usize] = if self.boundary == Boundary::Periodic { &[0] } else { &[0, 1, 2] };
        let extinction = &self.medium.extinction.values;
        let outermost = axes.iter().flat_map(|&axis| {
            let axis = Axis(axis);
            [0, extinction.len_of(axis) - 1].map(|index| extinction.index_axis(axis, index))
        });
        if outermost.flatten().any(|value| *value != 0.0) {
            let range =
                "0, as a trilinear medium ends at their centres: surround it by clear voxels";
            return Err(Error::out_of_range("extinction in the outermost voxels", "not 0", range));
        }
        self.medium.interpolation = Interpolation::Trilinear;
        Ok(self)
    }

    /// The same scene with a molecular atmosphere.
    pub fn with_air(self, air: Air) -> Self {
        Self { air: Some(air), ..self }
    }
}

/// The images of a scene with their scene illumination and views: the content of an image file,
/// and the only information available to a reconstruction.
#[derive(Debug, Clone, PartialEq)]
pub struct Observation {
    /// The scene illumination.
    pub light: Light,
    /// Keys of [`LightTable`] whose values are assumed because they were not specified. Images of
    /// a real instrument specify only the Sun and the wavelength.
    pub assumed: Vec<String>,
    /// The views, one per image.
    pub views: Vec<View>,
    /// Radiance (1/sr); NaN for pixels that are missing or left out, such as defective ones.
    pub images: ViewStack,
    /// Standard error of the radiance (1/sr), infinite for missing pixels; `None` if it is unknown.
    pub standard_error: Option<ViewStack>,
    /// Pixels that are saturated, `[view, row, col]`: they are at least as bright as their radiance.
    /// `None` if no pixel is known to be.
    pub saturated: Option<Array3<bool>>,
    /// Whether the rendering of the images was interrupted.
    pub incomplete: bool,
}

/// Largest plausible radiance (1/sr) for a solar irradiance of 1. That of clouds is below 1, that of
/// the sea glint below 100.
const BRIGHTEST: f32 = 100.0;
/// Largest plausible magnitude of a negative radiance relative to the largest positive one.
const DARKEST: f32 = 10.0;

/// Returns an error if a radiance is one that neither light nor noise explains, but the code of a
/// missing value.
fn check_radiances(images: &ViewStack, irradiance: f64) -> Result<()> {
    let brightest = images.brightest();
    let most = BRIGHTEST * irradiance as f32;
    let implausible =
        |value: f32| value > most || (brightest > 0.0 && value < -DARKEST * brightest);
    match images.values.indexed_iter().find(|(_, value)| implausible(**value)) {
        None => Ok(()),
        Some(((view, row, col), value)) => Err(Error::out_of_range(
            "radiance",
            format!("{value} at [view {view}, row {row}, col {col}]"),
            format!(
                "a radiance of sunlight (at most {most} for the solar irradiance {irradiance}): it \
                 may be the code of a missing value, or in another unit than the irradiance"
            ),
        )),
    }
}

/// Largest angle (degrees) between lines of sight that count as parallel: they are half a pixel of 50 m apart
/// at the ends of a cloud that extends 0.7 km above and below the target.
const PARALLEL_DEG: f64 = 2.0;

/// The bilinear interpolation between pixel centres; NaN outside of the image and beside missing pixels.
fn interpolated(image: Image<'_>, (row, col): (f64, f64)) -> f32 {
    let size = [image.nrows(), image.ncols()];
    let at = [row, col];
    if (0..2).any(|axis| !(0.0..=size[axis] as f64).contains(&at[axis])) {
        return f32::NAN;
    }
    let centre = [0, 1].map(|axis| (at[axis] - 0.5).clamp(0.0, (size[axis] - 1) as f64));
    let first = [0, 1].map(|axis| (centre[axis] as usize).min(size[axis].saturating_sub(2)));
    let part = [0, 1].map(|axis| (centre[axis] - first[axis] as f64) as f32);
    let next = [0, 1].map(|axis| (first[axis] + 1).min(size[axis] - 1));
    let line =
        |row: usize| (1.0 - part[1]) * image[[row, first[1]]] + part[1] * image[[row, next[1]]];
    (1.0 - part[0]) * line(first[0]) + part[0] * line(next[0])
}

/// Whether an image consists of one of this size in the middle of missing pixels.
fn is_padded(image: Image<'_>, [rows, cols]: [usize; 2]) -> bool {
    let [top, left] = first_of_padded([rows, cols], [image.nrows(), image.ncols()]);
    let is_inside =
        |row, col| (top..top + rows).contains(&row) && (left..left + cols).contains(&col);
    image.indexed_iter().all(|((row, col), radiance)| is_inside(row, col) || radiance.is_nan())
}

impl Observation {
    /// An observation without standard error. If `light` is a [`Sun`], all other properties of the
    /// scene illumination have their default values.
    ///
    /// # Errors
    /// Returns an error if the number or the size of the images does not match the views, or if a
    /// radiance is not that of sunlight. Views may be smaller than the images if these are padded
    /// ([`ViewStack::of_images`]).
    pub fn new(light: impl Into<Light>, views: Vec<View>, images: ViewStack) -> Result<Self> {
        let [count, rows, cols] = images.shape();
        if views.len() != count {
            return Err(Error::mismatch(
                "number of views",
                views.len(),
                count,
                "give one image per view",
            ));
        }
        let sized = |(view, image): (View, Image<'_>)| {
            let size = [view.rows, view.cols];
            let padded = view.padded([rows, cols]).ok();
            padded.filter(|_| is_padded(image, size)).ok_or_else(|| {
                Error::mismatch(
                    "image size [row, col]",
                    format!("{size:?}"),
                    format!("[{rows}, {cols}]"),
                    "give images of the size that the views specify",
                )
            })
        };
        let views = views.into_iter().zip(images.values.outer_iter()).map(sized);
        let views = views.collect::<Result<_>>()?;
        let light = light.into();
        check_radiances(&images, light.sun.irradiance)?;
        Ok(Self {
            light,
            assumed: Vec::new(),
            views,
            images,
            standard_error: None,
            saturated: None,
            incomplete: false,
        })
    }

    /// The observation with the standard error of its radiances (1/sr). Pixels whose error is infinite or
    /// not a number become missing.
    ///
    /// # Errors
    /// Returns an error if an error is negative, or if they do not have the shape of the images.
    pub fn with_standard_error(self, errors: Array3<f32>) -> Result<Self> {
        let mut errors = errors;
        if errors.dim() != self.images.values.dim() {
            return Err(Error::mismatch(
                "shape [view, row, col] of the standard error",
                format!("{:?}", self.images.shape()),
                format!("{:?}", errors.shape()),
                "give one standard error per pixel",
            ));
        }
        let mut images = self.images;
        Zip::from(&mut errors).and(&mut images.values).for_each(|error, radiance| {
            if radiance.is_nan() || error.is_nan() || *error == f32::INFINITY {
                (*error, *radiance) = (f32::INFINITY, f32::NAN);
            }
        });
        let standard_error = Some(ViewStack::of_errors(errors)?);
        let known = Self { images, standard_error, saturated: None, ..self };
        match self.saturated {
            Some(saturated) => known.with_saturated(saturated),
            None => Ok(known),
        }
    }

    /// The observation with its saturated pixels marked. Missing pixels are not.
    ///
    /// # Errors
    /// Returns an error if the marks do not have the shape of the images.
    pub fn with_saturated(self, saturated: Array3<bool>) -> Result<Self> {
        if saturated.dim() != self.images.values.dim() {
            return Err(Error::mismatch(
                "shape [view, row, col] of the saturated pixels",
                format!("{:?}", self.images.shape()),
                format!("{:?}", saturated.shape()),
                "mark every pixel",
            ));
        }
        let mut saturated = saturated;
        saturated
            .zip_mut_with(&self.images.values, |marked, radiance| *marked &= !radiance.is_nan());
        let any = saturated.iter().any(|marked| *marked);
        Ok(Self { saturated: any.then_some(saturated), ..self })
    }

    /// The observation without the pixels `[view, row, col]` that `is_left_out` selects: they become
    /// missing.
    #[must_use]
    pub fn without(mut self, is_left_out: impl Fn([usize; 3]) -> bool) -> Self {
        for ((view, row, col), radiance) in self.images.values.indexed_iter_mut() {
            if is_left_out([view, row, col]) {
                *radiance = f32::NAN;
                if let Some(errors) = &mut self.standard_error {
                    errors.values[[view, row, col]] = f32::INFINITY;
                }
                if let Some(saturated) = &mut self.saturated {
                    saturated[[view, row, col]] = false;
                }
            }
        }
        self
    }

    /// Whether the radiance of each pixel is known, `[view, row, col]`: it is neither missing nor
    /// saturated, and its standard error is below the brightest radiance, so that it tells cloud from
    /// clear sky.
    pub fn known(&self) -> Array3<bool> {
        let mut known = self.images.missing().mapv(|missing| !missing);
        if let Some(errors) = &self.standard_error {
            let brightest = self.images.brightest();
            let most = if brightest > 0.0 { brightest } else { f32::INFINITY };
            known.zip_mut_with(&errors.values, |known, error| *known &= *error < most);
        }
        if let Some(saturated) = &self.saturated {
            known.zip_mut_with(saturated, |known, saturated| *known &= !saturated);
        }
        known
    }

    /// The observation as networks need it: images with a line of sight for each pixel are interpolated to
    /// those of orthographic cameras, with pixels on the horizontal plane through the common target.
    ///
    /// # Errors
    /// Returns an error if there is no common target, or if the lines of sight of an image are so far from
    /// parallel that an orthographic camera does not see the same.
    pub fn on_ideal_cameras(&self) -> Result<Cow<'_, Self>> {
        let is_ideal = |view: &View| !matches!(view.projection, Projection::LinesOfSight { .. });
        if self.views.iter().all(is_ideal) {
            return Ok(Cow::Borrowed(self));
        }
        let (mut observation, target) = (self.clone(), target(&self.views)?);
        let chosen = self.views.iter().enumerate().filter(|(_, view)| !is_ideal(view));
        for (number, view) in chosen {
            let aimed = view.aimed_at(target)?;
            let spread = aimed.spread().to_degrees();
            if spread > PARALLEL_DEG {
                return Err(Error::out_of_range(
                    "lines of sight",
                    format!("up to {spread:.2} degrees from that of the target in view {number}"),
                    format!(
                        "within {PARALLEL_DEG} degrees for a network: give smaller images, or use invert"
                    ),
                ));
            }
            let size = [view.rows, view.cols];
            let ideal = View::orthographic(aimed.towards(), target, aimed.pixel_km(), size)?
                .with_shift(aimed.shift)?;
            let image = self.images.image(number);
            let mut resampled = observation.images.values.index_axis_mut(Axis(0), number);
            for ((row, col), radiance) in resampled.indexed_iter_mut() {
                let ray = ideal.ray(row as f64 + 0.5, col as f64 + 0.5);
                let point = ray.at((target.z - ray.origin.z) / ray.direction.z);
                let place = view.project(point);
                *radiance = place.map_or(f32::NAN, |place| interpolated(image, place));
            }
            observation.views[number] = ideal;
        }
        (observation.standard_error, observation.saturated) = (None, None);
        Ok(Cow::Owned(observation))
    }

    /// The solar and viewing geometry as plain numbers.
    pub fn geometry(&self) -> ViewGeometry {
        view_geometry(&self.light.sun, &self.views)
    }

    /// The solar and viewing geometry, target (km) and wavelength (um) as plain numbers.
    ///
    /// # Errors
    /// As [`imaging_geometry`].
    pub fn imaging_geometry(&self) -> Result<ImagingGeometry> {
        imaging_geometry(&self.light, &self.views)
    }
}

/// Distance (pixels) of the target from the centre of an image that is neglected.
const CENTRED: f64 = 0.02;

/// The solar and viewing geometry, target (km) and wavelength (um) as plain numbers. The angles are
/// those at the common target.
///
/// # Errors
/// Returns an error if the images do not show a common target, or if a camera is so near that
/// images of another point cannot be described by the angles at the common one.
pub fn imaging_geometry(light: &Light, views: &[View]) -> Result<ImagingGeometry> {
    let target = target(views)?;
    let at_target: Vec<View> =
        views.iter().map(|view| view.aimed_at(target)).collect::<Result<_>>()?;
    let shifts: Vec<[f64; 2]> = at_target.iter().map(|view| view.shift).collect();
    let is_centred = shifts.iter().flatten().all(|pixels| pixels.abs() < CENTRED);
    Ok(ImagingGeometry {
        views: view_geometry(&light.sun, &at_target),
        target_km: target.to_array(),
        shifts: if is_centred { Vec::new() } else { shifts },
        wavelength_um: light.wavelength,
        solar_irradiance: light.sun.irradiance,
    })
}

/// The solar and viewing geometry as plain numbers (degrees, km).
pub fn view_geometry(sun: &Sun, views: &[View]) -> ViewGeometry {
    ViewGeometry {
        sun_zenith_deg: sun.zenith.to_degrees(),
        sun_azimuth_deg: sun.azimuth.to_degrees(),
        view_zenith_deg: views.iter().map(|view| view.zenith().to_degrees()).collect(),
        view_azimuth_deg: views.iter().map(|view| view.azimuth().to_degrees()).collect(),
        pixel_km: views.iter().map(View::pixel_km).collect(),
        camera_distance_km: views.iter().map(View::distance_km).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sun_stands_in_the_north_east() {
        let sun = Sun::default().towards();
        assert!((sun.x - 0.353_553).abs() < 1e-6 && (sun.y - 0.353_553).abs() < 1e-6);
        assert!((sun.z - 0.866_025).abs() < 1e-6);
        let problem = Sun::from_degrees(165.0, 90.0).unwrap_err().to_string();
        assert!(problem.contains("give 15 and the azimuth towards the Sun, 270"), "{problem}");
        assert!(Sun::from_degrees(f64::NAN, 0.0).is_err());
    }
}
