//! The prior: the extinction is smooth, and a network may have estimated its own uncertainty.

use super::optimiser::dot;
use crate::grid::Grid;
use crate::rng::Stream;
use ndarray::Array3;
use rand_distr::{Distribution, StandardNormal};

/// Half the sum over all voxels and axes of `(d extinction / d axis / typical)^2`, the negative
/// logarithm of a Gaussian Markov random field. It includes only pairs of neighbours that are both
/// variables, so that the edge of the mask has no cost. If standard errors are given, half the sum
/// of `(extinction / standard error)^2` is added.
#[derive(Debug, Clone)]
pub(super) struct Prior {
    pairs: Vec<(usize, usize, f64)>,
    /// The inverse variance of each variable; empty if the variances are not known.
    precisions: Vec<f64>,
    /// Random errors of the expected differences and values, if the prior was disturbed: their product
    /// with the Hessian, and their cost at 0.
    errors: Option<(Vec<f64>, f64)>,
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
        Self { pairs, precisions: Vec::new(), errors: None }
    }

    /// Returns the prior with a standard error (1/km) of each variable.
    pub(super) fn with_errors(self, errors: &[f64]) -> Self {
        Self { precisions: errors.iter().map(|error| error.powi(-2)).collect(), ..self }
    }

    /// The prior of independent variables with standard errors around 0.
    pub(super) fn independent(errors: &[f64]) -> Self {
        Self { pairs: Vec::new(), precisions: Vec::new(), errors: None }.with_errors(errors)
    }

    /// Returns the prior of `count` variables, followed by those of another prior.
    pub(super) fn followed_by(mut self, count: usize, other: Self) -> Self {
        self.precisions.resize(count, 0.0);
        self.precisions.extend(other.precisions);
        let pairs = other.pairs.into_iter();
        self.pairs.extend(pairs.map(|(a, b, weight)| (a + count, b + count, weight)));
        self
    }

    /// Replaces the expected differences and values, which are 0, by random ones with their standard
    /// errors. The minimum of the prior then has the distribution of the prior.
    pub(super) fn disturb(&mut self, random: &mut Stream) {
        let mut normal = || -> f64 { StandardNormal.sample(random) };
        let last = self.pairs.iter().map(|&(first, second, _)| first.max(second) + 1).max();
        let (mut product, mut cost) =
            (vec![0.0; last.unwrap_or(0).max(self.precisions.len())], 0.0);
        for &(first, second, weight) in &self.pairs {
            let error = normal();
            product[first] += weight.sqrt() * error;
            product[second] -= weight.sqrt() * error;
            cost += 0.5 * error * error;
        }
        for (product, precision) in product.iter_mut().zip(&self.precisions) {
            let error = normal();
            *product += precision.sqrt() * error;
            cost += 0.5 * error * error;
        }
        self.errors = Some((product, cost));
    }

    pub(super) fn value(&self, extinction: &[f64]) -> f64 {
        let terms = self.pairs.iter().map(|&(first, second, weight)| {
            let difference = extinction[first] - extinction[second];
            weight * difference * difference
        });
        let squares = self.precisions.iter().zip(extinction).map(|(p, value)| p * value * value);
        let value = 0.5 * (terms.sum::<f64>() + squares.sum::<f64>());
        match &self.errors {
            Some((errors, cost)) => value - dot(errors, extinction) + cost,
            None => value,
        }
    }

    pub(super) fn gradient(&self, extinction: &[f64]) -> Vec<f64> {
        let mut gradient = self.times(extinction);
        if let Some((errors, _)) = &self.errors {
            gradient.iter_mut().zip(errors).for_each(|(gradient, error)| *gradient -= error);
        }
        gradient
    }

    /// The product of the Hessian with a vector.
    pub(super) fn times(&self, vector: &[f64]) -> Vec<f64> {
        let mut product = vec![0.0; vector.len()];
        for ((product, precision), value) in product.iter_mut().zip(&self.precisions).zip(vector) {
            *product = precision * value;
        }
        for &(first, second, weight) in &self.pairs {
            let push = weight * (vector[first] - vector[second]);
            product[first] += push;
            product[second] -= push;
        }
        product
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
    use crate::inversion::conjugate_gradient;
    use crate::math::DVec3;
    use crate::rng::{Purpose, stream};

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

    /// A random walk of three voxels whose first one is known: variances of 1, 1 + 4 and 1 + 4 + 4, and
    /// the covariance of the first two is 1.
    #[test]
    fn the_minimum_of_a_disturbed_prior_has_its_distribution() {
        let grid = Grid::new(DVec3::ZERO, DVec3::splat(0.5), [1, 1, 3]).unwrap();
        let shares = ndarray::array![[[1.0, 1.0, 1.0]]];
        let mut prior = Prior::new(&grid, &shares, 1, 4.0);
        prior.precisions = vec![1.0, 0.0, 0.0];
        let mut random = stream(1, Purpose::Validation, &[]);
        let (mut sums, count) = ([0.0; 4], 4000);
        for _ in 0..count {
            prior.disturb(&mut random);
            let right = prior.gradient(&[0.0; 3]).into_iter().map(|g| -g).collect();
            let x = conjugate_gradient::solve(|v| prior.times(v), &prior.diagonal(3), right);
            assert!(prior.gradient(&x).iter().all(|slope| slope.abs() < 0.02));
            assert!(prior.value(&x) >= -1e-3 && prior.value(&x) < prior.value(&[9.0, 0.0, 0.0]));
            let products = [x[0] * x[0], x[1] * x[1], x[2] * x[2], x[0] * x[1]];
            sums.iter_mut().zip(products).for_each(|(sum, product)| *sum += product);
        }
        for (sum, expected) in sums.into_iter().zip([1.0, 5.0, 9.0, 1.0]) {
            let (found, error) = (sum / count as f64, 9.0 * (2.0 / count as f64).sqrt());
            assert!((found - expected).abs() < 4.0 * error, "{found} {expected}");
        }
    }
}
