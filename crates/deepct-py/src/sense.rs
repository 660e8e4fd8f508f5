//! `sense`: simulation of the sensor.

use crate::array::{check_pixels, give, images, marks};
use crate::compute::interruptibly;
use crate::error::raise;
use crate::light::Light;
use crate::lineage::Lineage;
use crate::number::whole;
use crate::observation::{Given, Observation, PARTS, is_complete, observation};
use crate::record::{Record, attributes, record};
use crate::view::ViewSequence;
use deepct_core::image::ViewStack;
use deepct_core::sensor::{self, Scale, expose};
use deepct_core::{Error, scene};
use numpy::PyArray3;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;

/// An image sensor, described by the parameters of its data sheet.
///
/// Parameters
/// ----------
/// full_well : float
///     Full-well capacity of a pixel (electrons).
/// read_noise : float
///     Standard deviation of the read noise (electrons).
/// dark_current : float
///     Dark current (electrons per second).
/// bits : int
///     Number of bits of the analogue-to-digital converter.
/// exposure : float
///     Exposure time (seconds).
/// pixel_pitch : float
///     Distance between pixels on the sensor (um); it does not affect the noise.
///
/// Examples
/// --------
/// >>> deepct_py.Sensor.preset("cmv4000").bits
/// 10
#[pyclass(frozen, from_py_object, module = "deepct_py", get_all)]
#[derive(Clone, Copy)]
pub(crate) struct Sensor {
    /// Full-well capacity of a pixel (electrons).
    full_well: f64,
    /// Standard deviation of the read noise (electrons).
    read_noise: f64,
    /// Dark current (electrons per second).
    dark_current: f64,
    /// Number of bits of the analogue-to-digital converter.
    bits: u32,
    /// Exposure time (seconds).
    exposure: f64,
    /// Distance between pixels on the sensor (um).
    pixel_pitch: f64,
}

record!(Sensor);

impl Record for Sensor {
    fn arguments<'py>(of: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        let names = ["full_well", "read_noise", "dark_current", "bits", "exposure", "pixel_pitch"];
        attributes(of.as_any(), &names)
    }
}

#[pymethods]
impl Sensor {
    #[new]
    #[pyo3(signature = (*, full_well, read_noise, dark_current, bits, exposure, pixel_pitch))]
    fn new(
        full_well: f64,
        read_noise: f64,
        dark_current: f64,
        bits: &Bound<'_, PyAny>,
        exposure: f64,
        pixel_pitch: f64,
    ) -> PyResult<Self> {
        let bits = whole(bits, "bits")?;
        let sensor = Self { full_well, read_noise, dark_current, bits, exposure, pixel_pitch };
        sensor.core().check().map_err(raise)?;
        Ok(sensor)
    }

    /// A predefined sensor by its name: `"cmv4000"`.
    #[staticmethod]
    fn preset(name: &str) -> PyResult<Self> {
        sensor::Sensor::preset(name).map(Self::from).ok_or_else(|| {
            let known = sensor::Sensor::PRESETS.join(", ");
            raise(Error::out_of_range("sensor", format!("\"{name}\""), format!("one of {known}")))
        })
    }

    /// Read a sensor from a TOML file that gives every parameter of `Sensor`.
    ///
    /// Raises
    /// ------
    /// OSError
    ///     The file cannot be read.
    /// DeepctError
    ///     The contents of the file are invalid.
    #[staticmethod]
    fn from_file(path: PathBuf) -> PyResult<Self> {
        sensor::Sensor::from_file(&path).map(Self::from).map_err(raise)
    }
}

impl Sensor {
    fn core(&self) -> sensor::Sensor {
        let Self { full_well, read_noise, dark_current, bits, exposure, pixel_pitch } = *self;
        sensor::Sensor { full_well, read_noise, dark_current, bits, exposure, pixel_pitch }
    }
}

impl From<sensor::Sensor> for Sensor {
    fn from(sensor: sensor::Sensor) -> Self {
        let sensor::Sensor { full_well, read_noise, dark_current, bits, exposure, pixel_pitch } =
            sensor;
        Self { full_well, read_noise, dark_current, bits, exposure, pixel_pitch }
    }
}

/// Images as measured by a sensor, without their cameras.
///
/// Parameters
/// ----------
/// radiance, noise : array, [view, row, col]
///     Images and their noise (1/sr).
/// saturated : array of bool, [view, row, col]
///     The pixels that are saturated.
/// electrons_per_radiance : float
///     The factor between radiance and charge (electrons sr).
#[pyclass(frozen, module = "deepct_py")]
pub(crate) struct Sensed {
    /// Radiance (1/sr) derived from the grey levels, after subtraction of the mean dark charge:
    /// numpy.ndarray, float32, [view, row, col].
    #[pyo3(get)]
    radiance: Py<PyArray3<f32>>,
    /// Standard deviation of the noise of each pixel (1/sr), estimated from the measured charge:
    /// numpy.ndarray, float32, [view, row, col].
    #[pyo3(get)]
    noise: Py<PyArray3<f32>>,
    /// The pixels that are saturated, which are at least as bright as their radiance: numpy.ndarray,
    /// bool, [view, row, col].
    #[pyo3(get)]
    saturated: Py<PyArray3<bool>>,
    /// The factor between radiance and charge (electrons sr).
    #[pyo3(get)]
    electrons_per_radiance: f64,
}

record!(Sensed);

impl Record for Sensed {
    fn arguments<'py>(of: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        let names = ["radiance", "noise", "saturated", "electrons_per_radiance"];
        attributes(of.as_any(), &names)
    }
}

#[pymethods]
impl Sensed {
    #[new]
    fn new(
        radiance: &Bound<'_, PyAny>,
        noise: &Bound<'_, PyAny>,
        saturated: &Bound<'_, PyAny>,
        electrons_per_radiance: f64,
    ) -> PyResult<Self> {
        let py = radiance.py();
        Ok(Self {
            radiance: give(py, images(radiance, "radiance")?),
            noise: give(py, images(noise, "standard_error")?),
            saturated: give(py, marks(saturated, "saturated")?),
            electrons_per_radiance,
        })
    }
}

/// An observation as recorded by a sensor: its radiance is derived from the grey levels, its standard
/// error contains the noise of the sensor, and saturated pixels are marked.
///
/// Constructed by `sense`; the arguments are those of `Observation` and `electrons_per_radiance`.
#[pyclass(frozen, extends = Observation, module = "deepct_py")]
pub(crate) struct Exposure {
    /// The factor between radiance and charge (electrons sr).
    #[pyo3(get)]
    electrons_per_radiance: f64,
}

record!(Exposure);

impl Record for Exposure {
    fn arguments<'py>(of: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        attributes(of.as_any(), &[&PARTS[..], &["electrons_per_radiance"]].concat())
    }
}

#[pymethods]
impl Exposure {
    #[new]
    #[pyo3(signature = (
        radiance, views, light = None, *, standard_error = None, saturated = None,
        electrons_per_radiance, lineage = None,
    ))]
    fn new(
        radiance: &Bound<'_, PyAny>,
        views: ViewSequence,
        light: Option<Light>,
        standard_error: Option<Bound<'_, PyAny>>,
        saturated: Option<Bound<'_, PyAny>>,
        electrons_per_radiance: f64,
        lineage: Option<Lineage>,
    ) -> PyResult<PyClassInitializer<Self>> {
        let images = Observation::new(radiance, views, light, standard_error, saturated, lineage)?;
        Ok(PyClassInitializer::from(images).add_subclass(Self { electrons_per_radiance }))
    }
}

/// A sensor, or the name of a predefined one.
#[derive(FromPyObject)]
pub(crate) enum SensorChoice {
    /// The sensor itself.
    Sensor(Sensor),
    /// The name of a predefined sensor.
    Name(String),
}

/// Simulate the measurement of images by a sensor: photon, dark, read and quantisation noise.
///
/// Parameters
/// ----------
/// radiance : Observation, array [view, row, col], str or path
///     Noise-free images (1/sr).
/// sensor : Sensor or str, optional
///     The sensor, or the name of a predefined one. Default: `"cmv4000"`.
/// electrons_per_radiance : float, optional
///     Number of electrons for a radiance of 1/sr. By default the brightest pixel over all views
///     reaches the full-well capacity.
/// standard_error : array, [view, row, col], optional
///     Standard error of the radiance (1/sr), such as that of a Monte Carlo rendering: twice this
///     error is subtracted before the brightest pixel is found.
/// seed : int
///     Seed of the random number generator.
///
/// Returns
/// -------
/// Exposure or Sensed
///     An `Exposure`, which is an `Observation`, for an observation; otherwise the arrays.
///
/// Raises
/// ------
/// ValueError
///     A radiance is negative, a parameter is out of range, or the name of the sensor is unknown.
///
/// Examples
/// --------
/// >>> cloud = deepct_py.generate_cloud(seed=3, width_km=0.4)
/// >>> images = deepct_py.render(cloud, views="cloudct-10", samples=16)
/// >>> noisy = deepct_py.sense(images, "cmv4000")
/// >>> noisy.views == images.views
/// True
#[pyfunction]
#[pyo3(
    signature = (
        radiance, sensor = None, *, electrons_per_radiance = None, standard_error = None,
        seed = None,
    ),
    text_signature = "(radiance, sensor='cmv4000', *, electrons_per_radiance=None, \
                      standard_error=None, seed=1)",
)]
pub(crate) fn sense<'py>(
    radiance: &Bound<'py, PyAny>,
    sensor: Option<SensorChoice>,
    electrons_per_radiance: Option<f64>,
    standard_error: Option<Bound<'py, PyAny>>,
    seed: Option<&Bound<'py, PyAny>>,
) -> PyResult<Py<PyAny>> {
    let py = radiance.py();
    let seed = seed.map_or(Ok(1), |seed| whole(seed, "seed"))?;
    let sensor = match sensor {
        None => sensor::Sensor::CMV4000,
        Some(SensorChoice::Sensor(sensor)) => sensor.core(),
        Some(SensorChoice::Name(name)) => Sensor::preset(&name)?.core(),
    };
    let scale =
        electrons_per_radiance.map_or(Scale::BrightestAtFullWell, Scale::ElectronsPerRadiance);
    if is_complete(radiance)? {
        let given = Given { views: None, light: None, standard_error, saturated: None };
        let clean = observation(radiance, given, |_| Ok(Light::from(scene::Light::default())))?;
        let exposed = interruptibly(py, move || expose(&clean, &sensor, scale, seed))?;
        let electrons_per_radiance = exposed.electrons_per_radiance;
        let images = Observation::give(py, exposed.observation, Lineage::after(radiance, "sense")?);
        let exposure =
            PyClassInitializer::from(images).add_subclass(Exposure { electrons_per_radiance });
        return Ok(Py::new(py, exposure)?.into_any());
    }
    check_pixels(radiance, standard_error.as_ref(), "standard_error")?;
    let radiance = images(radiance, "radiance")?;
    let errors = standard_error.map(|errors| images(&errors, "standard_error")).transpose()?;
    let sensed = interruptibly(py, move || {
        let errors = errors.map(ViewStack::of_errors).transpose()?;
        sensor::sense(&ViewStack::with_missing(radiance)?, errors.as_ref(), &sensor, scale, seed)
    })?;
    let sensed = Sensed {
        radiance: give(py, sensed.images.values),
        noise: give(py, sensed.noise.values),
        saturated: give(py, sensed.saturated),
        electrons_per_radiance: sensed.electrons_per_radiance,
    };
    Ok(Py::new(py, sensed)?.into_any())
}
