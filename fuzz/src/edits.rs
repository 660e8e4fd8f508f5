//! Edits of valid HDF5 files, from which mutations reach the readers of deepct rather than those of
//! the HDF5 library.

use hdf5::types::{VarLenUnicode, VarLenArray};
use hdf5::{Dataset, File};
use libfuzzer_sys::arbitrary::{self, Arbitrary};
use std::path::Path;

/// Names of attributes that change what values mean.
const ATTRIBUTES: [&str; 22] = [
    "units", "standard_name", "long_name", "_FillValue", "missing_value", "scale_factor",
    "add_offset", "valid_min", "valid_max", "valid_range", "positive", "axis", "bounds",
    "flag_values", "flag_meanings", "coordinates", "_Unsigned", "calendar", "DIMENSION_LIST",
    "projection", "wavelength_um", "_Netcdf4Coordinates",
];

/// Texts that such attributes have.
const TEXTS: [&str; 24] = [
    "", "1", "g m-3", "kg m-3", "g/kg", "kg kg-1", "mg m**-3", "km-1", "m-1", "1/m", "m", "km",
    "um", "micron", "degrees", "rad", "sr-1", "Pa", "K", "up", "down", "true",
    "mass_concentration_of_cloud_liquid_water_in_air", "cloud_liquid_water_mixing_ratio",
];

/// Names of variables that readers look for.
const NAMES: [&str; 30] = [
    "lwc", "reff", "veff", "extinction", "uncertainty", "mask", "radiance", "x", "y", "z", "time",
    "ql", "qc", "QN", "QC", "qr", "density", "rho", "rhoref", "p", "TABS", "theta", "zh", "xh",
    "PH", "PHB", "ALT", "nc", "latitude", "altitude",
];

/// One change of a file.
#[derive(Debug, Arbitrary)]
pub enum Edit {
    /// An attribute with one of the usual texts.
    Usual { variable: u8, attribute: u8, text: u8 },
    /// An attribute with any text.
    Text { variable: u8, attribute: u8, text: String },
    /// An attribute with a number of some type.
    Number { variable: u8, attribute: u8, value: Number },
    /// An attribute with several numbers.
    Numbers { variable: u8, attribute: u8, values: Vec<f64> },
    /// An attribute is missing.
    Without { variable: u8, attribute: u8 },
    /// One value of a variable.
    Value { variable: u8, index: u16, value: f64 },
    /// All values of a variable are multiplied.
    Scale { variable: u8, factor: f64 },
    /// A variable is missing.
    Remove { variable: u8 },
    /// A variable has the name of another.
    Rename { variable: u8, name: u8 },
    /// Another variable, which has no dimension scales.
    Add { name: u8, shape: [u8; 3], value: Number },
    /// An attribute of the file.
    Global { attribute: u8, text: String },
}

/// A number of some type.
#[derive(Debug, Arbitrary)]
pub enum Number {
    /// Single precision.
    F32(f32),
    /// Double precision.
    F64(f64),
    /// Signed.
    I16(i16),
    /// Signed.
    I64(i64),
    /// Unsigned.
    U8(u8),
    /// Text instead of a number.
    Text(String),
    /// An array of variable length.
    Ragged(Vec<f32>),
}

/// Writes the valid file `original` with some changes to `path`. Changes that HDF5 refuses are
/// skipped.
pub fn edited(original: &[u8], edits: &[Edit], path: &Path) {
    std::fs::write(path, original).unwrap();
    let file = File::open_rw(path).unwrap();
    for edit in edits.iter().take(6) {
        let _ = apply(&file, edit);
    }
    file.close().unwrap();
}

fn apply(file: &File, edit: &Edit) -> hdf5::Result<()> {
    match edit {
        Edit::Usual { variable, attribute, text } => {
            let text = TEXTS[usize::from(*text) % TEXTS.len()];
            set(&pick(file, *variable)?, *attribute, &Number::Text(text.into()))
        }
        Edit::Text { variable, attribute, text } => {
            set(&pick(file, *variable)?, *attribute, &Number::Text(text.clone()))
        }
        Edit::Number { variable, attribute, value } => {
            set(&pick(file, *variable)?, *attribute, value)
        }
        Edit::Numbers { variable, attribute, values } => {
            let dataset = pick(file, *variable)?;
            let name = clear(&dataset, *attribute);
            dataset.new_attr_builder().with_data(values).create(name).map(drop)
        }
        Edit::Without { variable, attribute } => {
            clear(&pick(file, *variable)?, *attribute);
            Ok(())
        }
        Edit::Value { variable, index, value } => {
            let dataset = pick(file, *variable)?;
            let mut values = dataset.read_dyn::<f64>()?;
            let count = values.len().max(1);
            if let Some(one) = values.iter_mut().nth(usize::from(*index) % count) {
                *one = *value;
            }
            dataset.write(values.view())
        }
        Edit::Scale { variable, factor } => {
            let dataset = pick(file, *variable)?;
            let values = dataset.read_dyn::<f64>()? * *factor;
            dataset.write(values.view())
        }
        Edit::Remove { variable } => file.unlink(&pick(file, *variable)?.name()),
        Edit::Rename { variable, name } => {
            file.relink(&pick(file, *variable)?.name(), NAMES[usize::from(*name) % NAMES.len()])
        }
        Edit::Add { name, shape, value } => {
            let name = NAMES[usize::from(*name) % NAMES.len()];
            let shape = shape.map(|extent| usize::from(extent % 5));
            let number = match value {
                Number::F32(value) => f64::from(*value),
                Number::F64(value) => *value,
                Number::I16(value) => f64::from(*value),
                Number::I64(value) => *value as f64,
                Number::U8(value) => f64::from(*value),
                Number::Text(_) | Number::Ragged(_) => f64::NAN,
            };
            let values = ndarray::Array3::from_elem(shape, number);
            file.new_dataset_builder().with_data(values.view()).create(name).map(drop)
        }
        Edit::Global { attribute, text } => {
            let name = ATTRIBUTES[usize::from(*attribute) % ATTRIBUTES.len()];
            let text: VarLenUnicode = text.parse().unwrap_or_default();
            file.new_attr::<VarLenUnicode>().create(name)?.write_scalar(&text)
        }
    }
}

fn pick(file: &File, number: u8) -> hdf5::Result<Dataset> {
    let datasets = file.datasets()?;
    let index = usize::from(number) % datasets.len().max(1);
    datasets.into_iter().nth(index).ok_or_else(|| "no variable is left".into())
}

/// Removes an attribute; returns its name.
fn clear(dataset: &Dataset, attribute: u8) -> &'static str {
    let name = ATTRIBUTES[usize::from(attribute) % ATTRIBUTES.len()];
    let _ = dataset.delete_attr(name);
    name
}

fn set(dataset: &Dataset, attribute: u8, value: &Number) -> hdf5::Result<()> {
    let name = clear(dataset, attribute);
    match value {
        Number::F32(value) => dataset.new_attr::<f32>().create(name)?.write_scalar(value),
        Number::F64(value) => dataset.new_attr::<f64>().create(name)?.write_scalar(value),
        Number::I16(value) => dataset.new_attr::<i16>().create(name)?.write_scalar(value),
        Number::I64(value) => dataset.new_attr::<i64>().create(name)?.write_scalar(value),
        Number::U8(value) => dataset.new_attr::<u8>().create(name)?.write_scalar(value),
        Number::Text(text) => {
            let text: VarLenUnicode = text.parse().unwrap_or_default();
            dataset.new_attr::<VarLenUnicode>().create(name)?.write_scalar(&text)
        }
        Number::Ragged(values) => {
            let values = VarLenArray::from_slice(values);
            dataset.new_attr::<VarLenArray<f32>>().create(name)?.write_scalar(&values)
        }
    }
}
