#![no_main]
//! Grids in TOML: arbitrary bytes give a grid or an error.

use deepct_core::io::read_grid;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    deepct_fuzz::with_file(bytes, ".toml", |path| {
        let _ = read_grid(path);
    });
});
