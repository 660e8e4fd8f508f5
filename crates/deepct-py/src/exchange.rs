//! Exchange with files and with xarray, whose data sets have the names, coordinates, units and attributes
//! of the files: they are written to a temporary file and read from it.

use crate::array::{VOLUME, ascending};
use crate::error::raise;
use crate::light::warn;
use crate::lineage::Lineage;
use deepct_core::Result;
use deepct_core::io::{self, Provenance};
use pyo3::exceptions::{PyFileExistsError, PyOSError};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyDict, PyEllipsis, PyList, PyString, PyTuple};
use std::cell::RefCell;
use std::path::Path;

/// What a file written by this module records about itself.
pub(crate) fn provenance(title: &str, lineage: &Lineage) -> Provenance {
    Provenance {
        title: title.into(),
        configuration: String::new(),
        seed: 0,
        lineage: lineage.0.clone(),
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
    let loaded = xarray.call_method1("load_dataset", (path,))?;
    // Without the encoding, which names the temporary file, but with that of the time.
    let dataset = loaded.call_method0("drop_encoding")?;
    if dataset.contains("time")? {
        let encoding = |of: &Bound<'py, PyAny>| of.get_item("time")?.getattr("encoding");
        for key in ["units", "calendar", "dtype"] {
            if let Ok(value) = encoding(&loaded)?.get_item(key) {
                encoding(&dataset)?.set_item(key, value)?;
            }
        }
    }
    Ok(dataset)
}

/// The lock of Python that a thread holds while it writes by netCDF4-python.
static WRITING: PyOnceLock<Py<PyAny>> = PyOnceLock::new();

/// The dimensions of all files, in the order that their variables have.
const ORDER: [&str; 8] = ["time", "view", "z", "row", "y", "col", "x", "component"];

thread_local! {
    /// The temporary file that this thread reads, and what messages call it.
    static READING: RefCell<Option<(String, String)>> = const { RefCell::new(None) };
}

/// A message with the data set of xarray in the place of the temporary file.
pub(crate) fn named(message: &str) -> String {
    READING.with_borrow(|reading| match reading {
        None => message.to_owned(),
        Some((path, name)) => message.replace(path, name),
    })
}

/// Whether an argument is a data set of xarray.
pub(crate) fn is_dataset(object: &Bound<'_, PyAny>) -> PyResult<bool> {
    object.hasattr("data_vars")
}

/// What `read` reads from a file with the contents of a data set of fields, whose coordinates may descend.
pub(crate) fn through_field<T>(
    dataset: &Bound<'_, PyAny>,
    name: &str,
    read: impl FnOnce(&Path) -> PyResult<T>,
) -> PyResult<T> {
    through_file(&ascending(dataset.clone(), "the data set", VOLUME)?, name, read)
}

/// The numbers in files that tell where and when their fields were seen.
const CIRCUMSTANCES: [&str; 6] =
    ["time", "light", "sun_zenith_deg", "sun_azimuth_deg", "sun_irradiance", "wavelength"];

/// What `read` reads from a file with the time, the light and the history of a data set; `None` if it has
/// none of these.
pub(crate) fn through_circumstances<T>(
    dataset: &Bound<'_, PyAny>,
    read: impl FnOnce(&Path) -> PyResult<T>,
) -> PyResult<Option<T>> {
    let py = dataset.py();
    let axes = dataset.getattr("sizes")?.try_iter()?.collect::<PyResult<Vec<_>>>()?;
    let scalars = dataset.call_method1("drop_dims", (axes,))?;
    let names: Vec<_> = CIRCUMSTANCES
        .into_iter()
        .filter_map(|name| scalars.contains(name).map(|has| has.then_some(name)).transpose())
        .collect::<PyResult<_>>()?;
    let attributes = PyDict::new(py);
    if let Ok(history) = dataset.getattr("attrs")?.get_item("history") {
        attributes.set_item("history", history.str()?)?;
    }
    if names.is_empty() && attributes.is_empty() {
        return Ok(None);
    }
    let chosen = scalars.get_item(PyList::new(py, names)?)?;
    chosen.setattr("attrs", attributes)?;
    through_file(&chosen, "", read).map(Some)
}

/// What `read` reads from a file with the contents of a data set of xarray, whose axes are put in order.
/// `name` is that of the argument; empty if there is no other one.
pub(crate) fn through_file<T>(
    dataset: &Bound<'_, PyAny>,
    name: &str,
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
    let name = format!("the data set {name}").trim_end().to_owned();
    let outer = READING.replace(Some((path.display().to_string(), name)));
    let found = read(&path);
    READING.set(outer);
    found
}

/// Warns of a file whose computation was interrupted.
pub(crate) fn warn_of_incomplete(py: Python<'_>, path: &Path) -> PyResult<()> {
    match py.detach(|| io::incomplete(path)) {
        None => Ok(()),
        Some(lacking) => warn(py, &format!("{} is incomplete: {lacking}", path.display())),
    }
}

/// Returns an error if a file that deepct did not write is at `path`, unless it may be overwritten.
///
/// # Errors
/// `FileExistsError`.
pub(crate) fn check_origin(path: &Path, overwrite: bool) -> PyResult<()> {
    if overwrite || io::is_replaceable(path) {
        return Ok(());
    }
    Err(PyFileExistsError::new_err(format!(
        "{} exists and is not a file that deepct wrote there before: give another name, or \
         overwrite=True to replace it",
        path.display()
    )))
}

/// Runs `write` with the path that Python gave.
///
/// # Errors
/// As [`check_origin`] and `write`.
pub(crate) fn write(
    py: Python<'_>,
    path: &Path,
    overwrite: bool,
    write: impl FnOnce(&Path) -> Result<()> + Send,
) -> PyResult<()> {
    check_origin(path, overwrite)?;
    py.detach(|| write(path)).map_err(raise)
}

fn temporary() -> PyResult<tempfile::TempDir> {
    tempfile::tempdir().map_err(|problem| PyOSError::new_err(problem.to_string()))
}
