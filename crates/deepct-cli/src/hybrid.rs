//! `deepct hybrid`: inversion that starts from the estimate of the network.

use crate::config::Values;
use crate::field::{Field, given_mask, identity, part_of};
use crate::files::lineage;
use crate::global::Global;
use crate::inversion::{Flags, InvertSettings, Job, read_bands};
use crate::light::resolve_light;
use crate::network::{NetworkFlags, network_grid};
use crate::outcome::Outcome;
use crate::summary;
use deepct_core::carve::carve;
use deepct_core::grid::{Grid, Volume};
use deepct_core::inversion::{InversionSettings, Radius, network_bands, network_estimate};
use deepct_core::io::{ImagesFile, Provenance};
use deepct_core::network::{Estimate, Estimator};
use deepct_core::scene::{Observation, Tile};
use deepct_core::{Error, Result, conv};
use std::path::{Path, PathBuf};

/// Reconstruct the extinction of a cloud by an inversion that starts from the network estimate
///
/// The scene illumination (Sun, wavelength, droplet optics, molecular atmosphere, surface) is read
/// from the file of the images. Options may replace its values; the defaults listed below apply
/// only to values that the file lacks. Every replaced or assumed value is reported.
///
/// `deepct config invert` prints the settings of the solver, the optimiser and its stopping
/// criteria.
///
/// Fields of more than 144 columns along a side are computed and written tile by tile, each with the
/// columns around it. If the command is interrupted, repeat it to continue.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// File of images, or one file of images of the same cloud for each band: the network estimates the
    /// extinction from the first one
    #[arg(required = true)]
    images: Vec<PathBuf>,
    #[command(flatten)]
    network: NetworkFlags,
    /// Run the quick hybrid: 12 steps with one correction by the accurate solver
    #[arg(long, conflicts_with = "iterations")]
    quick: bool,
    #[command(flatten)]
    flags: Flags,
}

/// Number of rows and columns of a tile of a large field.
const TILE: usize = 96;

/// Columns around a tile that are computed with it. Lines of sight at 45 degrees cross them within the
/// height of a cumulus, and the light that they exchange with the tile is small.
const HALO: usize = 24;

pub(crate) fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let (mut settings, given) = args.flags.resolve()?;
    if args.quick {
        settings.inversion = settings.inversion.quick();
    }
    let network = args.network.estimator(conv::Settings::default(), global.force)?;
    let first = &args.images[0];
    let file = ImagesFile::open_first_band(first)?;
    let grid = network_grid(&network, args.network.grid()?, &file);
    let grid = grid.map_err(Error::in_file(first))?;
    let run = Run { args, global, network, settings, given };
    let [_, rows, cols] = grid.shape;
    match rows.max(cols) > TILE + 2 * HALO {
        true => run.field(grid),
        false => run.whole(grid),
    }
}

/// What a field and its tiles have in common.
struct Run<'a> {
    args: &'a Args,
    global: &'a Global,
    network: Estimator,
    settings: InvertSettings,
    /// Values of the scene illumination that replace those of the images.
    given: Values,
}

impl<'a> Run<'a> {
    fn whole(&self, grid: Grid) -> Result<Outcome> {
        let Self { args, global, network, .. } = self;
        let bands = read_bands(&args.images, &self.given, global)?;
        let start = self.start(&bands, &grid).map_err(Error::in_file(&args.images[0]))?;
        for band in network_bands(network, &bands) {
            args.network.warn_of_unusual_images(network, band, &start)?;
        }
        args.network.warn_of_ends(&start);
        self.job(bands, start).run(global)
    }

    /// The inversion of a field tile by tile.
    fn field(&self, grid: Grid) -> Result<Outcome> {
        let Self { args, global, network, .. } = self;
        let [images] = &args.images[..] else {
            let most = format!("1 for a field of more than {} columns", TILE + 2 * HALO);
            return Err(Error::out_of_range("number of files of images", args.images.len(), most));
        };
        let InversionSettings { radius, members, .. } = self.settings.inversion;
        let (is_given, none) = (radius == Radius::Given, members == 0);
        for (name, is_usual, usual) in
            [("inversion.radius", is_given, "given"), ("inversion.members", none, "0")]
        {
            if !is_usual {
                let range = format!("{usual} for a field of more than {} columns", TILE + 2 * HALO);
                return Err(Error::out_of_range(name, format!("not {usual}"), range));
            }
        }
        let mut file = ImagesFile::open(images)?;
        let mut corner = file.part(0..1, 0..1)?;
        resolve_light(&mut corner, images, &self.given, global.quiet)?;
        let light = corner.light.clone();
        let mask = args.flags.mask().map(|path| given_mask(path, &grid)).transpose()?;
        let tiles = Tile::all(file.views(), &grid, TILE, HALO)?;
        let configuration = self.configuration(corner, &grid)?;
        let provenance = Provenance {
            title: "Extinction by inversion".into(),
            configuration,
            seed: global.seed,
            lineage: lineage("hybrid", images),
        };
        if args.flags.truth.is_some() {
            note!("deepct: a field in tiles is not compared with --truth: use `deepct score`");
        }
        let out = args.flags.out();
        let mut field = Field { file, images, grid, tiles, out, provenance };
        let quiet = global.silent();
        let total = field.compute(global, |observation, tile| {
            let observation = Observation { light: light.clone(), ..observation.clone() };
            let start = self.start(std::slice::from_ref(&observation), &tile.around)?;
            let mask = match &mask {
                Some(mask) => part_of(mask, tile)?,
                None => carve(&observation, &tile.around, &self.settings.carve)?.mask,
            };
            let extinction = self.job(vec![observation], start).tile(&quiet, &mask, &grid)?;
            Ok(extinction.into())
        })?;
        if let Some((observation, tile)) = field.thickest(&total)? {
            let start = self.start(std::slice::from_ref(&observation), &tile.around)?;
            args.network.warn_of_unusual_images(network, &observation, &start)?;
            args.network.warn_of_ends(&start);
        }
        let summary = Summary { images, out, shape: grid.shape, largest: total.largest };
        args.flags.form.print(&summary, global);
        Ok(Outcome::Success)
    }

    /// The parameters of a run and its inputs, which identify the tiles.
    fn configuration(&self, corner: Observation, grid: &Grid) -> Result<String> {
        let Args { images, network, flags, .. } = self.args;
        let others = [Some(network.weights.as_path()), flags.mask()];
        let inputs = images.iter().map(PathBuf::as_path).chain(others.into_iter().flatten());
        let inputs = identity(inputs, grid)?;
        let grid = grid.part(0..1, 0..1)?;
        let start = Volume::constant(grid, 0.0).into();
        let job = self.job(vec![corner], start);
        Ok(format!("inputs = {inputs:?}\n{}", job.resolved(&self.settings)))
    }

    /// The estimate of the network, from which the inversion starts.
    fn start(&self, bands: &[Observation], grid: &Grid) -> Result<Estimate> {
        network_estimate(&self.network, network_bands(&self.network, bands), Some(grid))
    }

    fn job(&self, bands: Vec<Observation>, start: Estimate) -> Job<'a> {
        let args = self.args;
        Job {
            quick: args.quick,
            what: "hybrid",
            images: &args.images,
            flags: &args.flags,
            settings: self.settings.clone(),
            bands,
            grid: start.extinction.grid,
            start: start.into(),
            init: args.network.weights.display().to_string(),
        }
    }
}

/// What is printed about a field.
#[derive(Debug, serde::Serialize)]
struct Summary<'a> {
    images: &'a Path,
    out: &'a Path,
    /// `[z, y, x]`.
    shape: [usize; 3],
    /// Largest extinction (1/km).
    largest: f32,
}

impl summary::Summary for Summary<'_> {
    fn say(&self) {
        let [levels, rows, cols] = self.shape;
        say!("grid     {levels} levels of {rows} x {cols} columns");
        say!("largest  {:.3} km-1", self.largest);
    }
}
