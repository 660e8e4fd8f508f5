//! `deepct sense`: simulation of sensor noise.

use crate::files::lineage;
use crate::global::Global;
use crate::outcome::Outcome;
use crate::summary::{self, Form};
use deepct_core::files::check_output;
use deepct_core::io::{Provenance, read_observation, write_observation};
use deepct_core::sensor::{Exposure, Scale, Sensor, expose};
use deepct_core::{Error, Result};
use std::path::{Path, PathBuf};

/// Add photon, dark-current, read and quantisation noise to images
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// File of images without noise, as written by `deepct render`
    images: PathBuf,
    /// Sensor: cmv4000, or a TOML file with full_well, read_noise (electrons),
    /// dark_current (electrons/s), bits, exposure (s) and pixel_pitch (um)
    #[arg(long, default_value = "cmv4000", value_name = "NAME|FILE.toml")]
    sensor: String,
    /// Number of electrons for a radiance of 1/sr; by default it is chosen such that the brightest
    /// pixel of all views reaches the full well, after subtraction of twice its standard error
    #[arg(long, value_name = "E_PER_RADIANCE", allow_negative_numbers = true)]
    scale: Option<f64>,
    /// File of noisy images to write
    #[arg(long, value_name = "N.nc")]
    out: PathBuf,
    #[command(flatten)]
    form: Form,
}

pub(crate) fn run(args: &Args, global: &Global) -> Result<Outcome> {
    check_output(&args.out)?;
    let sensor = find_sensor(&args.sensor)?;
    let scale = match args.scale {
        None => Scale::BrightestAtFullWell,
        Some(scale) if scale.is_finite() && scale > 0.0 => Scale::ElectronsPerRadiance(scale),
        Some(scale) => return Err(Error::out_of_range("--scale", scale, "positive and finite")),
    };
    let clean = read_observation(&args.images)?;
    let Exposure { observation, electrons_per_radiance } =
        expose(&clean, &sensor, scale, global.seed).map_err(Error::in_file(&args.images))?;
    let resolved = Resolved { images: &args.images, electrons_per_radiance, sensor };
    let provenance = Provenance {
        title: "Images with sensor noise".into(),
        configuration: toml::to_string(&resolved).expect("plain numbers and text"),
        seed: global.seed,
        lineage: lineage("sense", &args.images),
    };
    write_observation(&args.out, &observation, &provenance)?;
    let marks = observation.saturated.iter().flatten();
    let summary = Summary {
        out: &args.out,
        electrons_per_radiance,
        saturated_pixels: marks.filter(|saturated| **saturated).count(),
        pixels: observation.images.values.len(),
    };
    args.form.print(&summary, global);
    Ok(Outcome::Success)
}

/// What is printed about noisy images.
#[derive(Debug, serde::Serialize)]
struct Summary<'a> {
    out: &'a Path,
    electrons_per_radiance: f64,
    saturated_pixels: usize,
    /// Number of pixels of all images.
    pixels: usize,
}

impl summary::Summary for Summary<'_> {
    fn say(&self) {
        let Self { electrons_per_radiance, saturated_pixels, pixels, .. } = *self;
        let share = 100.0 * saturated_pixels as f64 / pixels as f64;
        say!("{electrons_per_radiance:.6e} electrons for a radiance of 1/sr");
        say!("{saturated_pixels} pixels are saturated ({share:.2} %)");
    }
}

/// Parameters of the run, recorded in the output file.
#[derive(Debug, serde::Serialize)]
struct Resolved<'a> {
    images: &'a Path,
    electrons_per_radiance: f64,
    sensor: Sensor,
}

/// The preset of the given name, or else the sensor described in a file.
fn find_sensor(name: &str) -> Result<Sensor> {
    if let Some(sensor) = Sensor::preset(name) {
        return Ok(sensor);
    }
    if !Path::new(name).exists() {
        let range = format!("the name of a sensor ({}) or a TOML file", Sensor::PRESETS.join(", "));
        return Err(Error::out_of_range("--sensor", format!("\"{name}\""), range));
    }
    Sensor::from_file(Path::new(name))
}
