//! Discrete ordinates, and spherical harmonics on them.

use crate::math::DVec3;
use std::f64::consts::PI;

/// The ordinates of an octant are padded with ordinates of zero weight to a multiple of this
/// number, so that every vector of a processor is full.
pub(super) const LANES: usize = 8;

/// Discrete ordinates: [`zenith_rule`] in the cosine of the zenith angle times equal steps in
/// azimuth. The spherical harmonics include all degrees for which the ordinates integrate products
/// of two harmonics exactly.
#[derive(Debug)]
pub(super) struct Quadrature {
    /// Number of degrees of the harmonics.
    pub(super) degrees: usize,
    /// Number of harmonics: the square of the number of degrees, padded with zeros to whole
    /// vectors.
    pub(super) harmonics: usize,
    /// Ordinates by octant; those of octant `7 - o` are opposite to those of `o`.
    pub(super) octants: Vec<Octant>,
}

/// Ordinates of an octant; the `[f32; ordinates]` of each table are contiguous.
#[derive(Debug)]
pub(super) struct Octant {
    /// Sign of the directions along x, y, z.
    pub(super) signs: [f32; 3],
    /// Number of ordinates, including those of zero weight.
    pub(super) ordinates: usize,
    /// Components of the directions along x, y, z without their signs.
    pub(super) cosines: [Vec<f32>; 3],
    /// Weight of each ordinate (sr).
    pub(super) weights: Vec<f32>,
    /// Range of the vertical components, without their sign, that each ordinate represents.
    pub(super) bins: Vec<[f64; 2]>,
    /// Harmonics at the ordinates, `[harmonic][ordinate]`: from moments to radiances.
    pub(super) to_ordinates: Vec<f32>,
    /// Weight times harmonics, `[ordinate][harmonic]`: from radiances to moments.
    pub(super) to_moments: Vec<f32>,
}

impl Quadrature {
    /// Ordinates for an even number of zenith angles and twice as many azimuths.
    pub(super) fn new(zenith_angles: usize) -> Self {
        let degrees = degrees_of(zenith_angles);
        let harmonics = (degrees * degrees).next_multiple_of(LANES);
        let octants = (0..8).map(|number| Octant::new(number, zenith_angles)).collect();
        Self { degrees, harmonics, octants }
    }
}

impl Octant {
    fn new(number: usize, zenith_angles: usize) -> Self {
        let signs = [0, 1, 2].map(|axis| if number >> axis & 1 == 0 { 1.0_f32 } else { -1.0 });
        let azimuths = 2 * zenith_angles;
        let (mut directions, mut bins) = (Vec::new(), Vec::new());
        let mut top = 1.0;
        for (cosine, weight) in zenith_rule(zenith_angles) {
            bins.extend(vec![[f64::max(top - weight, 0.0), top]; azimuths / 4]);
            top -= weight;
            for step in 0..azimuths / 4 {
                let azimuth = 2.0 * PI * (step as f64 + 0.5) / azimuths as f64;
                let sine = (1.0 - cosine * cosine).sqrt();
                let direction = DVec3::new(sine * azimuth.cos(), sine * azimuth.sin(), cosine);
                directions.push((direction, weight * 2.0 * PI / azimuths as f64));
            }
        }
        let real = directions.len();
        let ordinates = real.next_multiple_of(LANES);
        directions.resize(ordinates, (DVec3::splat(3.0_f64.sqrt().recip()), 0.0));
        bins.resize(ordinates, [0.5; 2]);
        let degrees = degrees_of(zenith_angles);
        let harmonics = (degrees * degrees).next_multiple_of(LANES);
        let mut octant = Self {
            bins,
            signs,
            ordinates,
            cosines: [0, 1, 2].map(|axis| directions.iter().map(|(d, _)| d[axis] as f32).collect()),
            weights: directions.iter().map(|(_, weight)| *weight as f32).collect(),
            to_ordinates: vec![0.0; harmonics * ordinates],
            to_moments: vec![0.0; ordinates * harmonics],
        };
        let signs = DVec3::from_array(signs.map(f64::from));
        for (ordinate, (direction, weight)) in directions.iter().enumerate().take(real) {
            let values = spherical_harmonics(signs * *direction, degrees);
            for (harmonic, value) in values.iter().enumerate() {
                octant.to_ordinates[harmonic * ordinates + ordinate] = *value as f32;
                octant.to_moments[ordinate * harmonics + harmonic] = (weight * value) as f32;
            }
        }
        octant
    }
}

/// Number of degrees of the harmonics that the given number of zenith angles resolves.
pub(super) fn degrees_of(zenith_angles: usize) -> usize {
    zenith_angles - 1
}

/// Positive nodes and weights of a symmetric rule on [-1, 1] with an even number of points. It is
/// exact for polynomials up to degree `2 points - 4`, and for the flux of a hemisphere, the
/// integral of `x` from 0 to 1.
///
/// The Gauss-Legendre rule is exact for two degrees more, but has an error of 1.2 % in the flux for
/// 8 points. Because energy is conserved in the radiance at the ordinates, all radiance that leaves
/// a cloud would be too low by this amount.
///
/// In `x^2` it is a rule of half as many points with one degree of freedom left: the nodes are the
/// roots of `P_n + shift P_(n-2)` for any shift (Davis and Rabinowitz 1984, section 2.7, on
/// quasi-orthogonal polynomials).
fn zenith_rule(points: usize) -> Vec<(f64, f64)> {
    let mut rule = gauss_legendre(points);
    let flux = |rule: &[(f64, f64)]| rule.iter().map(|(x, weight)| x * weight).sum::<f64>();
    // The flux decreases as the shift grows, and is too small where the last node reaches zero, at
    // a shift of (n - 1) / n.
    let (mut shift, mut step) = (0.0, 0.125 * degrees_of(points) as f64 / points as f64);
    while step > 1e-16 {
        let next = shifted_rule(points, shift + step, Some(&rule));
        let ordered = next.is_sorted_by(|a, b| a.0 > b.0 && b.0 > 0.0);
        if ordered && flux(&next) >= 0.5 {
            (rule, shift) = (next, shift + step);
        } else {
            step *= 0.5;
        }
    }
    rule
}

/// Positive nodes and weights of the Gauss-Legendre rule with an even number of points on [-1, 1].
pub(super) fn gauss_legendre(points: usize) -> Vec<(f64, f64)> {
    shifted_rule(points, 0.0, None)
}

/// Rule on the roots of `P_n + shift P_(n-2)` by Newton's method, starting from the nodes of
/// another rule (Press et al. 2007, section 4.6).
fn shifted_rule(points: usize, shift: f64, near: Option<&[(f64, f64)]>) -> Vec<(f64, f64)> {
    let n = points as f64;
    let guess = |number: usize| match near {
        Some(rule) => rule[number].0,
        None => (PI * (number as f64 + 0.75) / (n + 0.5)).cos(),
    };
    let node = |number: usize| {
        let mut x = guess(number);
        let (mut slope, mut lower) = (1.0, 1.0);
        for _ in 0..20 {
            let [(value, derivative), (low, low_derivative)] = legendre(points, x);
            slope = derivative + shift * low_derivative;
            lower = low;
            x -= (value + shift * low) / slope;
        }
        (x, 2.0 * x * (2.0 * n - 1.0) / (n * (n - 1.0) * slope * lower))
    };
    (0..points / 2).map(node).collect()
}

/// Legendre polynomials of `degree` and of `degree - 2`, with their derivatives.
fn legendre(degree: usize, x: f64) -> [(f64, f64); 2] {
    let mut values = vec![1.0, x];
    let mut derivatives = vec![0.0, 1.0];
    for n in 1..degree {
        let l = n as f64;
        values.push(((2.0 * l + 1.0) * x * values[n] - l * values[n - 1]) / (l + 1.0));
        derivatives.push((2.0 * l + 1.0) * values[n] + derivatives[n - 1]);
    }
    [degree, degree - 2].map(|n| (values[n], derivatives[n]))
}

/// Degree of each harmonic, in the order of [`spherical_harmonics`].
pub(super) fn degrees(harmonics: usize) -> impl Iterator<Item = usize> {
    (0..harmonics).map(|harmonic| harmonic.isqrt())
}

/// Real spherical harmonics of the degrees below `count` at a unit vector, ordered by `l` and then
/// from `m = -l` to `l`, normalised so that the square of each integrates to 1.
pub(super) fn spherical_harmonics(direction: DVec3, count: usize) -> Vec<f64> {
    let mut values = vec![0.0; count * count];
    let cosine = direction.z;
    // sin(theta)^m cos(m phi) and sin(theta)^m sin(m phi), as polynomials of x and y.
    let (mut real, mut imaginary) = (1.0, 0.0);
    let mut diagonal = (0.25 / PI).sqrt();
    for m in 0..count {
        let (mut before, mut now) = (0.0, diagonal);
        for l in m..count {
            let center = l * l + l;
            if m == 0 {
                values[center] = now;
            } else {
                values[center + m] = 2.0_f64.sqrt() * now * real;
                values[center - m] = 2.0_f64.sqrt() * now * imaginary;
            }
            let (l, m) = ((l + 1) as f64, m as f64);
            let scale = ((4.0 * l * l - 1.0) / (l * l - m * m)).sqrt();
            let last = (((l - 1.0).powi(2) - m * m) / (4.0 * (l - 1.0).powi(2) - 1.0)).max(0.0);
            (before, now) = (now, scale * (cosine * now - last.sqrt() * before));
        }
        let m = m as f64;
        diagonal *= ((2.0 * m + 3.0) / (2.0 * m + 2.0)).sqrt();
        (real, imaginary) = (
            real * direction.x - imaginary * direction.y,
            real * direction.y + imaginary * direction.x,
        );
    }
    values
}

/// The first `harmonics` spherical harmonics in a direction; this number includes the padding.
pub(super) fn first_harmonics(direction: DVec3, harmonics: usize) -> Vec<f32> {
    let degrees = harmonics.saturating_sub(1).isqrt() + 1;
    let values = spherical_harmonics(direction, degrees);
    values.into_iter().take(harmonics).map(|value| value as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::towards;

    /// Products of two harmonics integrate to 1 or 0, and the signs of opposite octants are
    /// opposite.
    #[test]
    fn ordinates_integrate_products_of_harmonics() {
        for zenith_angles in [4, 8, 12] {
            let Quadrature { degrees, harmonics, octants } = Quadrature::new(zenith_angles);
            let mut products = vec![0.0_f64; harmonics * harmonics];
            for octant in &octants {
                for n in 0..octant.ordinates {
                    for a in 0..harmonics {
                        let weighted = f64::from(octant.to_moments[n * harmonics + a]);
                        for b in 0..harmonics {
                            products[a * harmonics + b] +=
                                weighted * f64::from(octant.to_ordinates[b * octant.ordinates + n]);
                        }
                    }
                }
            }
            for a in 0..harmonics {
                for b in 0..harmonics {
                    let expected = f64::from(a == b && a < degrees * degrees);
                    let found = products[a * harmonics + b];
                    assert!((found - expected).abs() < 2e-6, "{zenith_angles}: {a} {b} {found}");
                }
            }
            let opposite = octants[7].signs.map(|sign| -sign);
            assert_eq!(octants[0].signs, opposite);
        }
    }

    /// The rule integrates polynomials of even degree, and the flux through a plane, exactly.
    #[test]
    fn zenith_angles_integrate_polynomials_and_the_flux() {
        for points in (4..=32).step_by(4) {
            let rule = zenith_rule(points);
            let integral =
                |power: i32| rule.iter().map(|(x, weight)| weight * x.powi(power)).sum::<f64>();
            assert!((integral(1) - 0.5).abs() < 1e-13, "{points}: {}", integral(1));
            for degree in (0..=2 * points - 4).step_by(2) {
                let expected = 1.0 / (degree + 1) as f64;
                let found = integral(degree as i32);
                assert!((found - expected).abs() < 1e-13, "{points} {degree}: {found}");
            }
            assert!(rule.iter().all(|(x, weight)| *x > 0.0 && *x < 1.0 && *weight > 0.0));
        }
    }

    /// The addition theorem: the sum of products over m is (2 l + 1) / (4 pi) P_l.
    #[test]
    fn harmonics_obey_the_addition_theorem() {
        let (one, other) = (towards(0.7, 2.0), towards(2.2, 0.3));
        let [a, b] = [one, other].map(|direction| spherical_harmonics(direction, 6));
        let x: f64 = one.dot(other);
        let polynomials = [1.0, x, 1.5 * x * x - 0.5, 2.5 * x.powi(3) - 1.5 * x];
        for (l, polynomial) in polynomials.iter().enumerate() {
            let range = l * l..(l + 1) * (l + 1);
            let found: f64 = range.map(|harmonic| a[harmonic] * b[harmonic]).sum();
            let expected = (2 * l + 1) as f64 / (4.0 * PI) * polynomial;
            assert!((found - expected).abs() < 1e-12, "{l}: {found} {expected}");
        }
    }
}
