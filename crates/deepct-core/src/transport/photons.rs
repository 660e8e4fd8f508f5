//! Fluxes of the whole medium: photons traced from the Sun to where they leave.

use super::air_column::AirColumn;
use super::check_scene;
use super::field::Field;
use super::path::{ROULETTE, exponential, survives, turn};
use crate::error::{Error, Result};
use crate::math::{DVec3, Ray};
use crate::memory;
use crate::rng::{Purpose, RngExt, Stream, stream};
use crate::scene::{Boundary, Scene};
use crate::traverse::clip;
use rayon::prelude::*;
use std::f64::consts::PI;

/// Settings of [`fluxes`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FluxSettings {
    /// Number of photons, at least 2.
    pub photons: u64,
    /// Seed of all random numbers.
    pub seed: u64,
}

impl Default for FluxSettings {
    fn default() -> Self {
        Self { photons: 1_000_000, seed: 1 }
    }
}

/// A share of the sunlight incident on the top face of the grid, with its standard error.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Share {
    /// Mean over the photons.
    pub mean: f64,
    /// Standard error of the mean.
    pub standard_error: f64,
}

/// Destinations of the sunlight incident on the top face of the grid.
///
/// `reflected`, `transmitted` and `sides` are net fluxes through the faces of the grid: light that
/// the molecular atmosphere or the surface sends back in is subtracted from the light that left.
/// Together with `absorbed` they add up to 1. `absorbed`, `upward` and `downward`, which give the
/// final destination of the light, also add up to 1.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Fluxes {
    /// Light that does not enter through the top face, or leaves upwards through it.
    pub reflected: Share,
    /// Light that leaves downwards through the bottom face, scattered or not.
    pub transmitted: Share,
    /// Light that leaves through the sides.
    pub sides: Share,
    /// Light absorbed by the droplets.
    pub absorbed: Share,
    /// Light that escapes to space, through any face.
    pub upward: Share,
    /// Light absorbed by the surface.
    pub downward: Share,
    /// Light that reaches the surface without having been scattered.
    pub unscattered: Share,
}

/// Number of photons that share one random number stream.
const BATCH: u64 = 4096;
/// Number of shares counted.
const SHARES: usize = 7;
// Indices of the shares, in the order of `Fluxes`; the faces of the grid come first.
const TOP: usize = 0;
const BOTTOM: usize = 1;
const SIDES: usize = 2;
const ABSORBED: usize = 3;
const UPWARD: usize = 4;
const DOWNWARD: usize = 5;
const UNSCATTERED: usize = 6;

/// Trace photons that the Sun sends onto the top face of the grid until they escape to space or are
/// absorbed by the surface or a droplet. Sunlight incident elsewhere is not traced.
///
/// # Errors
/// Fails if there are fewer than two photons, or if a trilinear medium has only one voxel along an
/// axis.
pub fn fluxes(scene: &Scene, settings: FluxSettings) -> Result<Fluxes> {
    check_scene(scene)?;
    if settings.photons < 2 {
        return Err(Error::out_of_range("number of photons", settings.photons, "at least 2"));
    }
    let count = settings.photons.div_ceil(BATCH);
    memory::check("memory for the numbers of photons", count as f64, 96.0)?;
    let world = World::new(scene);
    let batch = |number: u64| {
        let mut rng = stream(settings.seed, Purpose::Transport, &[number, u64::MAX]);
        let mut sums = [[0.0; 2]; SHARES];
        for _ in 0..BATCH.min(settings.photons - number * BATCH) {
            for (sum, value) in sums.iter_mut().zip(world.trace(&mut rng)) {
                sum[0] += value;
                sum[1] += value * value;
            }
        }
        sums
    };
    let batches: Vec<_> = (0..count).into_par_iter().map(batch).collect();
    let count = settings.photons as f64;
    let share = |number: usize| {
        let [sum, squares] =
            [0, 1].map(|power: usize| batches.iter().map(|sums| sums[number][power]).sum::<f64>());
        let mean = sum / count;
        let variance = (squares / count - mean * mean).max(0.0) / (count - 1.0);
        Share { mean, standard_error: variance.sqrt() }
    };
    Ok(Fluxes {
        reflected: share(TOP),
        transmitted: share(BOTTOM),
        sides: share(SIDES),
        absorbed: share(ABSORBED),
        upward: share(UPWARD),
        downward: share(DOWNWARD),
        unscattered: share(UNSCATTERED),
    })
}

/// Scene data required to trace a photon.
struct World<'a> {
    scene: &'a Scene,
    field: Field,
    air: AirColumn,
    /// Corners of the grid, at infinity along x and y where it is periodic.
    lower: DVec3,
    upper: DVec3,
    /// Distance from the start of a photon to the top face (km): photons start above the molecular
    /// atmosphere.
    start: f64,
}

/// State of a photon, in the coordinates of the field.
struct Photon {
    at: DVec3,
    direction: DVec3,
    weight: f64,
    /// Whether it is inside the grid.
    inside: bool,
    scattered: bool,
    shares: [f64; SHARES],
}

impl<'a> World<'a> {
    fn new(scene: &'a Scene) -> Self {
        let grid = &scene.medium.extinction.grid;
        let (mut lower, mut upper) = (grid.lower(), grid.upper());
        if scene.boundary == Boundary::Periodic {
            (lower.x, lower.y) = (f64::NEG_INFINITY, f64::NEG_INFINITY);
            (upper.x, upper.y) = (f64::INFINITY, f64::INFINITY);
        }
        let air = AirColumn::new(scene.air.as_ref(), scene.surface.altitude);
        let above = if air.is_empty() { 0.0 } else { (air.top() - upper.z).max(0.0) };
        let start = above / scene.sun.towards().z + grid.extent().z;
        Self { scene, field: Field::new(&scene.medium, scene.boundary), air, lower, upper, start }
    }

    /// Trace one photon; returns its contribution to each share.
    fn trace(&self, rng: &mut Stream) -> [f64; SHARES] {
        let grid = &self.scene.medium.extinction.grid;
        let top = DVec3::new(rng.random(), rng.random(), 1.0);
        let sun = self.scene.sun.towards();
        let mut photon = Photon {
            at: self.field.local(grid.lower() + grid.extent() * top + self.start * sun),
            direction: -sun,
            weight: 1.0,
            inside: false,
            scattered: false,
            shares: [0.0; SHARES],
        };
        // All light counts as reflected until it enters through the top face.
        photon.shares[TOP] = 1.0;
        while photon.weight > 0.0 {
            self.fly(&mut photon, rng);
        }
        photon.shares
    }

    /// Advance to the next event: a droplet, a molecule, the surface, or space.
    fn fly(&self, photon: &mut Photon, rng: &mut Stream) {
        let heading = self.field.heading(photon.direction);
        let droplet = self.field.free_path(photon.at, &heading, exponential(rng));
        let molecule = if self.air.is_empty() {
            None
        } else {
            let altitude = self.field.point(photon.at).z;
            self.air.free_path(altitude, photon.direction.z, exponential(rng))
        };
        match (droplet, molecule) {
            (Some(droplet), molecule) if molecule.is_none_or(|molecule| droplet <= molecule) => {
                self.advance(photon, droplet, true);
                photon.at += droplet * heading.local;
                self.scatter(photon, rng);
            }
            (_, Some(molecule)) => {
                let at = photon.at + molecule * heading.local;
                let point = self.field.point(at);
                let inside = point.cmpge(self.lower).all() && point.cmple(self.upper).all();
                self.advance(photon, molecule, inside);
                photon.at = at;
                photon.scattered = true;
                let cosine = self.air.phase_function.sample(rng.random());
                photon.direction = turn(photon.direction, cosine, rng);
            }
            (_, None) if photon.direction.z < 0.0 => {
                let ground = self.field.local(DVec3::Z * self.scene.surface.altitude).z;
                let distance = (ground - photon.at.z) / heading.local.z;
                self.advance(photon, distance, false);
                photon.at += distance * heading.local;
                self.reflect(photon, rng);
            }
            _ => {
                self.advance(photon, f64::INFINITY, false);
                photon.shares[UPWARD] += photon.weight;
                photon.weight = 0.0;
            }
        }
    }

    /// A collision with a droplet.
    fn scatter(&self, photon: &mut Photon, rng: &mut Stream) {
        let collision = self.scene.medium.scattering.at(self.field.voxel(photon.at));
        photon.shares[ABSORBED] += photon.weight * (1.0 - collision.single_scattering_albedo);
        photon.weight *= collision.single_scattering_albedo;
        photon.scattered = true;
        if survives(&mut photon.weight, ROULETTE, rng) {
            photon.direction = turn(photon.direction, collision.sample(rng.random()), rng);
        } else {
            photon.weight = 0.0;
        }
    }

    /// Absorb part of the light at the surface and reflect the rest, in a direction drawn from the
    /// Lambertian distribution or from that of the waves.
    fn reflect(&self, photon: &mut Photon, rng: &mut Stream) {
        let (surface, away) = (&self.scene.surface, -photon.direction);
        if !photon.scattered {
            photon.shares[UNSCATTERED] += photon.weight;
        }
        let before = photon.weight;
        photon.weight = 0.0;
        photon.scattered = true;
        if !surface.is_black() {
            let diffuse = match surface.waves {
                None => 1.0,
                Some(_) if surface.albedo > 0.0 => 0.5,
                Some(_) => 0.0,
            };
            let direction = match surface.waves {
                Some(waves) if rng.random::<f64>() >= diffuse => waves.sample(away, rng),
                _ => turn(DVec3::Z, rng.random::<f64>().sqrt(), rng),
            };
            if direction.z > 0.0 {
                let waves = surface.waves.map_or(0.0, |w| w.sample_density(away, direction));
                let drawn = diffuse * direction.z / PI + (1.0 - diffuse) * waves;
                let reflected = surface.reflectance(away, direction) * direction.z;
                (photon.weight, photon.direction) = (before * reflected / drawn, direction);
            }
        }
        photon.shares[DOWNWARD] += before - photon.weight;
        if photon.weight > 0.0 && !survives(&mut photon.weight, ROULETTE, rng) {
            photon.weight = 0.0;
        }
    }

    /// Count the faces of the grid crossed over `distance` (km) on a path that ends inside or
    /// outside of the grid: outward crossings add to the share of the face, inward crossings
    /// subtract.
    fn advance(&self, photon: &mut Photon, distance: f64, inside: bool) {
        let was_inside = std::mem::replace(&mut photon.inside, inside);
        if was_inside && inside {
            return;
        }
        let ray = Ray { origin: self.field.point(photon.at), direction: photon.direction };
        let rises = ray.direction.z > 0.0;
        let passed = clip(&ray, self.lower, self.upper);
        if !was_inside {
            match passed {
                Some((enter, _)) if inside || enter < distance => {
                    photon.shares[self.face(ray.at(enter), !rises)] -= photon.weight;
                }
                // A rounding error: the photon is inside, so it has entered.
                None if inside => photon.shares[if rises { BOTTOM } else { TOP }] -= photon.weight,
                _ => return,
            }
        }
        if !inside {
            let face = match passed {
                Some((_, exit)) => self.face(ray.at(exit), rises),
                None if rises => TOP,
                None => BOTTOM,
            };
            photon.shares[face] += photon.weight;
        }
    }

    /// Face of the grid on which a point lies: the top or the bottom, or else a side.
    fn face(&self, point: DVec3, top: bool) -> usize {
        let (face, plane) = if top { (TOP, self.upper.z) } else { (BOTTOM, self.lower.z) };
        let near = (point.z - plane).abs() < 1e-9 * (self.upper.z - self.lower.z);
        if near || self.scene.boundary == Boundary::Periodic { face } else { SIDES }
    }
}
