//! The estimate of a cloud by a network.

use crate::error::Result;
use crate::grid::{Mask, Volume};

/// The estimate of a cloud by a network.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// The extinction (1/km).
    pub extinction: Volume,
    /// The expected absolute error of the extinction of each voxel (1/km), if the weights provide
    /// it.
    pub uncertainty: Option<Volume>,
    /// The effective radius (um), 0 where there is no extinction, if the weights provide it.
    pub effective_radius: Option<Volume>,
}

impl From<Volume> for Estimate {
    /// Creates an estimate of the extinction alone.
    fn from(extinction: Volume) -> Self {
        Self { extinction, uncertainty: None, effective_radius: None }
    }
}

impl Estimate {
    /// Sets all quantities to zero outside of a mask.
    ///
    /// # Errors
    /// A mask on another grid.
    pub fn apply(&mut self, mask: &Mask) -> Result<()> {
        let Self { extinction, uncertainty, effective_radius } = self;
        let others = [uncertainty, effective_radius].into_iter().flatten();
        others.chain([extinction]).try_for_each(|volume| mask.apply(volume))
    }

    /// The mean effective radius (um), weighted by the extinction. `None` if there is no effective
    /// radius or no extinction.
    pub fn mean_effective_radius(&self) -> Option<f64> {
        let radius = self.effective_radius.as_ref()?;
        let pairs = self.extinction.values.iter().zip(&radius.values);
        let (total, sum) = pairs.fold((0.0, 0.0), |(total, sum), (&extinction, &radius)| {
            let extinction = f64::from(extinction);
            (total + extinction, sum + extinction * f64::from(radius))
        });
        (total > 0.0).then(|| sum / total)
    }

    /// The relative error (epsilon) that the network expects of its estimate: the sum of the
    /// uncertainty over that of the extinction. `None` if there is no uncertainty or no extinction.
    pub fn expected_relative_error(&self) -> Option<f64> {
        let sum = |volume: &Volume| volume.values.iter().map(|&v| f64::from(v)).sum::<f64>();
        let extinction = sum(&self.extinction);
        let uncertainty = self.uncertainty.as_ref()?;
        (extinction > 0.0).then(|| sum(uncertainty) / extinction)
    }

    /// The shares of the extinction in the lowest and in the highest level. If one of them is not
    /// small, the cloud may extend beyond the grid.
    pub fn shares_at_ends(&self) -> [f64; 2] {
        let level = |number: usize| {
            let level = self.extinction.values.index_axis(ndarray::Axis(0), number);
            level.iter().map(|&value| f64::from(value)).sum::<f64>()
        };
        let total: f64 = self.extinction.values.iter().map(|&value| f64::from(value)).sum();
        let last = self.extinction.grid.shape[0] - 1;
        [0, last].map(|number| if total > 0.0 { level(number) / total } else { 0.0 })
    }

    /// Multiplies the uncertainty by the ratio of the error found to the error expected, which is
    /// interpolated linearly between the pairs `[expected, found]` of a calibration.
    pub(super) fn calibrate(&mut self, calibration: &[[f64; 2]]) {
        let Some(expected) = self.expected_relative_error() else { return };
        let (Some(first), Some(last)) = (calibration.first(), calibration.last()) else { return };
        let ratio = |pair: &[f64; 2]| pair[1] / pair[0];
        let after = calibration.partition_point(|pair| pair[0] <= expected);
        let factor = if !expected.is_finite() || after == 0 {
            ratio(first)
        } else if after == calibration.len() {
            ratio(last)
        } else {
            let (low, high) = (&calibration[after - 1], &calibration[after]);
            let share = (expected - low[0]) / (high[0] - low[0]);
            (1.0 - share) * ratio(low) + share * ratio(high)
        };
        if let Some(uncertainty) = &mut self.uncertainty {
            uncertainty.values.mapv_inplace(|value| (f64::from(value) * factor) as f32);
        }
    }
}
