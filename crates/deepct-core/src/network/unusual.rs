//! Statistics of images that show whether a network was trained on such images.

use super::Network;
use super::resample::Field;
use crate::error::Result;
use crate::grid::Grid;
use crate::image::{ImagingGeometry, ViewStack};
use std::collections::BTreeMap;

/// Share of the pixels that are darker than the background.
const DARK_SHARE: f64 = 0.1;

/// The agreement of many views, and that of at most [`FEW`], which may be lower.
const AGREEMENT: &str = "agreement";
const AGREEMENT_OF_FEW: &str = "agreement_of_few";
const FEW: usize = 5;

/// Largest number of pixels along an axis that is used for the agreement of the views.
const MOST_LINES: usize = 64;

/// A statistic of images that is outside its range in the training.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Unusual {
    /// The name of the statistic ([`image_statistics`]).
    pub name: String,
    /// Its value.
    pub value: f64,
    /// The lowest and the highest value in the training.
    pub typical: [f64; 2],
}

impl std::fmt::Display for Unusual {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (meaning, [low, high]) = (meaning(&self.name), self.typical);
        write!(formatter, "{meaning} is {:.3}, in the training {low:.3} to {high:.3}", self.value)
    }
}

/// What a statistic is, in words.
fn meaning(name: &str) -> &str {
    match name {
        "background" => {
            "the radiance of the darkest tenth over the cosine of the solar zenith angle"
        }
        "brightest" => "the largest radiance over the cosine of the solar zenith angle",
        "equal" => "the largest share of a view's pixels that all have its largest radiance",
        AGREEMENT | AGREEMENT_OF_FEW => {
            "the correlation of the views on the plane where they agree best"
        }
        other => other,
    }
}

/// The statistics of images, by name:
///
/// - `background` and `brightest`: the radiance (1/sr for a solar irradiance of 1) below which a
///   tenth of all pixels lies, and the largest one, over the cosine of the solar zenith angle.
///   Images in other units have other values.
/// - `equal`: the largest share of the pixels of a view that have the largest radiance of the view.
///   It is large if the sensor is saturated.
/// - `agreement`, or `agreement_of_few` for at most five views: on the horizontal plane where it is
///   largest, the mean correlation of each image with the mean of the others. It is low if the
///   geometry is not that of the images.
///
/// # Errors
/// An image geometry that the network does not support.
pub(super) fn image_statistics(
    network: &Network,
    images: &ViewStack,
    geometry: &ImagingGeometry,
    grid: &Grid,
) -> Result<BTreeMap<String, f64>> {
    let sun = geometry.views.sun_zenith_deg.to_radians().cos() * geometry.solar_irradiance;
    let mut sorted: Vec<f32> = images.values.iter().copied().collect();
    let dark = (DARK_SHARE * sorted.len() as f64) as usize;
    let (_, background, _) = sorted.select_nth_unstable_by(dark, f32::total_cmp);
    let background = f64::from(*background) / sun;
    let equal = images.values.outer_iter().map(|image| {
        let largest = image.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        image.iter().filter(|value| **value == largest).count() as f64 / image.len() as f64
    });
    let agreed = if images.shape()[0] <= FEW { AGREEMENT_OF_FEW } else { AGREEMENT };
    Ok(BTreeMap::from([
        ("background".into(), background),
        ("brightest".into(), f64::from(images.brightest()) / sun),
        ("equal".into(), equal.fold(0.0, f64::max)),
        (agreed.into(), agreement(network, images, geometry, grid)?),
    ]))
}

/// On the plane where it is largest, the mean correlation of each image with the mean of the others.
fn agreement(
    network: &Network,
    images: &ViewStack,
    geometry: &ImagingGeometry,
    grid: &Grid,
) -> Result<f64> {
    let [x, y, _] = geometry.target_km;
    let center = [grid.center().y - y, grid.center().x - x];
    let field = Field { size: [grid.shape[1], grid.shape[2]], center };
    let planes = network.planes(images, field)?;
    let (views, step) = (images.shape()[0], field.size.map(|lines| lines.div_ceil(MOST_LINES)));
    let thinned = |image: &[f32]| -> Vec<f64> {
        let rows = image.chunks_exact(field.size[1]).step_by(step[0]);
        rows.flat_map(|row| row.iter().step_by(step[1]).map(|&value| f64::from(value))).collect()
    };
    let pixels = field.size[0] * field.size[1];
    let on_plane = planes.chunks_exact(pixels * views).map(|plane| {
        let images: Vec<Vec<f64>> = plane.chunks_exact(pixels).map(thinned).collect();
        let sum: Vec<f64> =
            (0..images[0].len()).map(|at| images.iter().map(|image| image[at]).sum()).collect();
        let by_view = images.iter().map(|image| {
            let others: Vec<f64> = sum.iter().zip(image).map(|(sum, own)| sum - own).collect();
            correlation(image, &others)
        });
        by_view.sum::<f64>() / views as f64
    });
    Ok(on_plane.fold(-1.0, f64::max))
}

/// Pearson's correlation; 0 if one of them is constant.
fn correlation(one: &[f64], other: &[f64]) -> f64 {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let (a, b) = (mean(one), mean(other));
    let pairs = || one.iter().zip(other).map(|(x, y)| (x - a, y - b));
    let covariance: f64 = pairs().map(|(x, y)| x * y).sum();
    let squares = pairs().fold((0.0, 0.0), |sum, (x, y)| (sum.0 + x * x, sum.1 + y * y));
    let product: f64 = squares.0 * squares.1;
    if product > 0.0 { covariance / product.sqrt() } else { 0.0 }
}
