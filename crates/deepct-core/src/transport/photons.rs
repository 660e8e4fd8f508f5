//! Photons from the Sun, and where they leave: fluxes of the whole medium.

use super::check_scene;
use super::field::Field;
use super::path::{ROULETTE, survives, turn};
use crate::error::{Error, Result};
use crate::math::{DVec3, Ray};
use crate::rng::{Purpose, RngExt, Stream, stream};
use crate::scene::{Boundary, Scene};
use crate::traverse::clip;
use rayon::prelude::*;

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

/// A share of the sunlight that enters through the top of the grid, and its standard
/// error.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Share {
    /// The mean over the photons.
    pub mean: f64,
    /// Its standard error.
    pub standard_error: f64,
}

/// Where the sunlight goes that enters through the top face of the grid. The first
/// four shares add up to 1.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Fluxes {
    /// Leaves upwards through the top face.
    pub reflected: Share,
    /// Leaves downwards through the bottom face, scattered or not.
    pub transmitted: Share,
    /// Leaves through the sides.
    pub sides: Share,
    /// Stays.
    pub absorbed: Share,
    /// Leaves upwards through any face.
    pub upward: Share,
    /// Leaves without having been scattered.
    pub unscattered: Share,
}

/// Photons that run together on one random stream.
const BATCH: u64 = 4096;
/// Number of shares counted.
const SHARES: usize = 6;

/// Trace photons from the Sun through the top face of the grid until they leave or
/// are absorbed. The surface plays no part: what goes down through the bottom is
/// counted as transmitted.
///
/// # Errors
/// Fewer than two photons, or a trilinear medium with a single layer.
pub fn fluxes(scene: &Scene, settings: FluxSettings) -> Result<Fluxes> {
    check_scene(scene)?;
    if settings.photons < 2 {
        return Err(Error::out_of_range("number of photons", settings.photons, "at least 2"));
    }
    let field = Field::new(&scene.medium, scene.boundary);
    let batch = |number: u64| {
        let mut rng = stream(settings.seed, Purpose::Transport, &[number, u64::MAX]);
        let mut sums = [[0.0; 2]; SHARES];
        for _ in 0..BATCH.min(settings.photons - number * BATCH) {
            for (sum, value) in sums.iter_mut().zip(trace(scene, &field, &mut rng)) {
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
        reflected: share(0),
        transmitted: share(1),
        sides: share(2),
        absorbed: share(3),
        upward: share(4),
        unscattered: share(5),
    })
}

/// One photon: what it adds to each share, in the order of [`Fluxes`].
fn trace(scene: &Scene, field: &Field, rng: &mut Stream) -> [f64; SHARES] {
    let medium = &scene.medium;
    let grid = &medium.extinction.grid;
    let mut direction = -scene.sun.towards();
    let top = DVec3::new(rng.random(), rng.random(), 1.0);
    let mut at = field.local(grid.lower() + grid.extent() * top);
    let (mut weight, mut absorbed, mut scattered) = (1.0, 0.0, false);
    loop {
        let heading = field.heading(direction);
        let depth = -(1.0 - rng.random::<f64>()).ln();
        let Some(distance) = field.free_path(at, &heading, depth) else {
            break;
        };
        at += distance * heading.local;
        let collision = medium.scattering.at(field.voxel(at));
        absorbed += weight * (1.0 - collision.single_scattering_albedo);
        weight *= collision.single_scattering_albedo;
        scattered = true;
        if !survives(&mut weight, ROULETTE, rng) {
            weight = 0.0;
            break;
        }
        direction = turn(direction, collision.sample(rng.random()), rng);
    }
    let mut shares = [0.0, 0.0, 0.0, absorbed, 0.0, 0.0];
    shares[face(scene, Ray { origin: field.point(at), direction })] += weight;
    shares[4] = if direction.z > 0.0 { weight } else { 0.0 };
    shares[5] = if scattered { 0.0 } else { weight };
    shares
}

/// The face through which a ray leaves the grid: 0 top, 1 bottom, 2 a side.
fn face(scene: &Scene, ray: Ray) -> usize {
    let grid = &scene.medium.extinction.grid;
    let vertical = usize::from(ray.direction.z < 0.0);
    if scene.boundary == Boundary::Periodic {
        return vertical;
    }
    let Some((_, exit)) = clip(&ray, grid.lower(), grid.upper()) else {
        return vertical;
    };
    let plane = if vertical == 0 { grid.upper().z } else { grid.lower().z };
    let offset = (ray.at(exit).z - plane).abs();
    if offset < 1e-9 * grid.extent().z { vertical } else { 2 }
}
