//! Settings of the discrete-ordinates solver.

use super::lattice::MOST_PARTS;
use crate::error::{Error, Result};

/// Settings of the discrete-ordinates solver.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OrdinatesSettings {
    /// Number of zenith angles of the ordinates, a multiple of 4; the number of azimuths is twice
    /// as large.
    pub zenith_angles: usize,
    /// The iteration ends when a sweep changes the radiance by less than this relative amount, and
    /// the estimated error of the radiance is less than ten times as large.
    pub tolerance: f64,
    /// Maximum number of sweeps of one solution.
    pub most_sweeps: usize,
    /// Minimum number of rays per pixel; pixels wider than a voxel have more.
    pub rays_per_pixel: usize,
    /// Largest delta-M scaled optical depth of a cell along an axis: voxels are split until no cell
    /// exceeds it.
    pub cell_depth: f64,
    /// Maximum number of cells into which a voxel is split along an axis, at most 8.
    pub most_parts: usize,
    /// Smallest extinction (1/km) for which each voxel is prepared; if `None`, each voxel is
    /// prepared for its extinction in the scene.
    pub largest_extinction: Option<f64>,
    /// Whether [`render`](crate::transport::render) also estimates the error of its images, from a
    /// coarser solution.
    pub estimate_error: bool,
}

impl Default for OrdinatesSettings {
    fn default() -> Self {
        Self {
            zenith_angles: 8,
            tolerance: 1e-4,
            most_sweeps: 1000,
            rays_per_pixel: 13,
            cell_depth: 0.5,
            most_parts: 4,
            largest_extinction: None,
            estimate_error: false,
        }
    }
}

impl OrdinatesSettings {
    /// Settings for an approximate relative error of the bright pixels of single clouds;
    /// `docs/notes/deterministic_solver.md` lists the measured errors. For 0.01 and similar values they
    /// are the defaults.
    ///
    /// # Errors
    /// Fails if `accuracy` is not from 0.003 to 0.1.
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

    /// Settings of a coarser solution: fewer ordinates, cells of twice the optical depth and fewer
    /// rays; `None` if there is no coarser solution. The images of both solutions differ by about
    /// five times the error of the finer one: see `docs/notes/deterministic_solver.md`, "The estimated
    /// error".
    pub(in crate::transport) fn coarser(&self) -> Option<Self> {
        (self.zenith_angles >= 8).then(|| Self {
            zenith_angles: self.zenith_angles / 8 * 4,
            cell_depth: 2.0 * self.cell_depth,
            // Cells of voxels that need more parts than these are larger, too.
            most_parts: self.most_parts.div_ceil(2),
            rays_per_pixel: (2 * self.rays_per_pixel / 5).max(1),
            tolerance: self.tolerance.max(1e-3),
            ..*self
        })
    }

    /// Checks that all values are in range.
    ///
    /// # Errors
    /// The first value that is out of range.
    pub fn check(&self) -> Result<()> {
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
