//! Conversion of array arguments and results: NumPy arrays, and objects that NumPy can convert to
//! an array, such as xarray's `DataArray`.

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
    let kind: String = dtype.getattr("kind")?.extract()?;
    if !kinds.contains(&kind) {
        let wanted = if kinds == "b" { "booleans" } else { "real numbers" };
        // NumPy does not ask an object for DLPack of its own accord.
        let is_dlpack = kind == "O" && object.hasattr("__dlpack__")?;
        return Err(PyTypeError::new_err(match is_dlpack {
            true => format!("{name} is no NumPy array: give numpy.from_dlpack({name})"),
            false => format!("{name} is an array of {dtype}, not of {wanted}: convert it"),
        }));
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

/// Refuse an xarray object whose coordinates along one of the axes of a volume descend.
fn check_ascending(object: &Bound<'_, PyAny>, name: &str, axes: [&str; 3]) -> PyResult<()> {
    let Ok(coordinates) = object.getattr("coords") else { return Ok(()) };
    for axis in axes {
        let Ok(values) = coordinates.get_item(axis).and_then(|axis| axis.getattr("values")) else {
            continue;
        };
        let Ok(values) = values.call_method0("tolist").and_then(|list| list.extract::<Vec<f64>>())
        else {
            continue;
        };
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
