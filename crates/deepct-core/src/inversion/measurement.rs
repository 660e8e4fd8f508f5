//! The measured images with their standard errors, and the misfit of a model to them.

use super::calibration::{Prior, Seen, Slopes};
use super::{Calibration, InversionSettings};
use crate::error::{Error, Result};
use crate::grid::Mask;
use crate::image::ViewStack;
use crate::rng::Stream;
use crate::scene::{Observation, View};
use crate::traverse::walk;
use ndarray::{Array3, Axis, Zip};
use rand_distr::{Distribution, StandardNormal};

/// Images and the standard error of each pixel; the standard error of excluded pixels is infinite, and
/// the radiance of missing ones is 0.
#[derive(Debug, Clone, PartialEq)]
pub struct Measurement {
    images: ViewStack,
    standard_error: Array3<f32>,
    /// Whether the radiance of each pixel is a lower bound, because the pixel is saturated.
    is_bound: Array3<bool>,
    /// The largest radiance of the pixels that are not left out (1/sr).
    brightest: f64,
    /// What is known of the calibration of the camera of each view.
    cameras: Vec<Prior>,
    /// The change of the images of the model per row and per column by which its views are shifted;
    /// `None` if the directions of the cameras are known.
    slopes: Option<[Array3<f32>; 2]>,
    /// Number of pixels by which sums over the pixels are divided: that of all bands.
    count: usize,
}

impl Measurement {
    /// Creates a measurement from the images of an observation and their standard error or, if they
    /// have none, the `relative_noise` of the settings; the `model_error` and the `least_error` are
    /// added in quadrature. Pixels with an infinite standard error are excluded. The radiance of a
    /// saturated pixel is a lower bound, from which a brighter model does not differ.
    ///
    /// # Errors
    /// Images without light; a standard error whose shape differs from that of the images; no pixel
    /// that is included.
    pub fn new(observation: &Observation, settings: &InversionSettings) -> Result<Self> {
        let missing = observation.images.missing();
        let mut images = observation.images.clone();
        let brightest = f64::from(images.brightest());
        images.values.zip_mut_with(&missing, |radiance, missing| {
            *radiance = if *missing { 0.0 } else { *radiance };
        });
        if brightest <= 0.0 {
            return Err(Error::out_of_range("brightest radiance", brightest, "positive (1/sr)"));
        }
        let relative = |share: f64| images.values.mapv(|radiance| share * f64::from(radiance));
        let noise = match &observation.standard_error {
            None => relative(settings.relative_noise),
            Some(noise) if noise.shape() == images.shape() => {
                ViewStack::of_errors(noise.values.clone())?.values.mapv(f64::from)
            }
            Some(noise) => {
                return Err(Error::mismatch(
                    "shape [view, row, col] of the standard error",
                    format!("{:?}", images.shape()),
                    format!("{:?}", noise.shape()),
                    "give one standard error per pixel",
                ));
            }
        };
        let least = settings.least_error * brightest;
        let standard_error = Zip::from(&noise)
            .and(&relative(settings.model_error))
            .and(&missing)
            .map_collect(|noise, model, missing| match missing {
                true => f32::INFINITY,
                false => noise.hypot(*model).hypot(least) as f32,
            });
        check_errors(&standard_error)?;
        let nowhere = || Array3::from_elem(images.values.dim(), false);
        let is_bound = observation.saturated.clone().unwrap_or_else(nowhere);
        let cameras = vec![Prior::new(settings); images.values.len_of(Axis(0))];
        let count = included(&standard_error);
        let slopes = None;
        Ok(Self { images, standard_error, is_bound, brightest, cameras, slopes, count })
    }

    /// Returns the measurements of several bands such that their misfits add up to the mean over the
    /// pixels of all bands.
    pub(super) fn together(measurements: Vec<Self>) -> Vec<Self> {
        let count = measurements.iter().map(|band| included(&band.standard_error)).sum();
        measurements.into_iter().map(|band| Self { count, ..band }).collect()
    }

    /// Returns the measurement with an additional error of the model, relative to the radiance,
    /// added in quadrature.
    pub(super) fn with_model_error(&self, share: f64) -> Self {
        let images = self.images.clone();
        let standard_error = Zip::from(&self.standard_error)
            .and(&images.values)
            .map_collect(|error, radiance| error.hypot(share as f32 * radiance));
        Self { images, standard_error, ..self.clone() }
    }

    /// Returns the measurement without the pixels whose lines of sight miss the mask, because they
    /// contain no information on the voxels inside.
    pub(super) fn of_mask(&self, mask: &Mask, views: &[View]) -> Self {
        let mut standard_error = self.standard_error.clone();
        let parts = [[0.5, 0.5], [0.01, 0.01], [0.01, 0.99], [0.99, 0.01], [0.99, 0.99]];
        for ((view, row, col), error) in standard_error.indexed_iter_mut() {
            let sees = parts.iter().any(|[down, right]| {
                let ray = views[view].ray(row as f64 + down, col as f64 + right);
                walk(&mask.grid, &ray).any(|step| mask.values[step.voxel])
            });
            if !sees {
                *error = f32::INFINITY;
            }
        }
        Self { count: included(&standard_error), standard_error, ..self.clone() }
    }

    /// Returns the measurement with other noise: random errors with the standard errors are added to the
    /// images and to the expected calibrations.
    pub(super) fn with_other_noise(&self, random: &mut Stream) -> Self {
        let mut other = self.clone();
        let mut normal = || -> f64 { StandardNormal.sample(random) };
        for (radiance, error) in other.images.values.iter_mut().zip(&self.standard_error) {
            if error.is_finite() {
                *radiance += normal() as f32 * error;
            }
        }
        for camera in &mut other.cameras {
            for (expected, error) in camera.expected.iter_mut().zip(camera.errors) {
                *expected += normal() * error;
            }
        }
        other
    }

    /// Returns the measurement for a model whose views have these offsets, to which calibrations are
    /// relative, and whose images change by these slopes for each row and column that they are shifted.
    pub(super) fn of_views(&self, offsets: &[[f64; 2]], slopes: Option<[Array3<f32>; 2]>) -> Self {
        let mut moved = Self { slopes, ..self.clone() };
        for (camera, [row, col]) in moved.cameras.iter_mut().zip(offsets) {
            camera.expected[1] -= row;
            camera.expected[2] -= col;
        }
        moved
    }

    /// Whether each pixel is included.
    pub(super) fn counted(&self) -> Array3<bool> {
        self.standard_error.mapv(f32::is_finite)
    }

    /// Number of pixels that are included, of all bands if there are several; at least 1.
    pub fn pixels(&self) -> usize {
        self.count.max(1)
    }

    /// The most likely calibration of the camera of each view, with which the images of a model are
    /// compared with the measured ones: that which minimises the sum of the squared ratios of the
    /// residuals to their standard errors, and of the differences from the expected calibration to
    /// theirs.
    ///
    /// # Errors
    /// Images whose shape differs from that of the measurement.
    pub fn calibrations(&self, images: &ViewStack) -> Result<Vec<Calibration>> {
        self.check(images)?;
        let calibration = |(view, camera): (usize, &Prior)| {
            let seen = Seen {
                image: self.images.values.index_axis(Axis(0), view),
                standard_error: self.standard_error.index_axis(Axis(0), view),
                is_bound: self.is_bound.index_axis(Axis(0), view),
                slopes: self.slopes_of(view),
            };
            camera.most_likely(&seen, images.values.index_axis(Axis(0), view))
        };
        Ok(self.cameras.iter().enumerate().map(calibration).collect())
    }

    /// The misfit: the mean over all included pixels of the squared ratio of the residual to its
    /// standard error, with the most likely calibrations and including their prior.
    ///
    /// # Errors
    /// Images whose shape differs from that of the measurement.
    pub fn misfit(&self, images: &ViewStack) -> Result<f64> {
        let calibrations = self.calibrations(images)?;
        let residuals = self.residuals(images, &calibrations);
        let squares = residuals.iter().zip(&self.standard_error).map(|(residual, error)| {
            let residual = f64::from(*residual) / f64::from(*error);
            residual * residual
        });
        let cameras = self.cameras.iter().zip(calibrations);
        let unusual: f64 = cameras.map(|(camera, found)| camera.size_of(found)).sum();
        Ok((squares.sum::<f64>() + unusual) / self.pixels() as f64)
    }

    fn slopes_of(&self, view: usize) -> Slopes<'_> {
        let [rows, cols] = self.slopes.as_ref()?;
        Some([rows, cols].map(|slopes| slopes.index_axis(Axis(0), view)))
    }

    /// The difference of each pixel of a model, as its camera sees it, from the measured one.
    fn residuals(&self, images: &ViewStack, calibrations: &[Calibration]) -> Array3<f32> {
        let mut residuals = images.values.clone();
        let cameras = residuals.outer_iter_mut().zip(calibrations).enumerate();
        for (view, (mut image, calibration)) in cameras {
            let seen = calibration.image(image.view(), &self.slopes_of(view));
            image.assign(&seen);
        }
        Zip::from(&mut residuals).and(&self.images.values).and(&self.is_bound).for_each(
            |residual, seen, is_bound| {
                *residual -= seen;
                *residual = if *is_bound { residual.min(0.0) } else { *residual };
            },
        );
        residuals
    }

    /// The mean over all included pixels of the squared residual, in units of the largest radiance, so that
    /// bright pixels contribute most.
    ///
    /// # Errors
    /// Images whose shape differs from that of the measurement.
    pub(super) fn difference(&self, images: &ViewStack) -> Result<f64> {
        self.check(images)?;
        let brightest = self.brightest;
        let known = vec![Calibration::NOMINAL; self.cameras.len()];
        let residuals = self.residuals(images, &known);
        let residuals = residuals.iter().zip(&self.standard_error);
        let included = residuals.filter(|(_, error)| error.is_finite());
        let squares = included.map(|(residual, _)| (f64::from(*residual) / brightest).powi(2));
        Ok(squares.sum::<f64>() / self.pixels() as f64)
    }

    /// The derivative of half the [`Measurement::misfit`] with respect to each pixel of the images.
    /// Since the misfit is smallest at the most likely calibrations, these count as constant (variable
    /// projection: Golub and Pereyra 1973).
    ///
    /// # Errors
    /// Images whose shape differs from that of the measurement.
    pub fn derivative(&self, images: &ViewStack) -> Result<ViewStack> {
        let calibrations = self.calibrations(images)?;
        let count = self.pixels() as f32;
        let mut derivative = Zip::from(&self.residuals(images, &calibrations))
            .and(&self.standard_error)
            .map_collect(|residual, error| residual / (error * error * count));
        for (mut image, calibration) in derivative.outer_iter_mut().zip(calibrations) {
            image *= calibration.gain as f32;
        }
        ViewStack::new(derivative)
    }

    /// The sum of the squared ratios of changes of the images to the standard errors, over the number
    /// of pixels.
    pub(super) fn size_of(&self, change: &Array3<f32>) -> f64 {
        let ratios = change.iter().zip(&self.standard_error).map(|(c, e)| f64::from(c / e));
        ratios.map(|ratio| ratio * ratio).sum::<f64>() / self.pixels() as f64
    }

    /// The included pixels, each with the weight `1 / standard error / sqrt(number of pixels)`: the
    /// squares of residuals with these weights sum to the misfit.
    pub(super) fn weights(&self) -> impl Iterator<Item = ([usize; 3], f64)> {
        let root = (self.pixels() as f64).sqrt();
        let counted = self.standard_error.indexed_iter().filter(|(_, error)| error.is_finite());
        counted.map(move |((view, row, col), error)| {
            ([view, row, col], 1.0 / (f64::from(*error) * root))
        })
    }

    /// The weights `sign / standard error / sqrt(number of pixels)`. With random signs, the squared
    /// derivatives of the sum of pixels with these weights have the diagonal of the Gauss-Newton
    /// matrix of half the misfit as their expectation.
    ///
    /// # Errors
    /// None for signs of 1 and -1.
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

/// Number of pixels with a finite standard error.
fn included(standard_error: &Array3<f32>) -> usize {
    standard_error.iter().filter(|error| error.is_finite()).count()
}

fn check_errors(standard_error: &Array3<f32>) -> Result<()> {
    match standard_error.indexed_iter().find(|(_, error)| error.is_nan() || **error <= 0.0) {
        None if standard_error.iter().any(|error| error.is_finite()) => Ok(()),
        None => Err(Error::out_of_range(
            "standard error",
            "infinite in every pixel",
            "finite in those that are not left out, for example because they are saturated",
        )),
        Some(((view, row, col), error)) => Err(Error::out_of_range(
            "standard error",
            format!("{error} at [view {view}, row {row}, col {col}]"),
            "positive and finite (1/sr): set a relative_noise, model_error or least_error",
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;
    use crate::math::DVec3;
    use crate::scene::Sun;

    /// Calculated by hand for radiances of 3 and 4; the largest is 4.
    #[test]
    fn errors_add_in_quadrature() {
        let view = View::orthographic(DVec3::Z, DVec3::ZERO, 0.1, [1, 2]).unwrap();
        let stack = |a, b| ViewStack::new(ndarray::array![[[a, b]]]).unwrap();
        let mut seen = Observation::new(Sun::default(), vec![view], stack(3.0, 4.0)).unwrap();
        seen.standard_error = Some(stack(0.3, 0.0));
        let settings = InversionSettings {
            model_error: 0.1,
            least_error: 0.1,
            ..InversionSettings::default()
        };
        let measured = Measurement::new(&seen, &settings).unwrap();
        // 0.09 + 0.09 + 0.16 and 0 + 0.16 + 0.16.
        let misfit = measured.misfit(&stack(4.0, 3.0)).unwrap();
        assert!((misfit - 0.5 * (1.0 / 0.34 + 1.0 / 0.32)).abs() < 1e-6, "{misfit}");
        let derivative = measured.derivative(&stack(4.0, 3.0)).unwrap();
        assert!((derivative.values[[0, 0, 0]] - 0.5 / 0.34).abs() < 1e-6);
        assert!((derivative.values[[0, 0, 1]] + 0.5 / 0.32).abs() < 1e-6);
        let coarse = measured.with_model_error(0.2).misfit(&stack(4.0, 3.0)).unwrap();
        assert!((coarse - 0.5 * (1.0 / 0.70 + 1.0 / 0.96)).abs() < 1e-6, "{coarse}");
        assert!((measured.difference(&stack(4.0, 3.0)).unwrap() - 1.0 / 16.0).abs() < 1e-9);
        // The second pixel, in the east, does not observe a mask in the west.
        let grid = Grid::new(DVec3::new(-0.1, -0.05, 0.0), DVec3::splat(0.1), [1, 1, 2]).unwrap();
        let west = Mask::new(grid, ndarray::array![[[true, false]]]).unwrap();
        let half = measured.of_mask(&west, &seen.views);
        assert_eq!(half.pixels(), 1);
        let misfit = half.misfit(&stack(4.0, 9.0)).unwrap();
        assert!((misfit - 1.0 / 0.34).abs() < 1e-6, "{misfit}");
        let partly = |errors| seen.clone().with_standard_error(errors).unwrap();
        let left = partly(ndarray::array![[[0.3, f32::INFINITY]]]);
        let left = Measurement::new(&left, &settings).unwrap();
        assert_eq!(left.pixels(), 1);
        // The errors are 0.3, 0.3 and 0.3: those relative to the largest radiance that is left.
        assert!((left.misfit(&stack(4.0, 9.0)).unwrap() - 1.0 / 0.27).abs() < 1e-6);
        let none = partly(Array3::from_elem((1, 1, 2), f32::INFINITY));
        assert!(Measurement::new(&none, &settings).is_err());
        // A radiance that is missing, without standard errors.
        let mut unknown = Observation { standard_error: None, ..seen.clone() };
        unknown.images.values[[0, 0, 1]] = f32::NAN;
        let left = Measurement::new(&unknown, &settings).unwrap();
        assert_eq!((left.pixels(), left.with_model_error(0.1).pixels()), (1, 1));
        assert!(left.derivative(&stack(4.0, 9.0)).unwrap().values[[0, 0, 1]] == 0.0);
        // A saturated pixel: only a darker model differs from it.
        let bound = seen.clone().with_saturated(ndarray::array![[[true, false]]]).unwrap();
        let bound = Measurement::new(&bound, &settings).unwrap();
        assert!((bound.misfit(&stack(2.0, 4.0)).unwrap() - 0.5 / 0.34).abs() < 1e-6);
        assert_eq!(bound.misfit(&stack(9.0, 4.0)).unwrap(), 0.0);
        assert_eq!(bound.derivative(&stack(9.0, 4.0)).unwrap().values[[0, 0, 0]], 0.0);
        let exact = InversionSettings { model_error: 0.0, least_error: 0.0, ..settings };
        let problem = Measurement::new(&seen, &exact).unwrap_err().to_string();
        assert!(problem.contains("col 1"), "{problem}");
        // In two equal bands, each contributes half of the mean.
        let [one, other] = &Measurement::together(vec![measured.clone(), measured.clone()])[..]
        else {
            panic!()
        };
        let images = stack(4.0, 3.0);
        let both = one.misfit(&images).unwrap() + other.misfit(&images).unwrap();
        assert!((both - measured.misfit(&images).unwrap()).abs() < 1e-12);
    }

    /// Two views of two pixels, by hand, and the derivative by central differences; one pixel of the
    /// second view is saturated.
    #[test]
    fn the_most_likely_calibrations_minimise_the_misfit() {
        let view = View::orthographic(DVec3::Z, DVec3::ZERO, 0.1, [1, 2]).unwrap();
        let stack = |values: [f32; 4]| {
            ViewStack::new(Array3::from_shape_vec((2, 1, 2), values.to_vec()).unwrap()).unwrap()
        };
        let views = vec![view.clone(), view];
        let seen = Observation::new(Sun::default(), views, stack([2.1, 4.2, 3.0, 5.0])).unwrap();
        let seen = seen.with_standard_error(Array3::from_elem((2, 1, 2), 0.2)).unwrap();
        let seen = seen.with_saturated(ndarray::array![[[false, false]], [[false, true]]]).unwrap();
        let measurement = |pointing_error| {
            let settings = InversionSettings {
                model_error: 0.0,
                least_error: 0.0,
                camera_gain_error: 0.05,
                pointing_error,
                ..InversionSettings::default()
            };
            Measurement::new(&seen, &settings).unwrap()
        };
        let images = stack([2.0, 4.0, 2.5, 6.0]);
        let found = measurement(0.0).calibrations(&images).unwrap();
        // (2 x 2.1 + 4 x 4.2) / 0.04 + 400 over (4 + 16) / 0.04 + 400; the saturated pixel is bright
        // enough, and (2.5 x 3) / 0.04 + 400 over 6.25 / 0.04 + 400.
        assert!((found[0].gain - (525.0 + 400.0) / (500.0 + 400.0)).abs() < 1e-6, "{found:?}");
        assert!((found[1].gain - (187.5 + 400.0) / (156.25 + 400.0)).abs() < 1e-6, "{found:?}");
        let cases = [[2.0, 4.0, 2.5, 6.0], [2.2, 3.0, 3.0, 4.0]];
        for (values, pointing_error) in cases.into_iter().flat_map(|v| [(v, 0.0), (v, 0.2)]) {
            let slopes = [stack([0.5, -1.0, 2.0, 1.0]), stack([3.0, 1.0, 0.1, 2.0])];
            let slopes = Some(slopes.map(|slopes| slopes.values));
            let measured = measurement(pointing_error).of_views(&[[0.1, 0.0]; 2], slopes);
            let derivative = measured.derivative(&stack(values)).unwrap();
            for (n, found) in derivative.values.iter().enumerate() {
                let moved = |step: f32| {
                    let mut values = values;
                    values[n] += step;
                    measured.misfit(&stack(values)).unwrap()
                };
                let difference = (moved(0.01) - moved(-0.01)) / 0.04;
                assert!((f64::from(*found) - difference).abs() < 2e-3, "{n}: {found} {difference}");
            }
        }
    }
}
