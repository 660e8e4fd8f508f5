//! The result of an inversion and the record of its iterations.

use super::Checkpoint;
use crate::error::Result;
use crate::grid::Volume;
use serde::{Deserialize, Serialize};

/// One iteration of an inversion.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Index of the stage, from 0: the grids from coarse to fine, then the corrections.
    pub stage: usize,
    /// Side length (voxels) of the blocks that are solved for; 1 on the full-resolution grid.
    pub block: usize,
    /// Number of the iteration in that stage; 0 is the start of the stage.
    pub iteration: usize,
    /// Time since the start of the inversion (s).
    pub seconds: f64,
    /// Mean over all pixels of the squared ratio of the residual to its standard error.
    pub misfit: f64,
    /// Value of the objective function.
    pub value: f64,
    /// Number of evaluations of the forward model in that stage.
    pub evaluations: usize,
    /// Relative error epsilon, if the truth is known.
    pub relative_error: Option<f64>,
    /// Relative error of the total extinction delta, if the truth is known.
    pub mass_error: Option<f64>,
}

/// The reason why an inversion ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Ending {
    /// The misfit reached the level explained by the noise.
    Noise,
    /// The maximum number of iterations was reached.
    Iterations,
    /// The iterations no longer reduced the objective function.
    Stalled,
    /// The progress callback interrupted the inversion.
    Interrupted,
}

impl Ending {
    /// A description of the reason why the inversion ended.
    pub fn description(self) -> &'static str {
        match self {
            Self::Noise => "the misfit is at the noise level",
            Self::Iterations => "maximum number of iterations reached",
            Self::Stalled => "no further decrease of the objective function",
            Self::Interrupted => "stopped",
        }
    }
}

/// Misfit above which the images are not explained: noise and errors of the model are about 1, and
/// tens where surface or droplets are not those of the images.
const UNEXPLAINED: f64 = 100.0;

/// The result of an inversion.
#[derive(Debug, Clone, PartialEq)]
pub struct Reconstruction {
    /// The extinction (1/km), 0 outside the mask.
    pub extinction: Volume,
    /// The effective radius (um), 0 outside the mask; `None` if it was given.
    pub effective_radius: Option<Volume>,
    /// The record of each iteration.
    pub history: Vec<Record>,
    /// The reason why the inversion ended.
    pub ending: Ending,
}

impl Reconstruction {
    /// The mean effective radius (um), weighted by the extinction; `None` if it was given, or if there
    /// is no cloud.
    pub fn mean_effective_radius(&self) -> Option<f64> {
        let pairs = self.effective_radius.iter().flat_map(|radius| &radius.values);
        let (mut sum, mut total) = (0.0, 0.0);
        for (extinction, radius) in self.extinction.values.iter().zip(pairs) {
            sum += f64::from(*extinction) * f64::from(*radius);
            total += f64::from(*extinction);
        }
        (total > 0.0).then(|| sum / total).filter(|_| self.effective_radius.is_some())
    }

    /// The misfit at the end, if it is so large that the extinction does not explain the images, as
    /// when an inversion cannot leave its start. `None` if it was not allowed to.
    pub fn unexplained(&self) -> Option<f64> {
        let misfit = self.history.last()?.misfit;
        let moved = self.history.iter().any(|record| record.iteration > 0);
        if self.ending == Ending::Iterations && !moved {
            return None;
        }
        (misfit > UNEXPLAINED || misfit.is_nan()).then_some(misfit)
    }
}

/// Progress callback; `()` ignores all events.
pub trait Watch {
    /// Called after each iteration.
    fn reached(&self, _record: &Record) {}

    /// Called every few iterations with the state from which the inversion can be resumed.
    ///
    /// # Errors
    /// A checkpoint that cannot be stored; the inversion then ends with this error.
    fn keep(&self, _checkpoint: &Checkpoint) -> Result<()> {
        Ok(())
    }

    /// Whether to stop and return the current result. Called before each iteration.
    fn interrupted(&self) -> bool {
        false
    }
}

impl Watch for () {}
