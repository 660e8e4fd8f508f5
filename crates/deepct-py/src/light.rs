//! `Light`: the scene illumination, that is, all properties of a scene except the cloud.

use crate::error::raise;
use deepct_core::scene;
use pyo3::exceptions::{PyAttributeError, PyTypeError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::collections::BTreeMap;

/// Values by their keys in the library, such as `optics.phase`.
type Values = BTreeMap<String, toml::Value>;

/// Scene illumination: Sun, wavelength, droplet optics, molecular atmosphere, surface and lateral
/// boundaries. All parameters are keywords; the value after each type is the default.
///
/// Parameters
/// ----------
/// sun_zenith_deg : float, 30
///     Angle between the zenith and the Sun (degrees), in [0, 90).
/// sun_azimuth_deg : float, 45
///     Azimuth of the direction towards the Sun, clockwise from north (degrees).
/// solar_irradiance : float, 1
///     Solar irradiance on a surface normal to the beam; radiances have this unit per steradian.
/// wavelength : float, 0.672
///     Wavelength (um).
/// air : bool, False
///     Whether the scene includes the molecular (Rayleigh-scattering) atmosphere.
/// surface_albedo : float, 0.05
///     Lambertian albedo of the surface.
/// surface_altitude_km : float, 0
///     Altitude of the surface (km).
/// wind_speed : float, optional
///     Wind speed over the ocean (m/s), the waves of which reflect sunlight. By default the
///     surface has no waves.
/// periodic : bool, False
///     Whether the scene is periodic in the horizontal directions.
/// phase : str, "hg"
///     Phase function: "hg" (Henyey and Greenstein), "mie" or "isotropic".
/// extinction : str, "geometric"
///     Extinction efficiency for clouds given by their droplets: "geometric" (2) or "mie".
/// asymmetry : float, 0.86
///     Asymmetry parameter (only for the phase function "hg").
/// single_scattering_albedo : float, 1
///     Single-scattering albedo (only for "hg" and "isotropic").
/// distribution : str, "gamma"
///     Shape of the droplet size distribution: "gamma" or "lognormal" (only for "mie").
/// bandwidth : float, 0
///     Width of the spectral band (um) centred on the wavelength (only for "mie").
/// effective_variance : float, 0.1
///     Effective variance of the droplet size distribution (only for "mie").
/// effective_radius : float, optional
///     Effective radius of all droplets (um) (only for "mie").
///
/// Raises
/// ------
/// TypeError
///     A keyword is unknown.
/// ValueError
///     A value has the wrong type or is out of range.
#[pyclass(frozen, eq, from_py_object, module = "deepct_py")]
#[derive(Clone, PartialEq)]
pub(crate) struct Light(pub(crate) scene::Light);

#[pymethods]
impl Light {
    #[new]
    #[pyo3(
        signature = (**values),
        text_signature = "(*, sun_zenith_deg=30.0, sun_azimuth_deg=45.0, solar_irradiance=1.0, \
                          wavelength=0.672, air=False, surface_albedo=0.05, \
                          surface_altitude_km=0.0, wind_speed=None, periodic=False, phase='hg', \
                          extinction='geometric', asymmetry=0.86, single_scattering_albedo=1.0, \
                          distribution='gamma', bandwidth=0.0, effective_variance=None, \
                          effective_radius=None)",
    )]
    fn new(values: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        Self(scene::Light::default()).replace(values)
    }

    /// The scene illumination stored in an image file that was opened with xarray. Values that the
    /// file does not state have their defaults and are listed in a warning.
    #[staticmethod]
    fn from_dataset(dataset: &Bound<'_, PyAny>) -> PyResult<Self> {
        let py = dataset.py();
        let mut values = Values::new();
        for (name, key) in [
            ("sun_zenith_deg", "sun_zenith_deg"),
            ("sun_azimuth_deg", "sun_azimuth_deg"),
            ("sun_irradiance", "solar_irradiance"),
            ("wavelength", "wavelength"),
        ] {
            let number = dataset.get_item(name)?.call_method0("item")?.extract::<f64>()?;
            values.insert(key.to_owned(), toml::Value::Float(number));
        }
        if dataset.contains("light")? {
            let attributes = dataset.get_item("light")?.getattr("attrs")?;
            for key in scene::Light::keys() {
                let name = key.replace('.', "_");
                if attributes.contains(&name)? {
                    values.insert((*key).to_owned(), value(&attributes.get_item(&name)?, &name)?);
                }
            }
        }
        let missing: Vec<&str> = scene::Light::required_keys()
            .iter()
            .filter(|key| !values.contains_key(**key))
            .map(|key| plain(key))
            .collect();
        if !missing.is_empty() {
            let text =
                format!("the file does not state {}: defaults are assumed", missing.join(", "));
            py.import("warnings")?.call_method1("warn", (text,))?;
        }
        scene::Light::default().with_values(&values).map(Self).map_err(raise)
    }

    /// A copy with other values of the given keywords.
    #[pyo3(signature = (**values), text_signature = "($self, **values)")]
    fn replace(&self, values: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let mut given = self.0.values();
        for (name, object) in values.into_iter().flatten() {
            let name: String = name.extract()?;
            let Some(key) = scene::Light::keys().iter().find(|key| plain(key) == name) else {
                let names: Vec<_> = scene::Light::keys().iter().map(|key| plain(key)).collect();
                let text = format!("Light has no \"{name}\"; it has {}", names.join(", "));
                return Err(PyTypeError::new_err(text));
            };
            match object.is_none() {
                true => given.remove(*key),
                false => given.insert((*key).to_owned(), value(&object, &name)?),
            };
        }
        scene::Light::default().with_values(&given).map(Self).map_err(raise)
    }

    /// The values by keyword. Optional values that are not set are absent.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let values = PyDict::new(py);
        for (key, value) in self.0.values() {
            values.set_item(plain(&key), object(py, &value)?)?;
        }
        Ok(values)
    }

    fn __getattr__(&self, py: Python<'_>, name: &str) -> PyResult<Py<PyAny>> {
        let Some(key) = scene::Light::keys().iter().find(|key| plain(key) == name) else {
            return Err(PyAttributeError::new_err(format!("Light has no attribute \"{name}\"")));
        };
        match self.0.values().get(*key) {
            Some(value) => object(py, value),
            None => Ok(py.None()),
        }
    }

    fn __repr__(&self) -> String {
        let values = self.0.values().into_iter();
        let pairs: Vec<_> = values
            .map(|(key, value)| match value {
                toml::Value::Boolean(true) => format!("{}=True", plain(&key)),
                toml::Value::Boolean(false) => format!("{}=False", plain(&key)),
                value => format!("{}={value}", plain(&key)),
            })
            .collect();
        format!("Light({})", pairs.join(", "))
    }
}

/// The light given as an argument, or the default.
pub(crate) fn or_default(light: Option<Light>) -> scene::Light {
    light.map_or_else(scene::Light::default, |light| light.0)
}

/// Warns of what the discrete-ordinates solver neglects.
pub(crate) fn warn_of_neglected(py: Python<'_>, light: &scene::Light) -> PyResult<()> {
    for warning in light.neglected_by_ordinates() {
        py.import("warnings")?.call_method1("warn", (warning,))?;
    }
    Ok(())
}

/// The Python keyword for a key of the library.
fn plain(key: &str) -> &str {
    key.rsplit('.').next().unwrap_or(key)
}

fn value(object: &Bound<'_, PyAny>, name: &str) -> PyResult<toml::Value> {
    if let Ok(text) = object.extract::<String>() {
        return Ok(match text.as_str() {
            "true" => toml::Value::Boolean(true),
            "false" => toml::Value::Boolean(false),
            _ => toml::Value::String(text),
        });
    }
    if let Ok(flag) = object.extract::<bool>() {
        return Ok(toml::Value::Boolean(flag));
    }
    let number = object.extract::<f64>().map_err(|_| {
        PyTypeError::new_err(format!("{name} must be a number, text, True or False"))
    })?;
    Ok(toml::Value::Float(number))
}

fn object(py: Python<'_>, value: &toml::Value) -> PyResult<Py<PyAny>> {
    Ok(match value {
        toml::Value::Float(number) => number.into_pyobject(py)?.into_any().unbind(),
        toml::Value::Boolean(flag) => flag.into_pyobject(py)?.to_owned().into_any().unbind(),
        value => value.as_str().unwrap_or_default().into_pyobject(py)?.into_any().unbind(),
    })
}
