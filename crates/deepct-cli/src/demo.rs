//! `deepct demo`: the whole processing chain without any input.
//!
//! Generates a cloud, places it in a molecular atmosphere above an ocean surface, renders the ten
//! views of `cloudct-10`, adds the noise of a real sensor, carves a mask, reconstructs the
//! extinction with the built-in network, and scores and plots the result.

use crate::global::Global;
use crate::outcome::Outcome;
use crate::progress::RenderProgress;
use deepct_core::carve::{CarveSettings, carve};
use deepct_core::cloud::{Cloud, CumulusSettings, cumulus};
use deepct_core::grid::{Mask, Volume};
use deepct_core::io::{self, Provenance};
use deepct_core::metrics::{Scores, score};
use deepct_core::network::Network;
use deepct_core::plot::{VolumeFields, contact_sheet, volume_figure};
use deepct_core::scene::{Formation, Light, Observation, Scene};
use deepct_core::sensor::{Scale, Sensor, expose};
use deepct_core::transport::{OrdinatesSettings, Solver, render};
use deepct_core::{Error, Result};
use std::path::PathBuf;
use std::time::Instant;

/// Name of the formation and of the built-in weights for it.
const FORMATION: &str = "cloudct-10";
/// Accuracy of the images in bright pixels. Scores hardly depend on it, and the time does.
const ACCURACY: f64 = 0.05;

/// Run the whole chain in seconds: reconstruct a generated cloud from ten noisy views
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder for the output files and figures
    #[arg(long, value_name = "DIR", default_value = "deepct-demo")]
    out: PathBuf,
}

pub(crate) fn run(args: &Args, global: &Global) -> Result<Outcome> {
    std::fs::create_dir_all(&args.out).map_err(Error::io(&args.out))?;
    let stages = Stages { quiet: global.quiet };
    let cloud = stages.time("cloud", || cumulus(&CumulusSettings::default(), global.seed))?;
    let light = Light::realistic();
    let scene = stages.time("optics", || light.scene(&cloud))?;
    let light = light.recorded(&cloud);
    let images = stages.time("render", || photograph(&scene, light, global))?;
    let sensor = &Sensor::CMV4000;
    let noisy = stages
        .time("sense", || expose(&images, sensor, Scale::BrightestAtFullWell, global.seed))?
        .observation;
    let grid = &cloud.grid;
    let carved = stages.time("carve", || carve(&noisy, grid, &CarveSettings::default()))?;
    let network = Network::new(&io::load_weights(FORMATION)?)?;
    let bare = stages.time("infer", || network.infer(&noisy.images, &noisy.imaging_geometry()?))?;
    let mut estimate = bare.clone();
    carved.mask.apply(&mut estimate)?;

    let truth = scene.medium.extinction;
    let cloud = Cloud { extinction: Some(truth.values.clone()), ..cloud };
    let results = Results { cloud, truth, images, noisy, mask: carved.mask, estimate };
    stages.time("draw", || results.write(args, global.seed))?;
    results.print_scores(&bare)?;
    say!("files and figures: {}", args.out.display());
    say!("a page with a 3D view: deepct report {} --open", args.out.display());
    Ok(Outcome::Success)
}

/// Renders the images of the cloud, without sensor noise.
fn photograph(scene: &Scene, light: Light, global: &Global) -> Result<Observation> {
    let grid = &scene.medium.extinction.grid;
    let [_, rows, cols] = grid.shape;
    let views = Formation::cloudct_10().views(grid.center(), [rows, cols])?;
    let progress = RenderProgress::start(global, "render");
    let solver = Solver::Ordinates(OrdinatesSettings::with_accuracy(ACCURACY)?);
    let images = render(scene, &views, &solver, &progress)?.images;
    Observation::new(light, views, images)
}

/// Reports the run time of each stage.
struct Stages {
    quiet: bool,
}

impl Stages {
    fn time<T>(&self, stage: &str, work: impl FnOnce() -> Result<T>) -> Result<T> {
        let start = Instant::now();
        let result = work()?;
        if !self.quiet {
            say!("{stage:<8} {:>9.1} ms", 1e3 * start.elapsed().as_secs_f64());
        }
        Ok(result)
    }
}

/// Results of the demo, from the true cloud to its reconstruction.
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
            ..Provenance::default()
        };
        io::write_cloud(at("cloud.nc"), &self.cloud, &provenance("Generated cumulus"))?;
        io::write_observation(at("images.nc"), &self.images, &provenance("Images without noise"))?;
        io::write_observation(at("noisy.nc"), &self.noisy, &provenance("Images with noise"))?;
        io::write_mask(at("mask.nc"), &self.mask, &provenance("Space-carving mask"))?;
        io::write_volume(at("estimate.nc"), &self.estimate, &provenance("Network estimate"))?;
        let title = "Images of the ten views";
        contact_sheet(
            &self.noisy.images,
            &self.noisy.geometry(),
            self.noisy.light.wavelength,
            &[],
            title,
        )?
        .write(at("images.png"))?;
        let title = "Cumulus reconstructed from ten noisy views";
        let fields = VolumeFields {
            extinction: Some(&self.estimate),
            truth: Some(&self.truth),
            mask: Some(&self.mask),
            ..Default::default()
        };
        volume_figure(&fields, title)?.write(at("cloud.png"))
    }

    fn print_scores(&self, bare: &Volume) -> Result<()> {
        say!("{:<18} {:>8} {:>8}", "", "epsilon", "delta");
        for (name, estimate) in [("network", bare), ("network, carved", &self.estimate)] {
            let Scores { relative_error, mass_error, .. } = score(&self.truth, estimate)?;
            say!("{name:<18} {relative_error:>8.3} {mass_error:>8.3}");
        }
        Ok(())
    }
}
