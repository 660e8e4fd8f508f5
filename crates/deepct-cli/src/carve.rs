//! `deepct carve`: the voxels that may contain cloud according to the images.

use crate::global::Global;
use crate::outcome::Outcome;
use deepct_core::carve::{CarveSettings, carve};
use deepct_core::files::check_output;
use deepct_core::io::{Provenance, read_grid, read_observation, write_mask};
use deepct_core::{Error, Result};
use std::path::{Path, PathBuf};

/// Find the voxels of a grid that may contain cloud, by space carving
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// File of images
    images: PathBuf,
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
    /// File of the mask to write
    #[arg(long, value_name = "M.nc")]
    out: PathBuf,
}

pub(crate) fn run(args: &Args, global: &Global) -> Result<Outcome> {
    check_output(&args.out)?;
    let settings = CarveSettings { threshold: args.threshold, agreement: args.agreement };
    settings.check()?;
    let observation = read_observation(&args.images)?;
    let grid = read_grid(&args.grid)?;
    let carved = carve(&observation, &grid, &settings).map_err(Error::in_file(&args.images))?;
    if let Some(warning) = carved.warning() {
        note!("deepct: warning: {}: {warning}", args.images.display());
    }
    let resolved = Resolved {
        images: &args.images,
        grid: &args.grid,
        thresholds: &carved.thresholds,
        agreement: args.agreement,
    };
    let provenance = Provenance {
        title: "Voxels that may contain cloud".into(),
        configuration: toml::to_string(&resolved).expect("plain numbers and text"),
        seed: global.seed,
    };
    write_mask(&args.out, &carved.mask, &provenance)?;
    if !global.quiet {
        let share = carved.mask.count() as f64 / grid.len() as f64;
        let ends = |pick: fn(f32, f32) -> f32| carved.thresholds.iter().copied().reduce(pick);
        match (ends(f32::min), ends(f32::max)) {
            (Some(least), Some(most)) if least < most => {
                say!("threshold  {least:.5} to {most:.5} sr-1, by view");
            }
            (least, _) => say!("threshold  {:.5} sr-1", least.unwrap_or(0.0)),
        }
        say!("kept       {:.4} of {} voxels", share, grid.len());
    }
    Ok(Outcome::Success)
}

/// Parameters of the run, recorded in the output file.
#[derive(Debug, serde::Serialize)]
struct Resolved<'a> {
    images: &'a Path,
    grid: &'a Path,
    thresholds: &'a [f32],
    agreement: f64,
}
