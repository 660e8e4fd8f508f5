//! Images with their cameras and scene illumination.

use super::cameras::{read_views, write_cameras};
use super::light::{get_light, put_light, put_wavelengths};
use super::window::{PIXEL_AXES, Window, pixel_axes};
use super::write::{Attribute::*, Attributes, Output, Stored};
use super::{INCOMPLETE, Input, Provenance};
use crate::error::{Error, Result};
use crate::image::ViewStack;
use crate::scene::{Light, Observation, View};
use ndarray::{Axis, CowArray, Ix3, stack};
use std::ops::Range;
use std::path::Path;

/// The dimensions of images.
const PIXELS: [&str; 3] = ["view", "row", "col"];

/// Largest radiance (1/sr) for a solar irradiance of 1 that is taken for one of clouds where no unit is
/// stated. A white surface under the Sun in the zenith has 0.32.
const BRIGHTEST_CLOUD: f64 = 1.0;

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
    put_bands(&mut output, std::slice::from_ref(observation))?;
    if observation.incomplete {
        output.mark_incomplete("the rendering was interrupted before it had all photon paths")?;
    }
    output.finish()
}

/// Add the images of one or more bands to a file that is being written. Those of several are on the
/// dimension `wavelength`.
pub(super) fn put_bands(output: &mut Output, bands: &[Observation]) -> Result<()> {
    let Some(first) = bands.first() else {
        return Err(Error::out_of_range("number of bands", 0, "at least 1"));
    };
    if !bands.iter().all(|band| differs_in_wavelength_alone(first, band)) {
        let remedy = "write them to files of their own";
        return Err(Error::mismatch("bands", "the same views and illumination", "others", remedy));
    }
    if bands.len() > 1 {
        let wavelengths: Vec<f64> = bands.iter().map(|band| band.light.wavelength).collect();
        put_wavelengths(output, &wavelengths)?;
    }
    let [views, rows, cols] = first.images.shape();
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
    put_pixels(output, "radiance", bands, |band| Some((&band.images.values).into()), &radiance)?;
    let long_name = "standard error of radiance; infinite for missing pixels";
    let attributes = [("units", Text("sr-1")), ("long_name", Text(long_name))];
    put_pixels(
        output,
        "radiance_standard_error",
        bands,
        |band| Some((&band.standard_error.as_ref()?.values).into()),
        &attributes,
    )?;
    let attributes = [
        ("long_name", Text("saturated pixels, which are at least as bright as their radiance")),
        ("flag_values", Flags(&[0, 1])),
        ("flag_meanings", Text("not_saturated saturated")),
    ];
    let saturated = |band: &Observation| Some(band.saturated.as_ref()?.mapv(i8::from).into());
    put_pixels(output, "saturated", bands, saturated, &attributes)?;
    write_cameras(output, &first.views)?;
    put_light(output, first)
}
/// Whether the views and the scene illumination of two bands are the same except for the wavelength.
fn differs_in_wavelength_alone(one: &Observation, other: &Observation) -> bool {
    let light = Light { wavelength: one.light.wavelength, ..other.light.clone() };
    light == one.light && other.assumed == one.assumed && other.views == one.views
}

/// Add a value of each pixel of each band, unless no band has it.
///
/// # Errors
/// Returns an error if some bands have the value and others do not, or if it cannot be written.
fn put_pixels<'a, T: Stored>(
    output: &Output,
    name: &str,
    bands: &'a [Observation],
    values: impl Fn(&'a Observation) -> Option<CowArray<'a, T, Ix3>>,
    attributes: &Attributes,
) -> Result<()> {
    let known: Vec<_> = bands.iter().filter_map(values).collect();
    match &known[..] {
        [] => Ok(()),
        [values] if bands.len() == 1 => output.variable(name, &PIXELS, values, attributes),
        _ if known.len() == bands.len() => {
            let views: Vec<_> = known.iter().map(|values| values.view()).collect();
            let stacked = stack(Axis(0), &views).expect("the views have the same sizes");
            let [view, row, col] = PIXELS;
            output.variable(name, &["wavelength", view, row, col], &stacked, attributes)
        }
        _ => Err(Error::mismatch(
            format!("bands with {name}"),
            bands.len(),
            known.len(),
            "give it for all bands or for none",
        )),
    }
}

/// Read images. What [`write_observation`] wrote is reproduced exactly; files of other programs need
/// only radiances, Sun, wavelength and, for each view, the target and either the position of the camera
/// with the size of its pixels, or its direction with that. The pixel numbers `row` and `col` tell which
/// part of the images is left, how many pixels were averaged, and whether rows or columns are reversed.
///
/// # Errors
/// Returns an error if the file is missing, damaged or of another type, if radiances are not
/// finite, if the parameters of a camera or of the Sun are missing or out of range, or if they
/// contradict each other.
pub fn read_observation(path: impl AsRef<Path>) -> Result<Observation> {
    Ok(read_derived_observation(path)?.0)
}

/// Read the images of each band: those of a file whose radiances are on the dimension of `wavelength`, or
/// those of one wavelength. Variables that are not on this dimension hold for all bands.
///
/// # Errors
/// As [`read_observation`].
pub fn read_observations(path: impl AsRef<Path>) -> Result<Vec<Observation>> {
    let path = path.as_ref();
    let Some((dimension, count)) = bands(&Input::open(path)?)? else {
        return Ok(vec![read_observation(path)?]);
    };
    let band = |number| {
        let file = ImagesFile::of(Input::open(path)?.at(&dimension, number))?;
        file.observation(file.views.clone())
    };
    (0..count).map(band).collect()
}

/// The dimension of the wavelengths of radiances, and its length; `None` if there is one wavelength without
/// a dimension.
fn bands(input: &Input) -> Result<Option<(String, usize)>> {
    if !input.has("wavelength") || !input.has("radiance") {
        return Ok(None);
    }
    let (wavelength, radiance) = (input.variable("wavelength")?, input.variable("radiance")?);
    let &[count] = wavelength.shape.as_slice() else { return Ok(None) };
    let dimension = wavelength.dimension(0).filter(|name| *name != "view");
    let axes = 0..radiance.shape.len();
    let of_radiance = |name: &&str| axes.clone().any(|axis| radiance.dimension(axis) == Some(name));
    Ok(dimension.filter(of_radiance).map(|name| (name.to_owned(), count)))
}

/// As [`read_observation`], with a sentence about each property of the cameras and images that the file
/// does not state and that was derived from others.
///
/// # Errors
/// As [`read_observation`].
pub fn read_derived_observation(path: impl AsRef<Path>) -> Result<(Observation, Vec<String>)> {
    let file = ImagesFile::open(path)?;
    let observation = file.observation(file.views.clone())?;
    Ok((observation, file.derived))
}

/// A file of images that is open for reading, as a whole or in parts.
pub struct ImagesFile {
    input: Input,
    /// The names of the dimensions of the pixels.
    pixels: [&'static str; 3],
    window: Window,
    views: Vec<View>,
    light: Light,
    assumed: Vec<String>,
    derived: Vec<String>,
    /// Whether the radiances have the unit of the solar irradiance per steradian.
    relative: bool,
}

impl ImagesFile {
    /// Open a file of images, and read everything but its pixels.
    ///
    /// # Errors
    /// As [`read_observation`].
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let input = Input::open(path.as_ref())?;
        match bands(&input)? {
            None => Self::of(input),
            Some((dimension, 1)) => Self::of(input.at(&dimension, 0)),
            Some((dimension, count)) => {
                let remedy = format!(
                    "`invert` and `hybrid` read all of them; for other commands, write each to a file of \
                     its own (in xarray, images.isel({dimension}=0).to_netcdf(\"band_0.nc\"))"
                );
                Err(input.error("wavelength", format!("has {count} values"), &remedy))
            }
        }
    }

    /// As [`ImagesFile::open`], for the first band of a file that may contain several.
    ///
    /// # Errors
    /// As [`read_observation`].
    pub fn open_first_band(path: impl AsRef<Path>) -> Result<Self> {
        let input = Input::open(path.as_ref())?;
        match bands(&input)? {
            None => Self::of(input),
            Some((dimension, _)) => Self::of(input.at(&dimension, 0)),
        }
    }

    fn of(input: Input) -> Result<Self> {
        let axes = pixel_axes(&input)?;
        let pixels = ["view", axes[0], axes[1]];
        let relative = is_relative_to_the_irradiance(&input)?;
        let radiance = input.variable_on("radiance", &pixels)?;
        let &[count, rows, cols] = radiance.shape.as_slice() else {
            return Err(radiance.error("has not three dimensions", "write it on view, row, col"));
        };
        let window = Window::read(&input, axes, [count, rows, cols])?;
        let mut derived = window.notes(axes);
        let views = read_views(&input, &window, axes, [count, rows, cols], &mut derived)?;
        let (light, assumed) = get_light(&input)?;
        drop(radiance);
        Ok(Self { input, pixels, window, views, light, assumed, derived, relative })
    }

    /// The views of the whole images.
    pub fn views(&self) -> &[View] {
        &self.views
    }

    /// The scene illumination.
    pub fn light(&self) -> &Light {
        &self.light
    }

    /// Read the pixels within these rows (from the south) and columns (from the west), the same in all
    /// images.
    ///
    /// # Errors
    /// As [`read_observation`]; a part that is empty or not in the images.
    pub fn part(&mut self, rows: Range<usize>, cols: Range<usize>) -> Result<Observation> {
        let (first, size) = ([rows.start, cols.start], [rows.len(), cols.len()]);
        let views = self.views.iter().map(|view| view.part(first, size)).collect::<Result<_>>()?;
        let whole = [self.views[0].rows, self.views[0].cols];
        let stored = self.window.in_file([rows, cols], whole);
        self.input.read_parts(self.pixels[1..].iter().map(|name| name.to_string()).zip(stored));
        let observation = self.observation(views);
        self.input.read_parts([]);
        observation
    }

    /// The observation by these views of the part that is read.
    fn observation(&self, views: Vec<View>) -> Result<Observation> {
        let Self { input, pixels, window, relative, .. } = self;
        let values = |name| {
            let variable = input.variable_on(name, pixels)?;
            if *relative { variable.reals_3d() } else { variable.reals_3d_of_layout("sr-1") }
        };
        let images = ViewStack::with_missing(values("radiance")?).map_err(|problem| {
            let remedy = "write NaN, or the fill value, where a pixel is missing";
            input.error("radiance", problem.to_string(), remedy)
        })?;
        let images = ViewStack { values: window.oriented(images.values) };
        let has_units = input.variable("radiance")?.unit_text().is_some();
        let mut observation = Observation::new(self.light.clone(), views, images)
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
        observation.assumed.clone_from(&self.assumed);
        let error = "radiance_standard_error";
        if input.has(error) {
            let errors = window.oriented(values(error)?);
            observation = observation.with_standard_error(errors).map_err(|problem| {
                input.error(error, problem.to_string(), "write that of every pixel")
            })?;
        }
        if input.has("saturated") {
            let marks = input.variable_on("saturated", pixels)?.flags()?;
            let marks = marks.into_dimensionality::<Ix3>().expect("three dimensions were checked");
            observation =
                observation.with_saturated(window.oriented(marks)).map_err(|problem| {
                    input.error("saturated", problem.to_string(), "mark every pixel")
                })?;
        }
        Ok(observation)
    }
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
