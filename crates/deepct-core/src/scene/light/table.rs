//! The scene illumination as plain values: in TOML, JSON and netCDF, by keys, and back.

use super::{DropletOpticsModel, Light};
use crate::error::{Error, Result};
use crate::scene::{Boundary, Sun, Surface, Waves};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A [`Light`] as plain values, the form in which it is stored in files. Angles are in degrees, and
/// absent values are omitted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
#[non_exhaustive]
pub struct LightTable {
    /// Solar zenith angle (degrees).
    pub sun_zenith_deg: f64,
    /// Azimuth towards the Sun, clockwise from north (degrees).
    pub sun_azimuth_deg: f64,
    /// Solar irradiance on a surface normal to the beam; radiances have its unit per steradian.
    pub solar_irradiance: f64,
    /// Wavelength (um).
    pub wavelength: f64,
    /// Whether the molecular atmosphere is included.
    pub air: bool,
    /// Vertical optical depth of the gases above the clouds that absorb at the wavelength; `None`
    /// without absorption.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gas_optical_depth: Option<f64>,
    /// Lambertian albedo of the surface.
    pub surface_albedo: f64,
    /// Altitude of the surface (km).
    pub surface_altitude_km: f64,
    /// Wind speed over the ocean surface (m/s), whose waves reflect sunlight; `None` for a surface
    /// without waves.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wind_speed: Option<f64>,
    /// Whether the grid is continued periodically beyond its lateral boundaries.
    pub periodic: bool,
    /// Model of the droplet optics.
    pub optics: DropletOpticsModel,
}

impl Default for LightTable {
    fn default() -> Self {
        Light::default().into()
    }
}

impl From<Light> for LightTable {
    fn from(light: Light) -> Self {
        let Light { sun, wavelength, optics, air, gas_optical_depth, surface, boundary } = light;
        Self {
            sun_zenith_deg: degrees(sun.zenith),
            sun_azimuth_deg: degrees(sun.azimuth),
            solar_irradiance: sun.irradiance,
            wavelength,
            air,
            gas_optical_depth: Some(gas_optical_depth).filter(|depth| *depth != 0.0),
            surface_albedo: surface.albedo,
            surface_altitude_km: surface.altitude,
            wind_speed: surface.waves.map(|waves| waves.wind_speed()),
            periodic: boundary == Boundary::Periodic,
            optics,
        }
    }
}

impl TryFrom<LightTable> for Light {
    type Error = Error;

    fn try_from(table: LightTable) -> Result<Self> {
        let sun = Sun {
            irradiance: table.solar_irradiance,
            ..Sun::from_degrees(table.sun_zenith_deg, table.sun_azimuth_deg)?
        };
        let surface = Surface {
            albedo: table.surface_albedo,
            altitude: table.surface_altitude_km,
            waves: table.wind_speed.map(Waves::new).transpose()?,
        };
        let boundary = if table.periodic { Boundary::Periodic } else { Boundary::Open };
        let (wavelength, optics, air) = (table.wavelength, table.optics, table.air);
        let gas_optical_depth = table.gas_optical_depth.unwrap_or(0.0);
        let light = Self { sun, wavelength, optics, air, gas_optical_depth, surface, boundary };
        light.check()?;
        Ok(light)
    }
}

/// Converts radians to degrees such that the conversion back gives exactly the same angle. A
/// rounded value is preferred.
fn degrees(radians: f64) -> f64 {
    let nearest = radians.to_degrees();
    let round = (nearest * 1e9).round() / 1e9;
    [round, nearest, nearest.next_down(), nearest.next_up()]
        .into_iter()
        .find(|degrees| degrees.to_radians() == radians)
        .unwrap_or(nearest)
}

/// The dotted keys of a [`LightTable`]; the optional ones are last.
const KEYS: [&str; 18] = [
    "sun_zenith_deg",
    "sun_azimuth_deg",
    "solar_irradiance",
    "wavelength",
    "air",
    "surface_albedo",
    "surface_altitude_km",
    "periodic",
    "optics.extinction",
    "optics.phase",
    "optics.asymmetry",
    "optics.single_scattering_albedo",
    "optics.distribution",
    "optics.bandwidth",
    "gas_optical_depth",
    "wind_speed",
    "optics.effective_variance",
    "optics.effective_radius",
];
/// The number of optional keys.
const OPTIONAL: usize = 4;

impl Light {
    /// The keys of [`Light::values`].
    pub fn keys() -> &'static [&'static str] {
        &KEYS
    }

    /// The keys of [`Light::values`] that are always present.
    pub fn required_keys() -> &'static [&'static str] {
        &KEYS[..KEYS.len() - OPTIONAL]
    }

    /// The values of its [`LightTable`] by dotted key.
    pub fn values(&self) -> BTreeMap<String, toml::Value> {
        let table = toml::Table::try_from(self).expect("plain values");
        let mut values = BTreeMap::new();
        for (key, value) in table {
            match value {
                toml::Value::Table(below) => values.extend(
                    below.into_iter().map(|(name, value)| (format!("{key}.{name}"), value)),
                ),
                value => {
                    values.insert(key, value);
                }
            }
        }
        values
    }

    /// The same scene illumination with the values of some keys replaced.
    ///
    /// # Errors
    /// Returns an error if a key is unknown, or if a value has the wrong type or is out of range.
    pub fn with_values(&self, values: &BTreeMap<String, toml::Value>) -> Result<Self> {
        for (key, value) in values {
            check_value(key, value)?;
        }
        let mut table = toml::Table::new();
        for (key, value) in self.values().iter().chain(values) {
            // Integers are accepted as numbers, such as a wind speed in whole metres per second.
            let value = match value {
                toml::Value::Integer(number) => toml::Value::Float(*number as f64),
                value => value.clone(),
            };
            let (section, name) = key.split_once('.').unwrap_or(("", key));
            let into = match section {
                "" => &mut table,
                _ => table
                    .entry(section)
                    .or_insert_with(|| toml::Table::new().into())
                    .as_table_mut()
                    .expect("a section of known keys"),
            };
            into.insert(name.to_owned(), value);
        }
        let table: LightTable = table.try_into().map_err(|problem: toml::de::Error| {
            let problem = problem.message().replace('\n', " ");
            Error::out_of_range("light", problem, "as printed by `deepct config light`")
        })?;
        table.try_into()
    }
}

/// Returns an error unless the key is known and the value is of its kind.
fn check_value(key: &str, value: &toml::Value) -> Result<()> {
    let last = |key: &str| key.rsplit('.').next().unwrap_or_default().to_owned();
    let Some(known) = KEYS.iter().find(|known| **known == key) else {
        let meant = KEYS.iter().find(|known| last(known) == last(key));
        let range = meant.map_or("a key of `deepct config light`".to_owned(), |meant| {
            format!("{meant} (see `deepct config light`)")
        });
        return Err(Error::out_of_range("key of the light", key, range));
    };
    let names: &[&str] = match *known {
        "optics.extinction" => &["geometric", "mie"],
        "optics.phase" => &["hg", "henyey-greenstein", "mie", "isotropic"],
        "optics.distribution" => &["gamma", "lognormal"],
        _ => &[],
    };
    let (fits, range) = match *known {
        "air" | "periodic" => (value.is_bool(), "true or false".to_owned()),
        _ if names.is_empty() => (value.is_float() || value.is_integer(), "a number".to_owned()),
        _ => (value.as_str().is_some_and(|text| names.contains(&text)), names.join(" or ")),
    };
    if fits {
        return Ok(());
    }
    let range = format!("{range} (see `deepct config light`)");
    Err(Error::out_of_range(known, value, range))
}
