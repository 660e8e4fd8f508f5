//! Reading and writing of the file formats of the project.

use crate::{check_refusal, place};
use deepct_core::cloud::{Cloud, Microphysics};
use deepct_core::grid::{Grid, Mask, Volume};
use deepct_core::image::ViewStack;
use deepct_core::io::{self, Provenance};
use deepct_core::math::{DVec3, towards};
use deepct_core::scene::{Observation, Sun, View};
use ndarray::{Array1, Array3, s};
use std::path::Path;

pub(crate) fn provenance() -> Provenance {
    Provenance {
        title: "a test".into(),
        configuration: "samples = 3\n".into(),
        seed: u64::MAX,
        ..Provenance::default()
    }
}

pub(crate) fn grid() -> Grid {
    // Numbers without an exact binary representation, so that rounding of the grid is detected.
    Grid::new(DVec3::new(-0.3, 0.1, 0.48), DVec3::new(0.05, 0.07, 0.04), [3, 4, 5]).unwrap()
}

fn field(scale: f32) -> Array3<f32> {
    Array3::from_shape_fn(grid().shape, |(k, j, i)| scale * (1.0 + (k * 20 + j * 5 + i) as f32))
}

pub(crate) fn observation() -> Observation {
    let target = DVec3::new(0.8, 0.7, 1.1);
    let camera = target + 612.3 * towards(0.7, 2.1);
    let views = vec![
        View::perspective(camera, target, 8.1e-5, [3, 4]).unwrap(),
        View::orthographic(towards(1.1, 4.7), target, 0.05, [5, 7])
            .and_then(|whole| whole.part([1, 3], [3, 4]))
            .unwrap(),
        View::looking_up(towards(2.2, 4.7), target, 0.05, [3, 4]).unwrap(),
    ];
    let values = Array3::from_shape_fn((3, 3, 4), |(v, r, c)| 0.04 * (v * 12 + r * 4 + c) as f32);
    let error = ViewStack::new(values.mapv(|value| 0.01 * value)).unwrap();
    let sun = Sun { irradiance: 1.7, ..Sun::from_degrees(33.3, 217.1).unwrap() };
    let mut observation = Observation::new(sun, views, ViewStack::new(values).unwrap()).unwrap();
    observation.standard_error = Some(error);
    observation.light.wavelength = 0.86;
    observation
}

#[test]
fn a_cloud_is_read_as_it_was_written() {
    let (_folder, path) = place("cloud.nc");
    let droplets = Microphysics {
        liquid_water_content: field(0.01),
        effective_radius: field(1.0),
        effective_variance: field(0.002),
    };
    let mut cloud = Cloud::from_microphysics(grid(), droplets).unwrap();
    io::write_cloud(&path, &cloud, &provenance()).unwrap();
    assert_eq!(io::read_cloud(&path).unwrap(), cloud);
    cloud.extinction = Some(field(1.5));
    io::write_cloud(&path, &cloud, &provenance()).unwrap();
    assert_eq!(io::read_cloud(&path).unwrap(), cloud);
    assert_eq!(io::read_volume(&path).unwrap().values, field(1.5));
    assert_eq!(io::read_grid(&path).unwrap(), grid());
}

#[test]
fn volumes_masks_and_images_are_read_as_they_were_written() {
    let (_folder, path) = place("a.nc");
    let volume = Volume::new(grid(), field(2.0)).unwrap();
    io::write_volume(&path, &volume, &provenance()).unwrap();
    assert_eq!(io::read_volume(&path).unwrap(), volume);
    let mask = Mask::new(grid(), field(1.0).mapv(|value| value as i32 % 3 == 0)).unwrap();
    io::write_mask(&path, &mask, &provenance()).unwrap();
    assert_eq!(io::read_mask(&path).unwrap(), mask);
    io::write_observation(&path, &observation(), &provenance()).unwrap();
    assert_eq!(io::read_observation(&path).unwrap(), observation());
}

#[test]
fn a_single_voxel_keeps_its_size() {
    let (_folder, path) = place("voxel.nc");
    let grid = Grid::new(DVec3::new(0.1, 0.2, 0.3), DVec3::splat(0.07), [1, 1, 1]).unwrap();
    let volume = Volume::constant(grid, 3.0);
    io::write_volume(&path, &volume, &provenance()).unwrap();
    assert_eq!(io::read_volume(&path).unwrap(), volume);
}

#[test]
fn files_record_how_they_were_made_and_are_the_same_each_time() {
    let (folder, path) = place("a.nc");
    let volume = Volume::new(grid(), field(2.0)).unwrap();
    io::write_volume(&path, &volume, &provenance()).unwrap();
    // HDF5 timestamps have a resolution of one second; wait until the next second.
    std::thread::sleep(std::time::Duration::from_millis(1100));
    let again = folder.path().join("b.nc");
    io::write_volume(&again, &volume, &provenance()).unwrap();
    let [first, second] = [&path, &again].map(|path| std::fs::read(path).unwrap());
    assert!(first == second, "the same volume, other bytes");
    let file = hdf5::File::open(&path).unwrap();
    assert_eq!(global_text(&file, "Conventions"), "CF-1.10");
    assert_eq!(global_text(&file, "deepct_version"), env!("CARGO_PKG_VERSION"));
    assert_eq!(global_text(&file, "configuration"), "samples = 3\n");
    // Classic netCDF has no integer of more than 32 bits: larger seeds are written in digits.
    assert_eq!(global_text(&file, "seed"), "18446744073709551615");
    io::write_volume(&path, &volume, &Provenance { seed: 7, ..provenance() }).unwrap();
    let file = hdf5::File::open(&path).unwrap();
    assert_eq!(file.attr("seed").unwrap().read_scalar::<i32>().unwrap(), 7);
    // More than HDF5 stores in the header of a group; and no text at all.
    let long = Provenance {
        title: String::new(),
        configuration: "é".repeat(60_000),
        seed: 7,
        ..Provenance::default()
    };
    io::write_volume(&path, &volume, &long).unwrap();
    assert_eq!(io::read_volume(&path).unwrap(), volume);
    let file = hdf5::File::open(&path).unwrap();
    assert_eq!(file.attr("configuration").unwrap().dtype().unwrap().size(), 120_000);
    assert_eq!(global_text(&file, "title"), "");
}

/// A global attribute, which must be a text of fixed length.
fn global_text(file: &hdf5::File, name: &str) -> String {
    let attribute = file.attr(name).unwrap();
    let kind = attribute.dtype().unwrap().to_descriptor().unwrap();
    assert!(matches!(kind, hdf5::types::TypeDescriptor::FixedUnicode(_)), "{name}: {kind}");
    attribute.read_scalar::<hdf5::types::FixedUnicode<100>>().unwrap().to_string()
}

#[test]
fn coordinates_are_legible_and_the_grid_exact() {
    let (_folder, path) = place("a.nc");
    let write = |grid| {
        io::write_volume(&path, &Volume::constant(grid, 1.0), &provenance()).unwrap();
        assert_eq!(io::read_grid(&path).unwrap(), grid);
        assert_eq!(io::read_volume(&path).unwrap().grid, grid);
        hdf5::File::open(&path).unwrap()
    };
    // 0.64 + 0.04 * 0.5 is 0.6599999999999999 in double precision.
    let file = write(
        Grid::new(DVec3::new(-0.15, 0.1, 0.48), DVec3::new(0.1, 0.07, 0.04), [6, 4, 3]).unwrap(),
    );
    let values = |file: &hdf5::File, name| file.dataset(name).unwrap().read_raw::<f64>().unwrap();
    assert_eq!(values(&file, "z"), [0.5, 0.54, 0.58, 0.62, 0.66, 0.7]);
    assert_eq!(values(&file, "x"), [-0.1, 0.0, 0.1]);
    assert_eq!(values(&file, "x_bnds"), [-0.15, -0.05, -0.05, 0.05, 0.05, 0.15]);
    assert_eq!(values(&file, "z_bnds")[6..10], [0.6, 0.64, 0.64, 0.68]);
    // Voxels of 0.6 m, the edge of which needs more than nine decimals.
    let fine = DVec3::splat(0.002 / 3.3);
    let file = write(Grid::new(DVec3::new(0.0, 0.0, 2.0 / 3.0), fine, [2, 2, 2]).unwrap());
    assert_eq!(values(&file, "z")[0], 0.666_969_697);
}

#[test]
fn dimensions_are_known_after_a_variable_was_deleted() {
    let (_folder, path) = place("a.nc");
    let droplets = Microphysics {
        liquid_water_content: field(0.01),
        effective_radius: field(1.0),
        effective_variance: field(0.002),
    };
    let mut cloud = Cloud::from_microphysics(grid(), droplets).unwrap();
    cloud.extinction = Some(field(1.5));
    io::write_cloud(&path, &cloud, &provenance()).unwrap();
    let file = hdf5::File::open_rw(&path).unwrap();
    for name in ["lwc", "reff", "veff"] {
        file.unlink(name).unwrap();
    }
    // This takes the place of what was deleted.
    set_text(&file, "extinction", "comment", &"text ".repeat(500));
    file.close().unwrap();
    assert_eq!(io::read_volume(&path).unwrap().values, field(1.5));
}

#[test]
fn a_grid_is_read_from_toml() {
    let (_folder, path) = place("grid.toml");
    let text =
        "origin_km = [-0.3, 0.1, 0.48]\nspacing_km = [0.05, 0.07, 0.04]\nshape = [3, 4, 5]\n";
    std::fs::write(&path, text).unwrap();
    assert_eq!(io::read_grid(&path).unwrap(), grid());
    for (wrong, names) in [
        (text.replace("shape", "shap"), "shap"),
        (text.replace("0.05", "-0.05"), "spacing"),
        (text.replace("[3, 4, 5]", "[3, 4]"), "length"),
        (format!("{text}colour = 1\n"), "colour"),
    ] {
        std::fs::write(&path, wrong).unwrap();
        check_refusal(io::read_grid(&path), &path, names);
    }
}

/// Writes a valid volume and modifies the file with `spoil`.
fn spoiled(path: &Path, spoil: impl FnOnce(&hdf5::File)) {
    io::write_volume(path, &Volume::new(grid(), field(2.0)).unwrap(), &provenance()).unwrap();
    let file = hdf5::File::open_rw(path).unwrap();
    spoil(&file);
    file.close().unwrap();
}

/// Replaces a variable by one with other values, the same units and without dimension scales.
fn replace<T: hdf5::H5Type + Clone>(file: &hdf5::File, name: &str, values: ndarray::ArrayD<T>) {
    file.unlink(name).unwrap();
    file.new_dataset_builder().with_data(values.view()).create(name).unwrap();
    set_units(file, name, if name == "extinction" { "km-1" } else { "km" });
}

/// Sets the units of a variable.
pub(crate) fn set_units(file: &hdf5::File, name: &str, units: &str) {
    set_text(file, name, "units", units);
}

/// Sets a text attribute of a variable.
pub(crate) fn set_text(file: &hdf5::File, name: &str, attribute: &str, text: &str) {
    let variable = file.dataset(name).unwrap();
    let _ = variable.delete_attr(attribute);
    let text: hdf5::types::VarLenUnicode = text.parse().unwrap();
    let created = variable.new_attr::<hdf5::types::VarLenUnicode>().create(attribute);
    created.unwrap().write_scalar(&text).unwrap();
}

#[test]
fn a_missing_file_is_refused() {
    let (_folder, path) = place("none.nc");
    check_refusal(io::read_volume(&path), &path, "does not exist");
    check_refusal(io::read_observation(&path), &path, "does not exist");
}

#[test]
fn files_of_other_formats_are_refused() {
    let (_folder, path) = place("other.nc");
    for (bytes, names) in [
        (&b""[..], "not an HDF5"),
        (b"hello, this is text and no more than text", "not an HDF5"),
        (b"CDF\x01\0\0\0\0\0\0\0\0", "its header cannot be read"),
    ] {
        std::fs::write(&path, bytes).unwrap();
        check_refusal(io::read_volume(&path), &path, names);
    }
}

#[test]
fn a_truncated_file_is_refused() {
    let (_folder, path) = place("cut.nc");
    spoiled(&path, |_| {});
    let bytes = std::fs::read(&path).unwrap();
    for length in [60, 500, bytes.len() / 2, bytes.len() - 1] {
        std::fs::write(&path, &bytes[..length]).unwrap();
        check_refusal(io::read_volume(&path), &path, "truncated");
    }
}

#[test]
fn a_changed_value_is_found_by_its_checksum() {
    let (_folder, path) = place("flipped.nc");
    spoiled(&path, |_| {});
    let bytes = std::fs::read(&path).unwrap();
    let file = hdf5::File::open(&path).unwrap();
    let chunk = file.dataset("extinction").unwrap().chunk_info(0).unwrap();
    file.close().unwrap();
    let mut flipped = bytes;
    flipped[chunk.addr as usize + 40] ^= 1;
    std::fs::write(&path, flipped).unwrap();
    check_refusal(io::read_volume(&path), &path, "cannot be read");
}

#[test]
fn a_missing_variable_is_refused() {
    let (_folder, path) = place("volume.nc");
    spoiled(&path, |_| {});
    check_refusal(io::read_mask(&path), &path, "mask");
    check_refusal(io::read_observation(&path), &path, "radiance");
    spoiled(&path, |file| file.unlink("x").unwrap());
    check_refusal(io::read_volume(&path), &path, "x: is missing");
}

#[test]
fn wrong_dimensions_are_refused() {
    let (_folder, path) = place("volume.nc");
    spoiled(&path, |file| {
        replace(file, "extinction", Array1::<f32>::zeros(60).into_dyn());
    });
    check_refusal(io::read_volume(&path), &path, "dimensions");
    check_refusal(io::read_cloud(&path), &path, "dimensions");
    spoiled(&path, |file| {
        replace(file, "extinction", Array3::<f32>::zeros((5, 4, 3)).into_dyn());
    });
    check_refusal(io::read_volume(&path), &path, "one coordinate per voxel");
    check_refusal(io::read_cloud(&path), &path, "one coordinate per voxel");
}

/// The dimensions of a variable have names, so that their order does not matter.
#[test]
fn dimensions_may_be_in_any_order() {
    let (_folder, path) = place("volume.nc");
    let cube = Grid::new(DVec3::ZERO, DVec3::ONE, [2, 2, 2]).unwrap();
    let values = Array3::from_shape_fn(cube.shape, |(k, j, i)| (4 * k + 2 * j + i) as f32);
    let volume = Volume::new(cube, values.clone()).unwrap();
    io::write_volume(&path, &volume, &provenance()).unwrap();
    let file = hdf5::File::open_rw(&path).unwrap();
    for (from, to) in [("z", "t"), ("y", "z"), ("t", "y")] {
        file.relink(from, to).unwrap();
    }
    file.close().unwrap();
    let exchanged = values.permuted_axes([1, 0, 2]);
    assert_eq!(io::read_volume(&path).unwrap().values, exchanged);
}

/// Removes variables of a file of images.
fn without(path: &Path, observation: &Observation, names: &[&str]) {
    io::write_observation(path, observation, &provenance()).unwrap();
    let file = hdf5::File::open_rw(path).unwrap();
    names.iter().for_each(|name| file.unlink(name).unwrap());
    file.close().unwrap();
}

fn part(observation: &Observation, view: usize) -> Observation {
    let images = observation.images.values.slice(ndarray::s![view..=view, .., ..]).to_owned();
    let views = vec![observation.views[view].clone()];
    Observation::new(observation.light.clone(), views, ViewStack::new(images).unwrap()).unwrap()
}

/// A camera is given by its position or its direction, and the rest follows.
#[test]
fn what_follows_from_other_variables_may_be_missing() {
    let (_folder, path) = place("images.nc");
    let perspective = part(&observation(), 0);
    let informative = ["projection", "camera_direction", "view_zenith_deg", "view_azimuth_deg"];
    without(&path, &perspective, &[&informative[..], &["pixel_km"]].concat());
    let (found, derived) = io::read_derived_observation(&path).unwrap();
    assert_eq!((found, derived.len()), (perspective.clone(), 1));
    assert!(derived[0].contains("perspective"), "{derived:?}");
    without(&path, &perspective, &[&informative[..], &["pixel_tangent"]].concat());
    let (found, derived) = io::read_derived_observation(&path).unwrap();
    assert!((found.views[0].pixel_km() / perspective.views[0].pixel_km() - 1.0).abs() < 1e-12);
    assert!(derived[1].contains("pixel_tangent"), "{derived:?}");
    for (view, word) in [(1, "orthographic"), (2, "looking up")] {
        let parallel = part(&observation(), view);
        let informative = ["projection", "camera_direction", "camera_position", "pixel_tangent"];
        without(&path, &parallel, &informative);
        let (found, derived) = io::read_derived_observation(&path).unwrap();
        assert!(derived[0].contains(word), "{derived:?}");
        let (found, expected) = (&found.views[0], &parallel.views[0]);
        assert!(found.towards().distance(expected.towards()) < 1e-12);
        assert_eq!((found.pixel_km(), found.shift), (expected.pixel_km(), expected.shift));
        assert_eq!(found.looks_up(), view == 2);
    }
    for (view, name) in [
        (0, "target"),
        (0, "camera_position"),
        (1, "target"),
        (1, "pixel_km"),
        (1, "view_zenith_deg"),
    ] {
        let names =
            if name == "view_zenith_deg" { vec![name, "camera_direction"] } else { vec![name] };
        without(&path, &part(&observation(), view), &names);
        check_refusal(io::read_observation(&path), &path, name);
    }
    without(&path, &perspective, &["pixel_km", "pixel_tangent"]);
    check_refusal(io::read_observation(&path), &path, "pixel_tangent");
    // Radiances in sr-1 are those for a solar irradiance of 1.
    let mut unit = perspective;
    unit.light.sun.irradiance = 1.0;
    without(&path, &unit, &["sun_irradiance"]);
    assert_eq!(io::read_observation(&path).unwrap(), unit);
}

/// What is stated twice must agree, and the message names both variables.
#[test]
fn contradictory_cameras_are_refused() {
    let (_folder, path) = place("images.nc");
    let check = |view: usize, name: &str, factor: f64, names: [&str; 2]| {
        io::write_observation(&path, &part(&observation(), view), &provenance()).unwrap();
        let file = hdf5::File::open_rw(&path).unwrap();
        let dataset = file.dataset(name).unwrap();
        let values: ndarray::ArrayD<f64> = factor * dataset.read_dyn::<f64>().unwrap();
        dataset.write(values.view()).unwrap();
        drop(dataset);
        file.close().unwrap();
        for name in names {
            check_refusal(io::read_observation(&path), &path, name);
        }
    };
    check(0, "camera_direction", -1.0, ["camera_direction", "camera_position"]);
    check(0, "pixel_km", 1.1, ["pixel_km", "pixel_tangent"]);
    check(0, "view_zenith_deg", 1.1, ["view_zenith_deg", "camera_position"]);
    check(1, "view_azimuth_deg", 1.1, ["view_azimuth_deg", "camera_direction"]);
}

#[test]
fn wrong_types_are_refused() {
    let (_folder, path) = place("volume.nc");
    spoiled(&path, |file| {
        replace(file, "extinction", Array3::<i32>::zeros(grid().shape).into_dyn());
    });
    check_refusal(io::read_volume(&path), &path, "real numbers");
    spoiled(&path, |file| replace(file, "x", Array1::<bool>::default(5).into_dyn()));
    check_refusal(io::read_volume(&path), &path, "real numbers");
    spoiled(&path, |file| file.relink("extinction", "mask").unwrap());
    check_refusal(io::read_mask(&path), &path, "a mask is 1 inside and 0 outside");
}

#[test]
fn values_out_of_range_are_refused() {
    let (_folder, path) = place("volume.nc");
    for value in [f32::NAN, f32::INFINITY, -1.0] {
        let mut values = field(2.0);
        values[[1, 2, 3]] = value;
        spoiled(&path, |file| replace(file, "extinction", values.clone().into_dyn()));
        check_refusal(io::read_volume(&path), &path, "[z 1, y 2, x 3]");
        check_refusal(io::read_cloud(&path), &path, "extinction");
    }
    let mut mask = Array3::<u8>::zeros(grid().shape);
    mask[[0, 1, 2]] = 7;
    spoiled(&path, |file| {
        file.new_dataset_builder().with_data(mask.view()).create("mask").unwrap();
    });
    check_refusal(io::read_mask(&path), &path, "holds 7");
}

#[test]
fn coordinates_that_are_not_uniform_are_refused() {
    let (_folder, path) = place("volume.nc");
    for (x, names) in [
        ([0.0, 1.0, 2.0, 3.0, 5.0], "not uniform"),
        ([0.0, 1.0, f64::NAN, 3.0, 4.0], "not uniform"),
        ([4.0, 3.0, 2.0, 1.0, 0.0], "descends"),
        ([1.0, 1.0, 1.0, 1.0, 1.0], "descends"),
        ([0.0, 1.0, 2.0, 3.0, 4.0], "units"),
    ] {
        spoiled(&path, |file| {
            replace(file, "x", Array1::from(x.to_vec()).into_dyn());
            if names == "units" {
                file.dataset("x").unwrap().delete_attr("units").unwrap();
            }
        });
        check_refusal(io::read_volume(&path), &path, names);
    }
}

#[test]
fn a_declared_size_beyond_the_limit_is_refused() {
    let (_folder, path) = place("bomb.nc");
    spoiled(&path, |file| {
        file.unlink("extinction").unwrap();
        let huge = file.new_dataset::<f32>().chunk((1, 1, 1000)).shape((10_000, 10_000, 10_000));
        huge.create("extinction").unwrap();
        set_units(file, "extinction", "km-1");
    });
    check_refusal(io::read_volume(&path), &path, "declares shape [10000, 10000, 10000]");
}

#[test]
fn packed_numbers_are_understood() {
    let (_folder, path) = place("packed.nc");
    let values = Array3::from_shape_fn(grid().shape, |(k, j, i)| (k * 20 + j * 5 + i) as i16);
    spoiled(&path, |file| {
        replace(file, "extinction", values.clone().into_dyn());
        let variable = file.dataset("extinction").unwrap();
        for (name, value) in [("scale_factor", 0.25_f32), ("add_offset", 1.5)] {
            variable.new_attr::<f32>().create(name).unwrap().write_scalar(&value).unwrap();
        }
        variable.new_attr::<i16>().create("_FillValue").unwrap().write_scalar(&-9_i16).unwrap();
    });
    let volume = io::read_volume(&path).unwrap();
    assert_eq!(volume.values, values.mapv(|value| 0.25 * f32::from(value) + 1.5));
    let mut missing = values;
    missing[[0, 0, 0]] = -9;
    let file = hdf5::File::open_rw(&path).unwrap();
    file.dataset("extinction").unwrap().write(missing.view()).unwrap();
    file.close().unwrap();
    check_refusal(io::read_volume(&path), &path, "NaN");
}

#[test]
fn angles_that_do_not_fit_the_camera_are_refused() {
    let (_folder, path) = place("images.nc");
    io::write_observation(&path, &observation(), &provenance()).unwrap();
    let file = hdf5::File::open_rw(&path).unwrap();
    let angles = Array1::from(vec![10.0, 20.0, 30.0]);
    file.dataset("view_zenith_deg").unwrap().write(angles.view()).unwrap();
    file.close().unwrap();
    check_refusal(io::read_observation(&path), &path, "view_zenith_deg");
}

#[test]
fn a_folder_that_does_not_exist_leaves_nothing_behind() {
    let (folder, path) = place("no/such/folder/a.nc");
    let volume = Volume::constant(grid(), 1.0);
    assert!(io::write_volume(&path, &volume, &provenance()).is_err());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

/// Radiances in another unit than sr-1 need the solar irradiance in that unit.
#[test]
fn radiances_have_the_unit_of_the_irradiance() {
    let (_folder, path) = place("images.nc");
    io::write_observation(&path, &observation(), &provenance()).unwrap();
    let set = |variable: &str, unit: &str| {
        let file = hdf5::File::open_rw(&path).unwrap();
        let dataset = file.dataset(variable).unwrap();
        let _ = dataset.delete_attr("units");
        let text: hdf5::types::VarLenUnicode = unit.parse().unwrap();
        let attribute = dataset.new_attr::<hdf5::types::VarLenUnicode>().create("units").unwrap();
        attribute.write_scalar(&text).unwrap();
    };
    // Without units the layout states them.
    let file = hdf5::File::open_rw(&path).unwrap();
    file.dataset("radiance").unwrap().delete_attr("units").unwrap();
    drop(file);
    assert_eq!(io::read_observation(&path).unwrap(), observation());
    for name in ["radiance", "radiance_standard_error"] {
        set(name, "W m-2 um-1 sr-1");
    }
    let problem = io::read_observation(&path).unwrap_err().to_string();
    assert!(problem.contains("radiance") && problem.contains("sr-1"), "{problem}");
    set("sun_irradiance", "W m-2 um-1");
    assert_eq!(io::read_observation(&path).unwrap(), observation());
    set("sun_irradiance", "mW m-2 nm-1");
    assert!(io::read_observation(&path).is_err());
}

/// Parts of the images in a file are those of the whole images, also where the file begins in the north or
/// holds a part of larger images.
#[test]
fn images_are_read_in_parts() {
    let (_folder, path) = place("images.nc");
    let whole = observation();
    io::write_observation(&path, &whole, &provenance()).unwrap();
    let check = |expected: &Observation| {
        let mut file = io::ImagesFile::open(&path).unwrap();
        for (rows, cols) in [(0..3, 0..4), (1..3, 2..3), (0..1, 3..4)] {
            let part = file.part(rows.clone(), cols.clone()).unwrap();
            let slice = s![.., rows.clone(), cols.clone()];
            assert_eq!(part.images.values, expected.images.values.slice(slice));
            let errors =
                [&part, expected].map(|seen| &seen.standard_error.as_ref().unwrap().values);
            assert_eq!(errors[0], errors[1].slice(slice));
            for (view, whole) in part.views.iter().zip(&expected.views) {
                let (first, size) = ([rows.start, cols.start], [rows.len(), cols.len()]);
                assert_eq!(*view, whole.part(first, size).unwrap());
            }
        }
        assert!(file.part(1..4, 0..1).is_err() && file.part(1..1, 0..1).is_err());
    };
    check(&whole);
    let file = hdf5::File::open_rw(&path).unwrap();
    let rows: Vec<f64> = file.dataset("row").unwrap().read_raw().unwrap();
    let northern: Vec<f64> = rows.into_iter().rev().collect();
    file.dataset("row").unwrap().write_raw(&northern).unwrap();
    file.close().unwrap();
    let reversed = io::read_observation(&path).unwrap();
    assert_ne!(reversed.images, whole.images);
    check(&reversed);
}
