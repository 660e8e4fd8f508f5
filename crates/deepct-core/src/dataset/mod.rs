//! Data sets for training: contents, generation and resumption.
//!
//! A data set is a folder with `manifest.json` and one file per sample under `samples/`. Each
//! sample contains the true `extinction` and the images of a formation (`radiance`), computed by
//! the discrete-ordinates solver without sensor noise, which is drawn anew each time a sample is
//! used. A sample is one isolated cloud of a large-eddy simulation, or a square of its field. The
//! splits are separated in time, so that no cloud occurs in two of them.
//!
//! The samples are chosen before the first one is generated ([`plan`]), so that several processes
//! on several machines can each [`generate`] a [`Share`] of them.

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
