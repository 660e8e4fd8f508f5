//! Comparison of four reconstruction methods: the network, the inversion, the hybrid (an inversion
//! that starts from the estimate of the network) and the quick hybrid with a few iterations
//! (Sde-Chen et al. 2021, section 5).
//!
//! [`run`] reconstructs every cloud by every method and stores each result in a separate file, so
//! that an interrupted run can be resumed. It then writes a report with tables, box plots and
//! figures.

mod case;
mod report;
mod run;

pub use run::run;

use crate::carve::CarveSettings;
use crate::dataset::Split;
use crate::error::{Error, Result};
use crate::inversion::{self, Ending, InversionSettings, QUICK_ITERATIONS};
use crate::scene::{Formation, Light};
use crate::sensor::Sensor;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Settings of an experiment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExperimentSettings {
    /// Seed of generated clouds, of photon paths and of the sensor noise.
    pub seed: u64,
    /// Files of clouds.
    pub clouds: Vec<PathBuf>,
    /// Number of clouds from the built-in generator.
    pub generated: usize,
    /// Folder of a data set for the formation, or for a formation that includes all its views.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dataset: Option<PathBuf>,
    /// The split from which samples are taken.
    pub split: Split,
    /// Number of samples, evenly distributed over the split.
    pub samples: usize,
    /// Weights of the network: a file or the name of built-in weights.
    pub weights: PathBuf,
    /// The formation whose views are used. If absent: that of the weights; for general weights all
    /// views of a sample, and `cloudct-10` for other clouds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub formation: Option<String>,
    /// The methods to compare.
    pub methods: Vec<Method>,
    /// Name or file of the sensor, or `none`.
    pub sensor: String,
    /// Number of photon paths per pixel, for clouds without images.
    pub samples_per_pixel: u32,
    /// Number of scatterings after which these paths continue with weaker forward peaks; never if
    /// absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub similarity_after: Option<u32>,
    /// Scene illumination of clouds without images; samples of a data set include their own.
    pub light: Light,
    /// Effective radius (um) prescribed in the inversions; if absent, the mean of each cloud.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub effective_radius: Option<f64>,
    /// Initial extinction of the inversion (1/km).
    pub start: f64,
    /// Number of iterations of the quick hybrid.
    pub quick_iterations: usize,
    /// Settings of the space carving that gives the mask.
    pub carve: CarveSettings,
    /// Settings of the inversion in the three methods that include one.
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
            formation: None,
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

/// Largest number of generated clouds of an experiment.
const MOST_GENERATED: usize = 100_000;

impl ExperimentSettings {
    /// Check that the settings are valid.
    ///
    /// # Errors
    /// Returns an error that names the first invalid setting.
    pub fn check(&self) -> Result<()> {
        self.inversion.check()?;
        self.carve.check()?;
        let mut light = self.light.clone();
        light.optics.effective_radius = self.effective_radius.or(light.optics.effective_radius);
        light.check()?;
        self.light.check()?;
        if self.methods.is_empty() {
            return Err(Error::out_of_range("methods", "empty", "at least one method"));
        }
        let repeated = |(number, method)| self.methods[..number].contains(method);
        if self.methods.iter().enumerate().any(repeated) {
            let found = format!("{:?}", self.methods);
            return Err(Error::out_of_range("methods", found, "different from each other"));
        }
        if !(self.start.is_finite() && self.start > 0.0) {
            return Err(Error::out_of_range("start", self.start, "positive and finite (1/km)"));
        }
        if let Some(name) =
            self.formation.as_deref().filter(|name| Formation::preset(name).is_none())
        {
            let range = format!("one of {}", Formation::PRESETS.join(", "));
            return Err(Error::out_of_range("formation", format!("\"{name}\""), range));
        }
        if self.dataset.is_some() != (self.samples > 0) {
            return Err(Error::out_of_range(
                "samples",
                self.samples,
                "positive if a data set is given, and 0 otherwise",
            ));
        }
        if self.generated > MOST_GENERATED {
            let range = format!("at most {MOST_GENERATED}");
            return Err(Error::out_of_range("generated", self.generated, range));
        }
        if self.samples_per_pixel < 2 {
            let range = "at least 2";
            return Err(Error::out_of_range("samples_per_pixel", self.samples_per_pixel, range));
        }
        if self.clouds.is_empty() && self.generated == 0 && self.dataset.is_none() {
            return Err(Error::out_of_range("clouds", "empty", "at least one cloud"));
        }
        Ok(())
    }

    /// The sensor; `None` for images without noise.
    ///
    /// # Errors
    /// Returns an error if there is neither a preset nor a file of this name, or if the file is not
    /// one of a sensor.
    fn sensor(&self) -> Result<Option<Sensor>> {
        match self.sensor.as_str() {
            "none" => Ok(None),
            name => Sensor::preset(name)
                .map_or_else(|| Sensor::from_file(Path::new(name)), Ok)
                .map(Some),
        }
    }
}

/// A reconstruction method. All methods are restricted to the carved mask.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Method {
    /// The network.
    Network,
    /// The inversion, which starts from a small constant extinction.
    Physics,
    /// The inversion, which starts from the estimate of the network.
    Hybrid,
    /// A few iterations of the hybrid with a faster solver.
    QuickHybrid,
}

impl Method {
    /// All methods, in the order of the paper.
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

/// The result of one method for one cloud.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Outcome {
    /// Name of the cloud.
    pub cloud: String,
    /// The method.
    pub method: Method,
    /// Largest optical depth of a column of the true cloud.
    pub optical_depth: f64,
    /// Relative error epsilon.
    pub relative_error: f64,
    /// Mass error delta.
    pub mass_error: f64,
    /// Epsilon that the network expects of its own estimate, if its weights provide an
    /// uncertainty.
    pub expected_relative_error: Option<f64>,
    /// Time from images to extinction including the carving (s).
    pub seconds: f64,
    /// Number of iterations of the inversion.
    pub steps: usize,
    /// Final misfit of the inversion.
    pub misfit: Option<f64>,
    /// Reason why the inversion ended.
    pub ending: Option<Ending>,
}

/// Progress callback of an experiment and of its inversions; `()` ignores all events.
pub trait Watch: inversion::Watch {
    /// Called before each of `total` results is computed or read from a previous run.
    fn begins(&self, _cloud: &str, _method: Method, _number: usize, _total: usize) {}

    /// Called with each newly computed result.
    fn made(&self, _outcome: &Outcome) {}
}

impl Watch for () {}

/// The result of an experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct Experiment {
    /// All results, or those of the share, ordered by cloud and then by method.
    pub outcomes: Vec<Outcome>,
    /// Number of newly computed results; the others are from previous runs.
    pub made: usize,
    /// Whether the progress callback interrupted the run, in which case there is no report.
    pub interrupted: bool,
}
