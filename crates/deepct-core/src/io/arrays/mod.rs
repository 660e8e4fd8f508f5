//! Files that are collections of arrays: NumPy (`.npy`, `.npz`), MATLAB 5 to 7 (`.mat`), pickles of
//! Python (`.pkl`), grid volumes of Mitsuba (`.vol`) and VTK image data (`.vti`).
//!
//! Opening a file lists its arrays: their names, shapes and types. Values are read when they are asked
//! for, in pieces, so that what a file declares never decides how much memory is allocated. Arrays in
//! structures have the path of the structure in their name, as `clouds/beta`.
//!
//! Most of these formats state neither units nor the names of axes. Files that
//! [`crate::io::export`] writes do: their arrays have the axes and units of deepct's own files.

mod matlab;
mod mitsuba;
mod numpy;
mod pickle;
mod vtk;

use crate::error::{Error, Result};
use half::f16;
use ndarray::{ArrayD, IxDyn};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The mark of a file of [`crate::io::export`], with the units of its arrays.
pub(super) const MARK: &str = "written by deepct: lengths in km; extinction and its uncertainty in km-1, \
                               lwc in g m-3, reff in um";
/// The beginning of such a file of MATLAB, whose header has 116 letters.
pub(super) const MATLAB_MARK: &str = "MATLAB 5.0 MAT-file, written by deepct";
/// The arrays that state the grid of such a file: the lower corner and the size of a voxel, x, y, z (km).
pub(super) const CORNER: &str = "origin_km";
/// See [`CORNER`].
pub(super) const SPACING: &str = "spacing_km";

/// The axes of a field.
const AXES: [&str; 3] = ["z", "y", "x"];
/// Number of bytes from which a format is identified.
const LONGEST_START: u64 = 512;
/// Number of bytes that are read at once.
const PIECE: usize = 1 << 20;
/// Depth of structures within structures that are listed, and the number of arrays in a file.
const DEEPEST: usize = 16;
const MOST_ARRAYS: usize = 10_000;

/// The type of the numbers of an array, with their size in bytes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Number {
    Float(usize),
    Signed(usize),
    Unsigned(usize),
    /// Another type, by its description.
    Other(String),
}

/// The representation of stored numbers.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Stored {
    number: Number,
    big_endian: bool,
}

/// Calls a function with the bytes of an array, from its first value on.
type Source = Box<dyn Fn(&mut Reading) -> std::io::Result<()>>;
/// What reads the bytes of an array.
type Reading<'a> = dyn FnMut(&mut dyn Read) -> std::io::Result<()> + 'a;

/// An array of a file.
pub(super) struct Array {
    /// The length along each axis.
    pub(super) shape: Vec<usize>,
    /// The name of each axis, where it is known.
    pub(super) dimensions: Vec<Option<String>>,
    /// The type of the values.
    pub(super) kind: Number,
    /// The unit, where it is known.
    pub(super) units: Option<&'static str>,
    /// The lower edge and the spacing of a coordinate that a grid states.
    pub(super) cells: Option<[f64; 2]>,
    stored: Stored,
    /// Whether the first index varies fastest.
    is_first_fastest: bool,
    source: Source,
}

/// The arrays of a file.
pub(super) struct Arrays {
    path: PathBuf,
    by_name: BTreeMap<String, Array>,
    /// What the format does not state, and is assumed.
    pub(super) assumption: Option<&'static str>,
    /// Whether [`crate::io::export`] wrote the file, so that nothing needs to be assumed.
    pub(super) is_own: bool,
}

/// The formats.
#[derive(Clone, Copy)]
enum Format {
    Npy,
    Npz,
    Matlab,
    Pickle,
    Mitsuba,
    Vtk,
}

/// Whether a file is one of these formats, according to its first bytes.
pub(super) fn is_array_file(path: &Path) -> bool {
    matches!(format_of(path), Ok(Some(_)))
}

/// What the ending of a name promises and the content of the file does not hold: a format of this
/// module. `None` for other names.
pub(super) fn expected_by_name(path: &Path) -> Option<Error> {
    let ending = path.extension()?.to_str()?.to_lowercase();
    let (what, remedy) = match ending.as_str() {
        "npy" | "npz" => {
            ("an array of NumPy or an archive of them", "write it with numpy.save or numpy.savez")
        }
        "mat" => {
            ("a MATLAB file of version 5 to 7.3", "save it with -v7 in MATLAB or scipy.io.savemat")
        }
        "pkl" | "pickle" => (
            "a pickle of protocol 2 to 5",
            "write it with pickle.dump(..., protocol=4) or numpy.savez",
        ),
        "vol" => ("a grid volume of Mitsuba, version 3", "write it with mitsuba.VolumeGrid"),
        "vti" => ("VTK image data", "write it with vtkXMLImageDataWriter"),
        _ => return None,
    };
    Some(Error::file(path, "file", format!("has the ending .{ending}, but is not {what}"), remedy))
}

fn format_of(path: &Path) -> Result<Option<Format>> {
    let mut start = Vec::new();
    let file = File::open(path).map_err(Error::io(path))?;
    file.take(LONGEST_START).read_to_end(&mut start).map_err(Error::io(path))?;
    Ok(match start.as_slice() {
        [0x93, b'N', b'U', b'M', b'P', b'Y', ..] => Some(Format::Npy),
        [b'P', b'K', 3 | 5, 4 | 6, ..] => Some(Format::Npz),
        [b'V', b'O', b'L', ..] => Some(Format::Mitsuba),
        [0x80, 2..=5, ..] => Some(Format::Pickle),
        text if matches!(text.get(124..128), Some([0, 1, b'I', b'M'] | [1, 0, b'M', b'I'])) => {
            Some(Format::Matlab)
        }
        text if String::from_utf8_lossy(text).contains("<VTKFile") => Some(Format::Vtk),
        _ => None,
    })
}

impl Arrays {
    /// List the arrays of a file; `None` if it is of another format.
    ///
    /// # Errors
    /// Returns an error if the file cannot be read, is damaged, or contains what is not an array.
    pub(super) fn open(path: &Path) -> Result<Option<Self>> {
        let Some(format) = format_of(path)? else { return Ok(None) };
        let mut arrays =
            Self { path: path.into(), by_name: BTreeMap::new(), assumption: None, is_own: false };
        match format {
            Format::Npy => numpy::list_npy(&mut arrays)?,
            Format::Npz => numpy::list_npz(&mut arrays)?,
            Format::Matlab => matlab::list(&mut arrays)?,
            Format::Pickle => pickle::list(&mut arrays)?,
            Format::Mitsuba => mitsuba::list(&mut arrays)?,
            Format::Vtk => vtk::list(&mut arrays)?,
        }
        if arrays.by_name.is_empty() {
            return Err(arrays.error(
                "file",
                "contains no arrays of numbers",
                "write the cloud as one",
            ));
        }
        Ok(Some(arrays))
    }

    pub(super) fn names(&self) -> Vec<String> {
        self.by_name.keys().cloned().collect()
    }

    pub(super) fn get(&self, name: &str) -> Option<&Array> {
        self.by_name.get(name)
    }

    fn error(&self, field: &str, problem: impl Into<String>, remedy: &str) -> Error {
        Error::file(&self.path, field, problem, remedy)
    }

    fn damaged(&self, problem: impl std::fmt::Display) -> Error {
        let problem = format!("is truncated or damaged: {problem}");
        self.error("file", problem, "copy it again from its source")
    }

    fn insert(&mut self, name: &str, array: Array) -> Result<()> {
        if self.by_name.len() == MOST_ARRAYS {
            let problem = format!("contains more than {MOST_ARRAYS} arrays");
            return Err(self.error("file", problem, "write the cloud alone"));
        }
        self.by_name.insert(name.to_owned(), array);
        Ok(())
    }

    /// The name of the file without its ending, which an array without a name gets.
    fn stem(&self) -> String {
        self.path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
    }

    /// Give arrays of a file of [`crate::io::export`] the axes and units that deepct's own files have.
    ///
    /// # Errors
    /// Returns an error if the file holds images, which cannot be read from it.
    fn as_own(&mut self) -> Result<()> {
        let line = |name: &str| -> Option<[f64; 3]> {
            let line = self.get(name).filter(|line| line.shape == [3])?;
            let is_real = matches!(line.kind, Number::Float(_));
            let values =
                is_real.then(|| line.read(std::slice::from_ref(&(0..3)), |value| value).ok())??;
            values.into_raw_vec_and_offset().0.try_into().ok()
        };
        let (Some(corner), Some(spacing)) = (line(CORNER), line(SPACING)) else {
            let remedy = "give the netCDF file from which they were converted";
            return Err(self.error(
                "file",
                "holds images, which are not read from this format",
                remedy,
            ));
        };
        let shape =
            self.by_name.values().find_map(|array| <[usize; 3]>::try_from(&array.shape[..]).ok());
        let shape = shape.ok_or_else(|| self.damaged("it has no fields"))?;
        self.is_own = true;
        for name in [CORNER, SPACING] {
            self.by_name.remove(name);
        }
        for (name, array) in &mut self.by_name {
            array.units = Some(match name.as_str() {
                "extinction" | "uncertainty" => "km-1",
                "lwc" => "g m-3",
                "reff" => "um",
                _ => "1",
            });
        }
        self.put_on_grid(corner, spacing, shape, Some("km"))
    }

    /// Give all arrays of the shape `[z, y, x]` the axes of a grid, and add their coordinates and bounds.
    ///
    /// # Errors
    /// Returns an error if the grid is not one.
    fn put_on_grid(
        &mut self,
        corner: [f64; 3],
        spacing: [f64; 3],
        shape: [usize; 3],
        units: Option<&'static str>,
    ) -> Result<()> {
        let is_grid = spacing.iter().all(|step| step.is_finite() && *step > 0.0)
            && corner.iter().all(|edge| edge.is_finite());
        if !is_grid {
            let problem = format!("begins at {corner:?} and has cells of {spacing:?}");
            return Err(self.error("grid", problem, "write a box with positive sizes"));
        }
        let cells = shape.iter().fold(0.0, |sum, length| sum + *length as f64);
        crate::memory::check("memory for the coordinates", cells, 64.0)
            .map_err(Error::in_file(&self.path))?;
        for array in self.by_name.values_mut().filter(|array| array.shape == shape) {
            array.dimensions = AXES.map(|name| Some(name.to_owned())).to_vec();
        }
        for (axis, name) in AXES.into_iter().rev().enumerate() {
            let (edge, step) = (corner[axis], spacing[axis]);
            let faces: Vec<_> = (0..=shape[2 - axis]).map(|at| edge + step * at as f64).collect();
            let centres: Vec<_> = faces.windows(2).map(|pair| 0.5 * (pair[0] + pair[1])).collect();
            let pairs: Vec<_> = faces.windows(2).flatten().copied().collect();
            let mut coordinate = Array::of_values(vec![centres.len()], &centres);
            coordinate.dimensions = vec![Some(name.to_owned())];
            coordinate.cells = units.map(|_| [edge, step]);
            coordinate.units = units;
            let mut bounds = Array::of_values(vec![centres.len(), 2], &pairs);
            bounds.dimensions = vec![Some(name.to_owned()), Some("bnds".to_owned())];
            self.insert(name, coordinate)?;
            self.insert(&format!("{name}_bnds"), bounds)?;
        }
        Ok(())
    }
}

impl Array {
    fn new(shape: Vec<usize>, stored: Stored, source: Source) -> Self {
        Self {
            dimensions: vec![None; shape.len()],
            shape,
            kind: stored.number.clone(),
            units: None,
            cells: None,
            stored,
            is_first_fastest: false,
            source,
        }
    }

    /// An array of values in memory.
    fn of_values(shape: Vec<usize>, values: &[f64]) -> Self {
        let bytes: Arc<[u8]> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        let stored = Stored { number: Number::Float(8), big_endian: false };
        Self::new(shape, stored, Box::new(move |read| read(&mut &bytes[..])))
    }

    /// An array whose values begin at an offset of a file.
    fn in_file(shape: Vec<usize>, stored: Stored, path: &Path, offset: u64) -> Self {
        let path = path.to_owned();
        let source = move |read: &mut Reading| {
            let mut file = File::open(&path)?;
            file.seek(SeekFrom::Start(offset))?;
            read(&mut BufReader::with_capacity(PIECE, file))
        };
        Self::new(shape, stored, Box::new(source))
    }

    /// The name of the array that holds the faces of the cells of a coordinate.
    pub(super) fn bounds(&self) -> Option<String> {
        match &self.dimensions[..] {
            [Some(name)] => Some(format!("{name}_bnds")),
            _ => None,
        }
    }

    /// The values within a range of each axis, each converted by `convert`.
    ///
    /// # Errors
    /// Returns an error if the file ends before, or if its checksum is wrong.
    pub(super) fn read<T>(
        &self,
        ranges: &[Range<usize>],
        convert: impl Fn(f64) -> T,
    ) -> std::io::Result<ArrayD<T>> {
        // In the order of the bytes.
        let (mut shape, mut ranges) = (self.shape.clone(), ranges.to_vec());
        if self.is_first_fastest {
            shape.reverse();
            ranges.reverse();
        }
        let lengths: Vec<_> = ranges.iter().map(ExactSizeIterator::len).collect();
        let size = self.stored.size();
        let line = shape.pop().unwrap_or(1);
        let part = ranges.pop().unwrap_or(0..1);
        let mut values = Vec::with_capacity(lengths.iter().product());
        let mut piece = vec![0; (part.len() * size).min(PIECE - PIECE % size)];
        (self.source)(&mut |bytes| {
            for index in ndarray::indices(IxDyn(&shape)) {
                let is_wanted =
                    ranges.iter().enumerate().all(|(axis, range)| range.contains(&index[axis]));
                if !is_wanted {
                    skip(bytes, line, size)?;
                    continue;
                }
                skip(bytes, part.start, size)?;
                let mut left = part.len() * size;
                while left > 0 {
                    let piece = &mut piece[..left.min(PIECE - PIECE % size)];
                    bytes.read_exact(piece)?;
                    left -= piece.len();
                    values.extend(
                        piece.chunks_exact(size).map(|bytes| convert(self.stored.value(bytes))),
                    );
                }
                skip(bytes, line - part.end, size)?;
            }
            Ok(())
        })?;
        let values =
            ArrayD::from_shape_vec(IxDyn(&lengths), values).map_err(std::io::Error::other)?;
        Ok(if self.is_first_fastest { values.reversed_axes() } else { values })
    }
}

impl Stored {
    /// Size of a number (bytes).
    fn size(&self) -> usize {
        match self.number {
            Number::Float(size) | Number::Signed(size) | Number::Unsigned(size) => size,
            Number::Other(_) => 1,
        }
    }

    /// Size of an array (bytes); `None` if it overflows.
    fn size_of(&self, shape: &[usize]) -> Option<u64> {
        let each = Some(self.size() as u64);
        shape.iter().fold(each, |bytes, length| bytes?.checked_mul(*length as u64))
    }

    fn value(&self, bytes: &[u8]) -> f64 {
        let mut ordered = [0; 8];
        for (place, byte) in ordered.iter_mut().zip(bytes) {
            *place = *byte;
        }
        if self.big_endian {
            ordered[..bytes.len()].reverse();
        }
        let [a, b, c, d, ..] = ordered;
        match self.number {
            Number::Float(2) => f16::from_le_bytes([a, b]).into(),
            Number::Float(4) => f32::from_le_bytes([a, b, c, d]).into(),
            Number::Float(_) => f64::from_le_bytes(ordered),
            Number::Signed(1) => f64::from(a as i8),
            Number::Signed(2) => i16::from_le_bytes([a, b]).into(),
            Number::Signed(4) => i32::from_le_bytes([a, b, c, d]).into(),
            Number::Signed(_) => i64::from_le_bytes(ordered) as f64,
            Number::Unsigned(_) | Number::Other(_) => u64::from_le_bytes(ordered) as f64,
        }
    }
}

/// Pass over a number of values.
fn skip(bytes: &mut dyn Read, count: usize, size: usize) -> std::io::Result<()> {
    let wanted = (count as u64).saturating_mul(size as u64);
    if wanted > 0 && std::io::copy(&mut bytes.take(wanted), &mut std::io::sink())? < wanted {
        return Err(std::io::ErrorKind::UnexpectedEof.into());
    }
    Ok(())
}

/// The type of numbers that NumPy calls, for example, `<f8`.
fn numpy_type(text: &str) -> Stored {
    let other = || Stored { number: Number::Other(text.to_owned()), big_endian: false };
    let (order, code) = match text.as_bytes() {
        [order @ (b'<' | b'>' | b'|' | b'='), code @ ..] => (*order, code),
        code => (b'<', code),
    };
    let number = match code {
        b"f2" => Number::Float(2),
        b"f4" => Number::Float(4),
        b"f8" => Number::Float(8),
        b"i1" => Number::Signed(1),
        b"i2" => Number::Signed(2),
        b"i4" => Number::Signed(4),
        b"i8" => Number::Signed(8),
        b"u1" | b"b1" => Number::Unsigned(1),
        b"u2" => Number::Unsigned(2),
        b"u4" => Number::Unsigned(4),
        b"u8" => Number::Unsigned(8),
        _ => return other(),
    };
    Stored { number, big_endian: order == b'>' }
}
