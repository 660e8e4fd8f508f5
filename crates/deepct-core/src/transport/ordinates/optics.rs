//! What a collision does, as the solver sees it: the forward peak counted as no collision.
//!
//! The share of scattering beyond the last harmonic is sent straight on (delta-M: Wiscombe
//! 1977). What it does to light scattered once is mended where the camera looks (TMS:
//! Nakajima and Tanaka 1988).

use super::lattice::{Lattice, index};
use super::quadrature::{Quadrature, degrees, degrees_of};
use crate::grid::Grid;
use crate::optics::{Scattering, VoxelMoments};

/// Optics by slot; a single row of a uniform medium serves all.
#[derive(Debug)]
pub(super) struct Optics {
    scattering: Scattering,
    harmonics: usize,
    /// Scattered light over extinction, `[row][harmonic]`, without the peak.
    scattered: Vec<f32>,
    /// Extinction without the peak over extinction, by row.
    kept: Vec<f32>,
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
        let (harmonics, count) = (quadrature.harmonics, quadrature.degrees);
        let (mut scattered, mut kept) = (Vec::new(), Vec::new());
        let of_voxels = VoxelMoments::new(scattering, count + 1);
        for row in 0..rows {
            let corners = lattice.voxels_of(row);
            let mut moments = vec![0.0; count + 1];
            for voxel in corners {
                let here = of_voxels.at(index(voxels, *voxel as usize));
                for (sum, moment) in moments.iter_mut().zip(here) {
                    *sum += moment / corners.len() as f64;
                }
            }
            let peak = moments[count];
            kept.push((1.0 - peak) as f32);
            scattered.extend(degrees(harmonics).map(|degree| (moments[degree] - peak) as f32));
        }
        Self { scattering: scattering.clone(), harmonics, scattered, kept }
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

    /// Light scattered by an angle of the given cosine over extinction (1/sr), the peak
    /// and all.
    pub(super) fn density(
        &self,
        voxels: &Grid,
        lattice: &Lattice,
        slot: usize,
        cosine: f64,
    ) -> f64 {
        let at = |voxel: &u32| {
            let collision = self.scattering.at(index(voxels, *voxel as usize));
            collision.single_scattering_albedo * collision.density(cosine)
        };
        let corners = match self.scattering {
            Scattering::Uniform { .. } => &lattice.voxels_of(slot)[..1],
            Scattering::Droplets { .. } => lattice.voxels_of(slot),
        };
        corners.iter().map(at).sum::<f64>() / corners.len() as f64
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
