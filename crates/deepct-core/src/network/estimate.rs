//! What a network states about a cloud.

use crate::grid::Volume;

/// What a network tells of a cloud.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// The extinction (1/km).
    pub extinction: Volume,
    /// The expected absolute error of the extinction of each voxel (1/km), where the weights
    /// tell it.
    pub uncertainty: Option<Volume>,
}

impl From<Volume> for Estimate {
    /// An extinction of which no more is known.
    fn from(extinction: Volume) -> Self {
        Self { extinction, uncertainty: None }
    }
}

impl Estimate {
    /// The relative error (epsilon) that the network expects of itself: the sum of the
    /// uncertainty over that of the extinction. `None` where no uncertainty is told.
    pub fn expected_relative_error(&self) -> Option<f64> {
        let sum = |volume: &Volume| volume.values.iter().map(|&v| f64::from(v)).sum::<f64>();
        self.uncertainty.as_ref().map(|uncertainty| sum(uncertainty) / sum(&self.extinction))
    }
}
