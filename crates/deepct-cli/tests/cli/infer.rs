use crate::program::Program;
use deepct_core::cloud::Cloud;
use deepct_core::grid::{Grid, Mask, Volume};
use deepct_core::image::ViewStack;
use deepct_core::inversion::network_estimate;
use deepct_core::io::{
    Provenance, load_trained_weights, read_estimate, read_mask, read_volume, write_mask,
    write_observation, write_sample, write_weights,
};
use deepct_core::math::{DVec3, towards};
use deepct_core::network::{
    Architecture, Estimator, FORMAT_VERSION, ImageLayout, LayerWeights, Levels, Network,
    NetworkOutput, Planes, TrainedWeights, Training, Weights, WeightsMetadata,
};
use deepct_core::scene::{Formation, Observation, Sun, View};
use ndarray::{Array1, Array3, Array4, Axis, concatenate};
use std::collections::BTreeMap;

const TARGET: DVec3 = DVec3::new(0.4, 0.3, 1.0);

fn provenance() -> Provenance {
    Provenance {
        title: "A test".into(),
        configuration: String::new(),
        seed: 0,
        ..Provenance::default()
    }
}

/// Images with a bright rectangle in every view.
fn observation() -> Observation {
    let views = Formation::cloudct_10().views(TARGET, [9, 12]).unwrap();
    let radiance = Array3::from_shape_fn((10, 9, 12), |(view, row, col)| {
        let bright = (3..6).contains(&row) && (4..8).contains(&col);
        if bright { 0.2 + 0.001 * view as f32 } else { 0.01 }
    });
    Observation::new(Sun::default(), views, ViewStack::new(radiance).unwrap()).unwrap()
}

/// Weights for the formation of these images, with two layers and six levels around the target.
fn weights(observation: &Observation, image_layout: ImageLayout) -> Weights {
    let planes = match &image_layout {
        ImageLayout::Planes(planes) => planes.altitudes_km.len(),
        _ => 1,
    };
    let architecture = Architecture { channels: vec![10 * planes, 8, 6], last_relu: true };
    let layers = architecture.layer_channels().map(|(input, output)| LayerWeights {
        weight: Array4::from_shape_fn((output, input, 3, 3), |(o, i, y, x)| {
            ((7 * o + 5 * i + 3 * y + x) % 13) as f32 / 60.0 - 0.05
        }),
        bias: Array1::from_elem(output, 0.1),
    });
    let layers = layers.collect();
    let metadata = WeightsMetadata {
        format_version: FORMAT_VERSION,
        formation: "cloudct-10".into(),
        architecture,
        view_geometry: observation.geometry(),
        target_altitude_km: TARGET.z,
        wavelengths_um: vec![observation.light.wavelength],
        image_layout,
        horizontal_spacing_km: [0.05, 0.05],
        levels: Levels { bottom_km: 0.88, count: 6, spacing_km: 0.04 },
        outputs: vec![NetworkOutput::Extinction],
        input_scale: 5.0,
        output_scale: 20.0,
        effective_radius_scale: None,
        training: Training {
            data: "squares".into(),
            identity: "c0ffee".into(),
            samples: 12,
            seed: 1,
        },
        scores: BTreeMap::from([("epsilon".into(), 0.25)]),
        program: "a test".into(),
        configuration: serde_json::Value::Null,
    };
    Weights::new(metadata, layers).unwrap()
}

/// Writes the images and the weights to files.
fn files(program: &Program) -> (Observation, Weights) {
    let observation = observation();
    let weights = weights(&observation, ImageLayout::Camera);
    write_observation(program.path("N.nc"), &observation, &provenance()).unwrap();
    write_weights(program.path("W.safetensors"), &weights).unwrap();
    (observation, weights)
}

#[test]
fn the_answer_is_that_of_the_library() {
    let program = Program::new();
    let (observation, weights) = files(&program);
    program.succeed("infer N.nc --weights W.safetensors --out V.nc");
    let volume = read_volume(program.path("V.nc")).unwrap();
    let network = Network::new(&weights).unwrap();
    let expected =
        network.infer(&observation.images, &observation.imaging_geometry().unwrap()).unwrap();
    assert!(volume.grid.matches(&expected.grid));
    assert_eq!(volume.values, expected.values);
    assert!(volume.values.iter().any(|value| *value > 0.0));
    assert!((volume.grid.center() - TARGET).length() < 1e-9);
}

#[test]
fn images_are_laid_on_the_planes_of_the_weights() {
    let program = Program::new();
    let (observation, camera) = files(&program);
    let planes = ImageLayout::Planes(Planes { altitudes_km: vec![0.94, 1.06], extremes: false });
    let mut weights = weights(&observation, planes);
    write_weights(program.path("P.safetensors"), &weights).unwrap();
    let text = program.succeed("weights inspect P.safetensors");
    assert!(text.contains("images           resampled onto 2 planes at 0.94 1.06 km"), "{text}");
    program.succeed("infer N.nc --weights P.safetensors --out V.nc");
    let volume = read_volume(program.path("V.nc")).unwrap();
    let infer = |weights: &Weights| {
        let network = Network::new(weights).unwrap();
        network.infer(&observation.images, &observation.imaging_geometry().unwrap()).unwrap()
    };
    assert_eq!(volume, infer(&weights));
    assert!(volume.values != infer(&camera).values);

    weights.metadata.view_geometry.camera_distance_km[2] = None;
    write_weights(program.path("parallel.safetensors"), &weights).unwrap();
    program.refuse(
        "infer N.nc --weights parallel.safetensors --out V.nc",
        &["N.nc", "view 2: distance of the camera", "parallel rays"],
    );
}

#[test]
fn an_uncertainty_is_written_beside_the_extinction() {
    let program = Program::new();
    let (observation, mut weights) = files(&program);
    weights.metadata.outputs.push(NetworkOutput::Uncertainty);
    weights.metadata.levels.count = 3;
    write_weights(program.path("U.safetensors"), &weights).unwrap();
    let text = program.succeed("infer N.nc --weights U.safetensors --out V.nc");
    let network = Network::new(&weights).unwrap();
    let expected =
        network.estimate(&observation.images, &observation.imaging_geometry().unwrap()).unwrap();
    let written = read_estimate(program.path("V.nc")).unwrap();
    assert_eq!(written.extinction.values, expected.extinction.values);
    let uncertainty = written.uncertainty.unwrap().values;
    assert_eq!(uncertainty, expected.uncertainty.unwrap().values);
    let share = uncertainty.sum() / written.extinction.values.sum();
    assert!(text.contains(&format!("epsilon  {share:.3} expected")), "{text}");

    program.succeed("infer N.nc --weights U.safetensors --carve --out carved.nc");
    let text = program.succeed("weights inspect U.safetensors");
    assert!(text.contains("output           extinction and uncertainty (km-1) / 20"), "{text}");
    program.succeed("carve N.nc --grid carved.nc --out C.nc");
    let mask = read_mask(program.path("C.nc")).unwrap();
    let carved = read_estimate(program.path("carved.nc")).unwrap().uncertainty.unwrap();
    for (voxel, carved) in carved.values.indexed_iter() {
        assert_eq!(*carved, if mask.values[voxel] { uncertainty[voxel] } else { 0.0 });
    }
}

/// Weights for two bands that also estimate the effective radius, and the files of the bands: darker
/// images at 2.13 um.
fn files_of_two_bands(program: &Program) -> (Vec<Observation>, Weights) {
    let visible = observation();
    let mut infrared = visible.clone();
    infrared.light.wavelength = 2.13;
    infrared.images.values.mapv_inplace(|radiance| 0.7 * radiance);
    let mut weights = weights(&visible, ImageLayout::Camera);
    let first = &mut weights.layers[0].weight;
    let both = concatenate(Axis(1), &[first.view(), (-0.5 * &*first).view()]).unwrap();
    *first = both.as_standard_layout().into_owned();
    let metadata = &mut weights.metadata;
    metadata.architecture.channels[0] = 20;
    metadata.wavelengths_um = vec![0.672, 2.13];
    metadata.outputs.push(NetworkOutput::EffectiveRadius);
    metadata.levels.count = 3;
    metadata.effective_radius_scale = Some(4.0);
    write_weights(program.path("B.safetensors"), &weights).unwrap();
    let bands = vec![visible, infrared];
    for (name, band) in ["A.nc", "I.nc"].into_iter().zip(&bands) {
        write_observation(program.path(name), band, &provenance()).unwrap();
    }
    (bands, weights)
}

#[test]
fn an_effective_radius_comes_from_two_bands() {
    let program = Program::new();
    let (bands, weights) = files_of_two_bands(&program);
    let text = program.succeed("weights inspect B.safetensors");
    assert!(text.contains("at 0.672 and 2.13 um"), "{text}");
    assert!(text.contains("effective_radius (um) / 4"), "{text}");
    let text = program.succeed("infer A.nc I.nc --weights B.safetensors --out V.nc");
    let estimator = Estimator::new(TrainedWeights::Formation(weights));
    let expected = network_estimate(&estimator, &bands, None).unwrap();
    let written = read_estimate(program.path("V.nc")).unwrap();
    assert_eq!(written, expected);
    let radius = &written.effective_radius.as_ref().unwrap().values;
    assert!(radius.iter().all(|&radius| radius == 0.0 || (1.0..=25.0).contains(&radius)));
    assert!(radius.iter().any(|radius| *radius > 1.0));
    let mean = written.mean_effective_radius().unwrap();
    assert!(text.contains(&format!("radius   {mean:.2} um")), "{text}");

    // The same in one file.
    let cloud = Cloud::from_extinction(written.extinction.clone()).unwrap();
    write_sample(program.path("both.nc"), &cloud, &bands, &provenance()).unwrap();
    program.succeed("infer both.nc --weights B.safetensors --out both_found.nc");
    assert_eq!(read_estimate(program.path("both_found.nc")).unwrap(), written);
    program.succeed("infer both.nc --weights B.safetensors --out-dir found --json");
    assert_eq!(read_estimate(program.path("found/both.nc")).unwrap(), written);

    let expected = "number of bands: expected 2 (0.672 and 2.13 um), found 1 (0.672 um)";
    let command = "infer A.nc --weights B.safetensors --out W.nc";
    program.refuse(command, &["A.nc", expected, "at 0.672 and 2.13 um, in this order"]);
    let command = "infer I.nc A.nc --weights B.safetensors --out W.nc";
    program.refuse(command, &["wavelength of band 0: expected 0.6720 um, found 2.1300 um"]);
    files(&program);
    program.refuse(
        "infer A.nc I.nc --weights W.safetensors --out W.nc",
        &["number of bands: expected 1 (0.672 um), found 2 (0.672 and 2.13 um)"],
    );
    program.refuse("infer A.nc I.nc --out W.nc", &["number of bands: expected 1, found 2"]);
    program.refuse("carve both.nc --grid V.nc --out C.nc", &["wavelength", "has 2 values"]);
}

#[test]
fn a_mask_clears_what_is_outside() {
    let program = Program::new();
    let (observation, weights) = files(&program);
    let network = Network::new(&weights).unwrap();
    let whole =
        network.infer(&observation.images, &observation.imaging_geometry().unwrap()).unwrap();
    let inside = Array3::from_shape_fn(whole.grid.shape, |(k, j, i)| (k + j + i) % 2 == 0);
    let mask = Mask::new(whole.grid, inside).unwrap();
    write_mask(program.path("M.nc"), &mask, &provenance()).unwrap();
    program.succeed("infer N.nc --weights W.safetensors --mask M.nc --out masked.nc");
    let masked = read_volume(program.path("masked.nc")).unwrap();
    for ((voxel, masked), whole) in masked.values.indexed_iter().zip(&whole.values) {
        assert_eq!(*masked, if mask.values[voxel] { *whole } else { 0.0 });
    }

    program.succeed("infer N.nc --weights W.safetensors --carve --out carved.nc");
    program.succeed("carve N.nc --grid carved.nc --out C.nc");
    program.succeed("infer N.nc --weights W.safetensors --mask C.nc --out same.nc");
    let [carved, same] = ["carved.nc", "same.nc"].map(|n| read_volume(program.path(n)).unwrap());
    assert_eq!(carved.values, same.values);
    assert!(carved.values != whole.values && carved.values.iter().any(|value| *value > 0.0));

    let elsewhere = Grid { origin: whole.grid.origin + DVec3::X, ..whole.grid };
    let mask = Mask::new(elsewhere, mask.values).unwrap();
    write_mask(program.path("far.nc"), &mask, &provenance()).unwrap();
    let line = "infer N.nc --weights W.safetensors --mask far.nc --out V.nc";
    program.refuse(line, &["far.nc", "grid of the mask"]);
    let line = "infer N.nc --weights W.safetensors --mask C.nc --carve --out V.nc";
    assert_eq!(program.run(line).code, 2);
}

/// Images of a formation, Sun and size that no fixed network was trained for: they need neither
/// weights nor grid, and any grid can be requested.
#[test]
fn any_formation_needs_no_weights() {
    let program = Program::new();
    let size = [20, 26];
    let views =
        [(0.0, 0.0), (30.0, 80.0), (45.0, 200.0), (55.0, 310.0)].map(|(zenith, azimuth)| {
            let towards = towards(f64::to_radians(zenith), f64::to_radians(azimuth));
            View::perspective(TARGET + 500.0 * towards, TARGET, 8e-5, size).unwrap()
        });
    let radiance = Array3::from_shape_fn((4, 20, 26), |(_, row, col)| {
        let bright = (8..13).contains(&row) && (10..16).contains(&col);
        if bright { 0.2 } else { 0.02 }
    });
    let images = ViewStack::new(radiance).unwrap();
    let sun = Sun::from_degrees(52.0, 250.0).unwrap();
    let observation = Observation::new(sun, views.to_vec(), images).unwrap();
    write_observation(program.path("N.nc"), &observation, &provenance()).unwrap();
    let text = program.succeed("infer N.nc --carve --out V.nc");
    assert!(text.contains("32 levels of 20 x 26 columns"), "{text}");
    let estimate = read_estimate(program.path("V.nc")).unwrap();
    let grid = estimate.extinction.grid;
    assert!((grid.center() - TARGET).length() < 1e-9);
    assert!((grid.spacing - DVec3::new(0.04, 0.04, 0.032)).length() < 1e-9);
    assert!(estimate.extinction.values.iter().any(|value| *value > 1.0));
    assert!(estimate.uncertainty.is_some());

    let toml = "shape = [10, 12, 9]\nspacing_km = [0.06, 0.06, 0.1]\norigin_km = [0.1, 0.0, 0.5]\n";
    std::fs::write(program.path("grid.toml"), toml).unwrap();
    program.succeed("infer N.nc --grid grid.toml --out G.nc");
    assert_eq!(read_volume(program.path("G.nc")).unwrap().grid.shape, [10, 12, 9]);

    let low = Observation { light: Sun::from_degrees(78.0, 0.0).unwrap().into(), ..observation };
    write_observation(program.path("low.nc"), &low, &provenance()).unwrap();
    program.refuse(
        "infer low.nc --out L.nc",
        &["low.nc", "solar zenith angle", "78.00", "0 to 70 degrees", "--force"],
    );
    program.succeed("infer low.nc --force --out L.nc");
    let text = program.succeed("weights inspect general");
    assert!(text.contains("formation        any, 3 to 40 views"), "{text}");
    assert!(text.contains("7, 6"), "{text}");
}

#[test]
fn images_that_do_not_match_the_weights_are_refused() {
    let program = Program::new();
    let (_, weights) = files(&program);
    let mut changed = weights.clone();
    changed.metadata.view_geometry.sun_zenith_deg = 40.0;
    write_weights(program.path("sun.safetensors"), &changed).unwrap();
    program.refuse(
        "infer N.nc --weights sun.safetensors --out V.nc",
        &["N.nc", "solar zenith", "40.00", "30.00", "cloudct-10"],
    );
    let mut changed = weights;
    changed.metadata.view_geometry.view_zenith_deg[3] = 20.0;
    write_weights(program.path("view.safetensors"), &changed).unwrap();
    program.refuse(
        "infer N.nc --weights view.safetensors --out V.nc",
        &["N.nc", "view 3: zenith", "20.00", "18.00"],
    );
}

#[test]
fn weights_that_cannot_be_used_are_refused() {
    let program = Program::new();
    files(&program);
    let whole = std::fs::read(program.path("W.safetensors")).unwrap();
    std::fs::write(program.path("cut.safetensors"), &whole[..whole.len() - 4]).unwrap();
    // The name of one tensor is changed in place, so that a tensor is missing.
    let name = whole.windows(13).position(|at| at == b"layers.1.bias").unwrap();
    let mut renamed = whole;
    renamed[name + 7] = b'7';
    std::fs::write(program.path("renamed.safetensors"), renamed).unwrap();
    for (weights, words) in [
        ("cut.safetensors", ["cut.safetensors", "damaged"]),
        ("renamed.safetensors", ["layers.1.bias", "missing"]),
        ("N.nc", ["N.nc", "not safetensors"]),
        ("none", ["none", "no such file"]),
    ] {
        program.refuse(&format!("infer N.nc --weights {weights} --out V.nc"), &words);
        program.refuse(&format!("weights inspect {weights}"), &words);
    }
}

#[test]
fn inspection_tells_what_weights_are_for() {
    let program = Program::new();
    files(&program);
    let text = program.succeed("weights inspect W.safetensors");
    for words in [
        "cloudct-10, 10 views",
        "images           in camera geometry",
        "2, 1166 parameters",
        "10 8 6",
        "epsilon          0.25",
    ] {
        assert!(text.contains(words), "no \"{words}\" in: {text}");
    }
    let json = program.succeed("weights inspect W.safetensors --json");
    let report: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(report["receptive_field"], 5);
    assert_eq!(report["levels"]["count"], 6);
    assert_eq!(report["view_geometry"]["view_zenith_deg"].as_array().unwrap().len(), 10);
}

#[test]
fn many_files_are_processed_by_one_command() {
    let program = Program::new();
    program.succeed("cloud generate --seed 5 --set shape=[8,12,14] --set width_km=0.3 --set depth_km=0.16 --out C.nc");
    program.succeed("render C.nc --views cloudct-10 --samples 2 --out I.nc");
    program.succeed("render C.nc --views cloudct-10 --samples 2 --seed 2 --out J.nc");
    program.succeed("infer I.nc --grid C.nc --carve --out V.nc");
    program.succeed("carve J.nc --grid C.nc --out M.nc");
    let lines = program.succeed("infer I.nc J.nc --grid C.nc --carve --out-dir many");
    assert_eq!(lines.lines().count(), 2, "{lines}");
    assert!(lines.contains("many/I.nc  largest"), "{lines}");
    let [alone, among] = ["V.nc", "many/I.nc"].map(|name| read_volume(program.path(name)).unwrap());
    assert_eq!(alone, among);

    let json = program.succeed("carve I.nc J.nc --grid C.nc --out-dir many --json");
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json.as_array().unwrap().len(), 2);
    assert!(json[1]["kept"].as_f64().unwrap() > 0.0);
    let [alone, among] = ["M.nc", "many/J.nc"].map(|name| read_mask(program.path(name)).unwrap());
    assert_eq!(alone, among);

    // A file that cannot be read does not keep the others from being processed.
    let run = program.run("infer C.nc J.nc --grid C.nc --out-dir some");
    assert_eq!(run.code, 2);
    assert!(run.stderr.contains("C.nc: radiance: is missing"), "{}", run.stderr);
    assert!(run.stderr.contains("number of files that failed is 1"), "{}", run.stderr);
    assert!(program.path("some/J.nc").exists() && !program.path("some/C.nc").exists());

    program.refuse("infer I.nc J.nc --grid C.nc --out V.nc", &["number of bands"]);
    program.refuse("carve I.nc J.nc --grid C.nc --out V.nc", &["--out-dir"]);
    program.refuse("infer I.nc --grid C.nc --out-dir .", &["is an input of this command"]);
    program.refuse("infer I.nc many/I.nc --grid C.nc --out-dir more", &["output of two files"]);
}

/// Images of a long strip of clouds are estimated tile by tile. The result is that of the whole, and that
/// of a run that was interrupted.
#[test]
fn long_images_are_estimated_in_tiles() {
    let program = Program::new();
    let (rows, cols) = (24, 800);
    let target = DVec3::new(20.0, 0.6, 1.0);
    let views: Vec<View> = [(0.0_f64, 0.0_f64), (35.0, 80.0), (35.0, 260.0), (20.0, 170.0)]
        .iter()
        .map(|(zenith, azimuth)| towards(zenith.to_radians(), azimuth.to_radians()))
        .map(|towards| View::orthographic(towards, target, 0.05, [rows, cols]).unwrap())
        .collect();
    // A cloud of six columns in every twenty.
    let radiance = Array3::from_shape_fn((views.len(), rows, cols), |(view, row, col)| {
        let cloudy = (9..15).contains(&row) && (col + view) % 20 < 6;
        if cloudy { 0.15 + 0.01 * ((col / 20) % 5) as f32 } else { 0.02 }
    });
    let images = ViewStack::new(radiance).unwrap();
    let observation = Observation::new(Sun::default(), views, images).unwrap();
    let provenance = Provenance { title: "A test".into(), ..Provenance::default() };
    write_observation(program.path("I.nc"), &observation, &provenance).unwrap();
    let estimator = Estimator::new(load_trained_weights("general").unwrap());
    let geometry = observation.imaging_geometry().unwrap();
    let whole = estimator.estimate(&observation.images, &geometry, None).unwrap();

    let printed = program.succeed("infer I.nc --out V.nc");
    assert!(printed.contains("32 levels of 24 x 800 columns"), "{printed}");
    assert_eq!(program.files(), ["I.nc", "V.nc"]);
    let tiled = read_estimate(program.path("V.nc")).unwrap();
    assert_eq!(tiled.extinction.grid, whole.extinction.grid);
    let largest = whole.extinction.values.iter().copied().fold(0.0, f32::max);
    assert!(largest > 1.0, "{largest}");
    for (one, other) in tiled.extinction.values.iter().zip(&whole.extinction.values) {
        assert!((one - other).abs() < 1e-4 * largest, "{one} {other}");
    }
    // The first tile of a larger grid is not in the images: there is no cloud, and no error is expected.
    let [bottom, height] = [whole.extinction.grid.origin.z, whole.extinction.grid.spacing.z];
    let grid = format!(
        "origin_km = [-80.0, 0.0, {bottom}]\nspacing_km = [0.05, 0.05, {height}]\nshape = [32, 24, 2400]\n"
    );
    std::fs::write(program.path("G.toml"), grid).unwrap();
    program.succeed("infer I.nc --grid G.toml --out V.nc");
    let larger = read_estimate(program.path("V.nc")).unwrap();
    let part = |volume: &Volume, cols| volume.part(0..24, cols).unwrap().values;
    for volume in [&larger.extinction, larger.uncertainty.as_ref().unwrap()] {
        assert!(part(volume, 0..768).iter().all(|value| *value == 0.0));
        assert!(part(volume, 1600..2400).iter().any(|value| *value > 1.0));
    }
    std::fs::remove_file(program.path("G.toml")).unwrap();
    program.succeed("infer I.nc --out V.nc");

    // A tile of this run, and one of another run that must not be used.
    let bytes = std::fs::read(program.path("V.nc")).unwrap();
    program.succeed("infer I.nc --carve --out W.nc");
    std::fs::create_dir(program.path("V.nc.tiles")).unwrap();
    std::fs::copy(program.path("W.nc"), program.path("V.nc.tiles/1.nc")).unwrap();
    program.succeed("infer I.nc --out V.nc");
    assert_eq!(std::fs::read(program.path("V.nc")).unwrap(), bytes);
    assert_eq!(program.files(), ["I.nc", "V.nc", "W.nc"]);
}
