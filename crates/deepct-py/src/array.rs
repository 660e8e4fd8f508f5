//! Conversion of array arguments and results: NumPy arrays, objects that NumPy can convert to an
//! array, xarray objects, and objects of this module that contain the array.

use crate::exchange::is_dataset;
use crate::grid::Grid;
use deepct_core::grid;
use deepct_core::image::first_of_padded;
use deepct_core::io::unit_factor;
use deepct_core::math::DVec3;
use numpy::ndarray::Array3;
use numpy::{IntoPyArray, PyArray3, PyArrayMethods};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList, PySlice, PyTuple};
use std::path::PathBuf;

/// The axes of a volume.
pub(crate) const VOLUME: [&str; 3] = ["z", "y", "x"];
/// The axes of a stack of images.
const IMAGES: [&str; 3] = ["view", "row", "col"];

/// Tolerance of coordinates relative to their spacing: that of single precision.
const TOLERANCE: f64 = 1e-3;

/// The unit of an argument, and whether plain numbers may state that they have the unit 1.
fn unit_of(name: &str) -> (&'static str, bool) {
    match name {
        "radiance" | "standard_error" => ("sr-1", true),
        "effective_radius" => ("um", false),
        "liquid_water_content" => ("g m-3", false),
        "effective_variance" | "mask" | "saturated" => ("1", true),
        _ => ("km-1", false),
    }
}

/// The values of a stack of images: real numbers. Masked values are NaN, and a list of images of different
/// sizes is padded by NaN.
///
/// # Errors
/// `TypeError` if `object` does not hold real numbers; `ValueError` if it does not have three axes, or
/// has the units of another quantity.
pub(crate) fn images(object: &Bound<'_, PyAny>, name: &str) -> PyResult<Array3<f32>> {
    numbers(&Argument::new(object, name, IMAGES)?.filled(f64::NAN)?, name)
}

/// The values of a stack of images in the unit of a solar irradiance that is not 1, which numbers do not
/// state.
///
/// # Errors
/// As [`images`], except for the units.
pub(crate) fn images_in_any_unit(object: &Bound<'_, PyAny>, name: &str) -> PyResult<Array3<f32>> {
    reals(&Argument::new(object, name, IMAGES)?.filled(f64::NAN)?, name, 1.0)
}

/// Marks of the pixels of a stack of images: booleans, or the numbers 0 and 1.
///
/// # Errors
/// As [`images`]; `ValueError` if there are other numbers.
pub(crate) fn marks(object: &Bound<'_, PyAny>, name: &str) -> PyResult<Array3<bool>> {
    booleans(&Argument::new(object, name, IMAGES)?.filled(0.0)?, name)
}

/// The values of a volume, and the grid on which they are if the argument states it.
pub(crate) struct Placed<T> {
    pub(crate) values: Array3<T>,
    pub(crate) grid: Option<grid::Grid>,
    name: String,
}

/// The values of a volume: real numbers.
///
/// # Errors
/// As [`images`]; `ValueError` if its coordinates are not those of a grid.
pub(crate) fn volume(object: &Bound<'_, PyAny>, name: &str) -> PyResult<Placed<f32>> {
    let argument = Argument::new(object, name, VOLUME)?;
    Ok(Placed { values: numbers(&argument, name)?, grid: argument.grid, name: name.to_owned() })
}

/// A mask of voxels: booleans, or the numbers 0 and 1.
///
/// # Errors
/// As [`volume`]; `ValueError` if there are other numbers.
pub(crate) fn mask(object: &Bound<'_, PyAny>, name: &str) -> PyResult<Placed<bool>> {
    let argument = Argument::new(object, name, VOLUME)?;
    Ok(Placed { values: booleans(&argument, name)?, grid: argument.grid, name: name.to_owned() })
}

impl<T> Placed<T> {
    /// Values on a grid, of the argument `name`.
    pub(crate) fn new(grid: grid::Grid, values: Array3<T>, name: &str) -> Self {
        Self { values, grid: Some(grid), name: name.to_owned() }
    }

    /// The grid of the values: the given one, or that which the argument states.
    ///
    /// # Errors
    /// `ValueError` if the two contradict each other, or if there is none.
    pub(crate) fn grid(&self, given: Option<grid::Grid>) -> PyResult<grid::Grid> {
        agreed(&self.name, given, self.grid)
    }

    /// The values, which must be on the given grid if the argument states one.
    ///
    /// # Errors
    /// As [`Placed::grid`].
    pub(crate) fn on(self, grid: grid::Grid) -> PyResult<Array3<T>> {
        self.grid(Some(grid))?;
        Ok(self.values)
    }
}

/// The grid of an argument: the given one, or its own.
///
/// # Errors
/// `ValueError` if the two contradict each other, or if there is none.
pub(crate) fn agreed(
    name: &str,
    given: Option<grid::Grid>,
    own: Option<grid::Grid>,
) -> PyResult<grid::Grid> {
    match (given, own) {
        (Some(given), Some(own)) if !given.matches(&own) => Err(PyValueError::new_err(format!(
            "{name} is on another grid than the one expected: its coordinates are those of {}, but {} \
             is expected",
            described(&own),
            described(&given)
        ))),
        (Some(grid), _) | (None, Some(grid)) => Ok(grid),
        (None, None) => Err(PyValueError::new_err(format!(
            "grid is missing: give it, or {name} as an object with coordinates"
        ))),
    }
}

fn described(grid: &grid::Grid) -> String {
    let [nz, ny, nx] = grid.shape;
    let (lower, upper) = (grid.lower(), grid.upper());
    let along = |axis: usize| format!("{:.4} to {:.4}", lower[axis], upper[axis]);
    format!("{nz} x {ny} x {nx} voxels with z {}, y {}, x {} km", along(2), along(1), along(0))
}

/// An argument with its axes in order.
struct Argument<'py> {
    /// What NumPy can convert to an array.
    values: Bound<'py, PyAny>,
    /// The grid of its values, if it is known.
    grid: Option<grid::Grid>,
    axes: [&'static str; 3],
}

impl<'py> Argument<'py> {
    fn new(object: &Bound<'py, PyAny>, name: &str, axes: [&'static str; 3]) -> PyResult<Self> {
        // The name of the array in objects of this module and in data sets of xarray.
        let part = match name {
            "mask" | "effective_radius" | "radiance" | "standard_error" | "saturated" => name,
            _ => "extinction",
        };
        if object.extract::<PathBuf>().is_ok() {
            return Err(PyTypeError::new_err(format!(
                "{name} is \"{object}\", the name of a file, but must be an array: read the file before, \
                 for example with deepct_py.read_cloud, and give the array of the object"
            )));
        }
        let grid = object.getattr("grid").and_then(|grid| Ok(grid.cast_into::<Grid>()?));
        if let Ok(grid) = grid {
            let Grid(grid) = *grid.get();
            let values = object.getattr(part).map_err(|_| {
                let found = object.get_type();
                PyTypeError::new_err(format!("{name} is of {found}, which has no {part}"))
            })?;
            if values.is_none() {
                return Err(PyValueError::new_err(format!("{name} has no {part}")));
            }
            return Ok(Self { values, grid: Some(grid), axes });
        }
        let object = match is_dataset(object)? {
            true => object.get_item(part)?,
            false => object.clone(),
        };
        let values = in_order(object, name, axes)?;
        let grid = if axes == VOLUME { stated_grid(&values, name)? } else { None };
        Ok(Self { values, grid, axes })
    }

    /// The argument with masked images filled, and with images of different sizes in a list padded, by
    /// `missing`.
    fn filled(self, missing: f64) -> PyResult<Self> {
        if self.axes != IMAGES {
            return Ok(self);
        }
        let py = self.values.py();
        let numpy = py.import("numpy")?;
        let masked = numpy.getattr("ma")?;
        let fill = |part: &Bound<'py, PyAny>| -> PyResult<Bound<'py, PyAny>> {
            let kind = masked.getattr("MaskedArray")?;
            if !part.is_instance(&kind)? {
                return Ok(part.clone());
            }
            let dtype = numpy.call_method1("result_type", (part.getattr("dtype")?, "float32"))?;
            part.call_method1("astype", (dtype,))?.call_method1("filled", (missing,))
        };
        let is_list =
            self.values.is_instance_of::<PyList>() || self.values.is_instance_of::<PyTuple>();
        if !is_list {
            let values = fill(&self.values)?;
            return Ok(Self { values, ..self });
        }
        let parts: Vec<_> =
            self.values.try_iter()?.map(|part| fill(&part?)).collect::<PyResult<_>>()?;
        let shapes: Vec<Vec<usize>> = parts
            .iter()
            .map(|part| numpy.call_method1("shape", (part,))?.extract())
            .collect::<PyResult<_>>()?;
        let is_ragged = shapes.iter().any(|shape| *shape != shapes[0]);
        if !is_ragged || shapes.iter().any(|shape| shape.len() != 2) {
            let values = PyList::new(py, parts)?.into_any();
            return Ok(Self { values, ..self });
        }
        let most = |axis: usize| shapes.iter().map(|shape| shape[axis]).max().unwrap_or(0);
        let whole = [most(0), most(1)];
        let padded = numpy.call_method1("full", ((parts.len(), whole[0], whole[1]), missing))?;
        for ((number, part), shape) in parts.iter().enumerate().zip(&shapes) {
            let first = first_of_padded([shape[0], shape[1]], whole);
            let range = |axis: usize| {
                let start = first[axis] as isize;
                PySlice::new(py, start, start + shape[axis] as isize, 1)
            };
            padded.set_item((number, range(0), range(1)), part)?;
        }
        Ok(Self { values: padded, ..self })
    }

    /// The argument as an array of NumPy with three axes and one of the given kinds of numbers.
    fn array(&self, name: &str, kinds: &str, wanted: &str) -> PyResult<Bound<'py, PyAny>> {
        let py = self.values.py();
        let numpy = py.import("numpy")?;
        let masked = numpy.getattr("ma")?;
        let is_masked = |object: &Bound<'_, PyAny>| -> PyResult<bool> {
            masked.call_method1("is_masked", (object,))?.extract()
        };
        let mut any = is_masked(&self.values)?;
        // NumPy also drops the masks of the parts of a list.
        if self.values.is_instance_of::<PyList>() || self.values.is_instance_of::<PyTuple>() {
            for part in self.values.try_iter()? {
                any |= is_masked(&part?)?;
            }
        }
        if any {
            return Err(PyValueError::new_err(format!(
                "{name} is a masked array with masked values, which would be read as if they were \
                 valid: fill them, for example with {name}.filled(0)"
            )));
        }
        let array = numpy.call_method1("asarray", (&self.values,))?;
        let dtype = array.getattr("dtype")?;
        let kind: String = dtype.getattr("kind")?.extract()?;
        if !kinds.contains(&kind) {
            // NumPy does not ask an object for DLPack of its own accord.
            let is_dlpack = kind == "O" && self.values.hasattr("__dlpack__")?;
            return Err(PyTypeError::new_err(match is_dlpack {
                true => format!("{name} is no NumPy array: give numpy.from_dlpack({name})"),
                false => format!("{name} is an array of {dtype}, not of {wanted}: convert it"),
            }));
        }
        let dimensions: usize = array.getattr("ndim")?.extract()?;
        if dimensions != 3 {
            return Err(PyValueError::new_err(format!(
                "{name} has {dimensions} axes, but must have 3: [{}]",
                self.axes.join(", ")
            )));
        }
        Ok(array)
    }
}

fn numbers(argument: &Argument<'_>, name: &str) -> PyResult<Array3<f32>> {
    reals(argument, name, unit_factor_of(&argument.values, name)?)
}

fn reals(argument: &Argument<'_>, name: &str, factor: f64) -> PyResult<Array3<f32>> {
    let array = argument.array(name, "fiu", "real numbers")?;
    let array = if factor == 1.0 { array } else { array.mul(factor)? };
    let array = array.call_method1("astype", ("float32", "C", "unsafe", true, false))?;
    Ok(array.cast_into::<PyArray3<f32>>()?.try_readonly()?.as_array().to_owned())
}

fn booleans(argument: &Argument<'_>, name: &str) -> PyResult<Array3<bool>> {
    let array = argument.array(name, "bfiu", "booleans")?;
    let array = array.call_method1("astype", ("float32", "C", "unsafe", true, false))?;
    let array = array.cast_into::<PyArray3<f32>>()?.try_readonly()?;
    match array.as_array().iter().find(|number| **number != 0.0 && **number != 1.0) {
        None => Ok(array.as_array().mapv(|number| number == 1.0)),
        Some(number) => Err(PyValueError::new_err(format!(
            "{name} holds {number}, but must hold booleans, or the numbers 0 and 1"
        ))),
    }
}

/// The factor by which the numbers of an object that states its unit are multiplied: an xarray object
/// by its attribute `units`, a quantity of pint or astropy by its unit.
fn unit_factor_of(object: &Bound<'_, PyAny>, name: &str) -> PyResult<f64> {
    let (unit, is_plain) = unit_of(name);
    let attribute = object.getattr("attrs").and_then(|attrs| attrs.get_item("units"));
    let quantity = || object.getattr("magnitude").and_then(|_| object.getattr("units"));
    let stated = attribute.or_else(|_| quantity()).or_else(|_| object.getattr("unit"));
    let Ok(stated) = stated else { return Ok(1.0) };
    let stated = stated.str()?.to_string();
    if is_plain && matches!(stated.trim(), "" | "1") {
        return Ok(1.0);
    }
    // Some programs write a space before a power.
    unit_factor(&stated.trim().replace(" -", "-"), unit).ok_or_else(|| {
        PyValueError::new_err(format!(
            "{name} has the units \"{stated}\", but {unit} is expected: convert the values and give \
             them as numbers, or with these units"
        ))
    })
}

/// An xarray object with its axes in the given order and its coordinates ascending. An object without
/// these names is returned as it is, as its order cannot be checked.
fn in_order<'py>(
    mut object: Bound<'py, PyAny>,
    name: &str,
    axes: [&str; 3],
) -> PyResult<Bound<'py, PyAny>> {
    let dims = object.getattr("dims").and_then(|dims| Ok(dims.cast_into::<PyTuple>()?));
    let Ok(dims) = dims else { return Ok(object) };
    let found: Vec<String> = dims.iter().filter_map(|dim| dim.extract().ok()).collect();
    if found.len() != dims.len() || !axes.iter().all(|axis| found.iter().any(|dim| dim == axis)) {
        return Ok(object);
    }
    let sizes = object.getattr("sizes")?;
    for other in found.iter().filter(|dim| !axes.contains(&dim.as_str())) {
        let size: usize = sizes.get_item(other)?.extract()?;
        if size != 1 {
            return Err(PyValueError::new_err(format!(
                "{name} has an axis {other} of length {size}: select one of its elements, for \
                 example with {name}.isel({other}=0)"
            )));
        }
        object = object.call_method1("squeeze", (other,))?;
    }
    if found != axes {
        object = object.call_method1("transpose", PyTuple::new(object.py(), axes)?)?;
    }
    ascending(object, name, axes)
}

/// An xarray object whose coordinates along the given axes ascend: one with descending ones is turned.
///
/// # Errors
/// `ValueError` if the coordinates neither ascend nor descend.
pub(crate) fn ascending<'py>(
    mut object: Bound<'py, PyAny>,
    name: &str,
    axes: [&str; 3],
) -> PyResult<Bound<'py, PyAny>> {
    for axis in axes {
        let Some(values) = coordinate(&object, axis)? else { continue };
        let steps = || values.windows(2).map(|pair| pair[1] - pair[0]);
        if steps().all(|step| step > 0.0) {
            continue;
        }
        if !steps().all(|step| step < 0.0) {
            return Err(PyValueError::new_err(format!(
                "{name} has coordinates along {axis} that do not ascend: sort it, for example by \
                 {name}.sortby(\"{axis}\")"
            )));
        }
        let reversed = PyDict::new(object.py());
        reversed.set_item(axis, object.py().eval(c"slice(None, None, -1)", None, None)?)?;
        object = object.call_method("isel", (), Some(&reversed))?;
    }
    Ok(object)
}

/// The coordinates of an xarray object along an axis; `None` if it has no numbers there.
fn coordinate(object: &Bound<'_, PyAny>, axis: &str) -> PyResult<Option<Vec<f64>>> {
    let coordinates = object.getattr("coords")?;
    if !coordinates.contains(axis)? {
        return Ok(None);
    }
    let values = coordinates.get_item(axis)?.getattr("values")?.call_method0("tolist")?;
    Ok(values.extract().ok())
}

/// Refuse an xarray object whose pixels are not those of the radiance.
pub(crate) fn check_pixels(
    radiance: &Bound<'_, PyAny>,
    other: Option<&Bound<'_, PyAny>>,
    name: &str,
) -> PyResult<()> {
    let Some(other) = other else { return Ok(()) };
    if !radiance.hasattr("coords")? || !other.hasattr("coords")? {
        return Ok(());
    }
    for axis in IMAGES {
        let both = coordinate(radiance, axis)?.zip(coordinate(other, axis)?);
        if both.is_some_and(|(expected, found)| expected != found) {
            return Err(PyValueError::new_err(format!(
                "{name} has coordinates along {axis} that are not those of radiance: select the \
                 same part of both"
            )));
        }
    }
    Ok(())
}

/// The grid that the coordinates of an xarray object state; `None` if it has none along one of the
/// axes, a single one without its spacing, or indices.
fn stated_grid(object: &Bound<'_, PyAny>, name: &str) -> PyResult<Option<grid::Grid>> {
    if !object.hasattr("coords")? {
        return Ok(None);
    }
    let (mut origin, mut spacing, mut shape) = (DVec3::ZERO, DVec3::ZERO, [0; 3]);
    for (number, axis) in VOLUME.into_iter().enumerate() {
        let Some(values) = coordinate(object, axis)? else { return Ok(None) };
        let attributes = object.getattr("coords")?.get_item(axis)?.getattr("attrs")?;
        let attribute = |name: &str| attributes.get_item(name).ok();
        let is_index = |(index, value): (usize, &f64)| *value == index as f64;
        if attribute("units").is_none() && values.iter().enumerate().all(is_index) {
            return Ok(None);
        }
        let units: String =
            attribute("units").map_or_else(|| Ok("km".into()), |units| units.extract())?;
        let to_km = unit_factor(&units, "km").ok_or_else(|| {
            PyValueError::new_err(format!(
                "{name} has coordinates along {axis} in the units \"{units}\", but km is expected"
            ))
        })?;
        let number_of = |name| attribute(name).and_then(|value| value.extract::<f64>().ok());
        // The attributes of deepct's own files are exact, unless a part was selected.
        let exact = number_of("lower_edge").zip(number_of("spacing")).filter(|(edge, step)| {
            let expected = |index: usize| edge + step * (index as f64 + 0.5);
            let differs = |(index, value): (usize, &f64)| {
                (value - expected(index)).abs() > TOLERANCE * step.abs()
            };
            !values.iter().enumerate().any(differs)
        });
        let (edge, step) = match (exact, values.as_slice()) {
            (Some(exact), _) => exact,
            (None, [first, .., last]) => {
                let step = (last - first) / (values.len() - 1) as f64;
                let expected = |index: usize| first + step * index as f64;
                let mut off =
                    values.iter().enumerate().map(|(index, value)| value - expected(index));
                if off.any(|off| off.abs() > TOLERANCE * step) {
                    return Err(PyValueError::new_err(format!(
                        "{name} has coordinates along {axis} that are not equidistant: interpolate it \
                         to a regular grid"
                    )));
                }
                (first - 0.5 * step, step)
            }
            (None, _) => return Ok(None),
        };
        let axis = 2 - number;
        (origin[axis], spacing[axis], shape[number]) = (to_km * edge, to_km * step, values.len());
    }
    grid::Grid::new(origin, spacing, shape).map(Some).map_err(crate::error::raise)
}

/// The grid of an xarray object, from its coordinates.
///
/// # Errors
/// `ValueError` if it has none.
pub(crate) fn grid_of(object: &Bound<'_, PyAny>) -> PyResult<grid::Grid> {
    let object = match is_dataset(object)? {
        true => object.getattr("coords")?.call_method0("to_dataset")?,
        false => object.clone(),
    };
    let name = "the object";
    stated_grid(&ascending(object, name, VOLUME)?, name)?.ok_or_else(|| {
        PyValueError::new_err(
            "the object has no grid: it needs coordinates z, y and x of the voxel centres, at least \
             two along each axis",
        )
    })
}

/// Transfer an array to Python, without a copy.
pub(crate) fn give<T: numpy::Element>(py: Python<'_>, values: Array3<T>) -> Py<PyArray3<T>> {
    values.into_pyarray(py).unbind()
}

/// A copy of the values of an array, which Python may have changed.
pub(crate) fn copied<T: numpy::Element + Clone>(
    py: Python<'_>,
    array: &Py<PyArray3<T>>,
) -> PyResult<Array3<T>> {
    Ok(array.bind(py).try_readonly()?.as_array().to_owned())
}
