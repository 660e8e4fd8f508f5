//! Which samples a data set will have, and how they are shared out.

use super::{DatasetSettings, Manifest, Split};
use crate::cloud::{self, Cloud, IsolateSettings, Piece};
use crate::error::{Error, Result};
use crate::files;
use crate::io::import::{ImportSettings, import_cloud};
use crate::math::DVec3;
use crate::rng::{Purpose, Rng, RngExt, stream};
use serde::{Deserialize, Serialize};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// `plan.json`: the samples that a data set will have. The first process that works on a
/// data set writes it, all others read it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// The settings that the samples are chosen and made by.
    pub configuration: DatasetSettings,
    /// The samples, by source, snapshot and place.
    pub samples: Vec<Planned>,
}

/// A sample that is to be made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Planned {
    /// Number of its source in the settings, from 0.
    pub source: usize,
    /// The index of the snapshot.
    pub snapshot: usize,
    /// As [`Sample::corner`](super::Sample::corner).
    pub corner: [i64; 2],
}

/// One of several equal parts of a data set, each made by a process of its own: one of eight
/// is every eighth snapshot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Share {
    number: usize,
    of: usize,
}

/// What the data set in `folder` will hold: as its plan tells, or chosen from the
/// simulations and written there now. `progress` is called after every snapshot that is read.
///
/// # Errors
/// A folder with a data set of other settings; a simulation that cannot be read; settings
/// out of range.
pub fn plan(
    settings: &DatasetSettings,
    simulations: &Path,
    folder: &Path,
    progress: &(dyn Fn(u64) + Sync),
) -> Result<Plan> {
    // Nothing is left behind by settings that cannot work.
    settings.check(simulations)?;
    if Manifest::path(folder).exists() {
        same(settings, &Manifest::read(folder)?.configuration, &Manifest::path(folder))?;
    }
    let path = Plan::path(folder);
    if !path.exists() {
        let mut samples = Vec::new();
        for (source, snapshot) in settings.snapshots() {
            let pieces = pieces(settings, simulations, source, snapshot)?;
            let planned = |piece: Piece| Planned { source, snapshot, corner: piece.corner };
            samples.extend(pieces.into_iter().map(planned));
            progress(1);
        }
        let samples = count_out(settings, samples)?;
        Plan { configuration: settings.clone(), samples }.write(&path)?;
    }
    // Another process may have been faster, with other settings.
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
        "differs from the one asked for",
        "choose another folder, or the settings that the data set was begun with",
    ))
}

/// The clouds or squares of one snapshot that may be taken, in the order of their places.
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

/// Draw as many samples of each split as are asked for.
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
                    "at most the {} that its sources have: name more snapshots, or let more be \
                     taken of each",
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

/// Leave out what is beyond `most`, at random.
fn thin<T>(items: &mut Vec<T>, most: usize, rng: &mut impl Rng) {
    while items.len() > most {
        items.remove(rng.random_range(0..items.len()));
    }
}

/// The whole field of one snapshot, on the samples' levels.
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
    import_cloud(simulation, &import)
}

impl Plan {
    /// Where the plan of a data set's folder is.
    pub fn path(folder: &Path) -> PathBuf {
        folder.join("plan.json")
    }

    /// Number of samples of a split.
    pub fn count(&self, split: Split) -> usize {
        let splits =
            self.samples.iter().map(|planned| self.configuration.sources[planned.source].split);
        splits.filter(|own| *own == split).count()
    }

    /// Number of samples that a share has to make, as they are not in the folder.
    pub fn missing(&self, folder: &Path, share: Option<Share>) -> usize {
        self.snapshots(share)
            .flatten()
            .filter(|planned| !folder.join(planned.file()).exists())
            .count()
    }

    /// The samples of each snapshot of a share.
    pub(super) fn snapshots(&self, share: Option<Share>) -> impl Iterator<Item = &[Planned]> {
        let Share { number, of } = share.unwrap_or(Share { number: 1, of: 1 });
        self.samples
            .chunk_by(|one, next| (one.source, one.snapshot) == (next.source, next.snapshot))
            .skip(number - 1)
            .step_by(of)
    }

    fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(Error::io(path))?;
        let damaged = |problem: String| {
            Error::file(path, "plan", problem, "delete it: the same plan will be made again")
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
        let temporary = files::temporary_beside(path)?;
        std::fs::write(&temporary, text).map_err(Error::io(path))?;
        match temporary.persist_noclobber(path) {
            Err(problem) if problem.error.kind() != ErrorKind::AlreadyExists => {
                Err(Error::io(path)(problem.error))
            }
            _ => Ok(()),
        }
    }
}

impl Planned {
    /// Its file, relative to the data set's folder.
    pub fn file(&self) -> PathBuf {
        let Self { source, snapshot, corner: [row, col] } = self;
        PathBuf::from(format!("samples/{source}-{snapshot:03}-{row}-{col}.nc"))
    }
}

impl Share {
    /// Part `number`, from 1, `of` so many.
    ///
    /// # Errors
    /// A number that is not from 1 to `of`.
    pub fn new(number: usize, of: usize) -> Result<Self> {
        if (1..=of).contains(&number) {
            return Ok(Self { number, of });
        }
        let found = format!("{number}/{of}");
        Err(Error::out_of_range("share", found, "NUMBER/OF with a number from 1 to OF, as 3/8"))
    }
}

impl FromStr for Share {
    type Err = Error;

    /// As `3/8`, the third of eight.
    fn from_str(text: &str) -> Result<Self> {
        let number = |text: &str| text.trim().parse().unwrap_or(0);
        let (part, of) = text.split_once('/').unwrap_or_default();
        Self::new(number(part), number(of))
    }
}
