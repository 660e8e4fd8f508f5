#![no_main]
//! Clouds in both text formats: arbitrary bytes give a cloud or an error.

use deepct_core::io::import::{ImportSettings, read_text};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    deepct_fuzz::with_file(bytes, ".txt", |path| {
        let _ = read_text(path, &ImportSettings::default());
    });
});
