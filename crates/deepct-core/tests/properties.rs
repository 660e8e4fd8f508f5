//! What must hold for every input: the effect of threads, irradiance and agreement, and defined
//! answers at the limits of the numbers. That an estimate does not depend on the part of the grid is
//! tested in `general.rs`, that units and formats change nothing in `files/`.

use deepct_core::Error;
use deepct_core::carve::{CarveSettings, carve};
use deepct_core::grid::{Grid, Mask, Volume};
use deepct_core::image::{ImagingGeometry, ViewStack};
use deepct_core::inversion::{InversionSettings, OrdinatesModels, Problem, Start, invert};
use deepct_core::io::{GENERAL_WEIGHTS, load_trained_weights, load_weights};
use deepct_core::math::DVec3;
use deepct_core::network::{Estimator, Network};
use deepct_core::optics::{Medium, PhaseFunction};
use deepct_core::scene::{Boundary, Formation, Light, Observation, Scene, Sun, Surface, View};
use deepct_core::transport::{MonteCarloSettings, OrdinatesSettings, Solver, render};
use ndarray::Array3;
use proptest::prelude::*;
use std::f64::consts::PI;

/// Numbers between 0 and 1 that look random.
fn scattered(index: usize) -> f32 {
    let mixed = (index as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    ((mixed ^ (mixed >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 40) as f32 / (1 << 24) as f32
}

/// Images with structure of a few pixels on a dark surface.
fn images(views: usize, rows: usize, cols: usize) -> Array3<f32> {
    Array3::from_shape_fn((views, rows, cols), |(view, row, col)| {
        let bright = scattered(view + 40 * (col / 3 + 1000 * (row / 3)));
        0.02 + 0.2 * bright * bright
    })
}

fn stack(values: Array3<f32>) -> ViewStack {
    ViewStack::new(values).unwrap()
}

/// The geometry of the formation `cloudct-10` above `target`.
fn geometry(target: DVec3) -> ImagingGeometry {
    let views = Formation::cloudct_10().views(target, [1, 1]).unwrap();
    let images = stack(Array3::zeros((views.len(), 1, 1)));
    Observation::new(Light::realistic(), views, images).unwrap().imaging_geometry().unwrap()
}

fn on_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
}

fn largest(values: impl IntoIterator<Item = f32>) -> f32 {
    values.into_iter().fold(0.0, f32::max)
}

#[test]
fn threads_change_no_bit_of_an_estimate_and_of_a_mask() {
    let geometry = geometry(DVec3::new(0.0, 0.0, 1.12));
    let values = stack(images(10, 70, 45));
    let views = Formation::cloudct_10().views(DVec3::new(0.0, 0.0, 1.12), [70, 45]).unwrap();
    let observation = Observation::new(Light::realistic(), views, values.clone()).unwrap();
    let results = [1, 2, 5].map(|threads| {
        on_threads(threads, || {
            let fixed = Network::new(&load_weights("cloudct-10").unwrap()).unwrap();
            let general = Estimator::new(load_trained_weights(GENERAL_WEIGHTS).unwrap());
            let general = general.estimate(&values, &geometry, None).unwrap();
            let grid = general.extinction.grid;
            let settings = CarveSettings { threshold: Some(0.08), agreement: 0.5 };
            let mask = carve(&observation, &grid, &settings).unwrap().mask;
            (fixed.infer(&values, &geometry).unwrap(), general.extinction, mask)
        })
    });
    assert!(results[0] == results[1] && results[0] == results[2]);
    assert!(results[0].2.count() > 0);
}

fn box_of(extinction: f32, shape: [usize; 3]) -> Medium {
    let grid = Grid::new(DVec3::new(0.0, 0.0, 0.5), DVec3::splat(0.05), shape).unwrap();
    let phase = PhaseFunction::henyey_greenstein(0.85).unwrap();
    Medium::new(Volume::constant(grid, extinction), 1.0, phase).unwrap()
}

fn monte_carlo(samples_per_pixel: u32) -> Solver {
    let settings = MonteCarloSettings { samples_per_pixel, ..Default::default() };
    Solver::MonteCarlo(settings)
}

fn ordinates() -> Solver {
    Solver::Ordinates(OrdinatesSettings::with_accuracy(0.05).unwrap())
}

#[test]
fn images_are_proportional_to_the_irradiance() {
    let medium = box_of(20.0, [4, 5, 6]);
    let views = Formation::cloudct_10().views(medium.extinction.grid.center(), [6, 6]).unwrap();
    for solver in [monte_carlo(16), ordinates()] {
        let images = |irradiance| {
            let sun = Sun { irradiance, ..Sun::from_degrees(40.0, 10.0).unwrap() };
            let scene = Scene::new(medium.clone(), sun, Surface::OCEAN).unwrap();
            render(&scene, &views, &solver, &()).unwrap().images.values
        };
        let (one, other) = (images(1.0), images(1361.0));
        for (one, other) in one.iter().zip(&other) {
            assert!((one * 1361.0 - other).abs() <= 2e-6 * other, "{one} {other}");
        }
    }
}

/// Gases above the cloud absorb the sunlight before and what a camera sees after it is scattered.
#[test]
fn gases_absorb_on_both_ways() {
    let medium = box_of(20.0, [4, 5, 6]);
    let views = Formation::cloudct_10().views(medium.extinction.grid.center(), [6, 6]).unwrap();
    for solver in [monte_carlo(16), ordinates()] {
        let images = |gas_optical_depth| {
            let sun = Sun::from_degrees(60.0, 10.0).unwrap();
            let scene = Scene::new(medium.clone(), sun, Surface::OCEAN).unwrap();
            let scene = Scene { gas_optical_depth, ..scene };
            render(&scene, &views, &solver, &()).unwrap().images.values
        };
        let (clear, absorbed) = (images(0.0), images(0.1));
        for (((view, row, col), clear), absorbed) in clear.indexed_iter().zip(&absorbed) {
            let ray = views[view].ray(row as f64 + 0.5, col as f64 + 0.5);
            let passed = (-0.1 * (2.0 + 1.0 / -ray.direction.z)).exp() as f32;
            assert!((clear * passed - absorbed).abs() <= 1e-5 * clear, "{clear} {absorbed}");
        }
    }
}

fn inside(one: &Mask, other: &Mask) -> bool {
    one.values.iter().zip(&other.values).all(|(one, other)| !one || *other)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, ..ProptestConfig::default() })]

    /// A larger agreement and a larger threshold keep fewer voxels, and none that a smaller one
    /// removes.
    #[test]
    fn carving_is_monotone(
        seed in 0..1000_usize,
        agreements in (0.0..1.0_f64, 0.0..1.0_f64),
        thresholds in (0.0..1.0_f32, 0.0..1.0_f32),
    ) {
        let grid = Grid::new(DVec3::new(-0.3, -0.3, 0.4), DVec3::splat(0.05), [8, 12, 12]).unwrap();
        let views = Formation::cloudct_10().views(grid.center(), [14, 14]).unwrap();
        let values = Array3::from_shape_fn((views.len(), 14, 14), |(view, row, col)| {
            scattered(seed + 7919 * (view + 10 * (col / 4 + 4 * (row / 4))))
        });
        let observation = Observation::new(Light::default(), views, stack(values)).unwrap();
        let mask = |agreement: f64, threshold: f32| {
            let settings = CarveSettings { threshold: Some(threshold), agreement };
            carve(&observation, &grid, &settings).unwrap().mask
        };
        let (low, high) = (agreements.0.min(agreements.1), agreements.0.max(agreements.1));
        let (dark, bright) = (thresholds.0.min(thresholds.1), thresholds.0.max(thresholds.1));
        prop_assert!(inside(&mask(high, dark), &mask(low, dark)));
        prop_assert!(inside(&mask(low, bright), &mask(low, dark)));
    }

    /// Any finite images give finite estimates that are not negative.
    #[test]
    fn any_images_have_an_estimate(
        magnitude in -45.0..30.0_f32,
        seed in 0..1000_usize,
    ) {
        let network = Network::new(&load_weights("cloudct-10").unwrap()).unwrap();
        let scale = 10.0_f32.powf(magnitude);
        let values = Array3::from_shape_fn((10, 5, 4), |(view, row, col)| {
            scale * scattered(seed + view + 10 * (col + 4 * row))
        });
        let estimate = network.infer(&stack(values), &geometry(DVec3::new(0.0, 0.0, 1.12)));
        match estimate {
            Ok(estimate) => prop_assert!(estimate.check_non_negative("extinction").is_ok()),
            Err(problem) => prop_assert!(!problem.to_string().is_empty()),
        }
    }
}

/// The reflectance, seen from the nadir, of a plane-parallel layer of `levels` voxels of the given
/// optical depth without absorption, and the images' warnings.
fn reflectance(levels: usize, depth: f64, solver: &Solver) -> (f64, Vec<String>) {
    let medium = box_of((depth / 0.05) as f32, [levels, 1, 1]);
    let sun = Sun::from_degrees(30.0, 0.0).unwrap();
    let scene = Scene::new(medium, sun, Surface::BLACK).unwrap().with_boundary(Boundary::Periodic);
    let target = scene.medium.extinction.grid.center();
    let view = View::orthographic(DVec3::Z, target, 0.05, [1, 1]).unwrap();
    let rendering = render(&scene, &[view], solver, &()).unwrap();
    let radiance = f64::from(rendering.images.values[[0, 0, 0]]);
    (PI * radiance / 30_f64.to_radians().cos(), rendering.warnings())
}

/// Layers of which light leaves only after hundreds of scatterings, compared with adding and
/// doubling (`fixtures/doubling.py`, asymmetry parameter 0.85).
#[test]
fn thick_layers_are_those_of_adding_and_doubling() {
    let default = Solver::Ordinates(OrdinatesSettings::default());
    for (levels, depth, expected) in
        [(32, 0.25, 0.346353), (32, 0.625, 0.647432), (32, 1.25, 0.827809), (32, 2.5, 0.946777)]
    {
        let (found, warnings) = reflectance(levels, depth, &default);
        assert!((found / expected - 1.0).abs() < 0.005, "{levels} x {depth}: {found} {expected}");
        assert!(warnings.is_empty(), "{warnings:?}");
    }
}

/// A layer of optical depth 10,000 reflects nearly all light. The discrete-ordinates solver cannot
/// resolve its voxels, and says so.
#[test]
fn an_optical_depth_of_ten_thousand_has_an_answer() {
    let (found, warnings) = reflectance(4, 2500.0, &monte_carlo(1000));
    assert!((found / 1.092838 - 1.0).abs() < 0.15 && warnings.is_empty(), "{found} {warnings:?}");
    let (found, warnings) = reflectance(4, 2500.0, &ordinates());
    assert!((0.0..1.2).contains(&found), "{found}");
    assert!(warnings.iter().any(|text| text.contains("too thick")), "{warnings:?}");
}

#[test]
fn one_voxel_one_pixel_and_one_view_have_an_answer() {
    let medium = box_of(20.0, [1, 1, 1]);
    let grid = medium.extinction.grid;
    let scene = Scene::new(medium, Sun::from_degrees(30.0, 0.0).unwrap(), Surface::BLACK).unwrap();
    let view = View::orthographic(DVec3::Z, grid.center(), 0.05, [1, 1]).unwrap();
    let [paths, ordinates] = [monte_carlo(20_000), ordinates()]
        .map(|solver| render(&scene, std::slice::from_ref(&view), &solver, &()).unwrap().images);
    let (one, other) = (paths.values[[0, 0, 0]], ordinates.values[[0, 0, 0]]);
    assert!((other / one - 1.0).abs() < 0.05, "{one} {other}");
    let observation = Observation::new(scene.sun, vec![view], paths).unwrap();
    let carved =
        carve(&observation, &grid, &CarveSettings { threshold: Some(0.0), agreement: 0.9 });
    assert_eq!(carved.unwrap().mask.count(), 1);
}

/// The estimate of black images is clear; those of images without contrast are defined.
#[test]
fn black_and_uniform_images_have_an_estimate() {
    let geometry = geometry(DVec3::new(0.0, 0.0, 1.12));
    let general = Estimator::new(load_trained_weights(GENERAL_WEIGHTS).unwrap());
    for value in [0.0, 1e-40, 0.02, 1.0] {
        let uniform = stack(Array3::from_elem((10, 20, 20), value));
        let estimate = general.estimate(&uniform, &geometry, None).unwrap().extinction;
        estimate.check_non_negative("extinction").unwrap();
        let most = largest(estimate.values.iter().copied());
        // A cloud of 100 /km would fill such an image at 0.3.
        assert!(value > 0.5 || most < 2.0, "{value} {most}");
    }
}

#[test]
fn values_that_are_not_numbers_are_refused() {
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut values = images(3, 4, 4);
        values[[1, 2, 3]] = value;
        let problem = ViewStack::new(values).unwrap_err();
        assert!(matches!(problem, Error::OutOfRange { .. }), "{problem}");
    }
}

/// Black images contain no light, from which nothing follows.
#[test]
fn black_images_are_not_inverted() {
    let grid = Grid::new(DVec3::new(-0.1, -0.1, 0.5), DVec3::splat(0.05), [4, 4, 4]).unwrap();
    let views = Formation::cloudct_10().views(grid.center(), [8, 8]).unwrap();
    let images = stack(Array3::zeros((views.len(), 8, 8)));
    let observation = Observation::new(Light::default(), views, images).unwrap();
    let mask = Mask::new(grid, Array3::from_elem(grid.shape, true)).unwrap();
    let problem = Problem { bands: std::slice::from_ref(&observation), mask: &mask, truth: None };
    let settings = InversionSettings::default();
    let medium = box_of(0.0, [1, 1, 1]);
    let medium = Medium { extinction: Volume::constant(grid, 0.0), ..medium };
    let scene = Scene::new(medium, observation.light.sun, Surface::BLACK).unwrap();
    let views = observation.views.clone();
    let mut models = OrdinatesModels::new(scene, views, OrdinatesSettings::default());
    let problem = invert(&problem, &mut models, &Start::Search, &settings, &()).unwrap_err();
    assert!(problem.to_string().contains("brightest radiance is 0"), "{problem}");
}

/// Weights, plans and results hold numbers as text, which by default is read with an error of the last
/// digit.
#[test]
fn numbers_in_json_are_read_as_they_were_written() {
    // Some of these change without the feature `float_roundtrip`.
    for number in (1..20_000).map(|n| 1.0 / f64::from(n) + f64::from(n).sqrt()) {
        let text = serde_json::to_string(&number).unwrap();
        assert_eq!(serde_json::from_str::<f64>(&text).unwrap(), number);
    }
}
