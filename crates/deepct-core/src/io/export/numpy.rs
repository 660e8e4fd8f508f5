//! Archives of NumPy arrays (`.npz`).

use super::arrays::{NamedArray, Numbers};
use crate::error::{Error, Result};
use ndarray_npy::NpzWriter;
use std::path::Path;

/// Write arrays under their names.
pub(super) fn write(path: &Path, arrays: &[NamedArray]) -> Result<()> {
    let output = crate::files::Output::create(path)?;
    let file = std::fs::File::create(output.temporary()).map_err(Error::io(path))?;
    let failed = |problem: String| {
        let problem = format!("cannot be written: {problem}");
        Error::file(path, "file", problem, "check that the disk has room")
    };
    let mut archive = NpzWriter::new(std::io::BufWriter::new(file));
    for NamedArray { name, values } in arrays {
        let added = match values {
            Numbers::Single(values) => archive.add_array(*name, values),
            Numbers::Double(values) => archive.add_array(*name, values),
            Numbers::Byte(values) => archive.add_array(*name, values),
        };
        added.map_err(|problem| failed(problem.to_string()))?;
    }
    archive.finish().map_err(|problem| failed(problem.to_string()))?;
    output.finish()
}
