//! Arrays of NumPy: files of one array (`.npy`) and archives of them (`.npz`).
//!
//! Source: "A Simple File Format for NumPy Arrays" in the documentation of NumPy (`numpy.lib.format`).

use super::{Array, Arrays, MARK, Stored, numpy_type, skip};
use crate::error::{Error, Result};
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;
use zip::ZipArchive;

/// Largest header of an array (bytes).
const LONGEST_HEADER: usize = 1 << 16;

/// What the header of an array states.
struct Header {
    shape: Vec<usize>,
    stored: Stored,
    is_first_fastest: bool,
    /// Size of the header (bytes).
    length: u64,
}

impl Header {
    /// Size of the header and the values (bytes); `None` if the values are no numbers.
    fn size(&self) -> Option<u64> {
        let is_number = !matches!(self.stored.number, super::Number::Other(_));
        is_number.then(|| self.stored.size_of(&self.shape)?.checked_add(self.length))?
    }

    fn array(self, source: super::Source) -> Array {
        let Self { shape, stored, is_first_fastest, .. } = self;
        Array { is_first_fastest, ..Array::new(shape, stored, source) }
    }
}

/// List the array of a file.
pub(super) fn list_npy(arrays: &mut Arrays) -> Result<()> {
    let path = arrays.path.clone();
    let file = File::open(&path).map_err(Error::io(&path))?;
    let bytes = file.metadata().map_err(Error::io(&path))?.len();
    let header = header(&mut BufReader::new(file));
    let header = header.ok_or_else(|| arrays.damaged("its header cannot be read"))?;
    check_size(arrays, "it", &header, bytes)?;
    let at_values = Array::in_file(Vec::new(), header.stored.clone(), &path, header.length);
    arrays.insert(&arrays.stem(), header.array(at_values.source))
}

/// List the arrays of an archive.
pub(super) fn list_npz(arrays: &mut Arrays) -> Result<()> {
    let path = arrays.path.clone();
    let mut archive = archive(&path).map_err(|problem| arrays.damaged(problem))?;
    for index in 0..archive.len() {
        let mut member = archive.by_index(index).map_err(|problem| arrays.damaged(problem))?;
        let Some(name) = member.name().strip_suffix(".npy").map(str::to_owned) else { continue };
        let header = header(&mut member);
        let header =
            header.ok_or_else(|| arrays.damaged(format!("the header of {name} cannot be read")))?;
        check_size(arrays, &name, &header, member.size())?;
        let (path, length) = (path.clone(), header.length);
        let source = move |read: &mut super::Reading| {
            let mut archive = self::archive(&path)?;
            let mut member = BufReader::new(archive.by_index(index)?);
            skip(&mut member, 1, length as usize)?;
            read(&mut member)?;
            // At its end, the checksum is compared.
            std::io::copy(&mut member, &mut std::io::sink()).map(|_| ())
        };
        arrays.insert(&name, header.array(Box::new(source)))?;
    }
    if arrays.by_name.is_empty() {
        let problem = "is a zip archive without arrays of NumPy";
        return Err(arrays.error("file", problem, "write the arrays with numpy.savez"));
    }
    match archive.comment() == MARK.as_bytes() {
        true => arrays.as_own(),
        false => Ok(()),
    }
}

fn archive(path: &Path) -> zip::result::ZipResult<ZipArchive<BufReader<File>>> {
    ZipArchive::new(BufReader::new(File::open(path)?))
}

fn check_size(arrays: &Arrays, name: &str, header: &Header, bytes: u64) -> Result<()> {
    match (&header.stored.number, header.size()) {
        (super::Number::Other(_), _) => Ok(()),
        (_, Some(size)) if size <= bytes => Ok(()),
        (_, _) => {
            let problem =
                format!("{name} declares the shape {:?}, but has {bytes} bytes", header.shape);
            Err(arrays.damaged(problem))
        }
    }
}

/// The header of an array; `None` if it is not one.
fn header(bytes: &mut impl Read) -> Option<Header> {
    let mut start = [0; 8];
    bytes.read_exact(&mut start).ok()?;
    let version = start.strip_prefix(b"\x93NUMPY")?[0];
    let mut length = [0; 4];
    let size = if version == 1 { 2 } else { 4 };
    bytes.read_exact(&mut length[..size]).ok()?;
    let length = u32::from_le_bytes(length) as usize;
    if length > LONGEST_HEADER {
        return None;
    }
    let mut text = vec![0; length];
    bytes.read_exact(&mut text).ok()?;
    let text = String::from_utf8_lossy(&text);
    let after =
        |key: &str| Some(text.rsplit_once(key)?.1.trim_start().strip_prefix(':')?.trim_start());
    let description = text.split_once("'descr'")?.1.trim_start().strip_prefix(':')?.trim_start();
    // That of records is a list.
    let name = description.strip_prefix('\'').and_then(|rest| rest.split_once('\''));
    let stored = numpy_type(name.map_or("records", |(name, _)| name));
    let lengths = after("'shape'")?.strip_prefix('(')?.split_once(')')?.0;
    let shape = lengths.split(',').map(|length| length.trim().trim_end_matches('L'));
    let shape: Option<_> =
        shape.filter(|length| !length.is_empty()).map(|length| length.parse().ok()).collect();
    Some(Header {
        shape: shape?,
        stored,
        is_first_fastest: after("'fortran_order'")?.starts_with("True"),
        length: (8 + size + length) as u64,
    })
}
