//! Camera: light scattered towards it, integrated along its rays.
//!
//! Light scattered more than once comes from the moments of the solution. Light scattered once
//! comes from the optical depths towards the Sun and the full phase function, broadened by the
//! forward peak ([`super::broadened`]). The molecular atmosphere scatters along the whole ray,
//! between and in the cells.

mod tangent;

pub(super) use tangent::Change;

use super::beam::{Rays, spread_sun_depth, sun_depth};
use super::broadened::LEVELS;
use super::derivative::ByMedium;
use super::optics::Changes;
use super::quadrature::first_harmonics;
use super::surroundings::{BySurface, OnSurface, Outside, Surroundings};
use crate::math::{DVec3, GAUSS_TWO, Ray};
use crate::scene::View;

/// Largest optical depth of a step along a ray, for the extinction that the model is prepared for.
const STEP: f64 = 1.0;
/// Longest side of a tile (pixels), and largest angle across one (radians).
const TILE: usize = 64;
const NARROW: f64 = 0.02;
/// Number of levels at which the light of the molecular atmosphere along the rays of a tile is
/// tabulated.
const AIR_LEVELS: usize = 17;
/// Possible numbers of rays per pixel: with one of these numbers of points, and the previous number
/// as the generator, a lattice is spread evenly along all directions (Zaremba 1966).
const FIBONACCI: [usize; 16] =
    [3, 5, 8, 13, 21, 34, 55, 89, 144, 233, 377, 610, 987, 1597, 2584, 4181];
/// Positions of the two points in a step; the extinction is taken as linear through both (see
/// [`before`]).
const POINTS: [f64; 2] = GAUSS_TWO;

/// Part of an image, small enough for all its rays to have nearly the same direction.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tile {
    pub(super) view: usize,
    rows: [usize; 2],
    cols: [usize; 2],
}

/// Divide an image into tiles.
pub(super) fn tiles(number: usize, view: &View) -> Vec<Tile> {
    // The cast of the infinite number of parallel lines of sight saturates.
    let side = ((NARROW / view.pixel_angle()) as usize).clamp(1, TILE);
    let cut = |count: usize| -> Vec<[usize; 2]> {
        (0..count).step_by(side).map(|first| [first, (first + side).min(count)]).collect()
    };
    let rows = cut(view.rows);
    rows.iter()
        .flat_map(|rows| {
            cut(view.cols).into_iter().map(|cols| Tile { view: number, rows: *rows, cols })
        })
        .collect()
}

impl Tile {
    /// Pixels of the tile, `[row, col]`.
    pub(super) fn pixels(self) -> impl Iterator<Item = [usize; 2]> {
        (self.rows[0]..self.rows[1])
            .flat_map(move |row| (self.cols[0]..self.cols[1]).map(move |col| [row, col]))
    }

    /// Direction of propagation of the light that arrives at the middle of the tile.
    fn direction(&self, view: &View) -> DVec3 {
        let middle = |[first, last]: [usize; 2]| 0.5 * (first + last) as f64;
        -view.ray(middle(self.rows), middle(self.cols)).direction
    }
}

/// Data that the camera requires.
#[derive(Debug, Clone, Copy)]
pub(super) struct Camera<'a> {
    pub(super) rays: Rays<'a>,
    /// Direction towards the Sun.
    pub(super) sun: DVec3,
    pub(super) sun_depths: &'a [[f32; 8]],
    /// Part of the optical depths that is due to the molecular atmosphere, by cell.
    pub(super) air_depths: &'a [f32],
    pub(super) surroundings: &'a Surroundings,
    pub(super) on_surface: OnSurface<'a>,
    /// Moments of radiance, `[slot][4][harmonic]`.
    pub(super) moments: &'a [f32],
    /// Number of harmonics.
    pub(super) count: usize,
    /// Minimum number of rays per pixel.
    pub(super) rays_per_pixel: usize,
}

/// Quantities shared by the rays of a tile.
#[derive(Debug)]
pub(super) struct Prepared {
    /// Light that each active cell scatters towards the camera, over extinction: mean and slopes.
    scattered: Vec<[f32; 4]>,
    changes: Changes,
    air: AirLight,
    /// Number of rays per pixel.
    rays: usize,
}

/// Light of the molecular atmosphere in the block of cells along the rays of a tile.
#[derive(Debug)]
struct AirLight {
    /// Altitude at which the rays enter the block (km): that of its top, or of its bottom for rays
    /// that go up.
    start: f64,
    /// Number of levels per kilometre; negative for rays that go down.
    levels_per_km: f64,
    /// Radiance that the molecular atmosphere between the start and a level scatters into a ray,
    /// seen from the start, and transmittance; empty without a molecular atmosphere.
    levels: Vec<[f64; 2]>,
}

impl AirLight {
    /// Radiance and transmittance between the start and an altitude (km).
    #[inline]
    fn at(&self, altitude: f64) -> [f64; 2] {
        if self.levels.is_empty() {
            return [0.0, 1.0];
        }
        let last = (self.levels.len() - 1) as f64;
        let place = ((altitude - self.start) * self.levels_per_km).clamp(0.0, last);
        let level = (place as usize).min(self.levels.len() - 2);
        let part = place - level as f64;
        let [above, below] = [self.levels[level], self.levels[level + 1]];
        [0, 1].map(|m| (1.0 - part) * above[m] + part * below[m])
    }
}

/// Derivative of a weighted sum of the radiances of a tile.
#[derive(Debug)]
pub(super) struct Derivative {
    /// With respect to the medium, at fixed diffuse radiance.
    pub(super) medium: ByMedium,
    /// With respect to the optical depths towards the Sun from the cells.
    pub(super) sun_depths: Vec<[f32; 8]>,
    pub(super) on_surface: BySurface,
    /// With respect to the light scattered towards the camera (mean and slopes), from which the
    /// derivative with respect to the moments of radiance follows.
    pub(super) scattered: Vec<[f32; 4]>,
}

/// A step through a cell, evaluated at two points.
#[derive(Debug, Clone, Copy)]
struct Step {
    slot: usize,
    points: [Point; 2],
    /// Delta-M scaling factor, and length of the step (km).
    scaling: f64,
    length: f64,
    /// Light of the molecular atmosphere before the cell and in the step that reaches the camera.
    before: f64,
    air: f64,
}

/// A point on a ray, with the quantities evaluated there.
#[derive(Debug, Clone, Copy)]
struct Point {
    at: DVec3,
    /// Extinction (1/km).
    extinction: f64,
    /// Light scattered into the ray, over extinction: total, and from direct sunlight.
    source: f64,
    sunlight: f64,
    /// Transmittance from the Sun to the point, and delta-M scaled optical depth of the cloud on the
    /// path from the Sun to the camera.
    lit: f64,
    depth: f64,
    /// Derivative of the source with respect to the optical depth towards the Sun or the camera due
    /// to the broadening by the forward peak.
    broadening: f64,
    /// Transmittance from the point to the camera.
    transmittance: f64,
}

impl Step {
    /// Radiance at the camera due to the light scattered around each point.
    fn radiances(&self) -> [f64; 2] {
        self.points.map(|p| 0.5 * self.length * p.extinction * p.source * p.transmittance)
    }

    /// Decrease of these radiances per unit of optical depth before each point.
    fn weakened(&self) -> [f64; 2] {
        self.points
            .map(|p| 0.5 * self.length * p.extinction * (p.source - p.broadening) * p.transmittance)
    }
}

impl Camera<'_> {
    /// Compute the quantities shared by the rays of a tile.
    pub(super) fn prepare(&self, tile: &Tile, view: &View) -> Prepared {
        let (mut least, mut most) = (f64::INFINITY, 0.0_f64);
        for row in tile.rows {
            for col in tile.cols {
                let ray = view.ray(row as f64, col as f64);
                let angle = (-ray.direction.dot(self.sun)).clamp(-1.0, 1.0).acos();
                (least, most) = (least.min(angle), most.max(angle));
            }
        }
        // In the middle of a tile the angle may be smaller than at its corners.
        let least = least - (most - least);
        Prepared {
            scattered: self.scattered(tile, view),
            changes: self.rays.optics.changes(least, most),
            air: self.air_light(tile, view),
            rays: self.ray_count(view),
        }
    }

    /// Light that each active cell scatters towards the camera, over extinction: mean and slopes.
    fn scattered(&self, tile: &Tile, view: &View) -> Vec<[f32; 4]> {
        let harmonics = self.harmonics(tile, view);
        let count = harmonics.len();
        let cells = self.moments.chunks_exact(4 * count).enumerate();
        let scattered = |(slot, moments): (usize, &[f32])| {
            let by = self.rays.optics.scattered(self.rays.lattice.owner(slot));
            let mut sums = [0.0_f32; 4];
            for (sum, moments) in sums.iter_mut().zip(moments.chunks_exact(count)) {
                *sum = moments.iter().zip(&harmonics).zip(by).map(|((m, y), s)| m * y * s).sum();
            }
            sums
        };
        cells.map(scattered).collect()
    }

    /// Light of the molecular atmosphere along the rays of a tile.
    fn air_light(&self, tile: &Tile, view: &View) -> AirLight {
        let grid = &self.rays.lattice.grid;
        let height = grid.extent().z;
        let direction = -tile.direction(view);
        let steps = (AIR_LEVELS - 1) as f64;
        let start = if direction.z > 0.0 { grid.lower().z } else { grid.upper().z };
        let levels_per_km = (steps / height).copysign(direction.z);
        let mut light = AirLight { start, levels_per_km, levels: Vec::new() };
        if self.surroundings.has_air() {
            let level = |number: usize| {
                let length = number as f64 / steps * height / direction.z.abs();
                let ray = Ray { origin: DVec3::new(0.0, 0.0, start), direction };
                let transmittance = self.surroundings.transmittance(&ray, 0.0, length);
                [self.surroundings.before(&ray, length), transmittance]
            };
            light.levels = (0..AIR_LEVELS).map(level).collect();
        }
        light
    }

    /// Number of rays per pixel, which is larger for pixels wider than a voxel.
    fn ray_count(&self, view: &View) -> usize {
        let spacing = self.rays.lattice.grid.spacing;
        let across = (view.pixel_km() / spacing.min_element()).max(1.0);
        let wanted = (self.rays_per_pixel as f64 * across * across).ceil() as usize;
        let enough = FIBONACCI.iter().position(|count| *count >= wanted);
        FIBONACCI[enough.unwrap_or(FIBONACCI.len() - 1)]
    }

    /// Spherical harmonics in the direction of a tile.
    pub(super) fn harmonics(&self, tile: &Tile, view: &View) -> Vec<f32> {
        first_harmonics(tile.direction(view), self.count)
    }

    /// Mean radiance of a pixel, for a Sun of unit irradiance.
    pub(super) fn radiance(&self, view: &View, pixel: [usize; 2], prepared: &Prepared) -> f64 {
        let mut path = Path::default();
        let mut radiance = 0.0;
        for ray in pixel_rays(view, pixel, prepared.rays) {
            let beyond = self.walk(ray, prepared, false, &mut path);
            radiance += beyond.before + beyond.transmittance * beyond.outside.radiance();
            for step in &path.steps {
                let [first, second] = step.radiances();
                radiance += step.before + step.air + first + second;
            }
        }
        radiance / prepared.rays as f64
    }

    /// Add the derivative of `weight` times the radiance of a pixel.
    pub(super) fn differentiate(
        &self,
        view: &View,
        pixel: [usize; 2],
        weight: f64,
        prepared: &Prepared,
        into: &mut Derivative,
    ) {
        let weight = weight / prepared.rays as f64;
        let mut path = Path::default();
        let before = POINTS.map(before);
        let before_middle = self::before(0.5);
        for ray in pixel_rays(view, pixel, prepared.rays) {
            let beyond = self.walk(ray, prepared, true, &mut path);
            let value = weight * beyond.transmittance;
            self.surroundings.spread(&beyond.outside, value, &mut into.on_surface);
            // From back to front: a point attenuates the radiance that comes from behind it.
            let mut behind = beyond.transmittance * beyond.outside.radiance();
            for step in path.steps.iter().rev() {
                let Step { slot, scaling, length, air, .. } = *step;
                let number_of_voxel = self.rays.lattice.owner(slot);
                let row = self.rays.optics.row(number_of_voxel);
                let seen = step.weakened();
                for (number, point) in step.points.iter().enumerate() {
                    let weakened = before[0][number] * seen[0]
                        + before[1][number] * seen[1]
                        + before_middle[number] * air
                        + 0.5 * behind;
                    let own = 0.5 * length * point.source * point.transmittance;
                    let value = weight * (own - length * scaling * weakened);
                    self.rays.lattice.spread(&mut into.medium.extinction, slot, point.at, value);
                    into.medium.scaling[row] -= weight * length * point.extinction * weakened;
                    let light = weight * 0.5 * length * point.extinction * point.transmittance;
                    spread_sun_depth(
                        &mut into.sun_depths[slot],
                        &self.sun_depths[slot],
                        point.at,
                        -light * (point.sunlight - point.broadening),
                    );
                    self.rays.optics.spread_density(
                        number_of_voxel,
                        &path.densities,
                        point.depth,
                        light * point.lit,
                        &mut into.medium,
                    );
                    let functions = super::lattice::basis(point.at);
                    for (sum, function) in into.scattered[slot].iter_mut().zip(functions) {
                        *sum += (light * function) as f32;
                    }
                }
                behind += seen[0] + seen[1] + step.before + air;
            }
        }
    }

    /// Trace a ray; returns the light in front of and behind its steps. Steps through voxels
    /// without extinction affect only the derivative, for which `empty` includes them.
    fn walk(&self, ray: Ray, prepared: &Prepared, empty: bool, path: &mut Path) -> Background {
        let Path { steps, densities } = path;
        steps.clear();
        let Rays { lattice, optics, extinction, .. } = self.rays;
        let Prepared { scattered, changes, air, .. } = prepared;
        let before = POINTS.map(before);
        let before_middle = self::before(0.5);
        let altitude = |distance: f64| ray.origin.z + distance * ray.direction.z;
        let mut depth = 0.0;
        // Distances at which the ray enters the first cell and leaves the last one so far.
        let mut inside: Option<[f64; 2]> = None;
        // Transmittance from the camera to where rays enter the block, and light of the molecular
        // atmosphere up to the last cell.
        let (mut to_start, mut light) = (1.0, 0.0);
        for segment in lattice.segments(ray) {
            let number = segment.number;
            let leave = segment.enter + segment.length;
            if inside.is_none() {
                let [seen, passed] = air.at(altitude(segment.enter));
                light = seen;
                to_start = self.surroundings.transmittance(&ray, 0.0, segment.enter) / passed;
                optics.densities(ray.direction.dot(self.sun), changes, densities);
            }
            inside = Some([inside.map_or(segment.enter, |ends| ends[0]), leave]);
            let holds = |voxel: &u32| extinction[*voxel as usize] > 0.0;
            if !empty && !lattice.voxels_of(number).iter().any(holds) {
                continue;
            }
            let scaling = f64::from(optics.delta_m_scaling(number));
            // The steps do not depend on the current medium, because the radiance would be
            // discontinuous where their number changes.
            let prepared = f64::from(lattice.active()[number].prepared);
            let thickness = optics.typical_scaling * prepared / STEP;
            let [entered, _] = air.at(altitude(segment.enter));
            let mut gap = to_start * (entered - light) * f64::exp(-depth);
            light = entered;
            lattice.cells(&segment, |cell| {
                let slot = cell.slot;
                let reach = cell.to - cell.from;
                let count = (thickness * cell.length).ceil().max(1.0);
                let length = cell.length / count;
                for step in 0..count as usize {
                    let places = POINTS.map(|x| cell.from + (step as f64 + x) / count * reach);
                    let values = places.map(|at| lattice.value(extinction, slot, at));
                    let [seen, passed] =
                        air.at(altitude(cell.enter + (step as f64 + 1.0) * length));
                    let part = |weights: [f64; 2]| {
                        scaling * length * (weights[0] * values[0] + weights[1] * values[1])
                    };
                    let point = |n: usize| {
                        let at = places[n];
                        let to_camera = depth + part(before[n]);
                        let to_sun = sun_depth(&self.sun_depths[slot], at);
                        let of_cloud =
                            (to_sun - f64::from(self.air_depths[slot])).max(0.0) + to_camera;
                        let (single, change) = optics.density(number, densities, of_cloud);
                        let lit = (-to_sun).exp();
                        let functions = super::lattice::basis(at);
                        let diffuse: f64 = functions
                            .iter()
                            .zip(&scattered[slot])
                            .map(|(function, value)| function * f64::from(*value))
                            .sum();
                        Point {
                            at,
                            extinction: values[n],
                            source: single * lit + diffuse,
                            sunlight: single * lit,
                            lit,
                            depth: of_cloud,
                            broadening: change * lit,
                            transmittance: to_start * passed * (-to_camera).exp(),
                        }
                    };
                    steps.push(Step {
                        slot,
                        points: [point(0), point(1)],
                        scaling,
                        length,
                        before: std::mem::take(&mut gap),
                        air: to_start * (seen - light) * (-depth - part(before_middle)).exp(),
                    });
                    light = seen;
                    depth += part([0.5, 0.5]);
                }
            });
        }
        let Some([enter, leave]) = inside else {
            let outside = self.surroundings.outside(&ray, self.on_surface);
            return Background { before: 0.0, transmittance: 1.0, outside };
        };
        let behind = Ray { origin: ray.at(leave), ..ray };
        let [last, _] = air.at(altitude(leave));
        Background {
            before: self.surroundings.before(&ray, enter)
                + to_start * (last - light) * f64::exp(-depth),
            transmittance: self.surroundings.transmittance(&ray, 0.0, leave) * (-depth).exp(),
            outside: self.surroundings.outside(&behind, self.on_surface),
        }
    }
}

/// Rays through a pixel, spread evenly over its area.
fn pixel_rays(
    view: &View,
    [row, col]: [usize; 2],
    count: usize,
) -> impl Iterator<Item = Ray> + use<'_> {
    let position = FIBONACCI.iter().position(|other| *other == count).unwrap_or(0);
    let generator = if position == 0 { 2 } else { FIBONACCI[position - 1] };
    (0..count).map(move |number| {
        let place = |step: usize| ((number * step % count) as f64 + 0.5) / count as f64;
        view.ray(row as f64 + place(1), col as f64 + place(generator))
    })
}

/// Steps along a ray, with buffers that are reused from ray to ray.
#[derive(Debug, Default)]
struct Path {
    steps: Vec<Step>,
    /// Densities of the phase functions at the angle between the ray and the Sun.
    densities: Vec<[f64; LEVELS]>,
}

/// Light of a ray from in front of and behind the cloud.
#[derive(Debug, Clone, Copy)]
struct Background {
    /// Light of the molecular atmosphere that is not part of any step.
    before: f64,
    /// Transmittance from behind the cloud to the camera, and the radiance there.
    transmittance: f64,
    outside: Outside,
}

impl Derivative {
    /// A derivative of zero.
    pub(super) fn new(rays: &Rays, on_surface: OnSurface) -> Self {
        let slots = rays.lattice.len();
        Self {
            medium: ByMedium::new(rays),
            sun_depths: vec![[0.0; 8]; slots],
            on_surface: BySurface {
                shade: vec![0.0; on_surface.shade.len()],
                irradiance: vec![0.0; on_surface.irradiance.len()],
            },
            scattered: vec![[0.0; 4]; slots],
        }
    }
}

/// Weights of the extinctions at the two points of a step of unit length in the optical depth
/// before a position in the step: the integral of the line through both.
fn before(place: f64) -> [f64; 2] {
    let [first, second] = POINTS;
    let tilt = (0.5 * place * place - first * place) / (second - first);
    [place - tilt, tilt]
}
