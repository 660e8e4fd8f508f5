//! The file formats of deepct: HDF5 files that are also netCDF-4 with CF attributes.

mod axis;
mod cameras;
mod classic;
mod coding;
mod container;
mod content;
mod creation;
mod dimension;
mod drawing;
mod field;
mod guard;
mod hdf5_file;
mod light;
mod lineage;
mod observation;
mod read;
mod reconstruction;
mod reference;
mod sample;
mod sources;
mod window;
mod write;

pub(crate) use axis::{bounds, coordinates, coordinates_at, edge_and_spacing, first_and_spacing};
pub use content::{Content, read_content};
pub use drawing::{Drawing, Field, read_drawing, read_extinction};
pub use field::{
    EstimateFile, read_cloud, read_estimate, read_grid, read_implausible_cloud, read_mask,
    read_volume, write_cloud, write_estimate, write_mask, write_volume,
};
pub use guard::{allow_external_files, endless_reading};
use hdf5_file::is_hdf5;
pub use light::read_light;
pub use lineage::{Lineage, Time, read_lineage};
pub use observation::{
    ImagesFile, read_derived_observation, read_observation, read_observations, write_observation,
};
pub(crate) use read::{Input, Variable};
pub use reconstruction::write_reconstruction;
pub use reference::{
    ReferenceDroplets, ReferenceView, read_reference_droplets, read_reference_extinction,
    read_reference_view,
};
pub use sample::write_sample;

use std::path::Path;

/// Largest number of values that are read from one variable at once. It guards against files
/// whose header declares more values than fit in memory.
pub const MAX_VALUES: usize = 1 << 28;

/// Provenance of a file, recorded as global attributes.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Provenance {
    /// A short description of the file, or the command that created it.
    pub title: String,
    /// The resolved configuration, TOML or JSON.
    pub configuration: String,
    /// The seed of the run's random numbers.
    pub seed: u64,
    /// The time of the field and the history of the file from which it was made.
    pub lineage: Lineage,
}

/// The attribute of [`Provenance::configuration`].
const CONFIGURATION: &str = "configuration";
/// The attribute of all files that deepct writes.
const VERSION: &str = "deepct_version";
/// The attribute of a file whose computation was interrupted.
const INCOMPLETE: &str = "incomplete";

/// Whether a file is netCDF of any format, or HDF5.
pub(crate) fn is_netcdf(path: &Path) -> bool {
    let start = hdf5_file::first_bytes(path, 0).unwrap_or_default();
    matches!(start[..], [b'C', b'D', b'F', 1 | 2 | 5, ..]) || is_hdf5(path)
}

/// What a file of deepct lacks because its computation was interrupted; `None` for a complete file, and
/// for one that is no HDF5 file.
pub fn incomplete(path: impl AsRef<Path>) -> Option<String> {
    let path = path.as_ref();
    if !is_hdf5(path) {
        return None;
    }
    Input::open(path).ok()?.text(INCOMPLETE)
}

/// The configuration in a file of deepct ([`Provenance::configuration`]); `None` for other files.
pub fn configuration(path: impl AsRef<Path>) -> Option<String> {
    let path = path.as_ref();
    if !is_hdf5(path) {
        return None;
    }
    Input::open(path).ok()?.text(CONFIGURATION)
}

/// Whether a file was written by deepct, or changed by another program afterwards.
pub(super) fn is_own_file(path: &Path) -> bool {
    is_hdf5(path) && Input::open(path).is_ok_and(|input| input.text(VERSION).is_some())
}

/// The reason of a failure in the words of HDF5: that of the operating system where there is one,
/// otherwise the first line, as the others contain addresses.
fn reason(problem: &str) -> &str {
    const SYSTEM: &str = "error message = '";
    match problem.split_once(SYSTEM).and_then(|(_, rest)| rest.split_once('\'')) {
        Some((reason, _)) => reason,
        None => problem.lines().next().unwrap_or("unknown reason"),
    }
}

#[test]
fn failures_have_the_reason_of_the_system() {
    let text = "H5C_dest(): file write failed: time = Sat Nov 28 2026\n, filename = 'a.nc', errno = \
                28, error message = 'No space left on device', buf = 0x5557dd245ec0";
    assert_eq!(reason(text), "No space left on device");
    assert_eq!(reason("H5Dread(): filter failed\n, at 0x12"), "H5Dread(): filter failed");
}
