#![no_main]
//! HDF5 files of deepct: arbitrary bytes give clouds, volumes, masks, images or an error.

use deepct_core::io;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    deepct_fuzz::with_file(bytes, ".nc", |path| {
        let _ = io::read_cloud(path);
        let _ = io::read_volume(path);
        let _ = io::read_mask(path);
        let _ = io::read_observation(path);
    });
});
