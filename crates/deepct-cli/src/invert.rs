//! `deepct invert`: a cloud from its images, by inversion of the radiative transfer.

use crate::global::Global;
use crate::inversion::{Flags, Job, read_bands};
use crate::outcome::Outcome;
use deepct_core::inversion::Start;
use deepct_core::io::{read_estimate, read_grid};
use deepct_core::{Error, Result};
use std::path::PathBuf;

/// Reconstruct the extinction of a cloud by inversion: fit simulated images to the given ones
///
/// The scene illumination (Sun, wavelength, droplet optics, molecular atmosphere, surface) is read
/// from the file of the images. Options may replace its values; the defaults listed below apply
/// only to values that the file lacks. Every replaced or assumed value is reported.
///
/// With --radius, the effective radius is retrieved too. A second file of images, in a shortwave-infrared
/// band that droplets absorb, determines it much better; the extinction and the mask are those of the
/// first file.
///
/// `deepct config invert` prints the settings of the solver, the optimiser and its stopping
/// criteria.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// File of images, or one file of images of the same cloud for each band
    #[arg(required = true)]
    images: Vec<PathBuf>,
    /// Grid of the estimate: the file of a cloud or volume, or a TOML file (see `deepct formats`)
    #[arg(long, value_name = "C.nc|GRID.toml")]
    grid: PathBuf,
    /// Start: an extinction (1/km) for the whole mask, `auto` for the uniform extinction that fits
    /// the images best, or a file of an extinction
    #[arg(
        long,
        default_value = "0.01",
        value_name = "V.nc|NUMBER|auto",
        allow_hyphen_values = true
    )]
    init: String,
    #[command(flatten)]
    flags: Flags,
}

pub(crate) fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let (settings, given) = args.flags.resolve()?;
    let start = start(&args.init)?;
    let bands = read_bands(&args.images, &given, global)?;
    let job = Job {
        quick: false,
        what: "invert",
        images: &args.images,
        flags: &args.flags,
        settings,
        bands,
        grid: read_grid(&args.grid)?,
        start,
        init: args.init.clone(),
    };
    job.run(global)
}

fn start(init: &str) -> Result<Start> {
    if init == "auto" {
        return Ok(Start::Search);
    }
    match init.parse::<f64>() {
        Ok(extinction) if extinction.is_finite() && extinction > 0.0 => {
            Ok(Start::Constant(extinction))
        }
        Ok(extinction) => Err(Error::out_of_range("--init", extinction, "positive (1/km)")),
        Err(_) => Ok(read_estimate(init)?.into()),
    }
}
