//! Grid volumes of Mitsuba 3 (`.vol`, version 3).

use super::Fields;
use crate::error::{Error, Result};
use std::path::Path;

/// Number of the type of values: 32-bit floats.
const FLOAT32: i32 = 1;

/// Write the extinction (1/km). The bounding box is that of the grid (km).
pub(super) fn write(path: &Path, fields: &Fields) -> Result<()> {
    let extinction = fields.extinction().map_err(Error::in_file(path))?;
    let grid = fields.grid();
    let mut bytes = b"VOL\x03".to_vec();
    let [nz, ny, nx] = grid.shape;
    for number in [nx, ny, nz] {
        let number = i32::try_from(number).map_err(|_| {
            Error::file(path, "shape", format!("has {number} voxels along an axis"), "crop it")
        });
        bytes.extend(number?.to_le_bytes());
    }
    // The type comes before the shape, and the number of channels after it.
    bytes.splice(4..4, FLOAT32.to_le_bytes());
    bytes.extend(1_i32.to_le_bytes());
    let corners = [grid.lower(), grid.upper()].map(|corner| corner.as_vec3().to_array());
    // x varies fastest, as in the array.
    for value in corners.iter().flatten().chain(extinction) {
        bytes.extend(value.to_le_bytes());
    }
    crate::files::write(path, bytes)
}
