//! `Light`: everything about a scene but the cloud.

use crate::error::raise;
use deepct_core::scene;
use pyo3::exceptions::{PyAttributeError, PyTypeError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::collections::BTreeMap;

/// Values by the keys of the library.
type Values = BTreeMap<String, toml::Value>;

/// The light of a scene: Sun, wavelength, droplet optics, molecular atmosphere, surface and lateral
/// boundaries. All values are keywords; what is not given has its default.
///
/// Parameters
/// ----------
/// sun_zenith_deg : float, 30
///     Angle between the zenith and the Sun (degrees), in [0, 90).
/// sun_azimuth_deg : float, 45
///     Azimuth towards the Sun, clockwise from north (degrees).
/// solar_irradiance : float, 1
///     Solar irradiance on a surface normal to the beam; radiances are in its unit per steradian.
/// wavelength : float, 0.672
///     Wavelength (um).
/// air : bool, False
///     Whether there is the molecular (Rayleigh) atmosphere.
/// surface_albedo : float, 0.05
///     Lambertian albedo of the surface.
/// surface_altitude_km : float, 0
///     Altitude of the surface (km).
/// wind_speed : float, optional
///     Wind speed over the sea (m/s), whose waves reflect sunlight.
/// periodic : bool, False
///     Whether the grid is repeated without end beyond its horizontal sides.
/// phase : str, "hg"
///     Phase function: "hg" (Henyey and Greenstein), "mie" or "isotropic".
/// extinction : str, "geometric"
///     Extinction of a cloud that is known by its droplets: "geometric" or "mie".
/// asymmetry : float, 0.86
///     Asymmetry parameter ("hg").
/// single_scattering_albedo : float, 1
///     Single-scattering albedo ("hg", "isotropic").
/// distribution : str, "gamma"
///     Droplet size distribution: "gamma" or "lognormal" ("mie").
/// bandwidth : float, 0
///     Width of the spectral band (um) around the wavelength ("mie").
/// effective_variance : float, 0.1
///     Effective variance of the droplet size distribution ("mie").
/// effective_radius : float, optional
///     Effective radius of all droplets (um) ("mie").
///
/// Raises
/// ------
/// TypeError
///     An unknown keyword.
/// ValueError
///     A value of a wrong type or out of range.
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

    /// The light that a file of images states, opened by xarray. What it does not state has its
    /// default; a warning names it.
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

    /// The same light with other values of some keywords.
    #[pyo3(signature = (**values), text_signature = "($self, **values)")]
    fn replace(&self, values: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let mut given = Values::new();
        for (name, object) in values.into_iter().flatten() {
            let name: String = name.extract()?;
            let Some(key) = scene::Light::keys().iter().find(|key| plain(key) == name) else {
                let names: Vec<_> = scene::Light::keys().iter().map(|key| plain(key)).collect();
                let text = format!("Light has no \"{name}\"; it has {}", names.join(", "));
                return Err(PyTypeError::new_err(text));
            };
            if !object.is_none() {
                given.insert((*key).to_owned(), value(&object, &name)?);
            }
        }
        self.0.with_values(&given).map(Self).map_err(raise)
    }

    /// Its values by keyword; those that are not set are absent.
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

/// The light that an argument gives, or the default one.
pub(crate) fn or_default(light: Option<Light>) -> scene::Light {
    light.map_or_else(scene::Light::default, |light| light.0)
}

/// A key of the library as a keyword.
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
