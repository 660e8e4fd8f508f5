//! `sense`: what a sensor makes of images.

use crate::array::{Floats, IMAGES, give};
use crate::error::raise;
use deepct_core::Error;
use deepct_core::image::ViewStack;
use deepct_core::sensor::{self, Scale};
use numpy::PyArray3;
use pyo3::prelude::*;
use std::path::PathBuf;

/// A sensor by the numbers of its data sheet.
///
/// Parameters
/// ----------
/// full_well : float
///     The charge that fills a pixel (electrons).
/// read_noise : float
///     Standard deviation of the readout (electrons).
/// dark_current : float
///     Charge that gathers without light (electrons per second).
/// bits : int
///     Bits of the converter.
/// exposure : float
///     Exposure time (seconds).
/// pixel_pitch : float
///     Distance between pixels on the chip (um); it does not enter the noise.
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

    /// The sensor of that name: `"cmv4000"`.
    #[staticmethod]
    fn preset(name: &str) -> PyResult<Self> {
        sensor::Sensor::preset(name).map(Self::from).ok_or_else(|| {
            let known = sensor::Sensor::PRESETS.join(", ");
            raise(Error::out_of_range("sensor", format!("\"{name}\""), format!("one of {known}")))
        })
    }

    /// A sensor from a TOML file with one line for each parameter.
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

/// What a sensor made of a stack of images.
///
/// Attributes
/// ----------
/// radiance : numpy.ndarray, float32, [view, row, col]
///     Radiance (1/sr) as read from the grey levels, the mean dark charge subtracted.
/// noise : numpy.ndarray, float32, [view, row, col]
///     Standard deviation of each pixel's noise (1/sr), from the charge that was read.
/// electrons_per_radiance : float
///     The factor that was used (electrons sr).
#[pyclass(frozen, module = "deepct_py", get_all)]
pub(crate) struct Sensed {
    radiance: Py<PyArray3<f32>>,
    noise: Py<PyArray3<f32>>,
    electrons_per_radiance: f64,
}

/// A sensor, or the name of one.
#[derive(FromPyObject)]
pub(crate) enum SensorChoice {
    /// By its numbers.
    Sensor(Sensor),
    /// By its name.
    Name(String),
}

/// What a sensor makes of images: photon, dark, read and quantisation noise.
///
/// Parameters
/// ----------
/// radiance : array, [view, row, col]
///     Images without noise (1/sr).
/// sensor : Sensor or str
///     The sensor or the name of one; the CMV4000 where it is not given.
/// electrons_per_radiance : float, optional
///     Electrons for a radiance of 1/sr. Where it is not given, the brightest pixel over all
///     views fills its well.
/// seed : int
///     Seed of the random numbers.
///
/// Returns
/// -------
/// Sensed
///
/// Raises
/// ------
/// ValueError
///     A negative radiance, a number out of range, an unknown sensor.
#[pyfunction]
#[pyo3(signature = (radiance, sensor = None, *, electrons_per_radiance = None, seed = 1))]
pub(crate) fn sense(
    py: Python<'_>,
    radiance: &Bound<'_, PyAny>,
    sensor: Option<SensorChoice>,
    electrons_per_radiance: Option<f64>,
    seed: u64,
) -> PyResult<Sensed> {
    let sensor = match sensor {
        None => sensor::Sensor::CMV4000,
        Some(SensorChoice::Sensor(sensor)) => sensor.core(),
        Some(SensorChoice::Name(name)) => Sensor::preset(&name)?.core(),
    };
    let scale =
        electrons_per_radiance.map_or(Scale::BrightestAtFullWell, Scale::ElectronsPerRadiance);
    let radiance = Floats::new(radiance, "radiance", IMAGES)?.to_owned();
    let sensed = py
        .detach(|| sensor::sense(&ViewStack::new(radiance)?, &sensor, scale, seed))
        .map_err(raise)?;
    Ok(Sensed {
        radiance: give(py, sensed.images.values),
        noise: give(py, sensed.noise.values),
        electrons_per_radiance: sensed.electrons_per_radiance,
    })
}
