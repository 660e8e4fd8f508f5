//! The choice of the samples of a data set and their distribution among processes.

use super::{DatasetSettings, Manifest, Source, Split};
use crate::cloud::{self, Cloud, IsolateSettings, Piece};
use crate::error::{Error, Result};
use crate::files;
use crate::io::import::{ImportSettings, import_cloud};
use crate::math::DVec3;
use crate::rng::{Purpose, Rng, RngExt, stream};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// The contents of `plan.json`: the samples of a data set to be generated. The first process that
/// works on a data set writes the file; all others read it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// The settings by which the samples are chosen and generated.
    pub configuration: DatasetSettings,
    /// The samples, ordered by source, snapshot and position.
    pub samples: Vec<Planned>,
}

/// A sample to be generated.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Planned {
    /// Index of its source in the settings, from 0.
    pub source: usize,
    /// The index of the snapshot.
    pub snapshot: usize,
    /// As [`Sample::corner`](super::Sample::corner).
    pub corner: [i64; 2],
    /// Checksum of the liquid water of the cloud, by which a simulation that has changed since is
    /// detected.
    pub water_sha256: String,
}

/// One of several equal parts of a data set or an experiment, each made by a separate process. For
/// example, one of eight shares contains every eighth snapshot, or every eighth cloud.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Share {
    number: usize,
    of: usize,
}

/// Returns the plan of the data set in `folder`. If there is none, the samples are chosen from the
/// simulations and the plan is written. `progress` is called after every snapshot that is read.
///
/// # Errors
/// Returns an error if the folder contains a data set with other settings, if a simulation cannot
/// be read, or if settings are out of range.
pub fn plan(
    settings: &DatasetSettings,
    simulations: &Path,
    folder: &Path,
    progress: &(dyn Fn(u64) + Sync),
) -> Result<Plan> {
    // Check first, so that invalid settings leave no files.
    settings.check(simulations)?;
    if Manifest::path(folder).exists() {
        same(settings, &Manifest::read(folder)?.configuration, &Manifest::path(folder))?;
    }
    let path = Plan::path(folder);
    if !path.exists() {
        let mut samples = Vec::new();
        // An index beyond the end of a file would be found only after all others were read.
        for Source { file, first, last, every, .. } in &settings.sources {
            field(settings, &simulations.join(file), last - (last - first) % every)?;
        }
        for (source, snapshot) in settings.snapshots() {
            let pieces = pieces(settings, simulations, source, snapshot)?;
            let planned = |piece: Piece| Planned {
                source,
                snapshot,
                corner: piece.corner,
                water_sha256: water_sha256(&piece),
            };
            samples.extend(pieces.into_iter().map(planned));
            progress(1);
        }
        let samples = count_out(settings, samples)?;
        Plan { configuration: settings.clone(), samples }.write(&path)?;
    }
    // Another process with other settings may have written the plan in the meantime.
    let plan = Plan::read(&path)?;
    same(settings, &plan.configuration, &path)?;
    Ok(plan)
}

fn same(asked: &DatasetSettings, begun: &DatasetSettings, path: &Path) -> Result<()> {
    if asked == begun {
        return Ok(());
    }
    Err(Error::file(
        path,
        "configuration",
        "differs from the requested configuration",
        "choose another folder, or the settings with which the data set was started",
    ))
}

/// Checksum of the liquid water of a cloud.
pub(super) fn water_sha256(piece: &Piece) -> String {
    let water = piece.cloud.microphysics.as_ref().map(|droplets| &droplets.liquid_water_content);
    let bytes: Vec<u8> =
        water.into_iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
    files::sha256_of([bytes.as_slice()])
}

/// The eligible clouds or squares of one snapshot, ordered by position.
pub(super) fn pieces(
    settings: &DatasetSettings,
    simulations: &Path,
    source: usize,
    snapshot: usize,
) -> Result<Vec<Piece>> {
    let field = field(settings, &simulations.join(&settings.sources[source].file), snapshot)?;
    let indices = [source as u64, snapshot as u64];
    let mut rng = stream(settings.seed, Purpose::Dataset, &indices);
    let DatasetSettings { columns: side, minimum_columns, minimum_water_path, .. } = *settings;
    let isolated = settings.sources[source].isolated.unwrap_or(settings.isolated);
    let mut pieces = if isolated {
        let isolate = IsolateSettings {
            side,
            columns: minimum_columns,
            water_path: minimum_water_path,
            ..IsolateSettings::default()
        };
        cloud::isolate(&field, &isolate)?
    } else {
        let [_, rows, cols] = field.grid.shape;
        let origin = [rng.random_range(0..rows), rng.random_range(0..cols)];
        let mut squares = cloud::tile(&field, side, origin)?;
        squares.retain(|piece| {
            piece.columns >= minimum_columns.max(1) && piece.water_path >= minimum_water_path
        });
        squares
    };
    thin(&mut pieces, settings.sources[source].clouds, &mut rng);
    Ok(pieces)
}

/// Draw the requested number of samples of each split.
fn count_out(settings: &DatasetSettings, samples: Vec<Planned>) -> Result<Vec<Planned>> {
    let mut samples = samples;
    for (split, count) in &settings.counts {
        let is_of = |planned: &Planned| settings.sources[planned.source].split == *split;
        let (mut own, others): (Vec<_>, Vec<_>) = samples.into_iter().partition(is_of);
        if own.len() < *count {
            return Err(Error::out_of_range(
                "counts",
                format!("{count} for {}", split.name()),
                format!(
                    "at most the {} that its sources provide: add snapshots, or increase the \
                     number of samples per snapshot",
                    own.len()
                ),
            ));
        }
        thin(&mut own, *count, &mut stream(settings.seed, Purpose::Dataset, &[*split as u64]));
        samples = others;
        samples.append(&mut own);
    }
    samples.sort_by_key(|planned| (planned.source, planned.snapshot));
    Ok(samples)
}

/// Remove items at random until at most `most` are left.
fn thin<T>(items: &mut Vec<T>, most: usize, rng: &mut impl Rng) {
    while items.len() > most {
        items.remove(rng.random_range(0..items.len()));
    }
}

/// The whole field of one snapshot, with the columns and levels of the samples.
fn field(settings: &DatasetSettings, simulation: &Path, snapshot: usize) -> Result<Cloud> {
    let column_km = settings.column_km;
    let import = ImportSettings {
        time: snapshot,
        droplets_per_cm3: Some(settings.droplets_per_cm3[0]),
        spacing: Some(DVec3::new(column_km, column_km, settings.levels.spacing_km)),
        base: Some(settings.levels.bottom_km),
        levels: Some(settings.levels.count),
        ..ImportSettings::default()
    };
    let (cloud, report) = import_cloud(simulation, &import)?;
    // Nobody sees the warnings of a long run, and its samples are used without another look.
    match report.warnings.into_iter().next() {
        None => Ok(cloud),
        Some(warning) => Err(Error::mismatch(
            "simulation of a data set",
            "a file that is read without warnings",
            warning,
            "correct the file",
        )),
    }
}

impl Plan {
    /// The path of the plan in the folder of a data set.
    pub fn path(folder: &Path) -> PathBuf {
        folder.join("plan.json")
    }

    /// Number of samples of a split.
    pub fn count(&self, split: Split) -> usize {
        let splits =
            self.samples.iter().map(|planned| self.configuration.sources[planned.source].split);
        splits.filter(|own| *own == split).count()
    }

    /// Number of samples of a share that are not yet in the folder.
    pub fn missing(&self, folder: &Path, share: Option<Share>) -> usize {
        self.snapshots(share)
            .flatten()
            .filter(|planned| !folder.join(planned.file()).exists())
            .count()
    }

    /// The samples of a share, grouped by snapshot.
    pub(super) fn snapshots(&self, share: Option<Share>) -> impl Iterator<Item = &[Planned]> {
        let same = |one: &Planned, next: &Planned| {
            (one.source, one.snapshot) == (next.source, next.snapshot)
        };
        share.unwrap_or_default().part(self.samples.chunk_by(same))
    }

    fn read(path: &Path) -> Result<Self> {
        let text = files::read_text(path)?;
        let damaged = |problem: String| {
            Error::file(path, "plan", problem, "delete it: the same plan is then created again")
        };
        let plan: Self =
            serde_json::from_str(&text).map_err(|problem| damaged(problem.to_string()))?;
        let sources = plan.configuration.sources.len();
        match plan.samples.iter().find(|planned| planned.source >= sources) {
            Some(planned) => Err(damaged(format!("there is no source {}", planned.source))),
            None => Ok(plan),
        }
    }

    /// Write the plan, unless another process has written one.
    fn write(&self, path: &Path) -> Result<()> {
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(Error::io(folder))?;
        }
        let text = serde_json::to_string(self).map_err(|problem| {
            Error::file(path, "plan", problem.to_string(), "report this as a bug")
        })?;
        let output = files::Output::create(path)?;
        std::fs::write(output.temporary(), text).map_err(Error::io(path))?;
        output.finish_if_new()
    }
}

impl Planned {
    /// The file of the sample, relative to the folder of the data set.
    pub fn file(&self) -> PathBuf {
        let Self { source, snapshot, corner: [row, col], .. } = self;
        PathBuf::from(format!("samples/{source}-{snapshot:03}-{row}-{col}.nc"))
    }
}

impl Share {
    /// Share `number` of `of` shares, counted from 1.
    ///
    /// # Errors
    /// Returns an error if `number` is not between 1 and `of`.
    pub fn new(number: usize, of: usize) -> Result<Self> {
        if (1..=of).contains(&number) {
            return Ok(Self { number, of });
        }
        let found = format!("{number}/{of}");
        Err(Error::out_of_range("share", found, "NUMBER/OF with NUMBER from 1 to OF, such as 3/8"))
    }

    /// The elements of this share.
    pub(crate) fn part<T>(self, all: impl Iterator<Item = T>) -> impl Iterator<Item = T> {
        all.skip(self.number - 1).step_by(self.of)
    }
}

impl Default for Share {
    /// Everything.
    fn default() -> Self {
        Self { number: 1, of: 1 }
    }
}

impl FromStr for Share {
    type Err = Error;

    /// Parse a share such as `3/8`, the third of eight.
    fn from_str(text: &str) -> Result<Self> {
        let number = |text: &str| text.trim().parse().unwrap_or(0);
        let (part, of) = text.split_once('/').unwrap_or_default();
        Self::new(number(part), number(of))
    }
}
