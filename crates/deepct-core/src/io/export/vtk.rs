//! VTK image data (`.vti`): XML with the values appended in binary form, for ParaView and VTK.

use super::Fields;
use crate::error::{Error, Result};
use crate::io::arrays::MARK;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

/// Write fields as cell data; each cell is a voxel, and lengths are in km.
pub(super) fn write(path: &Path, fields: &Fields) -> Result<()> {
    let output = crate::files::Output::create(path)?;
    let file = std::fs::File::create(output.temporary()).map_err(Error::io(path))?;
    let mut file = std::io::BufWriter::new(file);
    let mut put = |bytes: &[u8]| file.write_all(bytes).map_err(Error::io(path));
    put(header(fields).as_bytes())?;
    for field in fields.iter() {
        put(&bytes_of(fields).to_le_bytes())?;
        // x varies fastest, as in the arrays.
        for value in &field.values {
            put(&value.to_le_bytes())?;
        }
    }
    put(b"\n</AppendedData>\n</VTKFile>\n")?;
    file.into_inner().map_err(|problem| Error::io(path)(problem.into_error()))?;
    output.finish()
}

/// Size of the values of a field in bytes.
fn bytes_of(fields: &Fields) -> u64 {
    4 * fields.grid().len() as u64
}

/// Everything before the values: an array begins where the one before it and its size end.
fn header(fields: &Fields) -> String {
    let grid = fields.grid();
    let [nz, ny, nx] = grid.shape;
    let extent = format!("0 {nx} 0 {ny} 0 {nz}");
    let (origin, spacing) = (grid.origin, grid.spacing);
    let mut arrays = String::new();
    for (number, field) in fields.iter().enumerate() {
        let offset = number as u64 * (8 + bytes_of(fields));
        let name = field.name;
        writeln!(
            arrays,
            r#"<DataArray type="Float32" Name="{name}" format="appended" offset="{offset}"/>"#
        )
        .expect("text");
    }
    let first = fields.iter().next().map_or("", |field| field.name);
    format!(
        r#"<?xml version="1.0"?>
<!-- {MARK} -->
<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" header_type="UInt64">
<ImageData WholeExtent="{extent}" Origin="{} {} {}" Spacing="{} {} {}">
<Piece Extent="{extent}">
<CellData Scalars="{first}">
{arrays}</CellData>
</Piece>
</ImageData>
<AppendedData encoding="raw">
_"#,
        origin.x, origin.y, origin.z, spacing.x, spacing.y, spacing.z
    )
}
