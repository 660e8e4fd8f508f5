//! What comes from outside of the cells: sunlight from the surface, and from the air.
//!
//! Sunlight is scattered once by air, without the cloud's shadow, and reflected once by the
//! surface, with it. What the cloud throws on the surface or on the air around does not come
//! back.

use super::beam::{PARTS, Rays, add_all};
use super::lattice::Lattice;
use super::quadrature::Octant;
use super::sweep::Faces;
use crate::math::{DVec3, Ray};
use crate::scene::{Boundary, Scene, Surface};
use crate::transport::air_column::AirColumn;
use rayon::prelude::*;

/// Air and surface under the Sun.
#[derive(Debug)]
pub(super) struct Surroundings {
    air: AirColumn,
    surface: Surface,
    /// Towards the Sun.
    sun: DVec3,
    shadow: Shadow,
}

/// Where the cloud's shadow on the surface is looked at: a regular lattice of points.
#[derive(Debug)]
struct Shadow {
    origin: DVec3,
    spacing: DVec3,
    rows: usize,
    cols: usize,
    periodic: bool,
}

/// Light that comes along a ray from outside, for a Sun of unit irradiance.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Outside {
    /// From the air.
    air: f64,
    /// From the surface, through the air.
    ground: f64,
    /// Where on the surface.
    foot: DVec3,
}

impl Outside {
    pub(super) fn radiance(&self) -> f64 {
        self.air + self.ground
    }
}

impl Surroundings {
    pub(super) fn new(scene: &Scene, lattice: &Lattice) -> Self {
        let (sun, surface) = (scene.sun.towards(), scene.surface);
        let air = AirColumn::new(scene.air.as_ref(), surface.altitude);
        let shadow = Shadow::new(lattice, sun, surface.altitude);
        Self { air, surface, sun, shadow }
    }

    /// Whether nothing comes from outside.
    pub(super) fn is_dark(&self) -> bool {
        self.air.is_empty() && self.surface.is_black()
    }

    /// Optical depth of the air above an altitude (km).
    fn air_above(&self, altitude: f64) -> f64 {
        self.air.optical_depth(altitude, f64::INFINITY, 1.0)
    }

    /// Optical depth of the air on the way to the Sun.
    pub(super) fn sun_depth(&self, altitude: f64) -> f64 {
        self.air_above(altitude) / self.sun.z
    }

    /// Transmittance of the air between two points of a ray.
    pub(super) fn transmittance(&self, ray: &Ray, from: f64, to: f64) -> f64 {
        let [from, to] = [from, to].map(|distance| ray.at(distance).z);
        (-self.air.optical_depth(from, to, ray.direction.z).abs()).exp()
    }

    /// Optical depths of the cloud towards the Sun from the surface.
    pub(super) fn shadow_depths(&self, rays: &Rays) -> Vec<f32> {
        if self.surface.is_black() {
            return Vec::new();
        }
        let depth =
            |point| rays.depth(Ray { origin: self.shadow.point(point), direction: self.sun });
        (0..self.shadow.len()).into_par_iter().map(|point| depth(point) as f32).collect()
    }

    /// The transpose of the derivative of [`Surroundings::shadow_depths`].
    pub(super) fn spread_shadow_depths(&self, rays: &Rays, values: &[f64], into: &mut [f64]) {
        let size = values.len().div_ceil(PARTS).max(1);
        let part = |(part, values): (usize, &[f64])| {
            let mut sums = vec![0.0; into.len()];
            for (number, value) in values.iter().enumerate().filter(|(_, value)| **value != 0.0) {
                let origin = self.shadow.point(part * size + number);
                rays.spread_depth(Ray { origin, direction: self.sun }, *value, &mut sums);
            }
            sums
        };
        let parts: Vec<_> = values.par_chunks(size).enumerate().map(part).collect();
        add_all(into, &parts);
    }

    /// What a ray sees that meets no more cloud.
    pub(super) fn outside(&self, ray: &Ray, shadow_depths: &[f32]) -> Outside {
        let rise = ray.direction.z;
        let above = self.air_above(ray.origin.z);
        if rise >= 0.0 {
            return Outside { air: self.air_light(ray, above, 0.0), ..Outside::default() };
        }
        let ground = self.surface.altitude;
        let depth = self.air_above(ground);
        let mut outside = Outside { air: self.air_light(ray, above, depth), ..Outside::default() };
        if !self.surface.is_black() {
            outside.foot = ray.at((ground - ray.origin.z) / rise);
            let reflectance = self.surface.reflectance(-ray.direction, self.sun) * self.sun.z;
            let air = depth / self.sun.z + (depth - above) / -rise;
            let cloud = self.shadow.interpolate(shadow_depths, outside.foot);
            outside.ground = reflectance * (-air - cloud).exp();
        }
        outside
    }

    /// Add what follows from the derivative by what comes from outside, by shadow depths.
    pub(super) fn spread(&self, outside: &Outside, value: f64, by_shadow: &mut [f64]) {
        if outside.ground != 0.0 {
            self.shadow.spread(by_shadow, outside.foot, -value * outside.ground);
        }
    }

    /// Light that the air before a point of a ray scatters into it.
    pub(super) fn before(&self, ray: &Ray, end: f64) -> f64 {
        self.air_light(ray, self.air_above(ray.origin.z), self.air_above(ray.at(end).z))
    }

    /// Sunlight that is scattered once into a ray, between two depths of air above: the
    /// integral of `exp(-u / sun) exp(-|u - from| / slope) / slope` over the depth u.
    fn air_light(&self, ray: &Ray, from: f64, to: f64) -> f64 {
        if self.air.is_empty() || ray.direction.z == 0.0 {
            return 0.0;
        }
        let slope = ray.direction.z.abs();
        let density = self.air.phase_function.density(ray.direction.dot(self.sun));
        let (rate, span) = (1.0 / self.sun.z + (to - from).signum() / slope, to - from);
        // The mean of exp(-rate t) over t from 0 to the span.
        let x = -rate * span;
        let mean = if x.abs() < 1e-9 { 1.0 } else { x.exp_m1() / x };
        density / slope * (-from / self.sun.z).exp() * span.abs() * mean
    }

    /// What comes in through the faces of the grid in an octant, seen from their middles.
    pub(super) fn incoming(
        &self,
        lattice: &Lattice,
        octant: &Octant,
        shadow_depths: &[f32],
    ) -> Faces {
        let mut faces = Faces::dark(lattice, octant);
        self.each_face(lattice, octant, |axis, face, n, ray| {
            let count = octant.ordinates;
            let values = [&mut faces.x, &mut faces.y, &mut faces.z];
            let radiance = self.outside(&ray, shadow_depths).radiance();
            values.into_iter().nth(axis).expect("three axes")[face * 3 * count + n] =
                radiance as f32;
        });
        faces
    }

    /// The transpose of the derivative of [`Surroundings::incoming`], from the adjoint
    /// radiance that leaves through the same faces.
    pub(super) fn spread_incoming(
        &self,
        lattice: &Lattice,
        octant: &Octant,
        shadow_depths: &[f32],
        leaving: &Faces,
        by_shadow: &mut [f64],
    ) {
        let spacing = lattice.grid.spacing;
        self.each_face(lattice, octant, |axis, face, n, ray| {
            let leaving = [&leaving.x, &leaving.y, &leaving.z][axis];
            let adjoint = leaving[face * 3 * octant.ordinates + n] * octant.weights[n];
            let streaming = f64::from(octant.cosines[axis][n]) / spacing[axis];
            let outside = self.outside(&ray, shadow_depths);
            self.spread(&outside, f64::from(adjoint) * streaming, by_shadow);
        });
    }

    /// Call for each face that the light of an octant comes in through, and each ordinate:
    /// with the axis, the number of the face, the ordinate, and the ray that looks out.
    fn each_face(
        &self,
        lattice: &Lattice,
        octant: &Octant,
        mut call: impl FnMut(usize, usize, usize, Ray),
    ) {
        let (grid, signs) = (&lattice.grid, octant.signs.map(f64::from));
        let [nz, ny, nx] = grid.shape;
        let axes: &[usize] = if lattice.boundary == Boundary::Open { &[0, 1, 2] } else { &[2] };
        for axis in axes {
            let (rows, cols) = [(nz, ny), (nz, nx), (ny, nx)][*axis];
            for face in 0..rows * cols {
                let (row, col) = ((face / cols) as f64 + 0.5, (face % cols) as f64 + 0.5);
                let far = if signs[*axis] > 0.0 { 0.0 } else { [nx, ny, nz][*axis] as f64 };
                let place = match axis {
                    0 => DVec3::new(far, col, row),
                    1 => DVec3::new(col, far, row),
                    _ => DVec3::new(col, row, far),
                };
                let origin = grid.origin + grid.spacing * place;
                for n in 0..octant.ordinates {
                    let component = |axis: usize| -signs[axis] * f64::from(octant.cosines[axis][n]);
                    let direction = DVec3::new(component(0), component(1), component(2));
                    call(*axis, face, n, Ray { origin, direction });
                }
            }
        }
    }
}

impl Shadow {
    /// Points as dense as the cells, wherever the grid throws a shadow.
    fn new(lattice: &Lattice, sun: DVec3, altitude: f64) -> Self {
        let grid = &lattice.grid;
        let periodic = lattice.boundary == Boundary::Periodic;
        let fall = |z: f64| (altitude - z) / sun.z * sun;
        let (mut lower, mut upper) = (grid.lower(), grid.upper());
        if !periodic {
            let falls = [fall(grid.lower().z), fall(grid.upper().z)];
            lower += falls[0].min(falls[1]);
            upper += falls[0].max(falls[1]);
        }
        let count = |axis: usize| {
            let cells = ((upper[axis] - lower[axis]) / grid.spacing[axis]).round() as usize;
            if periodic { cells.max(1) } else { cells + 1 }
        };
        let origin = DVec3::new(lower.x, lower.y, altitude);
        Self { origin, spacing: grid.spacing, rows: count(1), cols: count(0), periodic }
    }

    fn len(&self) -> usize {
        self.rows * self.cols
    }

    fn point(&self, number: usize) -> DVec3 {
        let (row, col) = (number / self.cols, number % self.cols);
        self.origin + self.spacing * DVec3::new(col as f64, row as f64, 0.0)
    }

    /// The four points around a place, and their weights; no weight beyond the lattice.
    fn around(&self, foot: DVec3) -> [(usize, f64); 4] {
        let at = (foot - self.origin) / self.spacing;
        let along = |x: f64, count: usize| {
            let (first, part) = (x.floor(), x - x.floor());
            [(first, 1.0 - part), (first + 1.0, part)].map(|(index, weight)| {
                let count = count as f64;
                if self.periodic {
                    (index.rem_euclid(count) as usize, weight)
                } else if (0.0..count).contains(&index) {
                    (index as usize, weight)
                } else {
                    (0, 0.0)
                }
            })
        };
        let (cols, rows) = (along(at.x, self.cols), along(at.y, self.rows));
        [(0, 0), (0, 1), (1, 0), (1, 1)]
            .map(|(row, col)| (rows[row].0 * self.cols + cols[col].0, rows[row].1 * cols[col].1))
    }

    fn interpolate(&self, depths: &[f32], foot: DVec3) -> f64 {
        self.around(foot).map(|(point, weight)| weight * f64::from(depths[point])).iter().sum()
    }

    fn spread(&self, by_depth: &mut [f64], foot: DVec3, value: f64) {
        for (point, weight) in self.around(foot) {
            by_depth[point] += weight * value;
        }
    }
}
