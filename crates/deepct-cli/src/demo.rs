//! `deepct demo`: the main job with nothing else given.
//!
//! A cloud of the built-in generator, in air above the sea, seen by the ten views of
//! `cloudct-10` through the noise of a real sensor, carved, reconstructed by the built-in
//! network, scored and drawn.

use crate::Outcome;
use crate::global::Global;
use crate::plot::labels;
use crate::progress::RenderProgress;
use deepct_core::carve::{CarveSettings, carve};
use deepct_core::cloud::{Cloud, CumulusSettings, cumulus};
use deepct_core::grid::{Mask, Volume};
use deepct_core::io::{self, Provenance};
use deepct_core::metrics::{Scores, score};
use deepct_core::network::Network;
use deepct_core::optics::air::Air;
use deepct_core::optics::{DropletSettings, DropletTable, Medium};
use deepct_core::plot::{contact_sheet, volume_figure};
use deepct_core::scene::{Formation, Observation, Scene, Sun, Surface};
use deepct_core::sensor::{Scale, Sensor, sense};
use deepct_core::transport::{OrdinatesSettings, Solver, render};
use deepct_core::{Error, Result};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

/// The formation, and the name of the weights for it.
const FORMATION: &str = "cloudct-10";

/// Wavelength of the images (um).
const WAVELENGTH: f64 = 0.672;

/// Reconstruct a built-in cloud from ten noisy views: everything once, in seconds
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder for the files and pictures
    #[arg(long, value_name = "DIR", default_value = "deepct-demo")]
    out: PathBuf,
}

pub(crate) fn run(args: &Args, global: &Global) -> Result<Outcome> {
    std::fs::create_dir_all(&args.out).map_err(Error::io(&args.out))?;
    let stages = Stages { quiet: global.quiet };
    let cloud = stages.time("cloud", || cumulus(&CumulusSettings::default(), global.seed))?;
    let medium = stages.time("optics", || droplets(&cloud))?;
    let images = stages.time("render", || photograph(&medium, global))?;
    let noisy = stages.time("sense", || expose(&images, global.seed))?;
    let grid = &cloud.grid;
    let carved = stages.time("carve", || carve(&noisy, grid, &CarveSettings::default()))?;
    let network = Network::new(&io::load_weights(FORMATION)?)?;
    let bare = stages.time("infer", || {
        let target = grid.center();
        network.infer(&noisy.images, [target.x, target.y])
    })?;
    let mut estimate = bare.clone();
    carved.mask.apply(&mut estimate)?;

    let truth = medium.extinction;
    let cloud = Cloud { extinction: Some(truth.values.clone()), ..cloud };
    let results = Results { cloud, truth, images, noisy, mask: carved.mask, estimate };
    stages.time("draw", || results.write(args, global.seed))?;
    results.print_scores(&bare)?;
    println!("files and pictures: {}", args.out.display());
    Ok(Outcome::Success)
}

/// The cloud as its droplets scatter light.
fn droplets(cloud: &Cloud) -> Result<Medium> {
    let table = DropletTable::of(&DropletSettings::water(WAVELENGTH))?;
    Medium::from_droplets(cloud, Arc::new(table))
}

/// The images of the cloud without a sensor's noise.
fn photograph(medium: &Medium, global: &Global) -> Result<Observation> {
    let sun = Sun::default();
    let scene = Scene::new(medium.clone(), sun, Surface::OCEAN)?;
    let scene = Scene { air: Some(Air::new(WAVELENGTH)?), ..scene };
    let grid = &medium.extinction.grid;
    let [_, rows, cols] = grid.shape;
    let views = Formation::cloudct_10().views(grid.center(), [rows, cols])?;
    let progress = RenderProgress::start(global, "render");
    let solver = Solver::Ordinates(OrdinatesSettings::default());
    let images = render(&scene, &views, &solver, &progress)?.images;
    Observation::new(sun, views, images)
}

/// The same images through the paper's sensor.
fn expose(images: &Observation, seed: u64) -> Result<Observation> {
    let sensed = sense(&images.images, &Sensor::CMV4000, Scale::BrightestAtFullWell, seed)?;
    let standard_error = sensed.standard_error(images.standard_error.as_ref())?;
    Ok(Observation {
        images: sensed.images,
        standard_error: Some(standard_error),
        ..images.clone()
    })
}

/// Says how long each stage takes.
struct Stages {
    quiet: bool,
}

impl Stages {
    fn time<T>(&self, stage: &str, work: impl FnOnce() -> Result<T>) -> Result<T> {
        let start = Instant::now();
        let result = work()?;
        if !self.quiet {
            println!("{stage:<8} {:>9.1} ms", 1e3 * start.elapsed().as_secs_f64());
        }
        Ok(result)
    }
}

/// What the demo made, from the truth to its reconstruction.
struct Results {
    cloud: Cloud,
    truth: Volume,
    images: Observation,
    noisy: Observation,
    mask: Mask,
    estimate: Volume,
}

impl Results {
    fn write(&self, args: &Args, seed: u64) -> Result<()> {
        let at = |name: &str| args.out.join(name);
        let provenance = |title: &str| Provenance {
            title: title.into(),
            configuration: format!("formation = \"{FORMATION}\"\n"),
            seed,
        };
        io::write_cloud(at("cloud.nc"), &self.cloud, &provenance("A generated cumulus"))?;
        io::write_observation(at("images.nc"), &self.images, &provenance("Its images"))?;
        io::write_observation(at("noisy.nc"), &self.noisy, &provenance("Its noisy images"))?;
        io::write_mask(at("mask.nc"), &self.mask, &provenance("Where it can be"))?;
        io::write_volume(at("estimate.nc"), &self.estimate, &provenance("Its reconstruction"))?;
        let title = "What ten satellites see";
        contact_sheet(at("images.png"), &self.noisy.images, &labels(&self.noisy), title)?;
        let title = "A cumulus from ten noisy views";
        volume_figure(at("cloud.png"), &self.estimate, Some(&self.truth), title)
    }

    fn print_scores(&self, bare: &Volume) -> Result<()> {
        println!("{:<18} {:>8} {:>8}", "", "epsilon", "delta");
        for (name, estimate) in [("network", bare), ("network, carved", &self.estimate)] {
            let Scores { relative_error, mass_error, .. } = score(&self.truth, estimate)?;
            println!("{name:<18} {relative_error:>8.3} {mass_error:>8.3}");
        }
        Ok(())
    }
}
