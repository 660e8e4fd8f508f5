//! Small perceptrons, evaluated in f64 when weights are folded.

use crate::error::{Error, Result};
use ndarray::{Array1, Array2};

/// A linear layer, as `Linear` of PyTorch.
#[derive(Debug, Clone, PartialEq)]
pub struct Linear {
    /// Factors, `[output, input]`.
    pub weight: Array2<f32>,
    /// The constant of each output.
    pub bias: Array1<f32>,
}

impl Linear {
    fn apply(&self, input: &[f64]) -> Vec<f64> {
        let rows = self.weight.outer_iter().zip(&self.bias);
        rows.map(|(row, &bias)| {
            let products = row.iter().zip(input).map(|(&factor, value)| f64::from(factor) * value);
            f64::from(bias) + products.sum::<f64>()
        })
        .collect()
    }
}

/// Linear layers with the activation SiLU, `x / (1 + exp(-x))`, between them.
#[derive(Debug, Clone, PartialEq)]
pub struct Perceptron(Vec<Linear>);

impl Perceptron {
    /// Creates a perceptron from its layers, first to last.
    ///
    /// # Errors
    /// No layer, or numbers of inputs and outputs that do not fit.
    pub fn new(layers: Vec<Linear>) -> Result<Self> {
        if layers.is_empty() {
            return Err(Error::out_of_range("layers of a perceptron", 0, "at least 1"));
        }
        let outputs = |layer: &Linear| (layer.weight.shape()[0], layer.bias.len());
        let fits = |(written, biases), read| written == biases && written == read;
        let ends = layers.iter().skip(1).map(|next| next.weight.shape()[1]);
        let read = ends.chain([layers[layers.len() - 1].bias.len()]);
        for (index, (layer, read)) in layers.iter().zip(read).enumerate() {
            if !fits(outputs(layer), read) {
                let what = format!("outputs of layer {index} of a perceptron");
                let found = layer.weight.shape()[0];
                return Err(Error::mismatch(what, read, found, "export the weights again"));
            }
        }
        Ok(Self(layers))
    }

    /// Number of inputs.
    pub fn inputs(&self) -> usize {
        self.0[0].weight.shape()[1]
    }

    /// Number of outputs.
    pub fn outputs(&self) -> usize {
        self.0[self.0.len() - 1].bias.len()
    }

    /// Number of parameters.
    pub(super) fn parameters(&self) -> usize {
        self.0.iter().map(|layer| layer.weight.len() + layer.bias.len()).sum()
    }

    /// The outputs for given inputs.
    pub(super) fn apply(&self, input: &[f64]) -> Vec<f64> {
        let (last, hidden) = self.0.split_last().expect("at least one layer");
        let activated = |values: Vec<f64>| -> Vec<f64> {
            values.into_iter().map(|x| x / (1.0 + (-x).exp())).collect()
        };
        let input =
            hidden.iter().fold(input.to_vec(), |values, layer| activated(layer.apply(&values)));
        last.apply(&input)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    /// By hand: silu(1) = 0.731059, silu(-2) = -0.238406.
    #[test]
    fn outputs_are_those_computed_by_hand() {
        let first = Linear { weight: array![[1.0, 0.0], [0.0, -1.0]], bias: array![0.5, 0.0] };
        let second = Linear { weight: array![[2.0, 10.0]], bias: array![1.0] };
        let perceptron = Perceptron::new(vec![first.clone(), second.clone()]).unwrap();
        assert_eq!((perceptron.inputs(), perceptron.outputs()), (2, 1));
        let output = perceptron.apply(&[0.5, 2.0]);
        assert!((output[0] - (1.0 + 2.0 * 0.731_058_6 - 10.0 * 0.238_405_8)).abs() < 1e-6);
        assert!(Perceptron::new(vec![second, first]).is_err());
        assert!(Perceptron::new(Vec::new()).is_err());
    }
}
