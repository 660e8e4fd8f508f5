//! Scattering by a homogeneous sphere (Mie 1908), after Bohren and Huffman (1983),
//! "Absorption and Scattering of Light by Small Particles", chapter 4, with the number of
//! terms of Wiscombe (1980), "Improved Mie scattering algorithms".
//!
//! The calculation is implemented here instead of taken from a library because the code for one
//! sphere is short, and a table over droplet sizes is fast when all spheres share one grid of
//! angles.

use crate::math::with_vectors;
use num_complex::Complex64;
use pulp::{Simd, WithSimd};

/// The expansion coefficients of the wave scattered by a sphere.
#[derive(Debug, Clone, PartialEq)]
pub struct Sphere {
    size_parameter: f64,
    /// `a_n` and `b_n` from n = 1.
    coefficients: Vec<[Complex64; 2]>,
}

/// Efficiencies (cross-sections over the geometric cross-section) and asymmetry parameter of a
/// sphere.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Efficiencies {
    /// Extinction efficiency.
    pub extinction: f64,
    /// Scattering efficiency.
    pub scattering: f64,
    /// Asymmetry parameter, the mean cosine of the scattering angle.
    pub asymmetry: f64,
}

impl Sphere {
    /// The sphere with a positive size parameter (circumference over wavelength) and a refractive
    /// index `n + i k` relative to the surrounding medium.
    pub fn new(size_parameter: f64, refractive_index: Complex64) -> Self {
        let x = size_parameter;
        let terms = terms(x);
        let z = refractive_index * x;
        // The logarithmic derivative of psi_n(m x) by downward recurrence, because the upward
        // recurrence is unstable. The effect of the starting value zero vanishes if the recurrence
        // starts a few cube roots of |m x| above |m x|.
        let start = terms.max((z.norm() + 8.0 * z.norm().cbrt()) as usize) + 16;
        let mut derivative = vec![Complex64::ZERO; start + 1];
        for n in (1..=start).rev() {
            let ratio = n as f64 / z;
            derivative[n - 1] = ratio - (derivative[n] + ratio).inv();
        }
        // The Riccati-Bessel functions psi and chi of x by upward recurrence.
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

    /// The efficiencies and the asymmetry parameter: Bohren and Huffman (1983), equations 4.61 and
    /// 4.62 and the equation of section 4.5.
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

    /// The intensity `(|S1|^2 + |S2|^2) / 2` of scattered unpolarised light at the given cosines
    /// of the scattering angle and at the opposite cosines (Bohren and Huffman 1983, equations
    /// 4.74 and 4.77). Divided by `pi x^2 Q_sca` it is the phase function.
    pub fn intensities(&self, cosines: &[f64]) -> [Vec<f64>; 2] {
        let coefficients = self.coefficients.iter().enumerate();
        let terms: Vec<_> =
            coefficients.map(|(number, pair)| Term::new((number + 1) as f64, *pair)).collect();
        with_vectors(Series { terms: &terms, cosines })
    }
}

/// Spheres of [`LANES`] similar size parameters.
pub(super) struct SimilarSpheres {
    /// Extinction and scattering efficiency of each sphere.
    pub(super) efficiencies: [[f64; 2]; LANES],
    /// The series of every second sphere.
    series: [Vec<Term>; SAMPLES],
}

impl SimilarSpheres {
    /// The spheres with these size parameters. They must be similar, because all series have the length
    /// required by the largest one and the terms of much smaller spheres cannot be computed to that
    /// order.
    pub(super) fn new(size_parameters: [f64; LANES], refractive_index: Complex64) -> Self {
        with_vectors(Batch { size_parameters, refractive_index })
    }

    /// The intensities of the middle one, as [`Sphere::intensities`], but those opposite to the cosines from
    /// number `resolved` on are the mean of every second sphere.
    pub(super) fn intensities(&self, cosines: &[f64], resolved: usize) -> [Vec<f64>; 2] {
        let at =
            |sample: usize, cosines| with_vectors(Series { terms: &self.series[sample], cosines });
        let [found, mut opposite] = at(MIDDLE, cosines);
        for sample in (0..SAMPLES).filter(|sample| *sample != MIDDLE) {
            let [_, values] = at(sample, &cosines[resolved..]);
            opposite[resolved..].iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
        }
        opposite[resolved..].iter_mut().for_each(|sum| *sum /= SAMPLES as f64);
        [found, opposite]
    }
}

/// The number of terms of the series: Wiscombe (1980), equation 9.
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

/// Number of [`SimilarSpheres`].
pub(super) const LANES: usize = 8;
/// Number of those among them whose intensities are computed.
const SAMPLES: usize = LANES / 2;
/// The one among those that is in the middle.
const MIDDLE: usize = SAMPLES / 2;

/// A value for each sphere of a batch.
type Values = [f64; LANES];

/// The calculation of [`SimilarSpheres`]. It is that of [`Sphere::new`] with inner loops
/// over the spheres, which the compiler vectorises. The recurrences of a single sphere are long
/// chains of divisions in which each depends on the previous one.
struct Batch {
    size_parameters: Values,
    refractive_index: Complex64,
}

impl WithSimd for Batch {
    type Output = SimilarSpheres;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Self::Output {
        let x = self.size_parameters;
        let m = self.refractive_index;
        let largest = x.iter().fold(0.0_f64, |most, x| most.max(*x));
        let terms = terms(largest);
        let size = m.norm() * largest;
        let start = terms.max((size + 8.0 * size.cbrt()) as usize) + 16;
        // n / z = n w with w = 1 / (m x).
        let inverse = m.inv();
        let w: [Values; 2] = [x.map(|x| inverse.re / x), x.map(|x| inverse.im / x)];
        let mut derivatives = vec![[[0.0; LANES]; 2]; terms + 1];
        let mut derivative = [[0.0; LANES]; 2];
        for n in (1..=start).rev() {
            if n <= terms {
                derivatives[n] = derivative;
            }
            let n = n as f64;
            for i in 0..LANES {
                let ratio = [n * w[0][i], n * w[1][i]];
                let sum = [derivative[0][i] + ratio[0], derivative[1][i] + ratio[1]];
                let square = 1.0 / (sum[0] * sum[0] + sum[1] * sum[1]);
                derivative[0][i] = ratio[0] - sum[0] * square;
                derivative[1][i] = ratio[1] + sum[1] * square;
            }
        }
        let (mut psi_before, mut chi_before) = (x.map(f64::sin), x.map(f64::cos));
        let (mut psi, mut chi) = ([0.0; LANES], [0.0; LANES]);
        for i in 0..LANES {
            psi[i] = psi_before[i] / x[i] - chi_before[i];
            chi[i] = chi_before[i] / x[i] + psi_before[i];
        }
        let (mut extinction, mut scattering) = ([0.0; LANES], [0.0; LANES]);
        let mut series: [Vec<Term>; SAMPLES] = std::array::from_fn(|_| Vec::with_capacity(terms));
        for (n, derivative) in derivatives.iter().enumerate().skip(1) {
            let n = n as f64;
            let weight = 2.0 * n + 1.0;
            // Real and imaginary parts of a_n and b_n.
            let mut coefficients = [[[0.0; LANES]; 2]; 2];
            for i in 0..LANES {
                let over = 1.0 / x[i];
                let [re, im] = [derivative[0][i], derivative[1][i]];
                // The logarithmic derivative divided by the index (for a) and times it (for b).
                let electric = [
                    re * inverse.re - im * inverse.im + n * over,
                    re * inverse.im + im * inverse.re,
                ];
                let magnetic = [re * m.re - im * m.im + n * over, re * m.im + im * m.re];
                for (coefficient, [real, imaginary]) in
                    coefficients.iter_mut().zip([electric, magnetic])
                {
                    // (f psi - psi') / (f xi - xi') with xi = psi - i chi.
                    let upper = [real * psi[i] - psi_before[i], imaginary * psi[i]];
                    let other = [real * chi[i] - chi_before[i], imaginary * chi[i]];
                    let lower = [upper[0] + other[1], upper[1] - other[0]];
                    let square = 1.0 / (lower[0] * lower[0] + lower[1] * lower[1]);
                    coefficient[0][i] = (upper[0] * lower[0] + upper[1] * lower[1]) * square;
                    coefficient[1][i] = (upper[1] * lower[0] - upper[0] * lower[1]) * square;
                    extinction[i] += weight * coefficient[0][i];
                    scattering[i] += weight * (upper[0] * upper[0] + upper[1] * upper[1]) * square;
                }
                let next = weight * over;
                (psi_before[i], psi[i]) = (psi[i], next * psi[i] - psi_before[i]);
                (chi_before[i], chi[i]) = (chi[i], next * chi[i] - chi_before[i]);
            }
            for (sample, terms) in series.iter_mut().enumerate() {
                let of_sphere =
                    |[re, im]: [Values; 2]| Complex64::new(re[2 * sample], im[2 * sample]);
                terms.push(Term::new(n, coefficients.map(of_sphere)));
            }
        }
        let efficiencies = std::array::from_fn(|i| {
            let scale = 2.0 / (x[i] * x[i]);
            [scale * extinction[i], scale * scattering[i]]
        });
        SimilarSpheres { efficiencies, series }
    }
}

/// A term of the series of S1 + S2 and S1 - S2. Because the angular functions pi and tau are even
/// or odd, either series at the opposite cosine equals the other one apart from signs.
struct Term {
    /// n, and the factors (2 n + 1) / n and (n + 1) / n of the recurrence of pi.
    n: f64,
    up: f64,
    down: f64,
    /// Factors of pi + tau: real and imaginary part at the cosine and at its opposite.
    plus: [f64; 4],
    /// Factors of pi - tau, in the same order.
    minus: [f64; 4],
}

impl Term {
    /// The term of the coefficients `a_n` and `b_n`.
    fn new(n: f64, [a, b]: [Complex64; 2]) -> Self {
        let weight = (2.0 * n + 1.0) / (n * (n + 1.0));
        let (sum, difference) = (weight * (a + b), weight * (a - b));
        let sign = if n % 2.0 == 1.0 { 1.0 } else { -1.0 };
        Self {
            n,
            up: (2.0 * n + 1.0) / n,
            down: (n + 1.0) / n,
            plus: [sum.re, sum.im, sign * difference.re, sign * difference.im],
            minus: [difference.re, difference.im, sign * sum.re, sign * sum.im],
        }
    }
}

/// The series of [`Sphere::intensities`].
struct Series<'a> {
    terms: &'a [Term],
    cosines: &'a [f64],
}

impl WithSimd for Series<'_> {
    type Output = [Vec<f64>; 2];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let lanes = S::F64_LANES;
        let count = self.cosines.len();
        let mut cosines = self.cosines.to_vec();
        cosines.resize(count.next_multiple_of(lanes), 0.0);
        let mut intensities = [(); 2].map(|()| vec![0.0; cosines.len()]);
        let zero = simd.splat_f64s(0.0);
        let (vectors, _) = S::as_simd_f64s(&cosines);
        let [at, opposite] = &mut intensities;
        let (at, _) = S::as_mut_simd_f64s(at);
        let (opposite, _) = S::as_mut_simd_f64s(opposite);
        for ((cosine, at), opposite) in vectors.iter().zip(at).zip(opposite) {
            let (mut pi, mut pi_before) = (simd.splat_f64s(1.0), zero);
            // The sums of the terms with pi + tau and of those with pi - tau.
            let (mut plus, mut minus) = ([zero; 4], [zero; 4]);
            for term in self.terms {
                // Bohren and Huffman (1983), equation 4.47, with tau divided by n.
                let before = simd.mul_f64s(simd.splat_f64s(term.down), pi_before);
                let tau = simd.mul_add_e_f64s(*cosine, pi, simd.neg_f64s(before));
                let sum = simd.mul_add_e_f64s(simd.splat_f64s(term.n), tau, pi);
                let difference = simd.mul_add_e_f64s(simd.splat_f64s(-term.n), tau, pi);
                let step = simd.mul_f64s(simd.splat_f64s(term.up), *cosine);
                pi_before = pi;
                pi = simd.mul_add_e_f64s(step, pi, simd.neg_f64s(before));
                for part in 0..4 {
                    plus[part] =
                        simd.mul_add_e_f64s(simd.splat_f64s(term.plus[part]), sum, plus[part]);
                    minus[part] = simd.mul_add_e_f64s(
                        simd.splat_f64s(term.minus[part]),
                        difference,
                        minus[part],
                    );
                }
            }
            let intensity = |first: usize| {
                let parts = [plus[first], plus[first + 1], minus[first], minus[first + 1]];
                let square =
                    parts.into_iter().fold(zero, |sum, part| simd.mul_add_e_f64s(part, part, sum));
                simd.mul_f64s(simd.splat_f64s(0.25), square)
            };
            (*at, *opposite) = (intensity(0), intensity(2));
        }
        intensities.map(|mut values| {
            values.truncate(count);
            values
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    fn close(found: f64, expected: f64, tolerance: f64) -> bool {
        (found - expected).abs() <= tolerance * expected.abs()
    }

    /// Q_ext, Q_sca and g to the printed digits: Wiscombe (1979), "Mie scattering calculations",
    /// tables of test cases, and Bohren and Huffman (1983), appendix A (radius 0.525 um at a
    /// wavelength of 0.6328 um, m = 1.55).
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

    /// The reference is `miepython.efficiencies_mx(1.331-2.13e-8j, 93.5)` and `miepython.S1_S2` at
    /// 0, 30, 90, 142 and 180 degrees (miepython 3.3.0, whose amplitudes are normalised such that
    /// their mean square over the sphere is the single-scattering albedo over 4 pi).
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
        for (intensity, s) in sphere.intensities(&cosines)[0].iter().zip(amplitudes) {
            let expected = 0.5 * s.iter().map(|part| part * part).sum::<f64>();
            assert!(close(intensity / area, expected, 1e-6), "{intensity}, not {expected}");
        }
    }

    /// The intensity integrated over all directions is the scattering cross-section, and its mean
    /// cosine is the asymmetry parameter.
    #[test]
    fn intensities_add_up_to_the_scattering_cross_section() {
        let sphere = Sphere::new(25.0, Complex64::new(1.33, 1e-3));
        let count = 100_000;
        let width = PI / f64::from(count);
        let angles: Vec<f64> = (0..count).map(|i| width * (f64::from(i) + 0.5)).collect();
        let cosines: Vec<f64> = angles.iter().map(|angle| angle.cos()).collect();
        let intensities = &sphere.intensities(&cosines)[0];
        let parts = intensities.iter().zip(&angles).map(|(v, t)| 2.0 * PI * width * v * t.sin());
        let total: f64 = parts.clone().sum();
        let forward: f64 = parts.zip(&cosines).map(|(part, cosine)| part * cosine).sum();
        let found = sphere.efficiencies();
        assert!(close(total, PI * 25.0_f64.powi(2) * found.scattering, 1e-7));
        assert!(close(forward / total, found.asymmetry, 1e-7));
        assert!(found.scattering < found.extinction);
    }

    /// Compares a batch with single spheres, and the intensities at opposite cosines with those
    /// computed at these cosines directly.
    #[test]
    fn many_spheres_are_each_one() {
        let index = Complex64::new(1.331, 1e-4);
        for x in [0.02, 0.5, 3.0, 9.9, 40.0, 93.5, 700.0] {
            let sizes = std::array::from_fn(|i| x * (1.0 + 1e-3 * i as f64));
            let found = SimilarSpheres::new(sizes, index).efficiencies;
            for (x, [extinction, scattering]) in sizes.into_iter().zip(found) {
                let expected = Sphere::new(x, index).efficiencies();
                assert!(close(extinction, expected.extinction, 1e-9), "{x}: {extinction}");
                assert!(close(scattering, expected.scattering, 1e-9), "{x}: {scattering}");
            }
        }
        let cosines = [0.0, 0.1, 0.5, 0.77, 0.999, 1.0];
        let [at, opposite] = Sphere::new(93.5, index).intensities(&cosines);
        let [mirrored, _] = Sphere::new(93.5, index).intensities(&cosines.map(|c| -c));
        assert!(at.len() == cosines.len() && close(at[0], opposite[0], 1e-12));
        for (found, expected) in opposite.iter().zip(mirrored) {
            assert!(close(*found, expected, 1e-9), "{found}, not {expected}");
        }
    }
}
