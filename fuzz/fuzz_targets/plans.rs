#![no_main]
//! The JSON files of data sets and experiments: any text gives a plan, a manifest or a result, or
//! an error.

use deepct_core::dataset::{Manifest, Plan, Split};
use deepct_core::experiment::Outcome;

libfuzzer_sys::fuzz_target!(|text: &str| {
    let folder = deepct_fuzz::folder();
    std::fs::write(Manifest::path(folder), text).unwrap();
    let _ = Manifest::read(folder);
    if let Ok(plan) = serde_json::from_str::<Plan>(text) {
        plan.count(Split::Test);
        plan.missing(folder, None);
    }
    let _ = serde_json::from_str::<Outcome>(text);
});
