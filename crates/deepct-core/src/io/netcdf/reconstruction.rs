//! The result of an inversion: the volume, its mask and the course of the iterations.

use super::Provenance;
use super::field::{AXES, put_cloud, put_mask, put_volume};
use super::light::put_light;
use super::write::{Attribute::*, Output};
use crate::cloud::Cloud;
use crate::error::Result;
use crate::grid::Mask;
use crate::inversion::{Calibration, Ending, Reconstruction, Record, StandardErrors};
use crate::scene::Observation;
use ndarray::Array1;
use std::path::Path;

/// Write a reconstruction: `extinction`, `mask` and, if the effective radius was retrieved, the
/// droplets `lwc`, `reff` and `veff` on `(z, y, x)`, of which `veff` is that of the scene
/// illumination; on the dimension `step`, the values of `block`, `seconds`, `misfit` and, if the truth
/// is known, `relative_error` and `mass_error` after each iteration; and the scene illumination of the
/// images of the first band. Standard errors are `extinction_standard_error` (km-1),
/// `lwc_standard_error` and `reff_standard_error`; calibrations are `camera_gain`, `camera_row_offset`
/// and `camera_col_offset` (pixels) on the dimension `camera`, the views of all bands. The file can be read by `read_cloud`, `read_volume` and `read_mask`. That of
/// an interrupted inversion is marked ([`incomplete`](super::incomplete)).
///
/// # Errors
/// Returns an error if the file cannot be written, or if the scene illumination has a value out of
/// range.
pub fn write_reconstruction(
    path: impl AsRef<Path>,
    reconstruction: &Reconstruction,
    mask: &Mask,
    observation: &Observation,
    provenance: &Provenance,
) -> Result<()> {
    let mut output = Output::create(path.as_ref(), provenance)?;
    let Reconstruction { extinction, effective_radius, .. } = reconstruction;
    match effective_radius {
        None => put_volume(&mut output, extinction)?,
        Some(radius) => {
            let droplets = Some(observation.light.droplets_of(extinction, radius)?);
            let cloud = Cloud::from_extinction(extinction.clone())?;
            put_cloud(&mut output, &Cloud { microphysics: droplets, ..cloud })?;
        }
    }
    if let Some(errors) = &reconstruction.standard_errors {
        put_standard_errors(&output, errors)?;
    }
    put_calibrations(&mut output, &reconstruction.calibrations)?;
    put_mask(&output, mask)?;
    put_light(&output, observation)?;
    put_history(&mut output, &reconstruction.history)?;
    if reconstruction.ending == Ending::Interrupted {
        output.mark_incomplete("the inversion was interrupted before its end")?;
    }
    output.finish()
}

fn put_standard_errors(output: &Output, errors: &StandardErrors) -> Result<()> {
    let StandardErrors { extinction, effective_radius, liquid_water_content } = errors;
    let extinction = [("extinction", "km-1", "extinction", Some(extinction))];
    let droplets = [
        ("lwc", "g m-3", "liquid water content", liquid_water_content.as_ref()),
        ("reff", "um", "effective radius", effective_radius.as_ref()),
    ];
    for (name, unit, meaning, volume) in extinction.into_iter().chain(droplets) {
        let Some(volume) = volume else { continue };
        let meaning = format!("standard error of the {meaning}");
        let attributes = [("units", Text(unit)), ("long_name", Text(&meaning))];
        output.variable(&format!("{name}_standard_error"), &AXES, &volume.values, &attributes)?;
    }
    Ok(())
}

/// Writes the calibrations of the cameras of all bands, if they were unknown.
fn put_calibrations(output: &mut Output, bands: &[Vec<Calibration>]) -> Result<()> {
    if bands.iter().flatten().all(|camera| *camera == Calibration::NOMINAL) {
        return Ok(());
    }
    let cameras: Vec<(usize, &Calibration)> =
        bands.iter().enumerate().flat_map(|(n, band)| band.iter().map(move |c| (n, c))).collect();
    output.counted("camera", cameras.len(), "cameras of all views of all bands")?;
    let column =
        |name: &str, unit: &str, meaning: &str, value: &dyn Fn(usize, &Calibration) -> f64| {
            let values: Array1<f64> =
                cameras.iter().map(|(band, camera)| value(*band, camera)).collect();
            let attributes = [("units", Text(unit)), ("long_name", Text(meaning))];
            output.variable(name, &["camera"], &values, &attributes)
        };
    column("camera_band", "1", "number of the band, from 0", &|band, _| band as f64)?;
    column("camera_gain", "1", "factor by which the radiances are too large", &|_, c| c.gain)?;
    let shown = "of the point of the model's image that a pixel shows, from the pixel";
    for (axis, name) in ["row", "col"].into_iter().enumerate() {
        let meaning = format!("distance along {name} {shown}");
        let name = format!("camera_{name}_offset");
        column(&name, "pixel", &meaning, &|_, camera| camera.offset[axis])?;
    }
    Ok(())
}

fn put_history(output: &mut Output, history: &[Record]) -> Result<()> {
    output.counted("step", history.len(), "steps of the inversion")?;
    let column = |name: &str, unit: &str, long_name: &str, value: &dyn Fn(&Record) -> f64| {
        let values: Array1<f64> = history.iter().map(value).collect();
        output.variable(
            name,
            &["step"],
            &values,
            &[("units", Text(unit)), ("long_name", Text(long_name))],
        )
    };
    column("block", "1", "edge length of the blocks of voxels, in voxels", &|at| at.block as f64)?;
    column("seconds", "s", "time since the start", &|at| at.seconds)?;
    column("misfit", "1", "mean squared ratio of residual to standard error", &|at| at.misfit)?;
    if history.iter().all(|at| at.relative_error.is_some() && at.mass_error.is_some()) {
        let missing = |value: Option<f64>| value.unwrap_or(f64::NAN);
        column("relative_error", "1", "relative error epsilon", &|at| missing(at.relative_error))?;
        column("mass_error", "1", "mass error delta", &|at| missing(at.mass_error))?;
    }
    Ok(())
}
