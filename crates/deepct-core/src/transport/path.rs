//! Light paths, from the camera backwards to the Sun.

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

/// Paths of less throughput than this live on by chance.
pub(super) const ROULETTE: f64 = 0.3;
/// Sunlight that adds less than this (1/sr) at one droplet is added by chance.
const FAINT: f64 = 0.01;
/// The same at a molecule or the surface, of which a path meets few.
const FAINTER: f64 = 1e-4;
/// Mean number of branches towards the Sun at a molecule or the surface.
const BRANCHES_OUTSIDE: f64 = 0.5;

/// Everything that a path needs to know of the scene.
#[derive(Debug)]
pub(super) struct Tracer {
    field: Field,
    sun: Heading,
    guide: Guide,
    air: AirColumn,
    surface: Surface,
    /// Altitude of the surface in the field's coordinates.
    ground: f64,
    /// The medium, and those without the forward peak.
    stages: Vec<Stage>,
    similarity_after: u32,
}

/// A path on its way: it came to `at` in `direction`, or goes on from there.
#[derive(Debug, Clone, Copy)]
struct Path {
    at: DVec3,
    direction: DVec3,
    throughput: f64,
    scatterings: u32,
    meets: Meets,
}

/// What a path meets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Meets {
    Droplet,
    Molecule,
}

impl Tracer {
    /// Make a scene ready.
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

    /// The medium that light meets after a number of scatterings.
    #[inline]
    fn stage(&self, scatterings: u32) -> &Stage {
        let number = (scatterings + 1).saturating_sub(self.similarity_after) as usize;
        &self.stages[number.min(self.stages.len() - 1)]
    }

    /// What a collision of a path does.
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

    /// One sample of the radiance (1/sr, per unit irradiance) that comes along a ray.
    ///
    /// What the ray sees first is not left to chance: it sees cloud, air and surface, each
    /// through what is before it.
    pub(super) fn radiance(&self, ray: &Ray, rng: &mut Stream) -> f64 {
        let mut paths = Vec::new();
        let mut radiance = self.look(ray, &mut paths, rng);
        while let Some(path) = paths.pop() {
            radiance += self.collide(path, &mut paths, rng);
        }
        radiance
    }

    /// The first collisions along a ray, in `paths`, and what the surface reflects.
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

    /// A collision at `path.at`: the sunlight that is scattered into the path there.
    /// The path and its branches go on to their next collisions, in `paths`.
    fn collide(&self, path: Path, paths: &mut Vec<Path>, rng: &mut Stream) -> f64 {
        let Path { at, direction, scatterings, .. } = path;
        let collision = self.collision(&path);
        let throughput = path.throughput * collision.single_scattering_albedo;
        let cosine = direction.dot(self.sun.direction);
        let weight = throughput * collision.density(cosine);
        let faint = if path.meets == Meets::Droplet { FAINT } else { FAINTER };
        let mut radiance = self.sunlight(&path, weight, faint, rng);

        // Light of all other directions: some of them are drawn around the Sun. Each
        // direction counts by its chance to be drawn in either way (Veach 1997,
        // section 9.2), so that none counts much.
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

    /// Go on to the next collision, with a droplet or a molecule, whichever comes first;
    /// what the surface reflects if that comes before both.
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

    /// Light that the surface reflects at `path.at`: sunlight, and all other light.
    fn reflect(&self, path: Path, paths: &mut Vec<Path>, rng: &mut Stream) -> f64 {
        let (sun, away) = (self.sun.direction, -path.direction);
        let weight = path.throughput * self.surface.reflectance(away, sun) * sun.z;
        let mut radiance = self.sunlight(&path, weight, FAINTER, rng);
        // All other light, as at a collision: of directions that the surface favours, and of
        // some around the Sun, as a cloud may be on the way there.
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

    /// `weight` times the transmittance from where a path is to the Sun. A contribution
    /// below `faint` is rounded up to it or down to nothing by chance, so that a walk
    /// towards the Sun ends where too little is left.
    #[inline]
    fn sunlight(&self, path: &Path, weight: f64, faint: f64, rng: &mut Stream) -> f64 {
        let least = faint * (1.0 - rng.random::<f64>());
        if weight < least {
            return 0.0;
        }
        // All that comes to a collision comes through the medium of the next one, sunlight
        // too: what a later stage does not scatter is in it.
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

    /// Where a ray that left the medium meets the surface; `None` for a black surface
    /// and for rays that go up.
    #[inline]
    fn footprint(&self, at: DVec3, heading: &Heading) -> Option<DVec3> {
        (!self.surface.is_black() && heading.local.z < 0.0).then(|| {
            let foot = at + (self.ground - at.z) / heading.local.z * heading.local;
            DVec3::new(foot.x, foot.y, self.ground)
        })
    }
}

/// A number from the exponential distribution: an optical depth.
#[inline]
pub(super) fn exponential(rng: &mut Stream) -> f64 {
    -(1.0 - rng.random::<f64>()).ln()
}

/// Russian roulette: whether a path lives on. One that does carries the throughput of
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
