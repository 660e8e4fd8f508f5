//! The variables of the optimiser: the extinction of each voxel of a mask, and the effective radius.

use super::optimiser::Bounds;
use super::radius::Profile;
use super::{Fields, InversionSettings, Variable};
use crate::error::Result;
use crate::grid::{Grid, Volume};
use crate::transport::Derivatives;
use ndarray::Array3;
use std::ops::Range;

/// The unknowns on one grid.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Unknowns {
    /// Extinction of the cloudy part of each voxel (1/km).
    pub(super) extinction: Volume,
    /// Variables of the profile of the effective radius.
    pub(super) profile: Vec<f64>,
    /// Deviation of each voxel from the profile, in the units of its variable.
    pub(super) deviations: Volume,
}

/// The variables of one grid: first the extinction of each voxel, then the profile of the effective
/// radius, and last the deviation of each voxel from the profile, each as far as it is unknown.
///
/// The extinction of voxel `i` is `share[i] * T(x[i])` with the function `T` of [`Variable`]. In
/// blocks that are partly inside the mask, `T` is the extinction of the part inside, called the cloudy
/// part.
#[derive(Debug, Clone)]
pub(super) struct Variables {
    grid: Grid,
    voxels: Vec<[usize; 3]>,
    share: Vec<f64>,
    kind: Variable,
    softness: f64,
    greatest: f64,
    profile: Profile,
}

impl Variables {
    /// Creates the variables of the voxels with a positive share and of a profile.
    pub(super) fn new(
        grid: Grid,
        shares: &Array3<f64>,
        settings: &InversionSettings,
        profile: Profile,
    ) -> Self {
        let inside = shares.indexed_iter().filter(|(_, share)| **share > 0.0);
        let (voxels, share): (Vec<_>, Vec<_>) =
            inside.map(|((k, j, i), &share)| ([k, j, i], share)).unzip();
        let InversionSettings { variable: kind, softness, greatest, .. } = *settings;
        Self { grid, voxels, share, kind, softness, greatest, profile }
    }

    pub(super) fn len(&self) -> usize {
        self.of_deviations().end
    }

    /// The variables of the extinction.
    pub(super) fn of_extinction(&self) -> Range<usize> {
        0..self.voxels.len()
    }

    /// The variables of the profile of the effective radius.
    pub(super) fn of_profile(&self) -> Range<usize> {
        let start = self.voxels.len();
        start..start + self.profile.len()
    }

    /// The variables of the deviations from the profile.
    pub(super) fn of_deviations(&self) -> Range<usize> {
        let start = self.of_profile().end;
        let count = if self.profile.has_deviations() { self.voxels.len() } else { 0 };
        start..start + count
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

    /// Bounds of the variables; the extinction is between zero and its largest value.
    pub(super) fn bounds(&self) -> Bounds {
        let extinction = [0.0, self.inverse(self.greatest)];
        let mut bounds = vec![extinction; self.voxels.len()];
        bounds.extend(self.profile.bounds());
        bounds.resize(self.len(), Profile::deviation_bounds());
        let (lower, upper) = bounds.into_iter().map(|[lower, upper]| (lower, upper)).unzip();
        Bounds { lower, upper }
    }

    /// The variables of unknowns.
    pub(super) fn of(&self, unknowns: &Unknowns) -> Vec<f64> {
        let Unknowns { extinction, profile, deviations } = unknowns;
        let at = |volume: &Volume| self.gather(&volume.values.mapv(f64::from));
        let extinction = at(extinction).into_iter();
        let extinction = extinction.map(|value| self.inverse(value.clamp(0.0, self.greatest)));
        let mut x: Vec<f64> = extinction.chain(profile.iter().copied()).collect();
        if self.profile.has_deviations() {
            x.extend(at(deviations));
        }
        x
    }

    /// The unknowns of variables.
    ///
    /// # Errors
    /// None if there are as many values as variables.
    pub(super) fn unknowns(&self, x: &[f64]) -> Result<Unknowns> {
        let volume = |values: &[f64]| {
            Volume::new(self.grid, self.scatter(values).mapv(|value| value as f32))
        };
        Ok(Unknowns {
            extinction: volume(&self.values(x)[self.of_extinction()])?,
            profile: x[self.of_profile()].to_vec(),
            deviations: volume(&x[self.of_deviations()])?,
        })
    }

    /// The values to which the prior applies: the extinction of the cloudy part of each voxel (1/km),
    /// `T`, and the other variables themselves.
    pub(super) fn values(&self, x: &[f64]) -> Vec<f64> {
        let extinction = x[self.of_extinction()].iter().map(|x| self.forward(*x));
        extinction.chain(x[self.voxels.len()..].iter().copied()).collect()
    }

    /// The fields that are the input of the model.
    ///
    /// # Errors
    /// None if there are as many values as variables.
    pub(super) fn fields(&self, x: &[f64]) -> Result<Fields> {
        let mut cloudy = self.values(x);
        cloudy.iter_mut().zip(&self.share).for_each(|(cloudy, share)| *cloudy *= share);
        let extinction = self.scatter(&cloudy[self.of_extinction()]);
        let deviations = self.scatter(&x[self.of_deviations()]);
        Ok(Fields {
            extinction: Volume::new(self.grid, extinction.mapv(|value| value as f32))?,
            effective_radius: self.profile.volume(
                &self.grid,
                &x[self.of_profile()],
                &deviations,
            )?,
        })
    }

    /// Derivatives with respect to the variables, from the derivatives with respect to the fields of
    /// the model and to the [`Variables::values`].
    pub(super) fn pull_back(&self, x: &[f64], model: &Derivatives, values: &[f64]) -> Vec<f64> {
        let slopes = self.slopes(x);
        let mut derivative: Vec<f64> = values.iter().zip(&slopes).map(|(v, s)| v * s).collect();
        let (profile, deviations) = (self.of_profile(), self.of_deviations());
        for (i, voxel) in self.voxels.iter().enumerate() {
            derivative[i] += slopes[i] * self.share[i] * f64::from(model.extinction.values[*voxel]);
            if profile.is_empty() {
                continue;
            }
            let deviation = x[deviations.clone()].get(i).copied();
            let altitude = self.grid.voxel_center(*voxel).z;
            let at = self.profile.at(altitude, &x[profile.clone()], deviation.unwrap_or(0.0));
            let by_radius = f64::from(model.effective_radius.values[*voxel]);
            for (number, slope) in profile.clone().zip(at.by_profile) {
                derivative[number] += slope * by_radius;
            }
            if deviation.is_some() {
                derivative[deviations.start + i] += at.by_deviation * by_radius;
            }
        }
        derivative
    }

    /// The derivative of each of the [`Variables::values`] with respect to its variable.
    pub(super) fn slopes(&self, x: &[f64]) -> Vec<f64> {
        let extinction = x[self.of_extinction()].iter().map(|x| self.slope(*x));
        extinction.chain(x[self.voxels.len()..].iter().map(|_| 1.0)).collect()
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
    use crate::grid::Mask;
    use crate::inversion::Radius;
    use crate::math::DVec3;

    fn variables(kind: Variable, radius: Radius) -> Variables {
        let grid = Grid::new(DVec3::ZERO, DVec3::splat(0.1), [2, 1, 3]).unwrap();
        let shares = ndarray::array![[[0.5, 0.0, 1.0]], [[0.25, 0.0, 0.0]]];
        let settings = InversionSettings { variable: kind, ..Default::default() };
        let mask = Mask::new(grid, shares.mapv(|share| share > 0.0)).unwrap();
        Variables::new(grid, &shares, &settings, Profile::new(radius, &mask))
    }

    const ALL: [Radius; 4] = [Radius::Given, Radius::Uniform, Radius::Adiabatic, Radius::Field];

    /// Extinctions, two variables of a profile, and deviations.
    const X: [f64; 8] = [3.0, 7.0, 11.0, 1.5, -2.0, 0.5, -1.0, 2.0];

    #[test]
    fn unknowns_and_variables_are_inverse() {
        for (kind, radius) in ALL
            .into_iter()
            .flat_map(|radius| [Variable::Linear, Variable::Logarithmic].map(|kind| (kind, radius)))
        {
            let variables = variables(kind, radius);
            let x = match radius {
                Radius::Uniform => &X[..4],
                Radius::Adiabatic => &X[..5],
                Radius::Given => &X[..3],
                Radius::Field => &X,
            };
            assert_eq!(variables.len(), x.len());
            assert_eq!(variables.bounds().upper.len(), x.len());
            for (found, expected) in variables.of(&variables.unknowns(x).unwrap()).iter().zip(x) {
                assert!((found - expected).abs() < 1e-5, "{found} {expected}");
            }
            let fields = variables.fields(x).unwrap();
            let total: f32 = fields.extinction.values.sum();
            let expected: f64 =
                variables.values(x).iter().zip([0.5, 1.0, 0.25]).map(|(c, s)| c * s).sum();
            assert!((f64::from(total) / expected - 1.0).abs() < 1e-6);
            assert_eq!(fields.effective_radius.is_none(), radius == Radius::Given);
        }
    }

    /// Compares with central differences of a weighted sum of the fields and of the values.
    #[test]
    fn derivatives_are_those_of_differences() {
        let weights = ndarray::array![[[2.0, 9.0, -3.0]], [[5.0, 9.0, 9.0]]];
        let slopes = ndarray::array![[[1.0, 7.0, 2.0]], [[-4.0, 7.0, 7.0]]];
        for (kind, radius) in ALL
            .into_iter()
            .flat_map(|radius| [Variable::Linear, Variable::Logarithmic].map(|kind| (kind, radius)))
        {
            let variables = variables(kind, radius);
            let x = &X[..variables.len()];
            let sum = |x: &[f64]| -> f64 {
                let fields = variables.fields(x).unwrap();
                let inside = |of: &Array3<f32>, weights: &Array3<f32>| -> f64 {
                    let pairs = variables.voxels.iter().map(|v| (of[*v], weights[*v]));
                    pairs.map(|(value, weight)| f64::from(value) * f64::from(weight)).sum()
                };
                let radius = fields.effective_radius.map_or(0.0, |r| inside(&r.values, &slopes));
                let values: f64 = variables.values(x).iter().sum();
                inside(&fields.extinction.values, &weights) + radius + 0.7 * values
            };
            let model = Derivatives {
                extinction: Volume::new(variables.grid, weights.clone()).unwrap(),
                effective_radius: Volume::new(variables.grid, slopes.clone()).unwrap(),
            };
            let found = variables.pull_back(x, &model, &vec![0.7; x.len()]);
            for i in 0..x.len() {
                let (mut above, mut below) = (x.to_vec(), x.to_vec());
                above[i] += 0.02;
                below[i] -= 0.02;
                let expected = (sum(&above) - sum(&below)) / 0.04;
                let error = (found[i] - expected).abs();
                assert!(error < 1e-3 * expected.abs().max(1.0), "{i}: {} {expected}", found[i]);
            }
        }
    }
}
