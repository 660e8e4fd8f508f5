//! The prior: the extinction is smooth, and a network may have estimated its own uncertainty.

use crate::grid::Grid;
use ndarray::Array3;

/// Half the sum over all voxels and axes of `(d extinction / d axis / typical)^2`, the negative
/// logarithm of a Gaussian Markov random field. It includes only pairs of neighbours that are both
/// variables, so that the edge of the mask has no cost. If standard errors are given, half the sum
/// of `(extinction / standard error)^2` is added.
#[derive(Debug, Clone)]
pub(super) struct Prior {
    pairs: Vec<(usize, usize, f64)>,
    /// The inverse variance of each variable; empty if the variances are not known.
    precisions: Vec<f64>,
}

impl Prior {
    /// Creates the prior of the variables with a positive share, numbered in the order of the
    /// array. A voxel of the grid represents `block`^3 voxels of the full-resolution grid.
    /// `typical` is a gradient (1/km over 1 km); 0 makes all fields equally likely.
    pub(super) fn new(grid: &Grid, shares: &Array3<f64>, block: usize, typical: f64) -> Self {
        let mut pairs = Vec::new();
        if typical > 0.0 {
            let mut number = Array3::from_elem(grid.shape, None);
            let mut count = 0;
            for (number, share) in number.iter_mut().zip(shares) {
                if *share > 0.0 {
                    *number = Some(count);
                    count += 1;
                }
            }
            let cells = (block * block * block) as f64;
            for ((k, j, i), first) in number.indexed_iter() {
                let Some(first) = *first else { continue };
                let neighbours = [[k + 1, j, i], [k, j + 1, i], [k, j, i + 1]];
                for (voxel, spacing) in
                    neighbours.into_iter().zip([grid.spacing.z, grid.spacing.y, grid.spacing.x])
                {
                    if let Some(Some(second)) = number.get(voxel) {
                        pairs.push((first, *second, cells / (spacing * typical).powi(2)));
                    }
                }
            }
        }
        Self { pairs, precisions: Vec::new() }
    }

    /// Returns the prior with a standard error (1/km) of each variable.
    pub(super) fn with_errors(self, errors: &[f64]) -> Self {
        Self { precisions: errors.iter().map(|error| error.powi(-2)).collect(), ..self }
    }

    /// The prior of independent variables with standard errors around 0.
    pub(super) fn independent(errors: &[f64]) -> Self {
        Self { pairs: Vec::new(), precisions: Vec::new() }.with_errors(errors)
    }

    /// Returns the prior of `count` variables, followed by those of another prior.
    pub(super) fn followed_by(mut self, count: usize, other: Self) -> Self {
        self.precisions.resize(count, 0.0);
        self.precisions.extend(other.precisions);
        let pairs = other.pairs.into_iter();
        self.pairs.extend(pairs.map(|(a, b, weight)| (a + count, b + count, weight)));
        self
    }

    pub(super) fn value(&self, extinction: &[f64]) -> f64 {
        let terms = self.pairs.iter().map(|&(first, second, weight)| {
            let difference = extinction[first] - extinction[second];
            weight * difference * difference
        });
        let squares = self.precisions.iter().zip(extinction).map(|(p, value)| p * value * value);
        0.5 * (terms.sum::<f64>() + squares.sum::<f64>())
    }

    pub(super) fn gradient(&self, extinction: &[f64]) -> Vec<f64> {
        let mut gradient = vec![0.0; extinction.len()];
        for ((gradient, precision), value) in
            gradient.iter_mut().zip(&self.precisions).zip(extinction)
        {
            *gradient = precision * value;
        }
        for &(first, second, weight) in &self.pairs {
            let push = weight * (extinction[first] - extinction[second]);
            gradient[first] += push;
            gradient[second] -= push;
        }
        gradient
    }

    /// The diagonal of the Hessian.
    pub(super) fn diagonal(&self, count: usize) -> Vec<f64> {
        let mut diagonal = self.precisions.clone();
        diagonal.resize(count, 0.0);
        for &(first, second, weight) in &self.pairs {
            diagonal[first] += weight;
            diagonal[second] += weight;
        }
        diagonal
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::DVec3;

    /// Three voxels in a row along x, 0.5 km apart, have extinctions of 1, 4 and 2 /km: gradients
    /// of 6 and -4 over a typical one of 2 give (9 + 4) / 2.
    #[test]
    fn three_voxels_by_hand() {
        let grid = Grid::new(DVec3::ZERO, DVec3::splat(0.5), [1, 1, 4]).unwrap();
        let shares = ndarray::array![[[1.0, 0.5, 1.0, 0.0]]];
        let prior = Prior::new(&grid, &shares, 1, 2.0);
        let extinction = [1.0, 4.0, 2.0];
        assert!((prior.value(&extinction) - 6.5).abs() < 1e-12);
        assert_eq!(prior.gradient(&extinction), [-3.0, 5.0, -2.0]);
        assert_eq!(prior.diagonal(3), [1.0, 2.0, 1.0]);
        let coarse = Prior::new(&grid, &shares, 2, 2.0);
        assert!((coarse.value(&extinction) - 8.0 * 6.5).abs() < 1e-12);
        let alone = Prior::new(&grid, &shares, 1, 0.0);
        assert_eq!(alone.value(&extinction), 0.0);

        // Standard errors of 1, 2 and 4 add (1 + 4 + 1 / 4) / 2.
        let known = prior.with_errors(&[1.0, 2.0, 4.0]);
        assert!((known.value(&extinction) - 6.5 - 2.625).abs() < 1e-12);
        assert_eq!(known.gradient(&extinction), [-2.0, 6.0, -1.875]);
        assert_eq!(known.diagonal(3), [2.0, 2.25, 1.0625]);

        // Two more variables, of which the first is independent, and the second has no prior.
        let more = Prior::new(&grid, &shares, 1, 2.0).followed_by(3, Prior::independent(&[0.5]));
        assert!((more.value(&[1.0, 4.0, 2.0, 3.0, 7.0]) - 6.5 - 18.0).abs() < 1e-12);
        assert_eq!(more.diagonal(5), [1.0, 2.0, 1.0, 4.0, 0.0]);
        let after = Prior::independent(&[0.5]).followed_by(1, Prior::new(&grid, &shares, 1, 2.0));
        assert_eq!(after.gradient(&[3.0, 1.0, 4.0, 2.0]), [12.0, -3.0, 5.0, -2.0]);
    }
}
