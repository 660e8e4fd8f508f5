//! Photons from the Sun, and where they leave: fluxes of the whole medium.

use super::air_column::AirColumn;
use super::check_scene;
use super::field::Field;
use super::path::{ROULETTE, exponential, survives, turn};
use crate::error::{Error, Result};
use crate::math::{DVec3, Ray};
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

/// A share of the sunlight that shines on the top face of the grid, and its standard
/// error.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Share {
    /// The mean over the photons.
    pub mean: f64,
    /// Its standard error.
    pub standard_error: f64,
}

/// Where the sunlight goes that shines on the top face of the grid.
///
/// The first four shares are net fluxes through the faces of the grid: what air or
/// surface send back in counts against what left. They add up to 1, and so do
/// `absorbed`, `upward` and `downward`, which tell where the light is in the end.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Fluxes {
    /// Does not come in through the top face, or leaves through it upwards.
    pub reflected: Share,
    /// Leaves downwards through the bottom face, scattered or not.
    pub transmitted: Share,
    /// Leaves through the sides.
    pub sides: Share,
    /// Stays in the droplets.
    pub absorbed: Share,
    /// Goes to space, through any face.
    pub upward: Share,
    /// Stays in the surface.
    pub downward: Share,
    /// Comes to the surface without having been scattered.
    pub unscattered: Share,
}

/// Photons that run together on one random stream.
const BATCH: u64 = 4096;
/// Number of shares counted.
const SHARES: usize = 7;
// Their numbers, in the order of `Fluxes`; the faces of the grid come first.
const TOP: usize = 0;
const BOTTOM: usize = 1;
const SIDES: usize = 2;
const ABSORBED: usize = 3;
const UPWARD: usize = 4;
const DOWNWARD: usize = 5;
const UNSCATTERED: usize = 6;

/// Trace photons that the Sun shines on the top face of the grid until they are in space,
/// in the surface or in a droplet. The sunlight that shines on other places is not
/// followed.
///
/// # Errors
/// Fewer than two photons, or a trilinear medium with a single layer.
pub fn fluxes(scene: &Scene, settings: FluxSettings) -> Result<Fluxes> {
    check_scene(scene)?;
    if settings.photons < 2 {
        return Err(Error::out_of_range("number of photons", settings.photons, "at least 2"));
    }
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
    let batches: Vec<_> =
        (0..settings.photons.div_ceil(BATCH)).into_par_iter().map(batch).collect();
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

/// Everything that a photon needs to know of the scene.
struct World<'a> {
    scene: &'a Scene,
    field: Field,
    air: AirColumn,
    /// Corners of the grid, at infinity along x and y where it is periodic.
    lower: DVec3,
    upper: DVec3,
    /// The way from the start of a photon to the top face (km): it starts above all air.
    start: f64,
}

/// A photon on its way, in the field's coordinates.
struct Photon {
    at: DVec3,
    direction: DVec3,
    weight: f64,
    /// Whether it is in the grid.
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

    /// One photon: what it adds to each share.
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
        // All of it is reflected as long as nothing has come in through the top.
        photon.shares[TOP] = 1.0;
        while photon.weight > 0.0 {
            self.fly(&mut photon, rng);
        }
        photon.shares
    }

    /// From one place to the next: a droplet, a molecule, the surface, or space.
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

    /// The surface keeps a share of the light and sends the rest back: into a direction of
    /// all alike, or of those that the waves favour.
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

    /// Count the faces of the grid that are passed on a way of `distance` (km) which ends
    /// inside or outside of it: outwards as a gain of their shares, inwards as a loss.
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
                // A rounding error: it is inside, so it came in.
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

    /// The face of the grid that a point lies on: the top or the bottom, or else a side.
    fn face(&self, point: DVec3, top: bool) -> usize {
        let (face, plane) = if top { (TOP, self.upper.z) } else { (BOTTOM, self.lower.z) };
        let near = (point.z - plane).abs() < 1e-9 * (self.upper.z - self.lower.z);
        if near || self.scene.boundary == Boundary::Periodic { face } else { SIDES }
    }
}
