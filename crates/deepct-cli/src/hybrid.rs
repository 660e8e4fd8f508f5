//! `deepct hybrid`: the network, then physics from its answer.

use crate::global::Global;
use crate::inversion::{Flags, Job};
use crate::light::light_of;
use crate::outcome::Outcome;
use deepct_core::io::{load_weights, read_observation};
use deepct_core::network::Network;
use deepct_core::{Error, Result};
use std::path::PathBuf;

/// Reconstruct the extinction of a cloud with the network, then by physics from its answer
///
/// `deepct config invert` prints the settings.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Images
    images: PathBuf,
    /// Weights: a file, or the name of built-in ones (cloudct-10, pearls-32)
    #[arg(long, value_name = "FILE|NAME")]
    weights: PathBuf,
    /// Take 12 steps only, corrected once by the accurate solver
    #[arg(long, conflicts_with = "iterations")]
    quick: bool,
    #[command(flatten)]
    flags: Flags,
}

pub(crate) fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let (mut settings, given) = args.flags.resolve()?;
    if args.quick {
        settings.inversion = settings.inversion.quick();
    }
    let network = Network::new(&load_weights(&args.weights)?)?;
    let observation = read_observation(&args.images)?;
    let start = observation
        .imaging_geometry()
        .and_then(|geometry| network.estimate(&observation.images, &geometry))
        .map_err(Error::in_file(&args.images))?;
    let job = Job {
        quick: args.quick,
        what: "hybrid",
        images: &args.images,
        flags: &args.flags,
        settings,
        light: light_of(&observation, &args.images, &given, global.quiet)?,
        observation,
        grid: start.extinction.grid,
        start: start.into(),
        init: args.weights.display().to_string(),
    };
    job.run(global)?;
    Ok(Outcome::Success)
}
