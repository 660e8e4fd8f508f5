//! The error and result types of the library.
//!
//! Every variant carries the data that a caller needs to act on the error: the file, the field, the
//! value and the remedy. The message is one line.

use std::path::PathBuf;

/// The errors of deepct.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// An operation of the operating system failed: a missing file, no permission, a full disk.
    #[error("{}: {}", path.display(), in_words(source))]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The error reported by the operating system.
        source: std::io::Error,
    },
    /// A file was opened, but its content cannot be used.
    #[error("{}: {field}: {problem}; {remedy}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The variable, attribute, key, layer or line that is invalid.
        field: String,
        /// The problem with this field.
        problem: String,
        /// The action that solves the problem.
        remedy: String,
    },
    /// A value given by the caller is out of its range.
    #[error("{name} is {value}, but must be {range}")]
    OutOfRange {
        /// The argument or setting, under the name that the caller uses.
        name: &'static str,
        /// The value given.
        value: String,
        /// A description of the accepted values, with the unit.
        range: String,
    },
    /// The computation was stopped by a [`Stop`](crate::stop::Stop) before it had a result.
    #[error("interrupted")]
    Interrupted,
    /// Two inputs are inconsistent: a shape, a grid or a geometry differs.
    #[error("{what}: expected {expected}, found {found}; {remedy}")]
    Mismatch {
        /// The quantity that was compared.
        what: String,
        /// The value that is required.
        expected: String,
        /// The value that was given.
        found: String,
        /// The action that solves the problem.
        remedy: String,
    },
}

/// An error of the operating system, with the remedy for the most frequent one.
fn in_words(source: &std::io::Error) -> String {
    match source.kind() {
        std::io::ErrorKind::NotFound => "file: does not exist; check the path".into(),
        _ => source.to_string(),
    }
}

/// A result with the library's [`enum@Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// Creates an [`Error::OutOfRange`] from a value that can be printed.
    pub fn out_of_range(
        name: &'static str,
        value: impl ToString,
        range: impl Into<String>,
    ) -> Self {
        Self::OutOfRange { name, value: value.to_string(), range: range.into() }
    }

    /// Creates an [`Error::File`].
    pub fn file(
        path: impl Into<PathBuf>,
        field: impl Into<String>,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::File {
            path: path.into(),
            field: field.into(),
            problem: problem.into(),
            remedy: remedy.into(),
        }
    }

    /// Creates an [`Error::Mismatch`].
    pub fn mismatch(
        what: impl Into<String>,
        expected: impl ToString,
        found: impl ToString,
        remedy: impl Into<String>,
    ) -> Self {
        Self::Mismatch {
            what: what.into(),
            expected: expected.to_string(),
            found: found.to_string(),
            remedy: remedy.into(),
        }
    }

    /// Creates an [`Error::Io`] for `path`, for use with `map_err`.
    pub fn io(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { path, source }
    }

    /// Adds `path` to an error about values that were read from that file, for use with `map_err`:
    /// a value out of range becomes an [`Error::File`].
    pub fn in_file(path: impl Into<PathBuf>) -> impl Fn(Self) -> Self {
        let path = path.into();
        move |error| match error {
            Self::OutOfRange { name, value, range } => {
                Self::file(&path, name, format!("is {value}"), format!("it must be {range}"))
            }
            Self::Mismatch { what, expected, found, remedy } => Self::Mismatch {
                what: format!("{}: {what}", path.display()),
                expected,
                found,
                remedy,
            },
            other => other,
        }
    }
}
