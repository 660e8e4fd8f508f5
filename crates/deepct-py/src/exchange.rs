//! Exchange with files and with xarray, whose data sets have the names, coordinates, units and attributes
//! of the files: they are written to a temporary file and read from it.

use crate::error::raise;
use crate::light::warn;
use deepct_core::Result;
use deepct_core::io::{self, Provenance};
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyDict, PyEllipsis, PyString, PyTuple};
use std::path::Path;

/// What a file written by this module records about itself.
pub(crate) fn provenance(title: &str) -> Provenance {
    Provenance {
        title: title.into(),
        configuration: String::new(),
        seed: 0,
        ..Provenance::default()
    }
}

/// A data set of xarray with the contents of the file that `write` writes.
pub(crate) fn dataset<'py>(
    py: Python<'py>,
    write: impl FnOnce(&Path) -> PyResult<()>,
) -> PyResult<Bound<'py, PyAny>> {
    let xarray = py.import("xarray")?;
    let folder = temporary()?;
    let path = folder.path().join("data.nc");
    write(&path)?;
    // Without the encoding, which names the temporary file.
    xarray.call_method1("load_dataset", (path,))?.call_method0("drop_encoding")
}

/// The lock of Python that a thread holds while it writes by netCDF4-python.
static WRITING: PyOnceLock<Py<PyAny>> = PyOnceLock::new();

/// The dimensions of all files, in the order that their variables have.
const ORDER: [&str; 8] = ["time", "view", "z", "row", "y", "col", "x", "component"];

/// What `read` reads from a file with the contents of a data set of xarray, whose axes are put in order.
pub(crate) fn through_file<T>(
    dataset: &Bound<'_, PyAny>,
    read: impl FnOnce(&Path) -> PyResult<T>,
) -> PyResult<T> {
    let folder = temporary()?;
    let path = folder.path().join("data.nc");
    let py = dataset.py();
    let names = ORDER.map(|name| PyString::new(py, name).into_any());
    let order: Vec<_> =
        names.into_iter().chain([PyEllipsis::get(py).to_owned().into_any()]).collect();
    let options = PyDict::new(py);
    options.set_item("missing_dims", "ignore")?;
    let dataset = dataset.call_method("transpose", PyTuple::new(py, order)?, Some(&options))?;
    let options = PyDict::new(py);
    options.set_item("format", "NETCDF4")?;
    // Threads, such as those of dask, must not write by netCDF4-python at the same time: it ends the process.
    if py.import("h5netcdf").is_ok() {
        options.set_item("engine", "h5netcdf")?;
        dataset.call_method("to_netcdf", (&path,), Some(&options))?;
    } else {
        let lock = WRITING.get_or_try_init(py, || -> PyResult<Py<PyAny>> {
            Ok(py.import("threading")?.call_method0("Lock")?.unbind())
        })?;
        lock.call_method0(py, "acquire")?;
        let written = dataset.call_method("to_netcdf", (&path,), Some(&options));
        lock.call_method0(py, "release")?;
        written?;
    }
    read(&path).map_err(|problem| without_path(py, problem, &path))
}

/// Warns of a file whose computation was interrupted.
pub(crate) fn warn_of_incomplete(py: Python<'_>, path: &Path) -> PyResult<()> {
    match py.detach(|| io::incomplete(path)) {
        None => Ok(()),
        Some(lacking) => warn(py, &format!("{} is incomplete: {lacking}", path.display())),
    }
}

/// The exception with "the data set" in the place of the name of a temporary file.
fn without_path(py: Python<'_>, problem: PyErr, path: &Path) -> PyErr {
    let text = problem.value(py).to_string();
    let text = text.replace(&path.display().to_string(), "the data set");
    PyErr::from_type(problem.get_type(py), text)
}

/// Runs `write` with the path that Python gave.
pub(crate) fn write(
    py: Python<'_>,
    path: &Path,
    write: impl FnOnce(&Path) -> Result<()> + Send,
) -> PyResult<()> {
    py.detach(|| write(path)).map_err(raise)
}

fn temporary() -> PyResult<tempfile::TempDir> {
    tempfile::tempdir().map_err(|problem| PyOSError::new_err(problem.to_string()))
}
