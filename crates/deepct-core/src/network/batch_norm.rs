//! Batch normalisation, folded into the convolution before it.

use super::LayerWeights;
use crate::error::{Error, Result};
use ndarray::{Array1, Axis};

/// Constant added to the variance before the square root is taken (PyTorch's default).
pub const BATCH_NORM_EPSILON: f64 = 1e-5;

/// The batch normalisation of one layer at inference, one value per output channel (Ioffe and
/// Szegedy 2015, algorithm 2).
#[derive(Debug, Clone, PartialEq)]
pub struct BatchNorm {
    /// The factor gamma.
    pub weight: Array1<f32>,
    /// The offset beta.
    pub bias: Array1<f32>,
    /// Mean over the training data.
    pub running_mean: Array1<f32>,
    /// Variance over the training data.
    pub running_var: Array1<f32>,
}

impl BatchNorm {
    /// Returns the convolution that is equivalent to `layer` followed by this normalisation,
    /// computed in f64 and rounded once.
    ///
    /// # Errors
    /// A number of channels that differs from that of the layer, or a variance that is negative or
    /// not finite.
    pub fn fold_into(&self, layer: &LayerWeights) -> Result<LayerWeights> {
        let channels = layer.weight.shape()[0];
        for values in [&self.weight, &self.bias, &self.running_mean, &self.running_var] {
            if values.len() != channels {
                return Err(Error::mismatch(
                    "number of channels of a batch norm",
                    channels,
                    values.len(),
                    "give one value for each output channel of the convolution",
                ));
            }
        }
        if let Some(variance) = self.running_var.iter().find(|v| !(v.is_finite() && **v >= 0.0)) {
            let range = "finite and not negative";
            return Err(Error::out_of_range("batch norm running_var", variance, range));
        }
        let mut folded = layer.clone();
        for (channel, mut weight) in folded.weight.axis_iter_mut(Axis(0)).enumerate() {
            let deviation = (f64::from(self.running_var[channel]) + BATCH_NORM_EPSILON).sqrt();
            let factor = f64::from(self.weight[channel]) / deviation;
            weight.mapv_inplace(|value| (f64::from(value) * factor) as f32);
            let centered = f64::from(layer.bias[channel]) - f64::from(self.running_mean[channel]);
            folded.bias[channel] = (centered * factor + f64::from(self.bias[channel])) as f32;
        }
        Ok(folded)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array4, array};

    fn layer() -> LayerWeights {
        let weight = Array4::from_shape_fn((2, 3, 3, 3), |(o, i, y, x)| {
            0.1 * (1.0 + o as f32) * (i as f32 - 0.7) + 0.03 * (y as f32) - 0.02 * (x as f32)
        });
        LayerWeights { weight, bias: array![0.25, -0.5] }
    }

    /// Computes one pixel by normalising the sum, and by summing with the folded weights.
    #[test]
    fn folding_equals_normalising() {
        let norm = BatchNorm {
            weight: array![1.5, -0.4],
            bias: array![0.1, 0.3],
            running_mean: array![0.2, -2.0],
            running_var: array![4.0, 0.01],
        };
        let (layer, folded) = (layer(), norm.fold_into(&layer()).unwrap());
        let input = |i: usize, y: usize, x: usize| ((7 * i + 3 * y + 5 * x) % 11) as f64 - 4.0;
        for channel in 0..2 {
            let sum = |layer: &LayerWeights| {
                let weight = layer.weight.index_axis(Axis(0), channel);
                let taps =
                    weight.indexed_iter().map(|((i, y, x), w)| f64::from(*w) * input(i, y, x));
                taps.sum::<f64>() + f64::from(layer.bias[channel])
            };
            let mean = f64::from(norm.running_mean[channel]);
            let deviation = (f64::from(norm.running_var[channel]) + 1e-5).sqrt();
            let normalised = (sum(&layer) - mean) / deviation * f64::from(norm.weight[channel])
                + f64::from(norm.bias[channel]);
            assert!((normalised - sum(&folded)).abs() < 1e-5 * normalised.abs().max(1.0));
        }
    }

    #[test]
    fn a_norm_that_does_not_fit_is_refused() {
        let ones = array![1.0_f32, 1.0];
        let norm = BatchNorm {
            weight: ones.clone(),
            bias: ones.clone(),
            running_mean: ones.clone(),
            running_var: array![1.0, -1.0],
        };
        assert!(norm.fold_into(&layer()).unwrap_err().to_string().contains("running_var is -1"));
        let short = BatchNorm { running_var: ones, bias: array![1.0], ..norm };
        assert!(short.fold_into(&layer()).is_err());
    }
}
