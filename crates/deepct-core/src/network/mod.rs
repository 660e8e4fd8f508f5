//! The network: layers of 3x3 convolutions that turn a stack of images, one channel
//! per view, into an extinction field, one channel per level (Sde-Chen et al. 2021).

mod architecture;
mod batch_norm;
mod metadata;
mod weights;

pub use architecture::{Architecture, channels, receptive_field};
pub use batch_norm::{BATCH_NORM_EPSILON, BatchNorm};
pub use metadata::{FORMAT_VERSION, ImageLayout, Levels, Training, WeightsMetadata};
pub use weights::{LayerWeights, Weights};

use crate::conv::{Conv2d, Kernel, Stack};
use crate::error::{Error, Result};
use crate::grid::{Grid, Volume};
use crate::image::ViewStack;
use crate::math::DVec3;
use ndarray::Array3;

/// A network that is ready to run: its weights packed for this processor.
#[derive(Debug, Clone)]
pub struct Network {
    metadata: WeightsMetadata,
    stack: Stack,
}

impl Network {
    /// The network of `weights`, on the fastest kernel that the processor has.
    ///
    /// # Errors
    /// Layers that do not feed each other; none for [`Weights`] made by
    /// [`Weights::new`].
    pub fn new(weights: &Weights) -> Result<Self> {
        Self::with_kernel(weights, Kernel::best())
    }

    /// The network of `weights` on a kernel of one's choice.
    ///
    /// # Errors
    /// As [`Network::new`].
    pub fn with_kernel(weights: &Weights, kernel: Kernel) -> Result<Self> {
        let architecture = &weights.metadata.architecture;
        let layers = weights.layers.iter().enumerate().map(|(index, layer)| {
            let relu = architecture.relu(index);
            Conv2d::new(layer.weight.view(), layer.bias.view(), relu, kernel)
        });
        let stack = Stack::new(layers.collect::<Result<_>>()?)?;
        Ok(Self { metadata: weights.metadata.clone(), stack })
    }

    /// What the network is for.
    pub fn metadata(&self) -> &WeightsMetadata {
        &self.metadata
    }

    /// Number of views that the network wants.
    pub fn views(&self) -> usize {
        self.stack.input_channels()
    }

    /// Number of levels that the network gives.
    pub fn levels(&self) -> usize {
        self.stack.output_channels()
    }

    /// The grid of the extinction that [`Network::infer`] gives for images of
    /// `[rows, cols]` whose middle shows the point `target` (x and y, km): one column of
    /// voxels for each pixel, the levels of the metadata.
    ///
    /// # Errors
    /// A target that is not finite, an empty image, or one that is too large.
    pub fn grid(&self, target: [f64; 2], [rows, cols]: [usize; 2]) -> Result<Grid> {
        let WeightsMetadata { horizontal_spacing_km: [dx, dy], levels, .. } = &self.metadata;
        let west = target[0] - 0.5 * dx * cols as f64;
        let south = target[1] - 0.5 * dy * rows as f64;
        let origin = DVec3::new(west, south, levels.bottom_km);
        Grid::new(origin, DVec3::new(*dx, *dy, levels.spacing_km), [levels.count, rows, cols])
    }

    /// The extinction (1/km) of the cloud in `images` (radiance, 1/sr), whose middle
    /// shows the point `target` (x and y, km).
    ///
    /// Whether the images were taken as the weights want them is the question of
    /// [`WeightsMetadata::check_images`].
    ///
    /// # Errors
    /// Another number of images than of views; those of [`Network::grid`].
    pub fn infer(&self, images: &ViewStack, target: [f64; 2]) -> Result<Volume> {
        let [views, rows, cols] = images.shape();
        if views != self.views() {
            let remedy = "give the images of the formation that the weights are for";
            return Err(Error::mismatch("number of views", self.views(), views, remedy));
        }
        let grid = self.grid(target, [rows, cols])?;
        let input_scale = self.metadata.input_scale as f32;
        let input: Vec<f32> = images.values.iter().map(|radiance| radiance * input_scale).collect();
        let mut scratch = vec![0.0; self.scratch_len([rows, cols])];
        let mut values = Array3::zeros(grid.shape);
        let output = values.as_slice_mut().expect("a new array is contiguous");
        self.run(&input, [rows, cols], output, &mut scratch)?;
        let output_scale = self.metadata.output_scale as f32;
        values.mapv_inplace(|value| value * output_scale);
        Volume::new(grid, values)
    }

    /// The number of floats of scratch that [`Network::run`] needs.
    pub fn scratch_len(&self, size: [usize; 2]) -> usize {
        self.stack.scratch_len(size)
    }

    /// Run the layers alone, without the scales: `input` is `[view, row, col]` and
    /// `output` `[level, row, col]`, both C-ordered. Nothing is allocated.
    ///
    /// # Errors
    /// Slices that are not of these shapes, or a scratch shorter than
    /// [`Network::scratch_len`].
    pub fn run(
        &self,
        input: &[f32],
        size: [usize; 2],
        output: &mut [f32],
        scratch: &mut [f32],
    ) -> Result<()> {
        self.stack.run(input, size, output, scratch)
    }
}

#[cfg(test)]
mod fixture;
#[cfg(test)]
pub(crate) use fixture::weights;

#[cfg(test)]
mod tests {
    use super::*;

    fn images(shape: [usize; 3]) -> ViewStack {
        ViewStack::new(Array3::from_shape_fn(shape, |(view, row, col)| {
            0.01 * ((5 * view + 3 * row + 7 * col) % 11) as f32
        }))
        .unwrap()
    }

    /// The same numbers by the definition of the scales, and a grid around the target.
    #[test]
    fn scales_and_grid_are_those_of_the_metadata() {
        let network = Network::new(&weights(&[3, 5, 4], 3)).unwrap();
        let images = images([3, 6, 7]);
        let volume = network.infer(&images, [2.0, -1.0]).unwrap();
        assert_eq!(volume.grid.shape, [4, 6, 7]);
        let center = volume.grid.center();
        assert!((center - DVec3::new(2.0, -1.0, 0.4 + 2.0 * 0.04)).length() < 1e-12);
        assert!((volume.grid.extent() - DVec3::new(0.35, 0.30, 0.16)).length() < 1e-12);

        let input: Vec<f32> = images.values.iter().map(|value| 10.0 * value).collect();
        let mut scratch = vec![0.0; network.scratch_len([6, 7])];
        let mut output = vec![0.0; 4 * 6 * 7];
        network.run(&input, [6, 7], &mut output, &mut scratch).unwrap();
        assert!(output.iter().any(|value| *value > 0.0));
        for (volume, output) in volume.values.iter().zip(output) {
            assert_eq!(*volume, 5.0 * output);
        }
    }

    #[test]
    fn another_number_of_images_is_refused() {
        let network = Network::new(&weights(&[3, 4], 3)).unwrap();
        let error = network.infer(&images([4, 5, 5]), [0.0, 0.0]).unwrap_err().to_string();
        assert!(error.contains("number of views: expected 3, found 4"), "{error}");
    }

    #[test]
    fn a_network_may_end_without_a_relu() {
        let mut weights = weights(&[3, 5, 4], 3);
        let input = images([3, 6, 7]);
        let lowest = |weights: &Weights| {
            let volume = Network::new(weights).unwrap().infer(&input, [0.0, 0.0]).unwrap();
            volume.values.iter().copied().fold(f32::INFINITY, f32::min)
        };
        assert_eq!(lowest(&weights), 0.0);
        weights.metadata.architecture.last_relu = false;
        assert!(lowest(&weights) < 0.0);
    }
}
