#![no_main]
//! Files of deepct: valid clouds and images with a few changes give clouds, volumes, masks and
//! images whose values are finite, or missing in images, or an error.

use deepct_core::io;
use deepct_fuzz::{Edit, valid};
use std::sync::OnceLock;

libfuzzer_sys::fuzz_target!(|input: (u8, Vec<Edit>)| {
    static FILES: OnceLock<[Vec<u8>; 4]> = OnceLock::new();
    let files = FILES.get_or_init(|| [valid::cloud(), valid::images(), valid::estimate(), valid::mask()]);
    let (kind, edits) = input;
    let path = deepct_fuzz::folder().join("input.nc");
    deepct_fuzz::edited(&files[usize::from(kind % 4)], &edits, &path);
    if let Ok(cloud) = io::read_cloud(&path) {
        deepct_fuzz::check_cloud(&cloud);
    }
    if let Ok(volume) = io::read_volume(&path) {
        volume.check_non_negative("extinction").unwrap();
    }
    if let Ok(images) = io::read_observation(&path) {
        assert!(images.images.values.iter().all(|value| !value.is_infinite()));
        let _ = images.imaging_geometry();
    }
    let _ = io::read_estimate(&path);
    let _ = io::read_mask(&path);
    let _ = io::read_grid(&path);
});
