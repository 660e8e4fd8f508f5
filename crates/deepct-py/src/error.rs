//! Conversion of library errors to Python exceptions.

use deepct_core::Error;
use pyo3::PyErr;
use pyo3::exceptions::{PyOSError, PyValueError};

pyo3::create_exception!(
    deepct_py,
    DeepctError,
    pyo3::exceptions::PyException,
    "A file could be opened, but its contents cannot be used."
);

/// The exception for an error: `ValueError` for an invalid argument, `OSError` (or the subclass
/// for its error number, such as `FileNotFoundError`) for an error of the operating system,
/// [`DeepctError`] for invalid contents of a file.
pub(crate) fn raise(error: Error) -> PyErr {
    match error {
        Error::OutOfRange { .. } | Error::Mismatch { .. } => {
            PyValueError::new_err(error.to_string())
        }
        Error::Io { path, source } => match source.raw_os_error() {
            Some(number) => {
                // Python adds the error number to the message itself.
                let text = source.to_string();
                let text = text.split(" (os error").next().unwrap_or_default().to_owned();
                PyOSError::new_err((number, text, path.into_os_string()))
            }
            None => PyOSError::new_err(format!("{}: {source}", path.display())),
        },
        _ => DeepctError::new_err(error.to_string()),
    }
}
