//! What was measured, how well, and how far a model is from it.

use super::InversionSettings;
use crate::error::{Error, Result};
use crate::image::ViewStack;
use crate::scene::Observation;
use ndarray::{Array3, Zip};

/// Standard errors below this share of the brightest pixel are taken as this: no model is
/// right to more digits.
const LEAST_ERROR: f64 = 1e-3;

/// Images and the standard error of each pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct Measurement {
    images: ViewStack,
    standard_error: Array3<f32>,
}

impl Measurement {
    /// The images of an observation with the standard error that it tells, or else the
    /// `relative_noise` of the settings; the `model_error` is added in quadrature, and a
    /// thousandth of the brightest pixel is the least.
    ///
    /// # Errors
    /// Images without light; a standard error of another shape.
    pub fn new(observation: &Observation, settings: &InversionSettings) -> Result<Self> {
        let images = observation.images.clone();
        let brightest = f64::from(images.brightest());
        if brightest <= 0.0 {
            return Err(Error::out_of_range("brightest radiance", brightest, "positive (1/sr)"));
        }
        let relative = |share: f64| images.values.mapv(|radiance| share * f64::from(radiance));
        let noise = match &observation.standard_error {
            None => relative(settings.relative_noise),
            Some(noise) if noise.shape() == images.shape() => noise.values.mapv(f64::from),
            Some(noise) => {
                return Err(Error::mismatch(
                    "shape [view, row, col] of the standard error",
                    format!("{:?}", images.shape()),
                    format!("{:?}", noise.shape()),
                    "give one standard error per pixel",
                ));
            }
        };
        let standard_error = Zip::from(&noise)
            .and(&relative(settings.model_error))
            .map_collect(|noise, model| noise.hypot(*model).max(LEAST_ERROR * brightest) as f32);
        Ok(Self { images, standard_error })
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.standard_error.len()
    }

    /// The mean over all pixels of the squared residual over its standard error.
    ///
    /// # Errors
    /// Images of another shape.
    pub fn misfit(&self, images: &ViewStack) -> Result<f64> {
        self.check(images)?;
        let residuals = images.values.iter().zip(&self.images.values).zip(&self.standard_error);
        let squares = residuals.map(|((model, seen), error)| {
            let residual = f64::from(model - seen) / f64::from(*error);
            residual * residual
        });
        Ok(squares.sum::<f64>() / self.pixels() as f64)
    }

    /// The derivative of half the [`Measurement::misfit`] with respect to each pixel of
    /// the images.
    ///
    /// # Errors
    /// Images of another shape.
    pub fn derivative(&self, images: &ViewStack) -> Result<ViewStack> {
        self.check(images)?;
        let count = self.pixels() as f32;
        ViewStack::new(
            Zip::from(&images.values)
                .and(&self.images.values)
                .and(&self.standard_error)
                .map_collect(|model, seen, error| (model - seen) / (error * error * count)),
        )
    }

    /// The weights `sign / standard error / sqrt(number of pixels)`: with random signs,
    /// the squares of the derivatives of such a sum have the diagonal of the Gauss-Newton
    /// matrix of half the misfit as their mean.
    ///
    /// # Errors
    /// Never, with signs of 1 and -1.
    pub(super) fn probe(&self, mut sign: impl FnMut() -> f32) -> Result<ViewStack> {
        let scale = 1.0 / (self.pixels() as f32).sqrt();
        ViewStack::new(self.standard_error.mapv(|error| sign() * scale / error))
    }

    fn check(&self, images: &ViewStack) -> Result<()> {
        if images.shape() == self.images.shape() {
            return Ok(());
        }
        Err(Error::mismatch(
            "shape [view, row, col] of the model's images",
            format!("{:?}", self.images.shape()),
            format!("{:?}", images.shape()),
            "give the model the views of the observation",
        ))
    }
}
