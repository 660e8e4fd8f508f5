//! deepct retrieves the three-dimensional extinction field of a cloud from images that several
//! satellites take at the same time.
//!
//! Data flow in one direction through the modules:
//!
//! ```text
//! cloud -> optics -> scene -> transport -> sensor -> images
//! images -> carve -> mask;  images + network -> extinction
//! images + mask + transport -> inversion -> extinction
//! truth + extinction -> metrics, plot
//! ```
//!
//! A complete example, from a cloud to its images and back:
//!
//! ```
//! use deepct_core::carve::{CarveSettings, carve};
//! use deepct_core::cloud::{CumulusSettings, cumulus};
//! use deepct_core::metrics::score;
//! use deepct_core::network::Network;
//! use deepct_core::optics::extinction;
//! use deepct_core::scene::{Formation, Light, Observation};
//! use deepct_core::sensor::{Scale, Sensor, sense};
//! use deepct_core::transport::{Solver, render};
//!
//! let seed = 1;
//! let cloud = cumulus(&CumulusSettings::default(), seed)?;
//! let light = Light::default();
//! let scene = light.scene(&cloud)?;
//! let views = Formation::cloudct_10().views(cloud.grid.center(), [32, 32])?;
//! let radiance = render(&scene, &views, &Solver::default(), &())?.images;
//! let noisy = sense(&radiance, None, &Sensor::CMV4000, Scale::BrightestAtFullWell, seed)?.images;
//!
//! let observation = Observation::new(light, views, noisy)?;
//! let mask = carve(&observation, &cloud.grid, &CarveSettings::default())?.mask;
//! let network = Network::new(&deepct_core::io::load_weights("cloudct-10")?)?;
//! let mut estimate = network.infer(&observation.images, &observation.imaging_geometry()?)?;
//! mask.apply(&mut estimate)?;
//!
//! // An estimate of zero everywhere has a relative error of 1.
//! assert!(score(&extinction(&cloud)?, &estimate)?.relative_error < 0.6);
//! # Ok::<(), deepct_core::Error>(())
//! ```

pub mod carve;
pub mod cloud;
pub mod conv;
#[cfg(feature = "files")]
pub mod dataset;
#[cfg(feature = "plot")]
mod encoding;
pub mod error;
#[cfg(all(feature = "files", feature = "plot"))]
pub mod experiment;
pub mod files;
pub mod grid;
pub mod image;
pub mod inversion;
pub mod io;
pub mod math;
pub mod memory;
pub mod metrics;
pub mod network;
pub mod optics;
#[cfg(feature = "plot")]
pub mod plot;
#[cfg(all(feature = "files", feature = "plot"))]
pub mod report;
pub mod rng;
pub mod scene;
pub mod sensor;
pub mod stop;
pub mod transport;
pub mod traverse;
pub mod validation;

pub use error::{Error, Result};
