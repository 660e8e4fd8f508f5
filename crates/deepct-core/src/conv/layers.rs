//! A sequence of convolution layers and the settings with which it is evaluated.

use super::algorithm::Method;
use super::shape::Bands;
use super::{Conv2d, Scales, Settings};

/// A non-empty sequence of layers; the input channels of each layer are the output channels of
/// the preceding one.
#[derive(Debug, Clone)]
pub(super) struct Layers {
    pub(super) layers: Vec<Conv2d>,
    pub(super) scales: Scales,
    pub(super) settings: Settings,
}

impl Layers {
    /// Number of output channels of the last layer.
    pub(super) fn output_channels(&self) -> usize {
        self.layers[self.layers.len() - 1].output_channels()
    }

    /// The method by which a layer is computed for an image of this size.
    pub(super) fn method(&self, layer: &Conv2d, image: Bands) -> Method {
        let Settings { algorithm, precision, .. } = self.settings;
        let fastest = || layer.fastest(image, precision);
        algorithm.map_or_else(fastest, |algorithm| Method { algorithm, precision })
    }
}
