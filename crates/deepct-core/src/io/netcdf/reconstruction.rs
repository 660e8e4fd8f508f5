//! The result of an inversion: the volume, its mask and the course of the iterations.

use super::Provenance;
use super::field::{put_cloud, put_mask, put_volume};
use super::light::put_light;
use super::write::{Attribute::*, Output};
use crate::cloud::Cloud;
use crate::error::Result;
use crate::grid::Mask;
use crate::inversion::{Ending, Reconstruction, Record};
use crate::scene::Observation;
use ndarray::Array1;
use std::path::Path;

/// Write a reconstruction: `extinction`, `mask` and, if the effective radius was retrieved, the
/// droplets `lwc`, `reff` and `veff` on `(z, y, x)`, of which `veff` is that of the scene
/// illumination; on the dimension `step`, the values of `block`, `seconds`, `misfit` and, if the truth
/// is known, `relative_error` and `mass_error` after each iteration; and the scene illumination of the
/// images of the first band. The file can be read by `read_cloud`, `read_volume` and `read_mask`. That of
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
    put_mask(&output, mask)?;
    put_light(&output, observation)?;
    put_history(&mut output, &reconstruction.history)?;
    if reconstruction.ending == Ending::Interrupted {
        output.mark_incomplete("the inversion was interrupted before its end")?;
    }
    output.finish()
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
