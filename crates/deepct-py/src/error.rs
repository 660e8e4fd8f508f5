//! Errors of the library as exceptions of Python.

use deepct_core::Error;
use pyo3::PyErr;
use pyo3::exceptions::{PyOSError, PyValueError};

pyo3::create_exception!(
    deepct_py,
    DeepctError,
    pyo3::exceptions::PyException,
    "A file was opened, but what it holds cannot be used."
);

/// `ValueError` for an argument, `OSError` (or the subclass that its number asks for, such
/// as `FileNotFoundError`) where the operating system refused, [`DeepctError`] for the
/// contents of a file.
pub(crate) fn raise(error: Error) -> PyErr {
    match error {
        Error::OutOfRange { .. } | Error::Mismatch { .. } => {
            PyValueError::new_err(error.to_string())
        }
        Error::Io { path, source } => match source.raw_os_error() {
            Some(number) => {
                // Python says the number itself.
                let text = source.to_string();
                let text = text.split(" (os error").next().unwrap_or_default().to_owned();
                PyOSError::new_err((number, text, path.into_os_string()))
            }
            None => PyOSError::new_err(format!("{}: {source}", path.display())),
        },
        _ => DeepctError::new_err(error.to_string()),
    }
}
