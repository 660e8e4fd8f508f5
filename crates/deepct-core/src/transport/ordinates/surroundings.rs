//! Radiance that enters the cells from outside: sunlight scattered by the molecular atmosphere or
//! reflected by the surface, and light from the cloud that the surface reflects back.
//!
//! The cloud shadows the surface and illuminates it. The illumination is an unknown of the solution
//! ([`super::diffuse`]): the radiance that leaves the cells downwards, minus that of the clear
//! scene, is distributed over points of the surface, from which it is reflected isotropically. Both
//! operations use the same weights, so that each is the transpose of the other. Light of the cloud
//! that the surrounding molecular atmosphere would scatter back is neglected.

mod tangent;

use super::beam::{PARTS, Rays};
use super::derivative::ByMedium;
use super::lattice::Lattice;
use super::quadrature::{Octant, Quadrature, gauss_legendre};
use super::sky::Sky;
use super::surface_points::{Corners, SurfacePoints};
use super::sweep::Faces;
use crate::error::Result;
use crate::math::{DVec3, Ray};
use crate::memory;
use crate::scene::{Boundary, Scene, Surface};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// Spacing of the points at which the cloud's light on the surface is evaluated, relative to the
/// height of the bottom of the grid above the surface, by which this light is blurred.
const BLUR: f64 = 0.25;
/// Margin around the grid in which the cloud's light on the surface is evaluated, relative to the
/// height of the top of the grid above the surface.
const REACH: f64 = 2.0;

/// Spacing of the points at which the shadow is evaluated, relative to that of the voxels.
const SHADOW_STEP: f64 = 0.25;
/// Number of vertical direction components at which the light of the molecular atmosphere is
/// evaluated for an ordinate.
const BIN_NODES: usize = 6;

/// Memory for a point of the surface, with the derivatives (bytes).
const POINT_BYTES: f64 = 64.0;

/// Molecular atmosphere and surface, illuminated by the Sun.
#[derive(Debug)]
pub(super) struct Surroundings {
    sky: Sky,
    surface: Surface,
    /// Direction towards the Sun.
    sun: DVec3,
    /// Points at which the cloud's shadow, and its light, are evaluated.
    shadow: SurfacePoints,
    lit: SurfacePoints,
    /// By octant, [`number`]: radiance that enters from the molecular atmosphere through each face,
    /// in the order of [`each_face`], and, for upward octants, the points of the surface from which
    /// the rest comes.
    air: [Vec<f32>; 8],
    feet: [Vec<SurfaceHit>; 8],
    /// Minus the irradiance of the surface by the clear sky behind the cells.
    unclouded: Vec<f32>,
}

/// Effect of a cloud on the surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct OnSurface<'a> {
    /// Share of the direct sunlight that it blocks.
    pub(super) shade: &'a [f32],
    /// Irradiance that it adds.
    pub(super) irradiance: &'a [f32],
}

/// Derivatives with respect to the effect of a cloud on the surface.
#[derive(Debug, Clone)]
pub(super) struct BySurface {
    pub(super) shade: Vec<f64>,
    pub(super) irradiance: Vec<f64>,
}

/// Radiance that arrives along a ray from outside, for a Sun of unit irradiance.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Outside {
    /// Light of the molecular atmosphere, including that reflected by the surface.
    air: f64,
    /// Sunlight reflected by the surface and attenuated by the molecular atmosphere: in the shadow
    /// of the cloud, and without a cloud.
    sunlight: f64,
    unshaded: f64,
    /// Light of the cloud reflected by the surface, and its ratio to the irradiance of the surface
    /// by the cloud.
    cloud: f64,
    share: f64,
    /// Position on the surface.
    foot: DVec3,
}

impl Outside {
    pub(super) fn radiance(&self) -> f64 {
        self.air + self.sunlight + self.cloud
    }
}

impl Surroundings {
    /// # Errors
    /// A Sun so low, or a surface so far below, that the points do not fit into the memory.
    pub(super) fn new(scene: &Scene, lattice: &Lattice, quadrature: &Quadrature) -> Result<Self> {
        let (sun, surface) = (scene.sun.towards(), scene.surface);
        let shadow = shadow_points(lattice, sun, surface.altitude);
        let lit = lit_points(lattice, surface.altitude);
        let points = shadow.count() + lit.count();
        memory::check("memory for the shadow of a low Sun on the surface", points, POINT_BYTES)?;
        let mut surroundings = Self {
            sky: Sky::new(scene),
            surface,
            sun,
            shadow,
            lit,
            air: Default::default(),
            feet: Default::default(),
            unclouded: Vec::new(),
        };
        if !surroundings.is_dark() {
            for octant in &quadrature.octants {
                let (air, feet) = surroundings.through_faces(lattice, octant);
                surroundings.air[number(octant)] = air;
                surroundings.feet[number(octant)] = feet;
            }
        }
        surroundings.unclouded = surroundings.unclouded(lattice, quadrature);
        Ok(surroundings)
    }

    /// Whether no light enters from outside.
    pub(super) fn is_dark(&self) -> bool {
        self.sky.is_empty() && self.surface.is_black()
    }

    /// Whether there is a molecular atmosphere.
    pub(super) fn has_air(&self) -> bool {
        !self.sky.is_empty()
    }

    /// Number of points at which the cloud's light on the surface is evaluated; 0 if the surface
    /// does not reflect it.
    pub(super) fn lit_points(&self) -> usize {
        if self.surface.albedo == 0.0 { 0 } else { self.lit.len() }
    }

    /// Optical depth of the molecular atmosphere towards the Sun, from an altitude (km).
    pub(super) fn sun_depth(&self, altitude: f64) -> f64 {
        self.sky.above(altitude) / self.sun.z
    }

    /// Transmittance of the molecular atmosphere between two points of a ray.
    pub(super) fn transmittance(&self, ray: &Ray, from: f64, to: f64) -> f64 {
        self.sky.transmittance(ray, from, to)
    }

    /// Share of the direct sunlight that the cloud blocks at each point of the surface.
    pub(super) fn shade(&self, rays: &Rays) -> Vec<f32> {
        if self.surface.is_black() {
            return Vec::new();
        }
        let depth =
            |point| rays.depth(Ray { origin: self.shadow.point(point), direction: self.sun });
        let shade = |point| -(-depth(point)).exp_m1() as f32;
        (0..self.shadow.len()).into_par_iter().map(shade).collect()
    }

    /// Transpose of the derivative of [`Surroundings::shade`] at the values `shade`.
    pub(super) fn spread_shade(
        &self,
        rays: &Rays,
        shade: &[f32],
        values: &[f64],
        into: &mut ByMedium,
    ) {
        let size = values.len().div_ceil(PARTS).max(1);
        let part = |(part, values): (usize, &[f64])| {
            let mut sums = ByMedium::new(rays);
            for (number, value) in values.iter().enumerate().filter(|(_, value)| **value != 0.0) {
                let point = part * size + number;
                let ray = Ray { origin: self.shadow.point(point), direction: self.sun };
                rays.spread_depth(ray, value * (1.0 - f64::from(shade[point])), &mut sums);
            }
            sums
        };
        let parts: Vec<_> = values.par_chunks(size).enumerate().map(part).collect();
        parts.iter().for_each(|part| into.add(part));
    }

    /// Average the shade around each point, because the faces of voxels are wider than the spacing
    /// of the points. This operation is its own transpose.
    pub(super) fn blurred<T: Copy + Into<f64>>(&self, shade: &[T]) -> Vec<f64> {
        self.shadow.blurred(shade)
    }

    /// Radiance from outside along a ray that meets no further cloud.
    pub(super) fn outside(&self, ray: &Ray, on_surface: OnSurface) -> Outside {
        let mut outside = self.unclouded_outside(ray);
        if outside.unshaded != 0.0 {
            outside.sunlight *= 1.0 - self.shadow.interpolate(on_surface.shade, outside.foot);
        }
        if outside.share != 0.0 && !on_surface.irradiance.is_empty() {
            let irradiance = self.lit.interpolate(on_surface.irradiance, outside.foot);
            outside.cloud = outside.share * irradiance;
        }
        outside
    }

    /// Radiance along a ray without a cloud.
    fn unclouded_outside(&self, ray: &Ray) -> Outside {
        let rise = ray.direction.z;
        let above = self.sky.above(ray.origin.z);
        if rise >= 0.0 {
            let air = self.sky.light(ray.direction, above, 0.0);
            return Outside { air, ..Outside::default() };
        }
        let ground = self.surface.altitude;
        let depth = self.sky.above(ground);
        let air = self.sky.light(ray.direction, above, depth);
        if self.surface.is_black() {
            return Outside { air, ..Outside::default() };
        }
        let passed = ((depth - above) / rise).exp();
        let reflectance = self.surface.reflectance(-ray.direction, self.sun) * self.sun.z;
        let share = self.surface.albedo / PI * passed;
        let sunlight = passed * reflectance * (-depth / self.sun.z).exp();
        Outside {
            air: air + share * self.sky.irradiance,
            sunlight,
            unshaded: sunlight,
            cloud: 0.0,
            share,
            foot: ray.at((ground - ray.origin.z) / rise),
        }
    }

    /// Add the derivatives with respect to the effect of the cloud on the surface, where `value` is
    /// the derivative with respect to the radiance from outside.
    pub(super) fn spread(&self, outside: &Outside, value: f64, into: &mut BySurface) {
        if outside.unshaded != 0.0 {
            self.shadow.spread(&mut into.shade, outside.foot, -value * outside.unshaded);
        }
        if outside.share != 0.0 {
            self.lit.spread(&mut into.irradiance, outside.foot, value * outside.share);
        }
    }

    /// Radiance that the molecular atmosphere in front of a point of a ray scatters into it.
    pub(super) fn before(&self, ray: &Ray, end: f64) -> f64 {
        let [from, to] = [ray.origin.z, ray.at(end).z].map(|altitude| self.sky.above(altitude));
        self.sky.light(ray.direction, from, to)
    }

    /// Radiance that enters through the faces of the grid in an octant, evaluated at their centres,
    /// without the light of the cloud that the surface reflects.
    pub(super) fn incoming(
        &self,
        lattice: &Lattice,
        octant: &Octant,
        blurred_shade: &[f32],
    ) -> Faces {
        let mut faces = Faces::dark(lattice, octant);
        let mut air = self.air[number(octant)].iter();
        let mut feet = self.feet[number(octant)].iter();
        each_face(lattice, octant, |place, _| {
            let air = air.next().expect("one value for each face and ordinate");
            let sunlight = feet.next().map_or(0.0, |foot| foot.sunlight(blurred_shade));
            *place.mean(&mut faces, octant) = air + sunlight;
        });
        faces
    }

    /// Transpose of the derivative of [`Surroundings::incoming`] with respect to the blurred shade,
    /// applied to the adjoint radiance that leaves through the same faces.
    pub(super) fn spread_incoming(
        &self,
        lattice: &Lattice,
        octant: &Octant,
        leaving: &mut Faces,
        into: &mut [f64],
    ) {
        let spacing = lattice.grid.spacing;
        let mut feet = self.feet[number(octant)].iter();
        each_face(lattice, octant, |place, _| {
            let Some(foot) = feet.next() else { return };
            let FacePlace { axis, ordinate, .. } = place;
            let adjoint = f64::from(*place.mean(leaving, octant) * octant.weights[ordinate]);
            let streaming = f64::from(octant.cosines[axis][ordinate]) / spacing[axis];
            foot.shadow.spread(into, -adjoint * streaming * f64::from(foot.unshaded));
        });
    }

    /// Add the light of the cloud that the surface reflects, given the irradiance by the cloud, to
    /// the radiance that enters through the faces in an octant.
    pub(super) fn add_reflected(
        &self,
        lattice: &Lattice,
        octant: &Octant,
        irradiance: &[f32],
        faces: &mut Faces,
    ) {
        if irradiance.is_empty() || octant.signs[2] < 0.0 {
            return;
        }
        let mut feet = self.feet[number(octant)].iter();
        each_face(lattice, octant, |place, _| {
            let foot = feet.next().expect("a surface point for each face and ordinate");
            *place.mean(faces, octant) += foot.share * foot.lit.interpolate(irradiance);
        });
    }

    /// Add the irradiance of the surface by the radiance that leaves the faces in an octant, to
    /// which `opposite` is the opposite octant.
    pub(super) fn add_irradiance(
        &self,
        lattice: &Lattice,
        opposite: &Octant,
        leaving: &mut Faces,
        irradiance: &mut [f64],
    ) {
        if irradiance.is_empty() || opposite.signs[2] < 0.0 {
            return;
        }
        let spacing = lattice.grid.spacing;
        let volume = spacing.x * spacing.y * spacing.z;
        let mut feet = self.feet[number(opposite)].iter();
        each_face(lattice, opposite, |place, _| {
            let FacePlace { axis, ordinate, .. } = place;
            let foot = feet.next().expect("a surface point for each face and ordinate");
            let cosine = f64::from(opposite.cosines[axis][ordinate]);
            let section = cosine * volume / spacing[axis] / self.lit.area();
            let radiance = f64::from(*place.mean(leaving, opposite) * opposite.weights[ordinate]);
            let passed = PI / self.surface.albedo * f64::from(foot.share);
            foot.lit.spread(irradiance, section * radiance * passed);
        });
    }

    /// Convert a derivative with respect to the irradiance into the irradiance whose reflection is
    /// the corresponding adjoint radiance.
    pub(super) fn as_irradiance(&self, lattice: &Lattice, by_irradiance: &[f64]) -> Vec<f32> {
        let spacing = lattice.grid.spacing;
        let share = PI / self.surface.albedo * spacing.x * spacing.y * spacing.z / self.lit.area();
        by_irradiance.iter().map(|value| (share * value) as f32).collect()
    }

    /// Constant term of the irradiance by the cloud: minus the clear-sky irradiance that would
    /// reach the surface through the cells.
    pub(super) fn start(&self) -> &[f32] {
        &self.unclouded
    }

    /// Minus the irradiance by the clear sky behind the cells.
    fn unclouded(&self, lattice: &Lattice, quadrature: &Quadrature) -> Vec<f32> {
        let mut sum = vec![0.0; self.lit_points()];
        if !sum.is_empty() && !self.sky.is_empty() {
            for (index, octant) in quadrature.octants.iter().enumerate() {
                if octant.signs[2] > 0.0 {
                    continue;
                }
                let opposite = &quadrature.octants[7 - index];
                let mut leaving = Faces::dark(lattice, octant);
                let mut levels: BTreeMap<(u64, usize), f32> = BTreeMap::new();
                each_face(lattice, opposite, |place, ray| {
                    let back = Ray { direction: -ray.direction, ..ray };
                    let bin = opposite.bins[place.ordinate];
                    let key = (ray.origin.z.to_bits(), place.ordinate);
                    let sky =
                        levels.entry(key).or_insert_with(|| self.air_of_bin(&back, bin) as f32);
                    *place.mean(&mut leaving, octant) = -*sky;
                });
                self.add_irradiance(lattice, opposite, &mut leaving, &mut sum);
            }
        }
        sum.into_iter().map(|value| value as f32).collect()
    }

    /// Radiance that enters from the molecular atmosphere through each face in an octant, and the
    /// points of the surface from which the rest comes.
    fn through_faces(&self, lattice: &Lattice, octant: &Octant) -> (Vec<f32>, Vec<SurfaceHit>) {
        let (mut air, mut feet) = (Vec::new(), Vec::new());
        // All quantities except the position on the surface depend only on altitude and ordinate.
        let mut levels: BTreeMap<(u64, usize), Outside> = BTreeMap::new();
        each_face(lattice, octant, |FacePlace { ordinate, .. }, ray| {
            let key = (ray.origin.z.to_bits(), ordinate);
            let outside = levels.entry(key).or_insert_with(|| Outside {
                air: self.air_of_bin(&ray, octant.bins[ordinate]),
                ..self.unclouded_outside(&ray)
            });
            air.push(outside.air as f32);
            if ray.direction.z < 0.0 {
                let place = ray.at((self.surface.altitude - ray.origin.z) / ray.direction.z);
                feet.push(SurfaceHit {
                    unshaded: outside.sunlight as f32,
                    share: outside.share as f32,
                    shadow: Corners::new(&self.shadow, place),
                    lit: Corners::new(&self.lit, place),
                });
            }
        });
        (air, feet)
    }

    /// Light of the molecular atmosphere, averaged over the vertical components that an ordinate
    /// represents: the light increases towards the horizon, near which there are few ordinates.
    fn air_of_bin(&self, ray: &Ray, [low, high]: [f64; 2]) -> f64 {
        if self.sky.is_empty() {
            return self.unclouded_outside(ray).air;
        }
        let flat = ray.direction.x.hypot(ray.direction.y);
        let light = |(x, weight): (f64, f64)| {
            let rise = (low + x * (high - low)).clamp(1e-4, 1.0 - 1e-9);
            let scale = (1.0 - rise * rise).sqrt() / flat;
            let direction = DVec3::new(
                scale * ray.direction.x,
                scale * ray.direction.y,
                rise.copysign(ray.direction.z),
            );
            weight * self.unclouded_outside(&Ray { direction, ..*ray }).air
        };
        let rule = gauss_legendre(BIN_NODES);
        let both = rule.iter().flat_map(|(x, w)| [-x, *x].map(|x| (0.5 + 0.5 * x, 0.5 * w)));
        both.map(light).sum()
    }
}

/// Point of the surface from which a ray through a face comes, and the light from there.
#[derive(Debug, Clone, Copy)]
struct SurfaceHit {
    /// Reflected sunlight without the shadow of a cloud.
    unshaded: f32,
    /// Ratio of the radiance that arrives to the irradiance of the surface by the cloud.
    share: f32,
    shadow: Corners,
    lit: Corners,
}

impl SurfaceHit {
    /// Reflected sunlight in the shadow of a cloud.
    #[inline]
    fn sunlight(&self, blurred_shade: &[f32]) -> f32 {
        if self.unshaded == 0.0 {
            return 0.0;
        }
        self.unshaded * (1.0 - self.shadow.interpolate(blurred_shade))
    }
}

/// Index of an octant, from the signs of its directions.
fn number(octant: &Octant) -> usize {
    let [east, north, up] = octant.signs.map(|sign| usize::from(sign > 0.0));
    east + 2 * north + 4 * up
}

/// A face of the grid, and an ordinate.
#[derive(Debug, Clone, Copy)]
struct FacePlace {
    axis: usize,
    face: usize,
    ordinate: usize,
}

impl FacePlace {
    /// Mean radiance through the face in the direction of the ordinate.
    #[inline]
    fn mean<'a>(&self, faces: &'a mut Faces, octant: &Octant) -> &'a mut f32 {
        let values = match self.axis {
            0 => &mut faces.x,
            1 => &mut faces.y,
            _ => &mut faces.z,
        };
        &mut values[self.face * 3 * octant.ordinates + self.ordinate]
    }
}

/// Run `call` for each ordinate and each face through which the light of an octant enters, with the
/// ray from the face outwards, opposite to the light.
fn each_face(lattice: &Lattice, octant: &Octant, mut call: impl FnMut(FacePlace, Ray)) {
    let (grid, signs) = (&lattice.grid, octant.signs.map(f64::from));
    let [nz, ny, nx] = grid.shape;
    let axes: &[usize] = if lattice.boundary == Boundary::Open { &[0, 1, 2] } else { &[2] };
    for &axis in axes {
        let (rows, cols) = [(nz, ny), (nz, nx), (ny, nx)][axis];
        for face in 0..rows * cols {
            let (row, col) = ((face / cols) as f64 + 0.5, (face % cols) as f64 + 0.5);
            let far = if signs[axis] > 0.0 { 0.0 } else { [nx, ny, nz][axis] as f64 };
            let place = match axis {
                0 => DVec3::new(far, col, row),
                1 => DVec3::new(col, far, row),
                _ => DVec3::new(col, row, far),
            };
            let origin = grid.origin + grid.spacing * place;
            for ordinate in 0..octant.ordinates {
                let component =
                    |axis: usize| -signs[axis] * f64::from(octant.cosines[axis][ordinate]);
                let direction = DVec3::new(component(0), component(1), component(2));
                call(FacePlace { axis, face, ordinate }, Ray { origin, direction });
            }
        }
    }
}

/// Points denser than the voxels, wherever the grid may shade the surface.
fn shadow_points(lattice: &Lattice, sun: DVec3, altitude: f64) -> SurfacePoints {
    let grid = &lattice.grid;
    let periodic = lattice.boundary == Boundary::Periodic;
    let fall = |z: f64| (altitude - z) / sun.z * sun;
    let (mut lower, mut upper) = (grid.lower(), grid.upper());
    if !periodic {
        let falls = [fall(grid.lower().z), fall(grid.upper().z)];
        lower += falls[0].min(falls[1]);
        upper += falls[0].max(falls[1]);
    }
    lower.z = altitude;
    SurfacePoints::new(lower, upper, SHADOW_STEP * grid.spacing, periodic)
}

/// Points below and around the grid, spaced according to the resolution of the light there.
fn lit_points(lattice: &Lattice, altitude: f64) -> SurfacePoints {
    let grid = &lattice.grid;
    let periodic = lattice.boundary == Boundary::Periodic;
    let wide = DVec3::splat(if periodic { 0.0 } else { REACH * (grid.upper().z - altitude) });
    let wanted = grid.spacing.max(DVec3::splat(BLUR * (grid.lower().z - altitude)));
    let lower = DVec3 { z: altitude, ..grid.lower() - wide };
    SurfacePoints::new(lower, grid.upper() + wide, wanted, periodic)
}
