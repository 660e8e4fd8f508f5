//! The built-in general network: what its estimate must not depend on, and what it refuses.

use deepct_core::cloud::{Cloud, CumulusSettings, cumulus};
use deepct_core::grid::{Grid, Volume};
use deepct_core::image::{ImagingGeometry, ViewGeometry, ViewStack};
use deepct_core::io::{GENERAL_WEIGHTS, load_trained_weights};
use deepct_core::math::{DVec3, towards};
use deepct_core::network::{Estimator, TrainedWeights, Unusual};
use deepct_core::scene::{Formation, Light, Observation, Sun, View};
use deepct_core::transport::{OrdinatesSettings, Solver, render};
use ndarray::{Array3, Axis};
use std::f64::consts::PI;

const SIZE: [usize; 2] = [20, 24];

fn general() -> Estimator {
    Estimator::new(load_trained_weights(GENERAL_WEIGHTS).unwrap())
}

/// Six views around the target, 50 m pixels at a distance of 600 km.
fn geometry() -> ImagingGeometry {
    let views = ViewGeometry {
        sun_zenith_deg: 40.0,
        sun_azimuth_deg: 130.0,
        view_zenith_deg: vec![0.0, 20.0, 35.0, 41.0, 53.0, 60.0],
        view_azimuth_deg: vec![0.0, 10.0, 140.0, 260.0, 75.0, 320.0],
        pixel_km: vec![0.05, 0.052, 0.057, 0.06, 0.066, 0.07],
        camera_distance_km: vec![Some(600.0); 6],
    };
    let target_km = [3.0, -2.0, 1.12];
    let (wavelength_um, solar_irradiance) = (0.672, 1.0);
    ImagingGeometry { views, target_km, shifts: Vec::new(), wavelength_um, solar_irradiance }
}

/// Images of a bright spot on a dark surface, which is not quite in the middle.
fn images(views: usize) -> ViewStack {
    let [rows, cols] = SIZE;
    let values = Array3::from_shape_fn((views, rows, cols), |(view, row, col)| {
        let (y, x) = (row as f32 - 10.5, col as f32 - 12.0 - 0.3 * view as f32);
        0.02 + 0.2 * (-(x * x + y * y) / 12.0).exp()
    });
    ViewStack::new(values).unwrap()
}

fn small_cloud() -> Cloud {
    let settings = CumulusSettings { width_km: Some(0.6), ..Default::default() };
    cumulus(&settings, 3).unwrap()
}

fn light() -> Light {
    let mut light = Light::realistic();
    light.sun = Sun::from_degrees(40.0, 130.0).unwrap();
    light
}

/// Six views of a target; `sign` is -1 for azimuths counted in the other direction.
fn views(target: DVec3, sign: f64) -> Vec<View> {
    let angles =
        [(5.0, 0.0), (30.0, 20.0), (40.0, 95.0), (50.0, 150.0), (45.0, 250.0), (55.0, 310.0)];
    let view = |(zenith, azimuth)| {
        let to = towards(f64::to_radians(zenith), sign * f64::to_radians(azimuth));
        View::perspective(target + 600.0 * to, target, 0.05 / 600.0, [32, 32]).unwrap()
    };
    angles.map(view).to_vec()
}

fn observed(cloud: &Cloud, light: &Light, views: &[View]) -> Observation {
    let solver = Solver::Ordinates(OrdinatesSettings::with_accuracy(0.05).unwrap());
    let scene = light.scene(cloud).unwrap();
    let images = render(&scene, views, &solver, &()).unwrap().images;
    Observation::new(light.recorded(cloud), views.to_vec(), images).unwrap()
}

fn estimate(geometry: &ImagingGeometry, images: &ViewStack, grid: Option<&Grid>) -> Volume {
    general().estimate(images, geometry, grid).unwrap().extinction
}

/// The largest difference divided by the largest value.
fn difference(one: &Array3<f32>, other: &Array3<f32>) -> f32 {
    assert_eq!(one.shape(), other.shape());
    let largest = one.iter().fold(0.0_f32, |most, value| most.max(*value));
    assert!(largest > 1.0, "the estimate is empty: {largest}");
    one.iter().zip(other).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max) / largest
}

#[test]
fn the_order_of_the_views_does_not_matter() {
    let (straight, images) = (geometry(), images(6));
    let order = [3, 0, 5, 1, 4, 2];
    let mut turned = straight.clone();
    let pick = |values: &[f64]| order.iter().map(|&view| values[view]).collect::<Vec<_>>();
    turned.views.view_zenith_deg = pick(&straight.views.view_zenith_deg);
    turned.views.view_azimuth_deg = pick(&straight.views.view_azimuth_deg);
    turned.views.pixel_km = pick(&straight.views.pixel_km);
    let moved = ViewStack::new(images.values.select(Axis(0), &order)).unwrap();
    let (one, other) = (estimate(&straight, &images, None), estimate(&turned, &moved, None));
    assert_eq!(one.grid, other.grid);
    let error = difference(&one.values, &other.values);
    assert!(error < 1e-5, "{error:e}");
}

/// If all lengths are doubled, the same images belong to half the extinction.
#[test]
fn lengths_and_extinctions_scale_inversely() {
    let (small, images) = (geometry(), images(6));
    let mut large = small.clone();
    large.target_km = small.target_km.map(|length| 2.0 * length);
    large.views.pixel_km.iter_mut().for_each(|pixel| *pixel *= 2.0);
    large.views.camera_distance_km = vec![Some(1200.0); 6];
    let (one, other) = (estimate(&small, &images, None), estimate(&large, &images, None));
    assert!((other.grid.spacing - 2.0 * one.grid.spacing).length() < 1e-9);
    assert!((other.grid.origin - 2.0 * one.grid.origin).length() < 1e-9);
    let error = difference(&one.values, &(2.0 * &other.values));
    assert!(error < 1e-5, "{error:e}");
}

#[test]
fn a_solar_irradiance_in_other_units_changes_nothing() {
    let (unit, bright) = (geometry(), ImagingGeometry { solar_irradiance: 4.0, ..geometry() });
    let images = images(6);
    let scaled = ViewStack::new(4.0 * &images.values).unwrap();
    let (one, other) = (estimate(&unit, &images, None), estimate(&bright, &scaled, None));
    assert_eq!(one, other);
}

/// The default grid has one column for each pixel and is centred on the target; a part of it at
/// another place holds the same values.
#[test]
fn a_grid_elsewhere_holds_the_same_field() {
    let (geometry, images) = (geometry(), images(6));
    let whole = estimate(&geometry, &images, None);
    assert_eq!(whole.grid.shape, [32, SIZE[0], SIZE[1]]);
    let [x, y, z] = geometry.target_km;
    assert!((whole.grid.center() - DVec3::new(x, y, z)).length() < 1e-9);
    assert!((whole.grid.spacing - DVec3::new(0.05, 0.05, 0.04)).length() < 1e-9);
    // Two columns more to the west and one row less to the south.
    let shifted = Grid {
        origin: whole.grid.origin + DVec3::new(-0.1, 0.05, 0.0),
        shape: [32, SIZE[0] - 1, SIZE[1] + 2],
        ..whole.grid
    };
    let moved = estimate(&geometry, &images, Some(&shifted));
    let largest = whole.values.iter().copied().fold(1.0, f32::max);
    // Away from the edges, where the convolutions are padded with zeros.
    for ((k, j, i), value) in whole.values.indexed_iter() {
        if (8..SIZE[0] - 8).contains(&j) && (8..SIZE[1] - 8).contains(&i) {
            let other = moved.values[[k, j - 1, i + 2]];
            assert!((value - other).abs() < 1e-5 * largest, "{value} {other} at {k} {j} {i}");
        }
    }
}

/// On other voxels and levels, columns keep their optical depth.
#[test]
fn other_levels_keep_the_optical_depth() {
    let (geometry, images) = (geometry(), images(6));
    let whole = estimate(&geometry, &images, None);
    let depth = |volume: &Volume| {
        let sum: f64 = volume.values.iter().map(|value| f64::from(*value)).sum();
        let Grid { spacing, .. } = volume.grid;
        sum * spacing.x * spacing.y * spacing.z
    };
    let coarse =
        Grid { spacing: DVec3::new(0.05, 0.05, 0.16), shape: [8, SIZE[0], SIZE[1]], ..whole.grid };
    let volume = estimate(&geometry, &images, Some(&coarse));
    assert!((depth(&volume) / depth(&whole) - 1.0).abs() < 1e-4);
}

/// In a grid with many clear levels, the 32 levels of the network are placed where the cloud is.
#[test]
fn clear_levels_above_a_cloud_change_little() {
    let (cloud, light) = (small_cloud(), light());
    let target = cloud.grid.center();
    let observation = observed(&cloud, &light, &views(target, 1.0));
    let geometry = observation.imaging_geometry().unwrap();
    let images = &observation.images;
    let whole = estimate(&geometry, images, None);
    let mass = |volume: &Volume| volume.values.iter().map(|&x| f64::from(x)).sum::<f64>();
    for levels in [40, 64, 96] {
        let high = Grid { shape: [levels, 32, 32], ..whole.grid };
        let volume = estimate(&geometry, images, Some(&high));
        assert_eq!(volume.grid, high);
        let ratio = mass(&volume) / mass(&whole);
        assert!((0.85..1.15).contains(&ratio), "{levels} levels: {ratio}");
    }
}

#[test]
fn a_grid_that_no_image_shows_is_refused() {
    let (geometry, images) = (geometry(), images(6));
    let grid = general().grid(&geometry, SIZE).unwrap();
    let far = Grid { origin: grid.origin + DVec3::new(50.0, 0.0, 0.0), ..grid };
    let error = general().estimate(&images, &geometry, Some(&far)).unwrap_err().to_string();
    assert!(error.contains("no view shows any of its columns"), "{error}");
}

/// Images with pixels of a third of a voxel are averaged over the voxels: a pattern of single
/// columns, which interpolation alone would see as an error of up to 75 %, becomes a displacement of
/// up to 0.14 voxels.
#[test]
fn fine_pixels_are_averaged() {
    let mut fine = geometry();
    fine.views.pixel_km = vec![0.05 / 3.0; 6];
    let grid = estimate(&geometry(), &images(6), None).grid;
    let with = |pattern: [f32; 3]| {
        let values = Array3::from_shape_fn((6, 3 * SIZE[0], 3 * SIZE[1]), |(_, row, col)| {
            let (y, x) = ((row as f32 - 31.0) / 3.0, (col as f32 - 36.0) / 3.0);
            pattern[col % 3] * (0.02 + 0.2 * (-(x * x + y * y) / 12.0).exp())
        });
        estimate(&fine, &ViewStack::new(values).unwrap(), Some(&grid)).values
    };
    let error = difference(&with([1.0, 1.0, 1.0]), &with([0.5, 1.75, 0.75]));
    assert!(error < 0.12, "{error}");
}

#[test]
fn the_folded_network_is_kept_for_the_same_geometry() {
    let (estimator, geometry) = (general(), geometry());
    let grid = estimator.grid(&geometry, SIZE).unwrap();
    let first = estimator.network(&geometry, &grid).unwrap();
    let elsewhere = ImagingGeometry { target_km: [9.0, 9.0, 1.12], ..geometry.clone() };
    assert!(std::sync::Arc::ptr_eq(&first, &estimator.network(&elsewhere, &grid).unwrap()));
    let mut other = geometry;
    other.views.sun_zenith_deg = 41.0;
    assert!(!std::sync::Arc::ptr_eq(&first, &estimator.network(&other, &grid).unwrap()));
}

#[test]
fn a_geometry_outside_the_training_is_refused_with_number_and_range() {
    type Change = fn(&mut ImagingGeometry);
    let changes: [(Change, &str); 8] = [
        (
            |g| {
                let views = &mut g.views;
                (views.view_zenith_deg, views.view_azimuth_deg) = (vec![20.0; 6], vec![10.0; 6]);
            },
            "number of different views is 1, but must be 3 to 40",
        ),
        (
            |g| g.views.camera_distance_km[2] = Some(0.5),
            "altitude of a camera is 1.530 km (view 2), but must be above the grid",
        ),
        (|g| g.views.sun_zenith_deg = 80.0, "solar zenith angle is 80.00, but must be 0 to 70"),
        (|g| g.views.view_zenith_deg[3] = 79.0, "view zenith angle is 79.00 (view 3)"),
        (|g| g.views.pixel_km[5] = 0.4, "pixel size at the target over that of a voxel is 8.000"),
        (|g| g.wavelength_um = 0.865, "wavelength is 0.865, but must be 0.63 to 0.71 um"),
        (|g| g.views.pixel_km = vec![0.2; 6], "horizontal voxel size is 0.2000"),
        (|g| g.views.view_zenith_deg[0] = 90.0, "view zenith angle is 90"),
    ];
    for (change, message) in changes {
        let mut wrong = geometry();
        change(&mut wrong);
        let error = general().estimate(&images(6), &wrong, None).unwrap_err().to_string();
        assert!(error.contains(message), "{error}");
    }
    let mut low_sun = geometry();
    low_sun.views.sun_zenith_deg = 80.0;
    general().outside_training().estimate(&images(6), &low_sun, None).unwrap();
    let error = general().estimate(&images(5), &geometry(), None).unwrap_err().to_string();
    assert!(error.contains("number of views: expected 6, found 5"), "{error}");
}

/// Images of a cloud by the solver are usual; deliberately wrong ones are named.
#[test]
fn images_unlike_those_of_the_training_are_named() {
    let (cloud, light) = (small_cloud(), light());
    // Near the altitude of the target, all views agree whatever their directions.
    let target = cloud.grid.center() + DVec3::new(0.0, 0.0, 0.4);
    let views = |sign| views(target, sign);
    let images = observed(&cloud, &light, &views(1.0)).images;
    let unusual = |sign: f64, images: Array3<f32>| -> Vec<String> {
        let images = ViewStack::new(images).unwrap();
        let observation = Observation::new(light.clone(), views(sign), images).unwrap();
        let geometry = observation.imaging_geometry().unwrap();
        let estimator = general();
        let estimate = estimator.estimate(&observation.images, &geometry, None).unwrap();
        let found = estimator.unusual(&observation.images, &geometry, &estimate).unwrap();
        found.into_iter().map(|unusual| unusual.name).collect()
    };
    let values = &images.values;
    assert!(unusual(1.0, values.clone()).is_empty());
    // Azimuths counted counterclockwise.
    assert_eq!(unusual(-1.0, values.clone()), ["explained"]);
    // Reflectances in per cent.
    let reflectance = 100.0 * std::f32::consts::PI / 40_f32.to_radians().cos();
    let named = unusual(1.0, reflectance * values);
    assert!(named.starts_with(&["background".into(), "brightest".into()]), "{named:?}");
    let most = 0.5 * images.brightest();
    assert_eq!(unusual(1.0, values.mapv(|value| value.min(most))), ["equal"]);
}

/// A surface of albedo 0.2, whose radiance alone would be taken for clouds everywhere, changes the
/// estimate by less than its error.
#[test]
fn a_bright_surface_is_not_taken_for_a_cloud() {
    let cloud = small_cloud();
    let views = views(cloud.grid.center(), 1.0);
    let above = |albedo: f64| {
        let mut light = light();
        light.surface.albedo = albedo;
        let observation = observed(&cloud, &light, &views);
        let geometry = observation.imaging_geometry().unwrap();
        estimate(&geometry, &observation.images, Some(&cloud.grid)).values
    };
    let (ocean, land) = (above(0.05), above(0.2));
    let change = (&land - &ocean).mapv(f32::abs).sum() / ocean.sum();
    assert!(change < 0.35, "{change}");
    let total = land.sum() / ocean.sum();
    assert!((0.8..1.2).contains(&total), "{total}");
}

/// Networks of one formation are for a dark surface, and name a brighter one.
#[test]
fn a_network_of_one_formation_names_a_bright_surface() {
    let estimator = Estimator::new(load_trained_weights("cloudct-10").unwrap());
    let views = Formation::cloudct_10().views(DVec3::new(0.8, 0.8, 1.12), [32, 32]).unwrap();
    for (albedo, is_named) in [(0.0, false), (0.05, false), (0.15, true), (0.6, true)] {
        // The radiance of a Lambertian surface, of which the air above it transmits about 95 %, and
        // about that of the air.
        let radiance = (0.95 * albedo / PI * 30_f64.to_radians().cos() + 0.004) as f32;
        let images = ViewStack::new(Array3::from_elem((10, 32, 32), radiance)).unwrap();
        let observation = Observation::new(Sun::default(), views.clone(), images).unwrap();
        let geometry = observation.imaging_geometry().unwrap();
        let estimate = estimator.estimate(&observation.images, &geometry, None).unwrap();
        let found = estimator.unusual(&observation.images, &geometry, &estimate).unwrap();
        assert_eq!(found.len(), usize::from(is_named), "{albedo}: {found:?}");
        let names_albedo = |unusual: &Unusual| (unusual.value - albedo).abs() < 0.01;
        assert!(found.iter().all(names_albedo), "{albedo}: {found:?}");
    }
}

/// Weights for one formation accept grids with their own voxels and levels only.
#[test]
fn weights_of_one_formation_keep_their_voxels() {
    let weights = load_trained_weights("cloudct-10").unwrap();
    let TrainedWeights::Formation(formation) = &weights else { panic!("one formation") };
    let geometry = ImagingGeometry {
        views: formation.metadata.view_geometry.clone(),
        target_km: [0.0, 0.0, formation.metadata.target_altitude_km],
        wavelength_um: 0.672,
        solar_irradiance: 1.0,
        shifts: Vec::new(),
    };
    let estimator = Estimator::new(weights);
    let whole = estimator.estimate(&images(10), &geometry, None).unwrap().extinction;
    let part = Grid { shape: [32, 8, 8], ..whole.grid };
    assert_eq!(
        estimator.estimate(&images(10), &geometry, Some(&part)).unwrap().extinction.grid,
        part
    );
    let finer = Grid { spacing: 0.5 * whole.grid.spacing, ..whole.grid };
    let error = estimator.estimate(&images(10), &geometry, Some(&finer)).unwrap_err().to_string();
    assert!(error.contains("grid of the estimate"), "{error}");
}
