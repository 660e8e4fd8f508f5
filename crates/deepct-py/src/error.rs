//! Conversion of library errors to Python exceptions, and of its messages to the words of Python.

use crate::exchange::named;
use deepct_core::Error;
use pyo3::exceptions::{PyOSError, PyValueError};
use pyo3::prelude::*;

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
            PyValueError::new_err(in_python(&error.to_string()))
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
        _ => DeepctError::new_err(in_python(&error.to_string())),
    }
}

/// A message of the library, which names options of the command line and temporary files, with the
/// arguments of Python in their place.
pub(crate) fn in_python(text: &str) -> String {
    let text = named(text);
    let rewritten = Python::attach(|py| {
        py.import("deepct_py._words")?.call_method1("in_python", (&text,))?.extract()
    });
    rewritten.unwrap_or(text)
}
