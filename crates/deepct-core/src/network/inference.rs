//! Inference: from images to extinction.

use super::resample::{Field, Frame, PlaneResampler};
use super::{Estimate, NetworkOutput, Weights, WeightsMetadata};
use crate::conv::{self, Conv2d, Scales, Settings, Stack};
use crate::error::{Error, Result};
use crate::grid::{Grid, Volume};
use crate::image::{ImagingGeometry, ViewStack};
use crate::optics::TABLE_RADII;

use ndarray::{Array3, s};

/// The images of one band, `[view, row, col]`, with their imaging geometry.
#[derive(Debug, Clone, Copy)]
pub struct BandImages<'a> {
    /// Radiance, in the unit of the solar irradiance over sr.
    pub images: &'a ViewStack,
    /// The geometry of the views.
    pub geometry: &'a ImagingGeometry,
}

/// A network that is ready to run, with its weights packed for the processor.
#[derive(Debug, Clone)]
pub struct Network {
    metadata: WeightsMetadata,
    resampler: Option<PlaneResampler>,
    stack: Stack,
}

/// Memory for [`Network::run`], allocated once by [`Network::scratch`] and reusable for any number
/// of runs.
#[derive(Debug)]
pub struct Scratch {
    stack: conv::Scratch,
    /// The size `[cloud, row, col]` for which it was allocated.
    size: [usize; 3],
    /// The images on the plane of the target; empty if the images are not resampled onto planes.
    ground: Vec<f32>,
}

impl Scratch {
    /// The size in bytes.
    pub fn bytes(&self) -> usize {
        self.stack.bytes() + size_of_val(&self.ground[..])
    }
}

impl Network {
    /// Creates the network of `weights` with the default settings for this processor.
    ///
    /// # Errors
    /// Layers with inconsistent numbers of channels; none for [`Weights`] created by
    /// [`Weights::new`].
    pub fn new(weights: &Weights) -> Result<Self> {
        Self::with_settings(weights, Settings::default())
    }

    /// Creates the network of `weights` with other settings.
    ///
    /// # Errors
    /// As [`Network::new`].
    pub fn with_settings(weights: &Weights, settings: Settings) -> Result<Self> {
        let metadata = &weights.metadata;
        let layers = weights.layers.iter().enumerate().map(|(index, layer)| {
            let relu = metadata.architecture.relu(index);
            Conv2d::new(layer.weight.view(), layer.bias.view(), relu, settings.kernel)
        });
        let scales =
            Scales { input: metadata.input_scale as f32, output: metadata.output_scale as f32 };
        let stack = Stack::new(layers.collect::<Result<_>>()?, settings)?.with_scales(scales);
        Ok(Self { metadata: metadata.clone(), resampler: PlaneResampler::new(metadata), stack })
    }

    /// The metadata of the weights.
    pub fn metadata(&self) -> &WeightsMetadata {
        &self.metadata
    }

    /// Number of views that the network requires of each band.
    pub fn views(&self) -> usize {
        self.metadata.views()
    }

    /// Number of levels of the output.
    pub fn levels(&self) -> usize {
        self.metadata.levels.count
    }

    /// Number of output channels of [`Network::run`]: the levels of each output.
    pub fn output_channels(&self) -> usize {
        self.stack.output_channels()
    }

    /// The grid of the extinction returned by [`Network::infer`]; see [`WeightsMetadata::grid`].
    ///
    /// # Errors
    /// As [`WeightsMetadata::grid`].
    pub fn grid(&self, target: [f64; 2], size: [usize; 2]) -> Result<Grid> {
        self.metadata.grid(target, size)
    }

    /// Estimates the extinction (1/km) of the cloud in `images` (radiance, 1/sr) with the imaging
    /// geometry `geometry`.
    ///
    /// # Errors
    /// A geometry that the weights do not support ([`WeightsMetadata::check_images`]), with the
    /// value that differs; a number of images that differs from the number of views.
    pub fn infer(&self, images: &ViewStack, geometry: &ImagingGeometry) -> Result<Volume> {
        Ok(self.estimate(images, geometry)?.extinction)
    }

    /// As [`Network::infer`], with the further quantities that the weights provide.
    ///
    /// # Errors
    /// As [`Network::infer`].
    pub fn estimate(&self, images: &ViewStack, geometry: &ImagingGeometry) -> Result<Estimate> {
        let [_, rows, cols] = images.shape();
        self.estimate_on(&self.grid(geometry.middle_km(), [rows, cols])?, images, geometry)
    }

    /// As [`Network::estimate`], on a grid with the voxels and levels of the metadata and any
    /// number of columns at any horizontal position. Voxels that an image does not show are
    /// estimated from the values at its edge, and missing pixels are interpolated.
    ///
    /// # Errors
    /// As [`Network::estimate_bands`].
    pub fn estimate_on(
        &self,
        grid: &Grid,
        images: &ViewStack,
        geometry: &ImagingGeometry,
    ) -> Result<Estimate> {
        self.estimate_bands(grid, &[BandImages { images, geometry }])
    }

    /// As [`Network::estimate_on`], for images of the bands that the weights are for, in their order.
    ///
    /// # Errors
    /// As [`Network::infer`]; bands whose images have other sizes than those of the first one; a grid
    /// with other voxels or levels; a grid other than [`Network::grid`] if the network reads the images
    /// as recorded by the cameras.
    pub fn estimate_bands(&self, grid: &Grid, bands: &[BandImages<'_>]) -> Result<Estimate> {
        self.metadata.check_images(bands.iter().map(|band| band.geometry))?;
        grid.check_memory()?;
        let first = bands[0];
        let [_, rows, cols] = first.images.shape();
        for band in bands {
            let remedy = "give the images of the formation that the weights are for";
            let views = band.images.shape()[0];
            if views != self.views() {
                return Err(Error::mismatch("number of views", self.views(), views, remedy));
            }
            let size = |images: &ViewStack| format!("{:?}", &images.shape()[1..]);
            let (expected, found) = (size(first.images), size(band.images));
            if expected != found {
                let remedy = "give images of the same pixels in all bands";
                return Err(Error::mismatch("size of the images", expected, found, remedy));
            }
        }
        let [x, y, _] = first.geometry.target_km;
        let (size, center) = ([grid.shape[1], grid.shape[2]], grid.center());
        let shifts = self.shifts(bands);
        let supported = match self.resampler {
            Some(_) => self.grid([center.x, center.y], size)?,
            None if shifts.is_empty() => self.grid([x, y], [rows, cols])?,
            None => {
                let remedy =
                    "give whole images: these weights read them as recorded by the cameras";
                return Err(Error::mismatch("shift of the images", "none", "some", remedy));
            }
        };
        supported.check_same("the estimate", grid)?;
        let mut radiance = Vec::with_capacity(bands.len() * first.images.values.len());
        for BandImages { images, geometry } in bands {
            let unit = (1.0 / geometry.solar_irradiance) as f32;
            radiance.extend(images.filled().values.iter().map(|value| unit * value));
        }
        let mut scratch = self.scratch([1, size[0], size[1]])?;
        let mut values = Array3::zeros([self.output_channels(), size[0], size[1]]);
        let output = values.as_slice_mut().expect("a new array is contiguous");
        let field = Field { size, center: [center.y - y, center.x - x] };
        let frame = Frame { size: [rows, cols], shifts: &shifts };
        if let Some(resampler) = &self.resampler
            && !resampler.shows(field, frame)
        {
            let range = "in the images: no view shows any of its columns";
            return Err(Error::out_of_range("grid of the estimate", grid, range));
        }
        self.run_on(&radiance, frame, field, output, &mut scratch)?;
        self.estimate_of(grid, values)
    }

    /// The positions of the targets in the images of all bands; empty if they are at the centres.
    fn shifts(&self, bands: &[BandImages<'_>]) -> Vec<[f64; 2]> {
        if bands.iter().all(|band| band.geometry.shifts.is_empty()) {
            return Vec::new();
        }
        let of_band = |band: &BandImages| {
            let mut shifts = band.geometry.shifts.clone();
            shifts.resize(self.views(), [0.0; 2]);
            shifts
        };
        bands.iter().flat_map(of_band).collect()
    }

    /// The quantities in the output, `[output and level, row, col]`.
    fn estimate_of(&self, grid: &Grid, mut values: Array3<f32>) -> Result<Estimate> {
        let (metadata, levels) = (&self.metadata, self.levels());
        let part = |output: NetworkOutput| {
            let number = metadata.outputs.iter().position(|one| *one == output)?;
            let part = values.slice(s![number * levels..(number + 1) * levels, .., ..]);
            Some(part.to_owned())
        };
        let uncertainty = part(NetworkOutput::Uncertainty);
        let radius = part(NetworkOutput::EffectiveRadius);
        values.slice_collapse(s![..levels, .., ..]);
        let scale = metadata.effective_radius_scale.unwrap_or(1.0) / metadata.output_scale;
        let [least, most] = TABLE_RADII.map(|radius| radius as f32);
        let radius = radius.map(|mut radius| {
            radius.zip_mut_with(&values, |radius, &extinction| {
                let limited = (scale as f32 * *radius).clamp(least, most);
                *radius = if extinction > 0.0 { limited } else { 0.0 };
            });
            radius
        });
        let volume = |values| Volume::new(*grid, values);
        Ok(Estimate {
            uncertainty: uncertainty.map(volume).transpose()?,
            effective_radius: radius.map(volume).transpose()?,
            extinction: volume(values)?,
        })
    }

    /// Allocates memory for [`Network::run`] for images of the size `[cloud, row, col]`.
    ///
    /// # Errors
    /// A size that is zero or exceeds the addressable memory.
    pub fn scratch(&self, size: [usize; 3]) -> Result<Scratch> {
        let stack = self.stack.scratch(size)?;
        let ground = match &self.resampler {
            Some(resampler) => vec![0.0; resampler.ground_len(size)?],
            None => Vec::new(),
        };
        Ok(Scratch { stack, size, ground })
    }

    /// Computes the outputs times the `output_scale` of the metadata, `[cloud, output and level, row,
    /// col]` with the extinction (1/km) first, for images of radiance (1/sr), `[cloud, band and view,
    /// row, col]`, of the size for which `scratch` was allocated. All arrays are in C order. No memory is allocated.
    ///
    /// # Errors
    /// Slices whose lengths do not match these shapes.
    pub fn run(&self, input: &[f32], output: &mut [f32], scratch: &mut Scratch) -> Result<()> {
        let [_, rows, cols] = scratch.size;
        let field = Field { size: [rows, cols], center: [0.0, 0.0] };
        self.run_on(input, Frame { size: field.size, shifts: &[] }, field, output, scratch)
    }

    /// The images on the plane of the target, `[view, row, col]`, scaled; empty if the network reads
    /// the images as recorded by the cameras.
    pub(super) fn on_target(
        &self,
        images: &ViewStack,
        shifts: &[[f64; 2]],
        field: Field,
    ) -> Result<Vec<f32>> {
        let Some(resampler) = &self.resampler else { return Ok(Vec::new()) };
        let [_, rows, cols] = images.shape();
        let radiance = images.values.as_standard_layout();
        let radiance = radiance.as_slice().expect("standard layout is contiguous");
        let mut ground = vec![0.0; resampler.ground_len([1, field.size[0], field.size[1]])?];
        resampler.resample(radiance, Frame { size: [rows, cols], shifts }, field, &mut ground);
        Ok(resampler.without_margin(&ground, field.size))
    }

    /// As [`Network::run`], for images of any frame and any field.
    fn run_on(
        &self,
        input: &[f32],
        frame: Frame<'_>,
        field: Field,
        output: &mut [f32],
        scratch: &mut Scratch,
    ) -> Result<()> {
        let Scratch { stack, size, ground } = scratch;
        let [rows, cols] = frame.size;
        let Some(resampler) = &self.resampler else { return self.stack.run(input, output, stack) };
        for (what, expected, found) in [
            (
                "number of values of the input",
                size[0] * self.metadata.images() * rows * cols,
                input.len(),
            ),
            ("length of the scratch", resampler.ground_len(*size)?, ground.len()),
        ] {
            if expected != found {
                let remedy = "give images [cloud, view, row, col] and the scratch made for them";
                return Err(Error::mismatch(what, expected, found, remedy));
            }
        }
        resampler.resample(input, frame, field, ground);
        self.stack.run_from(&resampler.source(ground, field.size), output, stack)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::DVec3;
    use crate::network::weights;

    /// The imaging geometry that the weights require, with the given target point (x and y, km).
    fn around(weights: &Weights, [x, y]: [f64; 2]) -> ImagingGeometry {
        let metadata = &weights.metadata;
        ImagingGeometry {
            views: metadata.view_geometry.clone(),
            target_km: [x, y, metadata.target_altitude_km],
            wavelength_um: metadata.wavelengths_um[0],
            solar_irradiance: 1.0,
            shifts: Vec::new(),
        }
    }

    fn images(shape: [usize; 3]) -> ViewStack {
        ViewStack::new(Array3::from_shape_fn(shape, |(view, row, col)| {
            0.01 * ((5 * view + 3 * row + 7 * col) % 11) as f32
        }))
        .unwrap()
    }

    /// Weights may be stored in any order.
    #[test]
    fn the_order_of_the_weights_in_memory_does_not_matter() {
        let weights = weights(&[3, 5, 4], 3);
        let mut reversed = weights.clone();
        for layer in &mut reversed.layers {
            let columns_first = layer.weight.t().as_standard_layout().into_owned();
            layer.weight = columns_first.reversed_axes();
            assert!(!layer.weight.is_standard_layout());
        }
        let infer = |weights: &Weights| {
            let network = Network::new(weights).unwrap();
            network.infer(&images([3, 6, 7]), &around(weights, [2.0, -1.0])).unwrap()
        };
        assert!(infer(&reversed) == infer(&weights));
    }

    /// The result agrees with the definition of the scales, and the grid is centred on the target.
    #[test]
    fn scales_and_grid_are_those_of_the_metadata() {
        let geometry = around(&weights(&[3, 5, 4], 3), [2.0, -1.0]);
        let network = Network::new(&weights(&[3, 5, 4], 3)).unwrap();
        let images = images([3, 6, 7]);
        let volume = network.infer(&images, &geometry).unwrap();
        assert_eq!(volume.grid.shape, [4, 6, 7]);
        let center = volume.grid.center();
        assert!((center - DVec3::new(2.0, -1.0, 0.4 + 2.0 * 0.04)).length() < 1e-12);
        assert!((volume.grid.extent() - DVec3::new(0.35, 0.30, 0.16)).length() < 1e-12);

        let mut unscaled = weights(&[3, 5, 4], 3);
        (unscaled.metadata.input_scale, unscaled.metadata.output_scale) = (1.0, 1.0);
        let ten_times = ViewStack::new(10.0 * &images.values).unwrap();
        let output = Network::new(&unscaled).unwrap().infer(&ten_times, &geometry).unwrap();
        assert!(output.values.iter().any(|value| *value > 0.0));
        for (volume, output) in volume.values.iter().zip(output.values) {
            assert_eq!(*volume, 5.0 * output);
        }
    }

    /// The uncertainty is the second half of the channels of the last layer.
    #[test]
    fn an_uncertainty_comes_after_the_extinction() {
        let images = images([3, 6, 7]);
        let mut weights = weights(&[3, 5, 8], 3);
        let geometry = around(&weights, [0.0, 0.0]);
        let all = Network::new(&weights).unwrap().infer(&images, &geometry).unwrap();
        weights.metadata.outputs.push(NetworkOutput::Uncertainty);
        weights.metadata.levels.count = 4;
        let network = Network::new(&weights).unwrap();
        let estimate = network.estimate(&images, &geometry).unwrap();
        let uncertainty = estimate.uncertainty.unwrap();
        assert_eq!(uncertainty.grid, estimate.extinction.grid);
        assert_eq!(uncertainty.grid.shape, [4, 6, 7]);
        assert_eq!(estimate.extinction.values, all.values.slice(s![..4, .., ..]));
        assert_eq!(uncertainty.values, all.values.slice(s![4.., .., ..]));
        assert_eq!(network.infer(&images, &geometry).unwrap(), estimate.extinction);
    }

    #[test]
    fn another_number_of_images_is_refused() {
        let weights = weights(&[3, 4], 3);
        let network = Network::new(&weights).unwrap();
        let geometry = around(&weights, [0.0, 0.0]);
        let error = network.infer(&images([4, 5, 5]), &geometry).unwrap_err().to_string();
        assert!(error.contains("number of views: expected 3, found 4"), "{error}");
        let blue = ImagingGeometry { wavelength_um: 0.45, ..geometry };
        let error = network.infer(&images([3, 5, 5]), &blue).unwrap_err().to_string();
        assert!(error.contains("wavelength"), "{error}");
    }

    #[test]
    fn a_network_may_end_without_a_relu() {
        let mut weights = weights(&[3, 5, 4], 3);
        let input = images([3, 6, 7]);
        let lowest = |weights: &Weights| {
            let volume =
                Network::new(weights).unwrap().infer(&input, &around(weights, [0.0, 0.0])).unwrap();
            volume.values.iter().copied().fold(f32::INFINITY, f32::min)
        };
        assert_eq!(lowest(&weights), 0.0);
        weights.metadata.architecture.last_relu = false;
        assert!(lowest(&weights) < 0.0);
    }
}
