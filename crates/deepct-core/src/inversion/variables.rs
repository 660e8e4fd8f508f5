//! The variables of the optimiser: one for each voxel of a mask.

use super::optimiser::Bounds;
use super::{InversionSettings, Variable};
use crate::error::Result;
use crate::grid::{Grid, Volume};
use ndarray::Array3;

/// The variables of one grid. The extinction of voxel `i` is `share[i] * T(x[i])` with the function
/// `T` of [`Variable`]. In blocks that are partly inside the mask, `T` is the extinction of the
/// part inside, called the cloudy part.
#[derive(Debug, Clone)]
pub(super) struct Variables {
    grid: Grid,
    voxels: Vec<[usize; 3]>,
    share: Vec<f64>,
    kind: Variable,
    softness: f64,
    greatest: f64,
}

impl Variables {
    /// Creates a variable for each voxel with a positive share.
    pub(super) fn new(grid: Grid, shares: &Array3<f64>, settings: &InversionSettings) -> Self {
        let inside = shares.indexed_iter().filter(|(_, share)| **share > 0.0);
        let (voxels, share): (Vec<_>, Vec<_>) =
            inside.map(|((k, j, i), &share)| ([k, j, i], share)).unzip();
        let InversionSettings { variable: kind, softness, greatest, .. } = *settings;
        Self { grid, voxels, share, kind, softness, greatest }
    }

    pub(super) fn len(&self) -> usize {
        self.voxels.len()
    }

    /// The values of a field at the voxels of the variables.
    pub(super) fn gather(&self, values: &Array3<f64>) -> Vec<f64> {
        self.voxels.iter().map(|voxel| values[*voxel]).collect()
    }

    /// The field with the given values at the voxels of the variables, and 0 elsewhere.
    pub(super) fn scatter(&self, numbers: &[f64]) -> Array3<f64> {
        let mut values = Array3::zeros(self.grid.shape);
        for (voxel, number) in self.voxels.iter().zip(numbers) {
            values[*voxel] = *number;
        }
        values
    }

    /// The index of the variable of each voxel.
    pub(super) fn numbers(&self) -> Array3<Option<u32>> {
        let mut numbers = Array3::from_elem(self.grid.shape, None);
        for (number, voxel) in self.voxels.iter().enumerate() {
            numbers[*voxel] = Some(number as u32);
        }
        numbers
    }

    /// Bounds of an extinction between zero and the largest extinction.
    pub(super) fn bounds(&self) -> Bounds {
        let greatest = self.inverse(self.greatest);
        Bounds { lower: vec![0.0; self.len()], upper: vec![greatest; self.len()] }
    }

    /// The variables for an extinction of the cloudy parts (1/km).
    pub(super) fn of(&self, cloudy: &Volume) -> Vec<f64> {
        let extinction = self.voxels.iter().map(|voxel| f64::from(cloudy.values[*voxel]));
        extinction.map(|extinction| self.inverse(extinction.clamp(0.0, self.greatest))).collect()
    }

    /// The extinction of the cloudy part of each voxel (1/km), `T`.
    pub(super) fn cloudy(&self, x: &[f64]) -> Vec<f64> {
        x.iter().map(|x| self.forward(*x)).collect()
    }

    /// The extinction (1/km) that is the input of the model.
    ///
    /// # Errors
    /// None if there are as many values as variables.
    pub(super) fn extinction(&self, x: &[f64]) -> Result<Volume> {
        let mut cloudy = self.cloudy(x);
        cloudy.iter_mut().zip(&self.share).for_each(|(cloudy, share)| *cloudy *= share);
        Volume::new(self.grid, self.scatter(&cloudy).mapv(|value| value as f32))
    }

    /// Derivatives with respect to the variables, from the derivatives with respect to the
    /// extinction in the model and to that of the cloudy parts.
    pub(super) fn pull_back(&self, x: &[f64], model: &Volume, cloudy: &[f64]) -> Vec<f64> {
        (0..x.len())
            .map(|i| {
                let outer = self.share[i] * f64::from(model.values[self.voxels[i]]) + cloudy[i];
                outer * self.slope(x[i])
            })
            .collect()
    }

    /// The derivative of the extinction of each cloudy part with respect to its variable.
    pub(super) fn slopes(&self, x: &[f64]) -> Vec<f64> {
        x.iter().map(|x| self.slope(*x)).collect()
    }

    fn forward(&self, u: f64) -> f64 {
        match self.kind {
            Variable::Linear => u,
            Variable::Logarithmic => self.softness * (u / self.softness).exp_m1(),
        }
    }

    fn slope(&self, u: f64) -> f64 {
        match self.kind {
            Variable::Linear => 1.0,
            Variable::Logarithmic => (u / self.softness).exp(),
        }
    }

    fn inverse(&self, extinction: f64) -> f64 {
        match self.kind {
            Variable::Linear => extinction,
            Variable::Logarithmic => self.softness * (extinction / self.softness).ln_1p(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::DVec3;

    fn variables(kind: Variable) -> Variables {
        let grid = Grid::new(DVec3::ZERO, DVec3::ONE, [1, 2, 3]).unwrap();
        let shares = ndarray::array![[[0.5, 0.0, 1.0], [0.25, 0.0, 0.0]]];
        let settings = InversionSettings { variable: kind, ..Default::default() };
        Variables::new(grid, &shares, &settings)
    }

    #[test]
    fn extinction_and_variables_are_inverse() {
        for kind in [Variable::Linear, Variable::Logarithmic] {
            let variables = variables(kind);
            let x = [3.0, 7.0, 11.0];
            let cloudy = variables.scatter(&variables.cloudy(&x)).mapv(|value| value as f32);
            let cloudy = Volume::new(variables.grid, cloudy).unwrap();
            for (found, expected) in variables.of(&cloudy).iter().zip(x) {
                assert!((found - expected).abs() < 1e-5, "{found} {expected}");
            }
            let total: f32 = variables.extinction(&x).unwrap().values.sum();
            let expected: f64 =
                variables.cloudy(&x).iter().zip([0.5, 1.0, 0.25]).map(|(c, s)| c * s).sum();
            assert!((f64::from(total) / expected - 1.0).abs() < 1e-6);
        }
    }

    /// Compares with central differences of a weighted sum of the extinction.
    #[test]
    fn derivatives_are_those_of_differences() {
        for kind in [Variable::Linear, Variable::Logarithmic] {
            let variables = variables(kind);
            let weights = ndarray::array![[[2.0, 9.0, -3.0], [5.0, 9.0, 9.0]]];
            let sum = |x: &[f64]| -> f64 {
                let cloudy = variables.cloudy(x);
                let seen: f64 = cloudy
                    .iter()
                    .zip(&variables.share)
                    .zip(&variables.voxels)
                    .map(|((cloudy, share), voxel)| cloudy * share * f64::from(weights[*voxel]))
                    .sum();
                seen + 0.7 * cloudy.iter().sum::<f64>()
            };
            let x = [3.0, 1.0, 4.0];
            let model = Volume::new(variables.grid, weights.clone()).unwrap();
            let found = variables.pull_back(&x, &model, &[0.7; 3]);
            for i in 0..3 {
                let (mut above, mut below) = (x, x);
                above[i] += 1e-5;
                below[i] -= 1e-5;
                let expected = (sum(&above) - sum(&below)) / 2e-5;
                assert!((found[i] / expected - 1.0).abs() < 1e-6, "{} {expected}", found[i]);
            }
        }
    }
}
