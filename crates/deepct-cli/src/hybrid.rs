//! `deepct hybrid`: inversion that starts from the estimate of the network.

use crate::global::Global;
use crate::inversion::{Flags, Job};
use crate::light::resolve_light;
use crate::network::NetworkFlags;
use crate::outcome::Outcome;
use deepct_core::conv;
use deepct_core::io::read_observation;
use deepct_core::{Error, Result};
use std::path::PathBuf;

/// Reconstruct the extinction of a cloud by an inversion that starts from the network estimate
///
/// The scene illumination (Sun, wavelength, droplet optics, molecular atmosphere, surface) is read
/// from the file of the images. Options may replace its values; the defaults listed below apply
/// only to values that the file lacks. Every replaced or assumed value is reported.
///
/// `deepct config invert` prints the settings of the solver, the optimiser and its stopping
/// criteria.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// File of images
    images: PathBuf,
    #[command(flatten)]
    network: NetworkFlags,
    /// Run the quick hybrid: 12 steps with one correction by the accurate solver
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
    let network = args.network.estimator(conv::Settings::default())?;
    let grid = args.network.grid()?;
    let mut observation = read_observation(&args.images)?;
    resolve_light(&mut observation, &args.images, &given, global.quiet)?;
    let start = observation
        .on_ideal_cameras()
        .and_then(|ideal| {
            network.estimate(&ideal.images, &ideal.imaging_geometry()?, grid.as_ref())
        })
        .map_err(Error::in_file(&args.images))?;
    args.network.warn_of_unusual_images(&network, &observation, &start)?;
    args.network.warn_of_ends(&start);
    let job = Job {
        quick: args.quick,
        what: "hybrid",
        images: &args.images,
        flags: &args.flags,
        settings,
        observation,
        grid: start.extinction.grid,
        start: start.into(),
        init: args.network.weights.display().to_string(),
    };
    job.run(global)
}
