//! Settings of a data set.

use super::Variation;
use crate::error::{Error, Result};
use crate::files;
use crate::grid::Grid;
use crate::math::DVec3;
use crate::network::Levels;
use crate::scene::{Formation, Light, View};
use crate::transport::OrdinatesSettings;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Settings from which a data set is generated.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DatasetSettings {
    /// Seed of the random choice of clouds and of their droplet number concentrations.
    pub seed: u64,
    /// Name of the formation that observes the clouds.
    pub formation: String,
    /// The scene illumination.
    pub light: Light,
    /// Wavelengths (um) of the bands in which each sample is rendered, with the same illumination
    /// otherwise; if there are none, only that of the illumination. The extinction of a sample is that
    /// of the first band.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub bands: Vec<f64>,
    /// Minimum and maximum droplet number concentration (1/cm3), from which effective radii are
    /// derived. The value of each cloud is drawn between them, uniformly in its logarithm.
    pub droplets_per_cm3: [f64; 2],
    /// Factor by which the liquid water content is multiplied.
    pub water_share: f32,
    /// Settings of the radiative transfer solver.
    pub solver: SolverSettings,
    /// Number of columns of a sample along x and along y.
    pub columns: usize,
    /// Width of a column (km).
    pub column_km: f64,
    /// Levels of a sample.
    pub levels: Levels,
    /// Whether a sample contains a single isolated cloud. Otherwise it is a square of the field
    /// with all clouds in it. A source can override this setting.
    #[serde(default = "isolated")]
    pub isolated: bool,
    /// Minimum number of cloudy columns of a sample.
    pub minimum_columns: usize,
    /// Minimum of the largest liquid water path of a sample (g/m2).
    pub minimum_water_path: f32,
    /// Number of samples of each split, drawn at random from those of its sources. A split that is
    /// not listed includes all samples.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub counts: BTreeMap<Split, usize>,
    /// The simulations that provide the clouds.
    pub sources: Vec<Source>,
}

/// The value for data sets that were generated before this setting existed.
fn isolated() -> bool {
    true
}

/// A time interval of one simulation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Source {
    /// The file of the simulation, relative to the folder of the simulations.
    pub file: PathBuf,
    /// The split to which its clouds belong.
    pub split: Split,
    /// Index of the first snapshot.
    pub first: usize,
    /// Index of the last snapshot.
    pub last: usize,
    /// Step between the indices of the snapshots.
    pub every: usize,
    /// Maximum number of samples of one snapshot; if there are more, they are drawn at random.
    pub clouds: usize,
    /// Overrides [`DatasetSettings::isolated`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub isolated: Option<bool>,
    /// Random variation of the clouds; if absent, they are used unchanged.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub variation: Option<Variation>,
    /// Overrides [`DatasetSettings::light`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub light: Option<Light>,
}

/// The settings of the discrete-ordinates solver for a data set.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SolverSettings {
    /// See [`OrdinatesSettings::zenith_angles`].
    pub zenith_angles: usize,
    /// See [`OrdinatesSettings::tolerance`].
    pub tolerance: f64,
    /// See [`OrdinatesSettings::cell_depth`].
    pub cell_depth: f64,
    /// See [`OrdinatesSettings::most_parts`].
    pub most_parts: usize,
}

/// The split to which a sample belongs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Split {
    /// Samples used to train a network.
    Train,
    /// Samples used to decide when to stop the training and to report its progress.
    Validation,
    /// Samples reserved for the final evaluation.
    Test,
}

impl Split {
    /// The name in files and settings.
    pub fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Validation => "validation",
            Self::Test => "test",
        }
    }
}

impl SolverSettings {
    pub(super) fn resolve(self) -> OrdinatesSettings {
        let Self { zenith_angles, tolerance, cell_depth, most_parts } = self;
        OrdinatesSettings { zenith_angles, tolerance, cell_depth, most_parts, ..Default::default() }
    }
}

impl DatasetSettings {
    /// All snapshots that are read: the index of the source and that of the snapshot in it.
    pub fn snapshots(&self) -> impl Iterator<Item = (usize, usize)> {
        self.sources.iter().enumerate().flat_map(|(number, source)| {
            let every = source.every.max(1);
            (source.first..=source.last).step_by(every).map(move |snapshot| (number, snapshot))
        })
    }

    /// The formation with the configured name.
    ///
    /// # Errors
    /// Returns an error if there is no preset with this name.
    pub fn formation(&self) -> Result<Formation> {
        Formation::preset(&self.formation).ok_or_else(|| {
            Error::out_of_range(
                "formation",
                format!("\"{}\"", self.formation),
                format!("one of {}", Formation::PRESETS.join(", ")),
            )
        })
    }

    /// The grid of the samples. All samples have their horizontal origin at 0, regardless of the
    /// position of the cloud in the simulation.
    pub(super) fn grid(&self) -> Result<Grid> {
        let Self { columns, column_km, levels, .. } = self;
        let origin = DVec3::new(0.0, 0.0, levels.bottom_km);
        let spacing = DVec3::new(*column_km, *column_km, levels.spacing_km);
        Grid::new(origin, spacing, [levels.count, *columns, *columns])
    }

    /// The views of the samples.
    pub(super) fn views(&self) -> Result<Vec<View>> {
        self.formation()?.views(self.grid()?.center(), [self.columns; 2])
    }

    /// The scene illumination of the samples of a source in each band.
    pub(super) fn lights(&self, source: &Source) -> Vec<Light> {
        let light = source.light.as_ref().unwrap_or(&self.light);
        match &self.bands[..] {
            [] => vec![light.clone()],
            bands => {
                bands.iter().map(|&wavelength| Light { wavelength, ..light.clone() }).collect()
            }
        }
    }

    /// Check that the values are in range, that the formation is known, and that the files of the
    /// simulations can be opened.
    pub(super) fn check(&self, simulations: &Path) -> Result<()> {
        if self.sources.is_empty() {
            return Err(Error::out_of_range("number of [[sources]]", 0, "at least 1"));
        }
        for source in &self.sources {
            let path = simulations.join(&source.file);
            files::check_regular(&path)?;
        }
        self.views()?;
        let [least, most] = self.droplets_per_cm3;
        if !(least > 0.0 && least <= most && most.is_finite()) {
            let found = format!("[{least}, {most}]");
            return Err(Error::out_of_range("droplets_per_cm3", found, "positive, least first"));
        }
        if !(self.water_share > 0.0 && self.water_share.is_finite()) {
            return Err(Error::out_of_range("water_share", self.water_share, "positive"));
        }
        let least = self.minimum_water_path;
        if !(least >= 0.0 && least.is_finite()) {
            return Err(Error::out_of_range("minimum_water_path", least, "0 or more (g/m2)"));
        }
        for Source { file, first, last, every, .. } in &self.sources {
            let of = |value: usize| format!("{value} for {}", file.display());
            if *every == 0 {
                return Err(Error::out_of_range("every", of(0), "at least 1"));
            }
            if last < first {
                return Err(Error::out_of_range("last", of(*last), format!("at least {first}")));
            }
        }
        self.solver.resolve().check()?;
        let repeated = |(number, band)| self.bands[..number].contains(band);
        if self.bands.iter().enumerate().any(repeated) {
            let found = format!("{:?}", self.bands);
            return Err(Error::out_of_range("bands", found, "different wavelengths"));
        }
        for source in &self.sources {
            self.lights(source).iter().try_for_each(Light::check)?;
            source.variation.map_or(Ok(()), |variation| variation.check())?;
        }
        Ok(())
    }
}
