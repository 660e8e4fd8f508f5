//! What a picture of a file shows: fields on a grid, or images.

use super::{Content, read_cloud, read_content, read_light, read_mask};
use crate::cloud::Cloud;
use crate::error::{Error, Result};
use crate::grid::{Grid, Mask, Volume};
use crate::network::Estimate;
use crate::scene::{Light, Observation};
use std::path::Path;

/// The contents of a file that can be drawn.
#[derive(Debug, Clone, PartialEq)]
pub enum Drawing {
    /// The extinction of a cloud or a volume, a mask, or both.
    Field(Box<Field>),
    /// Images.
    Images(Box<Observation>),
}

/// What is known in the voxels of a grid: an extinction, a mask, or both.
#[derive(Debug, Clone, PartialEq)]
pub struct Field {
    /// The extinction and its uncertainty.
    pub estimate: Option<Estimate>,
    /// The voxels that may contain cloud, on the grid of the extinction.
    pub mask: Option<Mask>,
    /// Whether it is a cloud that is given by its droplets.
    pub has_droplets: bool,
}

impl Field {
    /// The grid of the voxels.
    ///
    /// # Panics
    /// If there is neither an extinction nor a mask.
    pub fn grid(&self) -> &Grid {
        let estimate = self.estimate.as_ref().map(|estimate| &estimate.extinction.grid);
        let mask = || self.mask.as_ref().map(|mask| &mask.grid);
        estimate.or_else(mask).expect("a field has an extinction or a mask")
    }
}

impl From<Estimate> for Field {
    fn from(estimate: Estimate) -> Self {
        Self { estimate: Some(estimate), mask: None, has_droplets: false }
    }
}

/// Read fields, or else images, and the scene illumination that the file states. `otherwise` is used for
/// the extinction of droplets where it states none.
///
/// # Errors
/// If the file is neither, the error of the kind that it resembles is returned: that of images if it
/// has a radiance variable, otherwise that of a volume.
pub fn read_drawing(path: impl AsRef<Path>, otherwise: &Light) -> Result<(Drawing, Option<Light>)> {
    let path = path.as_ref();
    let stated = read_light(path)?.map(|(light, _)| light);
    let light = stated.as_ref().unwrap_or(otherwise);
    let of_cloud = |cloud: Cloud| {
        let extinction = light.extinction(&cloud).map_err(Error::in_file(path))?;
        let has_droplets = cloud.microphysics.is_some();
        Ok(Field { has_droplets, ..with_mask(path, extinction.into()) })
    };
    let field = match read_content(path)? {
        // A sample of a data set has both.
        Some(Content::Images(observation)) => match read_cloud(path) {
            Ok(cloud) => of_cloud(cloud)?,
            Err(_) => return Ok((Drawing::Images(observation), stated)),
        },
        Some(Content::Mask(mask)) => {
            Field { estimate: None, mask: Some(mask), has_droplets: false }
        }
        Some(Content::Estimate(estimate)) => with_mask(path, estimate),
        Some(Content::Cloud(cloud)) => of_cloud(cloud)?,
        // The reader of volumes tells what is wrong.
        None => Field::from(Estimate::from(read_extinction(path, light)?)),
    };
    Ok((Drawing::Field(Box::new(field)), stated))
}

/// An estimate and the mask in the same file, if it has one.
fn with_mask(path: &Path, estimate: Estimate) -> Field {
    let mask = read_mask(path).ok().filter(|mask| mask.grid.matches(&estimate.extinction.grid));
    Field { mask, ..Field::from(estimate) }
}

/// Read the extinction of a cloud or a volume with the given scene illumination.
///
/// # Errors
/// As [`read_cloud`] and [`Light::extinction`].
pub fn read_extinction(path: impl AsRef<Path>, light: &Light) -> Result<Volume> {
    let path = path.as_ref();
    light.extinction(&read_cloud(path)?).map_err(Error::in_file(path))
}
