//! Protection against HDF5 files that refer to other files, and against reading that does not end.

use super::sources;
use crate::error::{Error, Result};
use hdf5::dataset::Layout;
use hdf5::{Dataset, Group, LinkType};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Depth of groups below which links are not followed.
const DEEPEST: usize = 16;

/// Time that any part of a file may take to be read, and the lowest rate of its values.
const SLOWEST: Duration = Duration::from_secs(20);
const SLOWEST_BYTES_PER_S: f64 = 1e6;

/// Whether files may refer to other files.
static EXTERNAL: AtomicBool = AtomicBool::new(false);

/// Allows links to other files, and values stored in other files, in the HDF5 files that this
/// process reads. A file from an unknown source could otherwise make a command copy any file of the
/// machine into its output.
pub fn allow_external_files() {
    EXTERNAL.store(true, Ordering::Relaxed);
}

fn refused(path: &Path, field: &str, problem: &str) -> Error {
    let remedy = "copy the values into one file, or use --allow-external if you trust the file";
    Error::file(path, field, problem, remedy)
}

/// Returns an error if a group, or one in it, has a link to another file.
pub(super) fn check_links(path: &Path, group: &Group) -> Result<()> {
    if EXTERNAL.load(Ordering::Relaxed) {
        return Ok(());
    }
    match external_link(group, DEEPEST) {
        None => Ok(()),
        Some(name) => Err(refused(path, &name, "is a link to another file")),
    }
}

/// The name of a link to another file in a group or one of its groups.
fn external_link(group: &Group, depth: usize) -> Option<String> {
    type Found = (Option<String>, Vec<String>);
    let visit = |_: &Group, name: &str, link: hdf5::LinkInfo, (external, hard): &mut Found| {
        match link.link_type {
            LinkType::External => *external = Some(name.to_owned()),
            LinkType::Hard => hard.push(name.to_owned()),
            LinkType::Soft => {}
        }
        external.is_none()
    };
    // A group that cannot be listed has no variables that can be read.
    let (external, names) = group.iter_visit_default((None, Vec::new()), visit).ok()?;
    if external.is_some() || depth == 0 {
        return external;
    }
    names.iter().find_map(|name| {
        let inner = external_link(&group.group(name).ok()?, depth - 1)?;
        Some(format!("{name}/{inner}"))
    })
}

/// Returns an error if the values of a variable are stored in other files.
///
/// Where other files are allowed, returns an error if one of them is missing: the HDF5 library reads
/// zeros in its place.
pub(super) fn check_storage(path: &Path, name: &str, dataset: &Dataset) -> Result<()> {
    let Ok(properties) = dataset.dcpl() else { return Ok(()) };
    if EXTERNAL.load(Ordering::Relaxed) {
        return match properties.layout() {
            Layout::Virtual => sources::check(path, name, dataset),
            _ => Ok(()),
        };
    }
    if properties.layout() == Layout::Virtual {
        return Err(refused(path, name, "is a virtual data set, which refers to other files"));
    }
    if !properties.external().is_empty() {
        return Err(refused(path, name, "has its values in another file"));
    }
    Ok(())
}

/// The parts of files that are being read: number, file and deadline.
static READING: Mutex<Vec<(u64, PathBuf, Instant)>> = Mutex::new(Vec::new());

/// A part of a file that is being read, until it is dropped.
pub(super) struct Reading(u64);

impl Reading {
    /// Starts to read about `bytes` of a file.
    pub(super) fn start(path: &Path, bytes: f64) -> Self {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let longest = SLOWEST + Duration::from_secs_f64(bytes / SLOWEST_BYTES_PER_S);
        let deadline = Instant::now() + longest;
        let mut reading = READING.lock().unwrap_or_else(PoisonError::into_inner);
        reading.push((number, path.into(), deadline));
        Self(number)
    }
}

impl Drop for Reading {
    fn drop(&mut self) {
        let mut reading = READING.lock().unwrap_or_else(PoisonError::into_inner);
        reading.retain(|(number, ..)| *number != self.0);
    }
}

/// An error about a file of which a part has been read for much longer than the slowest disk takes.
/// The HDF5 library does not end if it reads some damaged files, and nothing but the end of the
/// process can stop it; a program can call this function regularly from a thread of its own.
pub fn endless_reading() -> Option<Error> {
    endless_at(Instant::now())
}

fn endless_at(now: Instant) -> Option<Error> {
    let reading = READING.lock().unwrap_or_else(PoisonError::into_inner);
    let (_, path, _) = reading.iter().find(|(.., deadline)| now > *deadline)?;
    let problem = "cannot be read: the HDF5 library does not come to an end";
    Some(Error::file(path, "file", problem, "copy it again from its source, or write it again"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reading_that_does_not_end_is_noticed() {
        let reading = Reading::start(Path::new("slow.nc"), 3e6);
        let after = |seconds: f64| endless_at(Instant::now() + Duration::from_secs_f64(seconds));
        assert!(after(22.0).is_none());
        let message = after(24.0).unwrap().to_string();
        assert!(message.starts_with("slow.nc: file: cannot be read"), "{message}");
        drop(reading);
        assert!(after(24.0).is_none());
    }
}
