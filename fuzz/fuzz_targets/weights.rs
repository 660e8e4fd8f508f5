#![no_main]
//! Weights files (safetensors with metadata): arbitrary bytes give weights, which make a network, or
//! an error.

use deepct_core::io::parse_trained_weights;
use deepct_core::network::Estimator;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Ok(weights) = parse_trained_weights(bytes, "fuzz.safetensors".as_ref()) {
        let _ = Estimator::new(weights);
    }
});
