//! Verification of a data set.

use super::Manifest;
use crate::error::{Error, Result};
use crate::files::sha256;
use crate::io;
use std::path::Path;

/// Read every sample of a data set and compare it with the manifest. `progress` is called once per
/// sample. Returns the manifest.
///
/// # Errors
/// Returns an error for the first sample that is missing, has been modified, or has another shape.
pub fn check(folder: &Path, progress: &(dyn Fn(u64) + Sync)) -> Result<Manifest> {
    let manifest = Manifest::read(folder)?;
    let remedy = "delete the file and run `deepct dataset generate` again";
    for sample in &manifest.samples {
        let path = folder.join(&sample.file);
        if sha256(&path)? != sample.sha256 {
            return Err(Error::file(path, "checksum", "differs from the manifest's", remedy));
        }
        let volume = io::read_volume(&path)?;
        let bands = io::read_observations(&path)?;
        let [rows, cols] = manifest.image_shape;
        let images = [manifest.geometry.view_zenith_deg.len(), rows, cols];
        if volume.grid.shape[0] != manifest.levels.count
            || bands.len() != manifest.configuration.bands.len().max(1)
            || bands.iter().any(|band| band.images.shape() != images)
        {
            return Err(Error::file(path, "shape", "differs from the manifest's", remedy));
        }
        progress(1);
    }
    Ok(manifest)
}
