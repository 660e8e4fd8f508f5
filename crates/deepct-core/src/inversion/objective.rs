//! What is minimised: half the misfit plus the prior, by pixel.

use super::optimiser::Function;
use super::prior::Prior;
use super::variables::Variables;
use super::{ForwardModel, InversionSettings, Measurement};
use crate::error::Result;
use crate::grid::Volume;
use crate::image::ViewStack;
use crate::rng::{Purpose, RngExt, stream};

/// Sensitivities below this share of their mean count as this, squared: a voxel that no
/// pixel sees well is not thrown about.
const LEAST_SENSITIVITY: f64 = 0.1;

/// The objective on one grid.
pub(super) struct Objective<'a> {
    pub(super) model: Box<dyn ForwardModel + 'a>,
    pub(super) measurement: &'a Measurement,
    pub(super) variables: Variables,
    pub(super) prior: Prior,
    /// Extinction of the cloudy parts that the prior expects (1/km).
    expected: Vec<f64>,
    /// The point of the last value, with the model's images there.
    last: Option<(Vec<f64>, ViewStack)>,
    /// Misfit at the point of the last gradient.
    misfit: f64,
}

impl<'a> Objective<'a> {
    pub(super) fn new(
        model: Box<dyn ForwardModel + 'a>,
        measurement: &'a Measurement,
        variables: Variables,
        prior: Prior,
    ) -> Self {
        let expected = vec![0.0; variables.len()];
        Self { model, measurement, variables, prior, expected, last: None, misfit: f64::INFINITY }
    }

    /// Expect an extinction of the cloudy parts: the prior is then about what differs.
    pub(super) fn expect(&mut self, cloudy: &Volume) {
        self.expected = self.variables.gather(&cloudy.values.mapv(f64::from));
    }

    /// What differs at `x` from what the prior expects (1/km).
    fn unexpected(&self, x: &[f64]) -> Vec<f64> {
        let cloudy = self.variables.cloudy(x);
        cloudy.iter().zip(&self.expected).map(|(cloudy, expected)| cloudy - expected).collect()
    }

    /// Misfit at the point of the last gradient.
    pub(super) fn misfit(&self) -> f64 {
        self.misfit
    }

    /// How far the images at `x` are from those that were measured, whatever their
    /// standard errors.
    pub(super) fn difference(&mut self, x: &[f64]) -> Result<f64> {
        let images = self.model.images(&self.variables.extinction(x)?)?;
        self.measurement.difference(&images)
    }

    /// Give each variable the unit in which the curvature of the objective at `x` is about
    /// the same for all of them.
    ///
    /// The diagonal of the Gauss-Newton matrix is estimated by random combinations of the
    /// pixels (Bekas, Kokiopoulou and Saad 2007), whose derivatives cost a gradient each,
    /// and smoothed over neighbours.
    pub(super) fn precondition(&mut self, x: &[f64], settings: &InversionSettings) -> Result<()> {
        if settings.probes == 0 {
            return Ok(());
        }
        self.value(x)?;
        let count = self.variables.len();
        let mut squares = vec![0.0; count];
        for probe in 0..settings.probes {
            let mut random = stream(0, Purpose::Inversion, &[probe as u64]);
            let weights = self.measurement.probe(|| if random.random() { 1.0 } else { -1.0 })?;
            let derivatives = self.model.gradient(&weights)?;
            let derivatives = self.variables.pull_back(x, &derivatives, &vec![0.0; count]);
            squares.iter_mut().zip(derivatives).for_each(|(sum, d)| *sum += d * d);
        }
        let field = self.variables.scatter(&squares);
        let counted = self.variables.scatter(&vec![1.0; count]).mapv(|one| one > 0.0);
        let mut squares = self.variables.gather(&super::blocks::smooth(&field, &counted));
        let pixels = self.measurement.pixels() as f64;
        let prior = self.prior.diagonal(count);
        for (square, prior) in squares.iter_mut().zip(prior) {
            *square = *square / settings.probes as f64 + prior / pixels;
        }
        let mean = squares.iter().sum::<f64>() / count as f64;
        let scale = squares.iter().map(|s| ((s / mean).max(LEAST_SENSITIVITY.powi(2))).powf(-0.5));
        self.variables.set_scale(scale.collect());
        self.last = None;
        Ok(())
    }
}

impl Function for Objective<'_> {
    fn value(&mut self, x: &[f64]) -> Result<f64> {
        let images = self.model.images(&self.variables.extinction(x)?)?;
        let misfit = self.measurement.misfit(&images)?;
        let prior = self.prior.value(&self.unexpected(x));
        self.last = Some((x.to_vec(), images));
        Ok(0.5 * misfit + prior / self.measurement.pixels() as f64)
    }

    fn gradient(&mut self) -> Result<Vec<f64>> {
        let (x, images) = self.last.as_ref().expect("a gradient is asked for after a value");
        self.misfit = self.measurement.misfit(images)?;
        let derivatives = self.model.gradient(&self.measurement.derivative(images)?)?;
        let pixels = self.measurement.pixels() as f64;
        let mut prior = self.prior.gradient(&self.unexpected(x));
        prior.iter_mut().for_each(|derivative| *derivative /= pixels);
        Ok(self.variables.pull_back(x, &derivatives, &prior))
    }
}
