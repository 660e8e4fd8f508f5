//! Images with their cameras and scene illumination.

use super::light::{get_light, put_light};
use super::write::{Attribute::*, Output};
use super::{Input, Provenance};
use crate::error::{Error, Result};
use crate::image::ViewStack;
use crate::math::DVec3;
use crate::scene::{Observation, Projection, View};
use ndarray::{Array1, Array2, ArrayD};
use std::path::Path;

/// The dimensions of images.
const PIXELS: [&str; 3] = ["view", "row", "col"];

/// The parameters of all cameras, with one entry or row (x, y, z) per view.
struct Cameras {
    orthographic: Vec<i8>,
    position: Array2<f64>,
    direction: Array2<f64>,
    target: Array2<f64>,
    pixel_tangent: Vec<f64>,
    pixel_km: Vec<f64>,
}

/// Write images: `radiance(view, row, col)` (sr-1) and, if known, `radiance_standard_error`; for
/// each view, the zenith and azimuth angles, position, direction, target, projection and pixel
/// size of the camera; and the scene illumination.
///
/// # Errors
/// Returns an error if the file cannot be written.
pub fn write_observation(
    path: impl AsRef<Path>,
    observation: &Observation,
    provenance: &Provenance,
) -> Result<()> {
    let mut output = Output::create(path.as_ref(), provenance)?;
    put_observation(&mut output, observation)?;
    output.finish()
}

/// Add images to a file that is being written.
pub(super) fn put_observation(output: &mut Output, observation: &Observation) -> Result<()> {
    let [views, rows, cols] = observation.images.shape();
    output.counted("view", views, "index of the view")?;
    output.counted("row", rows, "pixel row, increasing northwards")?;
    output.counted("col", cols, "pixel column, increasing eastwards")?;
    output.counted("component", 3, "components x (east), y (north), z (up)")?;
    let radiance = [("units", Text("sr-1")), ("long_name", Text("radiance"))];
    output.variable("radiance", &PIXELS, &observation.images.values, &radiance)?;
    if let Some(error) = &observation.standard_error {
        let attributes =
            [("units", Text("sr-1")), ("long_name", Text("standard error of radiance"))];
        output.variable("radiance_standard_error", &PIXELS, &error.values, &attributes)?;
    }
    write_cameras(output, &observation.views)?;
    put_light(output, observation)
}

/// Read images that [`write_observation`] wrote. All numbers are reproduced exactly.
///
/// # Errors
/// Returns an error if the file is missing, damaged or of another type, if radiances are not
/// finite, if the parameters of a camera or of the Sun are out of range, or if the angles are
/// inconsistent with the position of the camera.
pub fn read_observation(path: impl AsRef<Path>) -> Result<Observation> {
    let path = path.as_ref();
    let input = Input::open(path)?;
    let relative = is_relative_to_the_irradiance(&input)?;
    let stack = |name| -> Result<ViewStack> {
        let variable = input.variable_on(name, &PIXELS)?;
        let values =
            if relative { variable.reals_3d()? } else { variable.reals_3d_of_layout("sr-1")? };
        ViewStack::new(values).map_err(|problem| {
            input.error(name, problem.to_string(), "write images without missing pixels")
        })
    };
    let images = stack("radiance")?;
    let error = "radiance_standard_error";
    let standard_error = if input.has(error) { Some(stack(error)?) } else { None };
    let views = read_views(&input, images.shape())?;
    let (light, assumed) = get_light(&input)?;
    let mut observation = Observation::new(light, views, images)
        .map_err(|problem| input.error("radiance", problem.to_string(), "write it again"))?;
    if standard_error.as_ref().is_some_and(|error| error.shape() != observation.images.shape()) {
        return Err(input.error(error, "has another shape than radiance", "write it again"));
    }
    (observation.assumed, observation.standard_error) = (assumed, standard_error);
    Ok(observation)
}

/// Whether the radiances have the unit of the solar irradiance per steradian, other than `sr-1`.
fn is_relative_to_the_irradiance(input: &Input) -> Result<bool> {
    if !input.has("sun_irradiance") || !input.has("radiance") {
        return Ok(false);
    }
    let parts = |text: String| -> Vec<String> {
        let mut parts: Vec<_> = text
            .split([' ', '.', '*'])
            .filter(|part| !part.is_empty())
            .map(str::to_owned)
            .collect();
        parts.sort();
        parts
    };
    let irradiance = input.variable("sun_irradiance")?.unit_text();
    let Some(irradiance) = irradiance.filter(|text| text != "1") else { return Ok(false) };
    let radiance = input.variable("radiance")?;
    if parts(radiance.unit_text().unwrap_or_default()) == parts(format!("{irradiance} sr-1")) {
        return Ok(true);
    }
    let unit = format!("{irradiance} sr-1");
    Err(radiance.wrong_unit(&unit, &unit))
}

fn write_cameras(output: &Output, views: &[View]) -> Result<()> {
    let cameras = Cameras::of(views);
    let vectors = ["view", "component"];
    let (zenith, azimuth): (Vec<_>, Vec<_>) =
        views.iter().map(|view| (view.zenith().to_degrees(), view.azimuth().to_degrees())).unzip();
    output.variable(
        "view_zenith_deg",
        &["view"],
        &zenith,
        &[
            ("units", Text("degree")),
            ("long_name", Text("angle at the target between the zenith and the camera")),
            ("standard_name", Text("sensor_zenith_angle")),
        ],
    )?;
    output.variable(
        "view_azimuth_deg",
        &["view"],
        &azimuth,
        &[
            ("units", Text("degree")),
            ("long_name", Text("azimuth at the target towards the camera, clockwise from north")),
            ("standard_name", Text("sensor_azimuth_angle")),
        ],
    )?;
    let km = |long_name| [("units", Text("km")), ("long_name", Text(long_name))];
    let one = |long_name| [("units", Text("1")), ("long_name", Text(long_name))];
    output.variable(
        "projection",
        &["view"],
        &cameras.orthographic,
        &[
            ("long_name", Text("camera projection")),
            ("flag_values", Flags(&[0, 1])),
            ("flag_meanings", Text("perspective orthographic")),
        ],
    )?;
    let position = km("camera position; missing for an orthographic camera");
    output.variable("camera_position", &vectors, &cameras.position, &position)?;
    let direction = one("unit vector from the target towards the camera");
    output.variable("camera_direction", &vectors, &cameras.direction, &direction)?;
    let target = km("point at the centre of the image");
    output.variable("target", &vectors, &cameras.target, &target)?;
    let tangent = one("ratio of pixel size to focal length; missing for an orthographic camera");
    output.variable("pixel_tangent", &["view"], &cameras.pixel_tangent, &tangent)?;
    let size = km("size of a pixel at the target");
    output.variable("pixel_km", &["view"], &cameras.pixel_km, &size)
}

impl Cameras {
    fn of(views: &[View]) -> Self {
        let row = |vector: DVec3| vector.to_array();
        let rows = |vectors: Vec<[f64; 3]>| Array2::from(vectors);
        let nowhere = DVec3::splat(f64::NAN);
        let (position, pixel_tangent): (Vec<_>, Vec<_>) = views
            .iter()
            .map(|view| match view.projection {
                Projection::Perspective { position, pixel_tangent } => {
                    (row(position), pixel_tangent)
                }
                Projection::Orthographic { .. } => (row(nowhere), f64::NAN),
            })
            .unzip();
        let is_orthographic =
            |view: &View| i8::from(matches!(view.projection, Projection::Orthographic { .. }));
        Self {
            orthographic: views.iter().map(is_orthographic).collect(),
            position: rows(position),
            direction: rows(views.iter().map(|view| row(view.towards())).collect()),
            target: rows(views.iter().map(|view| row(view.target)).collect()),
            pixel_tangent,
            pixel_km: views.iter().map(View::pixel_km).collect(),
        }
    }
}

fn read_views(input: &Input, [count, rows, cols]: [usize; 3]) -> Result<Vec<View>> {
    let numbers = |name, unit| -> Result<Array1<f64>> {
        let values: ArrayD<f64> = input.variable_on(name, &["view"])?.reals_of_layout(unit)?;
        check_count(input, name, values.len(), count)?;
        Ok(values.into_dimensionality().expect("one dimension was checked"))
    };
    let vectors = |name, unit| -> Result<Vec<DVec3>> {
        let variable = input.variable_on(name, &["view", "component"])?;
        check_count(input, name, variable.shape.iter().product(), 3 * count)?;
        let values: ArrayD<f64> = variable.reals_of_layout(unit)?;
        let values = values.into_raw_vec_and_offset().0;
        Ok(values.chunks_exact(3).map(DVec3::from_slice).collect())
    };
    let orthographic = input.variable_on("projection", &["view"])?.flags()?;
    check_count(input, "projection", orthographic.len(), count)?;
    let (position, direction) =
        (vectors("camera_position", "km")?, vectors("camera_direction", "1")?);
    let target = vectors("target", "km")?;
    let (tangent, pixel_km) = (numbers("pixel_tangent", "1")?, numbers("pixel_km", "km")?);
    let (zenith, azimuth) =
        (numbers("view_zenith_deg", "degree")?, numbers("view_azimuth_deg", "degree")?);
    (0..count)
        .map(|index| {
            let size = [rows, cols];
            let view = if orthographic[[index]] {
                parallel(direction[index], target[index], pixel_km[index], size)
            } else {
                View::perspective(position[index], target[index], tangent[index], size)
            };
            let view = view.map_err(|problem| {
                let field = format!("camera of view {index}");
                input.error(&field, problem.to_string(), "correct its position and pixel size")
            })?;
            check_angles(input, &view, index, zenith[index], azimuth[index])?;
            Ok(view)
        })
        .collect()
}

/// An orthographic view with exactly the given direction. Normalising a unit vector again may
/// change it.
fn parallel(towards: DVec3, target: DVec3, pixel_km: f64, size: [usize; 2]) -> Result<View> {
    if !towards.is_normalized() {
        return Err(Error::out_of_range("camera direction", towards, "a unit vector"));
    }
    let view = View::orthographic(towards, target, pixel_km, size)?;
    Ok(View { projection: Projection::Orthographic { towards, pixel_km }, ..view })
}

fn check_count(input: &Input, name: &str, found: usize, expected: usize) -> Result<()> {
    if found == expected {
        return Ok(());
    }
    let problem = format!("has {found} values, but the images require {expected}");
    Err(input.error(name, problem, "write one camera per image"))
}

/// Check that the angles agree with the camera position or direction. The view is defined by the
/// latter; the angles are informative. If they disagree, one of them was edited, and it is unclear
/// which one is intended.
fn check_angles(
    input: &Input,
    view: &View,
    index: usize,
    zenith_deg: f64,
    azimuth_deg: f64,
) -> Result<()> {
    let said = crate::math::towards(zenith_deg.to_radians(), azimuth_deg.to_radians());
    if said.distance(view.towards()) <= 1e-6 {
        return Ok(());
    }
    let problem = format!(
        "of view {index} are {zenith_deg} and {azimuth_deg}, but its camera is at {} and {}",
        view.zenith().to_degrees(),
        view.azimuth().to_degrees()
    );
    let remedy = "change camera_position or camera_direction and the angles together";
    Err(input.error("view_zenith_deg, view_azimuth_deg", problem, remedy))
}
