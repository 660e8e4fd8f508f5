//! The objective function: half the misfit plus the prior divided by the number of pixels.

use super::conjugate_gradient;
use super::curvature::Curvature;
use super::optimiser::Function;
use super::prior::Prior;
use super::variables::{Unknowns, Variables};
use super::{Calibration, ForwardModel, InversionSettings, Measurement};
use crate::error::Result;
use crate::image::ViewStack;
use crate::rng::{Purpose, RngExt, Stream, stream};
use crate::scene::Observation;

/// The objective function on one grid.
pub(super) struct Objective<'a> {
    pub(super) model: Box<dyn ForwardModel + 'a>,
    /// The measurement of each band.
    measurements: Vec<Measurement>,
    pub(super) variables: Variables,
    pub(super) prior: Prior,
    /// The point at which the second derivatives of the misfit were estimated.
    probed_at: Vec<f64>,
    /// Approximate second derivatives of the misfit; `None` if they were not estimated.
    curvature: Option<Curvature>,
    /// The values that the prior expects: those of the cloudy part of each voxel (1/km) and of the
    /// other variables.
    expected: Vec<f64>,
    /// The point of the last evaluation and the images of the model there.
    last: Option<(Vec<f64>, Vec<ViewStack>)>,
    /// The misfit at the point of the last gradient.
    misfit: f64,
}

impl<'a> Objective<'a> {
    pub(super) fn new(
        model: Box<dyn ForwardModel + 'a>,
        measurements: Vec<Measurement>,
        variables: Variables,
        prior: Prior,
    ) -> Self {
        let expected = vec![0.0; variables.len()];
        Self {
            model,
            measurements,
            variables,
            prior,
            probed_at: Vec::new(),
            curvature: None,
            expected,
            last: None,
            misfit: f64::INFINITY,
        }
    }

    /// Sets the expected unknowns: the prior then applies to the difference from them.
    pub(super) fn expect(&mut self, unknowns: &Unknowns) {
        self.expected = self.variables.values(&self.variables.of(unknowns));
    }

    /// Replaces the measurements and the values that the prior expects by others of the same
    /// distribution.
    pub(super) fn disturb(&mut self, measurements: &[Measurement], random: &mut Stream) {
        let other = measurements.iter().map(|band| band.with_other_noise(random));
        self.measurements = other.collect();
        self.prior.disturb(random);
        self.forget();
    }

    /// The most likely calibration of each camera of each band at `x`.
    pub(super) fn calibrations(&mut self, x: &[f64]) -> Result<Vec<Vec<Calibration>>> {
        self.value(x)?;
        let (_, images) = self.last.as_ref().expect("value() was called");
        let bands = self.measurements.iter().zip(images);
        bands.map(|(measured, images)| measured.calibrations(images)).collect()
    }

    /// The difference at `x` from the values that the prior expects.
    fn unexpected(&self, x: &[f64]) -> Vec<f64> {
        let values = self.variables.values(x);
        values.iter().zip(&self.expected).map(|(value, expected)| value - expected).collect()
    }

    /// The images of each band at `x`, with their measurements.
    fn images(&mut self, x: &[f64]) -> Result<Vec<ViewStack>> {
        self.model.images(&self.variables.fields(x)?)
    }

    /// The sum over the bands of a function of the measurement and of the images.
    fn sum(
        &self,
        images: &[ViewStack],
        of: impl Fn(&Measurement, &ViewStack) -> Result<f64>,
    ) -> Result<f64> {
        self.measurements.iter().zip(images).map(|(measured, images)| of(measured, images)).sum()
    }

    /// Number of pixels of all bands.
    fn pixels(&self) -> f64 {
        self.measurements[0].pixels() as f64
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
        let images = self.images(x)?;
        self.sum(&images, Measurement::difference)
    }

    /// Estimates the second derivatives of the misfit at `x`.
    ///
    /// The diagonal of the Gauss-Newton matrix is estimated from random combinations of the pixels
    /// (Bekas, Kokiopoulou and Saad 2007), each of which requires one gradient, and smoothed over
    /// neighbouring voxels. For each variable of the profile of the effective radius, it follows from
    /// the change of the images.
    pub(super) fn probe(
        &mut self,
        x: &[f64],
        settings: &InversionSettings,
        bands: &[Observation],
    ) -> Result<()> {
        self.probed_at = x.to_vec();
        self.curvature = None;
        if settings.probes == 0 {
            return Ok(());
        }
        let of_profile = self.by_profile(x)?;
        self.value(x)?;
        let count = self.variables.len();
        let mut squares = vec![0.0; count];
        for probe in 0..settings.probes {
            let mut random = stream(0, Purpose::Inversion, &[probe as u64]);
            let mut sign = || if random.random() { 1.0 } else { -1.0 };
            let weights = self.measurements.iter().map(|measured| measured.probe(&mut sign));
            let derivatives = self.model.derivatives(&weights.collect::<Result<Vec<_>>>()?)?;
            let derivatives = self.variables.pull_back(x, &derivatives, &vec![0.0; count]);
            squares.iter_mut().zip(derivatives).for_each(|(sum, d)| *sum += d * d);
        }
        squares.iter_mut().for_each(|square| *square /= settings.probes as f64);
        let variables = &self.variables;
        let counted = variables.scatter(&vec![1.0; count]).mapv(|one| one > 0.0);
        for voxels in [variables.of_extinction(), variables.of_deviations()] {
            let field = variables.scatter(&squares[voxels.clone()]);
            let smooth = variables.gather(&super::blocks::smooth(&field, &counted));
            squares[voxels.clone()].copy_from_slice(&smooth[..voxels.len()]);
        }
        squares[variables.of_profile()].copy_from_slice(&of_profile);
        let extinction = variables.fields(x)?.extinction;
        let views = bands.iter().map(|band| &band.views[..]);
        let bands: Vec<_> = self.measurements.iter().zip(views).collect();
        self.curvature = Some(Curvature::new(&bands, &extinction, variables, squares));
        Ok(())
    }

    /// The second derivatives of the misfit with respect to the variables of the profile, in the
    /// Gauss-Newton approximation with finite differences of the images.
    fn by_profile(&mut self, x: &[f64]) -> Result<Vec<f64>> {
        let numbers = self.variables.of_profile();
        if numbers.is_empty() {
            return Ok(Vec::new());
        }
        let images = self.images(x)?;
        let second = |number: usize| {
            let mut moved = x.to_vec();
            moved[number] += 1.0;
            let changed = self.images(&moved)?;
            let bands = self.measurements.iter().zip(changed).zip(&images);
            let sizes = bands.map(|((measured, changed), before)| {
                measured.size_of(&(changed.values - &before.values))
            });
            Ok(sizes.sum())
        };
        let found = numbers.map(second).collect();
        // The model is no longer at the point of the last evaluation.
        self.last = None;
        found
    }
}

impl Function for Objective<'_> {
    fn value(&mut self, x: &[f64]) -> Result<f64> {
        let images = match self.last.take() {
            Some((last, images)) if last == x => images,
            _ => self.images(x)?,
        };
        let misfit = self.sum(&images, Measurement::misfit)?;
        let prior = self.prior.value(&self.unexpected(x));
        self.last = Some((x.to_vec(), images));
        Ok(0.5 * misfit + prior / self.pixels())
    }

    fn gradient(&mut self) -> Result<Vec<f64>> {
        let (x, images) = self.last.as_ref().expect("gradient() must be called after value()");
        self.misfit = self.sum(images, Measurement::misfit)?;
        let bands = self.measurements.iter().zip(images);
        let weights = bands.map(|(measured, images)| measured.derivative(images));
        let derivatives = self.model.derivatives(&weights.collect::<Result<Vec<_>>>()?)?;
        let pixels = self.pixels();
        let mut prior = self.prior.gradient(&self.unexpected(x));
        prior.iter_mut().for_each(|derivative| *derivative /= pixels);
        Ok(self.variables.pull_back(x, &derivatives, &prior))
    }

    fn preconditioned(&self, x: &[f64], vector: Vec<f64>, free: &[bool]) -> Vec<f64> {
        let Some(curvature) = &self.curvature else { return vector };
        let slopes = self.variables.slopes(x);
        let pixels = self.pixels();
        let product = |change: &[f64]| -> Vec<f64> {
            let values: Vec<f64> = change.iter().zip(&slopes).map(|(c, s)| c * s).collect();
            let prior = self.prior.times(&values);
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
