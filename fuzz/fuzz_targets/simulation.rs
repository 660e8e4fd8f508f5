#![no_main]
//! Output of large-eddy models: valid files with a few changes give a cloud whose values are finite,
//! or an error.

use deepct_core::io::import::{ImportSettings, read_les};
use deepct_fuzz::Edit;

const FILES: [&[u8]; 3] = [
    include_bytes!("../../crates/deepct-core/tests/fixtures/bins.nc"),
    include_bytes!("../../crates/deepct-core/tests/fixtures/cf.nc"),
    include_bytes!("../../crates/deepct-core/tests/fixtures/mixing.nc"),
];

libfuzzer_sys::fuzz_target!(|input: (u8, bool, Vec<Edit>)| {
    let (kind, resampled, edits) = input;
    let path = deepct_fuzz::folder().join("input.nc");
    deepct_fuzz::edited(FILES[usize::from(kind) % FILES.len()], &edits, &path);
    let mut settings = ImportSettings::default();
    if !resampled {
        settings.spacing = None;
    }
    if let Ok((cloud, _)) = read_les(&path, &settings) {
        deepct_fuzz::check_cloud(&cloud);
    }
});
