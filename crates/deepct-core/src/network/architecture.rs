//! The number of layers and their channels.

use serde::{Deserialize, Serialize};

/// The architecture of a network: a chain of 3x3 convolutions with padding 1, each followed by a
/// ReLU.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Architecture {
    /// Number of channels before the first layer (one per view, or one per plane and view), between
    /// the layers, and after the last layer (one per level and output). The list has one element
    /// more than there are layers.
    pub channels: Vec<usize>,
    /// Whether a ReLU follows the last layer, as in the paper; every other layer is always followed
    /// by one.
    pub last_relu: bool,
}

impl Architecture {
    /// The paper's network for `views` images and `levels` altitudes, with `model_depth + 1` layers
    /// (see [`channels`]).
    pub fn paper(views: usize, levels: usize, model_depth: usize) -> Self {
        Self { channels: channels(views, levels, model_depth), last_relu: true }
    }

    /// Number of convolutions.
    pub fn layers(&self) -> usize {
        self.channels.len().saturating_sub(1)
    }

    /// Number of input and output channels of each layer.
    pub fn layer_channels(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.channels.windows(2).map(|pair| (pair[0], pair[1]))
    }

    /// Number of weights and biases, with batch norms folded.
    pub fn parameters(&self) -> usize {
        self.layer_channels().map(|(input, output)| (9 * input + 1) * output).sum()
    }

    /// Whether a ReLU follows layer `layer`.
    pub fn relu(&self, layer: usize) -> bool {
        self.last_relu || layer + 1 < self.layers()
    }
}

/// The numbers of channels before, between and after the layers of the paper's network. The number
/// increases by 2 per layer from the number of views until it reaches the number of levels, and
/// then remains constant (Sde-Chen et al. 2021, and the code released by its authors). There are
/// `model_depth + 1` layers, and the list has one element more.
pub fn channels(views: usize, levels: usize, model_depth: usize) -> Vec<usize> {
    let mut channels = vec![views];
    let mut current = views;
    for _ in 0..model_depth {
        current = if current + 2 < levels { current + 2 } else { levels };
        channels.push(current);
    }
    channels.push(levels);
    channels
}

/// The width (pixels) of the square of input pixels on which one output pixel depends, after
/// `layers` convolutions of 3x3.
pub fn receptive_field(layers: usize) -> usize {
    2 * layers + 1
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The numbers of parameters are those of the released code for both architectures of the
    /// paper.
    #[test]
    fn both_published_layouts_have_their_number_of_parameters() {
        let pearls = Architecture::paper(32, 32, 32);
        assert_eq!((pearls.layers(), pearls.parameters()), (33, 305_184));
        let cloudct = Architecture::paper(10, 32, 80);
        assert_eq!((cloudct.layers(), cloudct.parameters()), (81, 695_122));
        assert_eq!(cloudct.channels[..4], [10, 12, 14, 16]);
        assert_eq!(cloudct.channels[9..14], [28, 30, 32, 32, 32]);
    }

    #[test]
    fn any_number_of_views_reaches_the_levels() {
        assert_eq!(channels(9, 14, 4), [9, 11, 13, 14, 14, 14]);
        assert_eq!(channels(40, 32, 1), [40, 32, 32]);
        assert_eq!(channels(3, 32, 1), [3, 5, 32]);
    }

    #[test]
    fn the_receptive_fields_are_those_of_the_paper() {
        assert_eq!((receptive_field(33), receptive_field(81)), (67, 163));
    }
}
