//! Inversion: retrieval of the extinction, and of the effective radius, whose simulated images fit
//! the measured ones.
//!
//! [`invert`] minimises
//!
//! ```text
//! 1/2 sum over bands and pixels ((F(x) - measured) / standard error)^2 + prior(x)
//! ```
//!
//! where `x` are the extinction in the voxels of a mask, bounded between zero and a largest value, and
//! the unknowns that describe the effective radius ([`Radius`]), for any forward model `F` that
//! provides images and the derivatives of a weighted sum of them ([`ForwardModel`]). If the gains of
//! the cameras or the directions in which they point are unknown, they take their most likely values at
//! any `x` ([`Calibration`]). From a uniform start, the
//! inversion first solves for blocks of voxels, on coarse grids on which an iteration is inexpensive.
//! The optimiser is a bounded quasi-Newton method ([`Minimiser`]), preconditioned with the Hessian of
//! the prior and an approximate Hessian of the misfit.

mod blocks;
mod calibration;
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
mod radius;
mod reconstruction;
mod run;
mod scale;
mod settings;
mod variables;

pub use calibration::Calibration;
pub use checkpoint::Checkpoint;
pub use hybrid::{QUICK_ITERATIONS, hybrid, network_bands, network_estimate, network_grid};
pub use measurement::Measurement;
pub use models::{Domain, Fields, ForwardModel, Models};
pub use optimiser::{Bounds, Function, Minimiser, MinimiserSettings, Pair, Point, Step};
pub use ordinates::{Band, OrdinatesModels, QUICK_TOLERANCE};
pub use problem::{Problem, Start, shown};
pub use reconstruction::{Ending, Explanation, Reconstruction, Record, StandardErrors, Watch};
pub use run::{invert, resume};
pub use settings::{InversionSettings, Radius, Variable};
