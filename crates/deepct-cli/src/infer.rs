//! `deepct infer`: the extinction of a cloud from its images, by the network.

use crate::Outcome;
use crate::global::Global;
use deepct_core::carve::{CarveSettings, carve};
use deepct_core::grid::{Mask, Volume};
use deepct_core::io::{Provenance, load_weights, read_mask, read_observation, write_volume};
use deepct_core::network::Network;
use deepct_core::scene::{Observation, target};
use deepct_core::{Error, Result};
use std::path::{Path, PathBuf};

/// Reconstruct the extinction of a cloud with the network
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Images
    images: PathBuf,
    /// Weights: a file, or the name of built-in ones (cloudct-10, pearls-32)
    #[arg(long, value_name = "FILE|NAME")]
    weights: PathBuf,
    /// Set the extinction to zero outside of this mask
    #[arg(long, value_name = "M.nc", conflicts_with = "carve")]
    mask: Option<PathBuf>,
    /// Set the extinction to zero outside of the mask that `deepct carve` finds
    #[arg(long)]
    carve: bool,
    /// File of the extinction to write
    #[arg(long, value_name = "V.nc")]
    out: PathBuf,
}

pub(crate) fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let network = Network::new(&load_weights(&args.weights)?)?;
    let observation = read_observation(&args.images)?;
    let mut volume = infer(&network, &observation).map_err(Error::in_file(&args.images))?;
    if let Some(mask) = find_mask(args, &observation, &volume)? {
        mask.apply(&mut volume)?;
    }
    let metadata = network.metadata();
    let resolved = Resolved {
        images: &args.images,
        weights: &args.weights,
        formation: &metadata.formation,
        trained_on: &metadata.training.identity,
        mask: args.mask.as_deref(),
        carve: args.carve,
    };
    let provenance = Provenance {
        title: "Extinction by the network".into(),
        configuration: toml::to_string(&resolved).expect("plain numbers and text"),
        seed: global.seed,
    };
    write_volume(&args.out, &volume, &provenance)?;
    if !global.quiet {
        let [levels, rows, cols] = volume.grid.shape;
        let largest = volume.values.iter().copied().fold(0.0, f32::max);
        println!("grid     {levels} levels of {rows} x {cols} columns");
        println!("largest  {largest:.3} km-1");
    }
    Ok(Outcome::Success)
}

fn infer(network: &Network, observation: &Observation) -> Result<Volume> {
    let target = target(&observation.views)?;
    let geometry = observation.geometry();
    network.metadata().check_images(&geometry, target.z, observation.wavelength)?;
    network.infer(&observation.images, [target.x, target.y])
}

/// The mask that was asked for, on the volume's grid.
fn find_mask(args: &Args, observation: &Observation, volume: &Volume) -> Result<Option<Mask>> {
    if args.carve {
        let carved = carve(observation, &volume.grid, &CarveSettings::default());
        return Ok(Some(carved.map_err(Error::in_file(&args.images))?.mask));
    }
    let Some(path) = &args.mask else { return Ok(None) };
    let mask = read_mask(path)?;
    if !mask.grid.matches(&volume.grid) {
        let remedy = "carve a mask on the grid of the network's answer, or use --carve";
        let what = format!("{}: grid of the mask", path.display());
        let text = |grid: &deepct_core::grid::Grid| {
            format!("{:?} voxels of {} km from {} km", grid.shape, grid.spacing, grid.origin)
        };
        return Err(Error::mismatch(what, text(&volume.grid), text(&mask.grid), remedy));
    }
    Ok(Some(mask))
}

/// What the output records of this run.
#[derive(Debug, serde::Serialize)]
struct Resolved<'a> {
    images: &'a Path,
    weights: &'a Path,
    formation: &'a str,
    trained_on: &'a str,
    mask: Option<&'a Path>,
    carve: bool,
}
