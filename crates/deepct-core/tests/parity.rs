//! Compares the network with PyTorch in float64, on the fixtures written by `parity/generate.py`.
//! weights_tools compares the published architectures with 33 and 81 layers. The fixture of the
//! general network is written by `python -m weights_tools.fixture`.

use deepct_core::conv::{Algorithm, Kernel, Settings};
use deepct_core::image::{ImagingGeometry, ViewGeometry};
use deepct_core::io::{read_trained_weights, read_weights};
use deepct_core::math::DVec3;
use deepct_core::network::{GeneralWeights, Network, TrainedWeights};
use safetensors::SafeTensors;
use std::path::{Path, PathBuf};

/// Tolerance of the largest error divided by the largest value. The rounding errors of Winograd's
/// larger tiles are several times larger.
fn tolerance(algorithm: Algorithm) -> f32 {
    if algorithm == Algorithm::WinogradF4 { 1e-5 } else { 2e-6 }
}

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/parity").join(name)
}

/// The same images as in `generate.py`.
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
    let kernels = Kernel::available().into_iter();
    for (kernel, algorithm) in kernels.flat_map(|k| Algorithm::ALL.map(|algorithm| (k, algorithm)))
    {
        let settings = Settings { kernel, algorithm: Some(algorithm), ..Settings::default() };
        let network = Network::with_settings(&weights, settings).unwrap();
        for (size_name, answer) in answers.iter() {
            let size = [1, answer.shape()[1], answer.shape()[2]];
            let expected = floats(answer.data());
            let mut found = vec![f32::NAN; expected.len()];
            let mut scratch = network.scratch(size).unwrap();
            let input = images(network.views() * size[1] * size[2]);
            network.run(&input, &mut found, &mut scratch).unwrap();
            let largest = expected.iter().fold(0.0_f32, |most, value| most.max(value.abs()));
            let differences = found.iter().zip(&expected).map(|(a, b)| (a - b).abs());
            let error = differences.fold(0.0, f32::max) / largest;
            let what = format!("{name} {size_name} {} {}", kernel.name(), algorithm.name());
            assert!(largest > 0.1, "{what}: PyTorch's output is too small to compare");
            assert!(error <= tolerance(algorithm), "{what}: {error:e}");
            println!("{what}: {error:.1e}");
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

#[test]
fn images_on_planes() {
    compare("planes");
}

/// A geometry of the fixture of the general network.
#[derive(serde::Deserialize)]
struct Case {
    horizontal_spacing_km: f64,
    target_altitude_km: f64,
    view_geometry: ViewGeometry,
}

fn general() -> GeneralWeights {
    match read_trained_weights(fixture("general.safetensors")).unwrap() {
        TrainedWeights::General(weights) => weights,
        _ => panic!("the fixture is a general network"),
    }
}

/// The output for the images of `generate.py` on `[rows, cols]` voxels, divided by its scale.
fn folded_output(weights: &GeneralWeights, case: &Case, [rows, cols]: [usize; 2]) -> Vec<f32> {
    let geometry = ImagingGeometry {
        views: case.view_geometry.clone(),
        target_km: [0.0, 0.0, case.target_altitude_km],
        wavelength_um: 0.672,
        solar_irradiance: 1.0,
        shifts: Vec::new(),
    };
    let target = DVec3::from(geometry.target_km);
    let grid = weights.grid(case.horizontal_spacing_km, target, [rows, cols]).unwrap();
    let network = Network::new(&weights.fold(&geometry, &grid, true).unwrap()).unwrap();
    let mut found = vec![f32::NAN; network.output_channels() * rows * cols];
    let mut scratch = network.scratch([1, rows, cols]).unwrap();
    network.run(&images(network.views() * rows * cols), &mut found, &mut scratch).unwrap();
    let scale = network.metadata().output_scale as f32;
    found.iter().map(|value| value / scale).collect()
}

/// The folded network agrees with the unfolded one of PyTorch in float64, for 3 to 40 views in any
/// direction, any Sun and voxels of 15 to 150 m.
#[test]
fn the_general_network_folds_for_any_geometry() {
    let weights = general();
    let text = std::fs::read_to_string(fixture("general.json")).unwrap();
    let cases: Vec<Case> = serde_json::from_str(&text).unwrap();
    let bytes = std::fs::read(fixture("general.answers.safetensors")).unwrap();
    let answers = SafeTensors::deserialize(&bytes).unwrap();
    assert_eq!(cases.len(), 50);
    let mut worst = 0.0_f32;
    for (number, case) in cases.iter().enumerate() {
        let answer = answers.tensor(&format!("{number}.output")).unwrap();
        let expected = floats(answer.data());
        let found = folded_output(&weights, case, [answer.shape()[1], answer.shape()[2]]);
        assert_eq!(found.len(), expected.len());
        let largest = expected.iter().fold(0.0_f32, |most, value| most.max(value.abs()));
        assert!(largest > 0.1, "{number}: PyTorch's output is too small to compare");
        let differences = found.iter().zip(&expected).map(|(a, b)| (a - b).abs());
        let error = differences.fold(0.0, f32::max) / largest;
        assert!(error <= 2e-6, "{number}: {error:e}");
        worst = worst.max(error);
    }
    println!("largest error of 50 geometries: {worst:.1e}");
}
