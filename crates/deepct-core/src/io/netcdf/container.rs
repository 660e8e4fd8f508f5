//! The formats of files with variables behind one interface: netCDF-4, which is HDF5, the classic format
//! of netCDF (netCDF-3), and the collections of arrays of other programs.

use super::classic::{self, Classic};
use super::hdf5_file::{self, Hdf5};
use crate::error::{Error, Result};
use crate::io::arrays::{Array, Arrays, Number};
use hdf5::H5Type;
use ndarray::ArrayD;
use std::ops::Range;
use std::path::Path;

/// The type of stored numbers, with their size in bytes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Kind {
    Float(usize),
    Signed(usize),
    Unsigned(usize),
    Boolean,
    /// Another type, by its description.
    Other(String),
}

/// The value of an attribute.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Attribute {
    Text(String),
    /// Numbers, and whether they are real numbers rather than integers.
    Numbers(Vec<f64>, bool),
}

/// A floating-point type to which stored numbers are converted.
pub(crate) trait Real: H5Type + Copy {
    fn from_f64(value: f64) -> Self;
    fn to_f64(self) -> f64;
}

impl Real for f32 {
    fn from_f64(value: f64) -> Self {
        value as Self
    }
    fn to_f64(self) -> f64 {
        f64::from(self)
    }
}

impl Real for f64 {
    fn from_f64(value: f64) -> Self {
        value
    }
    fn to_f64(self) -> f64 {
        self
    }
}

/// An open file.
pub(super) enum Container {
    Hdf5(Hdf5),
    Classic(Classic),
    Arrays(Arrays),
}

/// The storage of a variable.
#[derive(Clone, Copy)]
pub(super) enum Stored<'a> {
    Hdf5(&'a hdf5::Dataset),
    Classic(&'a Classic, &'a classic::Variable),
    Array(&'a Array),
}

impl Container {
    /// Open a file whose format is identified by its first bytes.
    ///
    /// # Errors
    /// Returns an error if the file is of another format, is damaged, or refers to other files.
    pub(super) fn open(path: &Path) -> Result<Self> {
        match hdf5_file::first_bytes(path, 0)?.as_slice() {
            [b'C', b'D', b'F', 1 | 2 | 5, ..] => Classic::open(path).map(Self::Classic),
            _ => match Arrays::open(path)? {
                Some(arrays) => Ok(Self::Arrays(arrays)),
                None => Hdf5::open(path).map(Self::Hdf5),
            },
        }
    }

    /// The names of the variables in alphabetical order, with the path of their group.
    pub(super) fn names(&self) -> Vec<String> {
        match self {
            Self::Hdf5(file) => file.names(),
            Self::Classic(file) => file.names(),
            Self::Arrays(file) => file.names(),
        }
    }

    /// The variable with this name.
    ///
    /// # Errors
    /// Returns an error if the file has such a variable, but it cannot be opened.
    pub(super) fn variable(&self, name: &str) -> Result<Option<Stored<'_>>> {
        Ok(match self {
            Self::Hdf5(file) => file.variable(name)?.map(Stored::Hdf5),
            Self::Classic(file) => {
                file.variable(name).map(|variable| Stored::Classic(file, variable))
            }
            Self::Arrays(file) => file.get(name).map(Stored::Array),
        })
    }

    /// An error about a variable that is listed but cannot be opened.
    pub(super) fn unreadable(&self) -> Option<Error> {
        match self {
            Self::Hdf5(file) => file.unreadable(),
            Self::Classic(_) | Self::Arrays(_) => None,
        }
    }

    /// What the format does not state, and is assumed.
    pub(super) fn assumption(&self) -> Option<&'static str> {
        match self {
            Self::Arrays(file) => file.assumption,
            Self::Hdf5(_) | Self::Classic(_) => None,
        }
    }

    /// The names of the dimensions of a variable, where the file specifies them.
    pub(super) fn dimensions(&self, name: &str, stored: Stored) -> Vec<Option<String>> {
        match (self, stored) {
            (Self::Hdf5(file), Stored::Hdf5(dataset)) => file.dimensions(name, dataset),
            (_, Stored::Classic(_, variable)) => {
                variable.dimensions.iter().cloned().map(Some).collect()
            }
            (_, Stored::Array(array)) => array.dimensions.clone(),
            (_, Stored::Hdf5(_)) => Vec::new(),
        }
    }

    /// An attribute of the file or of one of its groups; the path of the file itself is "/".
    pub(super) fn attribute(&self, group: &str, name: &str) -> Option<Attribute> {
        match self {
            Self::Hdf5(file) => file.attribute(group, name),
            Self::Classic(file) => file.attribute(name).cloned(),
            Self::Arrays(_) => None,
        }
    }
}

impl Stored<'_> {
    /// The length along each axis.
    pub(super) fn shape(&self) -> Vec<usize> {
        match self {
            Self::Hdf5(dataset) => dataset.shape(),
            Self::Classic(_, variable) => variable.shape.clone(),
            Self::Array(array) => array.shape.clone(),
        }
    }

    pub(super) fn kind(&self) -> Kind {
        match self {
            Self::Hdf5(dataset) => hdf5_file::kind(dataset),
            Self::Classic(_, variable) => variable.kind.clone(),
            Self::Array(array) => match &array.kind {
                Number::Float(size) => Kind::Float(*size),
                Number::Signed(size) => Kind::Signed(*size),
                Number::Unsigned(size) => Kind::Unsigned(*size),
                Number::Other(text) => Kind::Other(text.clone()),
            },
        }
    }

    pub(super) fn attribute(&self, name: &str) -> Option<Attribute> {
        match self {
            Self::Hdf5(dataset) => hdf5_file::attribute(dataset, name),
            Self::Classic(_, variable) => variable.attributes.get(name).cloned(),
            Self::Array(array) => match name {
                "units" => array.units.map(|units| Attribute::Text(units.to_owned())),
                "bounds" => array.bounds().map(Attribute::Text),
                "lower_edge" => array.cells.map(|[edge, _]| Attribute::Numbers(vec![edge], true)),
                "spacing" => array.cells.map(|[_, step]| Attribute::Numbers(vec![step], true)),
                _ => None,
            },
        }
    }

    /// The names of its attributes.
    pub(super) fn attributes(&self) -> Vec<String> {
        match self {
            Self::Hdf5(dataset) => dataset.attr_names().unwrap_or_default(),
            Self::Classic(_, variable) => variable.attributes.keys().cloned().collect(),
            Self::Array(_) => {
                let known = ["units", "bounds", "lower_edge", "spacing"].into_iter();
                known.filter(|name| self.attribute(name).is_some()).map(str::to_owned).collect()
            }
        }
    }

    /// The numbers within a range of each axis.
    ///
    /// # Errors
    /// Returns the problem and its remedy.
    pub(super) fn read<T: Real>(
        &self,
        ranges: &[Range<usize>],
    ) -> std::result::Result<ArrayD<T>, (String, String)> {
        match self {
            Self::Hdf5(dataset) => hdf5_file::read(dataset, ranges),
            Self::Classic(file, variable) => file.read(variable, ranges),
            Self::Array(array) => array.read(ranges, T::from_f64).map_err(|problem| {
                (format!("cannot be read: {problem}"), "copy the file again from its source".into())
            }),
        }
    }

    /// All values of the type [`Kind::Boolean`], which the classic format does not have.
    ///
    /// # Errors
    /// As [`Stored::read`].
    pub(super) fn read_boolean(&self) -> std::result::Result<ArrayD<bool>, (String, String)> {
        match self {
            Self::Hdf5(dataset) => {
                dataset.read_dyn().map_err(|error| hdf5_file::failure(dataset, &error))
            }
            Self::Classic(..) | Self::Array(_) => {
                Err(("has no Boolean values".into(), "write 0 and 1".into()))
            }
        }
    }

    /// All values as text. Single characters are joined along the last axis.
    ///
    /// # Errors
    /// As [`Stored::read`]; values that are no text.
    pub(super) fn read_texts(&self) -> std::result::Result<Vec<String>, (String, String)> {
        let texts = match self {
            Self::Hdf5(dataset) => hdf5_file::texts(dataset),
            Self::Classic(file, variable) => file.characters(variable),
            Self::Array(_) => None,
        };
        let texts = texts
            .ok_or_else(|| ("cannot be read as text".into(), "write numbers or text".into()))?;
        match self.shape().as_slice() {
            [.., length] if texts.iter().all(|text| text.len() <= 1) => {
                Ok(texts.chunks(*length).map(|parts| parts.concat().trim().to_owned()).collect())
            }
            _ => Ok(texts),
        }
    }
}
