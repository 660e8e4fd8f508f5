#![no_main]
//! Clouds in both text formats: arbitrary bytes give a cloud, whose values are finite, or an error.

use deepct_core::io::import::{ImportSettings, read_text};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let settings = ImportSettings { spacing: None, ..ImportSettings::default() };
    deepct_fuzz::with_file(bytes, ".txt", |path| {
        if let Ok((cloud, _)) = read_text(path, &settings) {
            deepct_fuzz::check_cloud(&cloud);
        }
    });
});
