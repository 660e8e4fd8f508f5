//! What a file of deepct contains.

use super::{Input, read_cloud, read_estimate, read_mask, read_observation};
use crate::cloud::Cloud;
use crate::error::Result;
use crate::grid::Mask;
use crate::network::Estimate;
use crate::scene::Observation;
use std::path::Path;

/// The content of a file of deepct.
#[derive(Debug, Clone)]
pub enum Content {
    /// A cloud, given by its droplets, its extinction or both.
    Cloud(Cloud),
    /// The estimate of a network: an extinction with its uncertainty.
    Estimate(Estimate),
    /// A mask.
    Mask(Mask),
    /// Images.
    Images(Box<Observation>),
}

/// Read a file of deepct, whatever it contains: images if it has `radiance` (also if it has a cloud, as
/// the samples of a data set do), a mask if it has `mask` and no extinction, an estimate if it has
/// `uncertainty`, and otherwise a cloud. `None` if the file is of another program:
/// [`crate::io::import`] may read it.
///
/// # Errors
/// As the function for this content, except for that of a cloud.
pub fn read_content(path: impl AsRef<Path>) -> Result<Option<Content>> {
    let path = path.as_ref();
    let Ok(input) = Input::open(path) else { return Ok(None) };
    // An import has to say what is assumed of other arrays.
    if input.is_exported() == Some(false) {
        return Ok(None);
    }
    let content = if input.has("radiance") {
        Content::Images(Box::new(read_observation(path)?))
    } else if input.has("mask") && !input.has("extinction") {
        Content::Mask(read_mask(path)?)
    } else if input.has("uncertainty") {
        Content::Estimate(read_estimate(path)?)
    } else {
        return Ok(read_cloud(path).ok().map(Content::Cloud));
    };
    Ok(Some(content))
}
