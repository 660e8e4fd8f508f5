//! Units, missing values, names and plausibility of the variables of files. Each case states the
//! right value or the refusal.

use crate::import::fixture;
use crate::own::{grid, provenance, set_text, set_units};
use crate::{check_refusal, place};
use deepct_core::Result;
use deepct_core::cloud::{Cloud, Microphysics};
use deepct_core::grid::Volume;
use deepct_core::io::import::{AirDensity, ImportSettings, import_cloud};
use deepct_core::io::{self, read_cloud, read_implausible_cloud, read_volume};
use hdf5::{File, H5Type};
use ndarray::{Array3, s};
use std::path::Path;

/// A voxel inside the grid.
const MIDDLE: [usize; 3] = [1, 2, 3];

/// Liquid water content (g/m3) of the test file: positive in the middle, zero on the sides.
fn water() -> Array3<f32> {
    Array3::from_shape_fn(grid().shape, |(k, j, i)| {
        if k == 1 && (1..3).contains(&j) && (1..4).contains(&i) { 0.25 * i as f32 } else { 0.0 }
    })
}

/// Writes a file with `lwc`, `reff` (8 um), `veff` (0.125) and `extinction` (1 km-1), and edits it.
fn edited(path: &Path, edit: impl FnOnce(&File)) {
    let all = |value| Array3::from_elem(grid().shape, value);
    let droplets = Microphysics {
        liquid_water_content: water(),
        effective_radius: all(8.0),
        effective_variance: all(0.125),
    };
    let mut cloud = Cloud::from_microphysics(grid(), droplets).unwrap();
    cloud.extinction = Some(all(1.0));
    io::write_cloud(path, &cloud, &provenance()).unwrap();
    let file = File::open_rw(path).unwrap();
    edit(&file);
    file.close().unwrap();
}

/// Copies a simulation of the fixtures and edits it.
fn edited_fixture(name: &str, path: &Path, edit: impl FnOnce(&File)) {
    std::fs::copy(fixture(name), path).unwrap();
    let file = File::open_rw(path).unwrap();
    edit(&file);
    file.close().unwrap();
}

/// Multiplies the values of a variable and sets its units.
fn scale(file: &File, name: &str, factor: f64, units: &str) {
    let variable = file.dataset(name).unwrap();
    let values = variable.read_dyn::<f64>().unwrap() * factor;
    if variable.dtype().unwrap().size() == 4 {
        variable.write(values.mapv(|value| value as f32).view()).unwrap();
    } else {
        variable.write(values.view()).unwrap();
    }
    set_units(file, name, units);
}

/// Sets one value of `lwc` or `reff`.
fn set_value(file: &File, name: &str, voxel: [usize; 3], value: f32) {
    let variable = file.dataset(name).unwrap();
    let mut values: Array3<f32> = variable.read().unwrap();
    values[voxel] = value;
    variable.write(values.view()).unwrap();
}

/// Sets a numeric attribute.
fn set_numbers<T: H5Type + Clone>(file: &File, name: &str, attribute: &str, values: &[T]) {
    let variable = file.dataset(name).unwrap();
    let _ = variable.delete_attr(attribute);
    variable.new_attr_builder().with_data(values).create(attribute).unwrap();
}

/// Imports with the voxels of the file.
fn import(path: &Path, change: impl FnOnce(&mut ImportSettings)) -> Result<(Cloud, Vec<String>)> {
    let mut settings = ImportSettings { spacing: None, ..ImportSettings::default() };
    change(&mut settings);
    import_cloud(path, &settings).map(|(cloud, report)| (cloud, report.warnings))
}

fn droplets(cloud: Cloud) -> Microphysics {
    cloud.microphysics.unwrap()
}

#[track_caller]
fn assert_close(found: &Array3<f32>, expected: &Array3<f32>) {
    assert_eq!(found.dim(), expected.dim());
    for (voxel, value) in expected.indexed_iter() {
        let error = (found[voxel] - value).abs();
        assert!(error <= 1e-6 * value.abs(), "{voxel:?}: {} not {value}", found[voxel]);
    }
}

/// Variable, factor of the numbers, units.
const SAME: [(&str, f64, &str); 16] = [
    ("lwc", 1e-3, "kg m-3"),
    ("lwc", 1e-3, "kg/m^3"),
    ("lwc", 1e-3, "kg.m-3"),
    ("lwc", 1e-3, "kg m**-3"),
    ("lwc", 1e3, "mg m-3"),
    ("lwc", 1.0, "gram / meter ** 3"),
    ("lwc", 1e-6, "g cm-3"),
    ("reff", 1e-6, "m"),
    ("reff", 1e-3, "mm"),
    ("reff", 1.0, "\u{b5}m"),
    ("reff", 1.0, "\u{3bc}m"),
    ("reff", 1.0, "micrometers"),
    ("veff", 1e2, "%"),
    ("extinction", 1e-3, "m-1"),
    ("extinction", 1e-3, "1/m"),
    ("extinction", 1e3, "Mm-1"),
];

#[test]
fn a_cloud_is_the_same_in_other_units() {
    let (_folder, path) = place("cloud.nc");
    edited(&path, |_| {});
    let expected = read_cloud(&path).unwrap();
    for (name, factor, units) in SAME {
        edited(&path, |file| scale(file, name, factor, units));
        for (read, with) in [
            (read_cloud(&path), "read_cloud"),
            (import(&path, |_| {}).map(|both| both.0), "import"),
        ] {
            let found = read.unwrap_or_else(|error| panic!("{with} {name} in {units}: {error}"));
            if let Some(extinction) = &found.extinction {
                assert_close(extinction, expected.extinction.as_ref().unwrap());
            }
            let [found, expected] = [found, expected.clone()].map(droplets);
            assert_close(&found.liquid_water_content, &expected.liquid_water_content);
            for (voxel, water) in water().indexed_iter() {
                let wet = *water > 0.0;
                let [radius, variance] =
                    [found.effective_radius[voxel], found.effective_variance[voxel]];
                assert!(!wet || (radius - 8.0).abs() < 1e-5, "{with}: {name} in {units}: {radius}");
                assert!(!wet || (variance - 0.125).abs() < 1e-6, "{with}: {name} in {units}");
            }
        }
    }
    edited(&path, |file| {
        ["x", "y", "z"].map(|axis| scale(file, axis, 1e3, "m")).into_iter().collect()
    });
    assert!(read_cloud(&path).unwrap().grid.matches(&grid()));
}

#[test]
fn units_that_are_missing_unknown_or_of_another_quantity_are_refused() {
    let (_folder, path) = place("cloud.nc");
    for (name, units, cure) in [
        ("lwc", "", "--units lwc=\""),
        ("lwc", "kilos", "--units lwc=\""),
        ("lwc", "m-3", "--units lwc=\""),
        ("reff", "", "--units reff=\"um\""),
        ("reff", "um2", "--units reff=\"um\""),
        ("reff", "1", "--units reff=\"um\""),
        ("x", "", "--units x=\"km\""),
        ("x", "degrees", "--units x=\"km\""),
        ("veff", "um", "--units veff=\"1\""),
    ] {
        edited(&path, |file| set_units(file, name, units));
        let found = if units.is_empty() { "has no units".into() } else { format!("\"{units}\"") };
        for words in [name, &found, cure] {
            check_refusal(read_cloud(&path), &path, words);
            check_refusal(
                import(&path, |settings| settings.variable = Some("lwc".into())),
                &path,
                words,
            );
        }
    }
    edited(&path, |file| set_units(file, "extinction", ""));
    check_refusal(read_volume(&path), &path, "--units extinction=\"km-1\"");
    // A plain number needs no unit.
    edited(&path, |file| file.dataset("veff").unwrap().delete_attr("units").unwrap());
    assert_eq!(droplets(read_cloud(&path).unwrap()).effective_variance[MIDDLE], 0.125);
}

#[test]
fn given_units_replace_those_of_the_file() {
    let (_folder, path) = place("cloud.nc");
    edited(&path, |file| {
        scale(file, "lwc", 1e-3, "1e-5kg/kg");
        scale(file, "x", 1e3, "");
        scale(file, "extinction", 1.0, "kg m-3");
        set_text(file, "extinction", "standard_name", "");
        set_text(file, "extinction", "long_name", "");
        file.relink("lwc", "ql").unwrap();
        file.relink("extinction", "rho").unwrap();
    });
    let units = |pairs: &[(&str, &str)]| {
        pairs.iter().map(|(name, unit)| ((*name).to_owned(), (*unit).to_owned())).collect()
    };
    let stated = units(&[("ql", "kg kg-1"), ("x", "m")]);
    let (cloud, _) = import(&path, |settings| settings.units = stated).unwrap();
    assert!(cloud.grid.matches(&grid()));
    assert_close(&droplets(cloud).liquid_water_content, &water());
    let other = units(&[("lwc", "kg m-3")]);
    check_refusal(import(&path, |settings| settings.units = other), &path, "lwc: is missing");
    let unknown = units(&[("ql", "kilos")]);
    check_refusal(import(&path, |settings| settings.units = unknown), &path, "kilos");
}

#[test]
fn units_of_images_are_converted() {
    let (_folder, path) = place("images.nc");
    let images = crate::own::observation();
    io::write_observation(&path, &images, &provenance()).unwrap();
    let file = File::open_rw(&path).unwrap();
    scale(&file, "camera_position", 1e3, "m");
    scale(&file, "wavelength", 1e3, "nm");
    file.close().unwrap();
    let found = io::read_observation(&path).unwrap();
    assert!((found.light.wavelength - images.light.wavelength).abs() < 1e-12);
    let file = File::open_rw(&path).unwrap();
    set_units(&file, "radiance", "W m-2 sr-1 um-1");
    file.close().unwrap();
    check_refusal(io::read_observation(&path), &path, "sr-1 is expected");
    check_refusal(io::read_observation(&path), &path, "the variable sun_irradiance");
    let file = File::open_rw(&path).unwrap();
    set_units(&file, "radiance", "1");
    file.close().unwrap();
    check_refusal(io::read_observation(&path), &path, "a reflectance times the cosine");
}

/// The value of a corner voxel of `lwc`, and how the file declares it as missing.
#[test]
fn liquid_water_that_is_missing_outside_of_cloud_is_absent() {
    let (_folder, path) = place("cloud.nc");
    type Declare = fn(&File);
    let cases: [(f32, Declare); 11] = [
        (9.969_21e36, |_| {}),
        (f32::NAN, |file| set_numbers(file, "lwc", "_FillValue", &[f32::NAN])),
        (-999.0, |file| set_numbers(file, "lwc", "_FillValue", &[-999.0_f32])),
        (999.99, |file| set_numbers(file, "lwc", "missing_value", &[999.99_f64])),
        (-9999.0, |file| set_numbers(file, "lwc", "missing_value", &[-9999_i32])),
        (-9999.0, |file| set_text(file, "lwc", "missing_value", "-9999.f")),
        (999.99, |file| {
            set_numbers(file, "lwc", "_FillValue", &[1e20_f32]);
            set_numbers(file, "lwc", "missing_value", &[999.99_f32]);
        }),
        (777.0, |file| set_numbers(file, "lwc", "missing_value", &[999.0_f32, 777.0])),
        (999.0, |file| set_numbers(file, "lwc", "valid_range", &[0.0_f32, 100.0])),
        (999.0, |file| set_numbers(file, "lwc", "valid_max", &[100.0_f32])),
        (-1.0, |file| set_numbers(file, "lwc", "valid_min", &[0.0_f32])),
    ];
    for (value, declare) in cases {
        edited(&path, |file| {
            set_value(file, "lwc", [2, 0, 0], value);
            declare(file);
        });
        let (cloud, warnings) = import(&path, |_| {}).unwrap();
        assert_close(&droplets(cloud).liquid_water_content, &water());
        assert_eq!(warnings.len(), 1, "{value}: {warnings:?}");
        assert!(warnings[0].contains("missing in 1 of 60 voxels"), "{warnings:?}");
        check_refusal(read_cloud(&path), &path, "[z 2, y 0, x 0]");
    }
}

#[test]
fn liquid_water_that_is_missing_otherwise_is_refused() {
    let (_folder, path) = place("cloud.nc");
    // A value that is not declared as missing.
    edited(&path, |file| set_value(file, "lwc", [0, 0, 0], f32::NAN));
    check_refusal(import(&path, |_| {}), &path, "[z 0, y 0, x 0]");
    // A hole inside of cloud.
    edited(&path, |file| {
        let variable = file.dataset("lwc").unwrap();
        variable.write(Array3::from_elem(grid().shape, 0.5_f32).view()).unwrap();
        set_value(file, "lwc", MIDDLE, -999.0);
        set_numbers(file, "lwc", "_FillValue", &[-999.0_f32]);
    });
    check_refusal(import(&path, |_| {}), &path, "missing at [z 1, y 2, x 3], which is inside");
    // One whose value is outside the valid range.
    edited(&path, |file| {
        let variable = file.dataset("lwc").unwrap();
        variable.write(Array3::from_elem(grid().shape, 0.5_f32).view()).unwrap();
        set_value(file, "lwc", MIDDLE, 9.0);
        set_numbers(file, "lwc", "valid_max", &[5.0_f32]);
    });
    check_refusal(import(&path, |_| {}), &path, "missing at [z 1, y 2, x 3], which is inside");
    check_refusal(read_cloud(&path), &path, "[z 1, y 2, x 3]");
}

#[test]
fn packed_and_unsigned_integers_are_decoded() {
    let (_folder, path) = place("cf.nc");
    // The fixture packs kg m-3 with a factor of 1e-5: 40000 is 0.4 g m-3.
    edited_fixture("cf.nc", &path, |file| {
        let cloud = file.dataset("cloud").unwrap();
        let mut stored = cloud.read_dyn::<i16>().unwrap();
        stored.fill(0);
        stored[[0, 3, 3, 3]] = 40_000_u16 as i16;
        stored[[0, 5, 0, 0]] = -32_767;
        cloud.write(stored.view()).unwrap();
        set_text(file, "cloud", "_Unsigned", "true");
        set_numbers(file, "cloud", "scale_factor", &[1e-8_f64]);
    });
    let (cloud, warnings) = import(&path, |_| {}).unwrap();
    let found = droplets(cloud).liquid_water_content;
    assert!((found[[3, 3, 3]] - 0.4).abs() < 1e-6, "{}", found[[3, 3, 3]]);
    assert_eq!(found[[5, 0, 0]], 0.0);
    assert!(warnings.iter().any(|warning| warning.contains("missing in 1 of")), "{warnings:?}");
}

/// Attributes that would turn all values into zeros, or that are no numbers.
#[test]
fn values_packed_by_anything_but_numbers_are_refused() {
    let (_folder, path) = place("cloud.nc");
    for numbers in [&[0.0][..], &[f64::NAN], &[f64::INFINITY], &[1.0, 2.0]] {
        edited(&path, |file| set_numbers(file, "lwc", "scale_factor", numbers));
        check_refusal(read_cloud(&path), &path, "scale_factor");
        check_refusal(import(&path, |_| {}), &path, "scale_factor");
    }
    edited(&path, |file| set_text(file, "lwc", "add_offset", "0.5"));
    check_refusal(read_cloud(&path), &path, "add_offset");
    edited(&path, |file| set_numbers(file, "lwc", "scale_factor", &[0.5_f64]));
    let half = droplets(read_cloud(&path).unwrap()).liquid_water_content;
    assert_close(&half, &(0.5 * water()));
}

/// A cloud on depths instead of altitudes would stand on its head.
#[test]
fn coordinates_that_increase_downwards_are_refused() {
    let (_folder, path) = place("cloud.nc");
    edited(&path, |file| set_text(file, "z", "positive", "down"));
    check_refusal(read_cloud(&path), &path, "increases downwards");
    check_refusal(read_volume(&path), &path, "increases downwards");
    check_refusal(io::read_grid(&path), &path, "increases downwards");
    check_refusal(import(&path, |_| {}), &path, "increases downwards");
    for (simulation, axis) in [("cf.nc", "up"), ("mixing.nc", "z")] {
        edited_fixture(simulation, &path, |file| set_text(file, axis, "positive", "Down"));
        check_refusal(import(&path, |_| {}), &path, "increases downwards");
    }
}

/// Images without units are taken to be relative to an irradiance in the same unit (1.7 in this file),
/// as deepct writes them, unless they are brighter than clouds.
#[test]
fn bright_images_without_units_are_refused() {
    let (_folder, path) = place("images.nc");
    let mut images = crate::own::observation();
    for (brightest, is_read) in [(1.6, true), (1.8, false), (45.0, false)] {
        let factor = brightest / images.images.brightest();
        images.images.values *= factor;
        io::write_observation(&path, &images, &provenance()).unwrap();
        assert_eq!(io::read_observation(&path).unwrap().images, images.images);
        let file = File::open_rw(&path).unwrap();
        file.dataset("radiance").unwrap().delete_attr("units").unwrap();
        file.close().unwrap();
        match is_read {
            true => assert_eq!(io::read_observation(&path).unwrap().images, images.images),
            false => check_refusal(io::read_observation(&path), &path, "has no units"),
        }
    }
}

#[test]
fn an_effective_radius_that_is_missing_is_refused_where_there_is_water() {
    let (_folder, path) = place("cloud.nc");
    for value in [f32::NAN, 0.0, -1.0, 9.969_21e36] {
        edited(&path, |file| set_value(file, "reff", MIDDLE, value));
        check_refusal(import(&path, |_| {}), &path, "[z 1, y 2, x 3]");
        check_refusal(read_cloud(&path), &path, "effective radius");
    }
    // Elsewhere the radius has no meaning, and traces of water need none.
    edited(&path, |file| {
        set_value(file, "reff", [0, 0, 0], f32::NAN);
        set_value(file, "reff", [0, 0, 1], 0.0);
        set_value(file, "lwc", [0, 0, 1], 1e-6);
    });
    let (cloud, warnings) = import(&path, |_| {}).unwrap();
    assert_close(&droplets(cloud).liquid_water_content, &water());
    assert!(warnings[0].contains("1 voxels with less than 0.001 g/m3"), "{warnings:?}");
    edited(&path, |file| set_value(file, "reff", [0, 0, 0], f32::NAN));
    assert_eq!(droplets(read_cloud(&path).unwrap()).effective_radius[[0, 0, 0]], 0.0);
}

#[test]
fn only_a_density_of_air_is_taken_for_one() {
    let (_folder, path) = place("cloud.nc");
    let ratio = |file: &File| {
        scale(file, "lwc", 1.0, "g/kg");
        file.relink("lwc", "ql").unwrap();
        set_text(file, "extinction", "standard_name", "");
        set_text(file, "extinction", "long_name", "");
    };
    let constant = |density| {
        move |settings: &mut ImportSettings| {
            settings.air_density = Some(AirDensity::Constant(density));
        }
    };
    for (name, value, units, standard, words) in [
        ("density", 1.0, "", "", "its unit is missing"),
        ("density", 1.0, "Pa", "", "its unit is \"Pa\""),
        ("rho", 1000.0, "kg m-3", "", "density of air is from 0.1 to 2"),
        ("rho", 1.0, "g m-3", "", "density of air is from 0.1 to 2"),
        ("density", 1.0, "kg m-3", "sea_water_density", "its standard_name is another"),
        ("density", 1.0, "kg m-3", "long: density of liquid water", "its long_name is"),
        ("density", 1.0, "kg m-3", "long: potential density", "its long_name is"),
        ("sigma", 1.0, "kg m-3", "", "no density of air"),
    ] {
        edited(&path, |file| {
            ratio(file);
            scale(file, "extinction", value, units);
            match standard.strip_prefix("long: ") {
                Some(text) => set_text(file, "extinction", "long_name", text),
                None => set_text(file, "extinction", "standard_name", standard),
            }
            file.relink("extinction", name).unwrap();
        });
        match import(&path, |_| {}) {
            // That of the standard atmosphere takes its place.
            Ok((_, warnings)) => assert!(
                warnings.iter().any(|warning| warning.contains(words)),
                "{name} {units} {standard}: {warnings:?}"
            ),
            refused => check_refusal(refused, &path, words),
        }
        let (cloud, _) = import(&path, constant(1.0)).unwrap();
        assert_close(&droplets(cloud).liquid_water_content, &water());
    }
    for (name, value, units, standard) in [
        ("rho", 1.0, "kg m-3", ""),
        ("density", 1.0, "kg m-3", "air_density"),
        ("RHO", 1e3, "g/m3", ""),
        ("sigma", 1.0, "kg/m^3", "air_density"),
    ] {
        edited(&path, |file| {
            ratio(file);
            scale(file, "extinction", value, units);
            set_text(file, "extinction", "standard_name", standard);
            file.relink("extinction", name).unwrap();
        });
        let (cloud, _) = import(&path, |_| {}).unwrap();
        assert_close(&droplets(cloud).liquid_water_content, &water());
    }
    check_refusal(import(&path, constant(1100.0)), &path, "--air-density: is 1100 kg m-3");
}

#[test]
fn a_profile_or_a_tendency_is_not_the_liquid_water() {
    let name = "mass_concentration_of_cloud_liquid_water_in_air";
    let (_folder, path) = place("profile.nc");
    edited_fixture("mixing.nc", &path, |file| {
        set_text(file, "RHO", "standard_name", name);
        file.relink("RHO", "a_profile").unwrap();
    });
    let with_density = |settings: &mut ImportSettings| {
        settings.air_density = Some(AirDensity::Constant(1.0));
    };
    let (cloud, _) = import(&path, with_density).unwrap();
    assert_eq!(cloud.grid.shape, [5, 4, 6]);
    for (other, units) in [("tendency_of_", "kg m-3"), ("", "kg m-3 s-1"), ("", "m-3"), ("", "K")] {
        edited(&path, |file| {
            file.dataset("lwc").unwrap().delete_attr("standard_name").unwrap();
            set_text(file, "extinction", "standard_name", &format!("{other}{name}"));
            set_units(file, "extinction", units);
            file.relink("extinction", "a_field").unwrap();
        });
        let (cloud, _) = import(&path, |_| {}).unwrap();
        assert_close(&droplets(cloud).liquid_water_content, &water());
    }
    // Two fields with one name.
    edited(&path, |file| {
        file.relink("lwc", "a_field").unwrap();
        set_text(file, "extinction", "standard_name", name);
        set_units(file, "extinction", "g m-3");
        file.relink("extinction", "b_field").unwrap();
    });
    check_refusal(import(&path, |_| {}), &path, "so may b_field; choose with --variable");
}

#[test]
fn water_and_ice_are_read_as_liquid_with_a_warning() {
    let (_folder, path) = place("sam.nc");
    for (name, described) in
        [("QN", "Non-precipitating Condensate (Water+Ice)"), ("qc", "cloud water and ice")]
    {
        edited(&path, |file| {
            file.dataset("lwc").unwrap().delete_attr("standard_name").unwrap();
            set_text(file, "lwc", "long_name", described);
            file.relink("lwc", name).unwrap();
        });
        let (cloud, warnings) = import(&path, |_| {}).unwrap();
        assert_close(&droplets(cloud).liquid_water_content, &water());
        assert!(warnings[0].contains(&format!("{name} contains water and ice")), "{warnings:?}");
    }
}

#[test]
fn effective_radii_are_found_by_name_and_follow_from_the_droplet_number() {
    let (_folder, path) = place("cloud.nc");
    edited(&path, |file| {
        file.relink("reff", "re_cloud").unwrap();
        file.dataset("re_cloud")
            .unwrap()
            .write(Array3::from_elem(grid().shape, 28_f32).view())
            .unwrap();
    });
    let (cloud, _) = import(&path, |_| {}).unwrap();
    assert_eq!(droplets(cloud).effective_radius[MIDDLE], 28.0);
    edited(&path, |file| {
        file.relink("extinction", "nc").unwrap();
        file.unlink("reff").unwrap();
        scale(file, "nc", 400e6, "m-3");
    });
    let (cloud, warnings) = import(&path, |_| {}).unwrap();
    let expected = deepct_core::cloud::effective_radius(water()[MIDDLE], 400.0);
    assert!((droplets(cloud).effective_radius[MIDDLE] - expected).abs() < 1e-4);
    assert!(warnings[0].contains("droplet number concentration nc"), "{warnings:?}");
    // A number per voxel has the unit 1, and nothing tells its volume.
    edited(&path, |file| {
        file.relink("extinction", "nc").unwrap();
        file.unlink("reff").unwrap();
        scale(file, "nc", 4e16, "1");
    });
    check_refusal(import(&path, |_| {}), &path, "cm-3 is expected");
}

#[test]
fn values_far_beyond_those_of_clouds_are_refused_unless_allowed() {
    let (_folder, path) = place("cloud.nc");
    for (name, value, words) in [
        ("lwc", 25.0, "liquid water content: is 25 g m-3 at voxel [z 1, y 2, x 3]"),
        ("lwc", 300.0, "in mg instead of g"),
        ("reff", 8e-6, "the numbers may be in m;"),
        ("reff", 8e-3, "the numbers may be in mm;"),
        ("reff", 8e3, "the numbers may be in nm;"),
        ("reff", 0.5, "effective radius: is 0.5 um at voxel [z 1, y 2, x 3]"),
        ("reff", 61.0, "not from 1 to 60"),
        ("extinction", 1.1e4, "extinction: is 11000 km-1 at voxel [z 1, y 2, x 3]"),
        ("extinction", 5e4, "the numbers may be in Mm-1"),
        ("extinction", 3e36, "it may represent a missing value"),
    ] {
        edited(&path, |file| set_value(file, name, MIDDLE, value));
        check_refusal(read_cloud(&path), &path, words);
        let (cloud, warnings) = read_implausible_cloud(&path).unwrap();
        assert_eq!(warnings.len(), 1, "{warnings:?}");
        assert!(warnings[0].contains(words.trim_end_matches(';')), "{words}: {warnings:?}");
        if name == "extinction" {
            assert_eq!(cloud.extinction.unwrap()[MIDDLE], value);
            check_refusal(read_volume(&path), &path, words);
            continue;
        }
        check_refusal(import(&path, |_| {}), &path, words);
        let allowed = import(&path, |settings| settings.allow_implausible = true).unwrap();
        assert!(allowed.1[0].contains(words.trim_end_matches(';')), "{:?}", allowed.1);
    }
    // The limits themselves, and small droplets in traces of water.
    edited(&path, |file| {
        set_value(file, "lwc", MIDDLE, 20.0);
        set_value(file, "reff", MIDDLE, 60.0);
        set_value(file, "lwc", [0, 0, 0], 1e-6);
        set_value(file, "reff", [0, 0, 0], 0.15);
        set_value(file, "extinction", MIDDLE, 1e4);
    });
    read_cloud(&path).unwrap();
    let volume = Volume::constant(grid(), 1e4);
    io::write_volume(&path, &volume, &provenance()).unwrap();
    assert_eq!(read_volume(&path).unwrap(), volume);
}

/// The file of a cloud with two voxels, at (x 0, y 0, z 1) and (x 2, y 1, z 2).
const LEVELS: &str = "# c\n3,2,3\n0.05,0.05\n0.5,0.54,0.58\n";

#[test]
fn text_clouds_are_read_as_people_save_them() {
    let (_folder, path) = place("cloud.csv");
    let spaces = "3 2 3\n0.05 0.05 0.5 0.54 0.58\n0 0 1 0.25 8\n2 1 2 0.5 10\n";
    let plain = format!("{LEVELS}x,y,z,lwc,reff\n0,0,1,0.25,8\n2,1,2,0.5,10\n");
    for text in [
        plain.clone(),
        format!("\u{feff}{plain}"),
        plain.replace('\n', "\r\n"),
        plain.replace("lwc,reff", "LWC,Reff").replace("x,y,z", "X,Y,Z"),
        plain.replace("0.25,8", "2.5D-01,0.8d+01"),
        plain.replace("0,0,1,", "0.0,0.0,1.0,"),
        format!("{LEVELS}x,y,z,lwc,reff,temp\n0,0,1,0.25,8,280\n2,1,2,0.5,10,\n"),
        format!("{LEVELS}reff,temp,lwc,k,j,i\n8,280,0.25,1,0,0\n10,281,0.5,2,1,2\n"),
        format!("{LEVELS},x,y,z,lwc,reff\n0,0,0,1,0.25,8\n1,2,1,2,0.5,10\n"),
        format!("# c\n{spaces}"),
        format!("a cloud without the sign of a comment\n{spaces}"),
        spaces.to_owned(),
    ] {
        std::fs::write(&path, &text).unwrap();
        let (cloud, warnings) =
            import(&path, |_| {}).unwrap_or_else(|error| panic!("{error}\n{text}"));
        assert!(warnings.is_empty(), "{warnings:?}");
        let droplets = droplets(cloud);
        let mut expected = Array3::zeros((3, 2, 3));
        (expected[[1, 0, 0]], expected[[2, 1, 2]]) = (0.25, 0.5);
        assert_close(&droplets.liquid_water_content, &expected);
        (expected[[1, 0, 0]], expected[[2, 1, 2]]) = (8.0, 10.0);
        assert_close(&droplets.effective_radius, &expected);
        assert!((droplets.effective_variance[[1, 0, 0]] - 0.1).abs() < 1e-7);
    }
}

#[test]
fn ambiguous_text_clouds_are_refused_by_their_line() {
    let (_folder, path) = place("cloud.csv");
    let rows = |names: &str, rows: &str| format!("{LEVELS}{names}\n{rows}\n");
    let names = "x,y,z,lwc,reff";
    for (text, words) in [
        (rows("x,y,z,lwc,reff,veff", "0,0,1,,8,0.1"), "line 6: lacks a number"),
        (rows("x,y,z,lwc,reff,veff", "0,0,1,0.25,8,"), "line 6: lacks a number"),
        (rows(names, "0,0,1,0.25"), "line 6: lacks a number: it has 4 fields"),
        (rows(names, "0,0,1,0.25,8,9"), "line 6: has 6 fields, not 5"),
        (rows(names, "0,0,1,0.25,8\n0,0,1,0.5,8"), "line 7: repeats the voxel of line 6"),
        (rows("x,y,z,lwc,lwc,reff", "0,0,1,0.25,0.5,8"), "line 5: does not name"),
        (rows("x,y,lwc,reff", "0,0,0.25,8"), "line 5: does not name"),
        (rows(names, "1,1,1,0.25,8\n3,2,3,0.5,8"), "line 7: does not start"),
        (rows(names, "1,1,1,0.25,8\n3,2,3,0.5,8"), "they seem to start at 1"),
        (rows(names, "0,0,1.5,0.25,8"), "line 6: does not have whole"),
        (rows(names, "0,0,1,0.25,8e-6"), "the numbers may be in m"),
        (rows(names, "0,0,1,250,8"), "in mg instead of g"),
        ("3 2 3\n0.05 0.05 0.5 0.54 0.58\n0 0 1 0.25 8 0.1 280\n".into(), "5 or 6, not 7"),
        (
            "3 2 3\n0.05 0.05 0.5 0.54 0.58\n0 0 1 0.25 8\n1 0 1 0.25 8 0.1\n".into(),
            "line 4: has 6",
        ),
    ] {
        std::fs::write(&path, &text).unwrap();
        check_refusal(import(&path, |_| {}), &path, words);
    }
    std::fs::write(&path, rows(names, "1,1,1,0.25,8\n2,1,2,0.5,8")).unwrap();
    let (cloud, warnings) = import(&path, |_| {}).unwrap();
    assert_eq!(droplets(cloud).liquid_water_content.slice(s![.., .., 0]).sum(), 0.0);
    assert!(warnings[0].contains("no index is 0"), "{warnings:?}");
}

/// Units in Latin-1 are read, although HDF5 calls them UTF-8.
#[test]
fn a_micro_sign_in_latin_1_is_one() {
    let (_folder, path) = place("cloud.nc");
    edited(&path, |file| set_units(file, "reff", "\u{b5}m"));
    let before = read_cloud(&path).unwrap();
    let mut bytes = std::fs::read(&path).unwrap();
    let sign = bytes.windows(3).position(|part| part == "\u{b5}m".as_bytes()).unwrap();
    bytes[sign] = b' ';
    std::fs::write(&path, &bytes).unwrap();
    assert_eq!(read_cloud(&path).unwrap(), before);
}

/// Without the lists by which variables and their dimensions refer to each other, the axes are found
/// by their lengths.
#[test]
fn dimensions_without_references_are_found_by_their_lengths() {
    let (_folder, path) = place("cloud.nc");
    edited(&path, |_| ());
    let before = read_volume(&path).unwrap();
    edited(&path, |file| {
        file.dataset("extinction").unwrap().delete_attr("DIMENSION_LIST").unwrap();
    });
    assert_eq!(read_volume(&path).unwrap(), before);
}

/// A variable whose standard name has a modifier, or which is described as ice or rain, is not the
/// liquid water, whatever its name.
#[test]
fn names_of_other_water_are_not_the_liquid_water() {
    let name = "mass_concentration_of_cloud_liquid_water_in_air";
    let (_folder, path) = place("other.nc");
    edited(&path, |file| {
        set_text(file, "extinction", "standard_name", &format!("{name} standard_error"));
        set_units(file, "extinction", "g m-3");
        file.relink("extinction", "a_error").unwrap();
    });
    let (cloud, _) = import(&path, |_| {}).unwrap();
    assert_close(&droplets(cloud).liquid_water_content, &water());
    for (attribute, text) in [
        ("standard_name", "mass_fraction_of_cloud_ice_in_air"),
        ("standard_name", "mass_fraction_of_cloud_condensed_water_in_air"),
        ("long_name", "rain water mixing ratio"),
        ("long_name", "cloud ice"),
        ("long_name", "liquid water tendency"),
    ] {
        edited(&path, |file| {
            for name in ["standard_name", "long_name"] {
                let _ = file.dataset("lwc").unwrap().delete_attr(name);
            }
            set_text(file, "lwc", attribute, text);
            file.relink("lwc", "qc").unwrap();
            file.unlink("extinction").unwrap();
        });
        check_refusal(import(&path, |_| {}), &path, "no variable is identified");
    }
}

/// The names that models give to effective radii.
#[test]
fn radii_have_many_names() {
    let (_folder, path) = place("radii.nc");
    for name in ["re_cloud", "RE_CLOUD", "r_eff", "effr", "cloud_effective_radius"] {
        edited(&path, |file| {
            let _ = file.dataset("reff").unwrap().delete_attr("standard_name");
            let _ = file.dataset("reff").unwrap().delete_attr("long_name");
            file.relink("reff", name).unwrap();
        });
        let (cloud, _) = import(&path, |_| {}).unwrap();
        assert_eq!(droplets(cloud).effective_radius[MIDDLE], 8.0, "{name}");
    }
}

/// Lengths, altitudes, numbers and variances far from those of clouds are in another unit.
#[test]
fn implausible_lengths_and_numbers_are_refused() {
    let (_folder, path) = place("metres.txt");
    let text =
        |steps: &str, levels: &str, row: &str| format!("# c\n3 2 3\n{steps} {levels}\n{row}\n");
    let refused = |text: String, words: &str| {
        std::fs::write(&path, text).unwrap();
        check_refusal(import(&path, |_| {}), &path, words);
    };
    let row = "0 0 1 0.25 8";
    refused(text("50 50", "500 540 580", row), "the numbers may be in m");
    refused(text("0.05 0.05", "500 540 580", row), "the numbers may be in m");
    refused(text("5e-5 5e-5", "0.5 0.54 0.58", row), "the numbers may be in km, but stated");
    refused(text("0.05 0.05", "0.5 0.54 0.58", "0 0 1 0.25 8 280"), "effective variance");
    let (_folder, path) = place("kg.nc");
    edited(&path, |file| scale(file, "lwc", 1e-3, "g m-3"));
    check_refusal(import(&path, |_| {}), &path, "the numbers may be in kg instead of g");
    edited(&path, |_| ());
    let number = |settings: &mut ImportSettings| settings.droplets_per_cm3 = Some(4e-4);
    assert!(import(&path, number).unwrap_err().to_string().contains("droplet number"));
}

#[test]
fn what_is_not_read_is_named_and_voxels_have_the_size_of_the_file() {
    let (_folder, path) = place("both.nc");
    edited(&path, |_| {});
    let settings = ImportSettings { spacing: None, ..ImportSettings::default() };
    let (cloud, report) = import_cloud(&path, &settings).unwrap();
    let text = "left out: extinction (--variable extinction imports it in place of liquid water)";
    assert!(report.taken.iter().any(|line| line == text), "{:?}", report.taken);
    assert_eq!(cloud.grid, grid());
    let settings = ImportSettings { variable: Some("extinction".into()), ..settings };
    let (cloud, report) = import_cloud(&path, &settings).unwrap();
    assert!(cloud.microphysics.is_none() && cloud.extinction.is_some());
    assert!(!report.taken.iter().any(|line| line.contains("left out")), "{:?}", report.taken);
}
