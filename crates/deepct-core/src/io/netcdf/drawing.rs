//! What a picture of a file shows: a volume or images.

use super::{read_cloud, read_light, read_observation};
use crate::error::{Error, Result};
use crate::grid::Volume;
use crate::scene::{Light, Observation};
use std::path::Path;

/// The contents of a file that can be drawn.
#[derive(Debug, Clone, PartialEq)]
pub enum Drawing {
    /// The extinction of a cloud or a volume.
    Volume(Volume),
    /// Images.
    Images(Box<Observation>),
}

/// Read a volume, or else images, and the scene illumination in the file, by default that of
/// [`Light::default`], in which the extinction of droplets is computed.
///
/// # Errors
/// If the file is neither, the error of the kind that it resembles is returned: that of images if it
/// has a radiance variable, otherwise that of a volume.
pub fn read_drawing(path: impl AsRef<Path>) -> Result<(Drawing, Light)> {
    let path = path.as_ref();
    let light = read_light(path)?.map_or_else(Light::default, |(light, _)| light);
    let problem = match read_extinction(path, &light) {
        Ok(volume) => return Ok((Drawing::Volume(volume), light)),
        Err(problem) => problem,
    };
    match read_observation(path) {
        Ok(observation) => Ok((Drawing::Images(Box::new(observation)), light)),
        Err(Error::File { field, problem: missing, .. })
            if field == "radiance" && missing == "is missing" =>
        {
            Err(problem)
        }
        Err(of_images) => Err(of_images),
    }
}

/// Read the extinction of a cloud or a volume with the given scene illumination.
///
/// # Errors
/// As [`read_cloud`] and [`Light::extinction`].
pub fn read_extinction(path: impl AsRef<Path>, light: &Light) -> Result<Volume> {
    let path = path.as_ref();
    light.extinction(&read_cloud(path)?).map_err(Error::in_file(path))
}
