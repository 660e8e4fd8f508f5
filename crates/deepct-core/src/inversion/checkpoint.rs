//! Where an inversion stands, so that it can go on from there.

use super::Record;
use super::optimiser::{Pair, Point};

/// Where an inversion stands after a step.
#[derive(Debug, Clone, PartialEq)]
pub struct Checkpoint {
    /// Number of the stage, from 0: grid after grid, then correction after correction.
    pub stage: usize,
    /// Steps taken in that stage.
    pub iteration: usize,
    /// The point where the second derivatives were looked for.
    pub probed_at: Vec<f64>,
    /// The point of the optimiser.
    pub point: Point,
    /// The steps that the optimiser remembers, the oldest first.
    pub pairs: Vec<Pair>,
    /// What was reached, step by step.
    pub history: Vec<Record>,
}
