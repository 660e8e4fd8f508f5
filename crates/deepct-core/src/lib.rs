//! deepct turns the images of a cloud, taken by several satellites at once, into the
//! cloud: the 3D field of its extinction.
//!
//! Data flows one way, and the modules stand in that order:
//!
//! ```text
//! cloud -> optics -> scene -> transport -> sensor -> images
//! images -> carve -> mask;  images + network -> extinction
//! truth + extinction -> metrics, plot
//! ```

pub mod carve;
pub mod cloud;
pub mod conv;
#[cfg(feature = "files")]
pub mod dataset;
pub mod error;
pub mod grid;
pub mod image;
pub mod io;
pub mod math;
pub mod metrics;
pub mod network;
pub mod optics;
#[cfg(feature = "plot")]
pub mod plot;
pub mod rng;
pub mod scene;
pub mod sensor;
pub mod transport;
pub mod traverse;
pub mod validation;

pub use error::{Error, Result};
