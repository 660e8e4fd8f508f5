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
mod models;
mod objective;
mod optimiser;
mod ordinates;
mod prior;
mod problem;
mod reconstruction;
mod run;
mod scale;
mod settings;
mod variables;

pub use checkpoint::Checkpoint;
pub use hybrid::{QUICK_ITERATIONS, hybrid, network_grid};
pub use measurement::Measurement;
pub use models::{Domain, ForwardModel, Models};
pub use optimiser::{Bounds, Function, Minimiser, MinimiserSettings, Pair, Point, Step};
pub use ordinates::{OrdinatesModels, QUICK_TOLERANCE};
pub use problem::{Problem, Start};
pub use reconstruction::{Ending, Reconstruction, Record, Watch};
pub use run::{invert, resume};
pub use settings::{InversionSettings, Variable};
