//! Statistics of images that show whether a network was trained on such images.

use super::Network;
use super::resample::Field;
use crate::error::Result;
use crate::grid::Volume;
use crate::image::{ImagingGeometry, ViewStack};
use std::collections::BTreeMap;

/// Share of the pixels that are darker than the background.
const DARK_SHARE: f64 = 0.1;

/// The statistic of images for a network of one formation.
const SURFACE: &str = "surface_albedo";

/// The share of the pixels that are missing in wide gaps ([`ViewStack::share_in_gaps`]), of any weights.
const GAPS: &str = "gaps";

/// The largest share in gaps with which estimates are as good as from complete images.
const FEW_GAPS: f64 = 0.01;

/// How well many views are explained, and at most [`FEW`], for which it may be less.
const EXPLAINED: &str = "explained";
const EXPLAINED_FEW: &str = "explained_few";
const FEW: usize = 5;

/// Number of pixels that may have the largest radiance of their view by chance.
const FEW_PIXELS: usize = 5;

/// Optical depth at which the brightness of a cloud has reached about 60 % of its largest value.
const BRIGHT_DEPTH: f64 = 8.0;

/// A statistic of images that is outside its range in the training.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Unusual {
    /// The name of the statistic, see [`Estimator::image_statistics`](super::Estimator::image_statistics).
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
        SURFACE => "the albedo of the surface, which is taken for a cloud if it is bright,",
        GAPS => "the share of missing pixels in wide gaps, which are interpolated,",
        "equal" => "the largest share of a view's pixels that all have its largest radiance",
        EXPLAINED | EXPLAINED_FEW => {
            "the correlation of the images with the estimate along their lines of sight"
        }
        other => other,
    }
}

/// Albedos (found in images) of the surface below the clouds with which the networks of one formation
/// were trained: all are 0.05, and noise and air are allowed for.
const DARK_SURFACES: [f64; 2] = [0.0, 0.08];

/// The albedo of the surface in images for a network of one formation, if it is not that of a dark one.
pub(super) fn unusual_surface(albedo: f64) -> Option<Unusual> {
    let is_bright = albedo > DARK_SURFACES[1];
    is_bright.then(|| Unusual { name: SURFACE.into(), value: albedo, typical: DARK_SURFACES })
}

/// The share of the pixels in gaps of the images, if it is large.
pub(super) fn unusual_gaps(images: &ViewStack) -> Option<Unusual> {
    let value = images.share_in_gaps();
    let typical = [0.0, FEW_GAPS];
    (value > FEW_GAPS).then(|| Unusual { name: GAPS.into(), value, typical })
}

/// The statistics of images, by name:
///
/// - `background` and `brightest`: the radiance (1/sr for a solar irradiance of 1) below which a
///   tenth of all pixels lies, and the largest one, over the cosine of the solar zenith angle.
///   Images in other units have other values.
/// - `equal`: the largest share of the pixels of a view that have the largest radiance of the view,
///   without the first five of them. It is large if the sensor is saturated.
/// - `explained`, or `explained_few` for at most five views: the mean over the views of the
///   correlation of the image with `1 - exp(-t / 8)`, where `t` is the optical depth of the
///   estimate along the lines of sight. It is low if the geometry is not that of the images.
///
/// # Errors
/// An image geometry that the network does not support.
pub(super) fn image_statistics(
    network: &Network,
    images: &ViewStack,
    geometry: &ImagingGeometry,
    extinction: &Volume,
) -> Result<BTreeMap<String, f64>> {
    let sun = geometry.views.sun_zenith_deg.to_radians().cos() * geometry.solar_irradiance;
    let mut sorted: Vec<f32> = images.values.iter().copied().collect();
    let dark = (DARK_SHARE * sorted.len() as f64) as usize;
    let (_, background, _) = sorted.select_nth_unstable_by(dark, f32::total_cmp);
    let background = f64::from(*background) / sun;
    let equal = images.values.outer_iter().map(|image| {
        let largest = image.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let count = image.iter().filter(|value| **value == largest).count();
        count.saturating_sub(FEW_PIXELS) as f64 / image.len() as f64
    });
    let name = if images.shape()[0] <= FEW { EXPLAINED_FEW } else { EXPLAINED };
    Ok(BTreeMap::from([
        ("background".into(), background),
        ("brightest".into(), f64::from(images.brightest()) / sun),
        ("equal".into(), equal.fold(0.0, f64::max)),
        (name.into(), explained(network, images, geometry, extinction)?),
    ]))
}

/// The mean correlation of the images on the plane of the target with the brightness of the
/// estimate there.
fn explained(
    network: &Network,
    images: &ViewStack,
    geometry: &ImagingGeometry,
    extinction: &Volume,
) -> Result<f64> {
    let ([x, y, _], grid) = (geometry.target_km, &extinction.grid);
    let center = [grid.center().y - y, grid.center().x - x];
    let field = Field { size: [grid.shape[1], grid.shape[2]], center };
    let on_target = network.on_target(images, &geometry.shifts, field)?;
    let views = on_target.chunks_exact(field.size[0] * field.size[1]).enumerate();
    let by_view: Vec<f64> = views
        .map(|(view, image)| {
            let depth = depth_on_target(network, extinction, view);
            let bright: Vec<f64> = depth.iter().map(|t| 1.0 - (-t / BRIGHT_DEPTH).exp()).collect();
            let image: Vec<f64> = image.iter().map(|&value| f64::from(value)).collect();
            correlation(&image, &bright)
        })
        .collect();
    Ok(by_view.iter().sum::<f64>() / by_view.len() as f64)
}

/// The optical depth along the line of sight of a view through each voxel of the plane of the
/// target, `[row, col]`, with the parallax of each level rounded to whole voxels.
fn depth_on_target(network: &Network, extinction: &Volume, view: usize) -> Vec<f64> {
    let (metadata, grid) = (network.metadata(), &extinction.grid);
    let [_, rows, cols] = grid.shape;
    let slant = metadata.view_geometry.view_zenith_deg[view].to_radians().cos();
    let mut depth = vec![0.0; rows * cols];
    for (number, level) in extinction.values.outer_iter().enumerate() {
        let altitude = grid.voxel_center([number, 0, 0]).z;
        let [north, east] = metadata.parallax(view, altitude).map(|voxels| voxels as isize);
        for ((row, col), &value) in level.indexed_iter() {
            let (row, col) = (row as isize + north, col as isize + east);
            let inside = (0..rows as isize).contains(&row) && (0..cols as isize).contains(&col);
            if inside && value > 0.0 {
                depth[row as usize * cols + col as usize] +=
                    f64::from(value) * grid.spacing.z / slant;
            }
        }
    }
    depth
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
