//! Conjugate gradients for symmetric positive definite systems.

use super::optimiser::dot;

/// Relative residual at which the iteration stops, in the norm of the inverse diagonal.
const ENOUGH: f64 = 1e-3;
/// Maximum number of products with the matrix.
const MOST: usize = 200;

/// Approximate solution of `matrix * x = right`, preconditioned with the diagonal of the matrix
/// (Hestenes and Stiefel 1952).
pub(super) fn solve(
    product: impl Fn(&[f64]) -> Vec<f64>,
    diagonal: &[f64],
    right: Vec<f64>,
) -> Vec<f64> {
    let divided = |vector: &[f64]| -> Vec<f64> {
        vector.iter().zip(diagonal).map(|(value, diagonal)| value / diagonal).collect()
    };
    let mut x = vec![0.0; right.len()];
    let mut residual = right;
    let mut direction = divided(&residual);
    let mut size = dot(&residual, &direction);
    let enough = ENOUGH * ENOUGH * size;
    for _ in 0..MOST {
        if size <= enough {
            break;
        }
        let image = product(&direction);
        let length = size / dot(&direction, &image);
        for i in 0..x.len() {
            x[i] += length * direction[i];
            residual[i] -= length * image[i];
        }
        let next = divided(&residual);
        let before = std::mem::replace(&mut size, dot(&residual, &next));
        direction.iter_mut().zip(next).for_each(|(d, next)| *d = next + size / before * *d);
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `[[4, 1, 0], [1, 3, -1], [0, -1, 2]] x = [6, 4, 4]`, solved by elimination: `x = [1, 2, 3]`.
    #[test]
    fn three_equations_by_hand() {
        let product =
            |x: &[f64]| vec![4.0 * x[0] + x[1], x[0] + 3.0 * x[1] - x[2], -x[1] + 2.0 * x[2]];
        let x = solve(product, &[4.0, 3.0, 2.0], vec![6.0, 4.0, 4.0]);
        for (found, expected) in x.iter().zip([1.0, 2.0, 3.0]) {
            assert!((found - expected).abs() < 1e-9, "{x:?}");
        }
        assert_eq!(solve(product, &[4.0, 3.0, 2.0], vec![0.0; 3]), [0.0; 3]);
    }
}
