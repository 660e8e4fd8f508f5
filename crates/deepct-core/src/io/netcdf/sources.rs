//! The sources of virtual HDF5 data sets. The HDF5 library reads zeros in the place of missing ones.
//!
//! The HDF5 crate does not list the sources of data sets that h5py writes.

#![allow(unsafe_code)]

use crate::error::{Error, Result};
use hdf5::Dataset;
use hdf5::dataset::Layout;
use hdf5::plist::DatasetCreate;
use hdf5_sys::h5i::hid_t;
use hdf5_sys::h5p::{H5Pget_virtual_count, H5Pget_virtual_dsetname, H5Pget_virtual_filename};
use std::collections::BTreeSet;
use std::ffi::c_char;
use std::path::{Path, PathBuf};

/// Number of virtual data sets that may be sources of each other.
const DEEPEST: usize = 16;
/// Longest name of a source (bytes).
const LONGEST_NAME: usize = 4096;

/// Returns an error if a source of a virtual data set is missing, or one of a source that is a
/// virtual data set itself.
pub(super) fn check(path: &Path, name: &str, dataset: &Dataset) -> Result<()> {
    check_within(path, name, dataset, DEEPEST)
}

fn check_within(path: &Path, name: &str, dataset: &Dataset, depth: usize) -> Result<()> {
    let refused = |problem: String| {
        let remedy = "copy the source to the folder of the file, or the values into one file";
        Error::file(path, name, format!("is a virtual data set, and {problem}"), remedy)
    };
    let missing = |source: &str| refused(format!("its source {source} is missing"));
    let sources = dataset.dcpl().ok().and_then(|properties| list(&properties));
    let folder = path.parent().unwrap_or(Path::new(""));
    for (file, variable) in sources.ok_or_else(|| refused("its sources cannot be listed".into()))? {
        // The names of a series of sources contain a number in place of %b.
        let [file, variable] = [file, variable].map(|name| name.replace("%b", "0"));
        let source = if file == "." {
            dataset.file().ok()
        } else {
            let places = [folder.join(&file), PathBuf::from(&file)];
            let found = places.into_iter().find(|place| place.is_file());
            found.and_then(|place| hdf5::File::open(place).ok())
        };
        let source = source.ok_or_else(|| missing(&file))?.dataset(&variable);
        let source = source.map_err(|_| missing(&format!("{variable} in {file}")))?;
        let is_virtual = source.dcpl().is_ok_and(|own| own.layout() == Layout::Virtual);
        if is_virtual && depth > 0 {
            check_within(Path::new(&source.filename()), &variable, &source, depth - 1)?;
        }
    }
    Ok(())
}

/// The files and the names of the sources; `None` if they cannot be listed.
fn list(properties: &DatasetCreate) -> Option<BTreeSet<(String, String)>> {
    let id = properties.id();
    hdf5::sync::sync(|| {
        let mut count = 0;
        // SAFETY: the identifier is open while `properties` is borrowed, the count outlives the call,
        // and the lock excludes other threads.
        if unsafe { H5Pget_virtual_count(id, &raw mut count) } < 0 {
            return None;
        }
        let texts = |index| {
            Some((
                text(id, index, H5Pget_virtual_filename)?,
                text(id, index, H5Pget_virtual_dsetname)?,
            ))
        };
        (0..count).map(texts).collect()
    })
}

/// A text of the source `index`, which `read` copies. The caller has the lock of the library.
fn text(
    id: hid_t,
    index: usize,
    read: unsafe extern "C" fn(hid_t, usize, *mut c_char, usize) -> isize,
) -> Option<String> {
    let mut bytes = vec![0_u8; LONGEST_NAME];
    // SAFETY: the library writes at most as many bytes as it is told, and reports the length that the
    // text has without its final zero.
    let length = unsafe { read(id, index, bytes.as_mut_ptr().cast(), bytes.len()) };
    let length = usize::try_from(length).ok().filter(|length| *length < LONGEST_NAME)?;
    bytes.truncate(length);
    String::from_utf8(bytes).ok()
}
