//! `deepct regrid`: fields on the grid of another file.

use crate::cloud::Selection;
use crate::global::Global;
use crate::outcome::Outcome;
use crate::summary::{Form, Summary};
use deepct_core::files::check_output;
use deepct_core::grid::Volume;
use deepct_core::io::{
    Content, Provenance, read_grid, read_lineage, write_cloud, write_mask, write_volume,
};
use deepct_core::optics::extinction;
use deepct_core::{Error, Result};
use std::path::{Path, PathBuf};

/// Resample a cloud, a volume or a mask onto the grid of another file
///
/// Water and extinction are averaged over larger voxels, which conserves them, and interpolated
/// linearly between the centres of voxels for smaller ones. A voxel is inside the new mask if a part
/// of it is inside the old one. The expected error of an estimate is left out, as the errors of
/// neighbouring voxels depend on each other.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// File of a cloud, a volume or a mask
    file: PathBuf,
    /// Grid: the file of a cloud, volume or mask, or a TOML file (see `deepct formats`)
    #[arg(long, value_name = "C.nc|GRID.toml")]
    like: PathBuf,
    /// File to write
    #[arg(long, value_name = "V.nc")]
    out: PathBuf,
    #[command(flatten)]
    selection: Selection,
    #[command(flatten)]
    form: Form,
}

pub(crate) fn run(args: &Args, global: &Global) -> Result<Outcome> {
    check_output(&args.out)?;
    let grid = read_grid(&args.like)?;
    let (content, lineage) = match args.selection.own_content(&args.file)? {
        Some(content) => (content, read_lineage(&args.file)),
        None => {
            let (cloud, lineage) = args.selection.import_as_it_is(&args.file, global)?;
            (Content::Cloud(cloud), lineage)
        }
    };
    let name = args.file.file_name().unwrap_or_default().to_string_lossy();
    let lineage = lineage.then(&format!("regrid {name}"));
    let provenance = |title: &str| Provenance {
        title: title.into(),
        configuration: toml::to_string(&Resolved { file: &args.file, like: &args.like })
            .expect("paths"),
        seed: global.seed,
        lineage: lineage.clone(),
    };
    match content {
        Content::Cloud(cloud) => {
            let resampled = cloud.resampled(&grid)?;
            args.say_change(&extinction(&cloud)?, &extinction(&resampled)?, global);
            write_cloud(&args.out, &resampled, &provenance("Cloud on another grid"))?;
        }
        Content::Estimate(estimate) => {
            let resampled = estimate.extinction.resampled(&grid);
            args.say_change(&estimate.extinction, &resampled, global);
            write_volume(&args.out, &resampled, &provenance("Extinction on another grid"))?;
        }
        Content::Mask(mask) => {
            write_mask(&args.out, &mask.resampled(&grid), &provenance("Mask on another grid"))?;
            args.form.print(&Change { out: &args.out, extinction: None }, global);
        }
        Content::Images(_) => {
            let remedy = "give a cloud, a volume or a mask";
            return Err(Error::file(
                &args.file,
                "radiance",
                "are images, which have no grid",
                remedy,
            ));
        }
    }
    Ok(Outcome::Success)
}

impl Args {
    /// Print how much of the extinction, summed over the volume, is on the new grid.
    fn say_change(&self, before: &Volume, after: &Volume, global: &Global) {
        let amount = |volume: &Volume| {
            let sum: f64 = volume.values.iter().map(|value| f64::from(*value)).sum();
            sum * volume.grid.spacing.element_product()
        };
        let (before, after) = (amount(before), amount(after));
        let extinction = (before > 0.0).then(|| after / before);
        self.form.print(&Change { out: &self.out, extinction }, global);
    }
}

/// What is printed about a field on another grid.
#[derive(Debug, serde::Serialize)]
struct Change<'a> {
    out: &'a Path,
    /// The extinction, summed over the volume, divided by that on the old grid, if there is any.
    extinction: Option<f64>,
}

impl Summary for Change<'_> {
    fn say(&self) {
        if let Some(share) = self.extinction {
            say!("extinction  {:.2} % of that of the old grid", 100.0 * share);
        }
    }
}

/// Parameters of the run, recorded in the output file.
#[derive(Debug, serde::Serialize)]
struct Resolved<'a> {
    file: &'a Path,
    like: &'a Path,
}
