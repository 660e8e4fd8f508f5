//! What is asked, and where the search begins.

use crate::grid::{Mask, Volume};
use crate::network::Estimate;
use crate::scene::Observation;

/// What is asked: the cloud of an observation, inside a mask.
#[derive(Debug, Clone, Copy)]
pub struct Problem<'a> {
    /// The images.
    pub observation: &'a Observation,
    /// Where the cloud may be, and the grid of the answer.
    pub mask: &'a Mask,
    /// The truth on the same grid, if the history shall tell how far each step is from it.
    pub truth: Option<&'a Volume>,
}

/// Where an inversion starts.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Start {
    /// The same extinction (1/km) everywhere in the mask.
    Constant(f64),
    /// The same extinction everywhere, the one that fits the images best.
    Search,
    /// An extinction on the grid of the mask, from a file or a network; how far off it is
    /// expected to be, if that is told, is part of the prior.
    Estimate(Box<Estimate>),
}

impl From<Estimate> for Start {
    fn from(estimate: Estimate) -> Self {
        Self::Estimate(Box::new(estimate))
    }
}
