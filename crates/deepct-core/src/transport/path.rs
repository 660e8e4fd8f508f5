//! One light path, from the camera backwards to the Sun.

use super::field::{Field, Heading};
use crate::error::Result;
use crate::math::{DVec3, Ray};
use crate::optics::{Collision, DropletOptics, DropletTable, PhaseFunction, Scattering};
use crate::rng::{RngExt, Stream};
use crate::scene::Scene;
use std::f64::consts::PI;
use std::sync::Arc;

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
    /// Extinction of the similar medium over that of the medium.
    thinner: f64,
    similarity_after: u32,
}

/// The similar medium (van de Hulst 1980, section 14.1): extinction over that of the
/// medium, and its scattering. A share of the light, which is in the forward peak, is
/// not scattered at all; the rest follows a Henyey-Greenstein function that keeps the
/// mean cosine. The share is `g^2`, which keeps the second moment too (Joseph, Wiscombe
/// and Weinman 1976), with the smallest `g` of the medium: one factor scales the
/// extinction everywhere.
fn without_peak(scattering: &Scattering) -> Result<(f64, Scattering)> {
    match scattering {
        Scattering::Uniform { single_scattering_albedo, phase_function } => {
            let (albedo, asymmetry) = (*single_scattering_albedo, phase_function.asymmetry());
            let extinction = 1.0 - albedo * asymmetry.max(0.0).powi(2);
            let (albedo, phase) = similar(albedo, phase_function, extinction)?;
            Ok((extinction, Scattering::uniform(albedo, phase)?))
        }
        Scattering::Droplets { effective_radius, table } => {
            let removed = |node: &DropletOptics| {
                node.single_scattering_albedo * node.phase_function.asymmetry().max(0.0).powi(2)
            };
            let extinction = 1.0 - table.nodes().iter().map(removed).fold(f64::INFINITY, f64::min);
            let nodes = table.nodes().iter().map(|node| {
                let (single_scattering_albedo, phase_function) =
                    similar(node.single_scattering_albedo, &node.phase_function, extinction)?;
                let extinction_per_water = extinction * node.extinction_per_water;
                Ok(DropletOptics {
                    extinction_per_water,
                    single_scattering_albedo,
                    phase_function,
                    ..*node
                })
            });
            let table = Arc::new(DropletTable::new(nodes.collect::<Result<_>>()?)?);
            let effective_radius = effective_radius.clone();
            Ok((extinction, Scattering::Droplets { effective_radius, table }))
        }
    }
}

/// Albedo and phase function where the share `1 - extinction` of all collisions is
/// left out because it scatters straight on.
fn similar(albedo: f64, phase: &PhaseFunction, extinction: f64) -> Result<(f64, PhaseFunction)> {
    let left_out = 1.0 - extinction;
    if left_out == 0.0 {
        return Ok((albedo, phase.clone()));
    }
    let scattered = albedo - left_out;
    let asymmetry = (albedo * phase.asymmetry() - left_out) / scattered;
    Ok((scattered / extinction, PhaseFunction::henyey_greenstein(asymmetry)?))
}

impl Tracer {
    /// Make a scene ready.
    pub(super) fn new(scene: &Scene, similarity_after: Option<u32>) -> Result<Self> {
        let field = Field::new(&scene.medium, scene.boundary);
        let full = scene.medium.scattering.clone();
        let (thinner, similar) = without_peak(&full)?;
        Ok(Self {
            sun: field.heading(scene.sun.towards()),
            ground: field.local(DVec3::new(0.0, 0.0, scene.surface.altitude)).z,
            reflectance: scene.surface.albedo / PI,
            full,
            similar,
            thinner,
            similarity_after: similarity_after.unwrap_or(u32::MAX),
            field,
        })
    }

    /// What a collision at a point does after a number of scatterings.
    #[inline]
    fn collision(&self, at: DVec3, scatterings: u32) -> Collision<'_> {
        let full = scatterings < self.similarity_after;
        let scattering = if full { &self.full } else { &self.similar };
        match scattering {
            Scattering::Uniform { .. } => scattering.at([0; 3]),
            Scattering::Droplets { .. } => scattering.at(self.field.voxel(at)),
        }
    }

    /// Extinction over that of the medium, after a number of scatterings.
    #[inline]
    fn extinction(&self, scatterings: u32) -> f64 {
        if scatterings < self.similarity_after { 1.0 } else { self.thinner }
    }

    /// One sample of the radiance (1/sr, per unit irradiance) that comes along a ray.
    ///
    /// The first collision is forced, and the surface is seen through what is before
    /// it: neither is left to chance.
    pub(super) fn radiance(&self, ray: &Ray, rng: &mut Stream) -> f64 {
        let origin = self.field.local(ray.origin);
        let heading = self.field.heading(ray.direction);
        let extinction = self.extinction(0);
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
            let collision = self.collision(at, scatterings);
            throughput *= collision.single_scattering_albedo;
            let weight = throughput * collision.density(direction.dot(self.sun.direction));
            // All that comes to this collision comes through the medium of the next one,
            // sunlight too: what the similar medium does not scatter is in it.
            let extinction = self.extinction(scatterings + 1);
            let sunlight = self.sunlight(at, weight, extinction, rng);
            radiance += sunlight;
            if !survives(&mut throughput, rng) {
                return radiance;
            }
            let visible = (sunlight / weight).min(1.0);
            direction = self.redirect(direction, visible, &collision, &mut throughput, rng);
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
        collision: &Collision<'_>,
        throughput: &mut f64,
        rng: &mut Stream,
    ) -> DVec3 {
        let cosine = collision.sample(rng.random());
        let share = TOWARDS_SUN * visible;
        if share == 0.0 || *collision.phase_functions[0] == PhaseFunction::Isotropic {
            return turn(direction, cosine, rng);
        }
        let around = if rng.random::<f64>() < share { self.sun.direction } else { direction };
        let turned = turn(around, cosine, rng);
        let wanted = collision.density(turned.dot(direction));
        let towards_sun = collision.density(turned.dot(self.sun.direction));
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
