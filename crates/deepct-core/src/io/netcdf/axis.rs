//! Coordinate variables of the axes.

use super::Variable;
use crate::error::Result;
use ndarray::ArrayD;

/// Largest relative difference between the steps of a uniform coordinate. It exceeds the rounding
/// error of 32-bit floats and is smaller than any intended stretching.
const UNIFORM: f64 = 2e-3;

/// The values of a coordinate in km.
///
/// # Errors
/// Returns an error if the values are not real numbers or if the unit is not one of length.
pub(crate) fn kilometres(axis: &Variable) -> Result<Vec<f64>> {
    let values: ArrayD<f64> = axis.reals_in("km")?;
    Ok(values.into_raw_vec_and_offset().0)
}

/// The lower edge (km) and the spacing (km) of a uniform coordinate.
pub(crate) fn edge_and_spacing(axis: &Variable) -> Result<(f64, f64)> {
    let values = kilometres(axis)?;
    let kilometre = axis.factor_to("km")?;
    let (first, last) = (values[0], values[values.len() - 1]);
    let recorded = axis.number("spacing").map(|spacing| spacing * kilometre);
    let spacing = match (values.len(), recorded) {
        (1, Some(spacing)) => spacing,
        (1, None) => {
            return Err(axis.error(
                "has a single value and no attribute `spacing`",
                "add the attribute `spacing` with the voxel's size",
            ));
        }
        (count, _) => (last - first) / (count - 1) as f64,
    };
    let uneven = values
        .windows(2)
        .map(|pair| (pair[1] - pair[0] - spacing).abs())
        .position(|error| error.is_nan() || error > UNIFORM * spacing.abs());
    if let Some(index) = uneven {
        return Err(axis.error(
            format!("is not uniform: it goes from {first} to {last} km with a break at {index}"),
            "resample the field to uniform spacing",
        ));
    }
    if spacing.is_nan() || spacing <= 0.0 {
        return Err(axis.error(
            format!("descends from {first} to {last} km"),
            "write the field so that x increases eastwards, y northwards and z upwards",
        ));
    }
    // A field that was cropped or shifted retains its attributes, so they are used only if they
    // agree with the values.
    let spacing = recorded.filter(|exact| (exact - spacing).abs() <= UNIFORM * spacing);
    let spacing = spacing.unwrap_or((last - first) / (values.len() - 1).max(1) as f64);
    let edge = first - 0.5 * spacing;
    let recorded = axis.number("lower_edge").map(|edge| edge * kilometre);
    let exact = recorded.filter(|exact| (exact - edge).abs() <= 1e-6 * spacing);
    Ok((exact.unwrap_or(edge), spacing))
}
