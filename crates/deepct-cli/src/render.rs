//! `deepct render`: the images of a cloud.

use crate::global::Global;
use crate::light::LightFlags;
use crate::outcome::Outcome;
use crate::progress::RenderProgress;
use deepct_core::image::ViewStack;
use deepct_core::io::{Provenance, read_cloud, write_exr, write_observation};
use deepct_core::plot::contact_sheet;
use deepct_core::scene::{Light, Observation, Scene, VIEW_FILE_HELP, View, ViewList};
use deepct_core::transport::{
    FluxSettings, Fluxes, MonteCarloSettings, OrdinatesSettings, Rendering, Solver, fluxes, render,
};
use deepct_core::{Error, Result};
use std::path::{Path, PathBuf};

/// Compute the radiances that each view sees
///
/// The images carry their light (Sun, wavelength, droplet optics, atmosphere, surface) in their
/// file, where `infer`, `invert`, `hybrid` and `score` read it. `deepct config light` prints every
/// key of it and its default.
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
    /// Light paths of each pixel; with --noise, the most of them [default: 1024, or as
    /// many as --noise wants]
    #[arg(long, value_name = "N")]
    samples: Option<u32>,
    /// Go on until the standard error of the bright pixels is this share of their
    /// radiance, such as 0.01: the root mean square over all pixels that are at least half
    /// as bright as the brightest one of their view
    #[arg(long, value_name = "SHARE")]
    noise: Option<f64>,
    /// After this many scatterings, go on without the forward peak: less noise for the same
    /// time; after 4, the view means of a thick cloud are less than 0.4 % off
    #[arg(long, value_name = "N")]
    similarity_after: Option<u32>,
    /// Relative error that the deterministic solver works for, 0.003 to 0.1: of the bright pixels of
    /// single clouds, about [default: 0.01]
    #[arg(long, value_name = "SHARE")]
    accuracy: Option<f64>,
    #[command(flatten)]
    light: LightFlags,
    /// Replace one value of the light, such as optics.extinction=mie
    #[arg(long, value_name = "KEY=VALUE", help_heading = "Light")]
    set: Vec<String>,
    /// Wavelength (um); for several of them the files have the wavelength in their names, as in
    /// I-0.672um.nc [default: 0.672]
    #[arg(long, value_name = "UM", value_delimiter = ',', help_heading = "Light")]
    wavelength: Vec<f64>,
    /// Also follow this many photons from the Sun [default: 1000000], and print where the
    /// light goes that shines on the top of the cloud's grid
    #[arg(
        long,
        value_name = "PHOTONS",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "1000000",
        value_parser = clap::value_parser!(u64).range(2..)
    )]
    fluxes: Option<u64>,
    /// File of images to write
    #[arg(long, value_name = "I.nc")]
    out: PathBuf,
    /// Also write the images as OpenEXR, one layer a view
    #[arg(long, value_name = "I.exr")]
    exr: Option<PathBuf>,
    /// Also draw all images on one sheet
    #[arg(long, value_name = "I.png")]
    png: Option<PathBuf>,
}

/// A solver by its name.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Method {
    /// Random photon paths: exact up to noise
    MonteCarlo,
    /// Discrete directions: without noise, in seconds, bright pixels about 1 % off
    Ordinates,
}

/// Light paths of each pixel where neither their number nor the noise is given.
const SAMPLES: u32 = 1024;

/// The most of them where the noise is given: a day of work.
const MOST_SAMPLES: u32 = 1 << 24;

pub(crate) fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let light = args.light.describe(&args.set)?;
    args.check_solver()?;
    args.ordinates()?;
    let list = ViewList::find(&args.views)?;
    let cloud = read_cloud(&args.cloud)?;
    let (center, [_, rows, cols]) = (cloud.grid.center(), cloud.grid.shape);
    let views = list.views(center, [rows, cols])?;
    let mut wavelengths = args.wavelength.clone();
    if wavelengths.is_empty() {
        wavelengths.push(light.wavelength);
    }
    for &wavelength in &wavelengths {
        let key = "wavelength".to_owned();
        let light = light.with_values(&[(key, toml::Value::Float(wavelength))].into())?;
        let scene = light.scene(&cloud).map_err(Error::in_file(&args.cloud))?;
        let light = light.recorded(&cloud);
        let name = |path: &Path| match wavelengths.len() {
            1 => path.to_owned(),
            _ => with_wavelength(path, wavelength),
        };
        if args.image(global, &light, &scene, views.clone(), &name)? {
            break;
        }
    }
    Ok(Outcome::Success)
}

/// The name of a file with a wavelength (um) before its extension.
fn with_wavelength(path: &Path, wavelength: f64) -> PathBuf {
    let mut name = path.file_stem().unwrap_or_default().to_owned();
    name.push(format!("-{wavelength}um"));
    if let Some(extension) = path.extension() {
        name.push(".");
        name.push(extension);
    }
    path.with_file_name(name)
}

impl Args {
    /// An error if the solver has no photon paths to which an option could apply.
    fn check_solver(&self) -> Result<()> {
        let of_paths = [
            ("--samples", self.samples.is_some()),
            ("--noise", self.noise.is_some()),
            ("--similarity-after", self.similarity_after.is_some()),
        ];
        if matches!(self.solver, Method::MonteCarlo) && self.accuracy.is_some() {
            return Err(Error::mismatch(
                "solver",
                "ordinates with --accuracy",
                "monte-carlo",
                "give --noise, or --solver ordinates",
            ));
        }
        match (self.solver, of_paths.into_iter().find(|(_, given)| *given)) {
            (Method::Ordinates, Some((option, _))) => Err(Error::mismatch(
                "solver",
                format!("monte-carlo with {option}"),
                "ordinates",
                format!("leave out {option}: this solver follows no photon paths"),
            )),
            _ => Ok(()),
        }
    }

    fn ordinates(&self) -> Result<OrdinatesSettings> {
        self.accuracy.map_or(Ok(OrdinatesSettings::default()), OrdinatesSettings::with_accuracy)
    }

    /// Render one scene and write its files; whether the user stopped it.
    fn image(
        &self,
        global: &Global,
        light: &Light,
        scene: &Scene,
        views: Vec<View>,
        name: &dyn Fn(&Path) -> PathBuf,
    ) -> Result<bool> {
        let rendering = self.render(global, scene, &views)?;
        let provenance = self.provenance(global, light, &rendering);
        let samples = rendering.samples_per_pixel;
        let noise = rendering.standard_error.as_ref();
        let noise = noise.map(|error| relative_noise(&rendering.images, error));
        let mut observation = Observation::new(light.clone(), views, rendering.images)?;
        observation.standard_error = rendering.standard_error;
        let out = name(&self.out);
        write_observation(&out, &observation, &provenance)?;
        if let Some(path) = &self.exr {
            write_exr(name(path), &observation)?;
        }
        if let Some(path) = &self.png {
            let title = out.file_stem().unwrap_or_default().to_string_lossy();
            let labels = crate::plot::labels(&observation);
            contact_sheet(name(path), &observation.images, &labels, &title)?;
        }
        if !rendering.converged && !rendering.interrupted {
            eprintln!(
                "deepct: warning: the deterministic solver has not come to its tolerance; the cloud is \
                 very thick, or its sides are periodic and close: --solver monte-carlo is exact"
            );
        }
        if rendering.interrupted {
            match self.solver {
                Method::MonteCarlo => {
                    eprintln!(
                        "deepct: stopped early: the images hold {samples} photon paths a pixel"
                    );
                }
                Method::Ordinates => eprintln!(
                    "deepct: stopped early: the images are those of a solution that has not come to its \
                     tolerance"
                ),
            }
        }
        if !global.quiet {
            let [views, rows, cols] = observation.images.shape();
            let by = match self.solver {
                Method::MonteCarlo => format!("{samples} photon paths each"),
                Method::Ordinates => "by discrete ordinates".to_owned(),
            };
            println!("{views} views of {rows} x {cols} pixels, {by}");
            println!("brightest  {:.5} sr-1", observation.images.brightest());
            if let Some(noise) = noise {
                println!("noise      {:.2} % of the mean", 100.0 * noise);
            }
        }
        if let Some(photons) = self.fluxes.filter(|_| !rendering.interrupted) {
            print_fluxes(&fluxes(scene, FluxSettings { photons, seed: global.seed })?);
        }
        Ok(rendering.interrupted)
    }

    fn render(&self, global: &Global, scene: &Scene, views: &[View]) -> Result<Rendering> {
        let samples = if self.noise.is_some() { MOST_SAMPLES } else { SAMPLES };
        let solver = match self.solver {
            Method::MonteCarlo => Solver::MonteCarlo(MonteCarloSettings {
                samples_per_pixel: self.samples.unwrap_or(samples),
                noise: self.noise,
                seed: global.seed,
                similarity_after: self.similarity_after,
            }),
            Method::Ordinates => Solver::Ordinates(self.ordinates()?),
        };
        render(scene, views, &solver, &RenderProgress::start(global, "render"))
    }
}

/// A row for each share of the light, with its standard error.
fn print_fluxes(fluxes: &Fluxes) {
    println!("light on the top of the grid    share    error");
    for (what, share) in [
        ("out through the top", fluxes.reflected),
        ("out through the bottom", fluxes.transmitted),
        ("out through the sides", fluxes.sides),
        ("absorbed by droplets", fluxes.absorbed),
        ("in the end in space", fluxes.upward),
        ("in the end in the surface", fluxes.downward),
        ("unscattered at the surface", fluxes.unscattered),
    ] {
        println!("{what:<26}  {:9.6}  {:.6}", share.mean, share.standard_error);
    }
}

/// The root mean square of the standard error over the mean radiance.
fn relative_noise(images: &ViewStack, standard_error: &ViewStack) -> f64 {
    let square = |value: &f32| f64::from(*value).powi(2);
    let count = images.values.len() as f64;
    let mean = images.values.iter().map(|v| f64::from(*v)).sum::<f64>() / count;
    let squares = standard_error.values.iter().map(square).sum::<f64>();
    (squares / count).sqrt() / mean
}

/// What the output records of this run.
#[derive(Debug, serde::Serialize)]
struct Resolved<'a> {
    cloud: &'a Path,
    views: &'a str,
    solver: &'a str,
    /// Light paths of each pixel that the images hold; 0 without any.
    samples: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    noise: Option<f64>,
    /// Whether the user stopped before all that was asked for was done.
    interrupted: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    similarity_after: Option<u32>,
    light: &'a Light,
}

impl Args {
    fn provenance(&self, global: &Global, light: &Light, rendering: &Rendering) -> Provenance {
        let resolved = Resolved {
            cloud: &self.cloud,
            views: &self.views,
            solver: match self.solver {
                Method::MonteCarlo => "monte-carlo",
                Method::Ordinates => "ordinates",
            },
            samples: rendering.samples_per_pixel,
            noise: self.noise,
            interrupted: rendering.interrupted,
            similarity_after: self.similarity_after,
            light,
        };
        Provenance {
            title: "Images of a cloud".into(),
            configuration: toml::to_string(&resolved).expect("plain numbers and text"),
            seed: global.seed,
        }
    }
}
