#![no_main]
//! Sensors in TOML: arbitrary bytes give a sensor or an error.

use deepct_core::sensor::Sensor;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    deepct_fuzz::with_file(bytes, ".toml", |path| {
        let _ = Sensor::from_file(path);
    });
});
