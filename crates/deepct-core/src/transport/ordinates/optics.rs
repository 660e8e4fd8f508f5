//! What a collision does, as the solver sees it: the forward peak counted as no collision.
//!
//! The share of scattering beyond the last harmonic is sent straight on (delta-M: Wiscombe
//! 1977). What it does to light scattered once is mended where the camera looks (TMS:
//! Nakajima and Tanaka 1988).

use super::lattice::{Lattice, index};
use super::quadrature::{Quadrature, degrees, degrees_of};
use crate::grid::Grid;
use crate::optics::{PhaseFunction, Scattering};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Optics by slot; a single row of a uniform medium serves all.
#[derive(Debug)]
pub(super) struct Optics {
    harmonics: usize,
    /// Scattered light over extinction, `[row][harmonic]`, without the peak.
    scattered: Vec<f32>,
    /// Extinction without the peak over extinction, by row.
    kept: Vec<f32>,
    /// The phase functions that light is scattered by in some cell.
    phase_functions: Vec<PhaseFunction>,
    /// Their numbers and how much of the extinction scatters by each, by row.
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
            Scattering::Uniform { .. } => lattice.len().min(1),
            Scattering::Droplets { .. } => lattice.len(),
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
        let all = scattering.phase_functions();
        let phase_functions: Vec<PhaseFunction> = used.iter().map(|n| all[*n].clone()).collect();

        let (harmonics, count) = (quadrature.harmonics, quadrature.degrees);
        let moments: Vec<Vec<f64>> =
            phase_functions.par_iter().map(|p| p.legendre_moments(count + 1)).collect();
        let (mut scattered, mut kept) = (Vec::new(), Vec::new());
        for row in &shares {
            let moment = |degree: usize| -> f64 {
                row.iter().map(|(number, share)| share * moments[*number][degree]).sum()
            };
            let peak = moment(count);
            let low: Vec<f32> = (0..=count).map(|degree| (moment(degree) - peak) as f32).collect();
            kept.push((1.0 - peak) as f32);
            scattered.extend(degrees(harmonics).map(|degree| low[degree]));
        }
        Self { harmonics, scattered, kept, phase_functions, shares }
    }

    /// Scattered light over extinction, by harmonic.
    #[inline]
    pub(super) fn scattered(&self, slot: usize) -> &[f32] {
        &self.scattered[self.row(slot) * self.harmonics..][..self.harmonics]
    }

    /// Extinction without the peak over extinction.
    #[inline]
    pub(super) fn kept(&self, slot: usize) -> f32 {
        self.kept[self.row(slot)]
    }

    /// The densities of all phase functions at a cosine, for [`Optics::density`].
    pub(super) fn densities(&self, cosine: f64, into: &mut Vec<f64>) {
        into.clear();
        into.extend(self.phase_functions.iter().map(|function| function.density(cosine)));
    }

    /// Light scattered by the angle of the densities over extinction (1/sr), the peak and all.
    #[inline]
    pub(super) fn density(&self, slot: usize, densities: &[f64]) -> f64 {
        let shares = self.shares[self.row(slot)].iter();
        shares.map(|(number, share)| share * densities[*number]).sum()
    }

    fn row(&self, slot: usize) -> usize {
        if self.kept.len() == 1 { 0 } else { slot }
    }
}

/// Extinction without the peak over extinction, of droplets of a middle size.
pub(super) fn kept(scattering: &Scattering, zenith_angles: usize) -> f64 {
    let degrees = degrees_of(zenith_angles);
    let (albedo, phase_function) = match scattering {
        Scattering::Uniform { single_scattering_albedo, phase_function } => {
            (*single_scattering_albedo, phase_function)
        }
        Scattering::Droplets { table, .. } => {
            let node = &table.nodes()[table.nodes().len() / 2];
            (node.single_scattering_albedo, &node.phase_function)
        }
    };
    1.0 - albedo * phase_function.legendre_moments(degrees + 1)[degrees]
}
