#![no_main]
//! Weights files (safetensors with metadata): arbitrary bytes give weights or an error.

use deepct_core::io::parse_weights;
use deepct_core::network::Network;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Ok(weights) = parse_weights(bytes, "fuzz.safetensors".as_ref()) {
        Network::new(&weights).expect("weights that were read make a network");
    }
});
