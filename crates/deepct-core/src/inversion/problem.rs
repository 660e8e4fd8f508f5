//! The problem that an inversion solves, and its start.

use crate::grid::{Mask, Volume};
use crate::network::Estimate;
use crate::scene::Observation;

/// The problem: the extinction of the cloud of an observation, inside a mask.
#[derive(Debug, Clone, Copy)]
pub struct Problem<'a> {
    /// The images and their geometry.
    pub observation: &'a Observation,
    /// The voxels that may contain cloud, and the grid of the solution.
    pub mask: &'a Mask,
    /// The truth on the same grid, if the history is to contain the error of each iteration.
    pub truth: Option<&'a Volume>,
}

/// The start of an inversion.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Start {
    /// A uniform extinction (1/km) in the mask.
    Constant(f64),
    /// A uniform extinction in the mask, with the value that fits the images best.
    Search,
    /// An extinction on the grid of the mask, from a file or a network. Its uncertainty, if given,
    /// is part of the prior.
    Estimate(Box<Estimate>),
}

impl From<Estimate> for Start {
    fn from(estimate: Estimate) -> Self {
        Self::Estimate(Box::new(estimate))
    }
}
