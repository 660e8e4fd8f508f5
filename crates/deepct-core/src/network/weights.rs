//! Network weights as arrays.

use super::WeightsMetadata;
use crate::error::{Error, Result};
use ndarray::{Array1, Array4};

/// The weights of one convolution, with its batch norm folded.
#[derive(Debug, Clone, PartialEq)]
pub struct LayerWeights {
    /// The kernels, `[output channel, input channel, 3, 3]`; the last two axes are row
    /// and column, and the sum is a correlation as in PyTorch.
    pub weight: Array4<f32>,
    /// The bias of each output channel.
    pub bias: Array1<f32>,
}

/// The weights of a network and their metadata.
#[derive(Debug, Clone, PartialEq)]
pub struct Weights {
    /// The metadata of the weights.
    pub metadata: WeightsMetadata,
    /// The layers, from first to last.
    pub layers: Vec<LayerWeights>,
}

impl Weights {
    /// Creates weights and checks that metadata and layers are consistent.
    ///
    /// # Errors
    /// The errors of [`WeightsMetadata::check`]; a number of layers or a shape of a layer that
    /// differs from the architecture, or a value that is not finite.
    pub fn new(metadata: WeightsMetadata, layers: Vec<LayerWeights>) -> Result<Self> {
        metadata.check()?;
        let remedy = "export the weights again";
        if layers.len() != metadata.architecture.layers() {
            let expected = metadata.architecture.layers();
            return Err(Error::mismatch("number of layers", expected, layers.len(), remedy));
        }
        for (index, (layer, (input, output))) in
            layers.iter().zip(metadata.architecture.layer_channels()).enumerate()
        {
            let expected = ([output, input, 3, 3], [output]);
            for (name, expected, found) in [
                ("weight", &expected.0[..], layer.weight.shape()),
                ("bias", &expected.1[..], layer.bias.shape()),
            ] {
                if expected != found {
                    let what = format!("shape of layers.{index}.{name}");
                    let (expected, found) = (format!("{expected:?}"), format!("{found:?}"));
                    return Err(Error::mismatch(what, expected, found, remedy));
                }
            }
            let mut values = layer.weight.iter().chain(&layer.bias);
            if let Some(value) = values.find(|value| !value.is_finite()) {
                let value = format!("{value} in layers.{index}");
                return Err(Error::out_of_range("weight", value, "finite"));
            }
        }
        Ok(Self { metadata, layers })
    }
}
