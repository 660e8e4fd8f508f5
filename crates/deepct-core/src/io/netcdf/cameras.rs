//! The cameras of images: all of their parameters are written, and those that are needed are read.

use super::Input;
use super::window::{PIXEL_AXES, Window, check_count};
use super::write::{Attribute::*, Output};
use crate::error::{Error, Result};
use crate::math::{DVec3, towards, zenith_and_azimuth};
use crate::scene::{LinesOfSight, Projection, View};
use ndarray::{Array2, Array3, Array4, ArrayD};
use std::sync::Arc;

/// The values of the variable `projection`.
const PERSPECTIVE: i8 = 0;
const ORTHOGRAPHIC: i8 = 1;
const LOOKING_UP: i8 = 2;
const LINES_OF_SIGHT: i8 = 3;
/// Their names.
const PROJECTIONS: [(i8, &str); 4] = [
    (PERSPECTIVE, "perspective"),
    (ORTHOGRAPHIC, "orthographic"),
    (LOOKING_UP, "orthographic_looking_up"),
    (LINES_OF_SIGHT, "lines_of_sight"),
];

/// Variables of the lines of sight of pixels: where they are, and where to.
const PIXEL_LINES: [(&str, &str, &str); 2] = [
    ("pixel_position", "km", "a point of the line of sight of each pixel; missing for cameras"),
    ("pixel_direction", "1", "vector of each pixel from there to the instrument, of any length"),
];

/// Largest angle (degrees) between directions of a camera that are stated twice:
/// instruments round angles to 0.01 degrees.
const ROUNDED_DEG: f64 = 0.05;

/// Largest relative difference of pixel sizes that are stated twice.
const ROUNDED_SIZE: f64 = 0.02;

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

/// Add the cameras of images to a file that is being written.
pub(super) fn write_cameras(output: &Output, views: &[View]) -> Result<()> {
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
            ("flag_values", Flags(&PROJECTIONS.map(|(kind, _)| kind))),
            ("flag_meanings", Text(&PROJECTIONS.map(|(_, name)| name).join(" "))),
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
    write_pixel_lines(output, views)
}

fn write_pixel_lines(output: &Output, views: &[View]) -> Result<()> {
    let lines: Vec<_> = views.iter().map(View::pixel_lines).collect();
    if lines.iter().all(Option::is_none) {
        return Ok(());
    }
    let (rows, cols) = (views[0].rows, views[0].cols);
    for (number, (name, units, long_name)) in PIXEL_LINES.into_iter().enumerate() {
        let values =
            Array4::from_shape_fn((views.len(), rows, cols, 3), |(view, row, col, axis)| {
                lines[view].as_ref().map_or(f64::NAN, |lines| lines[number][[row, col]][axis])
            });
        let attributes = [("units", Text(units)), ("long_name", Text(long_name))];
        output.variable(name, &["view", "row", "col", "component"], &values, &attributes)?;
    }
    Ok(())
}

/// The lines of sight of the pixels of each view, with rows to the north and columns to the east; `None`
/// for views for which the file has none.
fn read_pixel_lines(
    input: &Input,
    window: &Window,
    axes: [&str; 2],
    [count, rows, cols]: [usize; 3],
) -> Result<Vec<Option<Arc<LinesOfSight>>>> {
    if PIXEL_LINES.iter().all(|(name, ..)| !input.has(name)) {
        return Ok(vec![None; count]);
    }
    let [points, directions] = PIXEL_LINES.map(|(name, unit, _)| -> Result<Vec<Array2<DVec3>>> {
        let variable = input.variable(name)?;
        let mut names = (0..variable.shape.len()).filter_map(|axis| variable.dimension(axis));
        let known = ["view", axes[0], axes[1]];
        let component = names.find(|name| !known.contains(name)).unwrap_or("component").to_owned();
        let variable = input.variable_on(name, &["view", axes[0], axes[1], &component])?;
        if variable.shape != [count, rows, cols, 3] {
            let problem = format!("has shape {:?}", variable.shape);
            return Err(variable.error(problem, "write x, y, z for each pixel of the images"));
        }
        let values: ArrayD<f64> = variable.reals_of_layout(unit)?;
        let values = values.into_raw_vec_and_offset().0;
        let vectors = values.chunks_exact(3).map(DVec3::from_slice).collect();
        let vectors = Array3::from_shape_vec((count, rows, cols), vectors);
        let vectors = window.oriented(vectors.expect("three components for each pixel"));
        Ok(vectors.outer_iter().map(|view| view.to_owned()).collect())
    });
    let lines = points?.into_iter().zip(directions?).enumerate();
    lines
        .map(|(number, (points, directions))| {
            if points.iter().chain(&directions).all(|vector| vector.is_nan()) {
                return Ok(None);
            }
            let lines = LinesOfSight::new(&points, &directions).map_err(|problem| {
                let field = format!("pixel_position, pixel_direction of view {number}");
                input.error(&field, problem.to_string(), "correct them")
            })?;
            Ok(Some(Arc::new(lines)))
        })
        .collect()
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
                _ => (row(nowhere), f64::NAN),
            })
            .unzip();
        let projection = |view: &View| match view.projection {
            Projection::Perspective { .. } => PERSPECTIVE,
            Projection::Orthographic { .. } if view.looks_up() => LOOKING_UP,
            Projection::Orthographic { .. } => ORTHOGRAPHIC,
            Projection::LinesOfSight { .. } => LINES_OF_SIGHT,
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

/// Read the views of images. Sentences about what is derived are added to `derived`.
///
/// # Errors
/// Returns an error if the parameters of a camera are missing, out of range, or contradict each other.
pub(super) fn read_views(
    input: &Input,
    window: &Window,
    axes: [&str; 2],
    [count, rows, cols]: [usize; 3],
    derived: &mut Vec<String>,
) -> Result<Vec<View>> {
    let lines = read_pixel_lines(input, window, axes, [count, rows, cols])?;
    let numbers = |name, unit| numbers(input, name, unit, count);
    let vectors = |name, unit| vectors(input, name, unit, count);
    let kinds = projections(input, count)?;
    let (position, direction) =
        (vectors("camera_position", "km")?, vectors("camera_direction", "1")?);
    let target = vectors("target", "km")?;
    let (tangent, pixel_km) = (numbers("pixel_tangent", "1")?, numbers("pixel_km", "km")?);
    let (zenith, azimuth) =
        (numbers("view_zenith_deg", "degree")?, numbers("view_azimuth_deg", "degree")?);
    (0..count)
        .map(|index| {
            let camera = Camera {
                input,
                index,
                lines: lines[index].clone(),
                kind: kinds[index],
                position: position[index],
                direction: direction[index],
                target: target[index],
                pixel_tangent: tangent[index],
                pixel_km: pixel_km[index],
                angles: [zenith[index], azimuth[index]],
            };
            camera.view(window, [rows, cols], derived)
        })
        .collect()
}

/// The numbers of a variable with one for each view, or with one for all views; NaN if the file does not
/// have it.
fn numbers(input: &Input, name: &str, unit: &str, count: usize) -> Result<Vec<f64>> {
    if !input.has(name) {
        return Ok(vec![f64::NAN; count]);
    }
    let variable = input.variable(name)?;
    let variable =
        if variable.shape.is_empty() { variable } else { input.variable_on(name, &["view"])? };
    let values: ArrayD<f64> = variable.reals_of_layout(unit)?;
    match (values.ndim(), values.first()) {
        (0, Some(value)) => Ok(vec![*value; count]),
        _ => {
            check_count(input, name, values.len(), count)?;
            Ok(values.into_raw_vec_and_offset().0)
        }
    }
}

/// As [`numbers`], for vectors, whose components are along a dimension of any name.
fn vectors(input: &Input, name: &str, unit: &str, count: usize) -> Result<Vec<DVec3>> {
    if !input.has(name) {
        return Ok(vec![DVec3::NAN; count]);
    }
    let variable = input.variable(name)?;
    let mut dimensions = (0..variable.shape.len()).filter_map(|axis| variable.dimension(axis));
    let component = dimensions.find(|name| *name != "view").unwrap_or("component").to_owned();
    let is_common = variable.shape.len() == 1;
    let on: &[&str] = if is_common { &[&component] } else { &["view", &component] };
    let variable = input.variable_on(name, on)?.with_integers();
    if variable.shape.last() != Some(&3) {
        let problem = format!("has shape {:?}", variable.shape);
        return Err(variable.error(problem, "write three components x, y, z for each view"));
    }
    let values: ArrayD<f64> = variable.reals_of_layout(unit)?;
    let values = values.into_raw_vec_and_offset().0;
    let vectors: Vec<DVec3> = values.chunks_exact(3).map(DVec3::from_slice).collect();
    if is_common {
        return Ok(vec![vectors[0]; count]);
    }
    check_count(input, name, vectors.len(), count)?;
    Ok(vectors)
}

/// The projection of each view as a number, where the file states it, as a number or by its name.
fn projections(input: &Input, count: usize) -> Result<Vec<Option<i8>>> {
    let name = "projection";
    if !input.has(name) {
        return Ok(vec![None; count]);
    }
    let known: Vec<(f64, &str)> =
        PROJECTIONS.iter().map(|(kind, name)| (f64::from(*kind), *name)).collect();
    let unknown = |found: &str| {
        let names: Vec<String> =
            PROJECTIONS.iter().map(|(kind, name)| format!("{kind} ({name})")).collect();
        let problem = format!("is \"{found}\", but must be {}", names.join(", "));
        input.error(
            name,
            problem,
            "correct it or omit it: it follows from the parameters of the cameras",
        )
    };
    let found: Vec<Option<i8>> = match input.variable(name)?.texts()? {
        Some(texts) => texts
            .iter()
            .map(|text| match PROJECTIONS.iter().find(|(_, name)| name == text) {
                Some((kind, _)) => Ok(Some(*kind)),
                None if text.is_empty() => Ok(None),
                None => Err(unknown(text)),
            })
            .collect::<Result<_>>()?,
        None => numbers(input, name, "1", count)?
            .iter()
            .map(|number| match known.iter().position(|(kind, _)| kind == number) {
                Some(place) => Ok(Some(PROJECTIONS[place].0)),
                None if number.is_nan() => Ok(None),
                None => Err(unknown(&number.to_string())),
            })
            .collect::<Result<_>>()?,
    };
    if let [one] = found[..] {
        return Ok(vec![one; count]);
    }
    check_count(input, name, found.len(), count)?;
    Ok(found)
}

/// What a file states about the camera of a view; NaN for what it does not.
struct Camera<'a> {
    input: &'a Input,
    index: usize,
    lines: Option<Arc<LinesOfSight>>,
    kind: Option<i8>,
    position: DVec3,
    direction: DVec3,
    target: DVec3,
    pixel_tangent: f64,
    pixel_km: f64,
    /// Zenith and azimuth (degrees).
    angles: [f64; 2],
}

impl Camera<'_> {
    /// The view. What it derives is added to `derived`.
    ///
    /// # Errors
    /// Returns an error if the file does not state enough, or if it contradicts itself.
    fn view(&self, window: &Window, size: [usize; 2], derived: &mut Vec<String>) -> Result<View> {
        let mut note = |text: &str| {
            if !derived.iter().any(|known| known == text) {
                derived.push(text.to_owned());
            }
        };
        if let Some(lines) = self.lines.clone() {
            let view = View::lines_of_sight(lines).and_then(|view| {
                if self.target.is_finite() {
                    return view.aimed_at(self.target);
                }
                note("target: the pixel_position in the middle of the image");
                Ok(view)
            });
            return view.map_err(|problem| {
                let field = format!("lines of sight of view {}", self.index);
                self.input.error(&field, problem.to_string(), "correct them, or the target")
            });
        }
        if !self.target.is_finite() {
            return Err(self
                .missing("target", "write the point x, y, z that is in the middle of the image"));
        }
        let kind = self.kind.unwrap_or_else(|| {
            let (kind, reason) = if self.position.is_finite() {
                (PERSPECTIVE, "perspective, as there is a camera_position")
            } else if self.said_direction().is_some_and(|towards| towards.z < 0.0) {
                (LOOKING_UP, "orthographic and looking up, as there is no camera_position and the view zenith angle is above 90 degrees")
            } else {
                (ORTHOGRAPHIC, "orthographic, as there is no camera_position")
            };
            note(&format!("projection: {reason}"));
            kind
        });
        let distance = self.position.distance(self.target);
        let view = if kind == PERSPECTIVE {
            if !self.position.is_finite() {
                return Err(self.missing("camera_position", "write it for perspective cameras"));
            }
            let tangent = match self.pixel_tangent {
                tangent if tangent.is_finite() => tangent,
                _ if self.pixel_km.is_finite() => {
                    note("pixel_tangent: pixel_km over the distance of the camera");
                    self.pixel_km / distance
                }
                _ => return Err(self.missing("pixel_tangent", "write it, or pixel_km")),
            };
            View::perspective(self.position, self.target, window.pixel * tangent, size)
        } else {
            let towards = match self.said_direction() {
                Some(towards) => towards,
                None if self.position.is_finite() => {
                    note("direction of the cameras: from target and camera_position");
                    (self.position - self.target).normalize()
                }
                None => {
                    let remedy = "write both angles, or camera_position for perspective cameras";
                    return Err(self.missing("view_zenith_deg, view_azimuth_deg", remedy));
                }
            };
            let pixel_km = match self.pixel_km {
                pixel_km if pixel_km.is_finite() => pixel_km,
                _ => return Err(self.missing("pixel_km", "write the size of the pixels")),
            };
            let view = if kind == LOOKING_UP { View::looking_up } else { View::orthographic };
            let view = view(towards, self.target, window.pixel * pixel_km, size);
            view.and_then(|view| exactly(view, towards))
        };
        let view = view.and_then(|view| view.with_shift(window.shifts[self.index]));
        let view = view.map_err(|problem| {
            let field = format!("camera of view {}", self.index);
            self.input.error(&field, problem.to_string(), "correct its position and pixel size")
        })?;
        self.check(&view, distance)?;
        Ok(view)
    }

    /// The direction towards the camera as the file states it.
    fn said_direction(&self) -> Option<DVec3> {
        let [zenith, azimuth] = self.angles.map(f64::to_radians);
        let by_angles = towards(zenith, azimuth);
        [self.direction, by_angles].into_iter().find(|towards| towards.is_finite())
    }

    /// Check that all that is stated is true of the view, up to the rounding of angles and sizes. If it
    /// is not, one of the two was edited, and it is unclear which one is intended.
    fn check(&self, view: &View, distance: f64) -> Result<()> {
        let index = self.index;
        let degrees = |towards: DVec3| {
            let (zenith, azimuth) = zenith_and_azimuth(towards);
            format!("{:.3} and {:.3} degrees", zenith.to_degrees(), azimuth.to_degrees())
        };
        let at = (self.position - self.target).normalize();
        let [zenith, azimuth] = self.angles;
        let angles = towards(zenith.to_radians(), azimuth.to_radians());
        let own = match view.projection {
            Projection::Perspective { .. } => "camera_position",
            _ if self.direction.is_finite() => "camera_direction",
            _ => "view_zenith_deg, view_azimuth_deg",
        };
        let stated = [
            ("view_zenith_deg, view_azimuth_deg", angles),
            ("camera_direction", self.direction),
            ("camera_position", at),
        ];
        for (name, stated) in stated.into_iter().filter(|(_, stated)| stated.is_finite()) {
            if stated.angle_between(view.towards()) <= ROUNDED_DEG.to_radians() {
                continue;
            }
            let problem = format!(
                "of view {index}: the zenith and azimuth are {}, but its {own} has {}",
                degrees(stated),
                degrees(view.towards())
            );
            let remedy = format!("correct {name} or {own}, or omit the wrong one of them");
            return Err(self.input.error(name, problem, &remedy));
        }
        let by_tangent = distance * self.pixel_tangent;
        let is_perspective = matches!(view.projection, Projection::Perspective { .. });
        if is_perspective && (self.pixel_km - by_tangent).abs() > ROUNDED_SIZE * by_tangent {
            let problem = format!(
                "of view {index} is {}, but its pixel_tangent at the distance {distance} km of the camera \
                 makes pixels of {by_tangent} km",
                self.pixel_km
            );
            let remedy = "correct pixel_km or pixel_tangent, or omit the wrong one of them";
            return Err(self.input.error("pixel_km", problem, remedy));
        }
        Ok(())
    }

    fn missing(&self, name: &str, remedy: &str) -> Error {
        self.input.error(name, format!("is missing for view {}", self.index), remedy)
    }
}

/// The view, with exactly the given direction if it is orthographic and a unit vector, which may change
/// if it is normalised again.
fn exactly(view: View, towards: DVec3) -> Result<View> {
    let Projection::Orthographic { pixel_km, .. } = view.projection else { return Ok(view) };
    if !towards.is_normalized() {
        return Err(Error::out_of_range("camera direction", towards, "a unit vector"));
    }
    Ok(View { projection: Projection::Orthographic { towards, pixel_km }, ..view })
}
