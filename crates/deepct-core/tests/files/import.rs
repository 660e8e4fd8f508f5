//! Import of clouds from files of other programs. The simulations are written by the netCDF library
//! (fixtures/les.py) from a formula, which is also evaluated here.

use crate::{check_refusal, place};
use deepct_core::cloud::{Cloud, effective_radius};
use deepct_core::io::import::{Crop, ImportSettings, import_cloud};
use deepct_core::math::DVec3;
use ndarray::{Array3, s};
use std::path::PathBuf;

pub(crate) fn fixture(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures").join(name)
}

/// Liquid water content of the fixtures (g/m3).
fn water(time: usize, shape: [usize; 3]) -> Array3<f32> {
    Array3::from_shape_fn(shape, |(k, j, i)| ((7 * time + 5 * k + 3 * j + 2 * i) % 13) as f32 * 0.1)
}

fn content(cloud: &Cloud) -> &Array3<f32> {
    &cloud.microphysics.as_ref().unwrap().liquid_water_content
}

#[track_caller]
fn assert_close(found: &Array3<f32>, expected: &Array3<f32>) {
    assert_eq!(found.dim(), expected.dim());
    for (voxel, value) in expected.indexed_iter() {
        assert!((found[voxel] - value).abs() < 2e-6, "{voxel:?}: {} not {value}", found[voxel]);
    }
}

#[test]
fn a_simulation_that_follows_cf() {
    let settings = ImportSettings { time: 1, droplets_per_cm3: Some(70.0), ..Default::default() };
    let cloud = import_cloud(fixture("cf.nc"), &settings).unwrap().0;
    assert_close(content(&cloud), &water(1, [6, 8, 10]));
    assert!(cloud.grid.origin.distance(DVec3::new(0.0, 0.0, 0.38)) < 1e-12);
    assert!(cloud.grid.spacing.distance(DVec3::new(0.05, 0.05, 0.04)) < 1e-12);
    let droplets = cloud.microphysics.unwrap();
    for (water, radius) in droplets.liquid_water_content.iter().zip(&droplets.effective_radius) {
        assert_eq!(*radius, effective_radius(*water, 70.0));
    }
}

#[test]
fn a_crop_wraps_around_the_sides_and_levels_are_chosen() {
    let settings = ImportSettings {
        crop: Some(Crop { x0: 7, y0: 6, nx: 5, ny: 4 }),
        base: Some(0.46),
        levels: Some(5),
        ..Default::default()
    };
    let cloud = import_cloud(fixture("cf.nc"), &settings).unwrap().0;
    let whole = water(0, [6, 8, 10]);
    let expected = Array3::from_shape_fn((5, 4, 5), |(k, j, i)| {
        // The last level is above the top of the file.
        if k + 2 < 6 { whole[[k + 2, (j + 6) % 8, (i + 7) % 10]] } else { 0.0 }
    });
    assert_close(content(&cloud), &expected);
    assert!(cloud.grid.origin.distance(DVec3::new(0.35, 0.30, 0.46)) < 1e-12);
}

/// Bins with radii of 2, 2 * 2^(1/3) and 2 * 2^(2/3) um that contain 1, 2 and 3 parts of the liquid
/// water.
#[test]
fn a_droplet_spectrum_becomes_radius_and_variance() {
    let settings = ImportSettings { spacing: None, ..Default::default() };
    let cloud = import_cloud(fixture("bins.nc"), &settings).unwrap().0;
    let parts = water(0, [2, 3, 4]);
    assert_close(content(&cloud), &(6.0 * &parts));
    let radii = [0.0, 1.0, 2.0].map(|bin: f64| 2.0 * (bin / 3.0).exp2());
    let areas = [1.0 / radii[0], 2.0 / radii[1], 3.0 / radii[2]];
    let area: f64 = areas.iter().sum();
    let mean = 6.0 / area;
    let square = |(area, radius): (f64, f64)| area * (radius - mean).powi(2);
    let variance = areas.into_iter().zip(radii).map(square).sum::<f64>() / (area * mean * mean);
    let droplets = cloud.microphysics.unwrap();
    for (voxel, part) in parts.indexed_iter() {
        let found = [droplets.effective_radius[voxel], droplets.effective_variance[voxel]];
        let expected = if *part > 0.0 { [mean, variance] } else { [0.0, 0.0] };
        for (found, expected) in found.into_iter().zip(expected) {
            assert!((f64::from(found) - expected).abs() < 1e-5, "{voxel:?}: {found} {expected}");
        }
    }
}

#[test]
fn a_mixing_ratio_on_stretched_levels_in_another_order_of_axes() {
    let settings = ImportSettings { time: 2, ..Default::default() };
    let cloud = import_cloud(fixture("mixing.nc"), &settings).unwrap().0;
    // Edges of the levels (km) and liquid water content (g/m3), computed by hand.
    let edges = [0.0, 0.04, 0.085, 0.145, 0.225, 0.315];
    let density = [1.2, 1.15, 1.1, 1.05, 1.0_f32];
    let mut fine = water(2, [5, 4, 6]);
    for (k, density) in density.into_iter().enumerate() {
        fine.slice_mut(s![k, .., ..]).mapv_inplace(|ratio| ratio * density);
    }
    assert_eq!(cloud.grid.shape, [8, 2, 3]);
    assert!(cloud.grid.origin.length() < 1e-12);
    // Columns of 25 m become columns of 50 m by averaging four of them. The second new level lies
    // within the second level of the file, and the column keeps its water.
    let four = |k: usize, j: usize, i: usize| {
        fine.slice(s![k, 2 * j..2 * j + 2, 2 * i..2 * i + 2]).sum() / 4.0
    };
    for (j, i) in [(0, 0), (1, 2)] {
        let found = content(&cloud);
        assert!((found[[0, j, i]] - four(0, j, i)).abs() < 1e-5);
        assert!((found[[1, j, i]] - four(1, j, i)).abs() < 1e-5);
        let path: f64 = (0..5).map(|k| f64::from(four(k, j, i)) * (edges[k + 1] - edges[k])).sum();
        let kept = 0.04 * f64::from(found.slice(s![.., j, i]).sum());
        assert!((kept - path).abs() < 1e-6, "{kept} {path}");
    }
}

const PYSHDOM: &str =
    "# a cloud\n3 2 4\n0.05 0.05 0.50 0.54 0.58 0.62\n0 0 1 0.25 8.0\n2 1 3 0.5 12.5\n";
const AT3D: &str = "# a cloud\n3,2,4 # nx,ny,nz\n0.05,0.05 # dx,dy [km]\n0.50,0.54,0.58,0.62 # km\n\
                    x,y,z,lwc,reff\n0,0,1,0.25,8.0\n2,1,3,0.5,12.5\n";

#[test]
fn both_text_formats_hold_the_same_cloud() {
    let (_folder, path) = place("cloud.txt");
    let clouds = [PYSHDOM, AT3D].map(|text| {
        std::fs::write(&path, text).unwrap();
        import_cloud(&path, &ImportSettings::default()).unwrap().0
    });
    assert_eq!(clouds[0], clouds[1]);
    let [cloud, _] = clouds;
    assert_eq!(cloud.grid.shape, [4, 2, 3]);
    // The values are given at nodes; the first one is at x = 0, y = 0, z = 0.50 km.
    assert!(cloud.grid.voxel_center([0, 0, 0]).distance(DVec3::new(0.0, 0.0, 0.5)) < 1e-12);
    let droplets = cloud.microphysics.unwrap();
    let mut expected = Array3::zeros((4, 2, 3));
    (expected[[1, 0, 0]], expected[[3, 1, 2]]) = (0.25, 0.5);
    assert_close(&droplets.liquid_water_content, &expected);
    (expected[[1, 0, 0]], expected[[3, 1, 2]]) = (8.0, 12.5);
    assert_close(&droplets.effective_radius, &expected);
}

#[test]
fn the_effective_variance_of_a_text_file_is_read() {
    let (_folder, path) = place("cloud.txt");
    let with_variance = [
        PYSHDOM.replace("8.0", "8.0 0.15").replace("12.5", "12.5 0.2"),
        AT3D.replace("reff", "reff,veff").replace("8.0", "8.0,0.15").replace("12.5", "12.5,0.2"),
    ];
    for text in with_variance {
        std::fs::write(&path, text).unwrap();
        let cloud = import_cloud(&path, &ImportSettings::default()).unwrap().0;
        let variance = cloud.microphysics.unwrap().effective_variance;
        assert!((variance[[1, 0, 0]] - 0.15).abs() < 1e-6);
        assert!((variance[[3, 1, 2]] - 0.2).abs() < 1e-6);
    }
}

#[test]
fn what_is_not_a_simulation_is_refused() {
    let import = |name: &str, settings: &ImportSettings| import_cloud(fixture(name), settings);
    let none = ImportSettings::default();
    check_refusal(import("none.nc", &none), &fixture("none.nc"), "does not exist");
    let cf = fixture("cf.nc");
    let late = ImportSettings { time: 2, ..none.clone() };
    check_refusal(import("cf.nc", &late), &cf, "--time from 0 to 1");
    let other = ImportSettings { variable: Some("up".into()), ..none.clone() };
    check_refusal(import("cf.nc", &other), &cf, "no axis Y");
    for crop in [
        Crop { x0: 10, y0: 0, nx: 1, ny: 1 },
        Crop { x0: 0, y0: 0, nx: 11, ny: 1 },
        Crop { x0: 0, y0: 0, nx: 0, ny: 1 },
    ] {
        let beyond = ImportSettings { crop: Some(crop), ..none.clone() };
        check_refusal(import("cf.nc", &beyond), &cf, "crop");
    }
    let spacing = ImportSettings { spacing: Some(DVec3::new(0.05, 0.0, 0.04)), ..none };
    check_refusal(import("cf.nc", &spacing), &cf, "spacing");
}

#[test]
fn text_that_does_not_fit_is_refused_by_its_line() {
    let (_folder, path) = place("cloud.txt");
    let whole = || [PYSHDOM, AT3D];
    let mut cases = vec![
        (String::from("hello"), "line 1"),
        (String::new(), "line 1"),
        (PYSHDOM.replace("3 2 4", "3 2"), "line 2: does not hold three counts"),
        (PYSHDOM.replace("3 2 4", "3 2 99999999999999"), "line 2: declares"),
        (PYSHDOM.replace(" 0.62", ""), "line 3: has 3 altitudes"),
        (AT3D.replace("lwc", "water"), "line 5: does not name the columns"),
    ];
    for text in whole() {
        for (from, to, names) in [
            ("0.25", "-0.25", "lacks a number"),
            ("0.25", "nan", "lacks a number"),
            ("8.0", "", "lacks a number"),
            ("8.0", "0.0", "without an effective radius"),
            ("0.05", "-0.05", "positive steps"),
        ] {
            cases.push((text.replace(from, to), names));
        }
    }
    cases.push((PYSHDOM.replace("2 1 3 0.5", "2 1 4 0.5"), "line 5: does not start with indices"));
    for (text, names) in cases {
        std::fs::write(&path, &text).unwrap();
        check_refusal(import_cloud(&path, &ImportSettings::default()), &path, names);
    }
    std::fs::write(&path, [0xff, 0xfe, 0x00, 0x01, 0x80]).unwrap();
    check_refusal(import_cloud(&path, &ImportSettings::default()), &path, "neither HDF5 nor text");
}
