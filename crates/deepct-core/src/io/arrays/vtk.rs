//! VTK image data (`.vti`) with one value per cell and values that are appended in binary form without
//! compression, as [`crate::io::export`] writes it.

use super::{Array, Arrays, MARK, Number, Stored};
use crate::error::{Error, Result};
use std::fs::File;
use std::io::Read;

/// Largest size of what precedes the values (bytes).
const LONGEST_HEADER: u64 = 1 << 20;

/// List the arrays of the cells.
pub(super) fn list(arrays: &mut Arrays) -> Result<()> {
    let path = arrays.path.clone();
    let file = File::open(&path).map_err(Error::io(&path))?;
    let bytes = file.metadata().map_err(Error::io(&path))?.len();
    let mut start = Vec::new();
    file.take(LONGEST_HEADER).read_to_end(&mut start).map_err(Error::io(&path))?;
    let appended = b"<AppendedData encoding=\"raw\">";
    let at = start.windows(appended.len()).position(|window| window == appended);
    let values = at.and_then(|at| {
        let first = start[at..].iter().position(|byte| *byte == b'_')?;
        Some((at, at + first + 1))
    });
    let simple = "write it with vtkXMLImageDataWriter, SetDataModeToAppended(), EncodeAppendedDataOff() and \
                  SetCompressorTypeToNone()";
    let Some((end, first)) = values else {
        let problem = "has values that are not appended in raw form, which are not read";
        return Err(arrays.error("file", problem, simple));
    };
    let header = String::from_utf8_lossy(&start[..end]).into_owned();
    let tag =
        |name: &str| tags(&header, name).next().ok_or_else(|| arrays.damaged(format!("no {name}")));
    let whole = tag("VTKFile")?;
    if attribute(whole, "compressor").is_some() {
        return Err(arrays.error("file", "has compressed values, which are not read", simple));
    }
    let image = tag("ImageData")?;
    let Some(extent) = numbers::<6>(image, "WholeExtent") else {
        return Err(arrays.damaged("it has no extent"));
    };
    let pieces: Vec<_> = tags(&header, "Piece").collect();
    let is_whole = matches!(pieces[..], [piece] if numbers::<6>(piece, "Extent") == Some(extent));
    let is_turned = numbers(image, "Direction")
        .is_some_and(|axes| axes != [1., 0., 0., 0., 1., 0., 0., 0., 1.]);
    if !is_whole || is_turned {
        let problem = "has several pieces, or axes that are turned";
        return Err(arrays.error("file", problem, "write one piece along x, y and z"));
    }
    let sizes = [0, 1, 2].map(|axis| extent[2 * axis + 1] - extent[2 * axis]);
    if !sizes.iter().all(|size| (1.0..1e9).contains(size)) {
        let problem = format!("has the extent {extent:?}, which is not a volume of cells");
        return Err(arrays.error("file", problem, simple));
    }
    let [nx, ny, nz] = sizes.map(|size| size as usize);
    let shape = [nz, ny, nx];
    let origin = numbers(image, "Origin").unwrap_or([0.0; 3]);
    let spacing = numbers(image, "Spacing").unwrap_or([1.0; 3]);
    let corner = [0, 1, 2].map(|axis| origin[axis] + spacing[axis] * extent[2 * axis]);
    let big_endian = attribute(whole, "byte_order") == Some("BigEndian");
    let size_of_length = if attribute(whole, "header_type") == Some("UInt64") { 8 } else { 4 };
    let cells = header.split_once("<CellData").and_then(|(_, rest)| rest.split_once("</CellData>"));
    for field in tags(cells.map_or("", |(inside, _)| inside), "DataArray") {
        let offset = attribute(field, "offset").and_then(|offset| offset.parse::<u64>().ok());
        let (Some(name), Some(offset)) = (attribute(field, "Name"), offset) else { continue };
        if attribute(field, "NumberOfComponents").is_some_and(|count| count != "1") {
            continue;
        }
        let kind = attribute(field, "type").unwrap_or_default();
        let number = match kind {
            "Float32" => Number::Float(4),
            "Float64" => Number::Float(8),
            "UInt8" => Number::Unsigned(1),
            _ => Number::Other(kind.to_owned()),
        };
        let stored = Stored { number, big_endian };
        let begin =
            (first as u64).checked_add(offset).and_then(|at| at.checked_add(size_of_length));
        let end = begin.and_then(|begin| begin.checked_add(stored.size_of(&shape)?));
        let (Some(begin), true) = (begin, end.is_some_and(|end| end <= bytes)) else {
            let problem =
                format!("{name} has {nx} x {ny} x {nz} values, but the file has {bytes} bytes");
            return Err(arrays.damaged(problem));
        };
        let name = name.to_owned();
        arrays.insert(&name, Array::in_file(shape.to_vec(), stored, &path, begin))?;
    }
    if arrays.by_name.is_empty() {
        let problem = "has no numbers on its cells (CellData)";
        return Err(arrays.error(
            "file",
            problem,
            "convert values at points with vtkPointDataToCellData",
        ));
    }
    if header.contains(MARK) {
        arrays.insert(super::CORNER, Array::of_values(vec![3], &corner))?;
        arrays.insert(super::SPACING, Array::of_values(vec![3], &spacing))?;
        return arrays.as_own();
    }
    arrays.put_on_grid(corner, spacing, shape, None)
}

/// The tags of a name in a text of XML, from the name to their end.
fn tags<'a>(text: &'a str, name: &str) -> impl Iterator<Item = &'a str> {
    let start = format!("<{name}");
    text.match_indices(&start)
        .map(|(at, start)| &text[at + start.len()..])
        .filter(|rest| rest.starts_with(|letter: char| letter.is_whitespace() || letter == '>'))
        .map(|rest| rest.split('>').next().unwrap_or_default())
        .collect::<Vec<_>>()
        .into_iter()
}

/// The value of an attribute of a tag.
fn attribute<'a>(tag: &'a str, name: &str) -> Option<&'a str> {
    let (_, rest) = tag.split_once(&format!(" {name}=\""))?;
    rest.split_once('"').map(|(value, _)| value)
}

/// The numbers in an attribute of a tag.
fn numbers<const N: usize>(tag: &str, name: &str) -> Option<[f64; N]> {
    let numbers: Option<Vec<f64>> =
        attribute(tag, name)?.split_whitespace().map(|number| number.parse().ok()).collect();
    numbers?.try_into().ok()
}
