//! The comparison of four ways from images to a cloud: the network, physics, physics that
//! starts from the network, and the same in ten steps (Sde-Chen et al. 2021, section 5).
//!
//! [`run`] takes every cloud in every way, keeps each result in a file of its own, so that
//! a run that was stopped goes on where it was, and writes a report: tables, box plots,
//! pictures.

mod case;
mod report;
mod run;

pub use run::run;

use crate::carve::CarveSettings;
use crate::dataset::Split;
use crate::error::{Error, Result};
use crate::inversion::{self, Ending, InversionSettings, QUICK_ITERATIONS};
use crate::scene::Light;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// What is compared, and on what.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExperimentSettings {
    /// Seed of generated clouds, of photon paths and of the sensor's noise.
    pub seed: u64,
    /// Files of clouds.
    pub clouds: Vec<PathBuf>,
    /// Number of clouds of the built-in generator.
    pub generated: usize,
    /// Folder of a data set, made by the formation of the weights or one that has all of
    /// its views.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dataset: Option<PathBuf>,
    /// The set whose samples are taken.
    pub split: Split,
    /// Number of samples taken, evenly spread over the set.
    pub samples: usize,
    /// Weights of the network: a file, or the name of built-in ones.
    pub weights: PathBuf,
    /// The ways.
    pub methods: Vec<Method>,
    /// Sensor by its name or file, or `none`.
    pub sensor: String,
    /// Light paths of each pixel, for clouds that come without images.
    pub samples_per_pixel: u32,
    /// Scattering orders after which those paths go on without the forward peak; never, if
    /// absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub similarity_after: Option<u32>,
    /// The light of clouds that come without images; samples of a data set have their own.
    pub light: Light,
    /// Effective radius (um) that the inversions prescribe; if absent, the mean of each cloud.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub effective_radius: Option<f64>,
    /// Extinction (1/km) that physics starts from.
    pub start: f64,
    /// Steps of the quick hybrid.
    pub quick_iterations: usize,
    /// Where cloud is looked for.
    pub carve: CarveSettings,
    /// The inversion of the three ways that invert.
    pub inversion: InversionSettings,
}

impl Default for ExperimentSettings {
    fn default() -> Self {
        Self {
            seed: 1,
            clouds: Vec::new(),
            generated: 7,
            dataset: None,
            split: Split::Validation,
            samples: 0,
            weights: "cloudct-10".into(),
            methods: Method::ALL.into(),
            sensor: "cmv4000".into(),
            samples_per_pixel: 4096,
            similarity_after: Some(3),
            light: Light::default(),
            effective_radius: None,
            start: 0.01,
            quick_iterations: QUICK_ITERATIONS,
            carve: CarveSettings::default(),
            inversion: InversionSettings::default(),
        }
    }
}

impl ExperimentSettings {
    /// An error unless the settings can be used.
    ///
    /// # Errors
    /// Names the first setting at fault.
    pub fn check(&self) -> Result<()> {
        self.inversion.check()?;
        self.carve.check()?;
        self.light.check()?;
        if self.methods.is_empty() {
            return Err(Error::out_of_range("methods", "empty", "at least one way"));
        }
        if self.dataset.is_some() != (self.samples > 0) {
            return Err(Error::out_of_range(
                "samples",
                self.samples,
                "positive where a data set is given, and 0 where none is",
            ));
        }
        if self.clouds.is_empty() && self.generated == 0 && self.dataset.is_none() {
            return Err(Error::out_of_range("clouds", "empty", "at least one cloud"));
        }
        Ok(())
    }
}

/// A way from images to a cloud; all look inside the carved mask.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Method {
    /// The network.
    Network,
    /// Inversion from next to nothing.
    Physics,
    /// Inversion from the network's answer.
    Hybrid,
    /// A few steps of the same, by a solver with fewer ordinates.
    QuickHybrid,
}

impl Method {
    /// All of them, in the order of the paper.
    pub const ALL: [Self; 4] = [Self::Network, Self::Physics, Self::Hybrid, Self::QuickHybrid];

    /// The name in files and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Network => "network",
            Self::Physics => "physics",
            Self::Hybrid => "hybrid",
            Self::QuickHybrid => "quick-hybrid",
        }
    }
}

/// What one way made of one cloud.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Outcome {
    /// Name of the cloud.
    pub cloud: String,
    /// The way.
    pub method: Method,
    /// Optical depth of its thickest column.
    pub optical_depth: f64,
    /// Relative error epsilon.
    pub relative_error: f64,
    /// Relative error of the total extinction delta.
    pub mass_error: f64,
    /// The epsilon that the network expected of its own answer, if its weights tell that.
    pub expected_relative_error: Option<f64>,
    /// Time from images to extinction (s), with the carving.
    pub seconds: f64,
    /// Steps of the inversion.
    pub steps: usize,
    /// The last misfit of the inversion.
    pub misfit: Option<f64>,
    /// Why the inversion ended.
    pub ending: Option<Ending>,
}

/// Whoever waits for an experiment: for each of its inversions, too.
pub trait Watch: inversion::Watch {
    /// Called before each of `total` results is made or found.
    fn begins(&self, _cloud: &str, _method: Method, _number: usize, _total: usize) {}

    /// Called with each result that was made now.
    fn made(&self, _outcome: &Outcome) {}
}

impl Watch for () {}

/// What an experiment came to.
#[derive(Debug, Clone, PartialEq)]
pub struct Experiment {
    /// All results, by cloud and then by way.
    pub outcomes: Vec<Outcome>,
    /// Those of them that were made now and not found.
    pub made: usize,
    /// Whether the watch stopped it; there is no report then.
    pub interrupted: bool,
}
