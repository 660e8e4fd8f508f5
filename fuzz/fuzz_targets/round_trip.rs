#![no_main]
//! What the writers accept, the readers read as it was: clouds, volumes, masks and images with any
//! values.

use deepct_core::cloud::{Cloud, Microphysics};
use deepct_core::grid::{Grid, Mask, Volume};
use deepct_core::image::ViewStack;
use deepct_core::io;
use deepct_core::math::DVec3;
use deepct_core::scene::{Observation, Sun, View};
use deepct_fuzz::{Values, provenance};
use libfuzzer_sys::arbitrary::{self, Arbitrary};

#[derive(Debug, Arbitrary)]
struct Input {
    shape: [u8; 3],
    origin: [f64; 3],
    spacing: [f64; 3],
    sun: (f64, f64),
    wavelength: f64,
    cameras: Vec<(f64, f64, f64, f64)>,
    values: Values,
}

libfuzzer_sys::fuzz_target!(|input: Input| {
    let Input { shape, origin, spacing, sun, wavelength, cameras, mut values } = input;
    let shape = shape.map(|extent| usize::from(extent % 4) + 1);
    let path = deepct_fuzz::folder().join("output.nc");
    if let Ok(grid) = Grid::new(DVec3::from_array(origin), DVec3::from_array(spacing), shape) {
        let droplets = Microphysics {
            liquid_water_content: values.field(shape),
            effective_radius: values.field(shape),
            effective_variance: values.field(shape),
        };
        if let Ok(cloud) = Cloud::from_microphysics(grid, droplets) {
            if io::write_cloud(&path, &cloud, &provenance()).is_ok() {
                if let Ok(read) = io::read_cloud(&path) {
                    assert_eq!(read, cloud);
                }
            }
        }
        let volume = Volume::new(grid, values.field(shape)).unwrap();
        if io::write_volume(&path, &volume, &provenance()).is_ok() {
            if let Ok(read) = io::read_volume(&path) {
                assert_eq!(read, volume);
            }
        }
        let mask = Mask::new(grid, values.field(shape).mapv(|value| value > 0.0)).unwrap();
        if io::write_mask(&path, &mask, &provenance()).is_ok() {
            if let Ok(read) = io::read_mask(&path) {
                assert_eq!(read, mask);
            }
        }
    }
    let target = DVec3::from_array(origin);
    let views: Vec<View> = cameras
        .iter()
        .filter_map(|&(x, y, z, tangent)| {
            View::perspective(DVec3::new(x, y, z), target, tangent, [shape[1], shape[2]]).ok()
        })
        .collect();
    let images = values.field([views.len(), shape[1], shape[2]]);
    let Ok(sun) = Sun::from_degrees(sun.0, sun.1) else { return };
    let Ok(images) = ViewStack::new(images) else { return };
    let Ok(mut observation) = Observation::new(sun, views, images) else { return };
    observation.light.wavelength = wavelength;
    if io::write_observation(&path, &observation, &provenance()).is_ok() {
        if let Ok(read) = io::read_observation(&path) {
            assert_eq!(read.images, observation.images);
            assert_eq!(read.views, observation.views);
        }
    }
});
