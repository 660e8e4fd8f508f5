//! The solver against finite differences of itself.

use super::*;
use crate::grid::Grid;
use crate::math::{DVec3, towards};
use crate::optics::air::Air;
use crate::optics::{Interpolation, Medium, PhaseFunction};
use crate::scene::{Boundary, Sun, Surface, View};
use crate::transport::{MonteCarloSettings, Solver, render};

/// The solver's tolerance in these tests.
const TOLERANCE: f64 = 1e-6;

fn grid() -> Grid {
    Grid::new(DVec3::new(0.0, 0.0, 0.6), DVec3::new(0.05, 0.05, 0.04), [4, 5, 6]).unwrap()
}

/// A lump of cloud, thickest in its middle, uneven.
fn cloud(peak: f32) -> Volume {
    let grid = grid();
    let values = Array3::from_shape_fn(grid.shape, |(k, j, i)| {
        let at = grid.voxel_center([k, j, i]) - grid.center();
        let inside = (1.0 - 2.5 * (at / grid.extent()).length()).max(0.0) as f32;
        let uneven = 1.0 + 0.3 * ((7 * k + 3 * j + 5 * i) % 5) as f32;
        peak * inside * uneven
    });
    Volume::new(grid, values).unwrap()
}

fn model(extinction: &Volume, interpolation: Interpolation, boundary: Boundary) -> OrdinatesModel {
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

/// Weights as a misfit has them: of both signs.
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

/// The derivative in a direction, the central difference, and how well this is known from
/// images of the solver's tolerance.
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

/// The view means against those of random paths, of the cloud alone, above a bright surface,
/// and in air: so small and uneven a cloud asks for fine angles, cells and rays.
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
        let settings = MonteCarloSettings { samples_per_pixel: 8000, ..Default::default() };
        let truth = render(&scene, &views, &Solver::MonteCarlo(settings), &()).unwrap();
        for view in 0..views.len() {
            let mean = |stack: &ViewStack| f64::from(stack.image(view).mean().unwrap());
            let error = truth.standard_error.as_ref().unwrap().image(view);
            let squares: f64 = error.iter().map(|e| f64::from(e * e)).sum();
            let noise = squares.sqrt() / error.len() as f64;
            let (found, expected) = (mean(&images), mean(&truth.images));
            assert!(
                (found - expected).abs() < 0.01 * expected + 3.0 * noise,
                "{boundary:?} {surface:?} {air:?}, view {view}: {found} {expected} +- {noise}"
            );
        }
    }
}
