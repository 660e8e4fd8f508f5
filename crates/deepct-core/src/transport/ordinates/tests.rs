//! Tests of the solver against finite differences and the Monte Carlo solver.

use super::*;
use crate::grid::Grid;
use crate::math::{DVec3, towards};
use crate::optics::air::Air;
use crate::optics::{DropletSettings, DropletTable, Interpolation, Medium, PhaseFunction};
use crate::rng::{Purpose, RngExt, stream};
use crate::scene::{Boundary, Sun, Surface, View};
use crate::transport::{MonteCarloSettings, Solver, render};
use std::sync::Arc;

/// Tolerance of the solver in these tests.
const TOLERANCE: f64 = 1e-6;

pub(super) fn grid() -> Grid {
    Grid::new(DVec3::new(0.0, 0.0, 0.6), DVec3::new(0.05, 0.05, 0.04), [4, 5, 6]).unwrap()
}

/// A non-uniform cloud, with the largest extinction in its middle.
pub(super) fn cloud(peak: f32) -> Volume {
    let grid = grid();
    let values = Array3::from_shape_fn(grid.shape, |(k, j, i)| {
        let at = grid.voxel_center([k, j, i]) - grid.center();
        let inside = (1.0 - 2.5 * (at / grid.extent()).length()).max(0.0) as f32;
        let uneven = 1.0 + 0.3 * ((7 * k + 3 * j + 5 * i) % 5) as f32;
        peak * inside * uneven
    });
    Volume::new(grid, values).unwrap()
}

pub(super) fn model(
    extinction: &Volume,
    interpolation: Interpolation,
    boundary: Boundary,
) -> OrdinatesModel {
    let phase = PhaseFunction::henyey_greenstein(0.85).unwrap();
    let medium = Medium::new(extinction.clone(), 0.98, phase).unwrap();
    let sun = Sun::from_degrees(30.0, 70.0).unwrap();
    let surface = Surface { altitude: 0.2, ..Surface::lambertian(0.4) };
    let scene = Scene::new(medium.with_interpolation(interpolation), sun, surface).unwrap();
    let scene = scene.with_air(Air::new(0.672).unwrap());
    let view = |zenith, azimuth| {
        let target = grid().center();
        View::orthographic(towards(zenith, azimuth), target, 0.06, [6, 5]).unwrap()
    };
    let views = [view(0.0, 0.0), view(0.6, 1.0), view(0.9, 4.0)];
    let mask = Mask::new(grid(), Array3::from_elem(grid().shape, true)).unwrap();
    let settings = OrdinatesSettings {
        zenith_angles: 4,
        tolerance: TOLERANCE,
        largest_extinction: Some(100.0),
        ..OrdinatesSettings::default()
    };
    OrdinatesModel::new(&scene.with_boundary(boundary), &views, Some(&mask), &settings).unwrap()
}

/// Weights of both signs, as in a misfit.
fn weights(images: &ViewStack) -> ViewStack {
    let weight = |((v, row, col), _): ((usize, usize, usize), &f32)| {
        ((v * 31 + row * 7 + col * 3) % 11) as f32 / 5.0 - 0.7
    };
    let values = images.values.indexed_iter().map(weight).collect();
    ViewStack::new(Array3::from_shape_vec(images.values.raw_dim(), values).unwrap()).unwrap()
}

fn weighted(images: &ViewStack, weights: &ViewStack) -> f64 {
    images.values.iter().zip(&weights.values).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
}

/// Derivative in a direction, central difference, and the uncertainty of the latter that is due to
/// the tolerance of the solver.
fn compare(
    peak: f32,
    interpolation: Interpolation,
    boundary: Boundary,
    direction: impl Fn([usize; 3]) -> f32,
) -> [f64; 3] {
    let extinction = cloud(peak);
    let mut model = model(&extinction, interpolation, boundary);
    let images = model.images(&extinction).unwrap();
    let weights = weights(&images);
    let gradient = model.gradient(&weights).unwrap();
    let step = 0.01 * peak;
    let mut moved = |sign: f32| {
        let mut extinction = extinction.clone();
        for ((k, j, i), value) in extinction.values.indexed_iter_mut() {
            *value += sign * step * direction([k, j, i]);
        }
        weighted(&model.images(&extinction).unwrap(), &weights)
    };
    let difference = (moved(1.0) - moved(-1.0)) / (2.0 * f64::from(step));
    let derivative = gradient
        .values
        .indexed_iter()
        .map(|((k, j, i), value)| f64::from(*value) * f64::from(direction([k, j, i])))
        .sum();
    let all: f64 = images.values.iter().map(|value| f64::from(*value)).sum();
    [derivative, difference, TOLERANCE * all / f64::from(step)]
}

/// A direction that leaves empty voxels empty.
fn wave([k, j, i]: [usize; 3]) -> f32 {
    let at = grid().voxel_center([k, j, i]) - grid().center();
    if (at / grid().extent()).length() < 0.39 {
        ((3 * k + 5 * j + 2 * i) % 7) as f32 / 3.0 - 0.8
    } else {
        0.0
    }
}

#[test]
fn derivatives_are_central_differences() {
    for interpolation in [Interpolation::Constant, Interpolation::Trilinear] {
        for boundary in [Boundary::Open, Boundary::Periodic] {
            for peak in [0.1, 10.0, 50.0, 150.0] {
                let one = |voxel: [usize; 3]| f32::from(u8::from(voxel == [2, 2, 3]));
                for [derivative, difference, noise] in [
                    compare(peak, interpolation, boundary, wave),
                    compare(peak, interpolation, boundary, one),
                ] {
                    assert!(
                        (derivative - difference).abs() < 2e-3 * difference.abs() + noise,
                        "{interpolation:?} {boundary:?} {peak}: {derivative} {difference} {noise}"
                    );
                }
            }
        }
    }
}

/// Effective radii between the nodes of [`table_of`], at least 0.3 um from each (um).
fn radii() -> Volume {
    let values = Array3::from_shape_fn(grid().shape, |(k, j, i)| {
        let part = ((7 * k + 3 * j + 5 * i) % 11) as f32 / 10.0;
        if (k + i) % 3 == 0 { 4.5 + 3.0 * part } else { 8.5 + 6.0 * part }
    });
    Volume::new(grid(), values).unwrap()
}

fn table_of(wavelength: f64) -> Arc<DropletTable> {
    let settings = DropletSettings::water(wavelength);
    Arc::new(DropletTable::mie(&settings, &[4.0, 8.0, 16.0]).unwrap())
}

/// Central differences in eight voxels, among those with a derivative that is not close to zero, and
/// in four random directions, for thin and thick clouds in visible and in absorbed light.
#[test]
fn derivatives_by_effective_radius_are_central_differences() {
    const STEP: f32 = 0.25;
    for (wavelength, boundary, interpolation) in [
        (0.672, Boundary::Open, Interpolation::Constant),
        (1.6, Boundary::Periodic, Interpolation::Trilinear),
        (2.13, Boundary::Open, Interpolation::Constant),
    ] {
        let table = table_of(wavelength);
        for peak in [3.0, 100.0] {
            let extinction = cloud(peak);
            let droplets = |radii: &Volume| {
                Medium::of_droplets(extinction.clone(), radii.values.clone(), table.clone())
            };
            let mut model = model(&extinction, interpolation, boundary);
            let medium = droplets(&radii()).unwrap().with_interpolation(interpolation);
            let scene = Scene { medium, ..model.scene.clone() };
            let settings = model.settings;
            model = OrdinatesModel::new(&scene, &model.views, None, &settings).unwrap();
            let images = model.images(&extinction).unwrap();
            let weights = weights(&images);
            let gradient = model.derivatives(&weights).unwrap().effective_radius;
            let mut random = stream(5, Purpose::Validation, &[]);
            let squares: f32 = gradient.values.iter().map(|slope| slope * slope).sum();
            let least = 0.25 * (squares / gradient.values.len() as f32).sqrt();
            let sloping: Vec<_> =
                gradient.values.indexed_iter().filter(|(_, slope)| slope.abs() > least).collect();
            let single = (0..8).map(|_| {
                let mut direction = Array3::zeros(gradient.values.raw_dim());
                direction[sloping[random.random_range(0..sloping.len())].0] = STEP;
                direction
            });
            let mut directions: Vec<Array3<f32>> = single.collect();
            directions.extend(
                (0..4).map(|_| gradient.values.mapv(|_| STEP * random.random_range(-1.0_f32..1.0))),
            );
            let all: f64 = images.values.iter().map(|value| f64::from(*value)).sum();
            for (number, direction) in directions.iter().enumerate() {
                let mut moved = |sign: f32| {
                    let values = &radii().values + &(sign * direction);
                    let radii = Volume::new(grid(), values).unwrap();
                    // All solutions start from the dark, so that their errors are similar.
                    model.forget();
                    weighted(&model.images_of_droplets(&extinction, &radii).unwrap(), &weights)
                };
                let difference = 0.5 * (moved(1.0) - moved(-1.0));
                let along = &gradient.values * direction;
                let derivative: f64 = along.iter().map(|value| f64::from(*value)).sum();
                let noise = 0.1 * TOLERANCE * all;
                assert!(
                    (derivative - difference).abs() < 0.01 * difference.abs() + noise,
                    "{wavelength} {boundary:?} {interpolation:?} {peak} {number}: {derivative} \
                     {difference} {noise}"
                );
            }
        }
    }
}

/// Radii that are replaced give the images and derivatives of a model that was made with them.
#[test]
fn replaced_radii_are_those_of_the_scene() {
    let extinction = cloud(30.0);
    let table = table_of(2.13);
    let scene = |radii: &Volume| {
        let medium = Medium::of_droplets(extinction.clone(), radii.values.clone(), table.clone());
        Scene::new(medium.unwrap(), Sun::default(), Surface::BLACK).unwrap()
    };
    let views = [View::orthographic(towards(0.6, 1.0), grid().center(), 0.06, [6, 5]).unwrap()];
    let make = |radii: &Volume| {
        OrdinatesModel::new(&scene(radii), &views, None, &Default::default()).unwrap()
    };
    let mut model = make(&Volume::constant(grid(), 12.0));
    let found = model.images_of_droplets(&extinction, &radii()).unwrap();
    let mut fresh = make(&radii());
    assert_eq!(found, fresh.images(&extinction).unwrap());
    let weights = weights(&found);
    assert_eq!(model.derivatives(&weights).unwrap(), fresh.derivatives(&weights).unwrap());
    let beyond = model.images_of_droplets(&extinction, &Volume::constant(grid(), 17.0));
    assert!(beyond.unwrap_err().to_string().contains("16 um"));
    model.forget();
    assert_eq!(model.images(&extinction).unwrap(), found);
    let mut uniform =
        OrdinatesModel::new(&bare(&extinction, 0.8), &views, None, &Default::default());
    let refused = uniform.as_mut().unwrap().images_of_droplets(&extinction, &radii());
    assert!(refused.unwrap_err().to_string().contains("uniform"));
}

/// Compares the mean of each image with that of the Monte Carlo solver.
fn check_means(images: &ViewStack, scene: &Scene, views: &[View], samples: u32, case: &str) {
    let settings = MonteCarloSettings { samples_per_pixel: samples, ..Default::default() };
    let truth = render(scene, views, &Solver::MonteCarlo(settings), &()).unwrap();
    let errors = truth.standard_error.as_ref().unwrap();
    for view in 0..views.len() {
        let mean = |stack: &ViewStack| f64::from(stack.image(view).mean().unwrap());
        let error = errors.image(view);
        let squares: f64 = error.iter().map(|e| f64::from(e * e)).sum();
        let noise = squares.sqrt() / error.len() as f64;
        let (found, expected) = (mean(images), mean(&truth.images));
        assert!(
            (found - expected).abs() < 0.01 * expected + 3.0 * noise,
            "{case}, view {view}: {found} {expected} +- {noise}"
        );
    }
}

/// Comparison of the view means with those of the Monte Carlo solver, for the cloud alone, above a
/// bright surface, and in a molecular atmosphere. Such a small, non-uniform cloud requires fine
/// angles, cells and rays.
#[test]
fn images_are_those_of_random_paths() {
    let extinction = cloud(60.0);
    let bright = Surface { altitude: 0.2, ..Surface::lambertian(0.4) };
    let air = Some(Air::new(0.672).unwrap());
    for (boundary, surface, air) in [
        (Boundary::Open, Surface::BLACK, None),
        (Boundary::Periodic, Surface::BLACK, None),
        (Boundary::Open, bright, None),
        (Boundary::Periodic, bright, None),
        (Boundary::Open, bright, air),
    ] {
        let OrdinatesModel { scene, views, .. } =
            model(&extinction, Interpolation::Constant, boundary);
        let scene = Scene { surface, air, ..scene };
        let settings = OrdinatesSettings {
            rays_per_pixel: 55,
            cell_depth: 1.0,
            zenith_angles: 16,
            ..Default::default()
        };
        let mut model = OrdinatesModel::new(&scene, &views, None, &settings).unwrap();
        let images = model.images(&extinction).unwrap();
        let case = format!("{boundary:?} {surface:?} {air:?}");
        check_means(&images, &scene, &views, 8000, &case);
    }
}

/// Cameras below the cloud, beside it inside the grid, and in it. The Monte Carlo solver follows rays
/// of any origin and direction.
#[test]
fn cameras_may_look_up_and_stand_inside_the_scene() {
    let extinction = cloud(30.0);
    let center = extinction.grid.center();
    let (low, high) = (extinction.grid.lower(), extinction.grid.upper());
    let see =
        |position: DVec3, target: DVec3| View::perspective(position, target, 0.05, [8, 8]).unwrap();
    let below = DVec3::new(high.x, center.y, 0.05);
    let beside = DVec3::new(high.x - 0.01, center.y, low.z + 0.05);
    let views = [
        see(below, center),
        see(beside, center + 0.4 * (center - beside).with_z(0.0)),
        see(DVec3::new(low.x + 0.01, center.y, high.z - 0.02), center),
        see(center, center + DVec3::new(-0.4, -0.4, 0.1)),
        View::looking_up(towards(2.5, 3.5), center.with_z(low.z), 0.06, [8, 8]).unwrap(),
    ];
    let OrdinatesModel { scene, .. } = model(&extinction, Interpolation::Constant, Boundary::Open);
    let surface = Surface { altitude: 0.0, ..Surface::lambertian(0.2) };
    let air = Some(Air::new(0.55).unwrap());
    let scene = Scene { surface, air, ..scene };
    let settings = OrdinatesSettings {
        rays_per_pixel: 55,
        cell_depth: 0.5,
        zenith_angles: 16,
        ..Default::default()
    };
    let images = OrdinatesModel::new(&scene, &views, None, &settings)
        .and_then(|mut model| model.images(&extinction))
        .unwrap();
    check_means(&images, &scene, &views, 10_000, "cameras");
    let towards_sun = View::perspective(below, below + 0.2 * scene.sun.towards(), 0.05, [8, 8]);
    let problem = OrdinatesModel::new(&scene, &[towards_sun.unwrap()], None, &Default::default());
    assert!(problem.err().unwrap().to_string().contains("aureole"));
}

/// A cloud above a black surface, without a molecular atmosphere.
pub(super) fn bare(extinction: &Volume, asymmetry: f64) -> Scene {
    let phase = PhaseFunction::henyey_greenstein(asymmetry).unwrap();
    let medium = Medium::new(extinction.clone(), 1.0, phase).unwrap();
    Scene::new(medium, Sun::default(), Surface::BLACK).unwrap()
}

fn solved(scene: &Scene, views: &[View]) -> ViewStack {
    let settings = OrdinatesSettings::default();
    let mut model = OrdinatesModel::new(scene, views, None, &settings).unwrap();
    model.images(&scene.medium.extinction).unwrap()
}

/// The molecular atmosphere scatters between and in the cells, whichever voxels are active. The
/// Monte Carlo solver gives 0.004492; rays without the molecular atmosphere between their first and
/// last cell would give 0.00401.
#[test]
fn air_scatters_all_along_a_ray() {
    let grid = Grid::new(DVec3::new(0.0, 0.0, 0.5), DVec3::new(0.5, 0.5, 0.25), [4, 4, 4]).unwrap();
    let view =
        |zenith| View::orthographic(towards(zenith, 0.5), grid.center(), 0.5, [4, 4]).unwrap();
    let views = [view(0.0), view(0.8)];
    let mut corner = Volume::constant(grid, 0.0);
    corner.values[[0, 0, 0]] = 1e-9;
    let clouds = [Volume::constant(grid, 0.0), corner, Volume::constant(grid, 1e-9)];
    for wavelength in [0.672, 0.446] {
        let air = Air::new(wavelength).unwrap();
        let images =
            clouds.each_ref().map(|cloud| solved(&bare(cloud, 0.85).with_air(air), &views));
        if wavelength == 0.672 {
            let nadir = f64::from(images[2].values[[0, 2, 2]]);
            assert!((nadir / 0.004492 - 1.0).abs() < 0.005, "{nadir}");
        }
        for (empty, (corner, all)) in
            images[0].values.iter().zip(images[1].values.iter().zip(&images[2].values))
        {
            for found in [corner, all] {
                assert!((found / empty - 1.0).abs() < 3e-3, "{wavelength}: {found} {empty}");
            }
        }
    }
}

/// The light of a single voxel is the same in pixels of a sixteenth, one and four times its width,
/// and equals that of the Monte Carlo solver.
#[test]
fn pixels_of_any_size_see_the_same_voxel() {
    let grid = Grid::new(DVec3::new(0.0, 0.0, 1.0), DVec3::splat(0.05), [5, 5, 5]).unwrap();
    let mut extinction = Volume::constant(grid, 0.0);
    extinction.values[[2, 2, 2]] = 50.0;
    let scene = bare(&extinction, 0.85);
    let view = |size: f64, count: usize| {
        let target = grid.center() + DVec3::new(0.011, -0.007, 0.0);
        View::orthographic(towards(0.5, 2.0), target, size, [count; 2]).unwrap()
    };
    let light = |size: f64, count: usize| -> f64 {
        let images = solved(&scene, &[view(size, count)]);
        size * size * images.values.iter().map(|value| f64::from(*value)).sum::<f64>()
    };
    let paths = MonteCarloSettings { samples_per_pixel: 200_000, ..Default::default() };
    let one = view(0.05, 8);
    let truth = render(&scene, &[one], &Solver::MonteCarlo(paths), &()).unwrap();
    let expected =
        0.05 * 0.05 * truth.images.values.iter().map(|value| f64::from(*value)).sum::<f64>();
    for (size, count) in [(0.05 / 16.0, 128), (0.05, 8), (0.2, 2)] {
        let found = light(size, count);
        assert!((found / expected - 1.0).abs() < 0.015, "{size}: {found} {expected}");
    }
}

/// Between the points at which the optical depth towards the Sun is known it may vary from 0 to 10;
/// beyond them it must not fall below zero, which would amplify the sunlight.
#[test]
fn sunlight_is_never_more_than_the_suns() {
    let depths = [0.0, 10.0, 0.0, 10.0, 0.0, 10.0, 0.0, 10.0];
    for number in 0..=20 {
        let x = f64::from(number) / 20.0;
        assert!(beam::sun_depth(&depths, DVec3::new(x, 0.1, 0.9)) >= 0.0);
    }
}

/// The cloud signal of a small cloud of droplets in a molecular atmosphere above the ocean surface
/// at the default settings: its radiance minus that of the clear scene, in a nadir view, an oblique
/// view, and a view of the glory.
#[test]
fn the_light_of_a_small_cloud_is_that_of_photon_paths() {
    let grid =
        Grid::new(DVec3::new(0.0, 0.0, 0.6), DVec3::new(0.05, 0.05, 0.04), [5, 6, 6]).unwrap();
    let ragged = Array3::from_shape_fn(grid.shape, |(k, j, i)| {
        let at = (grid.voxel_center([k, j, i]) - grid.center()) / grid.extent();
        let hole = (5 * k + 3 * j + 7 * i) % 4 == 0;
        if at.length() < 0.48 && !hole {
            20.0 + 10.0 * ((3 * k + j + 2 * i) % 5) as f32
        } else {
            0.0
        }
    });
    let extinction = Volume::new(grid, ragged).unwrap();
    let table = DropletTable::mie(&DropletSettings::water(0.672), &[10.0]).unwrap();
    let phase = table.nodes()[0].phase_function.clone();
    let sun = Sun::default();
    let scene = |extinction: &Volume| {
        let medium = Medium::new(extinction.clone(), 1.0, phase.clone()).unwrap();
        let scene = Scene::new(medium, sun, Surface::OCEAN).unwrap();
        scene.with_air(Air::new(0.672).unwrap())
    };
    let views = [DVec3::Z, towards(0.9, 3.0), sun.towards()]
        .map(|towards| View::orthographic(towards, grid.center(), 0.05, [8, 8]).unwrap());
    let images = solved(&scene(&extinction), &views);
    let clear = solved(&scene(&Volume::constant(grid, 0.0)), &views);
    let settings = MonteCarloSettings { samples_per_pixel: 12_000, ..Default::default() };
    let truth = render(&scene(&extinction), &views, &Solver::MonteCarlo(settings), &()).unwrap();
    let error = truth.standard_error.as_ref().unwrap();
    for view in 0..views.len() {
        let sum = |stack: &ViewStack| -> f64 {
            stack.image(view).iter().map(|value| f64::from(*value)).sum()
        };
        let variance: f64 = error.image(view).iter().map(|e| f64::from(e * e)).sum();
        let signal = sum(&truth.images) - sum(&clear);
        let (found, noise) = (sum(&images) - sum(&clear), variance.sqrt());
        assert!(
            (found - signal).abs() < 0.015 * signal + 3.0 * noise && noise < 0.01 * signal,
            "view {view}: {found} {signal} +- {noise}"
        );
    }
}

/// The cloud signal by view of a cloud in absorbed light, whose droplets grow from its base to its top.
#[test]
fn the_light_that_droplets_absorb_is_that_of_photon_paths() {
    let grid =
        Grid::new(DVec3::new(0.0, 0.0, 0.6), DVec3::new(0.05, 0.05, 0.04), [6, 8, 8]).unwrap();
    let inside = |k: usize, j: usize, i: usize| {
        let at = (grid.voxel_center([k, j, i]) - grid.center()) / grid.extent();
        at.length() < 0.48
    };
    let extinction = Array3::from_shape_fn(grid.shape, |(k, j, i)| {
        if inside(k, j, i) { 30.0 + 10.0 * ((3 * k + j + 2 * i) % 5) as f32 } else { 0.0 }
    });
    let extinction = Volume::new(grid, extinction).unwrap();
    let radii = Array3::from_shape_fn(grid.shape, |(k, ..)| 6.0 + 2.0 * k as f32);
    let sun = Sun::default();
    let views = [DVec3::Z, towards(0.9, 3.0), towards(0.7, 0.5)]
        .map(|towards| View::orthographic(towards, grid.center(), 0.05, [10, 10]).unwrap());
    for wavelength in [1.6, 2.13] {
        let settings = DropletSettings::water(wavelength);
        let table = Arc::new(DropletTable::mie(&settings, &[6.0, 9.0, 12.0, 16.0]).unwrap());
        let medium = Medium::of_droplets(extinction.clone(), radii.clone(), table).unwrap();
        let scene = Scene::new(medium, sun, Surface::BLACK).unwrap();
        let images = solved(&scene, &views);
        let settings = MonteCarloSettings { samples_per_pixel: 8000, ..Default::default() };
        let truth = render(&scene, &views, &Solver::MonteCarlo(settings), &()).unwrap();
        let error = truth.standard_error.as_ref().unwrap();
        for view in 0..views.len() {
            let sum = |stack: &ViewStack| -> f64 {
                stack.image(view).iter().map(|value| f64::from(*value)).sum()
            };
            let variance: f64 = error.image(view).iter().map(|e| f64::from(e * e)).sum();
            let (found, expected, noise) = (sum(&images), sum(&truth.images), variance.sqrt());
            assert!(
                (found - expected).abs() < 0.01 * expected + 2.0 * noise
                    && noise < 0.005 * expected,
                "{wavelength}, view {view}: {found} {expected} +- {noise}"
            );
        }
    }
}

/// A progress callback receives shares from small values to 1, and may stop the computation.
#[test]
fn a_rendering_is_watched_and_stopped() {
    struct Waiting {
        stop: bool,
        shares: std::sync::Mutex<Vec<f64>>,
    }
    impl crate::transport::Watch for Waiting {
        fn reached(&self, progress: &crate::transport::Progress) {
            self.shares.lock().unwrap().push(progress.share);
        }

        fn interrupted(&self) -> bool {
            self.stop && self.shares.lock().unwrap().len() > 2
        }
    }
    let grid = Grid::new(DVec3::new(0.0, 0.0, 0.5), DVec3::splat(0.1), [4, 4, 4]).unwrap();
    let medium = Medium::new(
        Volume::constant(grid, 20.0),
        1.0,
        PhaseFunction::henyey_greenstein(0.85).unwrap(),
    );
    let scene = Scene::new(medium.unwrap(), Sun::default(), Surface::BLACK).unwrap();
    let views = [View::orthographic(DVec3::Z, grid.center(), 0.1, [6, 6]).unwrap()];
    let solver = Solver::Ordinates(OrdinatesSettings::default());
    let rendered = |stop| {
        let waiting = Waiting { stop, shares: Default::default() };
        let rendering = render(&scene, &views, &solver, &waiting);
        (rendering, waiting.shares.into_inner().unwrap())
    };
    let (whole, shares) = rendered(false);
    assert!(whole.unwrap().converged);
    assert!(shares.len() > 4 && shares[0] < 0.5 && shares.last() == Some(&1.0), "{shares:?}");
    let (part, shares) = rendered(true);
    assert!(matches!(part, Err(Error::Interrupted)) && shares.len() < 6, "{shares:?}");
}
