//! A true cloud and its images in one file.

use super::Provenance;
use super::field::put_cloud;
use super::observation::put_bands;
use super::write::Output;
use crate::cloud::Cloud;
use crate::error::Result;
use crate::scene::Observation;
use std::path::Path;

/// Write a training sample: the variables of a cloud and those of its images in each of one or more
/// bands, with `radiance` on the dimension `wavelength` if there are several. The file can be read by
/// `read_cloud` and `read_observations`.
///
/// # Errors
/// Returns an error if there is no band, if the bands differ in more than the wavelength and the
/// radiances, or if the file cannot be written.
pub fn write_sample(
    path: impl AsRef<Path>,
    cloud: &Cloud,
    bands: &[Observation],
    provenance: &Provenance,
) -> Result<()> {
    let mut output = Output::create(path.as_ref(), provenance)?;
    put_cloud(&mut output, cloud)?;
    put_bands(&mut output, bands)?;
    output.finish()
}
