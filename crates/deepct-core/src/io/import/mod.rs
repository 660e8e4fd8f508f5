//! Import of clouds: large-eddy simulations in netCDF, arrays of other programs, and the text formats of
//! pySHDOM, AT3D, SHDOM and MYSTIC.
//!
//! Fields of all formats are resampled to the requested grid by [`crate::grid::resample`]:
//! conservatively to coarser cells and between stretched levels, linearly to finer cells of one size.

mod axes;
mod cells;
mod density;
mod droplets;
mod les;
mod text;
mod water;

pub use les::{count_times, read_les};
pub use text::read_text;

use crate::cloud::Cloud;
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::grid::resample;
use crate::io::arrays::{expected_by_name, is_array_file};
use crate::io::netcdf::{Lineage, is_netcdf};
use crate::math::DVec3;
use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Droplet number concentration (1/cm3) assumed if the file does not contain the droplet size:
/// between that of maritime air (50 to 100) and that of continental air (several hundred).
pub const DROPLETS_PER_CM3: f64 = 100.0;

/// Largest number of levels of an imported cloud.
const MOST_LEVELS: usize = 100_000;

/// Selection of the part of a file to import, and the grid to which it is resampled.
#[derive(Debug, Clone, PartialEq)]
pub struct ImportSettings {
    /// Index of the time step, from 0.
    pub time: usize,
    /// The columns to import; all if `None`.
    pub crop: Option<Crop>,
    /// Droplet number concentration (1/cm3), from which effective radii are derived. If `None`,
    /// the radii of the file are used, or [`DROPLETS_PER_CM3`] if it has none.
    pub droplets_per_cm3: Option<f64>,
    /// Density of air, which converts a mixing ratio to liquid water content; it takes precedence over
    /// the density in the file.
    pub air_density: Option<AirDensity>,
    /// Name of the liquid water variable; identified automatically if `None`.
    pub variable: Option<String>,
    /// Voxel size along x, y, z (km); that of the file if `None`.
    pub spacing: Option<DVec3>,
    /// Altitude of the bottom of the lowest voxels (km); that of the file if `None`.
    pub base: Option<f64>,
    /// Number of levels; up to the top of the file if `None`.
    pub levels: Option<usize>,
    /// The axes of variables in files that do not name them, such as those of MATLAB; their cells have
    /// the size `spacing`, and begin at 0 along x and y and at `base` along z.
    pub axes: Option<Axes>,
    /// Units of variables that replace those of the file, by the name of the variable.
    pub units: BTreeMap<String, String>,
    /// Whether values far beyond those of clouds are accepted with a warning.
    pub allow_implausible: bool,
}

/// The density of air that converts a mixing ratio to liquid water content.
#[derive(Debug, Clone, PartialEq)]
pub enum AirDensity {
    /// The same everywhere (kg/m3).
    Constant(f64),
    /// A profile, interpolated linearly in altitude.
    Profile {
        /// The file that contains it.
        file: PathBuf,
        /// The name of the variable, after the path of its group.
        variable: String,
    },
}

/// The order of the axes of a variable, the slowest one first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Axes([char; 3]);

impl Axes {
    fn names(self) -> [String; 3] {
        self.0.map(String::from)
    }
}

impl FromStr for Axes {
    type Err = String;

    /// The letters x, y and z, such as `z,y,x`.
    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let letters: Vec<char> = text
            .chars()
            .filter(|letter| !", ".contains(*letter))
            .map(|c| c.to_ascii_lowercase())
            .collect();
        match letters[..] {
            [a, b, c] if ['x', 'y', 'z'].iter().all(|letter| letters.contains(letter)) => {
                Ok(Self([a, b, c]))
            }
            _ => Err("give the letters x, y and z in the order of the axes, such as z,y,x".into()),
        }
    }
}

impl fmt::Display for Axes {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(&self.names().join(","))
    }
}

impl FromStr for AirDensity {
    type Err = String;

    /// A number, or `FILE:VARIABLE`.
    fn from_str(text: &str) -> std::result::Result<Self, String> {
        if let Ok(density) = text.parse() {
            return Ok(Self::Constant(density));
        }
        match text.rsplit_once(':') {
            Some((file, variable)) if !file.is_empty() && !variable.is_empty() => {
                Ok(Self::Profile { file: file.into(), variable: variable.into() })
            }
            _ => Err("give a number (kg/m3), or a profile as FILE:VARIABLE".into()),
        }
    }
}

impl fmt::Display for AirDensity {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Constant(density) => write!(f, "{density}"),
            Self::Profile { file, variable } => write!(f, "{}:{variable}", file.display()),
        }
    }
}

/// What an import found in a file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ImportReport {
    /// The variable from which each quantity was taken, and what was assumed.
    pub taken: Vec<String>,
    /// What may be wrong.
    pub warnings: Vec<String>,
    /// The time that was read, and the history of the file.
    pub lineage: Lineage,
}

impl Default for ImportSettings {
    /// The whole field of the first time step on voxels of 50 x 50 x 40 m.
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
            axes: None,
            units: BTreeMap::new(),
            allow_implausible: false,
        }
    }
}

/// A rectangle of columns of a file. It wraps around the lateral boundaries, because simulations
/// are periodic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Crop {
    /// Index of the first column, counted eastwards.
    pub x0: usize,
    /// Index of the first row, counted northwards.
    pub y0: usize,
    /// Number of columns.
    pub nx: usize,
    /// Number of rows.
    pub ny: usize,
}

/// Read a cloud in any supported format: netCDF, HDF5 and collections of arrays (NumPy, MATLAB, pickles,
/// Mitsuba, VTK) by [`read_les`], all other files by [`read_text`]. Returns the cloud and a report about it.
///
/// # Errors
/// As [`read_les`] and [`read_text`].
pub fn import_cloud(
    path: impl AsRef<Path>,
    settings: &ImportSettings,
) -> Result<(Cloud, ImportReport)> {
    let path = path.as_ref();
    if !path.exists() {
        return Err(Error::file(path, "file", "does not exist", "check the path"));
    }
    if path.is_dir() {
        let (what, remedy) = folder(path);
        return Err(Error::file(path, "file", what, remedy));
    }
    crate::files::check_regular(path)?;
    match is_netcdf(path) || is_array_file(path) {
        true => read_les(path, settings),
        false => expected_by_name(path).map_or_else(|| read_text(path, settings), Err),
    }
}

/// What a folder contains, and how it becomes a file.
fn folder(path: &Path) -> (&'static str, &'static str) {
    let has = |name: &str| path.join(name).exists();
    let ends = |end: &str| path.extension().is_some_and(|found| found == end);
    if ends("zarr") || [".zgroup", ".zmetadata", "zarr.json"].into_iter().any(has) {
        let remedy = "convert it: xarray.open_zarr(...).to_netcdf(\"cloud.nc\")";
        return ("is a folder with a Zarr store, which is not read", remedy);
    }
    if ends("bp") || has("md.idx") {
        let remedy =
            "read it with the Python module adios2 and write netCDF, or let the model write it";
        return ("is a folder in the format ADIOS2 BP, which is not read", remedy);
    }
    ("is a folder", "give a regular file")
}

impl Crop {
    /// The crop of the settings, by default all of the `ny` x `nx` columns.
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
            format!(
                "{} x {} columns from {}, {} do not fit into {nx} x {ny} columns",
                crop.nx, crop.ny, crop.x0, crop.y0
            ),
            "choose a corner within the field and at most its size",
        ))
    }
}

/// The faces from the altitude `base` on, or all of them if there are fewer than two.
fn faces_above(faces: &[f64], base: f64) -> &[f64] {
    let first = faces.partition_point(|face| *face < base - 1e-9);
    if faces.len() - first < 2 { faces } else { &faces[first..] }
}

/// A length (km) without the rounding errors of its computation, which are far below this unit of 1 nm.
fn decimal(length: f64) -> f64 {
    (length * 1e12).round() / 1e12
}

/// The requested grid over cells with the given edges along z, y, x (km).
fn grid_over(edges: [&[f64]; 3], settings: &ImportSettings, path: &Path) -> Result<Grid> {
    let [z, y, x] = edges;
    let length = |edges: &[f64]| edges[edges.len() - 1] - edges[0];
    let own = |edges: &[f64]| decimal(length(edges) / (edges.len() - 1) as f64);
    let base = settings.base.unwrap_or_else(|| decimal(z[0]));
    let spacing =
        settings.spacing.unwrap_or_else(|| DVec3::new(own(x), own(y), own(faces_above(z, base))));
    // A whole number of voxels, up to rounding; the last one may extend beyond the cells.
    let count = |length: f64, step: f64| (length / step - 1e-3).ceil().max(1.0) as usize;
    if let Some(levels) = settings.levels.filter(|levels| *levels > MOST_LEVELS) {
        return Err(Error::out_of_range("levels", levels, format!("at most {MOST_LEVELS}")));
    }
    let levels = settings.levels.unwrap_or_else(|| count(z[z.len() - 1] - base, spacing.z));
    let shape = [levels, count(length(y), spacing.y), count(length(x), spacing.x)];
    let origin = DVec3::new(decimal(x[0]), decimal(y[0]), base);
    Grid::new(origin, spacing, shape).map_err(|problem| {
        Error::file(path, "grid", problem.to_string(), "choose another spacing, base or levels")
    })
}

/// The edges of cells around their centres; at least two centres are required.
fn edges_of(centres: &[f64], path: &Path, axis: &str) -> Result<Vec<f64>> {
    resample::edges(centres).map_err(|_| {
        Error::file(
            path,
            axis,
            "has fewer than two values or does not ascend",
            "give a field with at least two cells along each axis, in ascending order",
        )
    })
}
