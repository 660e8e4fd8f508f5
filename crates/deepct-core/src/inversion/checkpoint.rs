//! Where an inversion stands, so that it can go on from there.

use super::Record;
use super::optimiser::{Pair, Point};

/// Where an inversion stands after a step.
#[derive(Debug, Clone, PartialEq)]
pub struct Checkpoint {
    /// Side of the blocks of voxels that are being solved for; 1 on the grid itself.
    pub block: usize,
    /// Steps taken on that grid.
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
