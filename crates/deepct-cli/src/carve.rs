//! `deepct carve`: the voxels that may contain cloud according to the images.

use crate::files::{Files, lineage};
use crate::global::Global;
use crate::outcome::Outcome;
use crate::summary;
use deepct_core::carve::{CarveSettings, carve};
use deepct_core::grid::Grid;
use deepct_core::io::{Provenance, read_grid, read_observation, write_mask};
use deepct_core::{Error, Result};
use std::path::{Path, PathBuf};

/// Find the voxels of a grid that may contain cloud, by space carving
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    files: Files,
    /// Grid to carve: the file of a cloud or volume, or a TOML file (see `deepct formats`)
    #[arg(long, value_name = "C.nc|GRID.toml")]
    grid: PathBuf,
    /// Radiance (1/sr) above which a pixel is cloudy; by default it is determined for each view from
    /// the histograms of all views
    #[arg(long, value_name = "T", allow_negative_numbers = true)]
    threshold: Option<f32>,
    /// Fraction of the views of a voxel, from 0 to 1, that must see cloud there for the voxel to be
    /// kept
    #[arg(long, default_value_t = CarveSettings::default().agreement, value_name = "A")]
    agreement: f64,
}

pub(crate) fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let settings = CarveSettings { threshold: args.threshold, agreement: args.agreement };
    settings.check()?;
    let grid = read_grid(&args.grid)?;
    args.files
        .each(global, |images, out| carve_file(args, &settings, &grid, images, out, global))?;
    Ok(Outcome::Success)
}

fn carve_file(
    args: &Args,
    settings: &CarveSettings,
    grid: &Grid,
    images: &Path,
    out: &Path,
    global: &Global,
) -> Result<Summary> {
    let observation = read_observation(images)?;
    let carved = carve(&observation, grid, settings).map_err(Error::in_file(images))?;
    if let Some(warning) = carved.warning() {
        note!("deepct: warning: {}: {warning}", images.display());
    }
    let resolved = Resolved {
        images,
        grid: &args.grid,
        thresholds: &carved.thresholds,
        agreement: args.agreement,
    };
    let provenance = Provenance {
        title: "Voxels that may contain cloud".into(),
        configuration: toml::to_string(&resolved).expect("plain numbers and text"),
        seed: global.seed,
        lineage: lineage("carve", images),
    };
    write_mask(out, &carved.mask, &provenance)?;
    Ok(Summary {
        images: images.into(),
        out: out.into(),
        voxels: grid.len(),
        kept: carved.mask.count() as f64 / grid.len() as f64,
        thresholds: carved.thresholds,
    })
}

/// What is printed about a mask.
#[derive(Debug, serde::Serialize)]
struct Summary {
    images: PathBuf,
    out: PathBuf,
    /// Number of voxels of the grid.
    voxels: usize,
    /// Share of the voxels that are inside.
    kept: f64,
    /// Radiance (1/sr) above which a pixel is cloudy, for each view.
    thresholds: Vec<f32>,
}

impl summary::Summary for Summary {
    fn say(&self) {
        let ends = |pick: fn(f32, f32) -> f32| self.thresholds.iter().copied().reduce(pick);
        match (ends(f32::min), ends(f32::max)) {
            (Some(least), Some(most)) if least < most => {
                say!("threshold  {least:.5} to {most:.5} sr-1, by view");
            }
            (least, _) => say!("threshold  {:.5} sr-1", least.unwrap_or(0.0)),
        }
        say!("kept       {:.4} of {} voxels", self.kept, self.voxels);
    }

    fn say_line(&self) {
        say!("{}  {:.4} of {} voxels", self.out.display(), self.kept, self.voxels);
    }
}

/// Parameters of the run, recorded in the output file.
#[derive(Debug, serde::Serialize)]
struct Resolved<'a> {
    images: &'a Path,
    grid: &'a Path,
    thresholds: &'a [f32],
    agreement: f64,
}
