//! The network against PyTorch in float64, on the fixtures that `parity/generate.py`
//! wrote. The published layouts, 33 and 81 layers deep, are compared by weights_tools.

use deepct_core::conv::Kernel;
use deepct_core::io::read_weights;
use deepct_core::network::Network;
use safetensors::SafeTensors;
use std::path::{Path, PathBuf};

/// Largest error over largest value.
const TOLERANCE: f32 = 2e-6;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/parity").join(name)
}

/// The images that `generate.py` makes.
fn images(count: usize) -> Vec<f32> {
    (0..count).map(|index| ((index * 7919 + index / 97 * 31) % 128) as f32 / 128.0).collect()
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()
}

fn compare(name: &str) {
    let weights = read_weights(fixture(&format!("{name}.safetensors"))).unwrap();
    let bytes = std::fs::read(fixture(&format!("{name}.answers.safetensors"))).unwrap();
    let answers = SafeTensors::deserialize(&bytes).unwrap();
    assert_eq!(answers.len(), 3);
    for kernel in Kernel::available() {
        let network = Network::with_kernel(&weights, kernel).unwrap();
        for (size_name, answer) in answers.iter() {
            let size = [answer.shape()[1], answer.shape()[2]];
            let expected = floats(answer.data());
            let mut found = vec![f32::NAN; expected.len()];
            let mut scratch = vec![0.0; network.scratch_len(size)];
            let input = images(network.views() * size[0] * size[1]);
            network.run(&input, size, &mut found, &mut scratch).unwrap();
            let largest = expected.iter().fold(0.0_f32, |most, value| most.max(value.abs()));
            let differences = found.iter().zip(&expected).map(|(a, b)| (a - b).abs());
            let error = differences.fold(0.0, f32::max) / largest;
            assert!(largest > 0.1, "{name} {size_name}: PyTorch's answer is too small to compare");
            assert!(error <= TOLERANCE, "{name} {size_name} {kernel:?}: {error:e}");
            println!("{name} {size_name} {}: {error:.1e}", kernel.name());
        }
    }
}

#[test]
fn ten_views_with_batch_norm() {
    compare("views-10");
}

#[test]
fn odd_channels_without_a_last_relu() {
    compare("odd");
}
