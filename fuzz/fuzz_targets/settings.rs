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
use toml::Table;

libfuzzer_sys::fuzz_target!(|text: &str| {
    // A text that is no TOML fails in the same way for all of them.
    let Ok(table) = text.parse::<Table>() else {
        return deepct_fuzz::with_file(text.as_bytes(), ".toml", |path| drop(read_grid(path)));
    };
    deepct_fuzz::with_file(text.as_bytes(), ".toml", |path| {
        let _ = read_grid(path);
        let _ = Sensor::from_file(path);
        let _ = ViewList::find(&path.to_string_lossy());
    });
    let _ = table.clone().try_into::<Light>();
    let _ = table.clone().try_into::<CumulusSettings>();
    let _ = table.clone().try_into::<FieldSettings>();
    let _ = table.clone().try_into::<InversionSettings>().map(|settings| settings.check());
    let _ = table.clone().try_into::<ExperimentSettings>().map(|settings| settings.check());
    let _ = table.try_into::<DatasetSettings>().map(|settings| settings.formation().err());
});
