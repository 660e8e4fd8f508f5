//! Scattering by a homogeneous sphere (Mie 1908), after Bohren and Huffman (1983),
//! "Absorption and Scattering of Light by Small Particles", chapter 4, with the number of
//! terms of Wiscombe (1980), "Improved Mie scattering algorithms".
//!
//! Written here and not taken from a library: one sphere is a page of code, and a table
//! over droplet sizes is fast because all spheres share one grid of angles.

use num_complex::Complex64;

/// The coefficients of a sphere's scattered wave.
#[derive(Debug, Clone, PartialEq)]
pub struct Sphere {
    size_parameter: f64,
    /// `a_n` and `b_n` from n = 1.
    coefficients: Vec<[Complex64; 2]>,
}

/// What a sphere takes out of a beam, over its geometric cross-section.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Efficiencies {
    /// Of extinction.
    pub extinction: f64,
    /// Of scattering.
    pub scattering: f64,
    /// Mean cosine of the scattering angle.
    pub asymmetry: f64,
}

impl Sphere {
    /// The sphere of a size parameter (circumference over wavelength, positive) and a
    /// refractive index `n + i k` relative to what is around it.
    pub fn new(size_parameter: f64, refractive_index: Complex64) -> Self {
        let x = size_parameter;
        let terms = terms(x);
        let z = refractive_index * x;
        // The logarithmic derivative of psi_n(m x), downward: upward is unstable. It
        // starts from zero, which is forgotten a few cube roots of |m x| above |m x|.
        let start = terms.max((z.norm() + 8.0 * z.norm().cbrt()) as usize) + 16;
        let mut derivative = vec![Complex64::ZERO; start + 1];
        for n in (1..=start).rev() {
            let ratio = n as f64 / z;
            derivative[n - 1] = ratio - (derivative[n] + ratio).inv();
        }
        // Riccati-Bessel functions psi and chi of x, upward.
        let (mut psi_before, mut psi) = (x.sin(), x.sin() / x - x.cos());
        let (mut chi_before, mut chi) = (x.cos(), x.cos() / x + x.sin());
        let coefficients = (1..=terms).map(|n| {
            let order = n as f64;
            let [xi_before, xi] =
                [Complex64::new(psi_before, -chi_before), Complex64::new(psi, -chi)];
            let electric = derivative[n] / refractive_index + order / x;
            let magnetic = derivative[n] * refractive_index + order / x;
            let a = (electric * psi - psi_before) / (electric * xi - xi_before);
            let b = (magnetic * psi - psi_before) / (magnetic * xi - xi_before);
            let factor = (2.0 * order + 1.0) / x;
            (psi_before, psi) = (psi, factor * psi - psi_before);
            (chi_before, chi) = (chi, factor * chi - chi_before);
            [a, b]
        });
        Self { size_parameter, coefficients: coefficients.collect() }
    }

    /// Efficiencies and mean cosine: Bohren and Huffman (1983), equations 4.61, 4.62 and
    /// that of section 4.5.
    pub fn efficiencies(&self) -> Efficiencies {
        let (mut extinction, mut scattering, mut forward) = (0.0, 0.0, 0.0);
        for (number, [a, b]) in self.coefficients.iter().enumerate() {
            let n = (number + 1) as f64;
            extinction += (2.0 * n + 1.0) * (a.re + b.re);
            scattering += (2.0 * n + 1.0) * (a.norm_sqr() + b.norm_sqr());
            forward += (2.0 * n + 1.0) / (n * (n + 1.0)) * (a * b.conj()).re;
            if let Some([a_next, b_next]) = self.coefficients.get(number + 1) {
                let product = a * a_next.conj() + b * b_next.conj();
                forward += n * (n + 2.0) / (n + 1.0) * product.re;
            }
        }
        let scale = 2.0 / self.size_parameter.powi(2);
        Efficiencies {
            extinction: scale * extinction,
            scattering: scale * scattering,
            asymmetry: 2.0 * forward / scattering,
        }
    }

    /// The intensity `(|S1|^2 + |S2|^2) / 2` of unpolarised light scattered to angles of
    /// the given cosines (Bohren and Huffman 1983, equations 4.74 and 4.77): over
    /// `pi x^2 Q_sca` it is the phase function.
    pub fn intensities(&self, cosines: &[f64]) -> Vec<f64> {
        // By the sums and differences of a and b, and of the angular functions pi and
        // tau, S1 + S2 and S1 - S2 are one series each.
        let series = self.coefficients.iter().enumerate().map(|(number, [a, b])| {
            let n = (number + 1) as f64;
            let weight = (2.0 * n + 1.0) / (n * (n + 1.0));
            (n, weight * (a + b), weight * (a - b))
        });
        let series: Vec<_> = series.collect();
        let mut intensities = vec![0.0; cosines.len()];
        for (cosines, intensities) in cosines.chunks(BLOCK).zip(intensities.chunks_mut(BLOCK)) {
            let mut block = Block::default();
            block.cosines[..cosines.len()].copy_from_slice(cosines);
            for (n, sum, difference) in &series {
                block.add(*n, *sum, *difference);
            }
            for (intensity, values) in intensities.iter_mut().zip(block.intensities()) {
                *intensity = values;
            }
        }
        intensities
    }
}

/// Number of terms of the series: Wiscombe (1980), equation 9.
fn terms(x: f64) -> usize {
    let terms = if x < 8.0 {
        x + 4.0 * x.cbrt() + 1.0
    } else if x < 4200.0 {
        x + 4.05 * x.cbrt() + 2.0
    } else {
        x + 4.0 * x.cbrt() + 2.0
    };
    terms.ceil() as usize
}

/// Angles that are summed together: their sums stay in the cache.
const BLOCK: usize = 64;

/// The series of [`Sphere::intensities`] at some angles, term by term.
struct Block {
    cosines: [f64; BLOCK],
    /// The angular function pi of this term and the one before.
    pi: [f64; BLOCK],
    pi_before: [f64; BLOCK],
    /// Real and imaginary parts of S1 + S2 and of S1 - S2.
    sum: [[f64; BLOCK]; 2],
    difference: [[f64; BLOCK]; 2],
}

impl Default for Block {
    fn default() -> Self {
        Self {
            cosines: [0.0; BLOCK],
            pi: [1.0; BLOCK],
            pi_before: [0.0; BLOCK],
            sum: [[0.0; BLOCK]; 2],
            difference: [[0.0; BLOCK]; 2],
        }
    }
}

impl Block {
    /// Add term `n` and step the angular functions: Bohren and Huffman (1983),
    /// equation 4.47.
    #[inline]
    fn add(&mut self, n: f64, sum: Complex64, difference: Complex64) {
        let (up, down) = ((2.0 * n + 1.0) / n, (n + 1.0) / n);
        for i in 0..BLOCK {
            let (pi, along) = (self.pi[i], self.cosines[i] * self.pi[i]);
            let tau = n * along - (n + 1.0) * self.pi_before[i];
            self.pi[i] = up * along - down * self.pi_before[i];
            self.pi_before[i] = pi;
            let (plus, minus) = (pi + tau, pi - tau);
            self.sum[0][i] += sum.re * plus;
            self.sum[1][i] += sum.im * plus;
            self.difference[0][i] += difference.re * minus;
            self.difference[1][i] += difference.im * minus;
        }
    }

    fn intensities(&self) -> impl Iterator<Item = f64> + '_ {
        let square =
            |parts: &[[f64; BLOCK]; 2], i: usize| parts[0][i].powi(2) + parts[1][i].powi(2);
        (0..BLOCK).map(move |i| 0.25 * (square(&self.sum, i) + square(&self.difference, i)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    fn close(found: f64, expected: f64, tolerance: f64) -> bool {
        (found - expected).abs() <= tolerance * expected.abs()
    }

    /// Wiscombe (1979), "Mie scattering calculations", tables of test cases, and Bohren
    /// and Huffman (1983), appendix A (0.525 um at 0.6328 um, m = 1.55): Q_ext, Q_sca, g, to
    /// the digits that they print.
    #[test]
    fn efficiencies_are_the_published_ones() {
        let bohren_huffman = 2.0 * PI * 0.525 / 0.6328;
        for (x, real, imaginary, extinction, scattering, asymmetry) in [
            (0.099, 0.75, 0.0, 0.000007, 0.000007, 0.001448),
            (10.0, 1.5, 0.0, 2.881999, 2.881999, 0.742913),
            (100.0, 1.33, 1e-5, 2.101321, 2.096594, 0.868959),
            (1000.0, 1.33, 1e-5, 2.016876, 1.983333, 0.885772),
            (10.0, 1.5, 1.0, 2.417294, 1.346958, 0.834695),
            (bohren_huffman, 1.55, 0.0, 3.10543, 3.10543, 0.63314),
        ] {
            let found = Sphere::new(x, Complex64::new(real, imaginary)).efficiencies();
            let digits = if x == bohren_huffman { 5.1e-6 } else { 1.1e-6 };
            assert!((found.extinction - extinction).abs() < digits, "{x}: {found:?}");
            assert!((found.scattering - scattering).abs() < digits, "{x}: {found:?}");
            assert!((found.asymmetry - asymmetry).abs() < digits, "{x}: {found:?}");
        }
    }

    /// `miepython.efficiencies_mx(1.331-2.13e-8j, 93.5)` and `miepython.S1_S2` at 0, 30,
    /// 90, 142 and 180 degrees, miepython 3.3.0 (its amplitudes are normalised so that
    /// their mean square over the sphere is the albedo over 4 pi).
    #[test]
    fn a_droplet_is_that_of_miepython() {
        let sphere = Sphere::new(93.5, Complex64::new(1.331, 2.13e-8));
        let found = sphere.efficiencies();
        assert!(close(found.extinction, 2.142_897_010_025_501_4, 1e-10), "{found:?}");
        assert!(close(found.scattering, 2.142_889_781_718_427_6, 1e-10), "{found:?}");
        assert!(close(found.asymmetry, 0.875_444_766_914_217_9, 1e-10), "{found:?}");
        let amplitudes = [
            [19.3053346, -1.41213834, 19.30533457, -1.41213834],
            [-4.77856558e-01, 2.5025967e-01, -4.5854557e-01, 2.374702e-01],
            [-9.30461631e-03, -4.108382e-02, -2.979638e-02, 8.97439e-03],
            [-1.14186405e-01, -2.0053674e-01, -3.480932e-02, -3.321664e-02],
            [-1.05487285e-01, 2.4628571e-01, 1.0548729e-01, -2.4628571e-01],
        ];
        let cosines = [0.0, 30.0, 90.0, 142.0, 180.0_f64].map(|angle| angle.to_radians().cos());
        let area = PI * 93.5_f64.powi(2) * found.extinction;
        for (intensity, s) in sphere.intensities(&cosines).into_iter().zip(amplitudes) {
            let expected = 0.5 * s.iter().map(|part| part * part).sum::<f64>();
            assert!(close(intensity / area, expected, 1e-6), "{intensity}, not {expected}");
        }
    }

    /// The optical theorem: extinction is in the forward amplitude, and what is
    /// scattered to all sides is the scattering cross-section.
    #[test]
    fn intensities_add_up_to_the_scattering_cross_section() {
        let sphere = Sphere::new(25.0, Complex64::new(1.33, 1e-3));
        let count = 100_000;
        let width = PI / f64::from(count);
        let angles: Vec<f64> = (0..count).map(|i| width * (f64::from(i) + 0.5)).collect();
        let cosines: Vec<f64> = angles.iter().map(|angle| angle.cos()).collect();
        let intensities = sphere.intensities(&cosines);
        let parts = intensities.iter().zip(&angles).map(|(v, t)| 2.0 * PI * width * v * t.sin());
        let total: f64 = parts.clone().sum();
        let forward: f64 = parts.zip(&cosines).map(|(part, cosine)| part * cosine).sum();
        let found = sphere.efficiencies();
        assert!(close(total, PI * 25.0_f64.powi(2) * found.scattering, 1e-7));
        assert!(close(forward / total, found.asymmetry, 1e-7));
        assert!(found.scattering < found.extinction);
    }
}
