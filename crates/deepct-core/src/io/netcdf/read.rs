//! Reading of netCDF-4 and HDF5 files. The size, dimensions and data type of every variable are
//! checked before its values are read.

use super::coding::Coding;
use super::guard::{self, Reading};
use super::{MAX_VALUES, dimension, reason};
use crate::error::{Error, Result};
use crate::io::units::Unit;
use crate::memory;
use hdf5::types::{FixedAscii, FixedUnicode, TypeDescriptor, VarLenAscii, VarLenUnicode};
use hdf5::{Dataset, H5Type, Hyperslab, Location, SliceOrIndex};
use ndarray::{Array3, ArrayD, Ix3};
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Maximum length of a text attribute of fixed length (bytes).
const LONGEST_TEXT: usize = 4096;

/// Ratio of the size of the values to that of the file above which the values cannot have been
/// written: deflate compresses by at most 1032. Small variables are not checked.
const MOST_COMPRESSED: f64 = 1200.0;
const UNCHECKED_BYTES: f64 = 3e7;

/// A file that is open for reading.
pub(crate) struct Input {
    path: PathBuf,
    /// Units that replace those of the file, by the name of the variable.
    units: BTreeMap<String, String>,
    /// Size of the file (bytes).
    bytes: f64,
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
        crate::files::check_regular(path)?;
        let bytes = std::fs::metadata(path).map_err(Error::io(path))?.len() as f64;
        let _reading = Reading::start(path, bytes);
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
        guard::check_links(path, &file)?;
        let datasets = file.datasets().map_err(|_| {
            unusable("is damaged: its contents cannot be listed", "copy it again from its source")
        })?;
        let scales = datasets
            .into_iter()
            .filter(dimension::is_scale)
            .map(|scale| (leaf(&scale.name()), scale))
            .collect();
        Ok(Self { path: path.into(), units: BTreeMap::new(), bytes, file, scales })
    }

    /// The same file with units that replace those of its variables.
    ///
    /// # Errors
    /// Returns an error if the file has no variable with one of the names, or if a unit is not
    /// understood.
    pub(crate) fn with_units(self, units: &BTreeMap<String, String>) -> Result<Self> {
        for (name, unit) in units {
            self.variable(name)?;
            if Unit::parse(unit).is_none() {
                let problem = format!("has the unit \"{unit}\" in --units, which is not known");
                return Err(self.error(name, problem, "give a unit such as \"g m-3\" or \"um\""));
            }
        }
        Ok(Self { units: units.clone(), ..self })
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
        guard::check_storage(&self.path, name, &dataset)?;
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

    /// The value of a scalar variable, converted to `unit`.
    pub(crate) fn scalar(&self, name: &str, unit: &str) -> Result<f64> {
        let values: ArrayD<f64> = self.variable_on(name, &[])?.reals_of_layout(unit)?;
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
        let _reading = self.reading();
        text_attribute(&self.dataset, name)
    }

    /// The value of a numeric attribute.
    pub(crate) fn number(&self, name: &str) -> Option<f64> {
        match self.numbers(name).as_slice() {
            [number] => Some(*number),
            _ => None,
        }
    }

    /// A mark that this variable is being read.
    fn reading(&self) -> Reading {
        Reading::start(&self.input.path, 8.0 * self.shape.iter().product::<usize>() as f64)
    }

    /// The names of its attributes.
    pub(crate) fn attributes(&self) -> Vec<String> {
        let _reading = self.reading();
        self.dataset.attr_names().unwrap_or_default()
    }

    /// The numbers in an attribute, also if they are written as text.
    pub(super) fn numbers(&self, name: &str) -> Vec<f64> {
        let _reading = self.reading();
        let Ok(attribute) = self.dataset.attr(name) else { return Vec::new() };
        match attribute.dtype().and_then(|kind| kind.to_descriptor()) {
            Ok(
                TypeDescriptor::Float(_) | TypeDescriptor::Integer(_) | TypeDescriptor::Unsigned(_),
            ) if attribute.size() <= LONGEST_TEXT => attribute.read_raw().unwrap_or_default(),
            _ => self
                .text(name)
                .and_then(|text| text.trim_end_matches(['f', 'F', 'd', 'D', 's', 'b']).parse().ok())
                .into_iter()
                .collect(),
        }
    }

    /// The unit that the caller or, if the caller does not, the file states for the values.
    pub(crate) fn unit_text(&self) -> Option<String> {
        let stated = self.input.units.get(&self.name).cloned();
        stated.or_else(|| self.text("units")).filter(|text| !text.is_empty())
    }

    /// The factor that converts the values to the unit `expected`. Plain numbers, and variables
    /// whose name ends in the unit, may lack the attribute `units`.
    ///
    /// # Errors
    /// Returns an error if the unit is missing, is not understood, or is that of another quantity.
    pub(crate) fn factor_to(&self, expected: &str) -> Result<f64> {
        let own = Unit::parse(expected).expect("units in the program are understood");
        let in_name = format!("_{}", expected.replace("degree", "deg"));
        match self.unit_text() {
            None if expected == "1" || self.name.ends_with(&in_name) => Some(1.0),
            None => None,
            Some(text) => Unit::parse(&text).and_then(|unit| unit.factor_to(&own)),
        }
        .ok_or_else(|| self.wrong_unit(expected, expected))
    }

    /// An error that states the unit of the values, the expected one and an example of it.
    pub(crate) fn wrong_unit(&self, expected: &str, example: &str) -> Error {
        let found = self.unit_text();
        let found = found.map_or("no units".into(), |text| format!("the units \"{text}\""));
        self.error(
            format!("has {found}, but {expected} is expected"),
            &format!(
                "correct the attribute `units`, or state the units of the numbers with `cloud \
                 import --units {}=\"{example}\"`",
                self.name
            ),
        )
    }

    /// All values, converted to `unit`. Missing values are NaN.
    ///
    /// # Errors
    /// As [`Variable::factor_to`] and [`Variable::values_at`].
    pub(crate) fn reals_in<T: Real>(&self, unit: &str) -> Result<ArrayD<T>> {
        self.values_at(&self.everything(), self.factor_to(unit)?, f64::NAN)
    }

    /// As [`Variable::reals_in`]; numbers without units are taken to be in `unit`. For images, whose
    /// layout states the units and which other programs write without attributes.
    pub(crate) fn reals_of_layout<T: Real>(&self, unit: &str) -> Result<ArrayD<T>> {
        match self.unit_text() {
            None => self.reals(),
            Some(_) => self.reals_in(unit),
        }
    }

    /// As [`Variable::reals_of_layout`], for a variable with three axes.
    pub(crate) fn reals_3d_of_layout<T: Real>(&self, unit: &str) -> Result<Array3<T>> {
        self.with_three_axes(self.reals_of_layout(unit)?)
    }

    /// All values of a variable with three axes, converted to `unit`. Missing values are NaN.
    pub(crate) fn reals_3d_in<T: Real>(&self, unit: &str) -> Result<Array3<T>> {
        self.with_three_axes(self.reals_in(unit)?)
    }

    /// All values in the unit of the file. Missing values are NaN.
    pub(crate) fn reals<T: Real>(&self) -> Result<ArrayD<T>> {
        self.values_at(&self.everything(), 1.0, f64::NAN)
    }

    /// All values of a variable with three axes in the unit of the file. Missing values are NaN.
    pub(crate) fn reals_3d<T: Real>(&self) -> Result<Array3<T>> {
        self.with_three_axes(self.reals()?)
    }

    fn with_three_axes<T>(&self, values: ArrayD<T>) -> Result<Array3<T>> {
        values.into_dimensionality::<Ix3>().map_err(|_| {
            self.error(format!("has shape {:?}", self.shape), "write it with three dimensions")
        })
    }

    fn everything(&self) -> Vec<Range<usize>> {
        self.shape.iter().map(|&length| 0..length).collect()
    }

    /// The values within a range of each axis as real numbers, unpacked according to CF and
    /// multiplied by `factor`. Values that the file declares as missing are replaced by `missing`;
    /// those outside the valid range are NaN.
    ///
    /// # Errors
    /// Returns an error if the values are neither real numbers nor packed real numbers, if there
    /// are more than [`MAX_VALUES`], or if they cannot be read.
    pub(crate) fn values_at<T: Real>(
        &self,
        ranges: &[Range<usize>],
        factor: f64,
        missing: f64,
    ) -> Result<ArrayD<T>> {
        self.check_size(ranges)?;
        let kind = self.kind();
        let coding = Coding::of(self, kind.as_ref().ok());
        let value = |stored: f64| {
            T::from_f64(coding.decode(stored).map_or(missing, |value| value * factor))
        };
        match kind {
            Ok(TypeDescriptor::Float(_)) if coding.packing.is_none() => {
                let mut values: ArrayD<T> = self.fetch(ranges)?;
                values.mapv_inplace(|stored| value(stored.to_f64()));
                Ok(values)
            }
            Ok(TypeDescriptor::Integer(_) | TypeDescriptor::Unsigned(_))
                if coding.packing.is_none() =>
            {
                Err(self.wrong_kind(kind, "real numbers"))
            }
            Ok(
                TypeDescriptor::Float(_) | TypeDescriptor::Integer(_) | TypeDescriptor::Unsigned(_),
            ) => Ok(self.fetch::<f64>(ranges)?.mapv(value)),
            kind => Err(self.wrong_kind(kind, "real numbers")),
        }
    }

    /// All values of a variable that may have integers, such as the numbers of pixels.
    ///
    /// # Errors
    /// As [`Variable::values_at`].
    pub(crate) fn integers_or_reals(&self) -> Result<ArrayD<f64>> {
        match self.kind() {
            Ok(TypeDescriptor::Integer(_) | TypeDescriptor::Unsigned(_)) => {
                let all = self.everything();
                self.check_size(&all)?;
                self.fetch(&all)
            }
            _ => self.reals(),
        }
    }

    /// All values as booleans: 1 is true and 0 is false.
    ///
    /// # Errors
    /// Returns an error if the variable contains other numbers.
    pub(crate) fn flags(&self) -> Result<ArrayD<bool>> {
        let all = self.everything();
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
            Some(count) if count <= MAX_VALUES => {
                let bytes = 4.0 * count as f64;
                // Values that were never written take no space in a file.
                if bytes > UNCHECKED_BYTES && bytes > MOST_COMPRESSED * self.input.bytes {
                    let problem = format!(
                        "declares shape {:?}, but the file has {} bytes only",
                        self.shape, self.input.bytes
                    );
                    return Err(self.error(problem, "write it again with all of its values"));
                }
                memory::check("memory for a variable", count as f64, 16.0)
                    .map_err(Error::in_file(&self.input.path))
            }
            _ => Err(self.error(
                format!("declares shape {:?}, more than {MAX_VALUES} values", self.shape),
                "give a smaller part of the field",
            )),
        }
    }

    /// Whether an attribute holds real numbers rather than integers.
    pub(super) fn is_real(&self, name: &str) -> bool {
        let kind = self.dataset.attr(name).and_then(|attribute| attribute.dtype()?.to_descriptor());
        matches!(kind, Ok(TypeDescriptor::Float(_)))
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
        let _reading = self.reading();
        let unreadable = |problem: hdf5::Error| {
            self.error(
                format!("cannot be read: {}", reason(&problem.to_string())),
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
            decoded(attribute.read_raw::<FixedAscii<LONGEST_TEXT>>().ok()?[0].as_bytes())
        }
        TypeDescriptor::FixedUnicode(length) if length <= LONGEST_TEXT => {
            decoded(attribute.read_raw::<FixedUnicode<LONGEST_TEXT>>().ok()?[0].as_bytes())
        }
        TypeDescriptor::VarLenAscii => {
            decoded(attribute.read_raw::<VarLenAscii>().ok()?[0].as_bytes())
        }
        TypeDescriptor::VarLenUnicode => {
            decoded(attribute.read_raw::<VarLenUnicode>().ok()?[0].as_bytes())
        }
        _ => return None,
    };
    Some(text.trim().to_owned())
}

/// Text in UTF-8 or, if it is none, in Latin-1, in which older programs write the micro sign. HDF5
/// does not check what a file declares as UTF-8.
fn decoded(bytes: &[u8]) -> String {
    match std::str::from_utf8(bytes) {
        Ok(text) => text.to_owned(),
        Err(_) => bytes.iter().map(|&byte| char::from(byte)).collect(),
    }
}

/// The last part of an HDF5 path.
fn leaf(name: &str) -> String {
    name.rsplit('/').next().unwrap_or(name).to_owned()
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
