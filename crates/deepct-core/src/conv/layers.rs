//! Layers that feed each other, and how each is computed.

use super::algorithm::Method;
use super::shape::Bands;
use super::{Conv2d, Scales, Settings};

/// At least one layer, each of which reads as many channels as the one before writes.
#[derive(Debug, Clone)]
pub(super) struct Layers {
    pub(super) layers: Vec<Conv2d>,
    pub(super) scales: Scales,
    pub(super) settings: Settings,
}

impl Layers {
    /// Channels that the last layer writes.
    pub(super) fn output_channels(&self) -> usize {
        self.layers[self.layers.len() - 1].output_channels()
    }

    /// How a layer is computed for an image.
    pub(super) fn method(&self, layer: &Conv2d, image: Bands) -> Method {
        let Settings { algorithm, precision, .. } = self.settings;
        let fastest = || layer.fastest(image, precision);
        algorithm.map_or_else(fastest, |algorithm| Method { algorithm, precision })
    }
}
