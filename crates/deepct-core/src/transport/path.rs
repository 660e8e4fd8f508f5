//! Photon paths, traced backwards from the camera to the Sun.

use super::air_column::AirColumn;
use super::field::{Field, Heading};
use super::guide::{Expectation, Guide};
use super::peak::{Stage, stages};
use crate::error::Result;
use crate::math::{DVec3, Ray};
use crate::optics::{Collision, Scattering};
use crate::rng::{RngExt, Stream};
use crate::scene::{Scene, Surface};
use std::f64::consts::PI;

/// Throughput below which a path is subject to Russian roulette.
pub(super) const ROULETTE: f64 = 0.3;
/// Contribution of sunlight (1/sr) at a droplet below which it is subject to Russian roulette.
const FAINT: f64 = 0.01;
/// The same at a molecule or the surface, which a path meets less often.
const FAINTER: f64 = 1e-4;
/// Mean number of branches towards the Sun at a molecule or the surface.
const BRANCHES_OUTSIDE: f64 = 0.5;

/// Scene data required to trace a path.
#[derive(Debug)]
pub(super) struct Tracer {
    field: Field,
    sun: Heading,
    guide: Guide,
    air: AirColumn,
    surface: Surface,
    /// Altitude of the surface in the field's coordinates.
    ground: f64,
    /// The medium, followed by those with a truncated forward peak.
    stages: Vec<Stage>,
    similarity_after: u32,
}

/// State of a path, which arrived at `at` in `direction` or continues from there.
#[derive(Debug, Clone, Copy)]
struct Path {
    at: DVec3,
    direction: DVec3,
    throughput: f64,
    scatterings: u32,
    meets: Meets,
}

/// The scatterer that a path meets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Meets {
    Droplet,
    Molecule,
}

impl Tracer {
    /// Prepare a scene for tracing.
    pub(super) fn new(scene: &Scene, similarity_after: Option<u32>) -> Result<Self> {
        let field = Field::new(&scene.medium, scene.boundary);
        let sun = field.heading(scene.sun.towards());
        Ok(Self {
            guide: Guide::new(&field, &sun),
            air: AirColumn::new(scene.air.as_ref(), scene.surface.altitude),
            surface: scene.surface,
            ground: field.local(DVec3::new(0.0, 0.0, scene.surface.altitude)).z,
            stages: stages(&scene.medium.scattering)?,
            similarity_after: similarity_after.unwrap_or(u32::MAX),
            sun,
            field,
        })
    }

    /// The medium through which light passes after a number of scatterings.
    #[inline]
    fn stage(&self, scatterings: u32) -> &Stage {
        let number = (scatterings + 1).saturating_sub(self.similarity_after) as usize;
        &self.stages[number.min(self.stages.len() - 1)]
    }

    /// Scattering properties at the collision of a path.
    #[inline]
    fn collision<'a>(&'a self, path: &Path) -> Collision<'a> {
        let scattering = &self.stage(path.scatterings).scattering;
        match (path.meets, scattering) {
            (Meets::Molecule, _) => Collision {
                single_scattering_albedo: 1.0,
                phase_functions: [&self.air.phase_function; 2],
                share: 0.0,
            },
            (Meets::Droplet, Scattering::Uniform { .. }) => scattering.at([0; 3]),
            (Meets::Droplet, Scattering::Droplets { .. }) => {
                scattering.at(self.field.voxel(path.at))
            }
        }
    }

    /// One sample of the radiance (1/sr, per unit irradiance) along a ray.
    ///
    /// The type of the first event is not sampled: cloud, molecular atmosphere and surface all
    /// contribute, each attenuated by the media in front of it.
    pub(super) fn radiance(&self, ray: &Ray, rng: &mut Stream) -> f64 {
        let mut paths = Vec::new();
        let mut radiance = self.look(ray, &mut paths, rng);
        while let Some(path) = paths.pop() {
            radiance += self.collide(path, &mut paths, rng);
        }
        radiance
    }

    /// Push the first collisions along a ray onto `paths` and return the light that the surface
    /// reflects.
    fn look(&self, ray: &Ray, paths: &mut Vec<Path>, rng: &mut Stream) -> f64 {
        let origin = self.field.local(ray.origin);
        let heading = self.field.heading(ray.direction);
        let rise = ray.direction.z;
        let extinction = self.stage(0).extinction;
        let depth_from = |at| extinction * self.field.optical_depth(at, &heading, f64::INFINITY);
        let altitude = |at: DVec3| self.field.point(at).z;
        let depth = depth_from(origin);
        let seen = Path {
            at: origin,
            direction: ray.direction,
            throughput: 1.0,
            scatterings: 0,
            meets: Meets::Droplet,
        };
        if depth > 0.0 {
            let scattered = -(-depth).exp_m1();
            let reach = -(-rng.random::<f64>() * scattered).ln_1p() / extinction;
            if let Some(distance) = self.field.free_path(origin, &heading, reach) {
                let at = origin + distance * heading.local;
                let air = self.air.optical_depth(ray.origin.z, altitude(at), rise);
                paths.push(Path { at, throughput: scattered * (-air).exp(), ..seen });
            }
        }
        let end = if rise > 0.0 { f64::INFINITY } else { self.surface.altitude };
        let air = if rise == 0.0 { 0.0 } else { self.air.optical_depth(ray.origin.z, end, rise) };
        if air > 0.0 {
            let scattered = -(-air).exp_m1();
            let reach = -(-rng.random::<f64>() * scattered).ln_1p();
            if let Some(distance) = self.air.free_path(ray.origin.z, rise, reach) {
                let at = origin + distance * heading.local;
                let throughput = scattered * (depth_from(at) - depth).exp();
                paths.push(Path { at, throughput, meets: Meets::Molecule, ..seen });
            }
        }
        match self.footprint(origin, &heading) {
            Some(at) => {
                self.reflect(Path { at, throughput: (-depth - air).exp(), ..seen }, paths, rng)
            }
            None => 0.0,
        }
    }

    /// Sunlight scattered into the path by a collision at `path.at`. The path and its branches
    /// continue to their next collisions, which are pushed onto `paths`.
    fn collide(&self, path: Path, paths: &mut Vec<Path>, rng: &mut Stream) -> f64 {
        let Path { at, direction, scatterings, .. } = path;
        let collision = self.collision(&path);
        let throughput = path.throughput * collision.single_scattering_albedo;
        let cosine = direction.dot(self.sun.direction);
        let weight = throughput * collision.density(cosine);
        let faint = if path.meets == Meets::Droplet { FAINT } else { FAINTER };
        let mut radiance = self.sunlight(&path, weight, faint, rng);

        // Light from all other directions, some of which are sampled around the Sun. Each direction
        // is weighted by its combined probability density under both sampling methods (Veach 1997,
        // section 9.2), so that no contribution is large.
        let stage = self.stage(scatterings);
        let (expected, share, lobe) = match path.meets {
            Meets::Droplet => {
                let extinction = self.stage(scatterings + 1).extinction;
                let expected = self.guide.expect(&self.field, at, extinction, stage.asymmetry);
                (expected, expected.branches(stage.asymmetry, cosine), collision)
            }
            Meets::Molecule => (Expectation::OUTSIDE, BRANCHES_OUTSIDE, stage.anywhere()),
        };
        let share = if stage.asymmetry == 0.0 { 0.0 } else { share };
        let branches = (share + rng.random::<f64>()) as u32;
        for branch in 0..=branches {
            let turned = if branch == 0 {
                turn(direction, collision.sample(rng.random()), rng)
            } else {
                turn(self.sun.direction, lobe.sample(rng.random()), rng)
            };
            let mut path =
                Path { direction: turned, throughput, scatterings: scatterings + 1, ..path };
            let mut importance = 1.0;
            if share > 0.0 {
                let wanted = collision.density(turned.dot(direction));
                let towards_sun = lobe.density(turned.dot(self.sun.direction));
                path.throughput *= wanted / (wanted + share * towards_sun);
                importance = expected.importance(towards_sun);
            }
            if survives(&mut path.throughput, ROULETTE / importance, rng) {
                radiance += self.fly(path, paths, rng);
            }
        }
        radiance
    }

    /// Continue to the next collision, with a droplet or a molecule, whichever comes first, and
    /// push it onto `paths`. Returns the light that the surface reflects if the path reaches it
    /// first.
    fn fly(&self, path: Path, paths: &mut Vec<Path>, rng: &mut Stream) -> f64 {
        let heading = self.field.heading(path.direction);
        let depth = exponential(rng) / self.stage(path.scatterings).extinction;
        let mut first = self.field.free_path(path.at, &heading, depth);
        let mut meets = Meets::Droplet;
        if !self.air.is_empty() {
            let altitude = self.field.point(path.at).z;
            let air = self.air.free_path(altitude, path.direction.z, exponential(rng));
            if air.is_some_and(|air| first.is_none_or(|cloud| air < cloud)) {
                (first, meets) = (air, Meets::Molecule);
            }
        }
        if let Some(distance) = first {
            paths.push(Path { at: path.at + distance * heading.local, meets, ..path });
            return 0.0;
        }
        match self.footprint(path.at, &heading) {
            Some(at) => self.reflect(Path { at, ..path }, paths, rng),
            None => 0.0,
        }
    }

    /// Light that the surface reflects at `path.at`: direct sunlight, and light from all other
    /// directions.
    fn reflect(&self, path: Path, paths: &mut Vec<Path>, rng: &mut Stream) -> f64 {
        let (sun, away) = (self.sun.direction, -path.direction);
        let weight = path.throughput * self.surface.reflectance(away, sun) * sun.z;
        let mut radiance = self.sunlight(&path, weight, FAINTER, rng);
        // All other light, as at a collision: some directions are sampled from the reflectance of
        // the surface and some around the Sun, because a cloud may lie in that direction.
        let stage = self.stage(path.scatterings);
        let (lobe, waves) = (stage.anywhere(), self.surface.waves);
        let share = if stage.asymmetry == 0.0 { 0.0 } else { BRANCHES_OUTSIDE };
        let lambertian = f64::from(self.surface.albedo > 0.0);
        let mut go_on = |direction: DVec3, rng: &mut Stream| {
            let reflectance = self.surface.reflectance(away, direction) * direction.z;
            if direction.z <= 0.0 || reflectance <= 0.0 {
                return;
            }
            let towards_sun = lobe.density(direction.dot(sun));
            let drawn = lambertian * direction.z / PI
                + waves.map_or(0.0, |waves| waves.sample_density(away, direction))
                + share * towards_sun;
            let throughput = path.throughput * reflectance / drawn;
            let mut path = Path { direction, throughput, ..path };
            let least = ROULETTE / Expectation::OUTSIDE.importance(share.ceil() * towards_sun);
            if survives(&mut path.throughput, least, rng) {
                radiance += self.fly(path, paths, rng);
            }
        };
        if lambertian > 0.0 {
            go_on(turn(DVec3::Z, rng.random::<f64>().sqrt(), rng), rng);
        }
        if let Some(waves) = waves {
            go_on(waves.sample(away, rng), rng);
        }
        if rng.random::<f64>() < share {
            go_on(turn(sun, lobe.sample(rng.random()), rng), rng);
        }
        radiance
    }

    /// `weight` times the transmittance from the position of a path to the Sun. A contribution
    /// below `faint` is set to `faint` or to zero at random, so that the traversal towards the Sun
    /// ends where too little is left.
    #[inline]
    fn sunlight(&self, path: &Path, weight: f64, faint: f64, rng: &mut Stream) -> f64 {
        let least = faint * (1.0 - rng.random::<f64>());
        if weight < least {
            return 0.0;
        }
        // Light that arrives at a collision, sunlight included, has passed through the medium of
        // the next stage: it contains the light whose scattering that stage omits.
        let extinction = self.stage(path.scatterings + 1).extinction;
        let altitude = self.field.point(path.at).z;
        let air = self.air.optical_depth(altitude, f64::INFINITY, self.sun.direction.z);
        let limit = (weight / least).ln() / extinction;
        let depth = self.field.optical_depth(path.at, &self.sun, limit) + air / extinction;
        if depth > limit {
            return 0.0;
        }
        (weight * (-depth * extinction).exp()).max(faint)
    }

    /// Point where a ray that left the medium meets the surface; `None` for a black surface and for
    /// upward rays.
    #[inline]
    fn footprint(&self, at: DVec3, heading: &Heading) -> Option<DVec3> {
        (!self.surface.is_black() && heading.local.z < 0.0).then(|| {
            let foot = at + (self.ground - at.z) / heading.local.z * heading.local;
            DVec3::new(foot.x, foot.y, self.ground)
        })
    }
}

/// A random optical depth from the exponential distribution.
#[inline]
pub(super) fn exponential(rng: &mut Stream) -> f64 {
    -(1.0 - rng.random::<f64>()).ln()
}

/// Russian roulette: whether a path continues. A path that continues also carries the throughput of
/// those that do not.
#[inline]
pub(super) fn survives(throughput: &mut f64, least: f64, rng: &mut Stream) -> bool {
    if *throughput >= least {
        return true;
    }
    let lives = rng.random::<f64>() * least < *throughput;
    *throughput = least;
    lives
}

/// Random unit vector at an angle of the given cosine to `axis`, with a uniformly distributed
/// azimuth. A point in the unit disc gives the azimuth without trigonometric functions (von Neumann
/// 1951); the frame is that of Duff et al. (2017).
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
