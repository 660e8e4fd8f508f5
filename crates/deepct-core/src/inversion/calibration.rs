//! What is not known of the cameras: their gains, and the directions in which they point.

use super::{Domain, InversionSettings, Models};
use crate::error::Result;
use crate::image::ViewStack;
use glam::{DMat3, DVec3};
use ndarray::{Array2, Array3, ArrayView2};
use serde::{Deserialize, Serialize};

/// The calibration of a camera, relative to that of the file of the images: a measured image is that
/// of a model, shifted and multiplied.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Factor by which the radiances are too large.
    pub gain: f64,
    /// Distance (rows, columns) of the point of the model's image that a pixel shows from the pixel.
    pub offset: [f64; 2],
}

impl Calibration {
    /// The calibration of the file of the images.
    pub const NOMINAL: Self = Self { gain: 1.0, offset: [0.0; 2] };

    fn new([gain, row, col]: [f64; 3]) -> Self {
        Self { gain, offset: [row, col] }
    }

    pub(super) fn values(self) -> [f64; 3] {
        let [row, col] = self.offset;
        [self.gain, row, col]
    }

    /// The image that the camera takes of the image of a model with these slopes, to first order in the
    /// offset.
    pub(super) fn image(self, model: ArrayView2<f32>, slopes: &Slopes) -> Array2<f32> {
        let mut image = self.gain as f32 * &model;
        for (offset, slopes) in self.offset.into_iter().zip(slopes.iter().flatten()) {
            image.scaled_add(offset as f32, slopes);
        }
        image
    }
}

/// The change of an image of the model per pixel by which its view is shifted along the rows and along
/// the columns; `None` if the direction of the camera is known.
pub(super) type Slopes<'a> = Option<[ArrayView2<'a, f32>; 2]>;

/// The measured image of a view, and the slopes of that of the model.
#[derive(Clone, Copy)]
pub(super) struct Seen<'a> {
    pub(super) image: ArrayView2<'a, f32>,
    /// Standard error of each pixel; infinite for pixels that are left out.
    pub(super) standard_error: ArrayView2<'a, f32>,
    /// Whether the radiance of each pixel is a lower bound.
    pub(super) is_bound: ArrayView2<'a, bool>,
    pub(super) slopes: Slopes<'a>,
}

/// What is known of the calibration of a camera before it takes an image: the expected values, each
/// with its standard error; 0 for values that are known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Prior {
    pub(super) expected: [f64; 3],
    pub(super) errors: [f64; 3],
}

/// Maximum number of steps in which a calibration is determined; there are more than two only if
/// pixels are saturated.
const STEPS: usize = 50;

impl Prior {
    pub(super) fn new(settings: &InversionSettings) -> Self {
        let InversionSettings { camera_gain_error: gain, pointing_error: pointing, .. } = *settings;
        Self { expected: Calibration::NOMINAL.values(), errors: [gain, pointing, pointing] }
    }

    /// The sum of the squared ratios of the differences from the expected values to their standard
    /// errors.
    pub(super) fn size_of(&self, calibration: Calibration) -> f64 {
        let values = calibration.values().into_iter().zip(self.expected).zip(self.errors);
        let ratios = values.filter(|(_, error)| *error > 0.0);
        ratios.map(|((value, expected), error)| ((value - expected) / error).powi(2)).sum()
    }

    /// The most likely calibration: that which minimises the sum of the squared ratios of the
    /// residuals to their standard errors, and of [`Prior::size_of`]. A saturated pixel takes part only
    /// where the model is too dark. Without slopes, the offset is the expected one.
    pub(super) fn most_likely(&self, seen: &Seen, model: ArrayView2<f32>) -> Calibration {
        let mut values = self.expected;
        let [gain_error, row_error, col_error] = self.errors;
        let errors = match seen.slopes {
            Some(_) => [gain_error, row_error, col_error],
            None => [gain_error, 0.0, 0.0],
        };
        if errors == [0.0; 3] {
            return Calibration::new(values);
        }
        for _ in 0..STEPS {
            // The normal equations of the differences from the expected values.
            let (mut matrix, mut right) = (DMat3::ZERO, DVec3::ZERO);
            for (at, radiance, error, is_bound) in seen.pixels() {
                let slope = |axis: usize| seen.slopes.as_ref().map_or(0.0, |s| s[axis][at]);
                let parts = [model[at], slope(0), slope(1)].map(f64::from);
                let sum = |values: [f64; 3]| -> f64 {
                    values.iter().zip(parts).map(|(value, part)| value * part).sum()
                };
                if is_bound && sum(values) > radiance {
                    continue;
                }
                let parts = DVec3::from_array(parts) / error;
                matrix += DMat3::from_cols(parts * parts.x, parts * parts.y, parts * parts.z);
                right += parts * ((radiance - sum(self.expected)) / error);
            }
            for (n, error) in errors.into_iter().enumerate() {
                if error > 0.0 {
                    matrix.col_mut(n)[n] += error.powi(-2);
                } else {
                    // A known value: its difference is 0.
                    for other in 0..3 {
                        matrix.col_mut(n)[other] = 0.0;
                        matrix.col_mut(other)[n] = 0.0;
                    }
                    (matrix.col_mut(n)[n], right[n]) = (1.0, 0.0);
                }
            }
            let change = matrix.inverse() * right;
            let found = (DVec3::from_array(self.expected) + change).to_array();
            let before = std::mem::replace(&mut values, found);
            if values.iter().zip(before).all(|(value, before)| (value - before).abs() < 1e-12) {
                break;
            }
        }
        Calibration::new(values)
    }
}

impl Seen<'_> {
    /// Position, radiance, standard error and whether the radiance is a bound, of each pixel that is
    /// included.
    fn pixels(&self) -> impl Iterator<Item = ([usize; 2], f64, f64, bool)> {
        let errors = self.standard_error.indexed_iter().filter(|(_, error)| error.is_finite());
        errors.map(|((row, col), error)| {
            let at = [row, col];
            (at, f64::from(self.image[at]), f64::from(*error), self.is_bound[at])
        })
    }
}

/// Shift (pixels) of views for the derivative of their images.
const SHIFT: f64 = 0.25;

/// The change of the images of each band per row and per column by which all views are shifted, by
/// central differences of the images of the expected fields.
pub(super) fn slopes(models: &mut dyn Models, domain: &Domain) -> Result<Vec<[Array3<f32>; 2]>> {
    let mut along = Vec::new();
    for axis in 0..2 {
        let before = shifted(models, domain, (axis, -SHIFT))?;
        let after = shifted(models, domain, (axis, SHIFT))?;
        let bands = before.into_iter().zip(after);
        let slopes =
            bands.map(|(before, after)| (after.values - before.values) / (2.0 * SHIFT) as f32);
        along.push(slopes.collect::<Vec<_>>());
    }
    let (cols, rows) = (along.remove(1), along.remove(0));
    Ok(rows.into_iter().zip(cols).map(|(rows, cols)| [rows, cols]).collect())
}

/// The images of the expected fields where all views are shifted along an axis. Corrections of the
/// images are left out: they are nearly the same for all shifts.
fn shifted(
    models: &mut dyn Models,
    domain: &Domain,
    (axis, distance): (usize, f64),
) -> Result<Vec<ViewStack>> {
    let mut offsets = domain.offsets.to_vec();
    offsets.iter_mut().flatten().for_each(|offset| offset[axis] += distance);
    let domain = Domain { offsets: &offsets, near: false, ..*domain };
    models.model(&domain)?.images(domain.expected)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An image that was made with a gain and an offset, seen without noise.
    #[test]
    fn gain_and_offset_are_found() {
        let model = Array2::from_shape_fn((7, 8), |(row, col)| {
            let (row, col) = (row as f32 - 3.0, col as f32 - 3.2);
            (-0.1 * (row * row + col * col)).exp()
        });
        let slope = |axis: usize| {
            Array2::from_shape_fn(model.raw_dim(), |at| {
                let centre = [3.0, 3.2][axis];
                -0.2 * ([at.0, at.1][axis] as f32 - centre) * model[at]
            })
        };
        let slopes = [slope(0), slope(1)];
        let slopes = Some([slopes[0].view(), slopes[1].view()]);
        let camera = Calibration { gain: 1.03, offset: [0.2, -0.1] };
        let image = camera.image(model.view(), &slopes);
        let by_hand = 1.03 - 0.2 * (0.2 * (5.0 - 3.0) - 0.1 * (1.0 - 3.2));
        assert!((image[[5, 1]] - by_hand * model[[5, 1]]).abs() < 1e-6);
        let mut errors = Array2::from_elem(model.raw_dim(), 1e-3);
        errors[[0, 0]] = f32::INFINITY;
        let mut bounds = Array2::from_elem(model.raw_dim(), false);
        bounds[[3, 3]] = true;
        let mut image = image;
        // A saturated pixel, and one that is left out.
        image[[3, 3]] *= 0.8;
        image[[0, 0]] = 7.0;
        let seen = Seen {
            image: image.view(),
            standard_error: errors.view(),
            is_bound: bounds.view(),
            slopes,
        };
        let prior = |gain, pointing| {
            let settings = InversionSettings {
                camera_gain_error: gain,
                pointing_error: pointing,
                ..Default::default()
            };
            Prior::new(&settings)
        };
        let found = prior(0.1, 1.0).most_likely(&seen, model.view());
        for (found, expected) in found.values().into_iter().zip(camera.values()) {
            assert!((found - expected).abs() < 1e-4, "{found} {expected}");
        }
        assert_eq!(prior(0.0, 0.0).most_likely(&seen, model.view()), Calibration::NOMINAL);
        assert_eq!(prior(0.1, 0.0).most_likely(&seen, model.view()).offset, [0.0; 2]);
        assert_eq!(prior(0.0, 1.0).most_likely(&seen, model.view()).gain, 1.0);
        let without = prior(0.1, 1.0).most_likely(&Seen { slopes: None, ..seen }, model.view());
        assert_eq!(without.offset, [0.0; 2]);
        let seen = Seen { slopes, ..seen };
        // A prior that is much more certain than the image.
        let certain = prior(1e-6, 1e-6).most_likely(&seen, model.view());
        assert!((certain.gain - 1.0).abs() < 1e-4 && certain.offset[0].abs() < 1e-4);
        let size = prior(0.01, 0.1).size_of(camera);
        assert!((size - (9.0 + 4.0 + 1.0)).abs() < 1e-9, "{size}");
    }
}
