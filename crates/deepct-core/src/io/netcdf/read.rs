//! Reading of netCDF-4 and HDF5 files. The size, dimensions and data type of every variable are
//! checked before its values are read.

use super::{MAX_VALUES, dimension};
use crate::error::{Error, Result};
use hdf5::types::{FixedAscii, FixedUnicode, TypeDescriptor, VarLenAscii, VarLenUnicode};
use hdf5::{Dataset, H5Type, Hyperslab, Location, SliceOrIndex};
use ndarray::{Array3, ArrayD, Ix3};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Maximum length of a text attribute of fixed length (bytes).
const LONGEST_TEXT: usize = 4096;

/// A file that is open for reading.
pub(crate) struct Input {
    path: PathBuf,
    file: hdf5::File,
    scales: Vec<(String, Dataset)>,
}

/// A variable of an [`Input`].
pub(crate) struct Variable<'a> {
    input: &'a Input,
    /// The name in the file.
    pub(crate) name: String,
    /// The length along each axis.
    pub(crate) shape: Vec<usize>,
    dataset: Dataset,
}

/// A floating-point type to which HDF5 converts values.
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

/// The CF packing of real numbers: `value = stored * scale + offset`, and the stored number that
/// represents a missing value.
struct Packing {
    scale: Option<f64>,
    offset: Option<f64>,
    missing: Option<f64>,
}

impl Input {
    /// Open a file.
    ///
    /// # Errors
    /// Returns an error if the file does not exist, is not HDF5, or is truncated.
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let unusable = |problem: &str, remedy: &str| Error::file(path, "file", problem, remedy);
        if !path.exists() {
            return Err(unusable("does not exist", "check the path"));
        }
        let file = hdf5::File::open(path).map_err(|_| match first_bytes(path).as_slice() {
            b"\x89HDF\r\n\x1a\n" => unusable(
                "is truncated or damaged",
                "copy it again from its source, or write it again",
            ),
            [b'C', b'D', b'F', ..] => {
                unusable("is netCDF-3", "convert it to netCDF-4 with `nccopy -k nc4`")
            }
            _ => unusable("is not an HDF5 or netCDF-4 file", "give a file of that format"),
        })?;
        let datasets = file.datasets().map_err(|_| {
            unusable("is damaged: its contents cannot be listed", "copy it again from its source")
        })?;
        let scales = datasets
            .into_iter()
            .filter(dimension::is_scale)
            .map(|scale| (leaf(&scale.name()), scale))
            .collect();
        Ok(Self { path: path.into(), file, scales })
    }

    /// An error about a field of this file.
    pub(crate) fn error(&self, field: &str, problem: impl Into<String>, remedy: &str) -> Error {
        Error::file(&self.path, field, problem, remedy)
    }

    /// The names of the variables in alphabetical order.
    pub(crate) fn names(&self) -> Vec<String> {
        let datasets = self.file.datasets().unwrap_or_default();
        let mut names: Vec<_> = datasets.iter().map(|dataset| leaf(&dataset.name())).collect();
        names.sort();
        names
    }

    /// Whether the file has a variable with this name.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.file.dataset(name).is_ok()
    }

    /// A variable of any shape.
    ///
    /// # Errors
    /// Returns an error if the file has no variable with this name.
    pub(crate) fn variable(&self, name: &str) -> Result<Variable<'_>> {
        let dataset = self.file.dataset(name).map_err(|_| {
            let names = self.names().join(", ");
            self.error(name, "is missing", &format!("the file has these variables: {names}"))
        })?;
        Ok(Variable { input: self, name: name.into(), shape: dataset.shape(), dataset })
    }

    /// A variable on the given dimensions, in this order.
    ///
    /// # Errors
    /// Returns an error if the variable is missing, has another rank, or is on other dimensions.
    pub(crate) fn variable_on(&self, name: &str, dimensions: &[&str]) -> Result<Variable<'_>> {
        let variable = self.variable(name)?;
        variable.check_dimensions(dimensions)?;
        Ok(variable)
    }

    /// The numbers in an attribute of a group.
    ///
    /// # Errors
    /// Returns an error if there is no such group or if it has no such attribute.
    pub(crate) fn group_numbers(&self, group: &str, attribute: &str) -> Result<Vec<f64>> {
        let numbers = self.file.group(group).and_then(|group| group.attr(attribute)?.read_raw());
        numbers.map_err(|_| {
            self.error(group, format!("has no {attribute}"), "give a group with that attribute")
        })
    }

    /// The value of a scalar variable.
    pub(crate) fn scalar(&self, name: &str) -> Result<f64> {
        let values: ArrayD<f64> = self.variable_on(name, &[])?.reals()?;
        Ok(values.into_raw_vec_and_offset().0[0])
    }
}

impl Variable<'_> {
    /// An error about this variable.
    pub(crate) fn error(&self, problem: impl Into<String>, remedy: &str) -> Error {
        self.input.error(&self.name, problem, remedy)
    }

    /// The name of the dimension along an axis, if the file specifies it.
    pub(crate) fn dimension(&self, axis: usize) -> Option<&str> {
        if self.shape.len() == 1 && self.input.scales.iter().any(|(name, _)| *name == self.name) {
            return Some(&self.name);
        }
        let mut scales = self.input.scales.iter();
        scales
            .find(|(_, scale)| dimension::is_attached(&self.dataset, scale, axis))
            .map(|(name, _)| name.as_str())
    }

    /// Returns an error unless the axes have the given names in this order. An axis without a
    /// name in the file is identified by its position.
    fn check_dimensions(&self, expected: &[&str]) -> Result<()> {
        let found: Vec<_> =
            (0..self.shape.len()).map(|axis| self.dimension(axis).unwrap_or("?")).collect();
        let fits = found.len() == expected.len()
            && found.iter().zip(expected).all(|(found, name)| found == name || *found == "?");
        if fits {
            return Ok(());
        }
        let problem = format!(
            "has dimensions ({}) of shape {:?}, but ({}) are expected",
            found.join(", "),
            self.shape,
            expected.join(", ")
        );
        Err(self.error(problem, "write it on these dimensions in this order"))
    }

    /// The value of a text attribute.
    pub(crate) fn text(&self, name: &str) -> Option<String> {
        text_attribute(&self.dataset, name)
    }

    /// The value of a numeric attribute.
    pub(crate) fn number(&self, name: &str) -> Option<f64> {
        let attribute = self.dataset.attr(name).ok()?;
        let numeric = matches!(
            attribute.dtype().and_then(|kind| kind.to_descriptor()),
            Ok(TypeDescriptor::Float(_) | TypeDescriptor::Integer(_) | TypeDescriptor::Unsigned(_))
        );
        if !numeric || attribute.size() != 1 {
            return None;
        }
        attribute.read_raw::<f64>().ok()?.first().copied()
    }

    /// The names of its attributes.
    pub(crate) fn attributes(&self) -> Vec<String> {
        self.dataset.attr_names().unwrap_or_default()
    }

    /// All values as real numbers.
    pub(crate) fn reals<T: Real>(&self) -> Result<ArrayD<T>> {
        let all: Vec<_> = self.shape.iter().map(|&length| 0..length).collect();
        self.reals_at(&all)
    }

    /// All values of a variable with three axes.
    pub(crate) fn reals_3d<T: Real>(&self) -> Result<Array3<T>> {
        let values = self.reals()?;
        values.into_dimensionality::<Ix3>().map_err(|_| {
            self.error(format!("has shape {:?}", self.shape), "write it with three dimensions")
        })
    }

    /// The values within a range of each axis as real numbers, unpacked according to CF. Missing
    /// values are NaN.
    ///
    /// # Errors
    /// Returns an error if the values are neither real numbers nor packed real numbers, if there
    /// are more than [`MAX_VALUES`], or if they cannot be read.
    pub(crate) fn reals_at<T: Real>(&self, ranges: &[Range<usize>]) -> Result<ArrayD<T>> {
        self.check_size(ranges)?;
        let packing = self.packing();
        let packed = packing.scale.is_some() || packing.offset.is_some();
        match self.kind() {
            Ok(TypeDescriptor::Float(_)) => {}
            Ok(TypeDescriptor::Integer(_) | TypeDescriptor::Unsigned(_)) if packed => {}
            kind => return Err(self.wrong_kind(kind, "real numbers")),
        }
        let missing = |value: f64| packing.missing == Some(value);
        if !packed {
            let mut values: ArrayD<T> = self.fetch(ranges)?;
            if packing.missing.is_some() {
                let nan =
                    |value: T| if missing(value.to_f64()) { f64::NAN } else { value.to_f64() };
                values.mapv_inplace(|value| T::from_f64(nan(value)));
            }
            return Ok(values);
        }
        let (scale, offset) = (packing.scale.unwrap_or(1.0), packing.offset.unwrap_or(0.0));
        let stored: ArrayD<f64> = self.fetch(ranges)?;
        Ok(stored.mapv(|value| {
            T::from_f64(if missing(value) { f64::NAN } else { value * scale + offset })
        }))
    }

    /// All values as booleans: 1 is true and 0 is false.
    ///
    /// # Errors
    /// Returns an error if the variable contains other numbers.
    pub(crate) fn flags(&self) -> Result<ArrayD<bool>> {
        let all: Vec<_> = self.shape.iter().map(|&length| 0..length).collect();
        self.check_size(&all)?;
        let numbers: ArrayD<i64> = match self.kind() {
            Ok(TypeDescriptor::Boolean) => return self.fetch(&all),
            Ok(TypeDescriptor::Integer(_) | TypeDescriptor::Unsigned(_)) => self.fetch(&all)?,
            kind => return Err(self.wrong_kind(kind, "integers 0 and 1")),
        };
        match numbers.iter().find(|number| !(0..=1).contains(*number)) {
            None => Ok(numbers.mapv(|number| number == 1)),
            Some(number) => {
                Err(self.error(format!("holds {number}"), "a mask is 1 inside and 0 outside"))
            }
        }
    }

    fn check_size(&self, ranges: &[Range<usize>]) -> Result<()> {
        let count = ranges.iter().try_fold(1_usize, |count, range| count.checked_mul(range.len()));
        match count {
            Some(0) => Err(self.error("is empty", "write it with values")),
            Some(count) if count <= MAX_VALUES => Ok(()),
            _ => Err(self.error(
                format!("declares shape {:?}, more than {MAX_VALUES} values", self.shape),
                "give a smaller part of the field",
            )),
        }
    }

    fn packing(&self) -> Packing {
        Packing {
            scale: self.number("scale_factor"),
            offset: self.number("add_offset"),
            missing: self.number("_FillValue").or_else(|| self.number("missing_value")),
        }
    }

    fn kind(&self) -> hdf5::Result<TypeDescriptor> {
        self.dataset.dtype()?.to_descriptor()
    }

    fn wrong_kind(&self, found: hdf5::Result<TypeDescriptor>, expected: &str) -> Error {
        let found = found.map_or_else(|_| "unsupported".into(), |kind| kind.to_string());
        self.error(
            format!("has values of type {found}, but {expected} are expected"),
            "write it with this type (integers represent real numbers only with scale_factor)",
        )
    }

    fn fetch<T: H5Type>(&self, ranges: &[Range<usize>]) -> Result<ArrayD<T>> {
        let unreadable = |problem: hdf5::Error| {
            self.error(
                format!("cannot be read: {}", first_line(&problem)),
                "the file is truncated, damaged or compressed by a filter other than deflate; \
                 copy it again or write it again",
            )
        };
        if self.shape.is_empty() {
            return self.dataset.read_dyn().map_err(unreadable);
        }
        let slab: Vec<_> = ranges
            .iter()
            .map(|range| SliceOrIndex::SliceCount {
                start: range.start,
                step: 1,
                count: range.len(),
                block: 1,
            })
            .collect();
        self.dataset.read_slice::<T, _, ndarray::IxDyn>(Hyperslab::from(slab)).map_err(unreadable)
    }
}

/// The value of a text attribute. HDF5 does not convert between the four string types, so each
/// is read with its own type.
fn text_attribute(on: &Location, name: &str) -> Option<String> {
    let attribute = on.attr(name).ok()?;
    if attribute.size() != 1 {
        return None;
    }
    let text = match attribute.dtype().ok()?.to_descriptor().ok()? {
        TypeDescriptor::FixedAscii(length) if length <= LONGEST_TEXT => {
            attribute.read_raw::<FixedAscii<LONGEST_TEXT>>().ok()?[0].as_str().to_owned()
        }
        TypeDescriptor::FixedUnicode(length) if length <= LONGEST_TEXT => {
            attribute.read_raw::<FixedUnicode<LONGEST_TEXT>>().ok()?[0].as_str().to_owned()
        }
        TypeDescriptor::VarLenAscii => {
            attribute.read_raw::<VarLenAscii>().ok()?[0].as_str().to_owned()
        }
        TypeDescriptor::VarLenUnicode => {
            attribute.read_raw::<VarLenUnicode>().ok()?[0].as_str().to_owned()
        }
        _ => return None,
    };
    Some(text.trim().to_owned())
}

/// The last part of an HDF5 path.
fn leaf(name: &str) -> String {
    name.rsplit('/').next().unwrap_or(name).to_owned()
}

fn first_line(problem: &hdf5::Error) -> String {
    problem.to_string().lines().next().unwrap_or("unknown reason").to_owned()
}

fn first_bytes(path: &Path) -> Vec<u8> {
    use std::io::Read;
    let mut bytes = Vec::new();
    if let Ok(file) = std::fs::File::open(path) {
        // A file that is too short is not HDF5 either.
        let _ = file.take(8).read_to_end(&mut bytes);
    }
    bytes
}
