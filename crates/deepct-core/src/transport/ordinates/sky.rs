//! Clear molecular atmosphere above the surface, illuminated by the Sun: single and multiple
//! scattering.
//!
//! Singly scattered light is known in closed form. The second Legendre moment is the last one of
//! molecules, so four numbers at each altitude describe the source of light that is scattered more
//! often or comes from the surface: the mean, and the coefficients of the associated Legendre
//! polynomials of degree 2 and orders 0, 1 and 2. The polynomials of orders 1 and 2 are multiplied
//! by the cosine of the azimuth from the Sun and of twice this azimuth, respectively. The source is
//! computed by successive orders of scattering (van de Hulst 1980, "Multiple light scattering",
//! chapter 4).

use super::beam::THREE;
use super::quadrature::gauss_legendre;
use crate::math::{DVec3, Ray};
use crate::scene::Scene;
use crate::transport::air_column::AirColumn;
use std::f64::consts::PI;

/// Number of terms of the source.
const TERMS: usize = 4;
/// Number of levels of the source.
const LEVELS: usize = 33;
/// Number of zenith angles, upwards and downwards together.
const ZENITH_ANGLES: usize = 32;
/// The iteration ends when an order of scattering changes the source by less than this relative
/// amount.
const TOLERANCE: f64 = 1e-5;
/// Maximum number of orders.
const MOST_ORDERS: usize = 200;

/// The molecular atmosphere without a cloud, for a Sun of unit irradiance.
#[derive(Debug)]
pub(super) struct Sky {
    air: AirColumn,
    /// Direction towards the Sun.
    sun: DVec3,
    /// Optical depth of the whole molecular atmosphere.
    depth: f64,
    /// Second Legendre moment of the phase function.
    second: f64,
    /// Source of light that was scattered or reflected before, at equal steps of optical depth from
    /// the top: the mean, and the coefficients of the polynomials of degree 2 by order.
    source: Vec<[f64; TERMS]>,
    /// Irradiance of the surface by the molecular atmosphere.
    pub(super) irradiance: f64,
}

impl Sky {
    /// Molecular atmosphere of a scene, above its surface.
    pub(super) fn new(scene: &Scene) -> Self {
        let air = AirColumn::new(scene.air.as_ref(), scene.surface.altitude);
        let depth = air.optical_depth(scene.surface.altitude, f64::INFINITY, 1.0);
        let second = air.phase_function.legendre_moments(3)[2];
        let source = vec![[0.0; TERMS]; LEVELS];
        let mut sky =
            Self { air, sun: scene.sun.towards(), depth, second, source, irradiance: 0.0 };
        if !sky.is_empty() {
            sky.scatter_on(scene.surface.albedo);
            sky.scatter_on_in_azimuth(1);
            sky.scatter_on_in_azimuth(2);
        }
        sky
    }

    /// Whether there is no molecular atmosphere.
    pub(super) fn is_empty(&self) -> bool {
        self.air.is_empty()
    }

    /// Optical depth of the molecular atmosphere above an altitude (km).
    pub(super) fn above(&self, altitude: f64) -> f64 {
        self.air.optical_depth(altitude, f64::INFINITY, 1.0)
    }

    /// Transmittance of the molecular atmosphere between two points of a ray.
    pub(super) fn transmittance(&self, ray: &Ray, from: f64, to: f64) -> f64 {
        let [from, to] = [from, to].map(|distance| ray.at(distance).z);
        (-self.air.optical_depth(from, to, ray.direction.z).abs()).exp()
    }

    /// Radiance that the molecular atmosphere scatters into a ray, seen from a point with the
    /// optical depth `from` above it; the ray ends where the optical depth above is `to`.
    pub(super) fn light(&self, direction: DVec3, from: f64, to: f64) -> f64 {
        if self.is_empty() || from == to {
            return 0.0;
        }
        let slope = direction.z.abs().max(1e-9);
        // Single scattering: the integral of exp(-u / sun) exp(-|u - from| / slope) / slope.
        let density = self.air.phase_function.density(direction.dot(self.sun));
        let (rate, span) = (1.0 / self.sun.z + (to - from).signum() / slope, to - from);
        let x = -rate * span;
        let mean = if x.abs() < 1e-9 { 1.0 } else { x.exp_m1() / x };
        let once = density / slope * (-from / self.sun.z).exp() * span.abs() * mean;
        // Multiple scattering, by Gauss-Legendre quadrature in the transmittance to the observer.
        let seen = -(-span.abs() / slope).exp_m1();
        let functions = self.functions(direction);
        let more = THREE.map(|(place, weight)| {
            let way = -slope * (-place * seen).ln_1p();
            let source = self.source_at(from + way.copysign(span));
            weight * seen * source.iter().zip(functions).map(|(s, f)| s * f).sum::<f64>()
        });
        once + more.iter().sum::<f64>()
    }

    /// Angular functions of the terms of the source, in a viewing direction.
    fn functions(&self, direction: DVec3) -> [f64; TERMS] {
        let (flat, sun) = (direction.truncate(), self.sun.truncate());
        let lengths = flat.length() * sun.length();
        let cosine = if lengths > 0.0 { (flat.dot(sun) / lengths).clamp(-1.0, 1.0) } else { 1.0 };
        let rise = direction.z;
        let double = 2.0 * cosine * cosine - 1.0;
        let [first, second] = [1, 2].map(|order| associated_polynomial(order, rise));
        [1.0, second_polynomial(rise), first * cosine, second * double]
    }

    /// Source at an optical depth, interpolated linearly between levels.
    fn source_at(&self, depth: f64) -> [f64; TERMS] {
        let place = (depth / self.depth).clamp(0.0, 1.0) * (LEVELS - 1) as f64;
        let level = (place as usize).min(LEVELS - 2);
        let part = place - level as f64;
        let [before, after] = [self.source[level], self.source[level + 1]];
        std::array::from_fn(|m| (1.0 - part) * before[m] + part * after[m])
    }

    /// Iterate scattering and reflection until the source converges.
    fn scatter_on(&mut self, albedo: f64) {
        let step = self.depth / (LEVELS - 1) as f64;
        let angles = half_range();
        let sunlight: Vec<[f64; 2]> = (0..LEVELS)
            .map(|level| {
                let light = (-(level as f64) * step / self.sun.z).exp() / (4.0 * PI);
                [light, light * 5.0 * self.second * second_polynomial(self.sun.z)]
            })
            .collect();
        let direct = self.sun.z * (-self.depth / self.sun.z).exp();
        for _ in 0..MOST_ORDERS {
            let source = |level: usize, cosine: f64| {
                let (a, b) = (self.source[level], sunlight[level]);
                a[0] + b[0] + (a[1] + b[1]) * second_polynomial(cosine)
            };
            // Integrals of the radiance over the cosine, without and with the polynomial.
            let mut moments = vec![[0.0; 2]; LEVELS];
            let mut irradiance = 0.0;
            let mut pass =
                |cosine: f64, weight: f64, start: f64, order: &mut dyn Iterator<Item = usize>| {
                    let Step { transmittance, near, far } = Step::new(step / cosine);
                    let (mut radiance, mut before) = (start, None);
                    for level in order {
                        if let Some(before) = before {
                            radiance = transmittance * radiance
                                + far * source(before, cosine)
                                + near * source(level, cosine);
                        }
                        before = Some(level);
                        moments[level][0] += weight * radiance;
                        moments[level][1] += weight * radiance * second_polynomial(cosine);
                    }
                    radiance
                };
            for (cosine, weight) in &angles {
                let radiance = pass(*cosine, *weight, 0.0, &mut (0..LEVELS));
                irradiance += 2.0 * PI * weight * cosine * radiance;
            }
            let reflected = albedo / PI * (direct + irradiance);
            for (cosine, weight) in &angles {
                pass(*cosine, *weight, reflected, &mut (0..LEVELS).rev());
            }
            let mut change = 0.0_f64;
            for (source, [mean, tilt]) in self.source.iter_mut().zip(moments) {
                let next = 0.5 * mean;
                change = change.max((next - source[0]).abs() / next);
                (source[0], source[1]) = (next, 2.5 * self.second * tilt);
            }
            self.irradiance = irradiance;
            if change < TOLERANCE {
                break;
            }
        }
    }
}

impl Sky {
    /// The same for the part of the radiance that is proportional to the cosine of the azimuth from
    /// the Sun (`order` 1) or of twice this azimuth (`order` 2). The surface does not contribute.
    fn scatter_on_in_azimuth(&mut self, order: usize) {
        let step = self.depth / (LEVELS - 1) as f64;
        let angles = half_range();
        // The addition theorem's factor 2 (2 - m)! / (2 + m)!.
        let factor = 5.0 * self.second * if order == 1 { 1.0 / 3.0 } else { 1.0 / 12.0 };
        let of_sun = factor / (4.0 * PI) * associated_polynomial(order, self.sun.z);
        let sunlight: Vec<f64> =
            (0..LEVELS).map(|level| of_sun * (-(level as f64) * step / self.sun.z).exp()).collect();
        for _ in 0..MOST_ORDERS {
            let mut moments = vec![0.0; LEVELS];
            let mut pass =
                |rise: f64, weight: f64, order_of_levels: &mut dyn Iterator<Item = usize>| {
                    let polynomial = associated_polynomial(order, rise);
                    let Step { transmittance, near, far } = Step::new(step / rise.abs());
                    let (mut radiance, mut before) = (0.0, None);
                    for level in order_of_levels {
                        let source = polynomial * (self.source[level][order + 1] + sunlight[level]);
                        if let Some(before) = before {
                            radiance = transmittance * radiance + far * before + near * source;
                        }
                        before = Some(source);
                        moments[level] += weight * radiance * polynomial;
                    }
                };
            for (cosine, weight) in &angles {
                // Downward light is seen by looking upwards.
                pass(*cosine, *weight, &mut (0..LEVELS));
                pass(-*cosine, *weight, &mut (0..LEVELS).rev());
            }
            let (mut change, mut most) = (0.0_f64, 0.0_f64);
            for (source, moment) in self.source.iter_mut().zip(moments) {
                let next = 0.25 * factor * moment;
                change = change.max((next - source[order + 1]).abs());
                most = most.max(next.abs());
                source[order + 1] = next;
            }
            if change <= TOLERANCE * most {
                break;
            }
        }
    }
}

/// Cosines from 0 to 1 and their weights; the radiance is discontinuous at the horizon.
fn half_range() -> Vec<(f64, f64)> {
    let rule = gauss_legendre(ZENITH_ANGLES / 2);
    let both = |(x, w): (f64, f64)| [-x, x].map(|x| (0.5 + 0.5 * x, 0.5 * w));
    rule.into_iter().flat_map(both).collect()
}

/// Transmittance of a step, and weights of the source at its near and far end, for a source that is
/// linear along the step.
struct Step {
    transmittance: f64,
    near: f64,
    far: f64,
}

impl Step {
    fn new(depth: f64) -> Self {
        let transmittance = (-depth).exp();
        let mean = -(-depth).exp_m1() / depth;
        Self { transmittance, near: 1.0 - mean, far: mean - transmittance }
    }
}

/// The associated Legendre polynomial of degree 2 and order 1 or 2.
fn associated_polynomial(order: usize, cosine: f64) -> f64 {
    let square = (1.0 - cosine * cosine).max(0.0);
    if order == 1 { 3.0 * cosine * square.sqrt() } else { 3.0 * square }
}

fn second_polynomial(cosine: f64) -> f64 {
    1.5 * cosine * cosine - 0.5
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::{Grid, Volume};
    use crate::optics::air::Air;
    use crate::optics::{Medium, PhaseFunction};
    use crate::scene::{Sun, Surface};
    use crate::transport::{MonteCarloSettings, radiances};

    /// Comparison with the Monte Carlo solver, upwards and downwards, also near the horizon, above
    /// a bright surface.
    #[test]
    fn the_sky_is_that_of_random_paths() {
        let grid = Grid::new(DVec3::new(0.0, 0.0, 1.0), DVec3::splat(0.1), [2, 2, 2]).unwrap();
        let phase = PhaseFunction::henyey_greenstein(0.85).unwrap();
        let medium = Medium::new(Volume::constant(grid, 0.0), 1.0, phase).unwrap();
        let sun = Sun::from_degrees(50.0, 45.0).unwrap();
        for (wavelength, albedo) in [(0.672, 0.05), (0.45, 0.3)] {
            let scene = Scene::new(medium.clone(), sun, Surface::lambertian(albedo)).unwrap();
            let scene = scene.with_air(Air::new(wavelength).unwrap());
            let sky = Sky::new(&scene);
            let ground =
                albedo / PI * (sky.irradiance + sky.sun.z * (-sky.depth / sky.sun.z).exp());
            let from = sky.above(0.5);
            for (rise, azimuth) in
                [(0.9, 0.7), (0.4, 3.0), (0.07, 2.0), (-0.07, 1.0), (-0.4, 4.0), (-1.0, 0.0)]
            {
                let flat = f64::sqrt(1.0 - rise * rise);
                let direction =
                    DVec3::new(flat * f64::sin(azimuth), flat * f64::cos(azimuth), rise);
                let ray = Ray { origin: DVec3::new(-3.0, 0.0, 0.5), direction };
                let settings =
                    MonteCarloSettings { samples_per_pixel: 30_000, ..Default::default() };
                let expected = radiances(&scene, &[ray], &settings).unwrap()[0];
                let found = if rise > 0.0 {
                    sky.light(direction, from, 0.0)
                } else {
                    let passed = ((sky.depth - from) / rise).exp();
                    sky.light(direction, from, sky.depth) + ground * passed
                };
                let error = (found - expected.mean).abs();
                assert!(
                    error < 3.5 * expected.standard_error + 3e-3 * expected.mean,
                    "{wavelength} {rise}: {found} {expected:?}"
                );
            }
        }
    }
}
