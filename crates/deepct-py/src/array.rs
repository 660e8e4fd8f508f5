//! Conversion of array arguments and results: NumPy arrays, and objects that NumPy can convert to
//! an array, such as xarray's `DataArray`.

use deepct_core::grid::Grid;
use numpy::ndarray::{Array3, ArrayView3};
use numpy::{IntoPyArray, PyArray3, PyArrayMethods, PyReadonlyArray3};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyList, PyTuple};

/// The axes of a volume.
pub(crate) const VOLUME: [&str; 3] = ["z", "y", "x"];
/// The axes of a stack of images.
pub(crate) const IMAGES: [&str; 3] = ["view", "row", "col"];

/// The units of the arguments with the given names, by their usual spellings, the first of which is
/// named in messages.
const UNITS: [(&[&str], &[&str]); 3] = [
    (
        &["extinction", "start", "truth", "estimate", "uncertainty"],
        &["km-1", "1/km", "km^-1", "km**-1", "1 / kilometer", "km -1"],
    ),
    (&["radiance", "standard_error"], &["sr-1", "1/sr", "sr^-1", "sr**-1", "1 / sr", "1", ""]),
    (
        &["effective_radius"],
        &["um", "\u{b5}m", "\u{3bc}m", "micron", "microns", "micrometer", "micrometre"],
    ),
];

/// Largest difference between equal coordinates, relative to their spacing.
const ROUNDING: f64 = 0.05;

/// A three-dimensional array of 32-bit floats owned by Python. An argument that already is a
/// C-contiguous array of this type is not copied.
pub(crate) struct Floats<'py>(PyReadonlyArray3<'py, f32>);

impl<'py> Floats<'py> {
    /// Convert `object`, whose axes must be `axes`.
    ///
    /// # Errors
    /// `TypeError` if `object` does not hold real numbers; `ValueError` if it does not have three
    /// axes, or if it is an xarray object with these axes in another order.
    pub(crate) fn new(object: &Bound<'py, PyAny>, name: &str, axes: [&str; 3]) -> PyResult<Self> {
        let array = numbers(object, name, axes, "fiu")?;
        let array = array.call_method1("astype", ("float32", "C", "unsafe", true, false))?;
        Ok(Self(array.cast_into::<PyArray3<f32>>()?.try_readonly()?))
    }

    /// A view of the values, without a copy.
    pub(crate) fn view(&self) -> ArrayView3<'_, f32> {
        self.0.as_array()
    }

    /// A copy of the values, owned by the library.
    pub(crate) fn to_owned(&self) -> Array3<f32> {
        self.view().as_standard_layout().into_owned()
    }
}

/// Convert `object`, whose axes must be `axes`, to an array of booleans. The values are copied.
///
/// # Errors
/// As [`Floats::new`], with booleans in place of real numbers.
pub(crate) fn booleans(
    object: &Bound<'_, PyAny>,
    name: &str,
    axes: [&str; 3],
) -> PyResult<Array3<bool>> {
    let array = numbers(object, name, axes, "b")?.cast_into::<PyArray3<bool>>()?;
    Ok(array.try_readonly()?.as_array().as_standard_layout().into_owned())
}

fn numbers<'py>(
    object: &Bound<'py, PyAny>,
    name: &str,
    axes: [&str; 3],
    kinds: &str,
) -> PyResult<Bound<'py, PyAny>> {
    check_names(object, name, axes)?;
    check_units(object, name)?;
    check_ascending(object, name, axes)?;
    let masked = object.py().import("numpy")?.getattr("ma")?;
    let is_masked = |object: &Bound<'_, PyAny>| -> PyResult<bool> {
        masked.call_method1("is_masked", (object,))?.extract()
    };
    // NumPy also drops the masks of the parts of a list.
    let parts = object.is_instance_of::<PyList>() || object.is_instance_of::<PyTuple>();
    let mut any = is_masked(object)?;
    if parts {
        for part in object.try_iter()? {
            any |= is_masked(&part?)?;
        }
    }
    if any {
        return Err(PyValueError::new_err(format!(
            "{name} is a masked array with masked values, which would be read as if they were \
             valid: fill them, for example with {name}.filled(0)"
        )));
    }
    let array = object.py().import("numpy")?.call_method1("asarray", (object,))?;
    let dtype = array.getattr("dtype")?;
    if !kinds.contains(&dtype.getattr("kind")?.extract::<String>()?) {
        let wanted = if kinds == "b" { "booleans" } else { "real numbers" };
        return Err(PyTypeError::new_err(format!(
            "{name} is an array of {dtype}, not of {wanted}"
        )));
    }
    let dimensions: usize = array.getattr("ndim")?.extract()?;
    if dimensions != 3 {
        return Err(PyValueError::new_err(format!(
            "{name} has {dimensions} axes, but must have 3: [{}]",
            axes.join(", ")
        )));
    }
    Ok(array)
}

/// Refuse an object that states another unit than that of the argument: an xarray object by its
/// attribute `units`, a quantity of pint or astropy by its unit.
fn check_units(object: &Bound<'_, PyAny>, name: &str) -> PyResult<()> {
    let Some((_, spellings)) = UNITS.iter().find(|(names, _)| names.contains(&name)) else {
        return Ok(());
    };
    let attribute = object.getattr("attrs").and_then(|attrs| attrs.get_item("units"));
    let quantity = || object.getattr("magnitude").and_then(|_| object.getattr("units"));
    let stated = attribute.or_else(|_| quantity()).or_else(|_| object.getattr("unit"));
    let Ok(stated) = stated else { return Ok(()) };
    let stated = stated.str()?.to_string();
    if spellings.contains(&stated.trim()) {
        return Ok(());
    }
    Err(PyValueError::new_err(format!(
        "{name} has the units \"{stated}\", but {} is expected: convert the values and give them as \
         numbers, or with these units",
        spellings[0]
    )))
}

/// The coordinates of an xarray object along an axis; those with the unit of a length are in km.
fn coordinates(object: &Bound<'_, PyAny>, axis: &str) -> Option<Vec<f64>> {
    let axis = object.getattr("coords").ok()?.get_item(axis).ok()?;
    let values = axis.getattr("values").ok()?.call_method0("tolist").ok()?;
    let mut values: Vec<f64> = values.extract().ok()?;
    let unit = axis.getattr("attrs").and_then(|attributes| attributes.get_item("units"));
    let unit = unit.and_then(|unit| unit.extract::<String>()).unwrap_or_default();
    if ["m", "meter", "meters", "metre", "metres"].contains(&unit.trim()) {
        values.iter_mut().for_each(|value| *value *= 1e-3);
    }
    Some(values)
}

/// An argument that may be missing, and its name.
pub(crate) type Named<'a, 'py> = (Option<&'a Bound<'py, PyAny>>, &'static str);

/// Refuse xarray objects whose coordinates are not those of `grid`. Numbers from 0 are indices.
pub(crate) fn check_on_grid(grid: &Grid, arguments: &[Named]) -> PyResult<()> {
    let [x, y, z] = grid.axes();
    for (axis, centres) in VOLUME.into_iter().zip([z, y, x]) {
        for (object, name) in arguments {
            let Some(found) = object.and_then(|object| coordinates(object, axis)) else { continue };
            let indices = found.iter().enumerate().all(|(index, value)| *value == index as f64);
            if !indices {
                check_equal([name, "the grid"], [&found, &centres], axis)?;
            }
        }
    }
    Ok(())
}

/// Refuse xarray objects whose coordinates differ from those of the first of them.
pub(crate) fn check_same(arguments: &[Named], axes: [&str; 3]) -> PyResult<()> {
    for axis in axes {
        let mut known = arguments
            .iter()
            .filter_map(|(object, name)| Some((coordinates((*object)?, axis)?, name)));
        let Some((first, first_name)) = known.next() else { continue };
        for (other, name) in known {
            check_equal([name, first_name], [&other, &first], axis)?;
        }
    }
    Ok(())
}

/// Refuse coordinates that differ by more than rounding. Other numbers of them are the error of
/// another check.
fn check_equal(names: [&str; 2], [one, other]: [&[f64]; 2], axis: &str) -> PyResult<()> {
    let ends = |values: &[f64]| [values[0], values[values.len() - 1]];
    if one.len() != other.len() || one.is_empty() {
        return Ok(());
    }
    let ([first, last], [other_first, other_last]) = (ends(one), ends(other));
    let step = (last - first).abs() / (one.len() - 1).max(1) as f64;
    let tolerance = ROUNDING * step.max(1e-3 * first.abs());
    if one.iter().zip(other).all(|(one, other)| (one - other).abs() <= tolerance) {
        return Ok(());
    }
    let [name, other_name] = names;
    Err(PyValueError::new_err(format!(
        "{name} has coordinates along {axis} from {first} to {last}, but {other_name} from \
         {other_first} to {other_last}: select or interpolate the same part, or give arrays without \
         coordinates"
    )))
}

/// Refuse an xarray object whose coordinates along one of the axes of a volume descend.
fn check_ascending(object: &Bound<'_, PyAny>, name: &str, axes: [&str; 3]) -> PyResult<()> {
    for axis in axes {
        let Some(values) = coordinates(object, axis) else { continue };
        if values.windows(2).any(|pair| pair[1] <= pair[0]) {
            return Err(PyValueError::new_err(format!(
                "{name} has coordinates along {axis} that do not ascend: sort it, for example by \
                 {name}.sortby(\"{axis}\")"
            )));
        }
    }
    Ok(())
}

/// Refuse an xarray object that has the expected axis names in another order. An object with any
/// other axis names is accepted, as its order cannot be checked.
fn check_names(object: &Bound<'_, PyAny>, name: &str, axes: [&str; 3]) -> PyResult<()> {
    let Ok(dims) = object.getattr("dims") else { return Ok(()) };
    let Ok(dims) = dims.cast_into::<PyTuple>() else { return Ok(()) };
    let found: Vec<String> = dims.iter().filter_map(|dim| dim.extract().ok()).collect();
    let permuted = found.len() == 3 && axes.iter().all(|axis| found.iter().any(|dim| dim == axis));
    if permuted && found != axes {
        return Err(PyValueError::new_err(format!(
            "{name} has the axes [{}], but must have [{}]: transpose it",
            found.join(", "),
            axes.join(", ")
        )));
    }
    Ok(())
}

/// Transfer an array to Python, without a copy.
pub(crate) fn give<T: numpy::Element>(py: Python<'_>, values: Array3<T>) -> Py<PyArray3<T>> {
    values.into_pyarray(py).unbind()
}
