//! Legendre moments of phase functions.

use super::PhaseFunction;
use std::f64::consts::PI;

/// Number of intervals of the cosine for functions without a closed form.
const PIECES: usize = 4000;
/// Number of cosines that are processed together.
const TOGETHER: usize = 16;

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

    /// The moments by two-point Gauss-Legendre quadrature on intervals that are narrowest at the
    /// forward peak.
    fn integrated_moments(&self, count: usize) -> Vec<f64> {
        let mut moments = vec![0.0; count];
        let edge = |piece: usize| (PI * (piece as f64 / PIECES as f64).powi(2)).cos();
        // Several cosines are processed together, because each step of a single recurrence depends
        // on the previous one.
        for first in (0..PIECES).step_by(TOGETHER / 2) {
            let (mut cosines, mut weights) = ([0.0; TOGETHER], [0.0; TOGETHER]);
            for n in 0..TOGETHER {
                let piece = first + n / 2;
                let (above, below) = (edge(piece), edge(piece + 1));
                let (middle, half) = (0.5 * (above + below), 0.5 * (above - below));
                let side = if n % 2 == 0 { -half } else { half };
                cosines[n] = middle + side / 3.0_f64.sqrt();
                weights[n] = 2.0 * PI * half * self.density(cosines[n]);
            }
            let (mut before, mut now) = ([0.0; TOGETHER], [1.0; TOGETHER]);
            for (degree, moment) in moments.iter_mut().enumerate() {
                let degree = degree as f64;
                let (a, b) = ((2.0 * degree + 1.0) / (degree + 1.0), degree / (degree + 1.0));
                let mut sum = 0.0;
                for n in 0..TOGETHER {
                    sum += weights[n] * now[n];
                    let next = a * cosines[n] * now[n] - b * before[n];
                    (before[n], now[n]) = (now[n], next);
                }
                *moment += sum;
            }
        }
        // Normalised, so that quadrature errors do not violate energy conservation.
        let all = moments.first().copied().unwrap_or(1.0);
        moments.iter_mut().for_each(|moment| *moment /= all);
        moments
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The moments of a tabulated Henyey-Greenstein function are the powers of its asymmetry
    /// parameter; the Rayleigh function is `1 + P_2 / 2` for isotropic molecules.
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
