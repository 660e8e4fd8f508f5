//! A true cloud and its images in one file.

use super::Provenance;
use super::field::put_cloud;
use super::observation::put_observation;
use super::write::Output;
use crate::cloud::Cloud;
use crate::error::Result;
use crate::scene::Observation;
use std::path::Path;

/// Write a training sample: the variables of a cloud and those of its images. The file can be
/// read by `read_cloud` and `read_observation`.
///
/// # Errors
/// Returns an error if the file cannot be written.
pub fn write_sample(
    path: impl AsRef<Path>,
    cloud: &Cloud,
    observation: &Observation,
    provenance: &Provenance,
) -> Result<()> {
    let mut output = Output::create(path.as_ref(), provenance)?;
    put_cloud(&mut output, cloud)?;
    put_observation(&mut output, observation)?;
    output.finish()
}
