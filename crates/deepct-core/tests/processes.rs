//! Files of a program that starts other programs. This is a program of its own, because tests that edit
//! files with HDF5 alone do lock them.

use deepct_core::grid::{Grid, Volume};
use deepct_core::io::{self, Provenance};
use deepct_core::math::DVec3;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};

/// A process that another thread starts holds the locks of all open files until its program begins.
#[cfg(unix)]
#[test]
fn files_are_written_while_other_programs_are_started() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("volume.nc");
    let grid = Grid::new(DVec3::ZERO, DVec3::splat(0.05), [3, 4, 5]).unwrap();
    let volume = Volume::constant(grid, 1.0);
    let provenance = Provenance {
        title: "a test".into(),
        configuration: String::new(),
        seed: 0,
        ..Provenance::default()
    };
    let done = AtomicBool::new(false);
    let start_programs = || {
        while !done.load(Ordering::Relaxed) {
            Command::new("true").status().unwrap();
        }
    };
    let results: Vec<_> = std::thread::scope(|scope| {
        scope.spawn(start_programs);
        scope.spawn(start_programs);
        let write = || io::write_volume(&path, &volume, &provenance);
        let results = (0..300).map(|_| write().and_then(|()| io::read_volume(&path))).collect();
        done.store(true, Ordering::Relaxed);
        results
    });
    for result in results {
        assert_eq!(result.unwrap(), volume);
    }
}
