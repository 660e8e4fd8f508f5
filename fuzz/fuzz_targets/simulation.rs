#![no_main]
//! Output of large-eddy models: arbitrary bytes give a cloud or an error.

use deepct_core::io::import::{ImportSettings, read_les};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    deepct_fuzz::with_file(bytes, ".nc", |path| {
        let _ = read_les(path, &ImportSettings::default());
    });
});
