//! Scattering as treated by the solver: the forward peak counts as no collision.
//!
//! The fraction of the scattering beyond the last harmonic is treated as exactly forward (delta-M:
//! Wiscombe 1977). Its effect on light scattered once is corrected in the camera (TMS: Nakajima and
//! Tanaka 1988).

use super::broadened::{Broadened, LEVELS, place};
use super::derivative::ByMedium;
use super::lattice::{Lattice, index};
use super::quadrature::{Quadrature, degrees};
use crate::grid::Grid;
use crate::optics::{PhaseFunction, Scattering};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::{Arc, OnceLock};

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

/// A phase function with what the solver needs of it.
#[derive(Debug)]
struct Function {
    /// Index in [`Scattering::phase_functions`].
    node: usize,
    phase_function: PhaseFunction,
    /// Effect of the forward peak on single scattering.
    broadened: Broadened,
    /// Legendre moments, of which the last one is the fraction of the forward peak.
    moments: Vec<f64>,
}

/// The phase functions of a medium, each of which is prepared when it first occurs in a cell.
#[derive(Debug)]
pub(super) struct Functions {
    degrees: usize,
    prepared: Vec<(PhaseFunction, OnceLock<Arc<Function>>)>,
}

impl Functions {
    pub(super) fn new(scattering: &Scattering, quadrature: &Quadrature) -> Self {
        let all = scattering.phase_functions().into_iter();
        let prepared = all.map(|function| (function.clone(), OnceLock::new())).collect();
        Self { degrees: quadrature.degrees, prepared }
    }

    fn prepare(&self, node: usize) -> Arc<Function> {
        let (phase_function, prepared) = &self.prepared[node];
        let prepare = || {
            let (broadened, moments) = Broadened::new(phase_function, self.degrees);
            Arc::new(Function { node, phase_function: phase_function.clone(), broadened, moments })
        };
        prepared.get_or_init(prepare).clone()
    }
}

/// Optical properties by active voxel; a uniform medium has a single row for all voxels.
#[derive(Debug)]
pub(super) struct Optics {
    harmonics: usize,
    /// Delta-M scaling factor of droplets of intermediate size.
    pub(super) typical_scaling: f64,
    /// Scattered light over extinction, `[row][harmonic]`, without the forward peak.
    scattered: Vec<f32>,
    /// Delta-M scaling factor (extinction without the forward peak over extinction), by row.
    scaling: Vec<f32>,
    /// Phase functions that occur in some cell.
    functions: Vec<Arc<Function>>,
    /// Optical depth of the forward peak over the delta-M scaled optical depth, by row.
    by_peak: Vec<f64>,
    /// Indices of the phase functions, and share of the extinction that each scatters, row after
    /// row.
    shares: Vec<(usize, f64)>,
    /// First element of each row in `shares`, and their number.
    starts: Vec<usize>,
}

impl Optics {
    pub(super) fn new(
        scattering: &Scattering,
        voxels: &Grid,
        lattice: &Lattice,
        quadrature: &Quadrature,
        functions: &Functions,
    ) -> Self {
        let rows = match scattering {
            Scattering::Uniform { .. } => lattice.active().len().min(1),
            Scattering::Droplets { .. } => lattice.active().len(),
        };
        let of_voxels = |row: usize| {
            let corners = lattice.voxels_of(row);
            let mut shares = BTreeMap::new();
            for voxel in corners {
                let place = index(voxels, *voxel as usize);
                let slopes = scattering.share_derivatives(place);
                // At a node of the table, the share of the next one is 0 but may increase.
                for ((number, share), (_, slope)) in
                    scattering.shares(place).into_iter().zip(slopes)
                {
                    if share > 0.0 || slope != 0.0 {
                        *shares.entry(number).or_insert(0.0) += share / corners.len() as f64;
                    }
                }
            }
            shares.into_iter().collect::<Vec<(usize, f64)>>()
        };
        let rows: Vec<_> = (0..rows).map(of_voxels).collect();
        let used: BTreeSet<usize> = rows.iter().flatten().map(|(number, _)| *number).collect();
        let used: Vec<usize> = used.into_iter().collect();
        let functions: Vec<_> = used.par_iter().map(|node| functions.prepare(*node)).collect();
        let (mut shares, mut starts) = (Vec::new(), vec![0]);
        for row in rows {
            let numbered = |(node, share)| (used.partition_point(|other| *other < node), share);
            shares.extend(row.into_iter().map(numbered));
            starts.push(shares.len());
        }
        let (harmonics, count) = (quadrature.harmonics, quadrature.degrees);
        let (mut scattered, mut scaling, mut by_peak) = (Vec::new(), Vec::new(), Vec::new());
        for ends in starts.windows(2) {
            let row = &shares[ends[0]..ends[1]];
            let moment = |degree: usize| -> f64 {
                row.iter().map(|(number, share)| share * functions[*number].moments[degree]).sum()
            };
            let peak = moment(count);
            let low: Vec<f32> = (0..=count).map(|degree| (moment(degree) - peak) as f32).collect();
            scaling.push((1.0 - peak) as f32);
            by_peak.push(peak / (1.0 - peak));
            scattered.extend(degrees(harmonics).map(|degree| low[degree]));
        }
        let typical_scaling = delta_m_scaling(scattering, count);
        Self { harmonics, typical_scaling, scattered, scaling, functions, by_peak, shares, starts }
    }

    /// Number of rows.
    pub(super) fn rows(&self) -> usize {
        self.scaling.len()
    }

    /// Number of pairs of a row and a phase function that occurs in it.
    pub(super) fn pairs(&self) -> usize {
        self.shares.len()
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
                self.functions.iter().map(|function| function.broadened.change(cosine)).collect()
            })
            .collect();
        Changes { least, step, values }
    }

    /// Compute the densities of all phase functions at a cosine, for [`Optics::density`].
    pub(super) fn densities(&self, cosine: f64, changes: &Changes, into: &mut Vec<[f64; LEVELS]>) {
        let (node, part) = changes.place(cosine);
        let [below, above] = [&changes.values[node], &changes.values[node + 1]];
        let functions = self.functions.iter().zip(below).zip(above);
        into.clear();
        into.extend(functions.map(|((function, below), above)| {
            let density = function.phase_function.density(cosine);
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
        for (number, share) in &self.shares[self.pairs_of(row)] {
            let [below, above] = [densities[*number][level], densities[*number][level + 1]];
            value += share * ((1.0 - part) * below + part * above);
            change += share * (above - below);
        }
        (value, change * slope * by_peak)
    }

    /// Add `value` times the derivative of [`Optics::density`] with respect to the optics.
    #[inline]
    pub(super) fn spread_density(
        &self,
        number: usize,
        densities: &[[f64; LEVELS]],
        depth: f64,
        value: f64,
        into: &mut ByMedium,
    ) {
        let row = self.row(number);
        let (level, part, slope) = place(self.by_peak[row] * depth);
        let mut change = 0.0;
        for pair in self.pairs_of(row) {
            let (number, share) = self.shares[pair];
            let [below, above] = [densities[number][level], densities[number][level + 1]];
            into.shares[pair] += value * ((1.0 - part) * below + part * above);
            change += share * (above - below);
        }
        into.by_peak[row] += value * change * slope * depth;
    }

    /// Derivative with respect to the effective radius of each voxel (1/um), from those with
    /// respect to the medium and to the scattered light over extinction, `[row][harmonic]`.
    pub(super) fn by_effective_radius(
        &self,
        scattering: &Scattering,
        voxels: &Grid,
        lattice: &Lattice,
        by: &ByMedium,
        by_scattered: &[f32],
    ) -> Vec<f64> {
        let mut derivative = vec![0.0; voxels.len()];
        let Scattering::Droplets { .. } = scattering else { return derivative };
        for (row, by_scattered) in by_scattered.chunks_exact(self.harmonics).enumerate() {
            let scaling = f64::from(self.scaling[row]);
            let by_fraction = by.by_peak[row] / (scaling * scaling) - by.scaling[row];
            let pairs = self.pairs_of(row);
            let by_share = |pair: usize| -> f64 {
                let moments = &self.functions[self.shares[pair].0].moments;
                let peak = moments[moments.len() - 1];
                let diffuse = degrees(self.harmonics).zip(by_scattered);
                by.shares[pair]
                    + by_fraction * peak
                    + diffuse.map(|(l, by)| (moments[l] - peak) * f64::from(*by)).sum::<f64>()
            };
            let by_shares: Vec<f64> = pairs.clone().map(by_share).collect();
            let corners = lattice.voxels_of(row);
            for &voxel in corners {
                let slopes = scattering.share_derivatives(index(voxels, voxel as usize));
                for (pair, by_share) in pairs.clone().zip(&by_shares) {
                    let node = self.functions[self.shares[pair].0].node;
                    let slopes = slopes.iter().filter(|(number, _)| *number == node);
                    let slope: f64 = slopes.map(|(_, slope)| slope).sum();
                    derivative[voxel as usize] += slope * by_share / corners.len() as f64;
                }
            }
        }
        derivative
    }

    /// The row of an active voxel.
    #[inline]
    pub(super) fn row(&self, number: usize) -> usize {
        if self.scaling.len() == 1 { 0 } else { number }
    }

    #[inline]
    fn pairs_of(&self, row: usize) -> Range<usize> {
        self.starts[row]..self.starts[row + 1]
    }
}

/// The effective radius (um) of droplets of intermediate size.
const INTERMEDIATE: f64 = 5.0;

/// Delta-M scaling factor, for droplets of intermediate size, with the moments below `degrees`.
pub(super) fn delta_m_scaling(scattering: &Scattering, degrees: usize) -> f64 {
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
