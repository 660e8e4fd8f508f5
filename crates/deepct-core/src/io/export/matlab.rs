//! MATLAB 5 files (`.mat`), which MATLAB, Octave and SciPy read. The format is described in
//! "MAT-File Format" (MathWorks): elements with a type and a size, aligned to eight bytes.

use super::arrays::{NamedArray, Numbers};
use crate::error::{Error, Result};
use crate::io::arrays::MATLAB_MARK;
use ndarray::ArrayD;
use std::path::Path;

/// Types of elements.
const INT8: u32 = 1;
const UINT8: u32 = 2;
const INT32: u32 = 5;
const UINT32: u32 = 6;
const SINGLE: u32 = 7;
const DOUBLE: u32 = 9;
const MATRIX: u32 = 14;
/// Classes of arrays.
const DOUBLE_CLASS: u32 = 6;
const SINGLE_CLASS: u32 = 7;
const UINT8_CLASS: u32 = 9;

/// Length of the text at the beginning of the file.
const TEXT: usize = 124;

/// Write arrays under their names; an array `[z, y, x]` has the indices `(z, y, x)`, and one with a
/// single axis is a row.
pub(super) fn write(path: &Path, arrays: &[NamedArray]) -> Result<()> {
    let mut bytes = format!("{MATLAB_MARK:TEXT$}").into_bytes();
    // The version, and the byte order: the letters of "MI" as a number.
    bytes.extend(0x0100_u16.to_le_bytes());
    bytes.extend(b"IM");
    for NamedArray { name, values } in arrays {
        let (class, shape, data) = match values {
            Numbers::Single(values) => (SINGLE_CLASS, values.shape(), numbers(SINGLE, values)),
            Numbers::Double(values) => (DOUBLE_CLASS, values.shape(), numbers(DOUBLE, values)),
            Numbers::Byte(values) => (UINT8_CLASS, values.shape(), numbers(UINT8, values)),
        };
        let shape = if let [length] = shape { &[1, *length] } else { shape };
        let mut matrix = element(UINT32, [class.to_le_bytes(), [0; 4]].as_flattened());
        let lengths: Vec<_> =
            shape.iter().flat_map(|length| (*length as i32).to_le_bytes()).collect();
        matrix.extend(element(INT32, &lengths));
        matrix.extend(element(INT8, name.as_bytes()));
        matrix.extend(data);
        if u32::try_from(matrix.len()).is_err() {
            let problem = format!("has {} bytes, and the format allows 4294967295", matrix.len());
            return Err(Error::file(path, *name, problem, "write another format, such as .npz"));
        }
        bytes.extend(element(MATRIX, &matrix));
    }
    crate::files::write(path, bytes)
}

/// An element: its type, its size and its content, filled up to a multiple of eight bytes.
fn element(kind: u32, content: &[u8]) -> Vec<u8> {
    let mut bytes: Vec<_> =
        [kind, content.len() as u32].iter().flat_map(|n| n.to_le_bytes()).collect();
    bytes.extend(content);
    bytes.resize(bytes.len().next_multiple_of(8), 0);
    bytes
}

/// The values of an array, of which the first index varies fastest.
fn numbers<T: bytemuck::NoUninit>(kind: u32, values: &ArrayD<T>) -> Vec<u8> {
    let content: Vec<u8> =
        values.t().iter().flat_map(|value| bytemuck::bytes_of(value).to_vec()).collect();
    element(kind, &content)
}
