//! Coordinate variables of the axes, and the faces of the cells around them.

use super::{Input, Variable};
use crate::error::Result;
use ndarray::ArrayD;

/// Largest relative difference between the steps of a uniform coordinate. It exceeds the rounding
/// error of 32-bit floats and is smaller than any intended stretching.
const UNIFORM: f64 = 2e-3;
/// Largest rounding of the values of a uniform coordinate, relative to its spacing.
const ROUNDING: f64 = 0.05;
/// Largest number of digits after the decimal point of rounded values.
const DIGITS: i32 = 6;
/// Largest number of cells by which an attribute `lower_edge` may precede a field that was cropped.
const CROPPED: f64 = 500.0;

/// The values of a coordinate in the unit of the file.
///
/// # Errors
/// Returns an error if there are none, if they are not finite numbers, or if they are depths.
pub(crate) fn coordinates(axis: &Variable) -> Result<Vec<f64>> {
    coordinates_at(axis, 0)
}

/// The values of a coordinate, which may depend on the time as its first axis, in the unit of the file.
/// Every coordinate that is read is of a position: depths would turn the cloud upside down.
///
/// # Errors
/// As [`coordinates`].
pub(crate) fn coordinates_at(axis: &Variable, time: usize) -> Result<Vec<f64>> {
    if axis.text("positive").is_some_and(|way| way.eq_ignore_ascii_case("down")) {
        return Err(axis.error(
            "increases downwards (its attribute `positive` is \"down\")",
            "give altitudes, which increase upwards: subtract the numbers from the altitude at 0",
        ));
    }
    let values: ArrayD<f64> = match axis.shape[..] {
        [times, length] => {
            let time = time.min(times.saturating_sub(1));
            axis.values_at(&[time..time + 1, 0..length], 1.0, f64::NAN)?
        }
        _ => axis.reals()?,
    };
    let values = values.into_raw_vec_and_offset().0;
    match values.iter().position(|value| !value.is_finite()) {
        None => Ok(values),
        Some(index) => Err(axis.error(
            format!("is not uniform: it is {} at {index}", values[index]),
            "write a number for every cell",
        )),
    }
}

/// The first value and the spacing of the values of a uniform coordinate with two or more values,
/// which may be rounded and may descend.
///
/// # Errors
/// Returns an error if the steps differ.
pub(crate) fn first_and_spacing(axis: &Variable, values: &[f64]) -> Result<(f64, f64)> {
    let (first, last) = (values[0], values[values.len() - 1]);
    let spacing = (last - first) / (values.len() - 1) as f64;
    let tolerance = (UNIFORM * spacing.abs()).max(rounding(values, spacing));
    let steps = values.windows(2).map(|pair| (pair[1] - pair[0] - spacing).abs());
    let uneven = steps.enumerate().find(|(index, error)| {
        let place = values[*index] - first - spacing * *index as f64;
        !(*error <= tolerance && place.abs() <= tolerance.max(UNIFORM * spacing.abs()))
    });
    match uneven {
        None => Ok((first, spacing)),
        Some((index, _)) => Err(axis.error(
            format!("is not uniform: it goes from {first} to {last} with a break at {index}"),
            "resample the field to uniform spacing",
        )),
    }
}

/// The rounding error of the steps between values that were rounded to a number of decimal digits;
/// zero if they were not.
fn rounding(values: &[f64], spacing: f64) -> f64 {
    let is_rounded = |digits: &i32| {
        let scale = 10_f64.powi(*digits);
        values.iter().all(|value| {
            let scaled = value * scale;
            (scaled - scaled.round()).abs() <= 1e-6 * scaled.abs().max(1.0)
        })
    };
    let unit = (0..=DIGITS).find(is_rounded).map_or(0.0, |digits| 10_f64.powi(-digits));
    if unit <= ROUNDING * spacing.abs() { 1.001 * unit } else { 0.0 }
}

/// The faces of the cells of a coordinate according to its CF attribute `bounds`, one more than
/// cells, in the unit and order of the coordinate; `None` if it has no bounds.
///
/// # Errors
/// Returns an error if the bounds leave gaps, overlap or do not enclose the coordinate.
pub(crate) fn bounds(input: &Input, axis: &Variable, values: &[f64]) -> Result<Option<Vec<f64>>> {
    let Some(name) = axis.text("bounds") else { return Ok(None) };
    let group = axis.name.rsplit_once('/').map_or(String::new(), |(group, _)| format!("{group}/"));
    let path = Some(format!("{group}{name}")).filter(|path| input.has(path)).unwrap_or(name);
    // A program that drops variables may leave the attribute behind.
    if !input.has(&path) {
        return Ok(None);
    }
    let variable = input.variable(&path)?;
    let remedy = format!("correct {path}, or remove the attribute `bounds` of {}", axis.name);
    if variable.shape != [values.len(), 2] {
        let problem = format!("has shape {:?}, not ({}, 2)", variable.shape, values.len());
        return Err(variable.error(problem, &remedy));
    }
    // Bounds without units have those of the coordinate.
    let factor = match (variable.unit_text(), axis.unit_text()) {
        (Some(_), Some(_)) => variable.factor_to("km")? / axis.factor_to("km")?,
        _ => 1.0,
    };
    let pairs = variable.reals::<f64>()?.into_raw_vec_and_offset().0;
    let descends = values.len() > 1 && values[0] > values[1];
    let cells: Vec<_> = pairs
        .chunks_exact(2)
        .map(|pair| {
            let (low, high) = (factor * pair[0].min(pair[1]), factor * pair[0].max(pair[1]));
            if descends { (high, low) } else { (low, high) }
        })
        .collect();
    for (index, (&(start, end), value)) in cells.iter().zip(values).enumerate() {
        let slack = 1e-3 * (end - start).abs();
        let inside = *value >= start.min(end) - slack && *value <= start.max(end) + slack;
        if !inside || start == end {
            let problem =
                format!("are {start} and {end} at {index}, but {} is {value} there", axis.name);
            return Err(variable.error(problem, &remedy));
        }
        let next = cells.get(index + 1).map_or(end, |next| next.0);
        if (next - end).abs() > slack || !next.is_finite() {
            let problem = format!("leave a gap or overlap after {index}: {end} and {next}");
            return Err(variable.error(problem, &remedy));
        }
    }
    let mut faces: Vec<_> = cells.iter().map(|cell| cell.0).collect();
    faces.extend(cells.last().map(|cell| cell.1));
    Ok(Some(faces))
}

/// The lower edge (km) and the spacing (km) of a uniform coordinate in deepct's own layout.
///
/// They follow from its values if there are several; bounds and the attributes `lower_edge` and
/// `spacing` make them exact where they agree, since a field that was cropped or shifted may have kept
/// those of the field before. Nothing but bounds and attributes states the size of a single cell,
/// so they must agree.
///
/// # Errors
/// Returns an error if the coordinate does not ascend uniformly, or if the size of a single cell is
/// unknown or contradictory.
pub(crate) fn edge_and_spacing(input: &Input, axis: &Variable) -> Result<(f64, f64)> {
    let kilometre = axis.factor_to("km")?;
    let values = coordinates(axis)?;
    let (edge, spacing) = match values.as_slice() {
        [value] => single_cell(input, axis, *value)?,
        _ => {
            let (first, spacing) = first_and_spacing(axis, &values)?;
            if spacing <= 0.0 {
                return Err(axis.error(
                    format!("descends from {first} to {}", values[values.len() - 1]),
                    "write the field so that x increases eastwards, y northwards and z upwards",
                ));
            }
            let faces = bounds(input, axis, &values).ok().flatten();
            let agree = |faces: &Vec<f64>| {
                let tolerance = (UNIFORM * spacing).max(rounding(&values, spacing));
                let mut cells = faces.windows(2);
                cells.all(|face| (face[1] - face[0] - spacing).abs() <= tolerance)
            };
            let recorded = axis.number("spacing");
            let recorded = recorded.filter(|exact| (exact - spacing).abs() <= UNIFORM * spacing);
            let spacing = recorded.unwrap_or(spacing);
            let edge = faces.filter(agree).map_or(first - 0.5 * spacing, |faces| faces[0]);
            (edge, spacing)
        }
    };
    let recorded = axis.number("lower_edge");
    let recorded = recorded.filter(|exact| (exact - edge).abs() <= 1e-6 * spacing);
    Ok((kilometre * recorded.unwrap_or(edge), kilometre * spacing))
}

/// The lower edge and the size of a single cell, in the unit of its coordinate.
fn single_cell(input: &Input, axis: &Variable, value: f64) -> Result<(f64, f64)> {
    let recorded = axis.number("spacing");
    let (edge, size) = match (bounds(input, axis, &[value])?, recorded) {
        (Some(faces), _) => (faces[0], faces[1] - faces[0]),
        (None, Some(size)) => (value - 0.5 * size, size),
        (None, None) => {
            return Err(axis.error(
                "has a single value, no bounds and no attribute `spacing`",
                "add the attribute `spacing` with the voxel's size",
            ));
        }
    };
    let contradiction = |name: &str, recorded: f64, found: String| {
        let remedy = "a field that was averaged or converted may have kept the attributes of the one \
                      before: correct or remove `spacing`, `lower_edge` and `bounds`";
        Err(axis.error(format!("has the attribute `{name}` = {recorded}, but {found}"), remedy))
    };
    if !(size > 0.0 && size.is_finite()) {
        return Err(
            axis.error(format!("has a cell of size {size}"), "correct the attribute `spacing`")
        );
    }
    if let Some(recorded) = recorded.filter(|recorded| (recorded - size).abs() > UNIFORM * size) {
        return contradiction("spacing", recorded, format!("its cell is {size} wide"));
    }
    // A cell that was cut out of a field may keep the lower edge of the field, a number of cells below.
    if let Some(recorded) = axis.number("lower_edge") {
        let cells = (edge - recorded) / size;
        if (cells - cells.round()).abs() > 1e-3 || !(-1e-3..CROPPED).contains(&cells) {
            return contradiction("lower_edge", recorded, format!("its cell begins at {edge}"));
        }
    }
    Ok((edge, size))
}
