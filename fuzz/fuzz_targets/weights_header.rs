#![no_main]
//! The headers of weights files: any header before tensors of zeros gives weights or an error.

use deepct_core::io::parse_trained_weights;
use deepct_core::network::Estimator;

libfuzzer_sys::fuzz_target!(|header: &[u8]| {
    let bytes = deepct_fuzz::safetensors_with(header);
    if let Ok(weights) = parse_trained_weights(&bytes, "fuzz.safetensors".as_ref()) {
        let _ = Estimator::new(weights);
    }
});
