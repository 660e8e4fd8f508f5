//! One light path, from the camera backwards to the Sun.

use super::field::{Field, Heading};
use crate::error::Result;
use crate::math::{DVec3, Ray};
use crate::optics::{Medium, PhaseFunction};
use crate::rng::{RngExt, Stream};
use crate::scene::Scene;
use std::f64::consts::PI;

/// Paths of less throughput than this live on by chance.
const ROULETTE: f64 = 0.3;
/// Sunlight that adds less than this (1/sr) at one scattering is added by chance.
const FAINT: f64 = 0.01;
/// Share of the new directions that are drawn around the Sun where it is not hidden.
const TOWARDS_SUN: f64 = 0.2;

/// Everything that a path needs to know of the scene.
#[derive(Debug)]
pub(super) struct Tracer {
    field: Field,
    sun: Heading,
    /// The surface in the field's coordinates, its albedo over pi.
    ground: f64,
    reflectance: f64,
    /// How light scatters at first, and after `similarity_after` scatterings.
    full: Scattering,
    similar: Scattering,
    similarity_after: u32,
}

/// What happens in a collision.
#[derive(Debug)]
struct Scattering {
    /// Extinction over that of the medium.
    extinction: f64,
    single_scattering_albedo: f64,
    phase_function: PhaseFunction,
}

impl Scattering {
    fn of(medium: &Medium) -> Self {
        Self {
            extinction: 1.0,
            single_scattering_albedo: medium.single_scattering_albedo,
            phase_function: medium.phase_function.clone(),
        }
    }

    /// Scattering in a similar medium (van de Hulst 1980, section 14.1): the share
    /// `g^2` of the light, which is in the forward peak, is not scattered at all; the
    /// rest follows a Henyey-Greenstein function of asymmetry `g / (1 + g)`, which
    /// keeps the first two moments (Joseph, Wiscombe and Weinman 1976).
    fn without_peak(&self) -> Result<Self> {
        let asymmetry = self.phase_function.asymmetry().max(0.0);
        let peak = asymmetry * asymmetry;
        let extinction = 1.0 - self.single_scattering_albedo * peak;
        let phase_function = if peak > 0.0 {
            PhaseFunction::henyey_greenstein(asymmetry / (1.0 + asymmetry))?
        } else {
            self.phase_function.clone()
        };
        let single_scattering_albedo = self.single_scattering_albedo * (1.0 - peak) / extinction;
        Ok(Self { extinction, single_scattering_albedo, phase_function })
    }
}

impl Tracer {
    /// Make a scene ready.
    pub(super) fn new(scene: &Scene, similarity_after: Option<u32>) -> Result<Self> {
        let field = Field::new(&scene.medium, scene.boundary);
        let full = Scattering::of(&scene.medium);
        Ok(Self {
            sun: field.heading(scene.sun.towards()),
            ground: field.local(DVec3::new(0.0, 0.0, scene.surface.altitude)).z,
            reflectance: scene.surface.albedo / PI,
            similar: full.without_peak()?,
            full,
            similarity_after: similarity_after.unwrap_or(u32::MAX),
            field,
        })
    }

    #[inline]
    fn scattering(&self, scatterings: u32) -> &Scattering {
        if scatterings < self.similarity_after { &self.full } else { &self.similar }
    }

    /// One sample of the radiance (1/sr, per unit irradiance) that comes along a ray.
    ///
    /// The first collision is forced, and the surface is seen through what is before
    /// it: neither is left to chance.
    pub(super) fn radiance(&self, ray: &Ray, rng: &mut Stream) -> f64 {
        let origin = self.field.local(ray.origin);
        let heading = self.field.heading(ray.direction);
        let extinction = self.scattering(0).extinction;
        let depth = extinction * self.field.optical_depth(origin, &heading, f64::INFINITY);
        let scattered = -(-depth).exp_m1();
        let mut radiance = 0.0;
        if depth > 0.0 {
            let reach = -(-rng.random::<f64>() * scattered).ln_1p() / extinction;
            if let Some(distance) = self.field.free_path(origin, &heading, reach) {
                let at = origin + distance * heading.local;
                radiance += self.collide(at, ray.direction, scattered, rng);
            }
        }
        if let Some(at) = self.footprint(origin, &heading) {
            let throughput = 1.0 - scattered;
            radiance += self.reflect(at, throughput, rng);
        }
        radiance
    }

    /// Light that comes to a collision at `at` and goes on against `direction`.
    fn collide(
        &self,
        mut at: DVec3,
        mut direction: DVec3,
        mut throughput: f64,
        rng: &mut Stream,
    ) -> f64 {
        let mut radiance = 0.0;
        let mut scatterings = 0;
        loop {
            // Scatter: light of the Sun, then of all other directions.
            let scattering = self.scattering(scatterings);
            let phase = &scattering.phase_function;
            throughput *= scattering.single_scattering_albedo;
            let weight = throughput * phase.density(direction.dot(self.sun.direction));
            // All that comes to this collision comes through the medium of the next one,
            // sunlight too: what the similar medium does not scatter is in it.
            let extinction = self.scattering(scatterings + 1).extinction;
            let sunlight = self.sunlight(at, weight, extinction, rng);
            radiance += sunlight;
            if !survives(&mut throughput, rng) {
                return radiance;
            }
            let visible = (sunlight / weight).min(1.0);
            direction = self.redirect(direction, visible, phase, &mut throughput, rng);
            scatterings += 1;

            // Fly to the next collision, or out.
            let heading = self.field.heading(direction);
            let depth = -(1.0 - rng.random::<f64>()).ln() / extinction;
            match self.field.free_path(at, &heading, depth) {
                Some(distance) => at += distance * heading.local,
                None => {
                    return match self.footprint(at, &heading) {
                        Some(at) => radiance + self.reflect(at, throughput, rng),
                        None => radiance,
                    };
                }
            }
        }
    }

    /// A new direction after scattering. Where the Sun is visible, some are drawn
    /// around it: the next scattering may send much sunlight down the path, which
    /// makes spikes if it is left to chance (Buras and Mayer 2011). The throughput
    /// makes up for it.
    #[inline]
    fn redirect(
        &self,
        direction: DVec3,
        visible: f64,
        phase: &PhaseFunction,
        throughput: &mut f64,
        rng: &mut Stream,
    ) -> DVec3 {
        let cosine = phase.sample(rng.random());
        let share = TOWARDS_SUN * visible;
        if share == 0.0 || *phase == PhaseFunction::Isotropic {
            return turn(direction, cosine, rng);
        }
        let around = if rng.random::<f64>() < share { self.sun.direction } else { direction };
        let turned = turn(around, cosine, rng);
        let wanted = phase.density(turned.dot(direction));
        let towards_sun = phase.density(turned.dot(self.sun.direction));
        *throughput *= wanted / (wanted + share * (towards_sun - wanted));
        turned
    }

    /// Light that the surface reflects at `at`: sunlight, then all other light.
    fn reflect(&self, at: DVec3, mut throughput: f64, rng: &mut Stream) -> f64 {
        let sun = self.reflectance * self.sun.direction.z;
        let radiance = self.sunlight(at, throughput * sun, 1.0, rng);
        throughput *= PI * self.reflectance;
        if !survives(&mut throughput, rng) {
            return radiance;
        }
        let direction = turn(DVec3::Z, rng.random::<f64>().sqrt(), rng);
        let heading = self.field.heading(direction);
        let depth = -(1.0 - rng.random::<f64>()).ln();
        match self.field.free_path(at, &heading, depth) {
            Some(distance) => {
                let at = at + distance * heading.local;
                radiance + self.collide(at, direction, throughput, rng)
            }
            None => radiance,
        }
    }

    /// `weight` times the transmittance from a point to the Sun. A faint contribution
    /// is rounded up to [`FAINT`] or down to nothing by chance, so that a walk towards
    /// the Sun ends where too little is left.
    #[inline]
    fn sunlight(&self, at: DVec3, weight: f64, extinction: f64, rng: &mut Stream) -> f64 {
        let least = FAINT * (1.0 - rng.random::<f64>());
        if weight < least {
            return 0.0;
        }
        let limit = (weight / least).ln() / extinction;
        let depth = self.field.optical_depth(at, &self.sun, limit);
        if depth > limit {
            return 0.0;
        }
        (weight * (-depth * extinction).exp()).max(FAINT)
    }

    /// Where a ray that left the medium meets the surface; `None` for a black surface
    /// and for rays that go up.
    #[inline]
    fn footprint(&self, at: DVec3, heading: &Heading) -> Option<DVec3> {
        (self.reflectance > 0.0 && heading.local.z < 0.0).then(|| {
            let foot = at + (self.ground - at.z) / heading.local.z * heading.local;
            DVec3::new(foot.x, foot.y, self.ground)
        })
    }
}

/// Russian roulette: whether a path lives on. One that does carries the throughput of
/// those that do not.
#[inline]
pub(super) fn survives(throughput: &mut f64, rng: &mut Stream) -> bool {
    if *throughput >= ROULETTE {
        return true;
    }
    let lives = rng.random::<f64>() * ROULETTE < *throughput;
    *throughput = ROULETTE;
    lives
}

/// A unit vector at an angle of the given cosine to `axis`, at a random azimuth: a
/// point in the unit disc gives the azimuth without trigonometry (von Neumann 1951),
/// the frame is that of Duff et al. (2017).
#[inline]
pub(super) fn turn(axis: DVec3, cosine: f64, rng: &mut Stream) -> DVec3 {
    let (u, v, square) = loop {
        let u = 2.0 * rng.random::<f64>() - 1.0;
        let v = 2.0 * rng.random::<f64>() - 1.0;
        let square = u * u + v * v;
        if square <= 1.0 && square > 0.0 {
            break (u, v, square);
        }
    };
    let sine = (1.0 - cosine * cosine).max(0.0).sqrt() / square;
    let (along, across) = (sine * (u * u - v * v), sine * 2.0 * u * v);
    let sign = 1.0_f64.copysign(axis.z);
    let a = -1.0 / (sign + axis.z);
    let b = axis.x * axis.y * a;
    let tangent = DVec3::new(1.0 + sign * axis.x * axis.x * a, sign * b, -sign * axis.x);
    let bitangent = DVec3::new(b, sign + axis.y * axis.y * a, -axis.y);
    (along * tangent + across * bitangent + cosine * axis).normalize()
}
