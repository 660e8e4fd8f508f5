//! `deepct score`: errors of estimates with respect to the truth.

use crate::config::{Values, flattened, single};
use crate::global::Global;
use crate::outcome::Outcome;
use crate::summary::print_json;
use deepct_core::grid::Volume;
use deepct_core::io::{read_cloud, read_light, read_mask};
use deepct_core::metrics::{MaskScores, Scores, check_truth, score, score_mask};
use deepct_core::scene::Light;
use deepct_core::{Error, Result};
use std::path::{Path, PathBuf};

/// Compare volumes and masks with the truth, one row per file
///
/// The columns for volumes are the relative error epsilon, which is the sum of
/// abs(estimate - truth) over the sum of the truth; the mass error delta, which is the sum of
/// (truth - estimate) over the sum of the truth and is positive if extinction is missing; the root
/// mean square error (rmse); and the correlation. --verbose adds vertical profiles.
///
/// The columns for masks are the fraction of all voxels inside the mask (kept), the fraction of the
/// total extinction outside the mask (extinction missed), the fraction of the empty voxels inside
/// the mask (false positive) and the fraction of the cloudy voxels outside it (false negative).
///
/// If a cloud is given by its droplet properties, its extinction is computed with the scene
/// illumination of the first estimate whose file contains one, or else with the default
/// illumination (`deepct config light`).
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// File of the true cloud
    #[arg(long, value_name = "C.nc")]
    truth: PathBuf,
    /// Files of estimated volumes or masks
    #[arg(required = true, value_name = "V.nc")]
    estimates: Vec<PathBuf>,
    /// Print one JSON array with all scores and profiles
    #[arg(long)]
    json: bool,
    /// Replace one value of this scene illumination, such as optics.extinction=mie
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
}

/// The scores of one file.
#[derive(Debug, serde::Serialize)]
struct Row<'a> {
    file: &'a Path,
    #[serde(flatten)]
    scores: Kind,
}

/// Scores by the kind of file.
#[derive(Debug, serde::Serialize)]
#[serde(untagged)]
enum Kind {
    Volume(Scores),
    Mask(MaskScores),
}

pub(crate) fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let light = args.light()?;
    let truth = read_extinction(&args.truth, &light)?;
    check_truth(&truth).map_err(Error::in_file(&args.truth))?;
    let rows = args
        .estimates
        .iter()
        .map(|file| score_file(&truth, file, &light))
        .collect::<Result<Vec<_>>>()?;
    if args.json {
        print_json(&rows);
        return Ok(Outcome::Success);
    }
    print_table(&rows);
    if global.verbose > 0 {
        rows.iter().for_each(print_profile);
    }
    Ok(Outcome::Success)
}

impl Args {
    /// The scene illumination of the images from which the estimates were made.
    fn light(&self) -> Result<Light> {
        let mut light = Light::default();
        for file in &self.estimates {
            if let Some((stated, _)) = read_light(file)? {
                light = stated;
                break;
            }
        }
        let mut values = Values::new();
        for setting in &self.set {
            values.extend(flattened(single(setting)?));
        }
        light.with_values(&values)
    }
}

fn read_extinction(path: &Path, light: &Light) -> Result<Volume> {
    light.extinction(&read_cloud(path)?).map_err(Error::in_file(path))
}

/// Scores a volume, or a mask if the file contains no volume.
fn score_file<'a>(truth: &Volume, file: &'a Path, light: &Light) -> Result<Row<'a>> {
    let scores = match (read_extinction(file, light), read_mask(file)) {
        (Ok(estimate), _) => score(truth, &estimate).map(Kind::Volume),
        (Err(_), Ok(mask)) => score_mask(truth, &mask).map(Kind::Mask),
        (Err(problem), Err(_)) => Err(problem),
    };
    Ok(Row { file, scores: scores.map_err(Error::in_file(file))? })
}

fn print_table(rows: &[Row<'_>]) {
    let width =
        rows.iter().map(|row| row.file.display().to_string().len()).max().unwrap_or(0).max(4);
    if rows.iter().any(|row| matches!(row.scores, Kind::Volume(_))) {
        say!("{:width$}  epsilon    delta  rmse (km-1)  correlation", "file");
    }
    for Row { file, scores } in rows {
        let Kind::Volume(scores) = scores else { continue };
        let correlation =
            scores.correlation.map_or("-".into(), |correlation| format!("{correlation:.4}"));
        say!(
            "{:width$}  {:7.4}  {:7.4}  {:11.4}  {correlation:>11}",
            file.display(),
            scores.relative_error,
            scores.mass_error,
            scores.root_mean_square_error,
        );
    }
    if rows.iter().any(|row| matches!(row.scores, Kind::Mask(_))) {
        say!("{:width$}     kept  extinction missed  false positive  false negative", "file");
    }
    for Row { file, scores } in rows {
        let Kind::Mask(scores) = scores else { continue };
        say!(
            "{:width$}  {:7.4}  {:17.5}  {:14.4}  {:14.4}",
            file.display(),
            scores.kept,
            scores.extinction_missed,
            scores.false_positive,
            scores.false_negative,
        );
    }
}

fn print_profile(row: &Row<'_>) {
    let Kind::Volume(scores) = &row.scores else { return };
    say!("\n{}: mean extinction (km-1) by altitude (km)", row.file.display());
    say!("altitude    truth  estimate  epsilon");
    for level in scores.profile.iter().rev() {
        let error = level.relative_error.map_or("-".into(), |error| format!("{error:.4}"));
        let (altitude, truth, estimate) = (level.altitude, level.truth, level.estimate);
        say!("{altitude:8.3}  {truth:7.3}  {estimate:8.3}  {error:>7}");
    }
}
