//! Phase functions as series of Legendre polynomials.

use super::PhaseFunction;
use std::f64::consts::PI;

/// Pieces of the range of cosines for functions without a closed form.
const PIECES: usize = 4000;

impl PhaseFunction {
    /// The first `count` Legendre moments: the mean of `P_l(cos)` for `l = 0, 1, ...`, so
    /// that the density is `sum (2 l + 1) / (4 pi) moment_l P_l(cos)`.
    pub fn legendre_moments(&self, count: usize) -> Vec<f64> {
        match self {
            Self::Isotropic => (0..count).map(|l| if l == 0 { 1.0 } else { 0.0 }).collect(),
            Self::HenyeyGreenstein { asymmetry } => {
                (0..count).map(|l| asymmetry.powi(l as i32)).collect()
            }
            Self::Rayleigh { .. } | Self::Tabulated(_) => self.integrated_moments(count),
        }
    }

    /// The moments by Gauss-Legendre quadrature with two points on pieces that lie closest
    /// at the forward peak.
    fn integrated_moments(&self, count: usize) -> Vec<f64> {
        let mut moments = vec![0.0; count];
        let edge = |piece: usize| (PI * (piece as f64 / PIECES as f64).powi(2)).cos();
        for piece in 0..PIECES {
            let (middle, half) =
                (0.5 * (edge(piece) + edge(piece + 1)), 0.5 * (edge(piece) - edge(piece + 1)));
            for cosine in [middle - half / 3.0_f64.sqrt(), middle + half / 3.0_f64.sqrt()] {
                let weight = 2.0 * PI * half * self.density(cosine);
                for (moment, polynomial) in moments.iter_mut().zip(legendre(cosine)) {
                    *moment += weight * polynomial;
                }
            }
        }
        // The rounding of the quadrature must not make or lose light.
        let all = moments.first().copied().unwrap_or(1.0);
        moments.iter_mut().for_each(|moment| *moment /= all);
        moments
    }
}

/// The Legendre polynomials of all degrees at one place.
fn legendre(x: f64) -> impl Iterator<Item = f64> {
    let (mut before, mut now, mut degree) = (0.0, 1.0, 0.0);
    std::iter::from_fn(move || {
        let value = now;
        let next = ((2.0 * degree + 1.0) * x * now - degree * before) / (degree + 1.0);
        (before, now, degree) = (now, next, degree + 1.0);
        Some(value)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Those of a table of Henyey and Greenstein's function are the powers of its
    /// asymmetry; Rayleigh's function is `1 + P_2 / 2` for round molecules.
    #[test]
    fn moments_are_the_known_ones() {
        let greenstein = PhaseFunction::henyey_greenstein(0.85).unwrap();
        let angles: Vec<f64> = (0..=2000).map(|i| PI * (f64::from(i) / 2000.0).powi(2)).collect();
        let mut cosines: Vec<f64> = angles.iter().rev().map(|angle| angle.cos()).collect();
        (cosines[0], cosines[2000]) = (-1.0, 1.0);
        let values = cosines.iter().map(|c| greenstein.density(*c)).collect();
        let table = PhaseFunction::tabulated(cosines, values).unwrap();
        for (l, (exact, found)) in
            greenstein.legendre_moments(17).iter().zip(table.legendre_moments(17)).enumerate()
        {
            assert!((exact - found).abs() < 2e-5, "{l}: {exact} {found}");
        }
        let rayleigh = PhaseFunction::rayleigh(0.0).unwrap().legendre_moments(4);
        for (found, exact) in rayleigh.iter().zip([1.0, 0.0, 0.1, 0.0]) {
            assert!((found - exact).abs() < 1e-6, "{rayleigh:?}");
        }
        let isotropic = PhaseFunction::Isotropic.legendre_moments(3);
        assert_eq!(isotropic, [1.0, 0.0, 0.0]);
    }
}
