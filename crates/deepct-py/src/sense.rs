//! `sense`: simulation of the sensor.

use crate::array::{Floats, IMAGES, check_same, give};
use crate::compute::compute;
use crate::error::raise;
use deepct_core::Error;
use deepct_core::image::ViewStack;
use deepct_core::sensor::{self, Scale};
use numpy::PyArray3;
use pyo3::prelude::*;
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
#[pyclass(frozen, eq, from_py_object, module = "deepct_py", get_all)]
#[derive(Clone, Copy, PartialEq)]
pub(crate) struct Sensor {
    full_well: f64,
    read_noise: f64,
    dark_current: f64,
    bits: u32,
    exposure: f64,
    pixel_pitch: f64,
}

#[pymethods]
impl Sensor {
    #[new]
    #[pyo3(signature = (*, full_well, read_noise, dark_current, bits, exposure, pixel_pitch))]
    fn new(
        full_well: f64,
        read_noise: f64,
        dark_current: f64,
        bits: u32,
        exposure: f64,
        pixel_pitch: f64,
    ) -> PyResult<Self> {
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

    fn __repr__(&self) -> String {
        let Self { full_well, read_noise, dark_current, bits, exposure, pixel_pitch } = self;
        format!(
            "Sensor(full_well={full_well}, read_noise={read_noise}, dark_current={dark_current}, \
             bits={bits}, exposure={exposure}, pixel_pitch={pixel_pitch})"
        )
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

/// Images as measured by a sensor.
///
/// Attributes
/// ----------
/// radiance : numpy.ndarray, float32, [view, row, col]
///     Radiance (1/sr) derived from the grey levels, after subtraction of the mean dark charge.
/// noise : numpy.ndarray, float32, [view, row, col]
///     Standard deviation of the noise of each pixel (1/sr), estimated from the measured charge.
/// saturated : numpy.ndarray, bool, [view, row, col]
///     The pixels that are saturated: they are at least as bright as their radiance.
/// electrons_per_radiance : float
///     The factor between radiance and charge (electrons sr).
#[pyclass(frozen, module = "deepct_py", get_all)]
pub(crate) struct Sensed {
    radiance: Py<PyArray3<f32>>,
    noise: Py<PyArray3<f32>>,
    saturated: Py<PyArray3<bool>>,
    electrons_per_radiance: f64,
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
/// radiance : array, [view, row, col]
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
/// Sensed
///
/// Raises
/// ------
/// ValueError
///     A radiance is negative, a parameter is out of range, or the name of the sensor is unknown.
#[pyfunction]
#[pyo3(signature = (
    radiance, sensor = None, *, electrons_per_radiance = None, standard_error = None, seed = 1,
))]
pub(crate) fn sense(
    py: Python<'_>,
    radiance: &Bound<'_, PyAny>,
    sensor: Option<SensorChoice>,
    electrons_per_radiance: Option<f64>,
    standard_error: Option<&Bound<'_, PyAny>>,
    seed: u64,
) -> PyResult<Sensed> {
    let sensor = match sensor {
        None => sensor::Sensor::CMV4000,
        Some(SensorChoice::Sensor(sensor)) => sensor.core(),
        Some(SensorChoice::Name(name)) => Sensor::preset(&name)?.core(),
    };
    let scale =
        electrons_per_radiance.map_or(Scale::BrightestAtFullWell, Scale::ElectronsPerRadiance);
    check_same(&[(Some(radiance), "radiance"), (standard_error, "standard_error")], IMAGES)?;
    let radiance = Floats::new(radiance, "radiance", IMAGES)?.to_owned();
    let errors = standard_error
        .map(|errors| Ok::<_, PyErr>(Floats::new(errors, "standard_error", IMAGES)?.to_owned()))
        .transpose()?;
    let sensed = compute(py, move |_| {
        let errors = errors.map(ViewStack::of_errors).transpose()?;
        sensor::sense(&ViewStack::new(radiance)?, errors.as_ref(), &sensor, scale, seed)
    })?;
    Ok(Sensed {
        radiance: give(py, sensed.images.values),
        noise: give(py, sensed.noise.values),
        saturated: give(py, sensed.saturated),
        electrons_per_radiance: sensed.electrons_per_radiance,
    })
}
