//! An estimator: trained weights of either kind, ready for images of any geometry they support.

use super::surface::{above_surface, surface_albedo};
use super::unusual::{image_statistics, unusual_gaps, unusual_surface};
use super::{
    BandImages, Estimate, GeneralMetadata, GeneralWeights, Network, NetworkOutput, Training,
    Unusual, Weights,
};
use crate::conv::Settings;
use crate::error::{Error, Result};
use crate::grid::{Grid, Volume};
use crate::image::{ImagingGeometry, ViewStack};
use crate::math::DVec3;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Images with pixels smaller than this share of a voxel are averaged over the area of a voxel;
/// bilinear interpolation alone would leave most of their pixels unused.
const FINE_PIXEL: f64 = 0.67;

/// Columns beyond the requested grid that are computed where the images show them: about half the
/// receptive field, whose padding with zeros would otherwise change the estimate at the edges.
const MARGIN: usize = 8;

/// Columns over which images with small pixels are averaged, on each side.
const AVERAGED: usize = 2;

/// Share of the extinction above and below which a first estimate is cut off to find the altitudes
/// of the cloud.
const TAIL: f64 = 0.005;

/// Number of significant digits of the voxel size derived from a pixel size.
const DIGITS: f64 = 1e6;

/// Trained weights of either kind.
#[derive(Debug, Clone, PartialEq)]
pub enum TrainedWeights {
    /// Weights for one formation and one Sun.
    Formation(Weights),
    /// Weights for any formation and any Sun.
    General(GeneralWeights),
}

impl TrainedWeights {
    /// The training data.
    pub fn training(&self) -> &Training {
        match self {
            Self::Formation(weights) => &weights.metadata.training,
            Self::General(weights) => &weights.metadata.training,
        }
    }

    /// Whether the weights also estimate the effective radius.
    pub fn has_effective_radius(&self) -> bool {
        let Self::Formation(weights) = self else { return false };
        weights.metadata.outputs.contains(&NetworkOutput::EffectiveRadius)
    }

    /// The formation that the images must have; `None` for general weights.
    pub fn formation(&self) -> Option<&str> {
        match self {
            Self::Formation(weights) => Some(&weights.metadata.formation),
            Self::General(_) => None,
        }
    }
}

/// Estimates the extinction of clouds from images by trained weights of either kind. General
/// weights are folded for the geometry of the images; the folded network is kept for the next
/// images of the same geometry.
#[derive(Debug)]
pub struct Estimator {
    weights: TrainedWeights,
    settings: Settings,
    outside_training: bool,
    /// The network used last, with the geometry and the grid that it was folded for.
    latest: Mutex<Option<Folded>>,
}

/// A network folded for a geometry; the horizontal position of the target does not matter.
#[derive(Debug, Clone)]
struct Folded {
    geometry: ImagingGeometry,
    levels: [f64; 3],
    network: Arc<Network>,
}

impl Estimator {
    /// Creates an estimator with the default settings for this processor.
    pub fn new(weights: TrainedWeights) -> Self {
        Self::with_settings(weights, Settings::default())
    }

    /// Creates an estimator with other settings of the convolution.
    pub fn with_settings(weights: TrainedWeights, settings: Settings) -> Self {
        Self { weights, settings, outside_training: false, latest: Mutex::new(None) }
    }

    /// Also accepts geometries for which general weights were not trained.
    pub fn outside_training(self) -> Self {
        Self { outside_training: true, ..self }
    }

    /// The weights.
    pub fn weights(&self) -> &TrainedWeights {
        &self.weights
    }

    /// Number of bands whose images the weights are for.
    pub fn bands(&self) -> usize {
        match &self.weights {
            TrainedWeights::Formation(weights) => weights.metadata.bands(),
            TrainedWeights::General(_) => 1,
        }
    }

    /// The grid on which [`Estimator::estimate`] estimates the cloud in images of `[rows, cols]`
    /// pixels if no other grid is requested. It has one column of voxels for each pixel, centred
    /// on the target, or about on the middle of images that are shifted from it. For general weights,
    /// the horizontal voxel size is that of the smallest pixel at the target, and the levels are
    /// centred on the target, but do not extend below an altitude of 0.
    ///
    /// # Errors
    /// As [`Network::grid`].
    pub fn grid(&self, geometry: &ImagingGeometry, [rows, cols]: [usize; 2]) -> Result<Grid> {
        let [x, y] = geometry.middle_km();
        let middle = DVec3::new(x, y, geometry.target_km[2]);
        match &self.weights {
            TrainedWeights::Formation(weights) => weights.metadata.grid([x, y], [rows, cols]),
            TrainedWeights::General(weights) => {
                let pixels = &geometry.views.pixel_km;
                let smallest = pixels.iter().copied().fold(f64::INFINITY, f64::min);
                if !(smallest.is_finite() && smallest > 0.0) {
                    let range = "positive and finite (km)";
                    return Err(Error::out_of_range("pixel size at the target", smallest, range));
                }
                let unit = 10_f64.powf(smallest.log10().floor()) / DIGITS;
                let voxel_km = (smallest / unit).round() * unit;
                let mut grid = weights.grid(voxel_km, middle, [rows, cols])?;
                if middle.z >= 0.0 {
                    grid.origin.z = grid.origin.z.max(0.0);
                }
                Ok(grid)
            }
        }
    }

    /// Number of columns beyond a part of a grid whose images have an influence on the estimate there.
    pub fn halo(&self, grid: &Grid) -> usize {
        let (layers, voxels) = match &self.weights {
            TrainedWeights::Formation(weights) => (weights.metadata.architecture.layers(), 1.0),
            TrainedWeights::General(weights) => {
                let GeneralMetadata { architecture, levels, .. } = &weights.metadata;
                let covering = grid.extent().z / (levels.count as f64 * levels.height);
                let narrow = grid.spacing.x.min(grid.spacing.y);
                let widest = grid.spacing.x.max(grid.spacing.y).max(covering);
                (architecture.layers, widest / narrow)
            }
        };
        (layers as f64 * voxels).ceil() as usize + AVERAGED
    }

    /// Estimates the extinction (1/km) of the cloud in `images` (radiance, in the unit of the solar
    /// irradiance over sr) with the imaging geometry `geometry`, on `grid` or on that of
    /// [`Estimator::grid`].
    ///
    /// General weights accept any regular grid. They estimate on voxels as wide as those of the
    /// grid, or wider if the cloud is higher than their levels, and the result is resampled onto
    /// the grid. Weights of one formation accept grids with their own voxels and levels.
    ///
    /// # Errors
    /// A geometry that the weights do not support, with the number at fault; a number of images
    /// that differs from the number of views; a grid that the weights do not support.
    pub fn estimate(
        &self,
        images: &ViewStack,
        geometry: &ImagingGeometry,
        grid: Option<&Grid>,
    ) -> Result<Estimate> {
        self.estimate_bands(&[BandImages { images, geometry }], grid)
    }

    /// As [`Estimator::estimate`], for images of the bands that the weights are for, in their order.
    /// General weights are for one band.
    ///
    /// # Errors
    /// As [`Estimator::estimate`]; another number of bands, or other wavelengths.
    pub fn estimate_bands(
        &self,
        bands: &[BandImages<'_>],
        grid: Option<&Grid>,
    ) -> Result<Estimate> {
        if let TrainedWeights::Formation(weights) = &self.weights {
            weights.metadata.check_bands(bands.iter().map(|band| band.geometry.wavelength_um))?;
        }
        let filled = bands.iter().map(|band| self.without_missing(band.images, band.geometry));
        let filled = filled.collect::<Result<Vec<_>>>()?;
        let [(images, geometry), others @ ..] = &filled[..] else {
            return Err(Error::out_of_range("number of bands", 0, "at least 1"));
        };
        let [_, rows, cols] = images.shape();
        let own = self.grid(geometry, [rows, cols])?;
        let grid = grid.unwrap_or(&own);
        match &self.weights {
            TrainedWeights::Formation(_) => {
                let bands = filled.iter().map(|(images, geometry)| BandImages { images, geometry });
                let bands: Vec<_> = bands.collect();
                self.folded(geometry, grid, self.outside_training)?.estimate_bands(grid, &bands)
            }
            TrainedWeights::General(_) if !others.is_empty() => {
                let remedy = "general weights are for one band: give the images of one, or weights for \
                              these bands";
                Err(Error::mismatch("number of bands", 1, bands.len(), remedy))
            }
            TrainedWeights::General(weights) => self.by_general(weights, images, geometry, grid),
        }
    }

    /// The estimate by general weights on a grid.
    fn by_general(
        &self,
        weights: &GeneralWeights,
        images: &ViewStack,
        geometry: &ImagingGeometry,
        grid: &Grid,
    ) -> Result<Estimate> {
        let inner = self.inner_grid(weights, images, geometry, grid)?;
        let mut estimate =
            self.on_inner(weights, images, geometry, &inner, self.outside_training)?;
        estimate.calibrate(&weights.metadata.calibration);
        if inner.matches(grid) {
            return Ok(estimate);
        }
        let uncertainty = estimate.uncertainty.as_ref().map(|volume| volume.resampled(grid));
        Ok(Estimate { uncertainty, ..estimate.extinction.resampled(grid).into() })
    }

    /// The images with missing pixels interpolated. Views without any known pixel are left out, which
    /// general weights do not need.
    ///
    /// # Errors
    /// A number of images that differs from the number of views; a view without pixels that the weights
    /// need.
    fn without_missing<'a>(
        &self,
        images: &'a ViewStack,
        geometry: &'a ImagingGeometry,
    ) -> Result<(Cow<'a, ViewStack>, Cow<'a, ImagingGeometry>)> {
        let (views, expected) = (images.shape()[0], geometry.views.view_zenith_deg.len());
        if views != expected {
            let remedy = "give one image for each view";
            return Err(Error::mismatch("number of views", expected, views, remedy));
        }
        let empty = (0..views).find(|view| images.is_empty(*view));
        let Some(view) = empty else { return Ok((images.filled(), Cow::Borrowed(geometry))) };
        if let TrainedWeights::Formation(_) = &self.weights {
            let found = format!("missing in view {view}");
            let range = "partly known: weights of one formation need all images, \
                         the general ones do not";
            return Err(Error::out_of_range("all pixels", found, range));
        }
        let chosen: Vec<usize> = (0..views).filter(|view| !images.is_empty(*view)).collect();
        let some = ViewStack { values: images.values.select(ndarray::Axis(0), &chosen) };
        Ok((Cow::Owned(some.filled().into_owned()), Cow::Owned(geometry.of_views(&chosen))))
    }

    /// The estimate by general weights on a grid with voxels and levels of their network.
    fn on_inner(
        &self,
        weights: &GeneralWeights,
        images: &ViewStack,
        geometry: &ImagingGeometry,
        inner: &Grid,
        force: bool,
    ) -> Result<Estimate> {
        let network = self.folded(geometry, inner, force)?;
        let averaged = average_fine_pixels(images, geometry, inner.spacing.x);
        let images = averaged.as_ref().unwrap_or(images);
        let adjusted = match weights.metadata.surface_albedo {
            Some(albedo) => above_surface(images, geometry, albedo)?,
            None => None,
        };
        network.estimate_on(inner, adjusted.as_ref().unwrap_or(images), geometry)
    }

    /// The grid on which general weights estimate the field of a grid: with its own levels, voxels as
    /// wide as those of the grid, and a margin of columns where the images show them. If the grid is
    /// higher than these levels, they cover the altitudes of the cloud in a first estimate on wider
    /// voxels, which may be outside the training.
    fn inner_grid(
        &self,
        weights: &GeneralWeights,
        images: &ViewStack,
        geometry: &ImagingGeometry,
        grid: &Grid,
    ) -> Result<Grid> {
        let [_, rows, cols] = images.shape();
        let shown = self.grid(geometry, [rows, cols])?;
        let levels = weights.metadata.levels;
        let in_levels = |height: f64| height / (levels.count as f64 * levels.height);
        let wide = grid.spacing.x.max(grid.spacing.y);
        let covering = in_levels(grid.extent().z);
        // The extent of a grid read from a file has rounding errors.
        if covering <= wide * (1.0 + 1e-4) {
            return covered(weights, grid, &shown, wide, grid.center().z);
        }
        let inner = covered(weights, grid, &shown, covering, grid.center().z)?;
        let first = self.on_inner(weights, images, geometry, &inner, true)?.extinction;
        let Some([low, high]) = altitudes(&first) else { return Ok(inner) };
        let voxel_km = in_levels(high - low).max(wide);
        // The window stays within the grid as far as it can.
        let half = 0.5 * voxel_km * levels.count as f64 * levels.height;
        let (bottom, top) = (grid.lower().z + half, grid.upper().z - half);
        let middle = (0.5 * (low + high)).min(top).max(bottom);
        covered(weights, grid, &shown, voxel_km, middle)
    }

    /// The statistics of images that are outside their range in the training of general weights, for
    /// example because the geometry is not that of the images, because they are saturated or in
    /// another unit, and missing pixels in wide gaps. General weights may state no ranges; for weights of
    /// one formation, the surface and the gaps are compared only. `estimate` is that of the images.
    ///
    /// # Errors
    /// As [`Estimator::estimate`].
    pub fn unusual(
        &self,
        images: &ViewStack,
        geometry: &ImagingGeometry,
        estimate: &Estimate,
    ) -> Result<Vec<Unusual>> {
        let mut found: Vec<Unusual> = unusual_gaps(images).into_iter().collect();
        let (images, geometry) = self.without_missing(images, geometry)?;
        let (images, geometry) = (&*images, &*geometry);
        let TrainedWeights::General(weights) = &self.weights else {
            found.extend(unusual_surface(surface_albedo(images, geometry)?));
            return Ok(found);
        };
        let typical = &weights.metadata.typical;
        if typical.is_empty() {
            return Ok(found);
        }
        let statistics = self.image_statistics(images, geometry, estimate)?;
        found.extend(typical.iter().filter_map(|(name, &[low, high])| {
            let &value = statistics.get(name)?;
            let unusual = Unusual { name: name.clone(), value, typical: [low, high] };
            (!(low..=high).contains(&value)).then_some(unusual)
        }));
        Ok(found)
    }

    /// Statistics of images by name, for general weights:
    ///
    /// - `background` and `brightest`: the radiance below which a tenth of all pixels lies, and the
    ///   largest one, over the cosine of the solar zenith angle (1/sr for a solar irradiance of 1);
    /// - `equal`: the largest share of the pixels of a view that have the largest radiance of the
    ///   view, without the first five of them;
    /// - `explained`, or `explained_few` for at most five views: the mean over the views of the
    ///   correlation of the image with `1 - exp(-t / 8)`, where `t` is the optical depth of the
    ///   estimate of the images along the lines of sight.
    ///
    /// # Errors
    /// As [`Estimator::estimate`]; weights for one formation.
    pub fn image_statistics(
        &self,
        images: &ViewStack,
        geometry: &ImagingGeometry,
        estimate: &Estimate,
    ) -> Result<BTreeMap<String, f64>> {
        let TrainedWeights::General(weights) = &self.weights else {
            let range = "general: others state no statistics of their training images";
            return Err(Error::out_of_range("weights", "for one formation", range));
        };
        let (images, geometry) = self.without_missing(images, geometry)?;
        let (images, geometry) = (&*images, &*geometry);
        let grid = &estimate.extinction.grid;
        let inner = self.inner_grid(weights, images, geometry, grid)?;
        if inner.matches(grid) {
            let network = self.network(geometry, &inner)?;
            return image_statistics(&network, images, geometry, &estimate.extinction);
        }
        let on_inner = self.on_inner(weights, images, geometry, &inner, self.outside_training)?;
        let network = self.network(geometry, &inner)?;
        image_statistics(&network, images, geometry, &on_inner.extinction)
    }

    /// The network for a geometry and a grid of its own voxels and levels.
    ///
    /// # Errors
    /// As [`GeneralWeights::fold`].
    pub fn network(&self, geometry: &ImagingGeometry, grid: &Grid) -> Result<Arc<Network>> {
        self.folded(geometry, grid, self.outside_training)
    }

    fn folded(&self, geometry: &ImagingGeometry, grid: &Grid, force: bool) -> Result<Arc<Network>> {
        let levels = [grid.spacing.x, grid.spacing.z, grid.origin.z];
        // Neither the irradiance nor the position of the images changes the network.
        let mut geometry = ImagingGeometry { shifts: Vec::new(), ..geometry.clone() };
        (geometry.solar_irradiance, geometry.target_km) = (1.0, [0.0, 0.0, geometry.target_km[2]]);
        let mut latest = self.latest.lock().unwrap_or_else(PoisonError::into_inner);
        let network = match (&self.weights, &*latest) {
            (TrainedWeights::Formation(_), Some(folded)) => return Ok(folded.network.clone()),
            (TrainedWeights::General(_), Some(folded))
                if folded.geometry == geometry && folded.levels == levels =>
            {
                return Ok(folded.network.clone());
            }
            (TrainedWeights::Formation(weights), None) => {
                Network::with_settings(weights, self.settings)?
            }
            (TrainedWeights::General(weights), _) => {
                let weights = weights.fold(&geometry, grid, force)?;
                Network::with_settings(&weights, self.settings)?
            }
        };
        let network = Arc::new(network);
        *latest = Some(Folded { geometry, levels, network: network.clone() });
        Ok(network)
    }
}

/// The grid of general weights with voxels of `voxel_km` whose columns cover those of `grid` and a
/// margin as far as `shown`, and whose levels are centred on the altitude `middle`.
fn covered(
    weights: &GeneralWeights,
    grid: &Grid,
    shown: &Grid,
    voxel_km: f64,
    middle: f64,
) -> Result<Grid> {
    let extent = grid.extent();
    let [rows, cols] = [extent.y, extent.x].map(|length| (length / voxel_km - 1e-4).ceil());
    let mut inner = weights.grid(
        voxel_km,
        DVec3::new(grid.center().x, grid.center().y, middle),
        [rows as usize, cols as usize],
    )?;
    // A grid with few levels lies at the bottom of those of the network rather than below ground.
    if grid.origin.z >= 0.0 && inner.origin.z < 0.0 {
        inner.origin.z = 0.0;
    }
    let columns = |length: f64| ((length / voxel_km + 1e-4).floor().max(0.0) as usize).min(MARGIN);
    let before = inner.lower() - shown.lower();
    let after = shown.upper() - inner.upper();
    let [south, west] = [columns(before.y), columns(before.x)];
    inner.origin -= voxel_km * DVec3::new(west as f64, south as f64, 0.0);
    inner.shape[1] += south + columns(after.y);
    inner.shape[2] += west + columns(after.x);
    Ok(inner)
}

/// The altitudes (km) between which nearly all of the extinction is, with a level more on each side;
/// `None` if there is no extinction.
fn altitudes(extinction: &Volume) -> Option<[f64; 2]> {
    let levels: Vec<f64> = extinction
        .values
        .outer_iter()
        .map(|level| level.iter().map(|&value| f64::from(value)).sum())
        .collect();
    let total: f64 = levels.iter().sum();
    if total <= 0.0 {
        return None;
    }
    let mut below = 0.0;
    let cumulative: Vec<f64> = levels
        .iter()
        .map(|level| {
            below += level / total;
            below
        })
        .collect();
    let first = cumulative.iter().position(|share| *share > TAIL)?;
    let last = cumulative.iter().position(|share| *share >= 1.0 - TAIL)?;
    let grid = &extinction.grid;
    let edge = |level: f64| grid.origin.z + grid.spacing.z * level;
    Some([edge(first as f64 - 1.0), edge(last as f64 + 2.0)])
}

/// The images with each pixel replaced by the mean over the area of a voxel around it, for views
/// with much smaller pixels; `None` if there is no such view.
fn average_fine_pixels(
    images: &ViewStack,
    geometry: &ImagingGeometry,
    voxel_km: f64,
) -> Option<ViewStack> {
    let widths: Vec<f64> = geometry.views.pixel_km.iter().map(|pixel| voxel_km / pixel).collect();
    if widths.iter().all(|width| *width <= 1.0 / FINE_PIXEL) {
        return None;
    }
    let mut images = images.clone();
    for (mut image, &width) in images.values.outer_iter_mut().zip(&widths) {
        if width <= 1.0 / FINE_PIXEL {
            continue;
        }
        for axis in 0..2 {
            for mut line in image.lanes_mut(ndarray::Axis(axis)) {
                let averaged = moving_average(&line.to_vec(), width);
                line.iter_mut().zip(averaged).for_each(|(pixel, value)| *pixel = value);
            }
        }
    }
    Some(images)
}

/// The mean of the values within half of `width` of each one; the values at the ends continue.
fn moving_average(values: &[f32], width: f64) -> Vec<f32> {
    let whole = ((width - 1.0) / 2.0).floor();
    let part = (width - 1.0) / 2.0 - whole;
    let (whole, last) = (whole as isize, values.len() as isize - 1);
    let at = |index: isize| f64::from(values[index.clamp(0, last) as usize]);
    (0..=last)
        .map(|index| {
            let inner: f64 = (-whole..=whole).map(|offset| at(index + offset)).sum();
            let outer = at(index - whole - 1) + at(index + whole + 1);
            ((inner + part * outer) / width) as f32
        })
        .collect()
}
