//! The state of an inversion, from which it can be resumed.

use super::Record;
use super::optimiser::{Pair, Point};

/// The state of an inversion after an iteration.
#[derive(Debug, Clone, PartialEq)]
pub struct Checkpoint {
    /// Index of the stage, from 0: the grids from coarse to fine, then the corrections.
    pub stage: usize,
    /// Number of iterations in that stage.
    pub iteration: usize,
    /// The point for which the model was created.
    pub began_at: Vec<f64>,
    /// The point at which the second derivatives were estimated.
    pub probed_at: Vec<f64>,
    /// The current point of the optimiser.
    pub point: Point,
    /// The steps stored by the optimiser, the oldest first.
    pub pairs: Vec<Pair>,
    /// The offsets of the views of each band for which the model was created.
    pub offsets: Vec<Vec<[f64; 2]>>,
    /// The record of each iteration.
    pub history: Vec<Record>,
}
