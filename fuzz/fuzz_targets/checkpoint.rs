#![no_main]
//! Checkpoints of inversions: arbitrary bytes, or any header before tensors of zeros, followed by
//! their checksum, give a checkpoint or an error.

use deepct_core::io::read_checkpoint;
use sha2::{Digest, Sha256};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let read = |bytes: &[u8]| {
        let bytes = [bytes, &Sha256::digest(bytes)].concat();
        deepct_fuzz::with_file(&bytes, ".checkpoint", |path| {
            let _ = read_checkpoint(path, "identity");
        });
    };
    read(bytes);
    read(&deepct_fuzz::safetensors_with(bytes));
});
