//! What a camera sees: light scattered towards it, along its rays.
//!
//! Light scattered more than once comes from the solver's moments, light scattered once
//! from the Sun's depths and the whole phase function.

use super::beam::{Rays, spread_sun_depth, sun_depth};
use super::quadrature::first_harmonics;
use super::surroundings::{BySurface, OnSurface, Outside, Surroundings};
use crate::math::{DVec3, Ray};
use crate::scene::{Projection, View};

/// A step along a ray is no thicker than this, through what the model is prepared for.
const STEP: f64 = 1.0;
/// The longest side of a tile (pixels), and the widest angle across one (radians).
const TILE: usize = 64;
const NARROW: f64 = 0.02;
/// The places of two points in a step, and what their extinctions add to the depth before
/// each of them and before the end, for one that is linear between them.
const POINTS: [f64; 2] = [0.211_324_865_405_187_13, 0.788_675_134_594_812_9];

/// Part of an image, small enough that all its rays have nearly one direction.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tile {
    pub(super) view: usize,
    rows: [usize; 2],
    cols: [usize; 2],
}

/// Cuts an image in tiles.
pub(super) fn tiles(number: usize, view: &View) -> Vec<Tile> {
    let side = match view.projection {
        Projection::Orthographic { .. } => TILE,
        Projection::Perspective { pixel_tangent, .. } => {
            ((NARROW / pixel_tangent) as usize).clamp(1, TILE)
        }
    };
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
    /// The pixels, `[row, col]`.
    pub(super) fn pixels(self) -> impl Iterator<Item = [usize; 2]> {
        (self.rows[0]..self.rows[1])
            .flat_map(move |row| (self.cols[0]..self.cols[1]).map(move |col| [row, col]))
    }

    /// The direction in which light comes to the middle of the tile.
    fn direction(&self, view: &View) -> DVec3 {
        let middle = |[first, last]: [usize; 2]| 0.5 * (first + last) as f64;
        -view.ray(middle(self.rows), middle(self.cols)).direction
    }
}

/// All that a camera needs to know.
#[derive(Debug, Clone, Copy)]
pub(super) struct Camera<'a> {
    pub(super) rays: Rays<'a>,
    /// Towards the Sun.
    pub(super) sun: DVec3,
    pub(super) sun_depths: &'a [[f32; 8]],
    pub(super) surroundings: &'a Surroundings,
    pub(super) on_surface: OnSurface<'a>,
    /// Moments of radiance, `[slot][4][harmonic]`.
    pub(super) moments: &'a [f32],
    /// Number of rays along each side of a pixel.
    pub(super) rays_per_side: usize,
    /// The largest extinction that is prepared for (1/km).
    pub(super) largest_extinction: f64,
}

/// The derivative of a weighted sum of radiances of a tile.
#[derive(Debug)]
pub(super) struct Derivative {
    /// By the extinction of each voxel, at the radiance that there is.
    pub(super) extinction: Vec<f64>,
    /// By the depths towards the Sun from the cells.
    pub(super) sun_depths: Vec<[f32; 8]>,
    pub(super) on_surface: BySurface,
    /// By the moments of radiance, all of which see the camera alike: by what is scattered
    /// towards it, mean and slopes.
    pub(super) scattered: Vec<[f32; 4]>,
}

/// A point on a ray, and what is known there.
#[derive(Debug, Clone, Copy)]
struct Point {
    slot: usize,
    at: DVec3,
    /// Extinction (1/km), and that without the peak over it.
    extinction: f64,
    kept: f64,
    /// Half the length of the step (km).
    weight: f64,
    /// Light scattered into the ray, over extinction: in all, and what came from the Sun.
    source: f64,
    sunlight: f64,
    /// Transmittance from here to the camera.
    transmittance: f64,
}

impl Camera<'_> {
    /// What is scattered towards the camera by each active cell over extinction: mean and
    /// slopes.
    pub(super) fn scattered(&self, tile: &Tile, view: &View) -> Vec<[f32; 4]> {
        let harmonics = self.harmonics(tile, view);
        let count = harmonics.len();
        let cells = self.moments.chunks_exact(4 * count).enumerate();
        let scattered = |(slot, moments): (usize, &[f32])| {
            let by = self.rays.optics.scattered(slot);
            let mut sums = [0.0_f32; 4];
            for (sum, moments) in sums.iter_mut().zip(moments.chunks_exact(count)) {
                *sum = moments.iter().zip(&harmonics).zip(by).map(|((m, y), s)| m * y * s).sum();
            }
            sums
        };
        cells.map(scattered).collect()
    }

    /// The harmonics in the direction of a tile.
    pub(super) fn harmonics(&self, tile: &Tile, view: &View) -> Vec<f32> {
        let slots = self.rays.lattice.len().max(1);
        first_harmonics(tile.direction(view), self.moments.len() / 4 / slots)
    }

    /// The mean radiance of a pixel, for a Sun of unit irradiance.
    pub(super) fn radiance(&self, view: &View, pixel: [usize; 2], scattered: &[[f32; 4]]) -> f64 {
        let mut way = Way::default();
        let radiance = |ray| {
            let beyond = self.walk(ray, scattered, &mut way);
            beyond.before
                + beyond.transmittance * beyond.outside.radiance()
                + way.points.iter().map(Point::radiance).sum::<f64>()
        };
        let (sum, count) = self
            .pixel_rays(view, pixel)
            .map(radiance)
            .fold((0.0, 0.0), |s, r| (s.0 + r, s.1 + 1.0));
        sum / count
    }

    /// Add the derivative of `weight` times the radiance of a pixel.
    pub(super) fn differentiate(
        &self,
        view: &View,
        pixel: [usize; 2],
        weight: f64,
        scattered: &[[f32; 4]],
        into: &mut Derivative,
    ) {
        let weight = weight / (self.rays_per_side * self.rays_per_side) as f64;
        let mut way = Way::default();
        for ray in self.pixel_rays(view, pixel) {
            let beyond = self.walk(ray, scattered, &mut way);
            let value = weight * beyond.transmittance;
            self.surroundings.spread(&beyond.outside, value, &mut into.on_surface);
            // Backwards: what is behind a point is weakened by it.
            let mut behind = beyond.transmittance * beyond.outside.radiance();
            for pair in way.points.chunks_exact(2).rev() {
                let seen = [pair[0].radiance(), pair[1].radiance()];
                let before = before_points();
                for (number, point) in pair.iter().enumerate() {
                    let length = 2.0 * point.weight;
                    let weakened =
                        before[0][number] * seen[0] + before[1][number] * seen[1] + 0.5 * behind;
                    let own = point.weight * point.source * point.transmittance;
                    let value = weight * (own - length * point.kept * weakened);
                    self.rays.lattice.spread(&mut into.extinction, point.slot, point.at, value);
                    let light = weight * point.weight * point.extinction * point.transmittance;
                    spread_sun_depth(
                        &mut into.sun_depths[point.slot],
                        point.at,
                        -light * point.sunlight,
                    );
                    let functions = super::lattice::basis(point.at);
                    for (sum, function) in into.scattered[point.slot].iter_mut().zip(functions) {
                        *sum += (light * function) as f32;
                    }
                }
                behind += seen[0] + seen[1];
            }
        }
    }

    fn pixel_rays(&self, view: &View, [row, col]: [usize; 2]) -> impl Iterator<Item = Ray> {
        let (count, view) = (self.rays_per_side, *view);
        let place = move |n: usize| (n as f64 + 0.5) / count as f64;
        (0..count * count)
            .map(move |n| view.ray(row as f64 + place(n / count), col as f64 + place(n % count)))
    }

    /// Go along a ray; gives what is before and behind its points.
    fn walk(&self, ray: Ray, scattered: &[[f32; 4]], way: &mut Way) -> Beyond {
        let Way { points, densities } = way;
        points.clear();
        let Rays { lattice, optics, extinction, .. } = self.rays;
        let before = before_points();
        let mut depth = 0.0;
        let mut inside: Option<[f64; 2]> = None;
        let mut air = 1.0;
        for segment in lattice.segments(ray) {
            let slot = segment.slot;
            let leave = segment.enter + segment.length;
            if inside.is_none() {
                air = self.surroundings.transmittance(&ray, 0.0, segment.enter);
                optics.densities(ray.direction.dot(self.sun), densities);
            }
            inside = Some([inside.map_or(segment.enter, |ends| ends[0]), leave]);
            let reach = segment.to - segment.from;
            let kept = f64::from(optics.kept(slot));
            // Not by the extinction that there is: the radiance would jump where it changes.
            let steps = (kept * self.largest_extinction * segment.length / STEP).ceil().max(1.0);
            let single = optics.density(slot, densities);
            let length = segment.length / steps;
            for step in 0..steps as usize {
                let places = POINTS.map(|x| segment.from + (step as f64 + x) / steps * reach);
                let values = places.map(|at| lattice.value(extinction, slot, at));
                for (number, at) in places.into_iter().enumerate() {
                    let own = kept
                        * length
                        * (before[number][0] * values[0] + before[number][1] * values[1]);
                    let sunlight = single * (-sun_depth(&self.sun_depths[slot], at)).exp();
                    let functions = super::lattice::basis(at);
                    let diffuse: f64 = functions
                        .iter()
                        .zip(&scattered[slot])
                        .map(|(function, value)| function * f64::from(*value))
                        .sum();
                    points.push(Point {
                        slot,
                        at,
                        extinction: values[number],
                        kept,
                        weight: 0.5 * length,
                        source: sunlight + diffuse,
                        sunlight,
                        transmittance: air * (-depth - own).exp(),
                    });
                }
                depth += kept * length * 0.5 * (values[0] + values[1]);
            }
        }
        let Some([enter, leave]) = inside else {
            let outside = self.surroundings.outside(&ray, self.on_surface);
            return Beyond { before: 0.0, transmittance: 1.0, outside };
        };
        let behind = Ray { origin: ray.at(leave), ..ray };
        Beyond {
            before: self.surroundings.before(&ray, enter),
            transmittance: self.surroundings.transmittance(&ray, 0.0, leave) * (-depth).exp(),
            outside: self.surroundings.outside(&behind, self.on_surface),
        }
    }
}

/// What is on a ray, and room to keep it from ray to ray.
#[derive(Debug, Default)]
struct Way {
    /// The points, two and two.
    points: Vec<Point>,
    /// Of the phase functions at the angle between the ray and the Sun.
    densities: Vec<f64>,
}

/// What a ray sees before and behind the cloud.
#[derive(Debug, Clone, Copy)]
struct Beyond {
    /// Light of the air before the cloud.
    before: f64,
    /// Transmittance from behind the cloud to the camera, and what is there.
    transmittance: f64,
    outside: Outside,
}

impl Point {
    fn radiance(&self) -> f64 {
        self.weight * self.extinction * self.source * self.transmittance
    }
}

impl Derivative {
    /// Nothing yet.
    pub(super) fn new(voxels: usize, slots: usize, on_surface: OnSurface) -> Self {
        Self {
            extinction: vec![0.0; voxels],
            sun_depths: vec![[0.0; 8]; slots],
            on_surface: BySurface {
                shadow_depths: vec![0.0; on_surface.shadow_depths.len()],
                irradiance: vec![0.0; on_surface.irradiance.len()],
            },
            scattered: vec![[0.0; 4]; slots],
        }
    }
}

/// What the extinctions at the two points of a step of unit length add to the depth before
/// each of them: the integral of the line through both.
fn before_points() -> [[f64; 2]; 2] {
    let [first, second] = POINTS;
    POINTS.map(|x| {
        let tilt = (0.5 * x * x - first * x) / (second - first);
        [x - tilt, tilt]
    })
}
