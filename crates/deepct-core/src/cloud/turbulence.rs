//! Random fields with the spectrum of turbulence.

use crate::grid::Grid;
use crate::rng::{Purpose, stream};
use ndarray::{Array3, Axis};
use rand_distr::{Distribution, StandardNormal};
use rustfft::FftPlanner;
use rustfft::num_complex::Complex;

/// The number of the random stream of the Fourier coefficients. The streams of the clouds are
/// numbered from zero.
const COEFFICIENTS: u64 = u64::MAX;

/// A Gaussian random field `[z, y, x]` of zero mean and unit variance on the voxels of `grid`,
/// periodic along every axis. The spectral power falls as `|k|^(-11/3)`, so that a
/// one-dimensional section has the energy spectrum `k^(-5/3)` of the inertial range
/// (Kolmogorov 1941). The power levels off at wavelengths above `outer_scale` (km). At the
/// wavelength `damped` (km) the power is reduced to 1/e and at shorter wavelengths further,
/// because a simulation likewise damps waves that its grid barely resolves.
///
/// The field is generated in Fourier space: each coefficient is an independent complex normal
/// number times the square root of its power, and the field is the real part of the inverse
/// transform.
pub(super) fn turbulence(grid: &Grid, outer_scale: f64, damped: f64, seed: u64) -> Array3<f32> {
    let [nz, ny, nx] = grid.shape;
    let frequency = |index: usize, count: usize, step: f64| {
        let signed = if 2 * index <= count { index as f64 } else { index as f64 - count as f64 };
        signed / (count as f64 * step)
    };
    let mut waves = Array3::from_elem((nz, ny, nx), Complex::new(0.0_f64, 0.0));
    for (k, mut level) in waves.axis_iter_mut(Axis(0)).enumerate() {
        let mut rng = stream(seed, Purpose::Cloud, &[COEFFICIENTS, k as u64]);
        for ((j, i), wave) in level.indexed_iter_mut() {
            let squared = frequency(k, nz, grid.spacing.z).powi(2)
                + frequency(j, ny, grid.spacing.y).powi(2)
                + frequency(i, nx, grid.spacing.x).powi(2);
            let power = (squared + outer_scale.powi(-2)).powf(-11.0 / 6.0)
                * (-squared * damped * damped).exp();
            let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
            *wave = Complex::new(normal(), normal()) * power.sqrt();
        }
    }
    waves[[0, 0, 0]] = Complex::new(0.0, 0.0);
    for axis in 0..3 {
        let plan = FftPlanner::new().plan_fft_inverse(waves.shape()[axis]);
        let mut scratch = vec![Complex::default(); plan.get_inplace_scratch_len()];
        let mut buffer = vec![Complex::default(); waves.shape()[axis]];
        for mut lane in waves.lanes_mut(Axis(axis)) {
            buffer.iter_mut().zip(&lane).for_each(|(to, from)| *to = *from);
            plan.process_with_scratch(&mut buffer, &mut scratch);
            lane.iter_mut().zip(&buffer).for_each(|(to, from)| *to = *from);
        }
    }
    let variance = waves.iter().map(|wave| wave.re * wave.re).sum::<f64>() / waves.len() as f64;
    let scale = if variance > 0.0 { variance.sqrt().recip() } else { 0.0 };
    waves.mapv(|wave| (wave.re * scale) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::DVec3;

    /// The spectral power of a row at a wave number, by the definition of the Fourier sum.
    fn power(row: &[f32], number: usize) -> f64 {
        let (mut re, mut im) = (0.0, 0.0);
        for (index, value) in row.iter().enumerate() {
            let angle = std::f64::consts::TAU * (number * index) as f64 / row.len() as f64;
            re += f64::from(*value) * angle.cos();
            im += f64::from(*value) * angle.sin();
        }
        re * re + im * im
    }

    /// Sections along each axis have a slope of -5/3 apart from the effect of the truncated
    /// spectrum. The reference -1.709 is the slope of the sum of `|k|^(-11/3)` over the waves
    /// that this grid resolves, fitted over the same wave numbers and computed with numpy.
    #[test]
    fn a_section_has_the_spectrum_of_the_inertial_range() {
        let grid = Grid::new(DVec3::ZERO, DVec3::splat(0.02), [96, 96, 96]).unwrap();
        let fields: Vec<_> = (0..3).map(|seed| turbulence(&grid, 20.0, 0.0, seed)).collect();
        for axis in 0..3 {
            let mut points = Vec::new();
            for number in 2..=12_usize {
                let lanes = fields.iter().flat_map(|field| field.lanes(Axis(axis)));
                let sum: f64 = lanes.step_by(7).map(|lane| power(&lane.to_vec(), number)).sum();
                points.push(((number as f64).ln(), sum.ln()));
            }
            let count = points.len() as f64;
            let mean = |f: &dyn Fn(&(f64, f64)) -> f64| points.iter().map(f).sum::<f64>() / count;
            let (x, y) = (mean(&|p| p.0), mean(&|p| p.1));
            let slope = mean(&|p| (p.0 - x) * (p.1 - y)) / mean(&|p| (p.0 - x).powi(2));
            assert!((slope + 1.709).abs() < 0.1, "slope {slope} along axis {axis}");
        }
    }

    #[test]
    fn mean_and_variance_are_those_of_the_standard_normal() {
        let grid = Grid::new(DVec3::ZERO, DVec3::new(0.05, 0.05, 0.04), [31, 30, 29]).unwrap();
        let field = turbulence(&grid, 1.0, 0.2, 8);
        let mean = field.iter().map(|v| f64::from(*v)).sum::<f64>() / field.len() as f64;
        let square = field.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>() / field.len() as f64;
        assert!(mean.abs() < 1e-5 && (square - 1.0).abs() < 1e-5, "{mean} {square}");
    }
}
