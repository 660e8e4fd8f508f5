//! The estimate of a cloud by a network.

use crate::grid::Volume;

/// The estimate of a cloud by a network.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// The extinction (1/km).
    pub extinction: Volume,
    /// The expected absolute error of the extinction of each voxel (1/km), if the weights provide
    /// it.
    pub uncertainty: Option<Volume>,
}

impl From<Volume> for Estimate {
    /// Creates an estimate without uncertainty.
    fn from(extinction: Volume) -> Self {
        Self { extinction, uncertainty: None }
    }
}

impl Estimate {
    /// The relative error (epsilon) that the network expects of its estimate: the sum of the
    /// uncertainty over that of the extinction. `None` if there is no uncertainty.
    pub fn expected_relative_error(&self) -> Option<f64> {
        let sum = |volume: &Volume| volume.values.iter().map(|&v| f64::from(v)).sum::<f64>();
        self.uncertainty.as_ref().map(|uncertainty| sum(uncertainty) / sum(&self.extinction))
    }
}
