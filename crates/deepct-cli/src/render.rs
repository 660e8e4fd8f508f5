//! `deepct render`: the images of a cloud.

use crate::Outcome;
use crate::config;
use crate::global::Global;
use crate::optics::RenderSettings;
use crate::progress::Progress;
use deepct_core::io::{Provenance, read_cloud, write_exr, write_observation};
use deepct_core::scene::{Observation, Scene, Sun, Surface, VIEW_FILE_HELP, View, ViewList};
use deepct_core::transport::{MonteCarloSettings, Solver, render};
use deepct_core::{Error, Result};
use std::path::{Path, PathBuf};

/// The defaults of `render`.
pub(crate) const DEFAULTS: &str = include_str!("defaults/render.toml");

/// Compute the radiances that each view sees
///
/// `deepct config render` prints the settings: the wavelength, and what droplets do to
/// light.
#[derive(Debug, clap::Args)]
#[command(after_long_help = VIEW_FILE_HELP)]
pub(crate) struct Args {
    /// Cloud
    cloud: PathBuf,
    /// Views: cloudct-10, pearls-32, or a TOML file of views. They look at the centre
    /// of the cloud's grid, with an image pixel for each of its columns
    #[arg(long, value_name = "NAME|FILE.toml")]
    views: String,
    /// How light is computed
    #[arg(long, value_enum, default_value_t = Method::MonteCarlo)]
    solver: Method,
    /// Light paths of each pixel
    #[arg(long, default_value_t = 1024, value_name = "N")]
    samples: u32,
    /// After this many scatterings, go on without the forward peak: much less noise
    /// for the same time, and up to 3 % of error in the view means of a thick cloud
    /// after 3, up to 7 % after 1
    #[arg(long, value_name = "N")]
    similarity_after: Option<u32>,
    /// Angle between the zenith and the Sun (degrees)
    #[arg(long, default_value_t = 30.0, value_name = "DEG", allow_negative_numbers = true)]
    sun_zenith: f64,
    /// Azimuth towards the Sun, clockwise from north (degrees)
    #[arg(long, default_value_t = 45.0, value_name = "DEG", allow_negative_numbers = true)]
    sun_azimuth: f64,
    /// Share of the light that the surface at altitude 0 reflects
    #[arg(long, default_value_t = Surface::OCEAN.albedo, value_name = "A", allow_negative_numbers = true)]
    surface_albedo: f64,
    #[command(flatten)]
    settings: config::Settings,
    /// File of images to write
    #[arg(long, value_name = "I.nc")]
    out: PathBuf,
    /// Also write the images as OpenEXR, one layer a view
    #[arg(long, value_name = "I.exr")]
    exr: Option<PathBuf>,
}

/// A solver by its name.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Method {
    /// Random light paths: exact up to noise
    MonteCarlo,
}

pub(crate) fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let settings: RenderSettings = args.settings.resolve(DEFAULTS)?;
    let list = ViewList::find(&args.views)?;
    let sun = Sun::from_degrees(args.sun_zenith, args.sun_azimuth)?;
    let cloud = read_cloud(&args.cloud)?;
    let (center, [_, rows, cols]) = (cloud.grid.center(), cloud.grid.shape);
    let views = list.views(center, [rows, cols])?;
    let medium = settings.medium(cloud).map_err(Error::in_file(&args.cloud))?;
    let surface = Surface { albedo: args.surface_albedo, ..Surface::OCEAN };
    let scene = Scene::new(medium, sun, surface)?;
    let mut observation = observe(args, global, &scene, views)?;
    observation.wavelength = settings.wavelength;
    write_observation(&args.out, &observation, &args.provenance(global, &settings))?;
    if let Some(path) = &args.exr {
        write_exr(path, &observation)?;
    }
    if !global.quiet {
        let [views, rows, cols] = observation.images.shape();
        println!("{views} views of {rows} x {cols} pixels");
        println!("brightest  {:.5} sr-1", observation.images.brightest());
        println!("noise      {:.2} % of the mean", 100.0 * relative_noise(&observation));
    }
    Ok(Outcome::Success)
}

/// Render with a bar that shows the rows.
fn observe(args: &Args, global: &Global, scene: &Scene, views: Vec<View>) -> Result<Observation> {
    let Method::MonteCarlo = args.solver;
    let solver = Solver::MonteCarlo(MonteCarloSettings {
        samples_per_pixel: args.samples,
        seed: global.seed,
        similarity_after: args.similarity_after,
    });
    let total = views.iter().map(|view| view.rows as u64).sum();
    let progress = Progress::start(global, "render", total);
    let rendering = render(scene, &views, &solver, &|done| progress.advance(done))?;
    let mut observation = Observation::new(scene.sun, views, rendering.images)?;
    observation.standard_error = Some(rendering.standard_error);
    Ok(observation)
}

/// The root mean square of the standard error over the mean radiance.
fn relative_noise(observation: &Observation) -> f64 {
    let square = |value: &f32| f64::from(*value).powi(2);
    let errors = observation.standard_error.iter().flat_map(|stack| &stack.values);
    let count = observation.images.values.len() as f64;
    let mean = observation.images.values.iter().map(|v| f64::from(*v)).sum::<f64>() / count;
    (errors.map(square).sum::<f64>() / count).sqrt() / mean
}

/// What the output records of this run.
#[derive(Debug, serde::Serialize)]
struct Resolved<'a> {
    cloud: &'a Path,
    views: &'a str,
    solver: &'a str,
    samples: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    similarity_after: Option<u32>,
    sun_zenith_deg: f64,
    sun_azimuth_deg: f64,
    surface_albedo: f64,
    #[serde(flatten)]
    settings: &'a RenderSettings,
}

impl Args {
    fn provenance(&self, global: &Global, settings: &RenderSettings) -> Provenance {
        let resolved = Resolved {
            cloud: &self.cloud,
            views: &self.views,
            solver: "monte-carlo",
            samples: self.samples,
            similarity_after: self.similarity_after,
            sun_zenith_deg: self.sun_zenith,
            sun_azimuth_deg: self.sun_azimuth,
            surface_albedo: self.surface_albedo,
            settings,
        };
        Provenance {
            title: "Images of a cloud".into(),
            configuration: toml::to_string(&resolved).expect("plain numbers and text"),
            seed: global.seed,
        }
    }
}
