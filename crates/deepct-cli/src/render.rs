//! `deepct render`: simulation of the images of a cloud.

use crate::files::lineage;
use crate::global::Global;
use crate::light::{LightFlags, warn_of_neglected};
use crate::outcome::Outcome;
use crate::progress::RenderProgress;
use crate::summary::{self, Form};
use deepct_core::files::check_output;
use deepct_core::io::{
    Provenance, load_trained_weights, read_cloud, read_implausible_cloud, write_exr,
    write_observation,
};
use deepct_core::network::{TrainedWeights, Weights};
use deepct_core::plot::{Format, contact_sheet};
use deepct_core::scene::{Light, Observation, Scene, Sun, VIEW_FILE_HELP, View, ViewList};
use deepct_core::transport::{
    FluxSettings, Fluxes, MonteCarloSettings, OrdinatesSettings, Rendering, Solver, fluxes, render,
};
use deepct_core::{Error, Result};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Compute the radiances that the cameras observe
///
/// The file of the images also stores the scene illumination (Sun, wavelength, droplet optics,
/// molecular atmosphere, surface), which `infer`, `invert`, `hybrid` and `score` read from there.
/// `deepct config light` prints every key and its default.
#[derive(Debug, clap::Args)]
#[command(after_long_help = VIEW_FILE_HELP)]
pub(crate) struct Args {
    /// File of the cloud
    cloud: PathBuf,
    /// Views: cloudct-10, pearls-32, or a TOML file of views. Unless the file specifies otherwise,
    /// the cameras point at the centre of the cloud's grid, and an image has as many pixels as the
    /// grid has columns
    #[arg(long, value_name = "NAME|FILE.toml", required_unless_present = "like")]
    views: Option<String>,
    /// Images like those that these weights were trained for: their cameras, altitude of the target,
    /// Sun and wavelengths, with air and Mie droplets. General weights have no cameras of their own.
    /// Other options replace values
    #[arg(long, value_name = "WEIGHTS")]
    like: Option<PathBuf>,
    /// Altitude of the point that the cameras are pointed at (km) [default: that of the centre of the
    /// cloud's grid]
    #[arg(long, value_name = "KM", allow_negative_numbers = true)]
    target_altitude: Option<f64>,
    /// Interpolate the extinction linearly between the centres of voxels; by default it is constant
    /// in each voxel
    #[arg(long)]
    trilinear: bool,
    /// Radiative transfer solver
    #[arg(long, value_enum, default_value_t = Method::MonteCarlo)]
    solver: Method,
    /// Number of photon paths per pixel; with --noise, the maximum number [default: 1024; with
    /// --noise 16777216]
    #[arg(long, value_name = "N")]
    samples: Option<u32>,
    /// Add photon paths until the relative standard error of the bright pixels is at most this,
    /// such as 0.01. It is the root mean square over all pixels that are at least half as bright as
    /// the brightest pixel of their view
    #[arg(long, value_name = "SHARE")]
    noise: Option<f64>,
    /// Continue a photon path without the forward peak of the phase function after this many
    /// scatterings, which reduces the noise for the same run time; with 4 scatterings, the bias of
    /// the mean radiance of a view of a thick cloud is less than 0.4 %
    #[arg(long, value_name = "N")]
    similarity_after: Option<u32>,
    /// Target accuracy of the deterministic solver, from 0.003 to 0.1: the approximate relative
    /// error of the bright pixels of single clouds [default: 0.01]
    #[arg(long, value_name = "SHARE")]
    accuracy: Option<f64>,
    /// Replace one value of the scene illumination, such as optics.extinction=mie
    #[arg(long, value_name = "KEY=VALUE", help_heading = "Scene illumination")]
    set: Vec<String>,
    /// Wavelength (um); several wavelengths are separated by commas, and each is rendered to its
    /// own files with the wavelength in the name, such as I-0.672um.nc [default: 0.672]
    #[arg(long, value_name = "UM", value_delimiter = ',', help_heading = "Scene illumination")]
    wavelength: Vec<f64>,
    /// Also trace this many photons from the Sun (1000000 if no number is given) through the top of
    /// the cloud's grid, and print the fractions that leave through its faces, are absorbed, and
    /// reach space or the surface
    #[arg(
        long,
        value_name = "PHOTONS",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "1000000",
        value_parser = clap::value_parser!(u64).range(2..)
    )]
    fluxes: Option<u64>,
    /// Accept values far beyond those of clouds with a warning: liquid water above 20 g/m3,
    /// extinctions above 10000 1/km, and effective radii outside 1 to 60 um
    #[arg(long)]
    allow_implausible: bool,
    /// File of images to write
    #[arg(long, value_name = "I.nc")]
    out: PathBuf,
    /// Also write the images as OpenEXR, one layer per view
    #[arg(long, value_name = "I.exr")]
    exr: Option<PathBuf>,
    /// Also write a figure of all images: .png, .svg or .pdf
    #[arg(long, value_name = "I.png")]
    png: Option<PathBuf>,
    #[command(flatten)]
    form: Form,
    #[command(flatten)]
    light: LightFlags,
}

/// Name of a solver.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Method {
    /// Monte Carlo photon paths: exact except for statistical noise
    MonteCarlo,
    /// Discrete ordinates: no noise, run times of seconds, errors of about 1 % in bright pixels
    Ordinates,
}

/// Photon paths per pixel if neither their number nor the noise is given.
const SAMPLES: u32 = 1024;

/// Maximum number of photon paths per pixel if the noise is given: about a day of computation.
const MOST_SAMPLES: u32 = 1 << 24;

pub(crate) fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let template = args.like.as_ref().map(load_trained_weights).transpose()?;
    let base = template.as_ref().map_or_else(|| Ok(Light::default()), trained_light)?;
    let light = base.with_values(&args.light.values(&args.set)?)?;
    for out in [Some(&args.out), args.exr.as_ref(), args.png.as_ref()].into_iter().flatten() {
        check_output(out)?;
    }
    args.png.as_ref().map(|png| Format::of(png, "--png")).transpose()?;
    args.check_solver()?;
    args.ordinates()?;
    if matches!(args.solver, Method::Ordinates) {
        warn_of_neglected(&light);
    }
    let list = args.views(template.as_ref())?;
    let (cloud, warnings) = match args.allow_implausible {
        true => read_implausible_cloud(&args.cloud)?,
        false => (read_cloud(&args.cloud)?, Vec::new()),
    };
    for warning in warnings {
        note!("deepct: warning: {warning}");
    }
    let (center, [_, rows, cols]) = (cloud.grid.center(), cloud.grid.shape);
    let views = list.views(center, [rows, cols])?;
    let mut wavelengths = args.wavelength.clone();
    if wavelengths.is_empty() {
        wavelengths.extend(trained_wavelengths(template.as_ref(), &light));
    }
    if wavelengths.len() > 1 && cloud.extinction.is_some() && cloud.microphysics.is_some() {
        note!(
            "deepct: warning: {}: its extinction is used at every wavelength; delete the variable \
             extinction for that of its droplets",
            args.cloud.display()
        );
    }
    let mut summaries = Vec::new();
    for &wavelength in &wavelengths {
        let key = "wavelength".to_owned();
        let light = light.with_values(&[(key, toml::Value::Float(wavelength))].into())?;
        let scene = light.scene(&cloud);
        let scene = scene.and_then(|scene| match args.trilinear {
            true => scene.with_trilinear_extinction(),
            false => Ok(scene),
        });
        let scene = scene.map_err(Error::in_file(&args.cloud))?;
        let light = light.recorded(&cloud);
        let name = |path: &Path| match wavelengths.len() {
            1 => path.to_owned(),
            _ => with_wavelength(path, wavelength),
        };
        let summary = args.image(global, &light, &scene, views.clone(), &name)?;
        let interrupted = summary.interrupted;
        summaries.push(summary);
        if interrupted {
            break;
        }
    }
    args.form.print_all(&summaries, global);
    let interrupted = summaries.iter().any(|summary| summary.interrupted);
    Ok(if interrupted { Outcome::Interrupted } else { Outcome::Success })
}

/// The illumination that weights were trained for.
fn trained_light(weights: &TrainedWeights) -> Result<Light> {
    let mut light = Light::realistic();
    if let TrainedWeights::Formation(Weights { metadata, .. }) = weights {
        let geometry = &metadata.view_geometry;
        light.sun = Sun::from_degrees(geometry.sun_zenith_deg, geometry.sun_azimuth_deg)?;
        light.wavelength = metadata.wavelengths_um[0];
    }
    Ok(light)
}

/// The wavelengths of the bands of weights, unless the illumination has another one than the first.
fn trained_wavelengths(weights: Option<&TrainedWeights>, light: &Light) -> Vec<f64> {
    match weights {
        Some(TrainedWeights::Formation(Weights { metadata, .. }))
            if metadata.wavelengths_um[0] == light.wavelength =>
        {
            metadata.wavelengths_um.clone()
        }
        _ => vec![light.wavelength],
    }
}

/// Inserts a wavelength (um) before the extension of a file name.
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
    /// The cameras: those of `--views`, or else of the weights of `--like`.
    fn views(&self, template: Option<&TrainedWeights>) -> Result<ViewList> {
        let trained = match template {
            Some(TrainedWeights::Formation(Weights { metadata, .. })) => Some(metadata),
            _ => None,
        };
        let list = match (&self.views, trained) {
            (Some(views), _) => ViewList::find(views)?,
            // Weights of the first versions do not state the distances of the cameras.
            (None, Some(metadata)) => ViewList::of_geometry(&metadata.view_geometry)
                .or_else(|_| ViewList::find(&metadata.formation))?,
            (None, None) => {
                let remedy = "give the cameras with --views";
                return Err(Error::mismatch(
                    "--like",
                    "weights of one formation",
                    "general weights, which are for any cameras",
                    remedy,
                ));
            }
        };
        let altitude = self.target_altitude.or(trained.map(|metadata| metadata.target_altitude_km));
        Ok(match altitude {
            Some(altitude) => list.with_target_altitude(altitude),
            None => list,
        })
    }

    /// Returns an error if an option does not apply to the chosen solver.
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
                format!("omit {option}: this solver has no photon paths"),
            )),
            _ => Ok(()),
        }
    }

    fn ordinates(&self) -> Result<OrdinatesSettings> {
        let settings = self
            .accuracy
            .map_or(Ok(OrdinatesSettings::default()), OrdinatesSettings::with_accuracy)?;
        Ok(OrdinatesSettings { estimate_error: true, ..settings })
    }

    /// Renders one scene and writes its files.
    fn image(
        &self,
        global: &Global,
        light: &Light,
        scene: &Scene,
        views: Vec<View>,
        name: &dyn Fn(&Path) -> PathBuf,
    ) -> Result<Summary> {
        let rendering = self.render(global, scene, &views)?;
        let provenance = self.provenance(global, light, &rendering);
        let samples = rendering.samples_per_pixel;
        let estimated_error = rendering.estimated_error;
        let noise = rendering.noise;
        let warnings = rendering.warnings();
        let mut observation = Observation::new(light.clone(), views, rendering.images)?;
        observation.standard_error = rendering.standard_error;
        observation.incomplete = rendering.interrupted;
        let out = name(&self.out);
        write_observation(&out, &observation, &provenance)?;
        if let Some(path) = &self.exr {
            write_exr(name(path), &observation)?;
        }
        if let Some(path) = &self.png {
            let title = out.file_stem().unwrap_or_default().to_string_lossy();
            let (geometry, wavelength) = (observation.geometry(), light.wavelength);
            contact_sheet(&observation.images, &geometry, wavelength, &[], &title)?
                .write(name(path))?;
        }
        for warning in &warnings {
            note!("deepct: warning: {warning}");
        }
        if rendering.interrupted {
            note!("deepct: stopped early: the images have {samples} photon paths per pixel");
        }
        let flux_settings = |photons| FluxSettings { photons, seed: global.seed };
        let photons = self.fluxes.filter(|_| !observation.incomplete);
        let fluxes = photons.map(|photons| fluxes(scene, flux_settings(photons))).transpose()?;
        Ok(Summary {
            out,
            shape: observation.images.shape(),
            solver: self.solver.name(),
            samples_per_pixel: samples,
            brightest: observation.images.brightest(),
            estimated_error,
            noise,
            interrupted: observation.incomplete,
            fluxes: fluxes.map(|fluxes| shares(&fluxes)),
        })
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

impl Method {
    fn name(self) -> &'static str {
        match self {
            Self::MonteCarlo => "monte-carlo",
            Self::Ordinates => "ordinates",
        }
    }
}

/// What is printed about images.
#[derive(Debug, Serialize)]
struct Summary {
    out: PathBuf,
    /// Number of views, rows and columns.
    shape: [usize; 3],
    solver: &'static str,
    /// 0 for the deterministic solver.
    samples_per_pixel: u32,
    /// Largest radiance (1/sr for a solar irradiance of 1).
    brightest: f32,
    /// Of the bright pixels, by the deterministic solver.
    #[serde(skip_serializing_if = "Option::is_none")]
    estimated_error: Option<f64>,
    /// Of the bright pixels, by photon paths.
    #[serde(skip_serializing_if = "Option::is_none")]
    noise: Option<f64>,
    interrupted: bool,
    /// Fractions of the light on top of the grid.
    #[serde(skip_serializing_if = "Option::is_none")]
    fluxes: Option<Vec<Share>>,
}

/// A fraction of the incident light, with its standard error.
#[derive(Debug, Serialize)]
struct Share {
    what: &'static str,
    fraction: f64,
    standard_error: f64,
}

fn shares(fluxes: &Fluxes) -> Vec<Share> {
    let shares = [
        ("leaves through the top", fluxes.reflected),
        ("leaves through the bottom", fluxes.transmitted),
        ("leaves through the sides", fluxes.sides),
        ("absorbed by droplets", fluxes.absorbed),
        ("finally in space", fluxes.upward),
        ("finally in the surface", fluxes.downward),
        ("unscattered at the surface", fluxes.unscattered),
    ];
    let row = |(what, share): (_, deepct_core::transport::Share)| Share {
        what,
        fraction: share.mean,
        standard_error: share.standard_error,
    };
    shares.into_iter().map(row).collect()
}

impl summary::Summary for Summary {
    fn say(&self) {
        let [views, rows, cols] = self.shape;
        let by = match self.samples_per_pixel {
            0 => "by discrete ordinates".to_owned(),
            samples => format!("{samples} photon paths per pixel"),
        };
        let plural = if views == 1 { "" } else { "s" };
        say!("{views} view{plural} of {rows} x {cols} pixels, {by}");
        say!("brightest  {:.5} sr-1", self.brightest);
        if let Some(error) = self.estimated_error {
            say!("error      {:.1} % of bright pixels, estimated", 100.0 * error);
        }
        if let Some(noise) = self.noise {
            say!("noise      {:.2} % of bright pixels", 100.0 * noise);
        }
        let Some(fluxes) = &self.fluxes else { return };
        say!("light on top of the grid     fraction    error");
        for Share { what, fraction, standard_error } in fluxes {
            say!("{what:<26}  {fraction:9.6}  {standard_error:.6}");
        }
    }
}

/// Parameters of the run, recorded in the output file.
#[derive(Debug, Serialize)]
struct Resolved<'a> {
    cloud: &'a Path,
    #[serde(skip_serializing_if = "Option::is_none")]
    views: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    like: Option<&'a Path>,
    #[serde(skip_serializing_if = "Option::is_none")]
    target_altitude: Option<f64>,
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    trilinear: bool,
    solver: &'a str,
    /// Photon paths per pixel in the images; 0 for the deterministic solver.
    samples: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    noise: Option<f64>,
    /// Estimated relative error of the bright pixels by the deterministic solver.
    #[serde(skip_serializing_if = "Option::is_none")]
    estimated_error: Option<f64>,
    /// Whether the user interrupted the rendering before it was complete.
    interrupted: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    similarity_after: Option<u32>,
    light: &'a Light,
}

impl Args {
    fn provenance(&self, global: &Global, light: &Light, rendering: &Rendering) -> Provenance {
        let resolved = Resolved {
            cloud: &self.cloud,
            views: self.views.as_deref(),
            like: self.like.as_deref(),
            target_altitude: self.target_altitude,
            trilinear: self.trilinear,
            solver: self.solver.name(),
            samples: rendering.samples_per_pixel,
            noise: self.noise,
            estimated_error: rendering.estimated_error,
            interrupted: rendering.interrupted,
            similarity_after: self.similarity_after,
            light,
        };
        Provenance {
            title: "Images of a cloud".into(),
            configuration: toml::to_string(&resolved).expect("plain numbers and text"),
            seed: global.seed,
            lineage: lineage("render", &self.cloud),
        }
    }
}
