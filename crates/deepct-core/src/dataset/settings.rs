//! What a data set is made of.

use super::Variation;
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::math::DVec3;
use crate::network::Levels;
use crate::scene::{Formation, Light, View};
use crate::transport::OrdinatesSettings;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What a data set is made of.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DatasetSettings {
    /// Seed of the choice of clouds and of their droplet numbers.
    pub seed: u64,
    /// Name of the formation that looks at the clouds.
    pub formation: String,
    /// The light that the clouds are seen in.
    pub light: Light,
    /// Least and largest droplet number concentration (1/cm3), from which effective radii
    /// follow: that of each cloud is drawn from between them, evenly in its logarithm.
    pub droplets_per_cm3: [f64; 2],
    /// Share of the liquid water that is kept: 1 is all of it.
    pub water_share: f32,
    /// How the light is computed.
    pub solver: SolverSettings,
    /// Columns of a sample along x and along y.
    pub columns: usize,
    /// Side of a column (km).
    pub column_km: f64,
    /// Levels of a sample.
    pub levels: Levels,
    /// Whether a sample is one cloud alone on its ground; otherwise it is a square of the field
    /// with all that is in it. A source may have it otherwise.
    #[serde(default = "isolated")]
    pub isolated: bool,
    /// Fewest cloudy columns of a sample.
    pub minimum_columns: usize,
    /// Least liquid water path (g/m2) that a sample must reach in a column.
    pub minimum_water_path: f32,
    /// Number of samples of each split, drawn at random from all that the sources have; all of
    /// a split that is not named.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub counts: BTreeMap<Split, usize>,
    /// Where the clouds come from.
    pub sources: Vec<Source>,
}

/// What data sets had before the setting was there.
fn isolated() -> bool {
    true
}

/// A stretch of time of one simulation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Source {
    /// The simulation, relative to the folder of the simulations.
    pub file: PathBuf,
    /// The set that its clouds belong to.
    pub split: Split,
    /// Index of the first snapshot.
    pub first: usize,
    /// Index of the last snapshot.
    pub last: usize,
    /// Take every so many snapshots.
    pub every: usize,
    /// The most samples taken of one snapshot, drawn at random.
    pub clouds: usize,
    /// [`DatasetSettings::isolated`] of its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub isolated: Option<bool>,
    /// How they are changed; as the simulation made them where this is missing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub variation: Option<Variation>,
    /// [`DatasetSettings::light`] of its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub light: Option<Light>,
}

/// The settings of the deterministic solver that a data set is computed with.
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

/// The set that a sample belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Split {
    /// What a network learns from.
    Train,
    /// What decides when to stop, and what is reported of a training.
    Validation,
    /// What nobody looks at before the end.
    Test,
}

impl Split {
    /// Its name in files and settings.
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
    /// Every snapshot that is read: the number of its source, and its index there.
    pub fn snapshots(&self) -> impl Iterator<Item = (usize, usize)> {
        self.sources.iter().enumerate().flat_map(|(number, source)| {
            let every = source.every.max(1);
            (source.first..=source.last).step_by(every).map(move |snapshot| (number, snapshot))
        })
    }

    /// The formation by its name.
    ///
    /// # Errors
    /// A name that is no preset.
    pub fn formation(&self) -> Result<Formation> {
        Formation::preset(&self.formation).ok_or_else(|| {
            Error::out_of_range(
                "formation",
                format!("\"{}\"", self.formation),
                format!("one of {}", Formation::PRESETS.join(", ")),
            )
        })
    }

    /// The grid of the samples. Where a cloud stood does not matter: every sample begins at 0.
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

    /// An error unless the values are in range, the formation is known and the simulations are in
    /// their folder.
    pub(super) fn check(&self, simulations: &Path) -> Result<()> {
        for source in &self.sources {
            let path = simulations.join(&source.file);
            std::fs::File::open(&path).map_err(Error::io(path))?;
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
        if let Some(source) = self.sources.iter().find(|source| source.every == 0) {
            let name = source.file.display();
            return Err(Error::out_of_range("every", format!("0 for {name}"), "at least 1"));
        }
        self.light.check()?;
        for source in &self.sources {
            source.light.as_ref().map_or(Ok(()), Light::check)?;
            source.variation.map_or(Ok(()), |variation| variation.check())?;
        }
        Ok(())
    }
}
