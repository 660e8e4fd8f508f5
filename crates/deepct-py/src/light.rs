//! `Light`: the scene illumination, that is, all properties of a scene except the cloud.

use crate::array::{give, volume};
use crate::error::{in_python, raise};
use crate::exchange::{is_dataset, through_circumstances, through_file};
use crate::number::reals;
use crate::record::{Record, record};
use deepct_core::image::ViewStack;
use deepct_core::{io, scene};
use numpy::PyArray3;
use numpy::ndarray::Array3;
use pyo3::exceptions::{PyTypeError, PyUserWarning, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::ffi::CString;
use std::path::{Path, PathBuf};

/// Scene illumination: Sun, wavelength, droplet optics, molecular atmosphere, surface and lateral
/// boundaries. All parameters are keywords; the value after each type is the default.
///
/// Parameters
/// ----------
/// sun_zenith_deg : float, 30
///     Angle between the zenith and the Sun (degrees), in [0, 90).
/// sun_azimuth_deg : float, 45
///     Azimuth of the direction towards the Sun, clockwise from north (degrees).
/// sun : (float, float), optional
///     Both angles: zenith and azimuth (degrees), in place of the two keywords above.
/// solar_irradiance : float, 1
///     Solar irradiance on a surface normal to the beam; radiances have this unit per steradian.
/// wavelength : float, 0.672
///     Wavelength (um).
/// air : bool, False
///     Whether the scene includes the molecular (Rayleigh-scattering) atmosphere.
/// gas_optical_depth : float, optional
///     Vertical optical depth of the gases above the clouds that absorb at the wavelength, such as water
///     vapour and carbon dioxide. By default they do not absorb.
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
/// assumed : sequence of str
///     The keywords whose values are not known; files do not state them.
///
/// Raises
/// ------
/// TypeError
///     A keyword is unknown.
/// ValueError
///     A value has the wrong type or is out of range.
///
/// Examples
/// --------
/// >>> light = deepct_py.Light(sun=(40, 120), air=True)
/// >>> light.sun_zenith_deg, light.wavelength
/// (40.0, 0.672)
#[pyclass(frozen, from_py_object, module = "deepct_py")]
#[derive(Clone)]
pub(crate) struct Light {
    pub(crate) core: scene::Light,
    /// Keys of the values that are assumed because they are not known.
    pub(crate) assumed: Vec<String>,
}

/// Two volumes.
type Pair = (Py<PyArray3<f32>>, Py<PyArray3<f32>>);

record!(Light);

impl Record for Light {
    fn arguments<'py>(of: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        let arguments = of.get().to_dict(of.py())?;
        if !of.get().assumed.is_empty() {
            arguments.set_item("assumed", of.get().assumed())?;
        }
        Ok(arguments)
    }
}

#[pymethods]
impl Light {
    #[new]
    #[pyo3(
        signature = (*, sun = None, assumed = Vec::new(), **values),
        text_signature = "(*, sun_zenith_deg=30.0, sun_azimuth_deg=45.0, sun=None, \
                          solar_irradiance=1.0, wavelength=0.672, air=False, \
                          gas_optical_depth=None, surface_albedo=0.05, \
                          surface_altitude_km=0.0, wind_speed=None, periodic=False, phase='hg', extinction='geometric', asymmetry=0.86, \
                          single_scattering_albedo=1.0, distribution='gamma', bandwidth=0.0, \
                          effective_variance=None, effective_radius=None, assumed=())",
    )]
    fn new(
        py: Python<'_>,
        sun: Option<&Bound<'_, PyAny>>,
        assumed: Vec<String>,
        values: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let values = values.map_or_else(|| Ok(PyDict::new(py)), |values| values.copy())?;
        if let Some(sun) = sun {
            let [zenith, azimuth] = reals(sun, "sun", ["zenith", "azimuth"])?;
            for (name, angle) in [("sun_zenith_deg", zenith), ("sun_azimuth_deg", azimuth)] {
                if values.contains(name)? {
                    return Err(PyTypeError::new_err(format!("give either sun or {name}")));
                }
                values.set_item(name, angle)?;
            }
        }
        let light = Self::from(scene::Light::default()).replace(Some(&values))?;
        let assumed = assumed.iter().map(|name| key(name)).collect::<PyResult<Vec<&str>>>()?;
        Ok(Self { assumed: assumed.into_iter().map(str::to_owned).collect(), ..light })
    }

    /// The scene illumination stored in an image file that was opened with xarray. Values that the
    /// file does not state have their defaults and are listed in a warning and in `assumed`.
    #[staticmethod]
    fn from_dataset(dataset: &Bound<'_, PyAny>) -> PyResult<Self> {
        let light = through_file(dataset, "", Self::read)?.ok_or_else(|| {
            PyValueError::new_err("the data set has no scene illumination, such as sun_zenith_deg")
        })?;
        light.warn_of_assumed(dataset.py())?;
        Ok(light)
    }

    /// Zenith angle of the Sun and azimuth towards it, clockwise from north (degrees).
    #[getter]
    fn sun(&self) -> (f64, f64) {
        (self.core.sun.zenith.to_degrees(), self.core.sun.azimuth.to_degrees())
    }

    /// The names of the values that are assumed because they are not known, for example because the
    /// file of the images does not state them.
    #[getter]
    fn assumed(&self) -> Vec<&str> {
        self.assumed.iter().map(|key| plain(key)).collect()
    }

    /// A copy with other values of the given keywords.
    #[pyo3(signature = (**values), text_signature = "($self, **values)")]
    fn replace(&self, values: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let mut given = self.core.values();
        let mut assumed = self.assumed.clone();
        for (name, object) in values.into_iter().flatten() {
            let name: String = name.extract()?;
            let key = key(&name)?;
            match object.is_none() {
                true => given.remove(key),
                false => given.insert(key.to_owned(), value(&object, &name)?),
            };
            assumed.retain(|unknown| unknown != key);
        }
        let core = scene::Light::default().with_values(&given).map_err(raise)?;
        Ok(Self { core, assumed })
    }

    /// The extinction per liquid water content of droplets, which multiplies a liquid water content to
    /// an extinction, with its derivative.
    ///
    /// Parameters
    /// ----------
    /// effective_radius : array [z, y, x]
    ///     Effective radius (um), positive, also in clear voxels.
    ///
    /// Returns
    /// -------
    /// (numpy.ndarray, numpy.ndarray)
    ///     Extinction per liquid water content (1/km per g/m3) and its derivative with respect to the
    ///     effective radius (per um), float32, [z, y, x]: `1500 / effective_radius` for the extinction
    ///     "geometric", that of Mie theory for "mie".
    ///
    /// Raises
    /// ------
    /// ValueError
    ///     A radius is not positive, or beyond the table of droplet optics.
    ///
    /// Examples
    /// --------
    /// >>> value, derivative = deepct_py.Light().extinction_per_water(np.full((1, 1, 1), 10.0))
    /// >>> float(value[0, 0, 0]), float(derivative[0, 0, 0])
    /// (150.0, -15.0)
    fn extinction_per_water(&self, effective_radius: &Bound<'_, PyAny>) -> PyResult<Pair> {
        let py = effective_radius.py();
        let radii = volume(effective_radius, "effective_radius")?.values;
        let (value, derivative) =
            py.detach(|| self.core.extinction_per_water(&radii)).map_err(raise)?;
        Ok((give(py, value), give(py, derivative)))
    }

    /// The values by keyword. Optional values that are not set are absent.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let values = PyDict::new(py);
        for (key, value) in self.core.values() {
            values.set_item(plain(&key), object(py, &value)?)?;
        }
        Ok(values)
    }
}

/// Defines the attributes of a light by their documentation and names.
macro_rules! values {
    ($($doc:literal $name:ident)*) => {
        #[pymethods]
        impl Light {
            $(
                #[doc = $doc]
                #[getter]
                fn $name(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
                    let values = self.core.values();
                    let value = values.get(key(stringify!($name))?);
                    value.map_or_else(|| Ok(py.None()), |value| object(py, value))
                }
            )*
        }
    };
}

values! {
    "Angle between the zenith and the Sun (degrees)." sun_zenith_deg
    "Azimuth of the direction towards the Sun, clockwise from north (degrees)." sun_azimuth_deg
    "Solar irradiance on a surface normal to the beam." solar_irradiance
    "Wavelength (um)." wavelength
    "Whether the scene includes the molecular (Rayleigh-scattering) atmosphere." air
    "Vertical optical depth of the absorbing gases above the clouds; None without them." gas_optical_depth
    "Lambertian albedo of the surface." surface_albedo
    "Altitude of the surface (km)." surface_altitude_km
    "Wind speed over the ocean (m/s); None for a surface without waves." wind_speed
    "Whether the scene is periodic in the horizontal directions." periodic
    "Phase function: \"hg\" (Henyey and Greenstein), \"mie\" or \"isotropic\"." phase
    "Extinction efficiency for clouds given by their droplets: \"geometric\" (2) or \"mie\"." extinction
    "Asymmetry parameter (only for the phase function \"hg\")." asymmetry
    "Single-scattering albedo (only for \"hg\" and \"isotropic\")." single_scattering_albedo
    "Shape of the droplet size distribution: \"gamma\" or \"lognormal\"." distribution
    "Width of the spectral band (um) centred on the wavelength." bandwidth
    "Effective variance of the droplet size distribution; None for that of the cloud, or 0.1." effective_variance
    "Effective radius of all droplets (um); None for that of the cloud." effective_radius
}

impl From<scene::Light> for Light {
    fn from(core: scene::Light) -> Self {
        Self { core, assumed: Vec::new() }
    }
}

impl Light {
    /// The scene illumination in a file; `None` if it has none.
    pub(crate) fn read(path: &Path) -> PyResult<Option<Self>> {
        let found = io::read_light(path).map_err(raise)?;
        Ok(found.map(|(core, assumed)| Self { core, assumed }))
    }

    /// The light that an argument states: an object of this module, a data set of xarray or a file. `None`
    /// for arrays, and where it is unknown.
    pub(crate) fn of(object: &Bound<'_, PyAny>) -> PyResult<Option<Self>> {
        if let Ok(path) = object.extract::<PathBuf>() {
            return Self::read(&path);
        }
        if is_dataset(object)? {
            return Ok(through_circumstances(object, Self::read)?.flatten());
        }
        let own = object.getattr("light").and_then(|light| Ok(light.extract::<Self>()?));
        Ok(own.ok())
    }

    /// Warns of the values that are assumed.
    pub(crate) fn warn_of_assumed(&self, py: Python<'_>) -> PyResult<()> {
        if self.assumed.is_empty() {
            return Ok(());
        }
        let names = self.assumed().join(", ");
        let text = format!("the file does not state {names}: defaults are assumed");
        warn(py, &text)
    }

    /// An observation with this light and without images, which files of volumes refer to.
    pub(crate) fn of_no_images(&self) -> scene::Observation {
        scene::Observation {
            light: self.core.clone(),
            assumed: self.assumed.clone(),
            views: Vec::new(),
            images: ViewStack { values: Array3::zeros((0, 0, 0)) },
            standard_error: None,
            saturated: None,
            incomplete: false,
        }
    }
}

/// Warns of what the discrete-ordinates solver neglects.
pub(crate) fn warn_of_neglected(py: Python<'_>, light: &scene::Light) -> PyResult<()> {
    for warning in light.neglected_by_ordinates() {
        warn(py, warning)?;
    }
    Ok(())
}

/// Issues a warning.
pub(crate) fn warn(py: Python<'_>, warning: &str) -> PyResult<()> {
    let text = CString::new(in_python(warning)).expect("no zero byte");
    PyErr::warn(py, &py.get_type::<PyUserWarning>(), &text, 1)
}

/// The key of the library for a keyword of Python.
///
/// # Errors
/// `TypeError` if there is none.
fn key(name: &str) -> PyResult<&'static str> {
    let keys = scene::Light::keys();
    keys.iter().find(|key| plain(key) == name).copied().ok_or_else(|| {
        let names: Vec<_> = keys.iter().map(|key| plain(key)).collect();
        PyTypeError::new_err(format!("Light has no \"{name}\"; it has {}", names.join(", ")))
    })
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
