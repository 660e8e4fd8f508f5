//! A truth and the images of it in one file.

use super::Provenance;
use super::field::put_volume;
use super::observation::put_observation;
use super::write::Output;
use crate::error::Result;
use crate::grid::Volume;
use crate::scene::Observation;
use std::path::Path;

/// Write a sample to learn from: the variables of a volume and those of its images.
/// `read_volume` and `read_observation` read the one and the other.
///
/// # Errors
/// When the file cannot be written.
pub fn write_sample(
    path: impl AsRef<Path>,
    truth: &Volume,
    observation: &Observation,
    provenance: &Provenance,
) -> Result<()> {
    let mut output = Output::create(path.as_ref(), provenance)?;
    put_volume(&mut output, truth)?;
    put_observation(&mut output, observation)?;
    output.finish()
}
