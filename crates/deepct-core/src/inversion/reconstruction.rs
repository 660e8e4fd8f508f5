//! What an inversion came to, step by step.

use super::Checkpoint;
use crate::error::Result;
use crate::grid::Volume;
use serde::{Deserialize, Serialize};

/// One step of an inversion.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Number of the stage, from 0: grid after grid, then correction after correction.
    pub stage: usize,
    /// Side of the blocks of voxels that were solved for; 1 on the grid itself.
    pub block: usize,
    /// Number of the step in that stage; 0 is its start.
    pub iteration: usize,
    /// Time since the beginning (s).
    pub seconds: f64,
    /// Mean over all pixels of the squared residual over its standard error.
    pub misfit: f64,
    /// What is minimised.
    pub value: f64,
    /// Times that images were computed in that stage.
    pub evaluations: usize,
    /// Relative error epsilon, where the truth is known.
    pub relative_error: Option<f64>,
    /// Relative error of the total extinction delta, where the truth is known.
    pub mass_error: Option<f64>,
}

/// Why an inversion ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Ending {
    /// The misfit is what the noise explains.
    Noise,
    /// All steps were taken.
    Iterations,
    /// Steps did not lower the value any more.
    Stalled,
    /// The watch stopped it.
    Interrupted,
}

impl Ending {
    /// Why the inversion ended, in words.
    pub fn description(self) -> &'static str {
        match self {
            Self::Noise => "the noise explains the rest",
            Self::Iterations => "all steps taken",
            Self::Stalled => "no step lowers the value any more",
            Self::Interrupted => "stopped",
        }
    }
}

/// What an inversion came to.
#[derive(Debug, Clone, PartialEq)]
pub struct Reconstruction {
    /// The extinction (1/km), 0 outside the mask.
    pub extinction: Volume,
    /// What was reached, step by step.
    pub history: Vec<Record>,
    /// Why it ended.
    pub ending: Ending,
}

/// Whoever waits for an inversion; `()` does so without a word.
pub trait Watch {
    /// Called after each step.
    fn reached(&self, _record: &Record) {}

    /// Called after each step with what is needed to go on from there.
    ///
    /// # Errors
    /// Where it cannot be kept; the inversion then ends with this error.
    fn keep(&self, _checkpoint: &Checkpoint) -> Result<()> {
        Ok(())
    }

    /// Whether to stop and give what is there. Asked before each step.
    fn interrupted(&self) -> bool {
        false
    }
}

impl Watch for () {}
