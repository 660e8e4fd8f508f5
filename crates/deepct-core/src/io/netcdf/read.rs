//! Reading of netCDF files of all formats. The size, dimensions and data type of every variable are
//! checked before its values are read.

use super::MAX_VALUES;
use super::coding::Coding;
use super::container::{Attribute, Container, Kind, Real, Stored};
use super::guard::Reading;
use crate::error::{Error, Result};
use crate::io::units::Unit;
use crate::memory;
use ndarray::{Array3, ArrayD, Axis, Ix3};
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Ratio of the size of the values to that of the file above which the values cannot have been
/// written: deflate compresses by at most 1032. Small variables are not checked.
const MOST_COMPRESSED: f64 = 1200.0;
const UNCHECKED_BYTES: f64 = 3e7;

/// A file that is open for reading.
pub(crate) struct Input {
    path: PathBuf,
    /// Units that replace those of the file, by the name of the variable.
    units: BTreeMap<String, String>,
    /// The names of the axes of variables with three axes without names.
    axes: Option<[String; 3]>,
    /// The parts of dimensions that are read, by their names; others are read as a whole.
    parts: BTreeMap<String, Range<usize>>,
    /// A dimension of which one index is read, as if variables did not have it.
    selected: Option<(String, usize)>,
    /// Size of the file (bytes).
    bytes: f64,
    container: Container,
}

/// A variable of an [`Input`].
pub(crate) struct Variable<'a> {
    input: &'a Input,
    /// The name in the file, after the path of its group.
    pub(crate) name: String,
    /// The length along each axis, of the part that is read.
    pub(crate) shape: Vec<usize>,
    /// The first index that is read along each stored axis.
    first: Vec<usize>,
    /// The stored axis of which one index is read.
    selected: Option<usize>,
    /// The name of the dimension along each axis, where the file specifies it.
    dimensions: Vec<Option<String>>,
    /// Whether the names of the dimensions are those of [`Input::with_axes`].
    pub(crate) has_stated_axes: bool,
    stored: Stored<'a>,
    /// The number of each axis in the file.
    order: Vec<usize>,
    /// Whether integers stand for real numbers.
    has_integers: bool,
}

impl Input {
    /// Open a file.
    ///
    /// # Errors
    /// Returns an error if the file does not exist, is of another format, or is truncated.
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let unusable = |problem: &str, remedy: &str| Error::file(path, "file", problem, remedy);
        if !path.exists() {
            return Err(unusable("does not exist", "check the path"));
        }
        crate::files::check_regular(path)?;
        let bytes = std::fs::metadata(path).map_err(Error::io(path))?.len() as f64;
        let _reading = Reading::start(path, bytes);
        let container = Container::open(path)?;
        let (units, parts) = (BTreeMap::new(), BTreeMap::new());
        let path = path.into();
        Ok(Self { path, units, axes: None, parts, selected: None, bytes, container })
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

    /// The same file with names of the axes of variables that have three without names.
    pub(crate) fn with_axes(self, axes: Option<[String; 3]>) -> Self {
        Self { axes, ..self }
    }

    /// Read only parts of these dimensions from now on, and others as a whole.
    pub(crate) fn read_parts(&mut self, parts: impl IntoIterator<Item = (String, Range<usize>)>) {
        self.parts = parts.into_iter().collect();
    }

    /// The same file at one index of a dimension: variables on it are read as if they did not have it.
    pub(crate) fn at(self, dimension: &str, index: usize) -> Self {
        Self { selected: Some((dimension.to_owned(), index)), ..self }
    }

    /// An error about a field of this file.
    pub(crate) fn error(&self, field: &str, problem: impl Into<String>, remedy: &str) -> Error {
        Error::file(&self.path, field, problem, remedy)
    }

    /// The names of the variables in alphabetical order, after the path of their group.
    pub(crate) fn names(&self) -> Vec<String> {
        self.container.names()
    }

    /// Whether the file has a variable with this name.
    pub(crate) fn has(&self, name: &str) -> bool {
        !matches!(self.container.variable(name), Ok(None))
    }

    /// A variable of any shape.
    ///
    /// # Errors
    /// Returns an error if the file has no variable with this name, or if it cannot be opened.
    pub(crate) fn variable(&self, name: &str) -> Result<Variable<'_>> {
        let _reading = Reading::start(&self.path, 0.0);
        let Some(stored) = self.container.variable(name)? else {
            return Err(self.unreadable().unwrap_or_else(|| {
                let names = self.names().join(", ");
                self.error(name, "is missing", &format!("the file has these variables: {names}"))
            }));
        };
        let name = name.trim_start_matches('/').to_owned();
        let mut dimensions = self.container.dimensions(&name, stored);
        let is_bare = dimensions.len() == 3 && dimensions.iter().all(Option::is_none);
        let stated = self.axes.as_ref().filter(|_| is_bare);
        if let Some(axes) = stated {
            dimensions = axes.iter().cloned().map(Some).collect();
        }
        let has_stated_axes = stated.is_some();
        let mut shape = stored.shape();
        let mut first = vec![0; shape.len()];
        for (axis, dimension) in dimensions.iter().enumerate().take(shape.len()) {
            let part = dimension.as_ref().and_then(|name| self.parts.get(name));
            // A part beyond the end is empty, and refused when it is read.
            if let Some(part) = part {
                (first[axis], shape[axis]) =
                    (part.start, part.end.min(shape[axis]).saturating_sub(part.start));
            }
        }
        let mut order: Vec<usize> = (0..shape.len()).collect();
        let index = self.selected.as_ref();
        let named = |name: &String| dimensions.iter().position(|own| own.as_ref() == Some(name));
        let selected = index.and_then(|(name, _)| named(name)).filter(|axis| *axis < shape.len());
        if let (Some(axis), Some((_, index))) = (selected, index) {
            first[axis] = *index;
            shape.remove(axis);
            dimensions.remove(axis);
            order.remove(axis);
        }
        Ok(Variable {
            input: self,
            // The coordinate of a dimension may consist of integers.
            has_integers: shape.len() <= 1,
            shape,
            dimensions,
            has_stated_axes,
            name,
            stored,
            order,
            first,
            selected,
        })
    }

    /// An error about a variable that the file has, but that cannot be opened.
    pub(crate) fn unreadable(&self) -> Option<Error> {
        self.container.unreadable()
    }

    /// Whether the file is a collection of arrays, and if so, whether deepct exported it.
    pub(crate) fn is_exported(&self) -> Option<bool> {
        match &self.container {
            Container::Arrays(arrays) => Some(arrays.is_own),
            Container::Hdf5(_) | Container::Classic(_) => None,
        }
    }

    /// What the format of the file does not state, and is assumed.
    pub(crate) fn assumption(&self) -> Option<&'static str> {
        self.container.assumption()
    }

    /// The text of an attribute of the file.
    pub(crate) fn text(&self, name: &str) -> Option<String> {
        match self.container.attribute("/", name)? {
            Attribute::Text(text) => Some(text),
            Attribute::Numbers(..) => None,
        }
    }

    /// The number in an attribute of the file.
    pub(crate) fn number(&self, name: &str) -> Option<f64> {
        match self.container.attribute("/", name)? {
            Attribute::Numbers(numbers, _) if numbers.len() == 1 => Some(numbers[0]),
            _ => None,
        }
    }

    /// A variable with axes in the order of the given dimensions, which the file may have in another
    /// order.
    ///
    /// # Errors
    /// Returns an error if the variable is missing, has another rank, or is on other dimensions.
    pub(crate) fn variable_on(&self, name: &str, dimensions: &[&str]) -> Result<Variable<'_>> {
        let variable = self.variable(name)?.arranged(dimensions);
        variable.check_dimensions(dimensions)?;
        Ok(variable)
    }

    /// The numbers in an attribute of a group.
    ///
    /// # Errors
    /// Returns an error if there is no such group or if it has no such attribute.
    pub(crate) fn group_numbers(&self, group: &str, attribute: &str) -> Result<Vec<f64>> {
        match self.container.attribute(group, attribute) {
            Some(Attribute::Numbers(numbers, _)) => Ok(numbers),
            _ => {
                let problem = format!("has no {attribute}");
                Err(self.error(group, problem, "give a group with that attribute"))
            }
        }
    }

    /// The value of a scalar variable, or the only value of an array, converted to `unit`
    /// unless that is `None`.
    pub(crate) fn scalar(&self, name: &str, unit: Option<&str>) -> Result<f64> {
        let variable = self.variable(name)?;
        let values: ArrayD<f64> = match unit {
            Some(unit) => variable.reals_of_layout(unit)?,
            None => variable.reals()?,
        };
        let values = values.into_raw_vec_and_offset().0;
        // Programs that join images give a number for each of them.
        match values.iter().find(|value| value.to_bits() != values[0].to_bits()) {
            None => Ok(values[0]),
            Some(other) => {
                let problem = format!("has the values {} and {other}", values[0]);
                let remedy = "one value applies to all views: write their mean if they hardly differ, or \
                              use the images with the same one";
                Err(variable.error(problem, remedy))
            }
        }
    }
}

impl Variable<'_> {
    /// An error about this variable.
    pub(crate) fn error(&self, problem: impl Into<String>, remedy: &str) -> Error {
        self.input.error(&self.name, problem, remedy)
    }

    /// The name of the dimension along an axis, if the file specifies it.
    pub(crate) fn dimension(&self, axis: usize) -> Option<&str> {
        self.dimensions.get(axis)?.as_deref()
    }

    /// The variable, whose integers stand for real numbers.
    pub(crate) fn with_integers(self) -> Self {
        Self { has_integers: true, ..self }
    }

    /// The variable with its axes in the order of these dimensions, if it is on them.
    fn arranged(mut self, dimensions: &[&str]) -> Self {
        let axis =
            |name: &&str| self.dimensions.iter().position(|own| own.as_deref() == Some(*name));
        let order: Option<Vec<usize>> = dimensions.iter().map(axis).collect();
        if let Some(order) = order.filter(|order| order.len() == self.shape.len()) {
            self.shape = order.iter().map(|&axis| self.shape[axis]).collect();
            self.dimensions = order.iter().map(|&axis| self.dimensions[axis].clone()).collect();
            self.order = order.iter().map(|&axis| self.order[axis]).collect();
        }
        self
    }

    /// Values as they are in the file with their axes in the order of this variable.
    fn in_order<T: Clone>(&self, values: ArrayD<T>) -> ArrayD<T> {
        if self.order.is_sorted() && self.selected.is_none() {
            return values;
        }
        let order: Vec<usize> = self.order.iter().copied().chain(self.selected).collect();
        let mut values = values.permuted_axes(order);
        if self.selected.is_some() {
            let last = values.ndim() - 1;
            values = values.index_axis_move(Axis(last), 0);
        }
        values.as_standard_layout().into_owned()
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
        Err(self.error(problem, "write it on these dimensions"))
    }

    /// The value of a text attribute.
    pub(crate) fn text(&self, name: &str) -> Option<String> {
        let _reading = self.reading();
        match self.stored.attribute(name)? {
            Attribute::Text(text) => Some(text),
            Attribute::Numbers(..) => None,
        }
    }

    /// The value of a numeric attribute.
    pub(crate) fn number(&self, name: &str) -> Option<f64> {
        match self.numbers(name).as_slice() {
            [number] => Some(*number),
            _ => None,
        }
    }

    /// The finite number in an attribute; `None` if there is no such attribute.
    ///
    /// # Errors
    /// Returns an error if the attribute holds anything else.
    pub(super) fn finite(&self, name: &str) -> Result<Option<f64>> {
        if !self.attributes().iter().any(|attribute| attribute == name) {
            return Ok(None);
        }
        match self.stored.attribute(name) {
            Some(Attribute::Numbers(numbers, _)) if matches!(numbers[..], [n] if n.is_finite()) => {
                Ok(Some(numbers[0]))
            }
            _ => {
                let problem = format!("has an attribute `{name}` that is not a finite number");
                Err(self.error(problem, "correct the attribute, or unpack the values"))
            }
        }
    }

    /// A mark that this variable is being read.
    fn reading(&self) -> Reading {
        Reading::start(&self.input.path, 8.0 * self.shape.iter().product::<usize>() as f64)
    }

    /// The names of its attributes.
    pub(crate) fn attributes(&self) -> Vec<String> {
        let _reading = self.reading();
        self.stored.attributes()
    }

    /// The numbers in an attribute, also if they are written as text.
    pub(super) fn numbers(&self, name: &str) -> Vec<f64> {
        let _reading = self.reading();
        match self.stored.attribute(name) {
            Some(Attribute::Numbers(numbers, _)) => numbers,
            Some(Attribute::Text(text)) => {
                let number = text.trim_end_matches(['f', 'F', 'd', 'D', 's', 'b']).parse().ok();
                number.into_iter().collect()
            }
            None => Vec::new(),
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
        let remedy = match expected {
            radiance if radiance.contains("sr-1") => "convert them: a reflectance times the cosine of the solar zenith angle over pi, a \
                       radiance over the solar irradiance in the same units; or state this irradiance, \
                       with its units, as the variable sun_irradiance"
                .to_owned(),
            _ => format!(
                "correct the attribute `units`, or state the units of the numbers with `cloud \
                 import --units {}=\"{example}\"`",
                self.name
            ),
        };
        self.error(format!("has {found}, but {expected} is expected"), &remedy)
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
    /// multiplied by `factor`. Values that the file declares as missing, or that are outside its valid
    /// range, are replaced by `missing`.
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
        let kind = self.stored.kind();
        let coding = Coding::of(self, &kind)?;
        let value = |stored: f64| {
            T::from_f64(coding.decode(stored).map_or(missing, |value| value * factor))
        };
        match kind {
            Kind::Float(_) if coding.packing.is_none() => {
                let mut values: ArrayD<T> = self.fetch(ranges)?;
                values.mapv_inplace(|stored| value(stored.to_f64()));
                Ok(values)
            }
            Kind::Signed(_) | Kind::Unsigned(_)
                if coding.packing.is_none() && !self.has_integers && !self.is_scaled_by_unit() =>
            {
                Err(self.wrong_kind(&kind, "real numbers"))
            }
            Kind::Float(_) | Kind::Signed(_) | Kind::Unsigned(_) => {
                Ok(self.fetch::<f64>(ranges)?.mapv(value))
            }
            _ => Err(self.wrong_kind(&kind, "real numbers")),
        }
    }

    /// Whether the unit contains the factor of packed values.
    fn is_scaled_by_unit(&self) -> bool {
        let unit = self.unit_text().as_deref().and_then(Unit::parse);
        unit.is_some_and(|unit| unit.has_number())
    }

    /// All values as booleans: 1 is true and 0 is false.
    ///
    /// # Errors
    /// Returns an error if the variable contains other numbers.
    pub(crate) fn flags(&self) -> Result<ArrayD<bool>> {
        let all = self.everything();
        self.check_size(&all)?;
        let numbers: ArrayD<f64> = match self.stored.kind() {
            Kind::Boolean => {
                let _reading = self.reading();
                let values = self.stored.read_boolean();
                let mut values =
                    values.map_err(|(problem, remedy)| self.error(problem, &remedy))?;
                for (axis, range) in self.in_file(&all).into_iter().enumerate() {
                    values.slice_axis_inplace(Axis(axis), range.into());
                }
                return Ok(self.in_order(values));
            }
            // Some programs convert masks to real numbers.
            Kind::Signed(_) | Kind::Unsigned(_) | Kind::Float(_) => self.fetch(&all)?,
            kind => return Err(self.wrong_kind(&kind, "numbers 0 and 1")),
        };
        match numbers.iter().find(|number| **number != 0.0 && **number != 1.0) {
            None => Ok(numbers.mapv(|number| number == 1.0)),
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
        matches!(self.stored.attribute(name), Some(Attribute::Numbers(_, true)))
    }

    fn wrong_kind(&self, found: &Kind, expected: &str) -> Error {
        let found = match found {
            Kind::Float(size) => format!("float{}", 8 * size),
            Kind::Signed(size) => format!("int{}", 8 * size),
            Kind::Unsigned(size) => format!("uint{}", 8 * size),
            Kind::Boolean => "bool".into(),
            Kind::Other(text) => text.clone(),
        };
        self.error(
            format!("has values of type {found}, but {expected} are expected"),
            "write it with this type (integers represent real numbers only with scale_factor, or with the \
             factor in their units)",
        )
    }

    fn fetch<T: Real>(&self, ranges: &[Range<usize>]) -> Result<ArrayD<T>> {
        let _reading = self.reading();
        let values = self.stored.read(&self.in_file(ranges));
        values
            .map(|values| self.in_order(values))
            .map_err(|(problem, remedy)| self.error(problem, &remedy))
    }

    /// Ranges of the axes, of the part that is read, as ranges of what is stored.
    fn in_file(&self, ranges: &[Range<usize>]) -> Vec<Range<usize>> {
        // Of the axis that is not among the ranges, one index is read.
        let mut stored: Vec<_> = self.first.iter().map(|&first| first..first + 1).collect();
        for (range, &axis) in ranges.iter().zip(&self.order) {
            let first = self.first[axis];
            stored[axis] = range.start + first..range.end + first;
        }
        stored
    }

    /// All values as text in C order, or `None` if they are numbers. Texts may be stored as characters along
    /// a further axis.
    ///
    /// # Errors
    /// Returns an error if the values cannot be read.
    pub(crate) fn texts(&self) -> Result<Option<Vec<String>>> {
        let Kind::Other(_) = self.stored.kind() else { return Ok(None) };
        self.check_size(&self.everything())?;
        let _reading = self.reading();
        self.stored.read_texts().map(Some).map_err(|(problem, remedy)| self.error(problem, &remedy))
    }
}
