//! `deepct infer`: extinction of a cloud from its images, by the network.

use crate::config;
use crate::defaults;
use crate::global::Global;
use crate::network::NetworkFlags;
use crate::outcome::Outcome;
use deepct_core::carve::{CarveSettings, carve};
use deepct_core::conv;
use deepct_core::files::check_output;
use deepct_core::grid::{Grid, Mask, Volume};
use deepct_core::io::{Provenance, read_mask, read_observation, write_estimate};
use deepct_core::network::{Estimate, Estimator};
use deepct_core::scene::Observation;
use deepct_core::{Error, Result};
use std::path::{Path, PathBuf};

/// Reconstruct the extinction of a cloud with the network
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// File of images
    images: PathBuf,
    #[command(flatten)]
    network: NetworkFlags,
    /// Set the extinction to zero outside this mask
    #[arg(long, value_name = "M.nc", conflicts_with = "carve")]
    mask: Option<PathBuf>,
    /// Set the extinction to zero outside the mask that `deepct carve` finds
    #[arg(long)]
    carve: bool,
    /// File of the extinction to write
    #[arg(long, value_name = "V.nc")]
    out: PathBuf,
    #[command(flatten)]
    settings: config::Settings,
}

/// The settings of a run.
#[derive(Debug, serde::Deserialize, serde::Serialize)]
#[serde(deny_unknown_fields)]
struct InferSettings {
    convolution: ConvolutionSettings,
}

#[derive(Debug, serde::Deserialize, serde::Serialize)]
#[serde(deny_unknown_fields)]
struct ConvolutionSettings {
    algorithm: String,
    kernel: String,
    precision: String,
    memory_mib: usize,
}

impl ConvolutionSettings {
    fn resolve(&self) -> Result<conv::Settings> {
        let chosen = |name: &str| (name != "auto").then(|| name.to_string());
        let kernel = chosen(&self.kernel).map(|name| conv::Kernel::from_name(&name)).transpose()?;
        let algorithm = chosen(&self.algorithm);
        let algorithm = algorithm.map(|name| conv::Algorithm::from_name(&name)).transpose()?;
        Ok(conv::Settings {
            kernel: kernel.unwrap_or_else(conv::Kernel::best),
            algorithm,
            precision: conv::Precision::from_name(&self.precision)?,
            memory: self.memory_mib.saturating_mul(1 << 20),
        })
    }
}

pub(crate) fn run(args: &Args, global: &Global) -> Result<Outcome> {
    check_output(&args.out)?;
    let settings: InferSettings = args.settings.resolve(defaults::INFER)?;
    let convolution = settings.convolution.resolve()?;
    let network = args.network.estimator(convolution)?;
    let grid = args.network.grid()?;
    let observation = read_observation(&args.images)?;
    let mut estimate =
        infer(&network, &observation, grid.as_ref()).map_err(Error::in_file(&args.images))?;
    let rounding = match convolution.precision {
        conv::Precision::Single => None,
        _ => {
            let single = conv::Settings { precision: conv::Precision::Single, ..convolution };
            let exact = infer(&args.network.estimator(single)?, &observation, grid.as_ref())?;
            Some(Rounding::between(&estimate.extinction, &exact.extinction))
        }
    };
    let mask = find_mask(args, &observation, &estimate.extinction)?;
    args.network.warn_of_unusual_images(&network, &observation, &estimate)?;
    args.network.warn_of_ends(&estimate);
    if let Some(mask) = mask {
        mask.apply(&mut estimate.extinction)?;
        estimate.uncertainty.as_mut().map_or(Ok(()), |values| mask.apply(values))?;
    }
    let weights = network.weights();
    let resolved = Resolved {
        images: &args.images,
        weights: &args.network.weights,
        formation: weights.formation(),
        trained_on: &weights.training().identity,
        grid: args.network.grid.as_deref(),
        mask: args.mask.as_deref(),
        carve: args.carve,
        settings,
    };
    let provenance = Provenance {
        title: "Extinction by the network".into(),
        configuration: toml::to_string(&resolved).expect("plain numbers and text"),
        seed: global.seed,
    };
    write_estimate(&args.out, &estimate, Some(&observation), &provenance)?;
    if !global.quiet {
        let Volume { grid, values } = &estimate.extinction;
        let [levels, rows, cols] = grid.shape;
        let largest = values.iter().copied().fold(0.0, f32::max);
        let (low, high) = (grid.lower().z, grid.upper().z);
        say!("grid     {levels} levels of {rows} x {cols} columns, {low:.3} to {high:.3} km");
        say!("largest  {largest:.3} km-1");
        if largest == 0.0 {
            say!("the estimate is empty: the network found no cloud in this grid");
        }
        if let Some(epsilon) = estimate.expected_relative_error() {
            say!("epsilon  {epsilon:.3} expected");
        }
        if let Some(Rounding { largest, root_mean_square }) = rounding {
            say!(
                "bfloat16 differs from single precision by at most {:.2} % of the largest value \
                 and by {:.2} % in the root mean square",
                100.0 * largest,
                100.0 * root_mean_square
            );
        }
    }
    Ok(Outcome::Success)
}

/// Differences between a volume computed with rounded factors and one in single precision.
#[derive(Debug, Clone, Copy)]
struct Rounding {
    /// Largest difference divided by the largest value.
    largest: f64,
    /// Root mean square of the difference divided by that of the values.
    root_mean_square: f64,
}

impl Rounding {
    fn between(rounded: &Volume, exact: &Volume) -> Self {
        let [mut error, mut value] = [(0.0_f64, 0.0_f64); 2];
        for (rounded, exact) in rounded.values.iter().zip(&exact.values) {
            let (difference, exact) = (f64::from(rounded - exact), f64::from(*exact));
            error = (error.0.max(difference.abs()), error.1 + difference * difference);
            value = (value.0.max(exact.abs()), value.1 + exact * exact);
        }
        Self { largest: error.0 / value.0, root_mean_square: (error.1 / value.1).sqrt() }
    }
}

fn infer(network: &Estimator, observation: &Observation, grid: Option<&Grid>) -> Result<Estimate> {
    network.estimate(&observation.images, &observation.imaging_geometry()?, grid)
}

/// The requested mask, on the grid of the volume.
fn find_mask(args: &Args, observation: &Observation, volume: &Volume) -> Result<Option<Mask>> {
    if args.carve {
        let carved = carve(observation, &volume.grid, &CarveSettings::default());
        let carved = carved.map_err(Error::in_file(&args.images))?;
        if let Some(warning) = carved.warning() {
            note!("deepct: warning: {}: {warning}", args.images.display());
        }
        return Ok(Some(carved.mask));
    }
    let Some(path) = &args.mask else { return Ok(None) };
    let mask = read_mask(path)?;
    if !mask.grid.matches(&volume.grid) {
        let remedy = "carve a mask on the grid of the network's estimate, or use --carve";
        let what = format!("{}: grid of the mask", path.display());
        let text = |grid: &deepct_core::grid::Grid| {
            format!("{:?} voxels of {} km from {} km", grid.shape, grid.spacing, grid.origin)
        };
        return Err(Error::mismatch(what, text(&volume.grid), text(&mask.grid), remedy));
    }
    Ok(Some(mask))
}

/// Parameters of the run, recorded in the output file.
#[derive(Debug, serde::Serialize)]
struct Resolved<'a> {
    images: &'a Path,
    weights: &'a Path,
    formation: Option<&'a str>,
    trained_on: &'a str,
    grid: Option<&'a Path>,
    mask: Option<&'a Path>,
    carve: bool,
    #[serde(flatten)]
    settings: InferSettings,
}
