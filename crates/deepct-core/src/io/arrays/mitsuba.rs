//! Grid volumes of Mitsuba (`.vol`, version 3): 32-bit floats on the cells of a box.

use super::{Array, Arrays, Number, Stored};
use crate::error::{Error, Result};
use std::fs::File;
use std::io::Read;

/// Size of the header (bytes).
const HEADER: usize = 48;
/// Number of the type of values: 32-bit floats.
const FLOAT32: i32 = 1;

/// List the values, which are taken for the extinction.
pub(super) fn list(arrays: &mut Arrays) -> Result<()> {
    let path = arrays.path.clone();
    let mut file = File::open(&path).map_err(Error::io(&path))?;
    let bytes = file.metadata().map_err(Error::io(&path))?.len();
    let mut header = [0; HEADER];
    file.read_exact(&mut header).map_err(|_| arrays.damaged("it ends in its header"))?;
    if header[3] != 3 {
        let problem = format!("is a volume of version {}, and version 3 is read", header[3]);
        return Err(arrays.error("file", problem, "write it with mitsuba.VolumeGrid"));
    }
    let (numbers, _) = header[4..].as_chunks::<4>();
    let [kind, nx, ny, nz, channels] = [0, 1, 2, 3, 4].map(|at| i32::from_le_bytes(numbers[at]));
    if (kind, channels) != (FLOAT32, 1) {
        let problem = format!("has {channels} channels of the type {kind}");
        return Err(arrays.error("file", problem, "write one channel of 32-bit floats (type 1)"));
    }
    let shape = [nz, ny, nx].map(|length| usize::try_from(length).unwrap_or(0));
    let stored = Stored { number: Number::Float(4), big_endian: false };
    if stored.size_of(&shape).is_none_or(|size| size == 0 || size > bytes - HEADER as u64) {
        let problem = format!("it declares {nx} x {ny} x {nz} values, but has {bytes} bytes");
        return Err(arrays.damaged(problem));
    }
    // Of the numbers that round to a corner, the shortest one is meant.
    let corner = |at: usize| -> f64 {
        f32::from_le_bytes(numbers[at]).to_string().parse().unwrap_or(f64::NAN)
    };
    let lower = [5, 6, 7].map(corner);
    let upper = [8, 9, 10].map(corner);
    let lengths = [nx, ny, nz];
    let spacing = [0, 1, 2].map(|axis| {
        let step = (upper[axis] - lower[axis]) / f64::from(lengths[axis]);
        // The digits that a 32-bit corner determines.
        format!("{step:.6e}").parse().unwrap_or(f64::NAN)
    });
    let values = Array::in_file(shape.to_vec(), stored, &path, HEADER as u64);
    arrays.insert("extinction", Array { units: Some("km-1"), ..values })?;
    arrays.assumption = Some(
        "the format states no units; the numbers are taken to be the extinction in km-1 in a box in km, as \
         `deepct convert` writes them (--units extinction=\"...\" states others)",
    );
    // Mitsuba writes the unit cube where nobody states a box.
    if (lower, upper) == ([0.0; 3], [1.0; 3]) {
        return Ok(());
    }
    arrays.put_on_grid(lower, spacing, shape, Some("km"))
}
