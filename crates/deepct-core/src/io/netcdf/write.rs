//! Writing of netCDF-4 files: variables on named dimensions. A file has a temporary name until it
//! is complete.

use super::lineage::put_lineage;
use super::{CONFIGURATION, INCOMPLETE, Provenance, VERSION, creation, dimension, reason};
use crate::error::{Error, Result};
use hdf5::types::{FloatSize, OwnedDynValue, TypeDescriptor};
use hdf5::{Dataset, DatasetBuilder, H5Type, Location};
use ndarray::{Array3, ArrayView, Axis, Dimension, s};
use std::path::{Path, PathBuf};

/// Maximum edge length of a chunk (values).
const CHUNK: usize = 64;

/// Beginning of the name of a dimension scale that has no coordinates, followed by its length in ten
/// characters.
const BARE: &str = "This is a netCDF dimension but not a netCDF variable.";

/// The value of an attribute.
#[derive(Debug, Clone, Copy)]
pub(super) enum Attribute<'a> {
    Text(&'a str),
    Number(f64),
    Whole(i32),
    Flags(&'a [i8]),
}

/// A type of values that netCDF of every version knows.
pub(super) trait Stored: H5Type + Clone {
    /// The value that marks what was never written. It is none that occurs: programs that read files
    /// by references to their chunks (kerchunk, VirtualiZarr) turn values equal to it into missing
    /// ones, and without it the zeros.
    fn unwritten() -> OwnedDynValue;
}

impl Stored for f32 {
    fn unwritten() -> OwnedDynValue {
        Self::NAN.into()
    }
}

impl Stored for f64 {
    fn unwritten() -> OwnedDynValue {
        Self::NAN.into()
    }
}

impl Stored for i32 {
    fn unwritten() -> OwnedDynValue {
        Self::MIN.into()
    }
}

impl Stored for i8 {
    fn unwritten() -> OwnedDynValue {
        Self::MIN.into()
    }
}

/// Attributes by name.
pub(super) type Attributes<'a> = [(&'a str, Attribute<'a>)];

/// A file that is being written. It receives its final name when it is finished; if it is dropped
/// before, the file is not created.
pub(super) struct Output {
    path: PathBuf,
    output: crate::files::Output,
    file: hdf5::File,
    dimensions: Vec<(String, Dataset)>,
}

impl Output {
    /// Start the file `path` with its global attributes.
    pub(super) fn create(path: &Path, provenance: &Provenance) -> Result<Self> {
        let output = crate::files::Output::create(path)?;
        let file = creation::create(output.temporary())
            .map_err(|problem| cannot_write(path, "file", &problem))?;
        let output = Self { path: path.into(), output, file, dimensions: Vec::new() };
        let version = env!("CARGO_PKG_VERSION");
        let source = format!("deepct {version}");
        // Classic netCDF has no integers of more than 32 bits.
        let digits = provenance.seed.to_string();
        let seed =
            i32::try_from(provenance.seed).map_or(Attribute::Text(&digits), Attribute::Whole);
        output.attributes(
            &output.file,
            "global attributes",
            &[
                ("Conventions", Attribute::Text("CF-1.10")),
                ("title", Attribute::Text(&provenance.title)),
                ("source", Attribute::Text(&source)),
                (VERSION, Attribute::Text(version)),
                (CONFIGURATION, Attribute::Text(&provenance.configuration)),
                ("seed", seed),
            ],
        )?;
        put_lineage(&output, &provenance.lineage)?;
        Ok(output)
    }

    /// Add attributes of the file.
    pub(super) fn global(&self, attributes: &Attributes) -> Result<()> {
        self.attributes(&self.file, "global attributes", attributes)
    }

    /// Mark the contents as those of a computation that was interrupted: `what` tells what they lack.
    pub(super) fn mark_incomplete(&self, what: &str) -> Result<()> {
        self.global(&[(INCOMPLETE, Attribute::Text(what))])
    }

    /// Add a dimension with its coordinate variable.
    pub(super) fn dimension<T: Stored>(
        &mut self,
        name: &str,
        coordinates: &[T],
        attributes: &Attributes,
    ) -> Result<()> {
        let scale = self
            .builder::<T>()
            .with_data(coordinates)
            .create(name)
            .map_err(|problem| cannot_write(&self.path, name, &problem))?;
        if !dimension::set_scale(&scale, name) {
            return Err(cannot_write(&self.path, name, "the dimension scale was refused"));
        }
        self.attributes(&scale, name, attributes)?;
        self.dimensions.push((name.into(), scale));
        Ok(())
    }

    /// Whether a dimension was added.
    pub(super) fn has_dimension(&self, name: &str) -> bool {
        self.dimensions.iter().any(|(known, _)| known == name)
    }

    /// Add a dimension whose coordinates are 0, 1, 2, ...
    pub(super) fn counted(&mut self, name: &str, length: usize, long_name: &str) -> Result<()> {
        let numbers: Vec<i32> = (0..length as i32).collect();
        self.dimension(name, &numbers, &[("long_name", Attribute::Text(long_name))])
    }

    /// Add a dimension that has no coordinates.
    pub(super) fn bare_dimension(&mut self, name: &str, length: usize) -> Result<()> {
        // The name and the type by which the netCDF library recognises such a dimension.
        let marker = format!("{BARE}{length:10}");
        let scale = self
            .file
            .new_dataset_builder()
            .obj_track_times(false)
            .attr_creation_order(creation::attribute_order())
            .empty_as(&TypeDescriptor::Float(FloatSize::U4))
            .shape(length)
            .create(name)
            .map_err(|problem| cannot_write(&self.path, name, &problem))?;
        if !dimension::set_scale(&scale, &marker) {
            return Err(cannot_write(&self.path, name, "the dimension scale was refused"));
        }
        self.dimensions.push((name.into(), scale));
        Ok(())
    }

    /// Add a variable on dimensions that were declared before; a scalar has none.
    pub(super) fn variable<'v, T: Stored, D: Dimension>(
        &self,
        name: &str,
        dimensions: &[&str],
        values: impl Into<ArrayView<'v, T, D>>,
        attributes: &Attributes,
    ) -> Result<()> {
        let values = values.into();
        // The file has C order, regardless of the order in memory.
        let values = values.as_standard_layout();
        let dataset = if dimensions.is_empty() {
            self.builder::<T>().with_data(values.view()).create(name)
        } else {
            self.compressed::<T>(values.shape()).with_data(values.view()).create(name)
        };
        self.attach(name, dataset, dimensions, attributes).map(|_| ())
    }

    /// Add a variable on dimensions that were declared before, whose values are written later.
    pub(super) fn unwritten<T: Stored>(
        &self,
        name: &str,
        dimensions: &[&str],
        shape: &[usize],
        attributes: &Attributes,
    ) -> Result<Dataset> {
        let dataset = self.compressed::<T>(shape).empty::<T>().shape(shape).create(name);
        self.attach(name, dataset, dimensions, attributes)
    }

    /// Write a part of a variable, from the index `first` along each axis.
    pub(super) fn write_part<T: Stored>(
        &self,
        dataset: &Dataset,
        first: [usize; 3],
        values: &Array3<T>,
    ) -> Result<()> {
        let [z, y, x] = [0, 1, 2].map(|axis| first[axis]..first[axis] + values.len_of(Axis(axis)));
        dataset
            .write_slice(values.as_standard_layout().view(), s![z, y, x])
            .map_err(|problem| cannot_write(&self.path, &dataset.name(), &problem))
    }

    /// A builder of a dataset in compressed blocks.
    fn compressed<T: Stored>(&self, shape: &[usize]) -> DatasetBuilder {
        let chunk: Vec<usize> = shape.iter().map(|&n| n.clamp(1, CHUNK)).collect();
        self.builder::<T>().chunk(chunk).shuffle().deflate(4)
    }

    /// Complete a variable with its dimensions and attributes.
    fn attach(
        &self,
        name: &str,
        dataset: hdf5::Result<Dataset>,
        dimensions: &[&str],
        attributes: &Attributes,
    ) -> Result<Dataset> {
        let dataset = dataset.map_err(|problem| cannot_write(&self.path, name, &problem))?;
        for (axis, dimension) in dimensions.iter().enumerate() {
            let scale = self.dimensions.iter().find(|(known, _)| known == dimension);
            let (_, scale) = scale.expect("dimensions are declared before their variables");
            if !dimension::attach_scale(&dataset, scale, axis) {
                return Err(cannot_write(&self.path, name, "a dimension could not be attached"));
            }
        }
        self.attributes(&dataset, name, attributes)?;
        Ok(dataset)
    }

    /// Add a scalar variable.
    pub(super) fn scalar(&self, name: &str, value: f64, attributes: &Attributes) -> Result<()> {
        self.variable(name, &[], ndarray::arr0(value).view(), attributes)
    }

    /// A builder of a dataset of values of the type `T`.
    fn builder<T: Stored>(&self) -> DatasetBuilder {
        self.file
            .new_dataset_builder()
            .obj_track_times(false)
            .attr_creation_order(creation::attribute_order())
            .fill_value(T::unwritten())
    }

    fn attributes(&self, on: &Location, field: &str, attributes: &Attributes) -> Result<()> {
        for (name, value) in attributes {
            let written = match value {
                Attribute::Text(text) => creation::write_text(on, name, &text.replace('\0', " ")),
                Attribute::Number(number) => on
                    .new_attr::<f64>()
                    .create(*name)
                    .and_then(|attribute| attribute.write_scalar(number)),
                Attribute::Whole(number) => on
                    .new_attr::<i32>()
                    .create(*name)
                    .and_then(|attribute| attribute.write_scalar(number)),
                Attribute::Flags(flags) => {
                    on.new_attr_builder().with_data(*flags).create(*name).map(|_| ())
                }
            };
            written.map_err(|problem| cannot_write(&self.path, field, &problem))?;
        }
        Ok(())
    }

    /// Close the file and rename it to its final name.
    pub(super) fn finish(self) -> Result<()> {
        let Self { path, output, file, dimensions } = self;
        drop(dimensions);
        file.close().map_err(|problem| cannot_write(&path, "file", &problem))?;
        output.finish()
    }
}

fn cannot_write(path: &Path, field: &str, problem: &(impl ToString + ?Sized)) -> Error {
    Error::file(
        path,
        field,
        format!("cannot be written: {}", reason(&problem.to_string())),
        "check that the disk has room and the folder can be written",
    )
}
