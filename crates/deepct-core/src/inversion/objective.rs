//! The objective function: half the misfit plus the prior divided by the number of pixels.

use super::conjugate_gradient;
use super::curvature::Curvature;
use super::optimiser::Function;
use super::prior::Prior;
use super::variables::Variables;
use super::{ForwardModel, InversionSettings, Measurement};
use crate::error::Result;
use crate::grid::Volume;
use crate::image::ViewStack;
use crate::rng::{Purpose, RngExt, stream};
use crate::scene::View;

/// The objective function on one grid.
pub(super) struct Objective<'a> {
    pub(super) model: Box<dyn ForwardModel + 'a>,
    pub(super) measurement: &'a Measurement,
    pub(super) variables: Variables,
    pub(super) prior: Prior,
    /// The point at which the second derivatives of the misfit were estimated.
    probed_at: Vec<f64>,
    /// Approximate second derivatives of the misfit; `None` if they were not estimated.
    curvature: Option<Curvature>,
    /// Expected extinction of the cloudy part of each voxel in the prior (1/km).
    expected: Vec<f64>,
    /// The point of the last evaluation and the images of the model there.
    last: Option<(Vec<f64>, ViewStack)>,
    /// The misfit at the point of the last gradient.
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
        Self {
            model,
            measurement,
            variables,
            prior,
            probed_at: Vec::new(),
            curvature: None,
            expected,
            last: None,
            misfit: f64::INFINITY,
        }
    }

    /// Sets the expected extinction of the cloudy parts: the prior then applies to the difference
    /// from it.
    pub(super) fn expect(&mut self, cloudy: &Volume) {
        self.expected = self.variables.gather(&cloudy.values.mapv(f64::from));
    }

    /// The difference at `x` from the extinction that the prior expects (1/km).
    fn unexpected(&self, x: &[f64]) -> Vec<f64> {
        let cloudy = self.variables.cloudy(x);
        cloudy.iter().zip(&self.expected).map(|(cloudy, expected)| cloudy - expected).collect()
    }

    /// The misfit at the point of the last gradient.
    pub(super) fn misfit(&self) -> f64 {
        self.misfit
    }

    /// The point of the last [`Objective::probe`].
    pub(super) fn probed_at(&self) -> &[f64] {
        &self.probed_at
    }

    /// Forgets all evaluations but the point and the second derivatives.
    pub(super) fn forget(&mut self) {
        self.last = None;
        self.model.forget();
    }

    /// The mean squared difference of the images at `x` from the measured ones, independent of the
    /// standard errors.
    pub(super) fn difference(&mut self, x: &[f64]) -> Result<f64> {
        let images = self.model.images(&self.variables.extinction(x)?)?;
        self.measurement.difference(&images)
    }

    /// Estimates the second derivatives of the misfit at `x`.
    ///
    /// The diagonal of the Gauss-Newton matrix is estimated from random combinations of the pixels
    /// (Bekas, Kokiopoulou and Saad 2007), each of which requires one gradient, and smoothed over
    /// neighbouring voxels.
    pub(super) fn probe(
        &mut self,
        x: &[f64],
        settings: &InversionSettings,
        views: &[View],
    ) -> Result<()> {
        self.probed_at = x.to_vec();
        self.curvature = None;
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
        squares.iter_mut().for_each(|square| *square /= settings.probes as f64);
        let field = self.variables.scatter(&squares);
        let counted = self.variables.scatter(&vec![1.0; count]).mapv(|one| one > 0.0);
        let diagonal = self.variables.gather(&super::blocks::smooth(&field, &counted));
        let extinction = self.variables.extinction(x)?;
        let (measurement, variables) = (self.measurement, &self.variables);
        let curvature = Curvature::new(measurement, views, &extinction, variables, diagonal);
        self.curvature = Some(curvature);
        Ok(())
    }
}

impl Function for Objective<'_> {
    fn value(&mut self, x: &[f64]) -> Result<f64> {
        let images = match self.last.take() {
            Some((last, images)) if last == x => images,
            _ => self.model.images(&self.variables.extinction(x)?)?,
        };
        let misfit = self.measurement.misfit(&images)?;
        let prior = self.prior.value(&self.unexpected(x));
        self.last = Some((x.to_vec(), images));
        Ok(0.5 * misfit + prior / self.measurement.pixels() as f64)
    }

    fn gradient(&mut self) -> Result<Vec<f64>> {
        let (x, images) = self.last.as_ref().expect("gradient() must be called after value()");
        self.misfit = self.measurement.misfit(images)?;
        let derivatives = self.model.gradient(&self.measurement.derivative(images)?)?;
        let pixels = self.measurement.pixels() as f64;
        let mut prior = self.prior.gradient(&self.unexpected(x));
        prior.iter_mut().for_each(|derivative| *derivative /= pixels);
        Ok(self.variables.pull_back(x, &derivatives, &prior))
    }

    fn preconditioned(&self, x: &[f64], vector: Vec<f64>, free: &[bool]) -> Vec<f64> {
        let Some(curvature) = &self.curvature else { return vector };
        let slopes = self.variables.slopes(x);
        let pixels = self.measurement.pixels() as f64;
        let product = |change: &[f64]| -> Vec<f64> {
            let extinction: Vec<f64> = change.iter().zip(&slopes).map(|(c, s)| c * s).collect();
            // The prior is quadratic: its gradient at a change is the product of its Hessian with
            // the change.
            let prior = self.prior.gradient(&extinction);
            let mut product = curvature.times(change);
            for (i, product) in product.iter_mut().enumerate() {
                *product = if free[i] { *product + slopes[i] * prior[i] / pixels } else { 0.0 };
            }
            product
        };
        let mut diagonal = curvature.diagonal();
        let prior = self.prior.diagonal(x.len());
        for ((diagonal, prior), slope) in diagonal.iter_mut().zip(prior).zip(&slopes) {
            *diagonal += slope * slope * prior / pixels;
        }
        conjugate_gradient::solve(product, &diagonal, vector)
    }
}
