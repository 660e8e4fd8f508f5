//! The scene illumination of images. Sun and wavelength are stored as separate variables and all
//! other quantities as attributes of the variable `light`, whose value has no meaning, as for
//! `grid_mapping` variables of CF.

use super::Input;
use super::write::{Attribute, Attribute::*, Output};
use crate::error::Result;
use crate::scene::{Light, Observation};
use std::collections::BTreeMap;
use std::path::Path;

/// The variable whose attributes describe the scene illumination.
const CONTAINER: &str = "light";

/// Attributes of the container that are not of the illumination.
const OTHER_ATTRIBUTES: [&str; 10] = [
    "long_name",
    "standard_name",
    "units",
    "comment",
    "coordinates",
    "grid_mapping",
    "DIMENSION_LIST",
    "REFERENCE_LIST",
    "CLASS",
    "NAME",
];

/// The variable of the solar irradiance for which the radiances hold.
const IRRADIANCE: &str = "sun_irradiance";

/// The variable of the wavelength.
const WAVELENGTH: &str = "wavelength";

/// Name, key in [`Light`], unit, long name and standard name of a variable.
type Described = (&'static str, &'static str, &'static str, &'static str, &'static str);

/// Quantities stored as variables.
const VARIABLES: [Described; 4] = [
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
    (IRRADIANCE, "solar_irradiance", "1", "solar irradiance normal to the beam", ""),
    (WAVELENGTH, "wavelength", "um", "wavelength", "radiation_wavelength"),
];

/// Read the scene illumination from a file of images or of a quantity retrieved from images, and
/// the required keys that the file does not specify. Returns `None` if the file does not specify
/// the scene illumination.
///
/// # Errors
/// Returns an error if the file cannot be read or if values are out of range.
pub fn read_light(path: impl AsRef<Path>) -> Result<Option<(Light, Vec<String>)>> {
    let input = Input::open(path.as_ref())?;
    let known = input.has(CONTAINER) || VARIABLES.iter().all(|(name, ..)| input.has(name));
    known.then(|| get_light(&input)).transpose()
}

/// Attributes of one of the [`VARIABLES`].
fn attributes(
    (_, _, units, long_name, standard_name): Described,
) -> Vec<(&'static str, Attribute<'static>)> {
    let named = (!standard_name.is_empty()).then_some(("standard_name", Text(standard_name)));
    [("units", Text(units)), ("long_name", Text(long_name))].into_iter().chain(named).collect()
}

/// Add the dimension of the wavelengths (um) of several bands to a file that is being written.
pub(super) fn put_wavelengths(output: &mut Output, wavelengths: &[f64]) -> Result<()> {
    let described = VARIABLES.into_iter().find(|(name, ..)| *name == WAVELENGTH);
    output.dimension(WAVELENGTH, wavelengths, &attributes(described.expect("it is one of them")))
}

/// Add the scene illumination of images to a file that is being written, without the wavelength if
/// that is a dimension. Assumed values are omitted.
pub(super) fn put_light(output: &Output, observation: &Observation) -> Result<()> {
    let mut values = observation.light.values();
    for described @ (name, key, ..) in VARIABLES {
        let value = values.remove(key).and_then(|value| value.as_float());
        if !output.has_dimension(name) {
            output.scalar(name, value.expect("a number"), &attributes(described))?;
        }
    }
    values.retain(|key, _| !observation.assumed.contains(key));
    // Many programs expose attributes as identifiers, which cannot contain a dot.
    let pairs: Vec<(String, toml::Value, String)> = values
        .into_iter()
        .map(|(key, value)| {
            let text = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
            (key.replace('.', "_"), value, text)
        })
        .collect();
    let long_name = "scene illumination: atmosphere, surface, boundaries, droplet optics";
    let mut attributes: Vec<(&str, Attribute)> = vec![("long_name", Text(long_name))];
    attributes.extend(pairs.iter().map(|(name, value, text)| {
        let attribute = value.as_float().map_or(Text(text), Number);
        (name.as_str(), attribute)
    }));
    output.variable(CONTAINER, &[], ndarray::arr0(0_i32).view(), &attributes)
}

/// The scene illumination of an open file and the required keys that it does not specify.
pub(super) fn get_light(input: &Input) -> Result<(Light, Vec<String>)> {
    let mut values = BTreeMap::new();
    for (name, key, unit, ..) in VARIABLES {
        // The irradiance has the unit of the radiances times sr, whichever that is.
        let number = match name {
            // Radiances in sr-1, and others are refused without it.
            IRRADIANCE if !input.has(name) => 1.0,
            IRRADIANCE => input.scalar(name, None)?,
            _ => input.scalar(name, Some(unit))?,
        };
        values.insert(key.to_owned(), toml::Value::Float(number));
    }
    if input.has(CONTAINER) {
        let container = input.variable(CONTAINER)?;
        let known: Vec<String> = Light::keys().iter().map(|key| key.replace('.', "_")).collect();
        let other = |name: &&String| {
            let of_the_format = OTHER_ATTRIBUTES.contains(&&***name) || name.starts_with('_');
            !of_the_format && !known.contains(name)
        };
        if let Some(name) = container.attributes().iter().find(other) {
            let remedy = "correct the name of the attribute; `deepct config light` lists the keys, \
                          in which a dot is written as _";
            return Err(container.error(format!("has an unknown attribute {name}"), remedy));
        }
        for key in Light::keys() {
            let name = key.replace('.', "_");
            let value = match (container.number(&name), container.text(&name)) {
                (Some(number), _) => toml::Value::Float(number),
                (_, Some(text)) => match text.as_str() {
                    "true" => toml::Value::Boolean(true),
                    "false" => toml::Value::Boolean(false),
                    _ => toml::Value::String(text),
                },
                (None, None) if container.attributes().contains(&name) => {
                    let problem = format!("has an attribute {name} that is no number and no text");
                    return Err(container.error(problem, "write a number, a text, true or false"));
                }
                (None, None) => continue,
            };
            values.insert((*key).to_owned(), value);
        }
    }
    let light = Light::default().with_values(&values).map_err(|problem| {
        let names = "scene illumination";
        input.error(names, problem.to_string(), "correct the value")
    })?;
    let unknown = Light::required_keys().iter().filter(|key| !values.contains_key(**key));
    Ok((light, unknown.map(|key| (*key).to_owned()).collect()))
}
