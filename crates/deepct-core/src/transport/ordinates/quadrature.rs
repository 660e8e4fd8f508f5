//! Directions and the functions on them: discrete ordinates and spherical harmonics.

use crate::math::DVec3;
use std::f64::consts::PI;

/// Ordinates of an octant are filled up to a multiple of this with ones of no weight, so
/// that every vector of a processor is full.
pub(super) const LANES: usize = 8;

/// The discrete ordinates: Gauss-Legendre in the cosine of the zenith angle times equal
/// steps in azimuth, and the spherical harmonics of all degrees that they integrate
/// exactly in products of two.
#[derive(Debug)]
pub(super) struct Quadrature {
    /// Number of harmonics: the square of the number of zenith angles.
    pub(super) harmonics: usize,
    /// The ordinates by octant; those of octant `7 - o` are opposite to those of `o`.
    pub(super) octants: Vec<Octant>,
}

/// The ordinates of an octant, each `[f32; ordinates]` of a table side by side.
#[derive(Debug)]
pub(super) struct Octant {
    /// The sign of the directions along x, y, z.
    pub(super) signs: [f32; 3],
    /// Number of ordinates, those without weight among them.
    pub(super) ordinates: usize,
    /// Components of the directions along x, y, z without their signs.
    pub(super) cosines: [Vec<f32>; 3],
    /// The weight of each ordinate (sr).
    pub(super) weights: Vec<f32>,
    /// Harmonics at the ordinates, `[harmonic][ordinate]`: from moments to radiances.
    pub(super) to_ordinates: Vec<f32>,
    /// Weight times harmonics, `[ordinate][harmonic]`: from radiances to moments.
    pub(super) to_moments: Vec<f32>,
}

impl Quadrature {
    /// The ordinates of a multiple of 4 zenith angles, so that harmonics fill whole vectors
    /// too, and twice as many azimuths.
    pub(super) fn new(zenith_angles: usize) -> Self {
        let harmonics = zenith_angles * zenith_angles;
        let octants = (0..8).map(|number| Octant::new(number, zenith_angles)).collect();
        Self { harmonics, octants }
    }
}

impl Octant {
    fn new(number: usize, zenith_angles: usize) -> Self {
        let signs = [0, 1, 2].map(|axis| if number >> axis & 1 == 0 { 1.0_f32 } else { -1.0 });
        let azimuths = 2 * zenith_angles;
        let mut directions = Vec::new();
        for (cosine, weight) in gauss_legendre(zenith_angles) {
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
        let harmonics = zenith_angles * zenith_angles;
        let mut octant = Self {
            signs,
            ordinates,
            cosines: [0, 1, 2].map(|axis| directions.iter().map(|(d, _)| d[axis] as f32).collect()),
            weights: directions.iter().map(|(_, weight)| *weight as f32).collect(),
            to_ordinates: vec![0.0; harmonics * ordinates],
            to_moments: vec![0.0; ordinates * harmonics],
        };
        let signs = DVec3::from_array(signs.map(f64::from));
        for (ordinate, (direction, weight)) in directions.iter().enumerate().take(real) {
            let values = spherical_harmonics(signs * *direction, zenith_angles);
            for (harmonic, value) in values.iter().enumerate() {
                octant.to_ordinates[harmonic * ordinates + ordinate] = *value as f32;
                octant.to_moments[ordinate * harmonics + harmonic] = (weight * value) as f32;
            }
        }
        octant
    }
}

/// The positive nodes and the weights of the Gauss-Legendre rule of an even number of
/// points on [-1, 1], by Newton's method (Press et al. 2007, section 4.6).
pub(super) fn gauss_legendre(points: usize) -> Vec<(f64, f64)> {
    let n = points as f64;
    (0..points / 2)
        .map(|number| {
            let mut x = (PI * (number as f64 + 0.75) / (n + 0.5)).cos();
            let mut derivative = 1.0;
            for _ in 0..20 {
                let (mut before, mut now) = (1.0, x);
                for degree in 2..=points {
                    let l = degree as f64;
                    (before, now) = (now, ((2.0 * l - 1.0) * x * now - (l - 1.0) * before) / l);
                }
                derivative = n * (x * now - before) / (x * x - 1.0);
                x -= now / derivative;
            }
            (x, 2.0 / ((1.0 - x * x) * derivative * derivative))
        })
        .collect()
}

/// The degree of each harmonic, in the order of [`spherical_harmonics`].
pub(super) fn degrees(harmonics: usize) -> impl Iterator<Item = usize> {
    (0..harmonics).map(|harmonic| harmonic.isqrt())
}

/// The real spherical harmonics of the degrees below `count` at a unit vector: `l` by `l`,
/// in each from `m = -l` to `l`, normalised so that the square of each integrates to 1.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::towards;

    /// Products of two harmonics integrate to 1 or 0, and opposite octants are opposite.
    #[test]
    fn ordinates_integrate_products_of_harmonics() {
        for zenith_angles in [4, 8, 12] {
            let Quadrature { harmonics, octants } = Quadrature::new(zenith_angles);
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
                    let expected = f64::from(a == b);
                    let found = products[a * harmonics + b];
                    assert!((found - expected).abs() < 2e-6, "{zenith_angles}: {a} {b} {found}");
                }
            }
            let opposite = octants[7].signs.map(|sign| -sign);
            assert_eq!(octants[0].signs, opposite);
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
