//! Clouds from elsewhere: large-eddy simulations in netCDF-4, and the text formats of
//! SHDOM's relatives.
//!
//! Whatever the format, the field is brought onto the wanted grid by
//! [`crate::cloud::resample`]: conservatively onto coarser cells, linearly onto finer.

mod axes;
mod les;
mod text;

pub use les::read_les;
pub use text::read_text;

use crate::cloud::{Cloud, resample};
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::math::DVec3;
use std::io::Read;
use std::path::Path;

/// The number of droplets taken where the file does not give their size (per cm3):
/// between the 50 to 100 of maritime and the several hundred of continental air.
pub const DROPLETS_PER_CM3: f64 = 100.0;

/// What of a file is read, and onto which grid it is brought.
#[derive(Debug, Clone, PartialEq)]
pub struct ImportSettings {
    /// Number of the time step, from 0.
    pub time: usize,
    /// The columns to take; all where it is `None`.
    pub crop: Option<Crop>,
    /// Droplets per cm3, from which radii follow. Where it is `None` the file's radii
    /// are taken, or [`DROPLETS_PER_CM3`] if it has none.
    pub droplets_per_cm3: Option<f64>,
    /// Density of air (kg/m3) for a mixing ratio in a file without one.
    pub air_density: Option<f64>,
    /// Name of the liquid water variable, where it is not to be found by itself.
    pub variable: Option<String>,
    /// Voxel size along x, y, z (km); the file's own where it is `None`.
    pub spacing: Option<DVec3>,
    /// Altitude of the lowest voxels' bottom (km); the file's where it is `None`.
    pub base: Option<f64>,
    /// Number of levels; up to the file's top where it is `None`.
    pub levels: Option<usize>,
}

impl Default for ImportSettings {
    /// The whole of the first time step on voxels of 50 x 50 x 40 m.
    fn default() -> Self {
        Self {
            time: 0,
            crop: None,
            droplets_per_cm3: None,
            air_density: None,
            variable: None,
            spacing: Some(DVec3::new(0.05, 0.05, 0.04)),
            base: None,
            levels: None,
        }
    }
}

/// A rectangle of a file's columns. It wraps around the sides, as simulations are
/// periodic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Crop {
    /// First column to the east.
    pub x0: usize,
    /// First row to the north.
    pub y0: usize,
    /// Number of columns.
    pub nx: usize,
    /// Number of rows.
    pub ny: usize,
}

/// Read a cloud of any format that is known: netCDF-4 and HDF5 by [`read_les`],
/// anything else by [`read_text`].
///
/// # Errors
/// As those two.
pub fn import_cloud(path: impl AsRef<Path>, settings: &ImportSettings) -> Result<Cloud> {
    let path = path.as_ref();
    if !path.is_file() {
        return Err(Error::file(path, "file", "does not exist", "check the path"));
    }
    let mut start = [0; 4];
    let read = std::fs::File::open(path).and_then(|mut file| file.read_exact(&mut start));
    match (read, &start) {
        (Ok(()), b"\x89HDF" | b"CDF\x01" | b"CDF\x02" | b"CDF\x05") => read_les(path, settings),
        _ => read_text(path, settings),
    }
}

impl Crop {
    /// The whole of `ny` x `nx` columns where nothing is chosen; otherwise the choice.
    fn of(settings: &ImportSettings, path: &Path, [ny, nx]: [usize; 2]) -> Result<Self> {
        let crop = settings.crop.unwrap_or(Self { x0: 0, y0: 0, nx, ny });
        let fits = |start: usize, count: usize, length: usize| {
            start < length && (1..=length).contains(&count)
        };
        if fits(crop.x0, crop.nx, nx) && fits(crop.y0, crop.ny, ny) {
            return Ok(crop);
        }
        Err(Error::file(
            path,
            "crop",
            format!("{crop:?} does not fit into {nx} x {ny} columns"),
            "choose a corner within the field and at most its size",
        ))
    }
}

/// The wanted grid over cells with the given edges along z, y, x (km).
fn grid_over(edges: [&[f64]; 3], settings: &ImportSettings, path: &Path) -> Result<Grid> {
    let [z, y, x] = edges;
    let length = |edges: &[f64]| edges[edges.len() - 1] - edges[0];
    let own = |edges: &[f64]| length(edges) / (edges.len() - 1) as f64;
    let spacing = settings.spacing.unwrap_or_else(|| DVec3::new(own(x), own(y), own(z)));
    let base = settings.base.unwrap_or(z[0]);
    // A whole number of voxels, up to rounding; the last one may reach beyond.
    let count = |length: f64, step: f64| (length / step - 1e-3).ceil().max(1.0) as usize;
    let levels = settings.levels.unwrap_or_else(|| count(z[z.len() - 1] - base, spacing.z));
    let shape = [levels, count(length(y), spacing.y), count(length(x), spacing.x)];
    Grid::new(DVec3::new(x[0], y[0], base), spacing, shape).map_err(|problem| {
        Error::file(path, "grid", problem.to_string(), "choose another spacing, base or levels")
    })
}

/// The edges of cells around coordinates; a single one needs its neighbours' distance.
fn edges_of(centres: &[f64], path: &Path, axis: &str) -> Result<Vec<f64>> {
    resample::edges(centres).map_err(|_| {
        Error::file(
            path,
            axis,
            "has fewer than two values or does not ascend",
            "give a field with at least two cells along every axis, growing east, north, up",
        )
    })
}
