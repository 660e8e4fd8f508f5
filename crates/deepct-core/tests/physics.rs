//! Validation of the radiative transfer against published and independent results; each test takes
//! a few seconds. `deepct validate --long` runs the same suites with less noise.

use deepct_core::grid::{Grid, Volume};
use deepct_core::math::{DVec3, Ray, deflect, towards};
use deepct_core::optics::air::Air;
use deepct_core::optics::{
    DropletOptics, DropletTable, Interpolation, Medium, PhaseFunction, Scattering,
};
use deepct_core::rng::{Purpose, RngExt, stream};
use deepct_core::scene::{Boundary, Formation, Scene, Sun, Surface, View, Waves};
use deepct_core::transport::{
    FluxSettings, MonteCarloSettings, Progress, Radiance, Rendering, Share, Solver, Watch, fluxes,
    radiances, render,
};
use deepct_core::validation::{Effort, Suite, validate};
use ndarray::Array3;
use std::f64::consts::PI;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

fn suite_holds(suite: Suite, samples: u32) {
    let mut rows = Vec::new();
    let effort = Effort { samples, ..Effort::QUICK };
    validate(suite, effort, None, None, &mut |row| rows.push(row)).unwrap();
    assert!(rows.len() >= 10);
    for row in rows {
        assert!(row.passed, "{row:?}");
        assert!(row.standard_error > 0.0, "{row:?}");
    }
}

#[test]
fn slabs_are_those_of_discrete_ordinates() {
    suite_holds(Suite::Slabs, 40_000);
}

#[test]
fn cubes_are_those_of_another_code() {
    suite_holds(Suite::Cubes, 100_000);
}

#[test]
fn the_step_cloud_is_that_of_another_code() {
    suite_holds(Suite::Step, 100_000);
}

/// An inhomogeneous cloud of 8 x 8 x 8 voxels with an optical depth of about 8.
fn lumps(albedo: f64) -> Medium {
    let grid = Grid::new(DVec3::new(0.0, 0.0, 0.5), DVec3::splat(0.05), [8, 8, 8]).unwrap();
    let values = Array3::from_shape_fn(grid.shape, |(k, j, i)| {
        let value = (k * k + 2 * j + 3 * i * j) % 7;
        if value > 2 { 10.0 * value as f32 } else { 0.0 }
    });
    let phase = PhaseFunction::henyey_greenstein(0.8).unwrap();
    Medium::new(Volume::new(grid, values).unwrap(), albedo, phase).unwrap()
}

fn monte_carlo(samples_per_pixel: u32, similarity_after: Option<u32>) -> MonteCarloSettings {
    MonteCarloSettings { samples_per_pixel, similarity_after, ..Default::default() }
}

fn draw(scene: &Scene, views: &[View], settings: MonteCarloSettings) -> Rendering {
    render(scene, views, &Solver::MonteCarlo(settings), &()).unwrap()
}

/// The mean of an image and its standard error.
fn mean(rendering: &Rendering, view: usize) -> Radiance {
    let sum = |power, image: deepct_core::image::Image| -> f64 {
        image.iter().map(|value| f64::from(*value).powi(power)).sum()
    };
    let image = rendering.images.image(view);
    let count = image.len() as f64;
    Radiance {
        mean: sum(1, image) / count,
        standard_error: sum(2, rendering.standard_error.as_ref().unwrap().image(view)).sqrt()
            / count,
    }
}

fn agree(what: &str, found: Radiance, expected: Radiance, systematic: f64) {
    let noise = found.standard_error.hypot(expected.standard_error);
    let difference = found.mean - expected.mean;
    assert!(difference.abs() < 3.0 * noise + systematic, "{what}: {found:?} {expected:?}");
}

fn exactly(mean: f64) -> Radiance {
    Radiance { mean, standard_error: 0.0 }
}

#[test]
fn a_bare_surface_reflects_its_albedo() {
    let medium =
        Medium { extinction: Volume::constant(lumps(1.0).extinction.grid, 0.0), ..lumps(1.0) };
    let sun = Sun { irradiance: 1.7, ..Sun::from_degrees(40.0, 10.0).unwrap() };
    let scene =
        Scene::new(medium, sun, Surface { altitude: 0.1, ..Surface::lambertian(0.3) }).unwrap();
    let views = Formation::cloudct_10().views(DVec3::new(0.2, 0.2, 0.7), [3, 3]).unwrap();
    let expected = 1.7 * 0.3 * 40_f64.to_radians().cos() / PI;
    for value in draw(&scene, &views, monte_carlo(4, None)).images.values {
        assert!((f64::from(value) - expected).abs() < 1e-6, "{value} {expected}");
    }
}

/// Single scattering in a box with low single-scattering albedo. The radiance is the integral of
/// the source along the line of sight, which has a closed form if neither the line of sight nor the
/// solar beam crosses a side.
#[test]
fn a_thin_box_scatters_once() {
    let grid =
        Grid::new(DVec3::new(-5.0, -5.0, 0.0), DVec3::new(1.0, 1.0, 0.1), [10, 10, 10]).unwrap();
    let phase = PhaseFunction::henyey_greenstein(0.6).unwrap();
    // With this single-scattering albedo the contribution of twice-scattered light is negligible.
    let albedo = 1e-3;
    let sun = Sun::from_degrees(35.0, 70.0).unwrap();
    let (extinction, mu0) = (0.8, sun.zenith.cos());
    let medium =
        Medium::new(Volume::constant(grid, extinction as f32), albedo, phase.clone()).unwrap();
    let scene = Scene::new(medium, sun, Surface::BLACK).unwrap();
    for (zenith, azimuth) in [(0.0, 0.0), (0.6, 1.0), (0.9, 4.0)] {
        let away = towards(zenith, azimuth);
        let view = View::orthographic(away, DVec3::new(0.0, 0.0, 1.0), 0.02, [4, 4]).unwrap();
        let found = mean(&draw(&scene, &[view], monte_carlo(4000, None)), 0);
        let mu = away.z;
        let air_mass = 1.0 / mu + 1.0 / mu0;
        let expected = albedo * phase.density(-sun.towards().dot(away)) / (mu * air_mass)
            * (1.0 - (-extinction * air_mass).exp());
        agree("single scattering", found, exactly(expected), 1e-3 * expected);
    }
}

/// With a conservative medium, a molecular atmosphere and a white surface, the flux that leaves
/// through the top equals the incident flux, for any extinction field.
#[test]
fn a_white_world_reflects_all_light() {
    for (interpolation, air) in [
        (Interpolation::Constant, None),
        (Interpolation::Trilinear, None),
        (Interpolation::Constant, Some(Air::new(0.35).unwrap())),
    ] {
        let medium = lumps(1.0).with_interpolation(interpolation);
        let grid = medium.extinction.grid;
        let sun = Sun::from_degrees(50.0, 200.0).unwrap();
        let surface = Surface { altitude: 0.3, ..Surface::lambertian(1.0) };
        let scene = Scene::new(medium, sun, surface).unwrap().with_boundary(Boundary::Periodic);
        let scene = Scene { air, ..scene };
        // Rays through the top, with directions distributed in proportion to their contribution
        // to the flux.
        let mut rng = stream(5, Purpose::Transport, &[]);
        let rays: Vec<Ray> = (0..2000)
            .map(|_| {
                let place = DVec3::new(rng.random(), rng.random(), 1.0);
                let cosine = rng.random::<f64>().sqrt();
                let away = deflect(DVec3::Z, cosine, 2.0 * PI * rng.random::<f64>());
                let origin = grid.lower() + grid.extent() * place + 90.0 / away.z * away;
                Ray { origin, direction: -away }
            })
            .collect();
        let found = radiances(&scene, &rays, &monte_carlo(10, None)).unwrap();
        let count = found.len() as f64;
        let sum: f64 = found.iter().map(|radiance| radiance.mean).sum();
        let squares: f64 = found.iter().map(|radiance| radiance.mean.powi(2)).sum();
        let error = (squares / count - (sum / count).powi(2)).sqrt() / count.sqrt();
        let flux = Radiance { mean: PI * sum / count, standard_error: PI * error };
        assert!(flux.standard_error < 0.02);
        agree("reflected flux", flux, exactly(sun.zenith.cos()), 0.0);
    }
}

/// Reciprocity (von Helmholtz 1856): the total light that a finite cloud scatters from the Sun to
/// the camera is unchanged if Sun and camera are exchanged.
#[test]
fn sun_and_camera_may_change_places() {
    let directions = [(20.0, 80.0), (55.0, 310.0)];
    let total = |sun: (f64, f64), camera: (f64, f64)| {
        let medium = lumps(0.95);
        let target = medium.extinction.grid.center();
        let sun = Sun::from_degrees(sun.0, sun.1).unwrap();
        let scene = Scene::new(medium, sun, Surface::BLACK).unwrap();
        let away = towards(camera.0.to_radians(), camera.1.to_radians());
        let view = View::orthographic(away, target, 0.05, [40, 40]).unwrap();
        let found = mean(&draw(&scene, &[view], monte_carlo(400, None)), 0);
        // Pixels are defined in the horizontal plane; their area normal to the line of sight is
        // smaller by the cosine of the view zenith angle.
        Radiance { mean: found.mean * away.z, standard_error: found.standard_error * away.z }
    };
    let there = total(directions[0], directions[1]);
    assert!(there.standard_error < 0.02 * there.mean);
    agree("reciprocity", there, total(directions[1], directions[0]), 0.0);
}

/// An absorbing cloud with open or periodic sides, in a molecular atmosphere above a bright ocean
/// surface with waves.
fn world(boundary: Boundary) -> Scene {
    let surface = Surface {
        altitude: 0.3,
        waves: Some(Waves::new(7.0).unwrap()),
        ..Surface::lambertian(0.3)
    };
    let scene = Scene::new(lumps(0.9), Sun::from_degrees(30.0, 45.0).unwrap(), surface).unwrap();
    scene.with_boundary(boundary).with_air(Air::new(0.35).unwrap())
}

/// The upward flux from radiances above the atmosphere equals that of photons traced from the Sun.
#[test]
fn images_and_photons_agree() {
    let in_air = world(Boundary::Periodic);
    let bare = Scene { surface: Surface::BLACK, air: None, ..in_air.clone() };
    for scene in [bare, in_air] {
        let photons = fluxes(&scene, FluxSettings { photons: 400_000, seed: 2 }).unwrap();
        let grid = scene.medium.extinction.grid;
        let mut rng = stream(6, Purpose::Transport, &[]);
        let rays: Vec<Ray> = (0..20_000)
            .map(|_| {
                let place = DVec3::new(rng.random(), rng.random(), 1.0);
                let cosine = rng.random::<f64>().sqrt();
                let away = deflect(DVec3::Z, cosine, 2.0 * PI * rng.random::<f64>());
                let origin = grid.lower() + grid.extent() * place + 90.0 / away.z * away;
                Ray { origin, direction: -away }
            })
            .collect();
        let found = radiances(&scene, &rays, &monte_carlo(4, None)).unwrap();
        let count = found.len() as f64;
        let sum: f64 = found.iter().map(|radiance| radiance.mean).sum();
        let squares: f64 = found.iter().map(|radiance| radiance.mean.powi(2)).sum();
        let error = (squares / count - (sum / count).powi(2)).sqrt() / count.sqrt();
        let scale = PI / scene.sun.zenith.cos();
        let reflected = Radiance { mean: scale * sum / count, standard_error: scale * error };
        assert!(reflected.standard_error < 0.01 && photons.sides.mean == 0.0);
        agree("light to space", reflected, radiance_of(photons.upward), 0.0);
    }
}

fn radiance_of(share: Share) -> Radiance {
    Radiance { mean: share.mean, standard_error: share.standard_error }
}

/// Energy conservation: the net fluxes through the faces and the absorption by droplets sum to the
/// incident flux, as do the fluxes to space and into the surface and the absorption by droplets.
#[test]
fn light_is_neither_made_nor_lost() {
    for boundary in [Boundary::Open, Boundary::Periodic] {
        let in_air = world(boundary);
        let bare = Scene { surface: Surface::BLACK, air: None, ..in_air.clone() };
        let white = Surface { altitude: 0.3, ..Surface::lambertian(1.0) };
        let white = Scene { surface: white, medium: lumps(1.0), ..in_air.clone() };
        for scene in [&in_air, &bare, &white] {
            let found = fluxes(scene, FluxSettings { photons: 200_000, seed: 3 }).unwrap();
            for shares in [
                vec![found.reflected, found.transmitted, found.sides, found.absorbed],
                vec![found.upward, found.downward, found.absorbed],
            ] {
                let sum: f64 = shares.iter().map(|share| share.mean).sum();
                let noise: f64 = shares.iter().map(|share| share.standard_error.powi(2)).sum();
                assert!((sum - 1.0).abs() < 3.0 * noise.sqrt(), "{sum}: {found:?}");
            }
        }
        let sent_back = fluxes(&white, FluxSettings { photons: 20_000, seed: 3 }).unwrap().upward;
        assert!((sent_back.mean - 1.0).abs() < 1e-9, "{sent_back:?}");
    }
}

/// The similar medium is a close approximation of the exact one.
#[test]
fn the_similar_medium_is_nearly_the_same() {
    let scene = Scene::new(lumps(1.0), Sun::default(), Surface::OCEAN).unwrap();
    let target = scene.medium.extinction.grid.center();
    let views = Formation::cloudct_10().views(target, [8, 8]).unwrap();
    let exact = draw(&scene, &views, monte_carlo(400, None));
    let similar = draw(&scene, &views, monte_carlo(400, Some(4)));
    for view in 0..views.len() {
        let (exact, similar) = (mean(&exact, view), mean(&similar, view));
        agree("similar medium", similar, exact, 0.003 * exact.mean);
        assert!(similar.standard_error < exact.standard_error);
    }
}

/// Single scattering in a molecular atmosphere of very low optical depth, along the whole line of
/// sight, above a black surface.
#[test]
fn thin_air_scatters_once() {
    let medium =
        Medium { extinction: Volume::constant(lumps(1.0).extinction.grid, 0.0), ..lumps(1.0) };
    let air = Air::new(2.2).unwrap();
    let sun = Sun::from_degrees(40.0, 10.0).unwrap();
    let scene = Scene::new(medium, sun, Surface::BLACK).unwrap().with_air(air);
    let depth = air.optical_depth(0.0, 100.0);
    assert!(depth < 5e-4);
    for (zenith, azimuth) in [(0.0, 0.0), (0.9, 1.0), (1.1, 4.0)] {
        let away = towards(zenith, azimuth);
        let ray = Ray { origin: 300.0 * away, direction: -away };
        let found = radiances(&scene, &[ray], &monte_carlo(40_000, None)).unwrap()[0];
        let (mu, mu0) = (away.z, sun.zenith.cos());
        let air_mass = 1.0 / mu + 1.0 / mu0;
        let expected = air.phase_function().density(-sun.towards().dot(away)) / (mu * air_mass)
            * (1.0 - (-depth * air_mass).exp());
        // The relative contribution of twice-scattered light is of the order of the optical depth.
        agree("thin air", found, exactly(expected), 3.0 * depth * expected);
        assert!(found.standard_error < 0.02 * expected, "{found:?}");
    }
}

/// Sunglint of an ocean surface with waves, without cloud or molecular atmosphere.
#[test]
fn a_bare_sea_mirrors_the_sun() {
    let medium =
        Medium { extinction: Volume::constant(lumps(1.0).extinction.grid, 0.0), ..lumps(1.0) };
    let sun = Sun::from_degrees(30.0, 180.0).unwrap();
    let waves = Waves::new(5.0).unwrap();
    let surface = Surface { waves: Some(waves), ..Surface::lambertian(0.01) };
    let scene = Scene::new(medium, sun, surface).unwrap();
    let radiance = |zenith: f64, azimuth: f64| {
        let away = towards(zenith.to_radians(), azimuth.to_radians());
        let ray = Ray { origin: 9.0 * away, direction: -away };
        let found = radiances(&scene, &[ray], &monte_carlo(4, None)).unwrap()[0].mean;
        let expected = sun.zenith.cos() * (0.01 / PI + waves.reflectance(away, sun.towards()));
        assert!((found - expected).abs() < 1e-9, "{found} {expected}");
        found
    };
    // The sunglint in the specular direction is far brighter than at an azimuth 90 degrees away.
    assert!(radiance(30.0, 0.0) > 20.0 * radiance(30.0, 90.0));
}

#[test]
fn a_wanted_noise_is_reached_and_a_stop_is_heard() {
    /// Stops as soon as there are images.
    #[derive(Default)]
    struct Impatient(AtomicBool);
    impl Watch for Impatient {
        fn reached(&self, _: &Progress) {
            self.0.store(true, Ordering::Relaxed);
        }

        fn interrupted(&self) -> bool {
            self.0.load(Ordering::Relaxed)
        }
    }
    /// Stops before that.
    struct Stopped;
    impl Watch for Stopped {
        fn interrupted(&self) -> bool {
            true
        }
    }
    let scene = Scene::new(lumps(1.0), Sun::default(), Surface::OCEAN).unwrap();
    let target = scene.medium.extinction.grid.center();
    let views = Formation::cloudct_10().views(target, [8, 8]).unwrap();
    let settings = MonteCarloSettings {
        samples_per_pixel: 100_000,
        noise: Some(0.05),
        ..MonteCarloSettings::default()
    };
    let found = draw(&scene, &views, settings.clone());
    assert!(found.samples_per_pixel < 10_000 && !found.interrupted);
    for view in 0..views.len() {
        let image = found.images.image(view);
        let brightest = image.iter().copied().fold(0.0, f32::max);
        let noise = image.iter().zip(found.standard_error.as_ref().unwrap().image(view));
        let bright = noise.filter(|(value, _)| **value > 0.5 * brightest);
        let ratios: Vec<f32> = bright.map(|(value, error)| error / value).collect();
        let square = ratios.iter().map(|ratio| ratio * ratio).sum::<f32>() / ratios.len() as f32;
        assert!(square.sqrt() < 0.08, "view {view}: {ratios:?}");
    }
    let solver = Solver::MonteCarlo(settings);
    let stopped = render(&scene, &views, &solver, &Impatient::default()).unwrap();
    assert!(stopped.interrupted && stopped.samples_per_pixel < found.samples_per_pixel);
    assert!(stopped.images.brightest() > 0.01);
    let nothing = render(&scene, &views, &solver, &Stopped);
    assert!(matches!(nothing, Err(deepct_core::Error::Interrupted)));
}

#[test]
fn the_image_is_the_same_for_any_number_of_threads() {
    let scene = Scene::new(lumps(1.0), Sun::default(), Surface::OCEAN).unwrap();
    let target = scene.medium.extinction.grid.center();
    let views = Formation::cloudct_10().views(target, [8, 8]).unwrap();
    let image = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| draw(&scene, &views, monte_carlo(16, None)))
    };
    let alone = image(1);
    assert!(alone.images.brightest() > 0.01);
    assert_eq!(alone, image(5));
}

/// The cloud of [`lumps`] with droplets of 8 um in its lower half and 12 um in its upper half.
/// `optics` is the single-scattering albedo and asymmetry parameter for these two radii.
fn droplets(optics: [(f64, f64); 2]) -> Medium {
    let nodes =
        [8.0, 12.0].into_iter().zip(optics).map(|(effective_radius, (albedo, g))| DropletOptics {
            effective_radius,
            extinction_per_water: 1500.0 / effective_radius,
            single_scattering_albedo: albedo,
            phase_function: PhaseFunction::henyey_greenstein(g).unwrap(),
        });
    let table = Arc::new(DropletTable::new(nodes.collect()).unwrap());
    let medium = lumps(1.0);
    let effective_radius =
        Array3::from_shape_fn(
            medium.extinction.grid.shape,
            |(k, _, _)| {
                if k < 4 { 8.0 } else { 12.0 }
            },
        );
    Medium { scattering: Scattering::Droplets { effective_radius, table }, ..medium }
}

/// Droplets of different radii but with the same optical properties give the same images as a
/// uniform medium. Absorbing droplets in the upper half absorb more light than those in the lower
/// half.
#[test]
fn each_voxel_scatters_as_its_own_droplets_do() {
    let black = |medium| Scene::new(medium, Sun::default(), Surface::BLACK).unwrap();
    let views = Formation::cloudct_10().views(lumps(1.0).extinction.grid.center(), [8, 8]).unwrap();
    for similarity_after in [None, Some(1)] {
        let image = |medium| draw(&black(medium), &views, monte_carlo(8, similarity_after)).images;
        let (uniform, alike) = (image(lumps(0.95)), image(droplets([(0.95, 0.8); 2])));
        for (a, b) in uniform.values.iter().zip(&alike.values) {
            assert!((a - b).abs() <= 1e-5 * a.abs(), "{a} and {b}");
        }
    }
    let fluxes = |medium| {
        fluxes(&black(medium), FluxSettings { photons: 50_000, ..Default::default() }).unwrap()
    };
    let absorbing_above = fluxes(droplets([(1.0, 0.8), (0.0, 0.8)]));
    let absorbing_below = fluxes(droplets([(0.0, 0.8), (1.0, 0.8)]));
    let absorbing = fluxes(lumps(0.0));
    assert!(absorbing.absorbed.mean > absorbing_above.absorbed.mean);
    assert!(absorbing_above.absorbed.mean > absorbing_below.absorbed.mean + 0.1);
    let noise = 3.0 * absorbing.unscattered.standard_error * 2_f64.sqrt();
    let unscattered = [absorbing_above, absorbing_below].map(|found| found.unscattered.mean);
    assert!(unscattered.iter().all(|mean| (mean - absorbing.unscattered.mean).abs() < noise));
}

#[test]
fn impossible_tasks_are_refused() {
    let scene = Scene::new(lumps(1.0), Sun::default(), Surface::OCEAN).unwrap();
    let view = |size| View::orthographic(DVec3::Z, DVec3::ZERO, 0.05, size).unwrap();
    let refused = |scene: &Scene, views: &[View], samples| {
        let solver = Solver::MonteCarlo(monte_carlo(samples, None));
        render(scene, views, &solver, &()).unwrap_err().to_string()
    };
    assert!(refused(&scene, &[], 4).contains("number of views"));
    assert!(refused(&scene, &[view([4, 4]), view([4, 5])], 4).contains("view 1"));
    assert!(refused(&scene, &[view([4, 4])], 1).contains("samples per pixel"));
    let grid = Grid::new(DVec3::ZERO, DVec3::ONE, [1, 4, 4]).unwrap();
    let thin = Medium { extinction: Volume::constant(grid, 1.0), ..lumps(1.0) };
    let thin = thin.with_interpolation(Interpolation::Trilinear);
    let thin = Scene::new(thin, Sun::default(), Surface::BLACK).unwrap();
    assert!(refused(&thin, &[view([4, 4])], 4).contains("trilinear"));
}
