//! The one error and the one result of the library.
//!
//! Every variant carries the data that a caller needs to act: which file, which
//! field, which number, and what to do about it. The message is one line.

use std::path::PathBuf;

/// What can go wrong in deepct.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system refused: a missing file, no permission, a full disk.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// A file was opened, but what it holds cannot be used.
    #[error("{}: {field}: {problem}; {remedy}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The variable, attribute, key, layer or line at fault.
        field: String,
        /// What is wrong with it.
        problem: String,
        /// What the user can do.
        remedy: String,
    },
    /// A value given by the caller is out of its range.
    #[error("{name} is {value}, but must be {range}")]
    OutOfRange {
        /// The argument or setting, as the caller knows it.
        name: &'static str,
        /// The value given.
        value: String,
        /// The values that are accepted, in words, with the unit.
        range: String,
    },
    /// Two inputs do not fit each other: a shape, a grid or a geometry.
    #[error("{what}: expected {expected}, found {found}; {remedy}")]
    Mismatch {
        /// What was compared.
        what: String,
        /// What the one side asks for.
        expected: String,
        /// What the other side holds.
        found: String,
        /// What the user can do.
        remedy: String,
    },
}

/// A result with the library's [`enum@Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// An [`Error::OutOfRange`] from anything that prints.
    pub fn out_of_range(
        name: &'static str,
        value: impl ToString,
        range: impl Into<String>,
    ) -> Self {
        Self::OutOfRange { name, value: value.to_string(), range: range.into() }
    }

    /// An [`Error::File`].
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

    /// An [`Error::Mismatch`].
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

    /// An [`Error::Io`] for `path`, to be used with `map_err`.
    pub fn io(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { path, source }
    }

    /// Names `path` in an error about values that were read from it, to be used with
    /// `map_err`: a value out of range is then an error of the file.
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
