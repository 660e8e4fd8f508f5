//! The classic format of netCDF (netCDF-3): with 32-bit offsets, with 64-bit offsets, and with
//! 64-bit sizes (CDF-5).
//!
//! Source: the NetCDF Classic Format Specification, Unidata. All numbers are big-endian. Every size
//! that a file declares is compared with the size of the file before memory is allocated.

use super::container::{Attribute, Kind, Real};
use super::hdf5_file::decoded;
use crate::error::{Error, Result};
use ndarray::{ArrayD, IxDyn};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};

const DIMENSIONS: u32 = 10;
const VARIABLES: u32 = 11;
const ATTRIBUTES: u32 = 12;

/// Largest size of a header (bytes).
const LONGEST_HEADER: u64 = 1 << 28;
/// Number of bytes that are read at once.
const PIECE: usize = 1 << 20;

/// An open file.
pub(super) struct Classic {
    path: PathBuf,
    file: File,
    attributes: BTreeMap<String, Attribute>,
    variables: BTreeMap<String, Variable>,
    /// Distance between the records (bytes).
    record: u64,
}

/// A variable of a file.
pub(super) struct Variable {
    pub(super) dimensions: Vec<String>,
    pub(super) shape: Vec<usize>,
    pub(super) kind: Kind,
    pub(super) attributes: BTreeMap<String, Attribute>,
    /// The code of the type.
    code: u32,
    /// Position of the first value in the file (bytes).
    begin: u64,
    /// Whether the first dimension is that of the records.
    records: bool,
}

impl Classic {
    pub(super) fn open(path: &Path) -> Result<Self> {
        let file = File::open(path).map_err(Error::io(path))?;
        let bytes = file.metadata().map_err(Error::io(path))?.len();
        let left = bytes.min(LONGEST_HEADER);
        let mut header = Header { reader: BufReader::new(&file), left, version: 0 };
        let Some((attributes, variables, record)) = header.read(bytes) else {
            let problem = "is truncated or damaged: its header cannot be read";
            return Err(Error::file(path, "file", problem, "copy it again from its source"));
        };
        Ok(Self { path: path.into(), file, attributes, variables, record })
    }

    pub(super) fn names(&self) -> Vec<String> {
        self.variables.keys().cloned().collect()
    }

    pub(super) fn variable(&self, name: &str) -> Option<&Variable> {
        self.variables.get(name)
    }

    pub(super) fn attribute(&self, name: &str) -> Option<&Attribute> {
        self.attributes.get(name)
    }

    /// The numbers of a variable within a range of each axis.
    pub(super) fn read<T: Real>(
        &self,
        variable: &Variable,
        ranges: &[Range<usize>],
    ) -> std::result::Result<ArrayD<T>, (String, String)> {
        self.values(variable, ranges).map_err(|problem| {
            let path = self.path.display();
            let remedy = format!("copy {path} again from its source");
            (format!("cannot be read: {problem}"), remedy)
        })
    }

    /// The characters of a variable of text, one by one; `None` if they cannot be read.
    pub(super) fn characters(&self, variable: &Variable) -> Option<Vec<String>> {
        let all: Vec<_> = variable.shape.iter().map(|&length| 0..length).collect();
        let codes: ArrayD<f64> = self.values(variable, &all).ok()?;
        let character = |code: &f64| match *code as u8 {
            0 => String::new(),
            code => char::from(code).to_string(),
        };
        Some(codes.iter().map(character).collect())
    }

    fn values<T: Real>(
        &self,
        variable: &Variable,
        ranges: &[Range<usize>],
    ) -> std::io::Result<ArrayD<T>> {
        let shape: Vec<_> = ranges.iter().map(ExactSizeIterator::len).collect();
        let size = size_of(variable.code);
        // The distance (bytes) between neighbours along each axis.
        let mut steps = vec![size as u64; ranges.len()];
        for axis in (1..ranges.len()).rev() {
            steps[axis - 1] = steps[axis].saturating_mul(variable.shape[axis] as u64);
        }
        if let (true, Some(step)) = (variable.records, steps.first_mut()) {
            *step = self.record;
        }
        // The values along the last axes are contiguous if they are read completely.
        let mut inner = ranges.len();
        let mut run = 1;
        while inner > 0 && (inner > 1 || !variable.records) {
            inner -= 1;
            run *= shape[inner];
            if shape[inner] != variable.shape[inner] {
                break;
            }
        }
        let count: usize = shape.iter().product();
        let mut values = Vec::with_capacity(count);
        let mut buffer = vec![0; (run * size).min(PIECE - PIECE % size)];
        let mut file = &self.file;
        for index in ndarray::indices(IxDyn(&shape[..inner])) {
            let start = variable.begin
                + ranges
                    .iter()
                    .enumerate()
                    .map(|(axis, range)| {
                        let offset = if axis < inner { index[axis] } else { 0 };
                        steps[axis] * (range.start + offset) as u64
                    })
                    .sum::<u64>();
            file.seek(SeekFrom::Start(start))?;
            let mut left = run * size;
            while left > 0 {
                let piece = &mut buffer[..left.min(PIECE - PIECE % size)];
                file.read_exact(piece)?;
                left -= piece.len();
                values.extend(
                    piece.chunks_exact(size).map(|bytes| T::from_f64(number(variable.code, bytes))),
                );
            }
        }
        ArrayD::from_shape_vec(IxDyn(&shape), values).map_err(std::io::Error::other)
    }
}

/// Reads the header; `None` if it is damaged.
struct Header<'a> {
    reader: BufReader<&'a File>,
    /// Number of bytes that may still be read.
    left: u64,
    version: u8,
}

type Contents = (BTreeMap<String, Attribute>, BTreeMap<String, Variable>, u64);

impl Header<'_> {
    fn read(&mut self, bytes: u64) -> Option<Contents> {
        self.version = self.take(4)?[3];
        let records = self.count()?;
        let dimensions = self.list(DIMENSIONS, |header| Some((header.name()?, header.count()?)))?;
        let attributes = self.attributes()?;
        let mut found = self.list(VARIABLES, |header| header.variable(&dimensions))?;
        // The size of a record is that of all variables with records, each rounded up to a multiple of
        // four bytes if there are several.
        let mut sizes = Vec::new();
        for (_, variable) in found.iter().filter(|(_, variable)| variable.records) {
            let values = variable.shape[1..]
                .iter()
                .try_fold(1_u64, |product, &length| product.checked_mul(length as u64))?;
            sizes.push(values.checked_mul(size_of(variable.code) as u64)?);
        }
        let record = match sizes.as_slice() {
            [single] => *single,
            several => several
                .iter()
                .try_fold(0_u64, |sum, size| sum.checked_add(size.checked_next_multiple_of(4)?))?,
        };
        let first = found.iter().filter(|(_, variable)| variable.records).map(|(_, v)| v.begin);
        let streaming = if self.version == 5 { u64::MAX } else { u64::from(u32::MAX) };
        let records = match first.min() {
            // A file that was written as a stream does not state their number.
            Some(begin) if records == streaming => bytes.saturating_sub(begin) / record.max(1),
            _ => records,
        };
        for (_, variable) in &mut found {
            if variable.records {
                variable.shape[0] = usize::try_from(records).ok()?;
            }
            variable.check(bytes, record)?;
        }
        Some((attributes, found.into_iter().collect(), record))
    }

    fn take(&mut self, count: u64) -> Option<Vec<u8>> {
        self.left = self.left.checked_sub(count)?;
        let mut bytes = vec![0; usize::try_from(count).ok()?];
        self.reader.read_exact(&mut bytes).ok()?;
        Some(bytes)
    }

    fn word(&mut self) -> Option<u32> {
        Some(u32::from_be_bytes(self.take(4)?.try_into().ok()?))
    }

    fn long(&mut self) -> Option<u64> {
        Some(u64::from_be_bytes(self.take(8)?.try_into().ok()?))
    }

    /// A count, whose size depends on the version of the format.
    fn count(&mut self) -> Option<u64> {
        if self.version == 5 { self.long() } else { self.word().map(u64::from) }
    }

    /// Bytes that are padded to a multiple of four.
    fn padded(&mut self, count: u64) -> Option<Vec<u8>> {
        let mut bytes = self.take(count.checked_next_multiple_of(4)?)?;
        bytes.truncate(usize::try_from(count).ok()?);
        Some(bytes)
    }

    fn name(&mut self) -> Option<String> {
        let length = self.count()?;
        self.padded(length).map(|bytes| decoded(&bytes))
    }

    /// A list of elements after its tag and their number; an absent list consists of zeros.
    fn list<T>(
        &mut self,
        tag: u32,
        mut element: impl FnMut(&mut Self) -> Option<T>,
    ) -> Option<Vec<T>> {
        let found = self.word()?;
        let count = self.count()?;
        if count == 0 {
            return Some(Vec::new());
        }
        // An element takes at least eight bytes.
        if found != tag || count > self.left / 8 {
            return None;
        }
        (0..count).map(|_| element(self)).collect()
    }

    fn attributes(&mut self) -> Option<BTreeMap<String, Attribute>> {
        let attributes = self.list(ATTRIBUTES, |header| {
            let name = header.name()?;
            let code = header.word()?;
            let count = header.count()?;
            let size = size_of(code);
            let bytes = header.padded(count.checked_mul(size as u64)?)?;
            let value = match code {
                2 => {
                    let text = decoded(&bytes);
                    Attribute::Text(text.trim_end_matches('\0').trim().to_owned())
                }
                _ => {
                    let numbers = bytes.chunks_exact(size).map(|bytes| number(code, bytes));
                    Attribute::Numbers(numbers.collect(), matches!(code, 5 | 6))
                }
            };
            Some((name, value))
        })?;
        Some(attributes.into_iter().collect())
    }

    fn variable(&mut self, dimensions: &[(String, u64)]) -> Option<(String, Variable)> {
        let name = self.name()?;
        let rank = self.count()?;
        if rank > self.left / 4 {
            return None;
        }
        let mut own = Vec::new();
        for _ in 0..rank {
            own.push(dimensions.get(usize::try_from(self.count()?).ok()?)?);
        }
        let attributes = self.attributes()?;
        let code = self.word()?;
        // The size is not exact for large variables, and follows from the dimensions.
        self.count()?;
        let begin = if self.version == 1 { u64::from(self.word()?) } else { self.long()? };
        let kind = match code {
            1 => Kind::Signed(1),
            2 => Kind::Other("text".into()),
            3 => Kind::Signed(2),
            4 => Kind::Signed(4),
            5 => Kind::Float(4),
            6 => Kind::Float(8),
            7 => Kind::Unsigned(1),
            8 => Kind::Unsigned(2),
            9 => Kind::Unsigned(4),
            10 => Kind::Signed(8),
            11 => Kind::Unsigned(8),
            _ => return None,
        };
        // The dimension of the records has the length 0.
        let is_record = |dimension: &(String, u64)| dimension.1 == 0;
        if own.iter().skip(1).any(|dimension| is_record(dimension)) {
            return None;
        }
        let lengths: Option<_> =
            own.iter().map(|(_, length)| usize::try_from(*length).ok()).collect();
        let variable = Variable {
            dimensions: own.iter().map(|(name, _)| name.clone()).collect(),
            shape: lengths?,
            kind,
            attributes,
            code,
            begin,
            records: own.first().is_some_and(|dimension| is_record(dimension)),
        };
        Some((name, variable))
    }
}

impl Variable {
    /// `None` if the file is too short for the values.
    fn check(&self, bytes: u64, record: u64) -> Option<()> {
        let of = |shape: &[usize]| {
            let mut lengths = shape.iter();
            lengths.try_fold(size_of(self.code) as u64, |size, &length| {
                size.checked_mul(length as u64)
            })
        };
        let size = match (self.records, self.shape.first()) {
            (true, Some(0)) => return Some(()),
            (true, Some(&records)) => {
                (records as u64 - 1).checked_mul(record)?.checked_add(of(&self.shape[1..])?)?
            }
            _ => of(&self.shape)?,
        };
        (self.begin.checked_add(size)? <= bytes).then_some(())
    }
}

/// The size of a number of the type `code` (bytes).
fn size_of(code: u32) -> usize {
    match code {
        3 | 8 => 2,
        4 | 5 | 9 => 4,
        6 | 10 | 11 => 8,
        _ => 1,
    }
}

/// The number of the type `code` in big-endian bytes.
fn number(code: u32, bytes: &[u8]) -> f64 {
    let value = bytes.iter().fold(0_u64, |value, &byte| (value << 8) | u64::from(byte));
    match code {
        1 => f64::from(value as u8 as i8),
        3 => f64::from(value as u16 as i16),
        4 => f64::from(value as u32 as i32),
        5 => f64::from(f32::from_bits(value as u32)),
        6 => f64::from_bits(value),
        10 => value as i64 as f64,
        _ => value as f64,
    }
}
