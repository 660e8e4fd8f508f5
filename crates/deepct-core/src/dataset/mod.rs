//! Data sets for training: what is in them, and how they are made and resumed.
//!
//! A data set is a folder: `manifest.json` and one file per sample under `samples/`,
//! each with the truth (`extinction`) and what a formation sees of it (`radiance`, by the
//! deterministic solver, without sensor noise: that is drawn anew each time a sample is used).
//! Every sample is one isolated cloud of a large-eddy simulation, or a square of its field. The
//! sets are split by time, so that no cloud stands in two of them.
//!
//! Which samples there will be is decided before the first is made ([`plan`]), so that
//! several processes, on several machines, can each [`generate`] a [`Share`] of them.

mod check;
mod generate;
mod manifest;
mod plan;
mod settings;
mod variation;

pub use check::check;
pub use generate::{Generated, generate};
pub use manifest::{FORMAT, Manifest, Sample};
pub use plan::{Plan, Planned, Share, plan};
pub use settings::{DatasetSettings, SolverSettings, Source, Split};
pub use variation::Variation;

#[cfg(test)]
mod tests;
