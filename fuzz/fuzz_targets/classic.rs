#![no_main]
//! Simulations in the classic format of netCDF: arbitrary bytes after its signature give a cloud, whose
//! values are finite, or an error.

use deepct_core::io::import::{ImportSettings, read_les};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let settings = ImportSettings { spacing: None, ..ImportSettings::default() };
    let bytes = [b"CDF", bytes].concat();
    deepct_fuzz::with_file(&bytes, ".nc", |path| {
        if let Ok((cloud, _)) = read_les(path, &settings) {
            deepct_fuzz::check_cloud(&cloud);
        }
    });
});
