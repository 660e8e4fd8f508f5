//! Conversion of array arguments and results: NumPy arrays, and objects that NumPy can convert to
//! an array, such as xarray's `DataArray`.

use numpy::ndarray::{Array3, ArrayView3};
use numpy::{IntoPyArray, PyArray3, PyArrayMethods, PyReadonlyArray3};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyTuple;

/// The axes of a volume.
pub(crate) const VOLUME: [&str; 3] = ["z", "y", "x"];
/// The axes of a stack of images.
pub(crate) const IMAGES: [&str; 3] = ["view", "row", "col"];

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
    let masked = object.py().import("numpy")?.getattr("ma")?;
    if masked.call_method1("is_masked", (object,))?.extract()? {
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
