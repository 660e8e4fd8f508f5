//! Scattering as treated by the solver: the forward peak counts as no collision.
//!
//! The fraction of the scattering beyond the last harmonic is treated as exactly forward (delta-M:
//! Wiscombe 1977). Its effect on light scattered once is corrected in the camera (TMS: Nakajima and
//! Tanaka 1988).

use super::broadened::{Broadened, LEVELS, place};
use super::lattice::{Lattice, index};
use super::quadrature::{Quadrature, degrees, degrees_of};
use crate::grid::Grid;
use crate::optics::{PhaseFunction, Scattering};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Largest spacing of the angles between which changes of single scattering are interpolated
/// linearly (radians).
const ANGLE_STEP: f64 = 0.002;

/// Effect of the forward peak on single scattering at angles around that seen by a camera: see
/// [`Optics::changes`].
#[derive(Debug, Clone)]
pub(super) struct Changes {
    least: f64,
    step: f64,
    /// `[angle][phase function][level]`.
    values: Vec<Vec<[f64; LEVELS]>>,
}

impl Changes {
    /// Index of the tabulated angle below that of a cosine, and fraction of the distance to the
    /// next one.
    fn place(&self, cosine: f64) -> (usize, f64) {
        let angle = (-cosine).clamp(-1.0, 1.0).acos();
        let place = ((angle - self.least) / self.step).clamp(0.0, (self.values.len() - 1) as f64);
        let node = (place as usize).min(self.values.len() - 2);
        (node, place - node as f64)
    }
}

/// Optical properties by active voxel; a uniform medium has a single row for all voxels.
#[derive(Debug)]
pub(super) struct Optics {
    harmonics: usize,
    /// Scattered light over extinction, `[row][harmonic]`, without the forward peak.
    scattered: Vec<f32>,
    /// Delta-M scaling factor (extinction without the forward peak over extinction), by row.
    scaling: Vec<f32>,
    /// Phase functions that occur in some cell, and the effect of the forward peak on each.
    phase_functions: Vec<(PhaseFunction, Broadened)>,
    /// Optical depth of the forward peak over the delta-M scaled optical depth, by row.
    by_peak: Vec<f64>,
    /// Indices of the phase functions, and share of the extinction that each scatters, by row.
    shares: Vec<Vec<(usize, f64)>>,
}

impl Optics {
    pub(super) fn new(
        scattering: &Scattering,
        voxels: &Grid,
        lattice: &Lattice,
        quadrature: &Quadrature,
    ) -> Self {
        let rows = match scattering {
            Scattering::Uniform { .. } => lattice.active().len().min(1),
            Scattering::Droplets { .. } => lattice.active().len(),
        };
        let of_voxels = |row: usize| {
            let corners = lattice.voxels_of(row);
            let mut shares = BTreeMap::new();
            for voxel in corners {
                for (number, share) in scattering.shares(index(voxels, *voxel as usize)) {
                    *shares.entry(number).or_insert(0.0) += share / corners.len() as f64;
                }
            }
            shares.into_iter().filter(|(_, share)| *share > 0.0).collect::<Vec<_>>()
        };
        let mut shares: Vec<_> = (0..rows).map(of_voxels).collect();
        let used: BTreeSet<usize> = shares.iter().flatten().map(|(number, _)| *number).collect();
        let used: Vec<usize> = used.into_iter().collect();
        for (number, _) in shares.iter_mut().flatten() {
            *number = used.partition_point(|other| other < number);
        }
        let (harmonics, count) = (quadrature.harmonics, quadrature.degrees);
        let all = scattering.phase_functions();
        let broaden = |number: &usize| {
            let (broadened, moments) = Broadened::new(all[*number], count);
            ((all[*number].clone(), broadened), moments)
        };
        let (phase_functions, moments): (Vec<_>, Vec<_>) = used.par_iter().map(broaden).unzip();
        let (mut scattered, mut scaling, mut by_peak) = (Vec::new(), Vec::new(), Vec::new());
        for row in &shares {
            let moment = |degree: usize| -> f64 {
                row.iter().map(|(number, share)| share * moments[*number][degree]).sum()
            };
            let peak = moment(count);
            let low: Vec<f32> = (0..=count).map(|degree| (moment(degree) - peak) as f32).collect();
            scaling.push((1.0 - peak) as f32);
            by_peak.push(peak / (1.0 - peak));
            scattered.extend(degrees(harmonics).map(|degree| low[degree]));
        }
        Self { harmonics, scattered, scaling, phase_functions, by_peak, shares }
    }

    /// Scattered light over extinction, by harmonic.
    #[inline]
    pub(super) fn scattered(&self, number: usize) -> &[f32] {
        &self.scattered[self.row(number) * self.harmonics..][..self.harmonics]
    }

    /// Delta-M scaling factor: extinction without the forward peak over extinction.
    #[inline]
    pub(super) fn delta_m_scaling(&self, number: usize) -> f32 {
        self.scaling[self.row(number)]
    }

    /// Effect of the forward peak on single scattering between two angles from exact backscatter
    /// (radians).
    pub(super) fn changes(&self, least: f64, most: f64) -> Changes {
        let steps = ((most - least) / ANGLE_STEP).ceil().max(1.0) as usize;
        let step = ((most - least) / steps as f64).max(1e-9);
        let values = (0..=steps)
            .map(|node| {
                let cosine = -(least + node as f64 * step).cos();
                self.phase_functions.iter().map(|(_, b)| b.change(cosine)).collect()
            })
            .collect();
        Changes { least, step, values }
    }

    /// Compute the densities of all phase functions at a cosine, for [`Optics::density`].
    pub(super) fn densities(&self, cosine: f64, changes: &Changes, into: &mut Vec<[f64; LEVELS]>) {
        let (node, part) = changes.place(cosine);
        let [below, above] = [&changes.values[node], &changes.values[node + 1]];
        let functions = self.phase_functions.iter().zip(below).zip(above);
        into.clear();
        into.extend(functions.map(|(((function, _), below), above)| {
            let density = function.density(cosine);
            let change = |level: usize| (1.0 - part) * below[level] + part * above[level];
            std::array::from_fn(|level| density + change(level))
        }));
    }

    /// Light scattered by the angle of `densities`, over extinction (1/sr), including the forward
    /// peak, where the delta-M scaled optical `depth` of the path before and after the scattering
    /// is given; and the derivative with respect to that depth.
    #[inline]
    pub(super) fn density(
        &self,
        number: usize,
        densities: &[[f64; LEVELS]],
        depth: f64,
    ) -> (f64, f64) {
        let row = self.row(number);
        let by_peak = self.by_peak[row];
        let (level, part, slope) = place(by_peak * depth);
        let (mut value, mut change) = (0.0, 0.0);
        for (number, share) in &self.shares[row] {
            let [below, above] = [densities[*number][level], densities[*number][level + 1]];
            value += share * ((1.0 - part) * below + part * above);
            change += share * (above - below);
        }
        (value, change * slope * by_peak)
    }

    fn row(&self, number: usize) -> usize {
        if self.scaling.len() == 1 { 0 } else { number }
    }
}

/// The effective radius (um) of droplets of intermediate size.
const INTERMEDIATE: f64 = 5.0;

/// Delta-M scaling factor, for droplets of intermediate size.
pub(super) fn delta_m_scaling(scattering: &Scattering, zenith_angles: usize) -> f64 {
    let degrees = degrees_of(zenith_angles);
    let (albedo, phase_function) = match scattering {
        Scattering::Uniform { single_scattering_albedo, phase_function } => {
            (*single_scattering_albedo, phase_function)
        }
        Scattering::Droplets { table, .. } => {
            let nodes = table.nodes();
            let below = nodes.partition_point(|node| node.effective_radius < INTERMEDIATE);
            let node = &nodes[below.min(nodes.len() - 1)];
            (node.single_scattering_albedo, &node.phase_function)
        }
    };
    1.0 - albedo * phase_function.legendre_moments(degrees + 1)[degrees]
}
