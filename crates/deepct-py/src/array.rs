//! Arrays in and out: NumPy arrays, and what NumPy can make one of, such as xarray's
//! `DataArray`.

use numpy::ndarray::{Array3, ArrayView3};
use numpy::{IntoPyArray, PyArray3, PyArrayMethods, PyReadonlyArray3};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyTuple;

/// The axes of a volume.
pub(crate) const VOLUME: [&str; 3] = ["z", "y", "x"];
/// The axes of a stack of images.
pub(crate) const IMAGES: [&str; 3] = ["view", "row", "col"];

/// A three-dimensional array of 32-bit floats that Python owns. It is not copied when
/// it is one already.
pub(crate) struct Floats<'py>(PyReadonlyArray3<'py, f32>);

impl<'py> Floats<'py> {
    /// The array that `object` is, whose axes have the names `axes`.
    ///
    /// # Errors
    /// `TypeError` for what is not numbers, `ValueError` for another number of axes, and
    /// for named axes (of xarray) in another order.
    pub(crate) fn new(object: &Bound<'py, PyAny>, name: &str, axes: [&str; 3]) -> PyResult<Self> {
        let array = numbers(object, name, axes, "fiub")?;
        let array = array.call_method1("astype", ("float32", "C", "unsafe", true, false))?;
        Ok(Self(array.cast_into::<PyArray3<f32>>()?.try_readonly()?))
    }

    /// The values, without a copy.
    pub(crate) fn view(&self) -> ArrayView3<'_, f32> {
        self.0.as_array()
    }

    /// The values as an array of the library's own: one copy.
    pub(crate) fn to_owned(&self) -> Array3<f32> {
        self.view().as_standard_layout().into_owned()
    }
}

/// The array of booleans that `object` is, copied, whose axes have the names `axes`.
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

/// Refuse an xarray object whose axes have our names in another order. Other names say
/// nothing and are let through.
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

/// Hand an array over to Python, without a copy.
pub(crate) fn give<T: numpy::Element>(py: Python<'_>, values: Array3<T>) -> Py<PyArray3<T>> {
    values.into_pyarray(py).unbind()
}
