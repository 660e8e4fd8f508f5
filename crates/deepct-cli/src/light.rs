//! Scene illumination on the command line: options describe it for `render`; the other verbs read
//! it from the file of the images.

use crate::config::{Values, flattened, read_table, single};
use deepct_core::scene::{Light, Observation, PhaseModel};
use deepct_core::{Error, Result};
use std::path::{Path, PathBuf};

/// Effective radius (um) that is assumed if Mie theory requires one and none is given.
const ASSUMED_RADIUS: f64 = 10.0;

/// Options that describe the scene illumination.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Scene illumination")]
pub(crate) struct LightFlags {
    /// File (TOML) that describes the scene illumination: Sun, wavelength, droplet optics,
    /// molecular atmosphere and surface; `deepct config light` prints every key
    #[arg(long, value_name = "FILE.toml")]
    light: Option<PathBuf>,
    /// Angle between the zenith and the Sun (degrees) [default: 30]
    #[arg(long, value_name = "DEG", allow_negative_numbers = true)]
    sun_zenith: Option<f64>,
    /// Azimuth towards the Sun, clockwise from north (degrees) [default: 45]
    #[arg(long, value_name = "DEG", allow_negative_numbers = true)]
    sun_azimuth: Option<f64>,
    /// Solar irradiance on a surface normal to the beam; radiances are in its unit per
    /// steradian [default: 1]
    #[arg(long, value_name = "E", allow_negative_numbers = true)]
    solar_irradiance: Option<f64>,
    /// Lambertian albedo of the surface [default: 0.05]
    #[arg(long, value_name = "A", allow_negative_numbers = true)]
    surface_albedo: Option<f64>,
    /// Wind speed over the ocean surface (m/s), whose waves reflect sunlight [default: no waves]
    #[arg(long, value_name = "M/S", allow_negative_numbers = true)]
    wind_speed: Option<f64>,
    /// Include the molecular atmosphere (Rayleigh scattering) [default: false]
    #[arg(long, value_name = "true|false", num_args = 0..=1, require_equals = true, default_missing_value = "true")]
    air: Option<bool>,
    /// Repeat the grid periodically beyond its horizontal sides [default: false]
    #[arg(long, value_name = "true|false", num_args = 0..=1, require_equals = true, default_missing_value = "true")]
    periodic: Option<bool>,
    /// Phase function of the droplets: hg (Henyey and Greenstein), mie or isotropic [default: hg]
    #[arg(long, value_name = "NAME")]
    phase: Option<String>,
    /// Effective radius (um) of all droplets, for Mie theory and a cloud given by its extinction
    #[arg(long, value_name = "UM", allow_negative_numbers = true)]
    effective_radius: Option<f64>,
}

impl LightFlags {
    /// The given values. Those of `--set` replace those of the file, and those of single options
    /// replace both.
    pub(crate) fn values(&self, set: &[String]) -> Result<Values> {
        let mut values = Values::new();
        if let Some(path) = &self.light {
            values = flattened(read_table(path, "light")?);
            Light::default().with_values(&values).map_err(Error::in_file(path))?;
        }
        for setting in set {
            values.extend(flattened(single(setting)?));
        }
        let number = |value: Option<f64>| value.map(toml::Value::Float);
        for (key, value) in [
            ("sun_zenith_deg", number(self.sun_zenith)),
            ("sun_azimuth_deg", number(self.sun_azimuth)),
            ("solar_irradiance", number(self.solar_irradiance)),
            ("surface_albedo", number(self.surface_albedo)),
            ("wind_speed", number(self.wind_speed)),
            ("air", self.air.map(toml::Value::Boolean)),
            ("periodic", self.periodic.map(toml::Value::Boolean)),
            ("optics.phase", self.phase.clone().map(toml::Value::String)),
            ("optics.effective_radius", number(self.effective_radius)),
        ] {
            values.extend(value.map(|value| (key.to_owned(), value)));
        }
        Ok(values)
    }
}

/// Completes the light of images: what their file states, with the given values in its place. Prints a
/// warning for each contradiction, and what has to be assumed.
pub(crate) fn resolve_light(
    observation: &mut Observation,
    path: &Path,
    given: &Values,
    quiet: bool,
) -> Result<()> {
    let stated = observation.light.values();
    let light = observation.light.with_values(given)?;
    let assumed = |key: &String| observation.assumed.contains(key);
    let file = path.display();
    for (key, value) in light.values() {
        match stated.get(&key) {
            Some(old) if *old != value && !assumed(&key) => note!(
                "deepct: warning: {key} is {old} in {file}, but {value} was given: {value} is used"
            ),
            None if observation.assumed.is_empty() => {
                note!(
                    "deepct: warning: {key} is not set in {file}, but {value} was given: it is used"
                );
            }
            _ => {}
        }
    }
    observation.light = light;
    observation.assumed.retain(|key| !given.contains_key(key));
    let optics = &mut observation.light.optics;
    if optics.effective_radius.is_none() && optics.phase == PhaseModel::Mie {
        optics.effective_radius = Some(ASSUMED_RADIUS);
        observation.assumed.push("optics.effective_radius".into());
    }
    let values = observation.light.values();
    let missing: Vec<String> = observation
        .assumed
        .iter()
        .filter(|key| matters(key, &observation.light))
        .map(|key| format!("{key} = {}", values[key]))
        .collect();
    warn_of_neglected(&observation.light);
    if !missing.is_empty() && !quiet {
        note!(
            "deepct: {} does not specify the whole scene illumination; assumed: {} \
             (--light FILE.toml specifies it)",
            path.display(),
            missing.join(", ")
        );
    }
    Ok(())
}

/// Warns of what the discrete-ordinates solver neglects.
pub(crate) fn warn_of_neglected(light: &Light) {
    for warning in light.neglected_by_ordinates() {
        note!("deepct: warning: {warning}");
    }
}

/// Whether a value of the light has an effect on an inversion.
fn matters(key: &str, light: &Light) -> bool {
    let mie = light.optics.phase == PhaseModel::Mie;
    match key {
        "optics.asymmetry" => light.optics.phase == PhaseModel::HenyeyGreenstein,
        "optics.single_scattering_albedo" => !mie,
        "optics.distribution" | "optics.bandwidth" => mie,
        // It only gives the extinction of a true cloud.
        "optics.extinction" => false,
        _ => true,
    }
}
