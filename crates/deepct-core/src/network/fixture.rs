//! Weights for tests.

use super::{
    Architecture, FORMAT_VERSION, ImageLayout, LayerWeights, Levels, NetworkOutput, Training,
    Weights, WeightsMetadata,
};
use crate::image::ViewGeometry;
use ndarray::{Array1, Array4};
use std::collections::BTreeMap;

/// Random weights that approximately preserve the magnitude of a signal from layer to layer.
pub(crate) fn weights(channels: &[usize], seed: u64) -> Weights {
    let mut state = seed;
    // The linear congruential generator of Knuth's MMIX, of which only the upper bits are used
    // because they are the most random.
    let mut draw = |bound: f32| {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        bound * ((state >> 40) as f32 / (1 << 23) as f32 - 1.0)
    };
    let layers = channels
        .windows(2)
        .map(|pair| {
            let bound = (6.0 / (9.0 * pair[0] as f32)).sqrt();
            LayerWeights {
                weight: Array4::from_shape_fn((pair[1], pair[0], 3, 3), |_| draw(bound)),
                bias: Array1::from_shape_fn(pair[1], |_| draw(0.1)),
            }
        })
        .collect();
    Weights::new(metadata(channels), layers).unwrap()
}

/// Metadata of a network with the given channels.
pub(crate) fn metadata(channels: &[usize]) -> WeightsMetadata {
    let views = channels[0];
    let count = channels[channels.len() - 1];
    WeightsMetadata {
        format_version: FORMAT_VERSION,
        formation: "test".into(),
        architecture: Architecture { channels: channels.to_vec(), last_relu: true },
        view_geometry: ViewGeometry {
            sun_zenith_deg: 30.0,
            sun_azimuth_deg: 45.0,
            view_zenith_deg: (0..views).map(|view| 9.0 * view as f64 / views as f64).collect(),
            view_azimuth_deg: (0..views).map(|view| 10.0 * (view % 2) as f64).collect(),
            pixel_km: vec![0.05; views],
            camera_distance_km: vec![Some(600.0); views],
        },
        target_altitude_km: 1.0,
        wavelengths_um: vec![0.672],
        image_layout: ImageLayout::Camera,
        horizontal_spacing_km: [0.05, 0.05],
        levels: Levels { bottom_km: 0.4, count, spacing_km: 0.04 },
        outputs: vec![NetworkOutput::Extinction],
        input_scale: 10.0,
        output_scale: 5.0,
        effective_radius_scale: None,
        training: Training { data: "none".into(), identity: "".into(), samples: 0, seed: 1 },
        scores: BTreeMap::from([("epsilon".into(), 0.5)]),
        program: "test".into(),
        configuration: serde_json::json!({"epochs": 3}),
    }
}
