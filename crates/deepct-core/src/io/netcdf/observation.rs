//! Images with their cameras and scene illumination.

use super::light::{get_light, put_light};
use super::write::{Attribute::*, Output};
use super::{INCOMPLETE, Input, Provenance};
use crate::error::{Error, Result};
use crate::image::ViewStack;
use crate::math::DVec3;
use crate::scene::{Observation, Projection, View};
use ndarray::{Array1, Array2, Array3, ArrayD, Axis, Ix3};
use std::path::Path;

/// The dimensions of images.
const PIXELS: [&str; 3] = ["view", "row", "col"];

/// The axes of an image, with the variable that holds the position of the target on them. Pixel
/// centres have the numbers of the axis, so that these positions also hold for parts of an image.
const PIXEL_AXES: [(&str, &str); 2] = [("row", "target_row"), ("col", "target_col")];

/// The values of the variable `projection`.
const PERSPECTIVE: i8 = 0;
const ORTHOGRAPHIC: i8 = 1;
const LOOKING_UP: i8 = 2;

/// Largest angle (degrees) between the position of a camera and angles that are stored beside it:
/// instruments round angles to 0.01 degrees.
const ROUNDED_DEG: f64 = 0.05;

/// Largest radiance (1/sr) for a solar irradiance of 1 that is taken for one of clouds where no unit is
/// stated. A white surface under the Sun in the zenith has 0.32.
const BRIGHTEST_CLOUD: f64 = 1.0;

/// The parameters of all cameras, with one entry or row (x, y, z) per view.
struct Cameras {
    projection: Vec<i8>,
    position: Array2<f64>,
    direction: Array2<f64>,
    target: Array2<f64>,
    pixel_tangent: Vec<f64>,
    pixel_km: Vec<f64>,
    /// The positions of the target on the axes of the image.
    target_pixel: [Vec<f64>; 2],
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
    if observation.incomplete {
        output.mark_incomplete("the rendering was interrupted before it had all photon paths")?;
    }
    output.finish()
}

/// Add images to a file that is being written.
pub(super) fn put_observation(output: &mut Output, observation: &Observation) -> Result<()> {
    let [views, rows, cols] = observation.images.shape();
    output.counted("view", views, "index of the view")?;
    for ((name, _), (size, long_name)) in PIXEL_AXES.iter().zip([
        (rows, "pixel row, increasing northwards"),
        (cols, "pixel column, increasing eastwards"),
    ]) {
        // Real numbers: those of averaged pixels may lie between integers, and programs that write
        // the average to a file retain the type.
        let numbers: Vec<f64> = (0..size).map(|number| number as f64).collect();
        output.dimension(name, &numbers, &[("long_name", Text(long_name))])?;
    }
    output.counted("component", 3, "components x (east), y (north), z (up)")?;
    let radiance = [("units", Text("sr-1")), ("long_name", Text("radiance"))];
    output.variable("radiance", &PIXELS, &observation.images.values, &radiance)?;
    if let Some(error) = &observation.standard_error {
        let long_name = "standard error of radiance; infinite for pixels that are left out, for \
                         example because they are saturated";
        let attributes = [("units", Text("sr-1")), ("long_name", Text(long_name))];
        output.variable("radiance_standard_error", &PIXELS, &error.values, &attributes)?;
    }
    if let Some(saturated) = &observation.saturated {
        let attributes = [
            ("long_name", Text("saturated pixels, which are at least as bright as their radiance")),
            ("flag_values", Flags(&[0, 1])),
            ("flag_meanings", Text("not_saturated saturated")),
        ];
        output.variable("saturated", &PIXELS, &saturated.mapv(i8::from), &attributes)?;
    }
    write_cameras(output, &observation.views)?;
    put_light(output, observation)
}

/// Read images that [`write_observation`] wrote. All numbers are reproduced exactly. The pixel
/// numbers `row` and `col` tell which part of the images is left, how many pixels were averaged, and
/// whether rows or columns are reversed.
///
/// # Errors
/// Returns an error if the file is missing, damaged or of another type, if radiances are not
/// finite, if the parameters of a camera or of the Sun are out of range, or if the angles are
/// inconsistent with the position of the camera.
pub fn read_observation(path: impl AsRef<Path>) -> Result<Observation> {
    let path = path.as_ref();
    let input = Input::open(path)?;
    let relative = is_relative_to_the_irradiance(&input)?;
    let values = |name| {
        let variable = input.variable_on(name, &PIXELS)?;
        if relative { variable.reals_3d() } else { variable.reals_3d_of_layout("sr-1") }
    };
    let images = ViewStack::new(values("radiance")?).map_err(|problem| {
        let remedy =
            "write numbers everywhere; an infinite radiance_standard_error leaves a pixel out";
        input.error("radiance", problem.to_string(), remedy)
    })?;
    let window = Window::read(&input, images.shape())?;
    let images = ViewStack { values: window.oriented(images.values) };
    let has_units = input.variable("radiance")?.unit_text().is_some();
    let error = "radiance_standard_error";
    let standard_error = match input.has(error) {
        true => {
            let errors = ViewStack::of_errors(values(error)?).map_err(|problem| {
                input.error(error, problem.to_string(), "write the standard error of every pixel")
            })?;
            Some(ViewStack { values: window.oriented(errors.values) })
        }
        false => None,
    };
    let views = read_views(&input, &window, images.shape())?;
    let (light, assumed) = get_light(&input)?;
    let mut observation = Observation::new(light, views, images)
        .map_err(|problem| input.error("radiance", problem.to_string(), "write it again"))?;
    let brightest = observation.images.brightest();
    if !has_units && f64::from(brightest) > BRIGHTEST_CLOUD * observation.light.sun.irradiance {
        let problem = format!(
            "has no units and numbers of up to {brightest}, more than a radiance of clouds for the solar \
             irradiance {}",
            observation.light.sun.irradiance
        );
        let remedy = "divide it by the solar irradiance and add the attribute units = \"sr-1\"";
        return Err(input.error("radiance", problem, remedy));
    }
    observation.incomplete = input.text(INCOMPLETE).is_some();
    if standard_error.as_ref().is_some_and(|error| error.shape() != observation.images.shape()) {
        return Err(input.error(error, "has another shape than radiance", "write it again"));
    }
    (observation.assumed, observation.standard_error) = (assumed, standard_error);
    if !input.has("saturated") {
        return Ok(observation);
    }
    let marks = input.variable_on("saturated", &PIXELS)?.flags()?;
    let marks = marks.into_dimensionality::<Ix3>().expect("three dimensions were checked");
    observation
        .with_saturated(window.oriented(marks))
        .map_err(|problem| input.error("saturated", problem.to_string(), "mark every pixel"))
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
        &cameras.projection,
        &[
            ("long_name", Text("camera projection")),
            ("flag_values", Flags(&[PERSPECTIVE, ORTHOGRAPHIC, LOOKING_UP])),
            ("flag_meanings", Text("perspective orthographic orthographic_looking_up")),
        ],
    )?;
    let position = km("camera position; missing for an orthographic camera");
    output.variable("camera_position", &vectors, &cameras.position, &position)?;
    let direction = one("unit vector from the target towards the camera");
    output.variable("camera_direction", &vectors, &cameras.direction, &direction)?;
    let target = km("point that the camera is pointed at");
    output.variable("target", &vectors, &cameras.target, &target)?;
    let tangent = one("ratio of pixel size to focal length; missing for an orthographic camera");
    output.variable("pixel_tangent", &["view"], &cameras.pixel_tangent, &tangent)?;
    let size = km("size of a pixel at the target");
    output.variable("pixel_km", &["view"], &cameras.pixel_km, &size)?;
    for ((_, name), values) in PIXEL_AXES.iter().zip(&cameras.target_pixel) {
        let position = one("position of the target on the axis of the pixels");
        output.variable(name, &["view"], values, &position)?;
    }
    Ok(())
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
        let projection = |view: &View| match view.projection {
            Projection::Perspective { .. } => PERSPECTIVE,
            Projection::Orthographic { .. } if view.looks_up() => LOOKING_UP,
            Projection::Orthographic { .. } => ORTHOGRAPHIC,
        };
        Self {
            projection: views.iter().map(projection).collect(),
            position: rows(position),
            direction: rows(views.iter().map(|view| row(view.towards())).collect()),
            target: rows(views.iter().map(|view| row(view.target)).collect()),
            pixel_tangent,
            pixel_km: views.iter().map(View::pixel_km).collect(),
            target_pixel: [0, 1].map(|axis| {
                let center = |view: &View| 0.5 * [view.rows, view.cols][axis] as f64 - 0.5;
                views.iter().map(|view| center(view) - view.shift[axis]).collect()
            }),
        }
    }
}

/// What the pixel numbers of a file say about its images, which may be parts or averages of others.
struct Window {
    /// The centre of each image relative to the target, `[row, col]` (pixels).
    shifts: Vec<[f64; 2]>,
    /// The width of a pixel in pixels of the camera.
    pixel: f64,
    /// Whether the pixel numbers decrease along rows and columns.
    reversed: [bool; 2],
}

impl Window {
    /// # Errors
    /// Returns an error if the numbers are not equidistant, if pixels are not squares, or if the
    /// images are not whole and the pixel of the target is unknown.
    fn read(input: &Input, [count, rows, cols]: [usize; 3]) -> Result<Self> {
        let mut window = Self { shifts: vec![[0.0; 2]; count], pixel: 1.0, reversed: [false; 2] };
        let mut steps = [1.0; 2];
        for (axis, ((name, target), size)) in PIXEL_AXES.into_iter().zip([rows, cols]).enumerate() {
            let [first, last] = pixel_numbers(input, name, size)?;
            let step = if size > 1 { (last - first) / (size - 1) as f64 } else { 1.0 };
            (steps[axis], window.reversed[axis]) = (step.abs(), step < 0.0);
            let middle = 0.5 * (first + last);
            if input.has(target) {
                let at: ArrayD<f64> = input.variable_on(target, &["view"])?.reals_of_layout("1")?;
                check_count(input, target, at.len(), count)?;
                for (shift, at) in window.shifts.iter_mut().zip(at) {
                    shift[axis] = (middle - at) / step.abs();
                }
            } else if first.min(last) != 0.0 || step.abs() != 1.0 {
                let problem = format!(
                    "begins with {first} in steps of {step}: the images are parts or averages of \
                     others, and it is unknown which pixel shows the target"
                );
                let remedy = format!("add {target}(view), the position of the target along {name}");
                return Err(input.error(name, problem, &remedy));
            }
        }
        let [tall, wide] = steps;
        if (tall - wide).abs() > 1e-6 * tall {
            let problem = format!("have steps of {tall} and {wide}, but pixels must be squares");
            return Err(input.error("row, col", problem, "average as many rows as columns"));
        }
        window.pixel = tall;
        Ok(window)
    }

    /// The images with rows to the north and columns to the east.
    fn oriented<T>(&self, mut pixels: Array3<T>) -> Array3<T> {
        for (axis, _) in self.reversed.iter().enumerate().filter(|(_, reversed)| **reversed) {
            pixels.invert_axis(Axis(1 + axis));
        }
        pixels
    }
}

/// The first and the last number of the pixels along an axis; from 0 if the file does not number
/// them.
fn pixel_numbers(input: &Input, name: &str, count: usize) -> Result<[f64; 2]> {
    let last = count as f64 - 1.0;
    if !input.has(name) {
        return Ok([0.0, last]);
    }
    let numbers: ArrayD<f64> = input.variable_on(name, &[name])?.reals()?;
    check_count(input, name, numbers.len(), count)?;
    let numbers: Vec<f64> = numbers.into_iter().collect();
    let ends = [numbers[0], numbers[count - 1]];
    let step = (ends[1] - ends[0]) / last.max(1.0);
    let expected = |index: usize| ends[0] + step * index as f64;
    let off = numbers.iter().enumerate().map(|(index, number)| (number - expected(index)).abs());
    if off.fold(0.0, f64::max) <= 1e-6 * step.abs() || count == 1 {
        return Ok(ends);
    }
    let problem = "holds pixel numbers that are not equidistant";
    Err(input.error(name, problem, "give whole images, or select pixels in equal steps"))
}

fn read_views(
    input: &Input,
    window: &Window,
    [count, rows, cols]: [usize; 3],
) -> Result<Vec<View>> {
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
    let projection: ArrayD<f64> = input.variable_on("projection", &["view"])?.reals()?;
    check_count(input, "projection", projection.len(), count)?;
    let (position, direction) =
        (vectors("camera_position", "km")?, vectors("camera_direction", "1")?);
    let target = vectors("target", "km")?;
    let (tangent, pixel_km) = (numbers("pixel_tangent", "1")?, numbers("pixel_km", "km")?);
    let (zenith, azimuth) =
        (numbers("view_zenith_deg", "degree")?, numbers("view_azimuth_deg", "degree")?);
    (0..count)
        .map(|index| {
            let size = [rows, cols];
            let (target, pixel_km) = (target[index], window.pixel * pixel_km[index]);
            let kind = projection[[index]];
            let view = if kind == f64::from(PERSPECTIVE) {
                View::perspective(position[index], target, window.pixel * tangent[index], size)
            } else if kind == f64::from(ORTHOGRAPHIC) {
                View::orthographic(direction[index], target, pixel_km, size)
            } else if kind == f64::from(LOOKING_UP) {
                View::looking_up(direction[index], target, pixel_km, size)
            } else {
                let range = "0 (perspective), 1 (orthographic) or 2 (orthographic, looking up)";
                Err(Error::out_of_range("projection", kind, range))
            };
            let view = view.and_then(|view| exactly(view, direction[index]));
            let view =
                view.and_then(|view| view.with_shift(window.shifts[index])).map_err(|problem| {
                    let field = format!("camera of view {index}");
                    input.error(&field, problem.to_string(), "correct its position and pixel size")
                })?;
            check_angles(input, &view, index, zenith[index], azimuth[index])?;
            Ok(view)
        })
        .collect()
}

/// The view, with exactly the given direction if it is orthographic. Normalising a unit vector again
/// may change it.
fn exactly(view: View, towards: DVec3) -> Result<View> {
    let Projection::Orthographic { pixel_km, .. } = view.projection else { return Ok(view) };
    if !towards.is_normalized() {
        return Err(Error::out_of_range("camera direction", towards, "a unit vector"));
    }
    Ok(View { projection: Projection::Orthographic { towards, pixel_km }, ..view })
}

fn check_count(input: &Input, name: &str, found: usize, expected: usize) -> Result<()> {
    if found == expected {
        return Ok(());
    }
    let problem = format!("has {found} values, but the images require {expected}");
    Err(input.error(name, problem, "write one camera per image"))
}

/// Check that the angles agree with the camera position or direction up to the rounding of angles.
/// The view is defined by the latter; the angles are informative. If they disagree, one of them was
/// edited, and it is unclear which one is intended.
fn check_angles(
    input: &Input,
    view: &View,
    index: usize,
    zenith_deg: f64,
    azimuth_deg: f64,
) -> Result<()> {
    let said = crate::math::towards(zenith_deg.to_radians(), azimuth_deg.to_radians());
    if said.angle_between(view.towards()) <= ROUNDED_DEG.to_radians() {
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
