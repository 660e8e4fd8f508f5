//! Archives of NumPy arrays (`.npz`).

use super::arrays::{NamedArray, Numbers};
use crate::error::{Error, Result};
use crate::io::arrays::MARK;
use ndarray_npy::WriteNpyExt;
use std::path::Path;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// Write arrays under their names.
pub(super) fn write(path: &Path, arrays: &[NamedArray]) -> Result<()> {
    let output = crate::files::Output::create(path)?;
    let file = std::fs::File::create(output.temporary()).map_err(Error::io(path))?;
    let failed = |problem: String| {
        let problem = format!("cannot be written: {problem}");
        Error::file(path, "file", problem, "check that the disk has room")
    };
    let mut archive = ZipWriter::new(std::io::BufWriter::new(file));
    archive.set_comment(MARK);
    let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
    let options = options.large_file(true);
    for NamedArray { name, values } in arrays {
        archive
            .start_file(format!("{name}.npy"), options)
            .map_err(|problem| failed(problem.to_string()))?;
        let member = std::io::BufWriter::new(&mut archive);
        let added = match values {
            Numbers::Single(values) => values.write_npy(member),
            Numbers::Double(values) => values.write_npy(member),
            Numbers::Byte(values) => values.write_npy(member),
        };
        added.map_err(|problem| failed(problem.to_string()))?;
    }
    let file = archive.finish().map_err(|problem| failed(problem.to_string()))?;
    file.into_inner().map_err(|problem| Error::io(path)(problem.into_error()))?;
    output.finish()
}
