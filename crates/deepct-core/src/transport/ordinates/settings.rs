//! The settings of the deterministic solver.

use super::lattice::MOST_PARTS;
use crate::error::{Error, Result};

/// Settings of the deterministic solver.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OrdinatesSettings {
    /// Number of zenith angles of the ordinates, a multiple of 4; there are twice as many
    /// azimuths.
    pub zenith_angles: usize,
    /// The iteration ends when a sweep changes the radiance by less than this share.
    pub tolerance: f64,
    /// The most sweeps of one solution.
    pub most_sweeps: usize,
    /// The least number of rays of a pixel as wide as a voxel; there are more in wider ones.
    pub rays_per_pixel: usize,
    /// Each voxel is split until none of its cells is thicker than this along an axis (optical
    /// depth without the forward peak).
    pub cell_depth: f64,
    /// The most cells that a voxel is split into along an axis, at most 8.
    pub most_parts: usize,
    /// The least extinction (1/km) that each voxel is prepared for; without one, that which the
    /// voxel has in the scene.
    pub largest_extinction: Option<f64>,
}

impl Default for OrdinatesSettings {
    fn default() -> Self {
        Self {
            zenith_angles: 8,
            tolerance: 1e-4,
            most_sweeps: 200,
            rays_per_pixel: 13,
            cell_depth: 0.5,
            most_parts: 4,
            largest_extinction: None,
        }
    }
}

impl OrdinatesSettings {
    /// Settings for about a relative error of the bright pixels of single clouds:
    /// `docs/deterministic_solver.md` has what was measured. 0.01 and what is near it are the defaults.
    ///
    /// # Errors
    /// An accuracy outside 0.003 to 0.1.
    pub fn with_accuracy(accuracy: f64) -> Result<Self> {
        if !(0.003..=0.1).contains(&accuracy) {
            return Err(Error::out_of_range("accuracy", accuracy, "from 0.003 to 0.1"));
        }
        let settings = Self::default();
        Ok(if accuracy >= 0.03 {
            Self { cell_depth: 2.0, rays_per_pixel: 5, tolerance: 1e-3, ..settings }
        } else if accuracy >= 0.007 {
            settings
        } else {
            Self {
                zenith_angles: 12,
                cell_depth: 0.3,
                most_parts: 8,
                rays_per_pixel: 34,
                ..settings
            }
        })
    }

    pub(super) fn check(&self) -> Result<()> {
        if !(4..=32).contains(&self.zenith_angles) || !self.zenith_angles.is_multiple_of(4) {
            return Err(Error::out_of_range(
                "zenith angles of the ordinates",
                self.zenith_angles,
                "a multiple of 4 from 4 to 32",
            ));
        }
        if !(self.cell_depth > 0.0 && self.cell_depth.is_finite()) {
            return Err(Error::out_of_range("cell depth", self.cell_depth, "positive"));
        }
        if self.largest_extinction.is_some_and(|most| !(most > 0.0 && most.is_finite())) {
            return Err(Error::out_of_range(
                "largest extinction",
                format!("{:?}", self.largest_extinction),
                "positive and finite (1/km)",
            ));
        }
        if !(self.tolerance > 0.0 && self.tolerance < 1.0) {
            return Err(Error::out_of_range("tolerance", self.tolerance, "between 0 and 1"));
        }
        if self.most_parts > MOST_PARTS {
            return Err(Error::out_of_range(
                "most parts of a voxel",
                self.most_parts,
                format!("at most {MOST_PARTS}"),
            ));
        }
        for (what, value) in [
            ("most sweeps", self.most_sweeps),
            ("rays of a pixel", self.rays_per_pixel),
            ("most parts of a voxel", self.most_parts),
        ] {
            if value == 0 {
                return Err(Error::out_of_range(what, 0, "at least 1"));
            }
        }
        Ok(())
    }
}
