//! Compares the network with PyTorch in float64, on the fixtures written by `parity/generate.py`.
//! weights_tools compares the published architectures with 33 and 81 layers. The fixture of the
//! general network is written by `python -m weights_tools.fixture`.

use deepct_core::conv::{Algorithm, Kernel, Settings};
use deepct_core::image::{ImagingGeometry, ViewGeometry, ViewStack};
use deepct_core::io::{read_trained_weights, read_weights};
use deepct_core::math::DVec3;
use deepct_core::network::{BandImages, GeneralWeights, Network, TrainedWeights};
use ndarray::{Array4, Axis};
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
            let input = images(network.metadata().images() * size[1] * size[2]);
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

#[test]
fn images_of_two_bands_on_planes() {
    compare("bands");
}

/// The estimate from the observations of two bands has the effective radius of PyTorch, within its
/// limits, where there is extinction.
#[test]
fn an_estimate_from_two_bands_has_an_effective_radius() {
    let weights = read_weights(fixture("bands.safetensors")).unwrap();
    let network = Network::new(&weights).unwrap();
    let metadata = network.metadata();
    let (rows, cols, views) = (31, 45, metadata.views());
    let values = Array4::from_shape_vec((2, views, rows, cols), images(2 * views * rows * cols));
    let values = values.unwrap();
    let stacks = [0, 1].map(|band| ViewStack::new(values.index_axis(Axis(0), band).to_owned()));
    let geometries = [0, 1].map(|band| ImagingGeometry {
        views: metadata.view_geometry.clone(),
        target_km: [0.0, 0.0, metadata.target_altitude_km],
        wavelength_um: metadata.wavelengths_um[band],
        solar_irradiance: 1.0,
        shifts: Vec::new(),
    });
    let stacks = stacks.map(Result::unwrap);
    let band =
        |number: usize| BandImages { images: &stacks[number], geometry: &geometries[number] };
    let grid = network.grid([0.0, 0.0], [rows, cols]).unwrap();
    let estimate = network.estimate_bands(&grid, &[band(0), band(1)]).unwrap();
    let bytes = std::fs::read(fixture("bands.answers.safetensors")).unwrap();
    let answers = SafeTensors::deserialize(&bytes).unwrap();
    let expected = floats(answers.tensor("31x45").unwrap().data());
    let (extinction, radius) = expected.split_at(expected.len() / 2);
    let found = estimate.effective_radius.unwrap();
    let (mut limited, mut inside) = (0, 0);
    for ((found, radius), extinction) in found.values.iter().zip(radius).zip(extinction) {
        // Where PyTorch's extinction is barely positive, that in single precision may be 0.
        if *extinction > 1e-5 {
            let radius = 10.0 * radius;
            assert!((found - radius.clamp(1.0, 25.0)).abs() < 1e-4, "{found} {radius}");
            match (1.0..25.0).contains(&radius) {
                true => inside += 1,
                false => limited += 1,
            }
        }
    }
    let pairs = found.values.iter().zip(&estimate.extinction.values);
    assert!(pairs.into_iter().all(|(radius, extinction)| (*radius > 0.0) == (*extinction > 0.0)));
    assert!(limited > 100 && inside > 100, "{limited} {inside}");

    let text = |bands: &[BandImages]| network.estimate_bands(&grid, bands).unwrap_err().to_string();
    let one = text(&[band(0)]);
    let problem = "number of bands: expected 2 (0.672 and 2.13 um), found 1 (0.672 um)";
    assert!(one.contains(problem) && one.contains("at 0.672 and 2.13 um, in this order"), "{one}");
    let order = text(&[band(1), band(0)]);
    assert!(order.contains("wavelength of band 0: expected 0.6720 um, found 2.1300 um"), "{order}");
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
