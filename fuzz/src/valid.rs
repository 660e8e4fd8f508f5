//! Valid files, from which the structured targets start.

use crate::{folder, provenance};
use deepct_core::cloud::{Cloud, Microphysics};
use deepct_core::grid::{Grid, Mask, Volume};
use deepct_core::image::ViewStack;
use deepct_core::io;
use deepct_core::math::{DVec3, towards};
use deepct_core::network::Estimate;
use deepct_core::scene::{Observation, Sun, View};
use ndarray::Array3;
use std::path::Path;

fn grid() -> Grid {
    Grid::new(DVec3::new(-0.3, 0.1, 0.48), DVec3::new(0.05, 0.07, 0.04), [3, 4, 5]).unwrap()
}

fn field(scale: f32) -> Array3<f32> {
    Array3::from_shape_fn(grid().shape, |(k, j, i)| scale * (1.0 + (k * 20 + j * 5 + i) as f32))
}

fn written(write: impl FnOnce(&Path) -> deepct_core::Result<()>) -> Vec<u8> {
    let path = folder().join("valid.nc");
    write(&path).unwrap();
    std::fs::read(&path).unwrap()
}

/// A cloud of droplets with its extinction.
pub fn cloud() -> Vec<u8> {
    let droplets = Microphysics {
        liquid_water_content: field(0.01),
        effective_radius: field(0.2),
        effective_variance: field(0.002),
    };
    let mut cloud = Cloud::from_microphysics(grid(), droplets).unwrap();
    cloud.extinction = Some(field(1.5));
    written(|path| io::write_cloud(path, &cloud, &provenance()))
}

fn observation() -> Observation {
    let target = DVec3::new(0.8, 0.7, 1.1);
    let camera = target + 612.3 * towards(0.7, 2.1);
    let views = vec![
        View::perspective(camera, target, 8.1e-5, [3, 4]).unwrap(),
        View::orthographic(towards(1.1, 4.7), target, 0.05, [3, 4]).unwrap(),
    ];
    let values = Array3::from_shape_fn((2, 3, 4), |(v, r, c)| 0.1 * (v * 12 + r * 4 + c) as f32);
    let error = ViewStack::new(values.mapv(|value| 0.01 * value)).unwrap();
    let sun = Sun::from_degrees(33.3, 217.1).unwrap();
    let mut observation = Observation::new(sun, views, ViewStack::new(values).unwrap()).unwrap();
    observation.standard_error = Some(error);
    observation
}

/// Two images with their standard errors.
pub fn images() -> Vec<u8> {
    written(|path| io::write_observation(path, &observation(), &provenance()))
}

/// The estimate of a network.
pub fn estimate() -> Vec<u8> {
    let volume = |scale| Volume::new(grid(), field(scale)).unwrap();
    let estimate = Estimate { extinction: volume(1.0), uncertainty: Some(volume(0.3)) };
    written(|path| io::write_estimate(path, &estimate, Some(&observation()), &provenance()))
}

/// A mask.
pub fn mask() -> Vec<u8> {
    let mask = Mask::new(grid(), field(1.0).mapv(|value| value > 20.0)).unwrap();
    written(|path| io::write_mask(path, &mask, &provenance()))
}
