//! Inversion: the extinction whose images are those that were measured.
//!
//! [`invert`] minimises
//!
//! ```text
//! 1/2 sum over pixels ((F(extinction) - measured) / standard error)^2 + prior(extinction)
//! ```
//!
//! over the voxels of a mask, between nothing and a greatest extinction, for any model
//! `F` that gives images and the derivatives of a weighted sum of them
//! ([`ForwardModel`]). From a start that is the same everywhere it first solves for blocks
//! of voxels, on grids so coarse that a step costs next to nothing. The optimiser is a
//! bounded quasi-Newton method ([`Minimiser`]), around the prior's second derivatives and an
//! estimate of the misfit's.

mod blocks;
mod checkpoint;
mod conjugate_gradient;
mod curvature;
mod hybrid;
mod measurement;
mod objective;
mod optimiser;
mod ordinates;
mod prior;
mod run;
mod scale;
mod settings;
mod variables;

pub use checkpoint::Checkpoint;
pub use hybrid::{QUICK_ITERATIONS, hybrid, network_grid};
pub use measurement::Measurement;
pub use optimiser::{Bounds, Function, Minimiser, MinimiserSettings, Pair, Point, Step};
pub use ordinates::{OrdinatesModels, QUICK_TOLERANCE};
pub use run::{invert, resume};
pub use settings::{InversionSettings, Variable};

use crate::error::Result;
use crate::grid::{Mask, Volume};
use crate::image::ViewStack;
use crate::network::Estimate;
use crate::scene::Observation;
use ndarray::Array3;
use serde::{Deserialize, Serialize};

/// The images of an extinction, and how they depend on it.
pub trait ForwardModel {
    /// The images of an extinction (1/km).
    ///
    /// # Errors
    /// Those of the model.
    fn images(&mut self, extinction: &Volume) -> Result<ViewStack>;

    /// The derivative of `sum(weights * images)` with respect to the extinction of each
    /// voxel, at the extinction of the last [`ForwardModel::images`].
    ///
    /// # Errors
    /// Those of the model.
    fn gradient(&mut self, weights: &ViewStack) -> Result<Volume>;
}

/// What a model is made for.
#[derive(Debug, Clone, Copy)]
pub struct Domain<'a> {
    /// The grid, that of the problem or one of blocks of its voxels, and where on it extinction is
    /// not 0.
    pub mask: &'a Mask,
    /// The extinction (1/km) that steps begin at, about, on the same grid.
    pub expected: &'a Volume,
    /// Whether that is an estimate of the answer, and not the same everywhere or of a coarser grid.
    pub near: bool,
    /// The pixels `[view, row, col]` that count; others may be left at 0.
    pub pixels: &'a Array3<bool>,
}

/// Models of the same images on any grid.
pub trait Models {
    /// Whether models near the answer are more accurate than others, and most so at the extinction
    /// that they are made for.
    fn are_corrected(&self) -> bool {
        false
    }

    /// The model for a domain.
    ///
    /// # Errors
    /// Those of the model.
    fn model(&mut self, domain: &Domain) -> Result<Box<dyn ForwardModel + '_>>;
}

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
