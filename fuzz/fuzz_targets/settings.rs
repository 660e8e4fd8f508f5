#![no_main]
//! TOML files: a grid, a sensor, views, light, and the settings of inversions, data sets,
//! experiments and clouds. Any text gives settings or an error.

use deepct_core::cloud::{CumulusSettings, FieldSettings};
use deepct_core::dataset::DatasetSettings;
use deepct_core::experiment::ExperimentSettings;
use deepct_core::inversion::InversionSettings;
use deepct_core::io::read_grid;
use deepct_core::scene::{Light, ViewList};
use deepct_core::sensor::Sensor;

libfuzzer_sys::fuzz_target!(|text: &str| {
    deepct_fuzz::with_file(text.as_bytes(), ".toml", |path| {
        let _ = read_grid(path);
        let _ = Sensor::from_file(path);
        let _ = ViewList::find(&path.to_string_lossy());
    });
    let _ = toml::from_str::<Light>(text);
    let _ = toml::from_str::<CumulusSettings>(text);
    let _ = toml::from_str::<FieldSettings>(text);
    let _ = toml::from_str::<InversionSettings>(text).map(|settings| settings.check());
    let _ = toml::from_str::<ExperimentSettings>(text).map(|settings| settings.check());
    let _ = toml::from_str::<DatasetSettings>(text).map(|settings| settings.formation().err());
});
