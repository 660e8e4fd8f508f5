//! Sensor model: conversion of radiance to electrons and grey levels, and back to radiance.
//!
//! The number of photons is random, the pixel adds dark charge, the readout adds noise, and the
//! analogue-to-digital converter rounds to grey levels and saturates. A pixel without charge is far
//! enough above the lowest grey level (the black level of a camera) for noise of both signs, so that
//! the mean of dark pixels is right. The variance of a pixel is
//! that of the paper (Sde-Chen et al. 2021, section 2.2): `V = i + D dt + read^2 + g^2 / 12` in
//! electrons squared.

use crate::error::{Error, Result};
use crate::image::ViewStack;
use crate::rng::{Purpose, Stream, stream};
use crate::scene::Observation;
use ndarray::Array3;
use rand_distr::{Distribution, Normal, Poisson};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Height of the black level above the lowest grey level, in standard deviations of the read noise.
const BLACK_DEVIATIONS: f64 = 6.0;

/// Number of standard errors that are subtracted from a pixel before it sets the exposure.
const DOUBT: f32 = 2.0;

/// The largest number of bits of a converter that is accepted.
const MAX_BITS: u32 = 24;

/// Characteristics of a sensor as given in its data sheet.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    /// Full well capacity: the charge at which a pixel saturates (electrons).
    pub full_well: f64,
    /// Standard deviation of the readout noise (electrons).
    pub read_noise: f64,
    /// Dark current: charge that accumulates without light (electrons per second).
    pub dark_current: f64,
    /// Number of bits of the converter: the full well is divided into `2^bits` grey levels, in
    /// addition to those below the black level.
    pub bits: u32,
    /// Exposure time (seconds).
    pub exposure: f64,
    /// Distance between pixels on the detector (um). It does not affect the noise: the view defines
    /// which part of the scene a pixel observes.
    pub pixel_pitch: f64,
}

/// Conversion of radiance to charge.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Scale {
    /// The brightest pixel of all views reaches the full well, as in the paper. Twice the
    /// standard error of each pixel is subtracted first, if it is known: single noisy pixels of a
    /// quick rendering do not set the exposure.
    BrightestAtFullWell,
    /// Number of electrons for a radiance of 1/sr.
    ElectronsPerRadiance(f64),
}

/// The output of a sensor for a stack of images.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensed {
    /// Radiance (1/sr) derived from the grey levels after subtraction of the mean dark charge: a
    /// pixel without light may be slightly negative.
    pub images: ViewStack,
    /// Standard deviation of the noise of each pixel (1/sr), estimated from the noisy charge, as is
    /// possible with the images alone.
    pub noise: ViewStack,
    /// Pixels that are saturated: it is only known that they are at least as bright as their
    /// radiance.
    pub saturated: Array3<bool>,
    /// The conversion factor that was used (electrons sr).
    pub electrons_per_radiance: f64,
}

impl Sensed {
    /// The standard error of each pixel (1/sr): the noise of the sensor and, if `before` is given,
    /// the standard error of the images before they were sensed, added in quadrature.
    ///
    /// # Errors
    /// A `before` whose shape differs from that of the images.
    pub fn standard_error(&self, before: Option<&ViewStack>) -> Result<ViewStack> {
        let Some(before) = before else { return Ok(self.noise.clone()) };
        check_shape(&self.noise, before)?;
        let both = ndarray::Zip::from(&self.noise.values)
            .and(&before.values)
            .map_collect(|noise, before| noise.hypot(*before));
        ViewStack::of_errors(both)
    }
}

impl Sensor {
    /// The CMV4000 of the paper at 25 degrees Celsius (ams, CMV4000 data sheet).
    pub const CMV4000: Self = Self {
        full_well: 13_500.0,
        read_noise: 13.0,
        dark_current: 125.0,
        bits: 10,
        exposure: 762e-6,
        pixel_pitch: 5.5,
    };

    /// Names of the presets.
    pub const PRESETS: [&'static str; 1] = ["cmv4000"];

    /// The preset with the given name.
    pub fn preset(name: &str) -> Option<Self> {
        (name == "cmv4000").then_some(Self::CMV4000)
    }

    /// Reads a sensor from a TOML file with one key for each field of [`Sensor`].
    ///
    /// # Errors
    /// A file that cannot be read, a missing or unknown key, a number out of range.
    pub fn from_file(path: &Path) -> Result<Self> {
        let remedy = "give full_well, read_noise (electrons), dark_current (electrons/s), bits, \
                      exposure (s) and pixel_pitch (um)";
        let sensor: Self = crate::files::read_toml(path, "sensor", remedy)?;
        sensor
            .check()
            .map_err(|problem| Error::file(path, "sensor", problem.to_string(), remedy))?;
        Ok(sensor)
    }

    /// Returns an error unless every value is physically possible.
    ///
    /// # Errors
    /// An [`Error::OutOfRange`] that names the first invalid value.
    pub fn check(&self) -> Result<()> {
        let positive = [
            ("full_well", self.full_well),
            ("exposure", self.exposure),
            ("pixel_pitch", self.pixel_pitch),
        ];
        for (name, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return Err(Error::out_of_range(name, value, "positive and finite"));
            }
        }
        for (name, value) in [("read_noise", self.read_noise), ("dark_current", self.dark_current)]
        {
            if !(value.is_finite() && value >= 0.0) {
                return Err(Error::out_of_range(name, value, "finite and not negative"));
            }
        }
        if !(1..=MAX_BITS).contains(&self.bits) {
            return Err(Error::out_of_range(
                "bits",
                self.bits,
                format!("between 1 and {MAX_BITS}"),
            ));
        }
        Ok(())
    }

    /// Electrons per grey level.
    pub fn electrons_per_count(&self) -> f64 {
        self.full_well / f64::from(1_u32 << self.bits)
    }

    /// The mean dark charge of an exposure (electrons).
    pub fn dark_charge(&self) -> f64 {
        self.dark_current * self.exposure
    }

    /// The paper's variance of the signal of a pixel (electrons squared) in which light releases
    /// `electrons` on average; it does not account for saturation.
    pub fn variance(&self, electrons: f64) -> f64 {
        let gain = self.electrons_per_count();
        electrons + self.dark_charge() + self.read_noise * self.read_noise + gain * gain / 12.0
    }

    /// The charge (electrons) that a saturated pixel reads, after subtraction of the dark charge.
    fn saturation(&self) -> f64 {
        f64::from((1_u32 << self.bits) - 1) * self.electrons_per_count() - self.dark_charge()
    }

    /// Number of grey levels below that of a pixel without charge.
    fn black_level(&self) -> f64 {
        (BLACK_DEVIATIONS * self.read_noise / self.electrons_per_count()).ceil()
    }

    /// Simulates one readout of a pixel in which light releases `electrons` on average, and returns
    /// it in electrons: dark charge and noise are added, the charge is rounded to a grey level, and
    /// the mean dark charge is subtracted.
    fn read(&self, electrons: f64, read_noise: &Normal<f64>, random: &mut Stream) -> f64 {
        let expected = electrons + self.dark_charge();
        // The Poisson distribution cannot be created for a mean of zero, where there is no charge,
        // nor for means so far above any full well that saturation hides their spread.
        let charge = Poisson::new(expected).map_or(expected, |poisson| poisson.sample(random));
        let signal = charge + read_noise.sample(random);
        let gain = self.electrons_per_count();
        let counts = (signal / gain).round().max(-self.black_level());
        (counts * gain - self.dark_charge()).min(self.saturation())
    }
}

/// An observation as recorded by a sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct Exposure {
    /// The noisy images, with the standard error of each pixel and with the saturated ones marked.
    pub observation: Observation,
    /// [`Sensed::electrons_per_radiance`].
    pub electrons_per_radiance: f64,
}

/// Applies a sensor to the images of an observation, see [`sense`]. The standard error of the
/// result combines the sensor noise and, if known, the standard error of the clean images.
///
/// # Errors
/// As [`sense`].
pub fn expose(clean: &Observation, sensor: &Sensor, scale: Scale, seed: u64) -> Result<Exposure> {
    let sensed = sense(&clean.images, clean.standard_error.as_ref(), sensor, scale, seed)?;
    let standard_error = Some(sensed.standard_error(clean.standard_error.as_ref())?);
    let observation = Observation { images: sensed.images, standard_error, ..clean.clone() };
    let mut saturated = sensed.saturated;
    if let Some(before) = &clean.saturated {
        saturated.zip_mut_with(before, |now, before| *now |= before);
    }
    let observation = observation.with_saturated(saturated)?;
    Ok(Exposure { observation, electrons_per_radiance: sensed.electrons_per_radiance })
}

/// Applies `sensor` to images without noise. Their `standard_error` (1/sr), if it is known, tells which
/// pixels may set the exposure. The result depends on `seed` and not on the number of
/// threads.
///
/// # Errors
/// A negative radiance, images without light if the brightest pixel defines the scale, a scale that
/// is not positive, a sensor that fails [`Sensor::check`].
pub fn sense(
    images: &ViewStack,
    standard_error: Option<&ViewStack>,
    sensor: &Sensor,
    scale: Scale,
    seed: u64,
) -> Result<Sensed> {
    sensor.check()?;
    check_radiance(images)?;
    if let Some(errors) = standard_error {
        check_shape(images, errors)?;
    }
    let electrons_per_radiance = electrons_per_radiance(images, standard_error, sensor, scale)?;
    let read_noise = Normal::new(0.0, sensor.read_noise).map_err(|problem| {
        Error::out_of_range("read_noise", sensor.read_noise, problem.to_string())
    })?;
    let [_, rows, cols] = images.shape();
    let mut sensed = images.values.as_standard_layout().into_owned();
    let pixels = sensed.as_slice_mut().expect("the layout was just made standard");
    pixels.par_chunks_mut(cols).enumerate().for_each(|(line, pixels)| {
        let (view, row) = ((line / rows) as u64, (line % rows) as u64);
        let mut random = stream(seed, Purpose::Sensor, &[view, row]);
        for radiance in pixels.iter_mut().filter(|radiance| !radiance.is_nan()) {
            let electrons = f64::from(*radiance) * electrons_per_radiance;
            let read = sensor.read(electrons, &read_noise, &mut random);
            *radiance = (read / electrons_per_radiance) as f32;
        }
    });
    let brightest = (sensor.saturation() / electrons_per_radiance) as f32;
    let saturated = sensed.mapv(|radiance| radiance >= brightest);
    let noise = sensed.mapv(|radiance| {
        if radiance.is_nan() {
            return f32::INFINITY;
        }
        let electrons = (f64::from(radiance) * electrons_per_radiance).max(0.0);
        (sensor.variance(electrons).sqrt() / electrons_per_radiance) as f32
    });
    let (images, noise) = (ViewStack::with_missing(sensed)?, ViewStack::of_errors(noise)?);
    Ok(Sensed { images, noise, saturated, electrons_per_radiance })
}

fn electrons_per_radiance(
    images: &ViewStack,
    standard_error: Option<&ViewStack>,
    sensor: &Sensor,
    scale: Scale,
) -> Result<f64> {
    match scale {
        Scale::ElectronsPerRadiance(factor) => {
            // The largest radiance that the sensor can record.
            let most = sensor.full_well / factor;
            if factor.is_finite() && most > f64::from(f32::MIN_POSITIVE) && most.is_finite() {
                return Ok(factor);
            }
            let range = "positive (electrons sr), with a full well that is a radiance";
            Err(Error::out_of_range("scale", format!("{factor:e}"), range))
        }
        Scale::BrightestAtFullWell => {
            let certain = standard_error.map(|errors| {
                let pixels = images.values.iter().zip(&errors.values);
                let certain = pixels.map(|(radiance, error)| radiance - DOUBT * error);
                certain.fold(f32::NEG_INFINITY, f32::max)
            });
            let certain = certain.filter(|certain| *certain > 0.0);
            let brightest = f64::from(certain.unwrap_or_else(|| images.brightest()));
            if brightest > 0.0 {
                return Ok(sensor.full_well / brightest);
            }
            Err(Error::out_of_range(
                "brightest radiance",
                brightest,
                "positive (1/sr) where it sets the scale; give a scale for dark images",
            ))
        }
    }
}

fn check_shape(images: &ViewStack, errors: &ViewStack) -> Result<()> {
    if errors.shape() == images.shape() {
        return Ok(());
    }
    Err(Error::mismatch(
        "shape [view, row, col] of the standard error",
        format!("{:?}", images.shape()),
        format!("{:?}", errors.shape()),
        "give the error of the images that are sensed",
    ))
}

fn check_radiance(images: &ViewStack) -> Result<()> {
    match images.values.indexed_iter().find(|(_, value)| **value < 0.0) {
        None => Ok(()),
        Some(((view, row, col), value)) => Err(Error::out_of_range(
            "radiance",
            format!("{value} at [view {view}, row {row}, col {col}]"),
            "not negative: give images without noise",
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The CMV4000 with twice the full well and grey levels of the same width: nothing saturates at
    /// 13,500 electrons.
    const DEEP: Sensor = Sensor { full_well: 27_000.0, bits: 11, ..Sensor::CMV4000 };

    fn constant(radiance: f32) -> ViewStack {
        ViewStack::new(Array3::from_elem((4, 200, 250), radiance)).unwrap()
    }

    fn mean_and_variance(values: &Array3<f32>) -> (f64, f64) {
        let count = values.len() as f64;
        let mean = values.iter().map(|&value| f64::from(value)).sum::<f64>() / count;
        let square = values.iter().map(|&value| (f64::from(value) - mean).powi(2)).sum::<f64>();
        (mean, square / (count - 1.0))
    }

    /// A radiance of 1/sr corresponds to one electron, so moments are in electrons. The mean of n
    /// pixels has the variance V / n. As the distribution is nearly Gaussian, their sample variance
    /// has the relative variance 2 / (n - 1). Both must agree within 4 standard deviations.
    #[test]
    fn mean_and_variance_are_those_of_the_paper() {
        for (seed, electrons) in
            [0.0, 5.0, 20.0, 60.0_f32, 135.0, 1350.0, 6750.0, 13_500.0].into_iter().enumerate()
        {
            let images = constant(electrons);
            let scale = Scale::ElectronsPerRadiance(1.0);
            let sensed = sense(&images, None, &DEEP, scale, seed as u64).unwrap().images;
            let count = sensed.values.len() as f64;
            let (mean, variance) = mean_and_variance(&sensed.values);
            let gain = 13_500.0 / 1024.0;
            let expected = f64::from(electrons) + 125.0 * 762e-6 + 169.0 + gain * gain / 12.0;
            let electrons = f64::from(electrons);
            assert!(
                (mean - electrons).abs() < 4.0 * (expected / count).sqrt(),
                "{electrons} {mean}"
            );
            let spread = (2.0 / (count - 1.0)).sqrt();
            assert!((variance / expected - 1.0).abs() < 4.0 * spread, "{variance} {expected}");
        }
    }

    /// The ratios agree with the published ones within half a unit of the last digit.
    #[test]
    fn signal_to_noise_of_the_cmv4000() {
        for (electrons, ratio, half_digit) in
            [(13_500.0, 115.0, 0.5), (6750.0, 81.0, 0.5), (1350.0, 34.0, 0.5), (135.0, 7.6, 0.05)]
        {
            let found: f64 = electrons / Sensor::CMV4000.variance(electrons).sqrt();
            assert!((found - ratio).abs() < half_digit, "{found} {ratio}");
        }
        assert!((Sensor::CMV4000.electrons_per_count() - 13.18).abs() < 0.01);
        assert!((Sensor::CMV4000.dark_charge() - 0.095).abs() < 0.001);
    }

    #[test]
    fn readings_are_grey_levels_and_saturate() {
        let sensor = Sensor::CMV4000;
        let images = constant(0.3);
        let sensed = sense(&images, None, &sensor, Scale::BrightestAtFullWell, 7).unwrap();
        assert!((sensed.electrons_per_radiance * f64::from(0.3_f32) - 13_500.0).abs() < 1e-6);
        let counts = sensed.images.values.mapv(|radiance| {
            (f64::from(radiance) * sensed.electrons_per_radiance + sensor.dark_charge())
                / sensor.electrons_per_count()
        });
        for count in &counts {
            assert!((count - count.round()).abs() < 1e-3, "{count} is between grey levels");
        }
        let saturated = counts.iter().filter(|count| count.round() == 1023.0).count();
        assert!(counts.iter().all(|count| count.round() <= 1023.0));
        // The mean signal is 1024 levels and its noise 9: 56 % of the pixels round to 1023 or more.
        assert!((saturated as f64 / counts.len() as f64 - 0.563).abs() < 0.01);
        assert_eq!(sensed.saturated.iter().filter(|marked| **marked).count(), saturated);
        let far_above = Scale::ElectronsPerRadiance(1e30);
        let sensed = sense(&images, None, &sensor, far_above, 7).unwrap();
        let top = (1023.0 * sensor.electrons_per_count() - sensor.dark_charge()) / 1e30;
        assert!(
            sensed.images.values.iter().all(|&value| (f64::from(value) / top - 1.0).abs() < 1e-6)
        );
    }

    /// A single noisy pixel of a quick rendering does not set the exposure.
    #[test]
    fn a_firefly_does_not_set_the_exposure() {
        let view = crate::scene::View::orthographic(
            crate::math::DVec3::Z,
            crate::math::DVec3::ZERO,
            0.1,
            [200, 250],
        );
        let mut images = constant(0.2);
        images.values[[2, 3, 4]] = 0.3;
        let views = vec![view.unwrap(); 4];
        let mut clean =
            Observation::new(crate::scene::Sun::default(), views, images.clone()).unwrap();
        let scale = |clean: &Observation| {
            let exposure = expose(clean, &Sensor::CMV4000, Scale::BrightestAtFullWell, 1).unwrap();
            exposure.electrons_per_radiance
        };
        assert!((scale(&clean) - 13_500.0 / 0.3).abs() < 0.01);
        let mut errors = images.values.mapv(|_| 0.001);
        errors[[2, 3, 4]] = 0.1;
        clean.standard_error = Some(ViewStack::new(errors).unwrap());
        assert!((scale(&clean) - 13_500.0 / 0.198).abs() < 0.01);
        let marked = Array3::from_shape_fn(images.values.dim(), |place| place == (1, 2, 3));
        let marked = clean.with_saturated(marked).unwrap();
        let faint = Scale::ElectronsPerRadiance(1e4);
        let sensed = expose(&marked, &Sensor::CMV4000, faint, 1).unwrap().observation;
        assert_eq!(sensed.saturated, marked.saturated);
    }

    #[test]
    fn the_seed_alone_decides() {
        let images = constant(0.2);
        let scale = Scale::ElectronsPerRadiance(10_000.0);
        let by = |threads, seed| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| sense(&images, None, &Sensor::CMV4000, scale, seed).unwrap())
        };
        assert_eq!(by(1, 3), by(3, 3));
        assert_ne!(by(1, 3), by(1, 4));
        let sensed = by(1, 3).images;
        assert_ne!(sensed.image(0), sensed.image(1));
    }

    #[test]
    fn errors_add_in_squares() {
        let sensed =
            sense(&constant(0.2), None, &Sensor::CMV4000, Scale::ElectronsPerRadiance(1e4), 1)
                .unwrap();
        let before = ViewStack::new(&sensed.noise.values * 0.75).unwrap();
        let both = sensed.standard_error(Some(&before)).unwrap();
        for (both, noise) in both.values.iter().zip(&sensed.noise.values) {
            assert!((both / noise - 1.25).abs() < 1e-6);
        }
        assert_eq!(sensed.standard_error(None).unwrap(), sensed.noise);
        let other = ViewStack::new(Array3::zeros((1, 2, 3))).unwrap();
        assert!(sensed.standard_error(Some(&other)).is_err());
    }

    #[test]
    fn without_light_and_dark_charge_only_the_readout_is_left() {
        let sensor = Sensor { dark_current: 0.0, read_noise: 0.0, ..Sensor::CMV4000 };
        let sensed =
            sense(&constant(0.0), None, &sensor, Scale::ElectronsPerRadiance(1.0), 1).unwrap();
        assert!(sensed.images.values.iter().all(|&radiance| radiance == 0.0));
    }

    #[test]
    fn what_no_sensor_can_see_is_refused() {
        let scale = Scale::BrightestAtFullWell;
        assert!(sense(&constant(-0.1), None, &Sensor::CMV4000, scale, 1).is_err());
        assert!(sense(&constant(0.0), None, &Sensor::CMV4000, scale, 1).is_err());
        for factor in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let scale = Scale::ElectronsPerRadiance(factor);
            assert!(sense(&constant(0.1), None, &Sensor::CMV4000, scale, 1).is_err());
        }
        let no_bits = Sensor { bits: 0, ..Sensor::CMV4000 };
        assert!(sense(&constant(0.1), None, &no_bits, scale, 1).is_err());
    }

    #[test]
    fn a_sensor_file_has_every_number_and_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sensor.toml");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            Sensor::from_file(&path)
        };
        let text = toml::to_string(&Sensor::CMV4000).unwrap();
        assert_eq!(read(&text).unwrap(), Sensor::CMV4000);
        for wrong in [
            text.replace("bits", "bit_depth"),
            text.replace("bits = 10", "bits = 64"),
            text.replace("full_well = 13500.0", "full_well = -1.0"),
            format!("{text}\ngain = 2.0"),
            text.replace("exposure", "# exposure"),
        ] {
            let message = read(&wrong).unwrap_err().to_string();
            assert!(message.contains("sensor.toml"), "{message}");
        }
    }
}
