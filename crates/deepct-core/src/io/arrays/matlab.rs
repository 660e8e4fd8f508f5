//! MATLAB files of versions 5 to 7 (`.mat`), compressed or not, of either byte order.
//!
//! Source: "MAT-File Format" (MathWorks): elements with a type and a size, aligned to eight bytes. Of an
//! array its axes are listed in the reverse order of MATLAB, as in files of version 7.3, which are HDF5;
//! vectors have one axis.

use super::{Array, Arrays, DEEPEST, MATLAB_MARK, Number, Reading, Stored, skip};
use crate::error::{Error, Result};
use flate2::read::ZlibDecoder;
use std::fs::File;
use std::io::{BufReader, Error as IoError, Read, Result as IoResult, Seek, SeekFrom};
use std::path::PathBuf;

/// Size of the text and the version at the beginning of a file (bytes).
const HEADER: u64 = 128;
/// Largest size of a name, of the names of fields, or of the lengths of the axes (bytes).
const LONGEST: u32 = 1 << 16;
/// Largest number of the cells of an array or of the fields of structures.
const MOST_PARTS: usize = 1_000_000;

/// Types of elements.
const MATRIX: u32 = 14;
const COMPRESSED: u32 = 15;
/// Classes of arrays.
const CELL: u8 = 1;
const STRUCTURE: u8 = 2;
const SPARSE: u8 = 5;

/// An element of the file that contains a variable.
#[derive(Clone)]
struct Place {
    path: PathBuf,
    /// The offset of its content in the file, and its size.
    offset: u64,
    size: u32,
    is_compressed: bool,
}

impl Place {
    /// Calls a function with the content of the element.
    fn read(&self, read: &mut Reading) -> IoResult<()> {
        let mut file = BufReader::new(File::open(&self.path)?);
        file.seek(SeekFrom::Start(self.offset))?;
        let mut content = file.take(self.size.into());
        match self.is_compressed {
            false => read(&mut content),
            true => {
                let mut content = BufReader::new(ZlibDecoder::new(content));
                read(&mut content)?;
                // At its end, the checksum is compared.
                std::io::copy(&mut content, &mut std::io::sink()).map(|_| ())
            }
        }
    }
}

/// The content of an element, and the number of bytes that were read of it.
struct Content<'a> {
    bytes: &'a mut dyn Read,
    position: u64,
    big_endian: bool,
}

/// The type and the size of an element; the content of a small one is in its tag.
struct Tag {
    kind: u32,
    size: u32,
    small: Option<[u8; 4]>,
}

/// List the arrays of numbers in all variables.
pub(super) fn list(arrays: &mut Arrays) -> Result<()> {
    let path = arrays.path.clone();
    let mut file = File::open(&path).map_err(Error::io(&path))?;
    let bytes = file.metadata().map_err(Error::io(&path))?.len();
    let mut header = [0; HEADER as usize];
    file.read_exact(&mut header).map_err(Error::io(&path))?;
    let big_endian = header[126..] == *b"MI";
    let is_own = header.starts_with(MATLAB_MARK.as_bytes());
    let mut offset = HEADER;
    while offset + 8 <= bytes {
        let mut tag = [0; 8];
        file.seek(SeekFrom::Start(offset)).map_err(Error::io(&path))?;
        file.read_exact(&mut tag).map_err(Error::io(&path))?;
        let [kind, size] =
            [0, 4].map(|at| word([tag[at], tag[at + 1], tag[at + 2], tag[at + 3]], big_endian));
        offset += 8;
        if offset + u64::from(size) > bytes {
            let problem = format!("an element declares {size} bytes, but the file ends before");
            return Err(arrays.damaged(problem));
        }
        if ![MATRIX, COMPRESSED].contains(&kind) {
            offset += u64::from(size);
            continue;
        }
        let is_compressed = kind == COMPRESSED;
        let place = Place { path: path.clone(), offset, size, is_compressed };
        let mut found = Vec::new();
        let listed = place.read(&mut |bytes| {
            let mut content = Content { bytes, position: 0, big_endian };
            let size = match is_compressed {
                false => size,
                true => match content.tag()? {
                    Tag { kind: MATRIX, size, .. } => size,
                    _ => return Ok(()),
                },
            };
            content.matrix(&place, "", size, DEEPEST, &mut found)
        });
        listed.map_err(|problem| arrays.damaged(problem))?;
        for (name, array) in found {
            arrays.insert(&name, if is_own { as_in_matlab(array) } else { array })?;
        }
        offset += u64::from(size);
    }
    if is_own { arrays.as_own() } else { Ok(()) }
}

/// An array with its axes in the order of MATLAB.
fn as_in_matlab(mut array: Array) -> Array {
    if array.shape.len() > 1 {
        array.shape.reverse();
        array.is_first_fastest = true;
    }
    array
}

fn word(bytes: [u8; 4], big_endian: bool) -> u32 {
    if big_endian { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) }
}

fn invalid(problem: &str) -> IoError {
    IoError::new(std::io::ErrorKind::InvalidData, problem)
}

impl Content<'_> {
    fn tag(&mut self) -> IoResult<Tag> {
        let mut bytes = [0; 8];
        self.bytes.read_exact(&mut bytes)?;
        self.position += 8;
        let [a, b, c, d, small @ ..] = bytes;
        let first = word([a, b, c, d], self.big_endian);
        match first >> 16 {
            0 => Ok(Tag { kind: first, size: word(small, self.big_endian), small: None }),
            size => Ok(Tag { kind: first & 0xffff, size, small: Some(small) }),
        }
    }

    fn skip(&mut self, size: u64) -> IoResult<()> {
        self.position += size;
        skip(self.bytes, size as usize, 1)
    }

    /// The content of a short element.
    fn short(&mut self) -> IoResult<Vec<u8>> {
        let tag = self.tag()?;
        if let Some(bytes) = tag.small {
            return Ok(bytes[..(tag.size as usize).min(4)].to_vec());
        }
        if tag.size > LONGEST {
            return Err(invalid("a name or a shape is too long"));
        }
        let mut bytes = vec![0; tag.size as usize];
        self.bytes.read_exact(&mut bytes)?;
        self.position += u64::from(tag.size);
        self.skip(u64::from(tag.size.next_multiple_of(8) - tag.size))?;
        Ok(bytes)
    }

    fn words(&mut self) -> IoResult<Vec<u32>> {
        let bytes = self.short()?;
        Ok(bytes.as_chunks::<4>().0.iter().map(|bytes| word(*bytes, self.big_endian)).collect())
    }

    /// List the arrays in the content of an element of the type [`MATRIX`] and a size. Its own name
    /// follows that of what contains it.
    fn matrix(
        &mut self,
        place: &Place,
        of: &str,
        size: u32,
        depth: usize,
        found: &mut Vec<(String, Array)>,
    ) -> IoResult<()> {
        // An empty array of a cell or a field.
        if size == 0 {
            return Ok(());
        }
        if depth == 0 {
            return Err(invalid("its structures are too deep"));
        }
        let end = self.position + u64::from(size);
        let flags = self.words()?.first().copied().unwrap_or(0);
        let (class, is_complex) = (flags as u8, flags & 0x800 != 0);
        // Objects and functions have another layout.
        if (CELL..=15).contains(&class) && class != 3 {
            let shape: Vec<_> = self.words()?.into_iter().map(|length| length as usize).collect();
            let name = String::from_utf8_lossy(&self.short()?).into_owned();
            let name = if of.is_empty() { name } else { of.to_owned() };
            let count = shape.iter().try_fold(1_usize, |count, length| count.checked_mul(*length));
            let count =
                count.ok_or_else(|| invalid(&format!("{name} declares the shape {shape:?}")))?;
            match class {
                CELL => self.parts(place, &name, count, &[], depth, found)?,
                STRUCTURE => {
                    let length = self.words()?.first().copied().unwrap_or(0).max(1) as usize;
                    let text = self.short()?;
                    let fields: Vec<_> = text.chunks(length).map(up_to_zero).collect();
                    self.parts(place, &name, count, &fields, depth, found)?;
                }
                SPARSE => found.push((name, unreadable("a sparse matrix", shape))),
                // Text.
                4 => {}
                _ if is_complex => found.push((name, unreadable("complex numbers", shape))),
                _ => found.push((name.clone(), self.numbers(place, &name, class, shape)?)),
            }
        }
        let rest = end.checked_sub(self.position);
        self.skip(
            rest.ok_or_else(|| invalid("an element is longer than the one that contains it"))?,
        )
    }

    /// List the arrays in the cells or in the fields of structures. Those of several have their number in
    /// the name.
    fn parts(
        &mut self,
        place: &Place,
        name: &str,
        count: usize,
        fields: &[String],
        depth: usize,
        found: &mut Vec<(String, Array)>,
    ) -> IoResult<()> {
        let is_cell = fields.is_empty();
        if count.saturating_mul(fields.len().max(1)) > MOST_PARTS {
            return Err(invalid(&format!("{name} has more than {MOST_PARTS} parts")));
        }
        let each = if is_cell { vec![String::new()] } else { fields.to_vec() };
        for number in 0..count {
            for field in &each {
                let path = match (is_cell, count) {
                    (true, _) => format!("{name}/{number}"),
                    (false, 1) => format!("{name}/{field}"),
                    (false, _) => format!("{name}/{number}/{field}"),
                };
                let tag = self.tag()?;
                if tag.kind != MATRIX {
                    return Err(invalid(&format!("{path} is no array")));
                }
                self.matrix(place, &path, tag.size, depth - 1, found)?;
            }
        }
        Ok(())
    }

    /// The array whose numbers come next.
    fn numbers(
        &mut self,
        place: &Place,
        name: &str,
        class: u8,
        shape: Vec<usize>,
    ) -> IoResult<Array> {
        let tag = self.tag()?;
        let number = match tag.kind {
            1 => Number::Signed(1),
            2 => Number::Unsigned(1),
            3 => Number::Signed(2),
            4 => Number::Unsigned(2),
            5 => Number::Signed(4),
            6 => Number::Unsigned(4),
            7 => Number::Float(4),
            9 => Number::Float(8),
            12 => Number::Signed(8),
            13 => Number::Unsigned(8),
            _ => {
                return Err(invalid(&format!(
                    "{name} has numbers of the unknown type {}",
                    tag.kind
                )));
            }
        };
        let stored = Stored { number: number.clone(), big_endian: self.big_endian };
        if stored.size_of(&shape) != Some(tag.size.into()) {
            let problem =
                format!("{name} declares the shape {shape:?}, but has {} bytes", tag.size);
            return Err(invalid(&problem));
        }
        // Real numbers may be stored as integers.
        let kind = match class {
            6 => Number::Float(8),
            7 => Number::Float(4),
            _ => number,
        };
        let is_vector = matches!(shape[..], [1, _] | [_, 1]);
        let shape = match is_vector {
            true => vec![shape.iter().product()],
            false => shape.into_iter().rev().collect(),
        };
        let source: super::Source = match tag.small {
            Some(bytes) => Box::new(move |read| read(&mut &bytes[..])),
            None => {
                let (place, position) = (place.clone(), self.position as usize);
                Box::new(move |read| {
                    place.read(&mut |bytes| {
                        skip(bytes, position, 1)?;
                        read(bytes)
                    })
                })
            }
        };
        Ok(Array { kind, ..Array::new(shape, stored, source) })
    }
}

/// An array whose values cannot be read, for the reason that they are `what`.
fn unreadable(what: &str, shape: Vec<usize>) -> Array {
    let stored = Stored { number: Number::Other(what.to_owned()), big_endian: false };
    Array::new(shape, stored, Box::new(|_| Err(IoError::other("is not read"))))
}

fn up_to_zero(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes.split(|byte| *byte == 0).next().unwrap_or_default()).into_owned()
}
