//! `deepct infer`: extinction of a cloud from its images, by the network.

use crate::config;
use crate::defaults;
use crate::field::{Field, given_mask, identity, part_of};
use crate::files::{Files, lineage};
use crate::global::Global;
use crate::network::{NetworkFlags, network_grid};
use crate::outcome::Outcome;
use crate::summary;
use deepct_core::carve::{CarveSettings, carve};
use deepct_core::conv;
use deepct_core::grid::{Grid, Mask, Volume};
use deepct_core::inversion::network_estimate;
use deepct_core::io::{ImagesFile, Provenance, read_observations, write_estimate};
use deepct_core::network::Estimator;
use deepct_core::scene::{Observation, Tile};
use deepct_core::{Error, Result};
use std::path::{Path, PathBuf};

/// Reconstruct the extinction of a cloud with the network
///
/// Weights for several bands need one file of images for each band with --out, in the order of the
/// weights (`deepct weights inspect`), or one file with a dimension wavelength; they may also estimate the
/// effective radius.
///
/// Fields of more than 768 columns along a side are computed and written tile by tile, in little memory.
/// If the command is interrupted, repeat it to continue.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    files: Files,
    #[command(flatten)]
    network: NetworkFlags,
    /// Set the extinction to zero outside this mask
    #[arg(long, value_name = "M.nc", conflicts_with = "carve")]
    mask: Option<PathBuf>,
    /// Set the extinction to zero outside the mask that `deepct carve` finds
    #[arg(long)]
    carve: bool,
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
    let settings: InferSettings = args.settings.resolve(defaults::INFER)?;
    let convolution = settings.convolution.resolve()?;
    let rounded = convolution.precision != conv::Precision::Single;
    let single = conv::Settings { precision: conv::Precision::Single, ..convolution };
    let run = Run {
        args,
        global,
        network: args.network.estimator(convolution, global.force)?,
        exact: rounded.then(|| args.network.estimator(single, global.force)).transpose()?,
        grid: args.network.grid()?,
        settings,
    };
    args.files.each_scene(global, |images, out| run.scene(images, out))?;
    Ok(Outcome::Success)
}

/// Number of rows and columns of a tile.
const TILE: usize = 768;

/// What all files have in common.
struct Run<'a> {
    args: &'a Args,
    global: &'a Global,
    network: Estimator,
    /// The network in single precision, if the other one is not.
    exact: Option<Estimator>,
    grid: Option<Grid>,
    settings: InferSettings,
}

impl Run<'_> {
    /// Estimate the extinction for the images of one scene, and write it.
    fn scene(&self, files: &[PathBuf], out: &Path) -> Result<Summary> {
        let images = &*files[0];
        let file = ImagesFile::open_first_band(images)?;
        let grid = network_grid(&self.network, self.grid, &file);
        let grid = grid.map_err(Error::in_file(images))?;
        let tiles = Tile::all(file.views(), &grid, TILE, self.network.halo(&grid))?;
        if tiles.len() > 1 {
            self.check_one_band(files)?;
            let Args { network, mask, .. } = self.args;
            let inputs = [Some(images), Some(&network.weights), mask.as_deref()];
            let inputs = identity(inputs.into_iter().flatten(), &grid)?;
            let provenance = self.provenance(files, &inputs);
            let file = ImagesFile::open(images)?;
            return self.field(Field { file, images, grid, tiles, out, provenance });
        }
        let Self { args, network, .. } = self;
        let bands = files.iter().map(read_observations).collect::<Result<Vec<_>>>()?.concat();
        let observation = &bands[0];
        let estimate = |network| network_estimate(network, &bands, Some(&grid));
        let mut estimated = estimate(network).map_err(Error::in_file(images))?;
        let exact = self.exact.as_ref().map(estimate).transpose()?;
        let rounding =
            exact.map(|exact| Rounding::between(&estimated.extinction, &exact.extinction));
        let mask = match &args.mask {
            Some(path) => Some(given_mask(path, &grid)?),
            None => self.carved(images, observation, &grid)?,
        };
        for band in &bands {
            args.network.warn_of_unusual_images(network, band, &estimated)?;
        }
        args.network.warn_of_ends(&estimated);
        if let Some(mask) = mask {
            estimated.apply(&mask)?;
        }
        write_estimate(out, &estimated, Some(observation), &self.provenance(files, &[]))?;
        Ok(Summary {
            images: images.into(),
            out: out.into(),
            shape: grid.shape,
            altitudes_km: [grid.lower().z, grid.upper().z],
            largest: estimated.extinction.values.iter().copied().fold(0.0, f32::max),
            effective_radius: estimated.mean_effective_radius(),
            expected_epsilon: estimated.expected_relative_error(),
            rounding,
        })
    }

    /// Returns an error unless a field in tiles has one band and the extinction alone is estimated.
    fn check_one_band(&self, files: &[PathBuf]) -> Result<()> {
        let bands = self.network.bands().max(files.len());
        if bands > 1 {
            let range = format!("1 for a field of more than {TILE} columns: give a smaller --grid");
            return Err(Error::out_of_range("number of bands", bands, range));
        }
        if self.network.weights().has_effective_radius() {
            let range = format!(
                "of the extinction alone for a field of more than {TILE} columns: give a smaller --grid"
            );
            return Err(Error::out_of_range("weights", "of the effective radius", range));
        }
        Ok(())
    }

    /// Estimate the extinction tile by tile.
    fn field(&self, mut field: Field) -> Result<Summary> {
        let Self { args, network, global, .. } = self;
        let mask = args.mask.as_deref().map(|path| given_mask(path, &field.grid)).transpose()?;
        let images = field.images;
        let total = field.compute(global, |observation, tile| {
            let one = std::slice::from_ref(observation);
            let mut estimate = network_estimate(network, one, Some(&tile.around))?;
            let mask = match &mask {
                Some(mask) => Some(part_of(mask, tile)?),
                None => self.carved(images, observation, &tile.around)?,
            };
            mask.map_or(Ok(()), |mask| estimate.apply(&mask))?;
            Ok(estimate)
        })?;
        if let Some((observation, tile)) = field.thickest(&total)? {
            let one = std::slice::from_ref(&observation);
            let estimate = network_estimate(network, one, Some(&tile.around))?;
            args.network.warn_of_unusual_images(network, &observation, &estimate)?;
            args.network.warn_of_ends(&estimate);
        }
        Ok(Summary {
            images: images.into(),
            out: field.out.into(),
            shape: field.grid.shape,
            altitudes_km: [field.grid.lower().z, field.grid.upper().z],
            largest: total.largest,
            effective_radius: None,
            expected_epsilon: total.expected_relative_error(),
            rounding: None,
        })
    }

    /// The mask that the images permit, if it is requested.
    fn carved(&self, images: &Path, seen: &Observation, grid: &Grid) -> Result<Option<Mask>> {
        if !self.args.carve {
            return Ok(None);
        }
        let carved = carve(seen, grid, &CarveSettings::default());
        let carved = carved.map_err(Error::in_file(images))?;
        if let Some(warning) = carved.warning() {
            note!("deepct: warning: {}: {warning}", images.display());
        }
        Ok(Some(carved.mask))
    }

    /// The provenance of the output, with what identifies the inputs if the run can be resumed.
    fn provenance(&self, images: &[PathBuf], inputs: &[String]) -> Provenance {
        let Self { args, network, settings, .. } = self;
        let weights = network.weights();
        let resolved = Resolved {
            images: &images[0],
            other_bands: &images[1..],
            inputs,
            weights: &args.network.weights,
            formation: weights.formation(),
            trained_on: &weights.training().identity,
            grid: args.network.grid.as_deref(),
            mask: args.mask.as_deref(),
            carve: args.carve,
            settings,
        };
        Provenance {
            title: "Extinction by the network".into(),
            configuration: toml::to_string(&resolved).expect("plain numbers and text"),
            seed: self.global.seed,
            lineage: lineage("infer", &images[0]),
        }
    }
}

/// What is printed about an estimate.
#[derive(Debug, serde::Serialize)]
struct Summary {
    images: PathBuf,
    out: PathBuf,
    /// `[z, y, x]`.
    shape: [usize; 3],
    /// Of the bottom and the top of the grid.
    altitudes_km: [f64; 2],
    /// Largest extinction (1/km).
    largest: f32,
    /// Mean effective radius (um), weighted by the extinction, if the network estimates it.
    #[serde(skip_serializing_if = "Option::is_none")]
    effective_radius: Option<f64>,
    /// The relative error that the network expects.
    expected_epsilon: Option<f64>,
    #[serde(skip)]
    rounding: Option<Rounding>,
}

impl summary::Summary for Summary {
    fn say(&self) {
        let [levels, rows, cols] = self.shape;
        let [low, high] = self.altitudes_km;
        say!("grid     {levels} levels of {rows} x {cols} columns, {low:.3} to {high:.3} km");
        say!("largest  {:.3} km-1", self.largest);
        if let Some(radius) = self.effective_radius {
            say!("radius   {radius:.2} um");
        }
        if self.largest == 0.0 {
            say!("the estimate is empty: the network found no cloud in this grid");
        }
        if let Some(epsilon) = self.expected_epsilon {
            say!("epsilon  {epsilon:.3} expected");
        }
        if let Some(Rounding { largest, root_mean_square }) = self.rounding {
            say!(
                "bfloat16 differs from single precision by at most {:.2} % of the largest value \
                 and by {:.2} % in the root mean square",
                100.0 * largest,
                100.0 * root_mean_square
            );
        }
    }

    fn say_line(&self) {
        let epsilon = self.expected_epsilon.map_or("-".into(), |epsilon| format!("{epsilon:.3}"));
        let Self { out, largest, .. } = self;
        say!("{}  largest {largest:.3} km-1, epsilon {epsilon} expected", out.display());
    }
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

/// Parameters of the run, recorded in the output file.
#[derive(Debug, serde::Serialize)]
struct Resolved<'a> {
    images: &'a Path,
    /// The files of further bands.
    #[serde(skip_serializing_if = "<[_]>::is_empty")]
    other_bands: &'a [PathBuf],
    #[serde(skip_serializing_if = "<[_]>::is_empty")]
    inputs: &'a [String],
    weights: &'a Path,
    formation: Option<&'a str>,
    trained_on: &'a str,
    grid: Option<&'a Path>,
    mask: Option<&'a Path>,
    carve: bool,
    #[serde(flatten)]
    settings: &'a InferSettings,
}
