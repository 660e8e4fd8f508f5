//! Unscattered sunlight.

mod tangent;

pub(super) use tangent::sun_depth_change;

use super::derivative::ByMedium;
use super::lattice::{Lattice, Segment, basis};
use super::optics::Optics;
use super::quadrature::gauss_legendre;
use crate::math::{DVec3, GAUSS_TWO, Ray, corner_weights};
use rayon::prelude::*;

/// Optical depth beyond which no light is transmitted.
const DARK: f64 = 40.0;
/// Number of parts into which the work of one derivative is divided, each with its own array.
pub(super) const PARTS: usize = 4;
/// Nodes and weights of the three-point Gauss-Legendre rule on [0, 1].
pub(super) const THREE: [(f64, f64); 3] = [
    (0.112_701_665_379_258_3, 5.0 / 18.0),
    (0.5, 8.0 / 18.0),
    (0.887_298_334_620_741_7, 5.0 / 18.0),
];

/// Field through which rays are traced.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rays<'a> {
    pub(super) lattice: &'a Lattice,
    pub(super) optics: &'a Optics,
    /// Extinction by voxel (1/km).
    pub(super) extinction: &'a [f32],
    /// Points of a cell at which sunlight is evaluated, from 0 to 1 along each axis, with their
    /// weights.
    pub(super) cubature: &'a [(DVec3, f64)],
}

impl Rays<'_> {
    /// Optical depth of a part of a ray, including the forward peak.
    #[inline]
    fn unscaled_depth(&self, segment: &Segment) -> f64 {
        let reach = segment.to - segment.from;
        let at = |x| segment.from + x * reach;
        let value = |x| self.lattice.value_in(self.extinction, segment.number, at(x));
        segment.length * 0.5 * (value(GAUSS_TWO[0]) + value(GAUSS_TWO[1]))
    }

    /// Delta-M scaled optical depth of a part of a ray.
    #[inline]
    fn depth_of(&self, segment: &Segment) -> f64 {
        f64::from(self.optics.delta_m_scaling(segment.number)) * self.unscaled_depth(segment)
    }

    /// Delta-M scaled optical depth along a ray, which is not followed beyond [`DARK`].
    pub(super) fn depth(&self, ray: Ray) -> f64 {
        let mut depth = 0.0;
        for segment in self.lattice.segments(ray) {
            depth += self.depth_of(&segment);
            if depth > DARK {
                break;
            }
        }
        depth
    }

    /// Add to a derivative the contribution of `value`, the derivative with respect to the optical
    /// depth along a ray.
    pub(super) fn spread_depth(&self, ray: Ray, value: f64, into: &mut ByMedium) {
        for segment in self.lattice.segments(ray) {
            let scaling = f64::from(self.optics.delta_m_scaling(segment.number));
            let weight = 0.5 * value * scaling * segment.length;
            for x in GAUSS_TWO {
                let at = segment.from + x * (segment.to - segment.from);
                self.lattice.spread_in(&mut into.extinction, segment.number, at, weight);
            }
            let row = self.optics.row(segment.number);
            into.scaling[row] += value * self.unscaled_depth(&segment);
        }
    }

    /// Optical depths towards the Sun from eight points of each active cell; `air` returns that of
    /// the molecular atmosphere from an altitude (km).
    pub(super) fn sun_depths(&self, sun: DVec3, air: impl Fn(f64) -> f64 + Sync) -> Vec<[f32; 8]> {
        let from = |slot: usize| {
            std::array::from_fn(|point| {
                let ray = self.sun_ray(slot, point, sun);
                (self.depth(ray) + air(ray.origin.z)) as f32
            })
        };
        (0..self.lattice.len()).into_par_iter().map(from).collect()
    }

    /// Transpose of the derivative of [`Rays::sun_depths`].
    pub(super) fn spread_sun_depths(&self, sun: DVec3, values: &[[f32; 8]], into: &mut ByMedium) {
        let size = values.len().div_ceil(PARTS).max(1);
        let parts: Vec<ByMedium> = (0..PARTS)
            .into_par_iter()
            .map(|part| {
                let mut sums = ByMedium::new(self);
                let first = (part * size).min(values.len());
                for (offset, values) in values[first..].iter().take(size).enumerate() {
                    for (point, value) in values.iter().enumerate().filter(|(_, v)| **v != 0.0) {
                        let ray = self.sun_ray(first + offset, point, sun);
                        self.spread_depth(ray, f64::from(*value), &mut sums);
                    }
                }
                sums
            })
            .collect();
        parts.iter().for_each(|part| into.add(part));
    }

    fn sun_ray(&self, slot: usize, point: usize, sun: DVec3) -> Ray {
        let at = DVec3::new(GAUSS_TWO[point & 1], GAUSS_TWO[point >> 1 & 1], GAUSS_TWO[point >> 2]);
        Ray { origin: self.lattice.point(slot, at), direction: sun }
    }

    /// Mean and slopes of the sunlight removed from the beam in each active cell, for a Sun of unit
    /// irradiance.
    pub(super) fn stopped(&self, depths: &[[f32; 8]]) -> Vec<[f32; 4]> {
        let stopped = |slot: usize| {
            let mut sums = [0.0; 4];
            for &(at, weight) in self.cubature {
                let value = weight * self.lattice.value(self.extinction, slot, at);
                let light = value * (-sun_depth(&depths[slot], at)).exp();
                for (sum, function) in sums.iter_mut().zip(basis(at)) {
                    *sum += light * function;
                }
            }
            sums.map(|sum| sum as f32)
        };
        (0..self.lattice.len()).into_par_iter().map(stopped).collect()
    }

    /// Transpose of the derivative of [`Rays::stopped`], with respect to the voxels and the depths.
    pub(super) fn spread_stopped(
        &self,
        depths: &[[f32; 8]],
        values: &[[f32; 4]],
        into: &mut [f64],
        by_depth: &mut [[f32; 8]],
    ) {
        for (slot, values) in values.iter().enumerate() {
            for &(at, weight) in self.cubature {
                let value: f64 =
                    basis(at).iter().zip(values).map(|(b, value)| b * f64::from(*value)).sum();
                let light = weight * value * (-sun_depth(&depths[slot], at)).exp();
                let stopped = light * self.lattice.value(self.extinction, slot, at);
                self.lattice.spread(into, slot, at, light);
                spread_sun_depth(&mut by_depth[slot], &depths[slot], at, -stopped);
            }
        }
    }
}

/// Add all `parts` to `into`.
pub(super) fn add_all(into: &mut [f64], parts: &[Vec<f64>]) {
    for part in parts {
        into.iter_mut().zip(part).for_each(|(sum, value)| *sum += value);
    }
}

/// Points of a cell and their weights; the number of points from bottom to top increases with the
/// optical `depth` of the cell for direct sunlight.
pub(super) fn cubature(depth: f64) -> Vec<(DVec3, f64)> {
    let half = (0.25 * depth + 1.0).ceil().clamp(2.0, 8.0) as usize;
    let rule = gauss_legendre(2 * half);
    let upward = rule.iter().flat_map(|(x, w)| [-0.5, 0.5].map(|side| (0.5 + side * x, 0.5 * w)));
    upward
        .flat_map(|(z, c)| {
            (0..9).map(move |n| {
                let [(x, a), (y, b)] = [THREE[n % 3], THREE[n / 3]];
                (DVec3::new(x, y, z), a * b * c)
            })
        })
        .collect()
}

/// Optical depth towards the Sun at a position in a cell: linear along each axis, and not negative.
#[inline]
pub(super) fn sun_depth(depths: &[f32; 8], at: DVec3) -> f64 {
    linear_sun_depth(depths, at).max(0.0)
}

/// The same without the limit: beyond the points at which it is known, it may fall below zero.
#[inline]
fn linear_sun_depth(depths: &[f32; 8], at: DVec3) -> f64 {
    let weights = corner_weights((at - GAUSS_TWO[0]) / (GAUSS_TWO[1] - GAUSS_TWO[0]));
    depths.iter().zip(weights).map(|(depth, weight)| weight * f64::from(*depth)).sum()
}

/// Transpose of the derivative of [`sun_depth`] at `depths`.
#[inline]
pub(super) fn spread_sun_depth(into: &mut [f32; 8], depths: &[f32; 8], at: DVec3, value: f64) {
    if linear_sun_depth(depths, at) <= 0.0 {
        return;
    }
    let weights = corner_weights((at - GAUSS_TWO[0]) / (GAUSS_TWO[1] - GAUSS_TWO[0]));
    for (sum, weight) in into.iter_mut().zip(weights) {
        *sum += (weight * value) as f32;
    }
}
