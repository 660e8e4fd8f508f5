//! The light of images: Sun and wavelength as variables of their own, all else as attributes of the
//! variable `light`, which holds no number, as `grid_mapping` variables of CF do.

use super::Input;
use super::write::{Attribute, Attribute::*, Output};
use crate::error::Result;
use crate::scene::Light;
use std::collections::BTreeMap;
use std::path::Path;

/// The variable whose attributes are the light.
const CONTAINER: &str = "light";

/// Quantities that are variables: name, key of the light, unit, long name, standard name.
const VARIABLES: [(&str, &str, &str, &str, &str); 4] = [
    (
        "sun_zenith_deg",
        "sun_zenith_deg",
        "degree",
        "angle between the zenith and the Sun",
        "solar_zenith_angle",
    ),
    (
        "sun_azimuth_deg",
        "sun_azimuth_deg",
        "degree",
        "azimuth towards the Sun, clockwise from north",
        "solar_azimuth_angle",
    ),
    ("sun_irradiance", "solar_irradiance", "1", "solar irradiance normal to the beam", ""),
    ("wavelength", "wavelength", "um", "wavelength", "radiation_wavelength"),
];

/// The light that a file of images, or of what was inferred from them, was made in, and the keys
/// that it does not state; `None` where it states nothing at all.
///
/// # Errors
/// A file that cannot be read; values out of range.
pub fn read_light(path: impl AsRef<Path>) -> Result<Option<(Light, Vec<String>)>> {
    let input = Input::open(path.as_ref())?;
    let known = input.has(CONTAINER) || VARIABLES.iter().all(|(name, ..)| input.has(name));
    known.then(|| get_light(&input)).transpose()
}

/// Put the light into a file that is being written.
pub(super) fn put_light(output: &Output, light: &Light) -> Result<()> {
    let mut values = light.values();
    for (name, key, units, long_name, standard_name) in VARIABLES {
        let value = values.remove(key).and_then(|value| value.as_float());
        let mut attributes = vec![("units", Text(units)), ("long_name", Text(long_name))];
        if !standard_name.is_empty() {
            attributes.push(("standard_name", Text(standard_name)));
        }
        output.scalar(name, value.expect("a number"), &attributes)?;
    }
    // A dot is no part of an identifier, which attributes are in many programs.
    let pairs: Vec<(String, toml::Value, String)> = values
        .into_iter()
        .map(|(key, value)| {
            let text = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
            (key.replace('.', "_"), value, text)
        })
        .collect();
    let long_name = "light of the images: air, surface, sides, droplet optics";
    let mut attributes: Vec<(&str, Attribute)> = vec![("long_name", Text(long_name))];
    attributes.extend(pairs.iter().map(|(name, value, text)| {
        let attribute = value.as_float().map_or(Text(text), Number);
        (name.as_str(), attribute)
    }));
    output.variable(CONTAINER, &[], ndarray::arr0(0_i32).view(), &attributes)
}

/// The light of a file that is open, and the keys that it does not state.
pub(super) fn get_light(input: &Input) -> Result<(Light, Vec<String>)> {
    let mut values = BTreeMap::new();
    for (name, key, ..) in VARIABLES {
        values.insert(key.to_owned(), toml::Value::Float(input.scalar(name)?));
    }
    if input.has(CONTAINER) {
        let container = input.variable(CONTAINER)?;
        for key in Light::keys() {
            let name = key.replace('.', "_");
            let value = match (container.number(&name), container.text(&name)) {
                (Some(number), _) => toml::Value::Float(number),
                (_, Some(text)) => match text.as_str() {
                    "true" => toml::Value::Boolean(true),
                    "false" => toml::Value::Boolean(false),
                    _ => toml::Value::String(text),
                },
                (None, None) => continue,
            };
            values.insert((*key).to_owned(), value);
        }
    }
    let light = Light::default().with_values(&values).map_err(|problem| {
        let names = "the light";
        input.error(names, problem.to_string(), "correct the value")
    })?;
    let unknown = Light::required_keys().iter().filter(|key| !values.contains_key(**key));
    Ok((light, unknown.map(|key| (*key).to_owned()).collect()))
}
