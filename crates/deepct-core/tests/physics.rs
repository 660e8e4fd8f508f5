//! Radiative transfer against published and independent numbers, a few seconds each.

use deepct_core::cloud::Cloud;
use deepct_core::grid::{Grid, Volume};
use deepct_core::math::{DVec3, Ray, towards};
use deepct_core::optics::{Medium, PhaseFunction};
use deepct_core::scene::{Boundary, Formation, Scene, Sun, Surface};
use deepct_core::transport::{
    FluxSettings, MonteCarloSettings, Share, Solver, fluxes, radiances, render,
};
use ndarray::Array3;
use std::f64::consts::PI;

fn slab(optical_depth: f64, albedo: f64, asymmetry: f64, sun_zenith_deg: f64) -> Scene {
    let grid = Grid::new(DVec3::ZERO, DVec3::ONE, [1, 1, 1]).unwrap();
    let phase = PhaseFunction::henyey_greenstein(asymmetry).unwrap();
    let medium = Medium::new(Volume::constant(grid, optical_depth as f32), albedo, phase).unwrap();
    let sun = Sun::from_degrees(sun_zenith_deg, 45.0).unwrap();
    Scene::new(medium, sun, Surface::BLACK).unwrap().with_boundary(Boundary::Periodic)
}

fn agree(name: &str, share: Share, reference: f64, reference_error: f64) {
    let tolerance = 3.0 * share.standard_error.hypot(reference_error);
    println!("{name}: {} +- {} against {reference}", share.mean, share.standard_error);
    assert!((share.mean - reference).abs() < tolerance, "{name}");
}

#[test]
fn slabs_reflect_as_in_the_tables() {
    for (tau, w, g, zenith, reference) in [
        (1.0, 1.0, 0.75, 0.0, 0.078742),
        (8.0, 1.0, 0.75, 0.0, 0.506418),
        (8.0, 1.0, 0.0, 30.0, 0.83636),
        (16.0, 1.0, 0.85, 60.0, 0.69740),
        (16.0, 0.99, 0.85, 0.0, 0.41772),
    ] {
        let settings = FluxSettings { photons: 200_000, seed: 3 };
        let fluxes = fluxes(&slab(tau, w, g, zenith), settings).unwrap();
        agree("reflected", fluxes.reflected, reference, 0.5e-5);
    }
}

#[test]
fn a_cube_loses_light_through_its_sides() {
    let phase = PhaseFunction::henyey_greenstein(0.85).unwrap();
    let grid = Grid::new(DVec3::ZERO, DVec3::splat(1.0 / 7.0), [7, 7, 7]).unwrap();
    let medium = Medium::new(Volume::constant(grid, 10.0), 1.0, phase).unwrap();
    let scene = Scene::new(medium, Sun::from_degrees(60.0, 0.0).unwrap(), Surface::BLACK).unwrap();
    let fluxes = fluxes(&scene, FluxSettings { photons: 400_000, seed: 3 }).unwrap();
    agree("reflected", fluxes.reflected, 0.18521, 9e-5);
    agree("transmitted", fluxes.transmitted, 0.04221, 5e-5);
    agree("sides", fluxes.sides, 0.77258, 10e-5);
}

/// Radiances of DISORT's test problem for Henyey-Greenstein 0.75, optical depth 8, at
/// the top upwards and at the bottom downwards; the beam's flux is pi.
#[test]
fn slab_radiances_are_those_of_the_table() {
    let scene = slab(8.0, 1.0, 0.75, 0.0);
    let settings = MonteCarloSettings { samples_per_pixel: 100_000, ..Default::default() };
    for (cosine, up, down) in
        [(1.0, 0.493302, 0.669581), (0.5, 0.519598, 0.422350), (0.1, 0.379740, 0.236362)]
    {
        let away = towards(f64::acos(cosine), 0.4);
        let rays = [
            Ray { origin: DVec3::new(0.3, 0.3, 1.0), direction: -away },
            Ray { origin: DVec3::new(0.3, 0.3, 0.0), direction: away },
        ];
        let found = radiances(&scene, &rays, &settings).unwrap();
        for (found, expected) in found.iter().zip([up, down]) {
            println!("{cosine}: {:?} {}", PI * found.mean, PI * found.standard_error);
            let tolerance = 3.0 * PI * found.standard_error;
            assert!((PI * found.mean - expected).abs() < tolerance, "{found:?} {expected}");
        }
    }
}

#[test]
fn the_image_is_the_same_for_any_number_of_threads() {
    let grid = Grid::new(DVec3::ZERO, DVec3::splat(0.05), [8, 8, 8]).unwrap();
    let extinction =
        Array3::from_shape_fn(grid.shape, |(k, j, i)| ((k + 2 * j + 3 * i) % 7) as f32);
    let medium = Medium::from_cloud(
        &Cloud::from_extinction(Volume::new(grid, 8.0 * extinction).unwrap()).unwrap(),
    )
    .unwrap();
    let scene = Scene::new(medium, Sun::default(), Surface::OCEAN).unwrap();
    let views = Formation::cloudct_10().views(grid.center(), [8, 8]).unwrap();
    let settings = MonteCarloSettings { samples_per_pixel: 16, ..Default::default() };
    let solver = Solver::MonteCarlo(settings);
    let image = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| render(&scene, &views, &solver, &|_| ())).unwrap()
    };
    let alone = image(1);
    assert!(alone.images.brightest() > 0.01);
    assert_eq!(alone, image(5));
}
