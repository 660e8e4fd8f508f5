use crate::program::Program;
use deepct_core::cloud::{Cloud, Microphysics};
use deepct_core::grid::{Grid, Volume};
use deepct_core::io::{Provenance, read_cloud, read_observation, write_cloud, write_volume};
use deepct_core::math::DVec3;
use deepct_core::optics::extinction;
use ndarray::Array3;

/// Writes a cloud that is a block in the centre of a grid with 6 x 7 columns.
fn cloud(program: &Program, name: &str) {
    let spacing = DVec3::new(0.05, 0.05, 0.04);
    let grid = Grid::new(DVec3::new(0.0, 0.0, 0.6), spacing, [5, 6, 7]).unwrap();
    let inside = |(k, j, i): (usize, usize, usize)| k > 0 && (2..4).contains(&j) && i > 1 && i < 5;
    let extinction =
        Array3::from_shape_fn(grid.shape, |voxel| if inside(voxel) { 40.0 } else { 0.0 });
    let cloud = Cloud::from_extinction(Volume::new(grid, extinction).unwrap()).unwrap();
    let provenance = Provenance {
        title: "A test".into(),
        configuration: String::new(),
        seed: 0,
        ..Provenance::default()
    };
    write_cloud(program.path(name), &cloud, &provenance).unwrap();
}

#[test]
fn images_have_the_views_and_the_size_of_the_grid() {
    let program = Program::new();
    cloud(&program, "C.nc");
    let command = "render C.nc --views cloudct-10 --samples 16 --surface-albedo 0";
    program.succeed(&format!("{command} --out I.nc"));
    program.succeed(&format!("{command} --out same.nc --threads 1"));
    program.succeed(&format!("{command} --out other.nc --seed 2"));
    let read = |name: &str| read_observation(program.path(name)).unwrap();
    let observation = read("I.nc");
    assert_eq!(observation, read("same.nc"));
    assert_ne!(observation, read("other.nc"));
    assert_eq!(observation.images.shape(), [10, 6, 7]);
    assert_eq!(observation.geometry().sun_zenith_deg.round(), 30.0);
    // View 5 points to nadir: cloud in the centre, a black surface around it.
    let nadir = observation.images.image(5);
    assert!(nadir.sum() > 0.1, "{nadir}");
    assert!(nadir[[0, 0]] == 0.0 && nadir[[5, 6]] == 0.0, "{nadir}");
    assert!(observation.standard_error.unwrap().image(5)[[2, 3]] > 0.0);
}

#[test]
fn droplets_scatter_by_their_size() {
    let program = Program::new();
    cloud(&program, "C.nc");
    let render = "render C.nc --views cloudct-10 --samples 4 --set optics.phase=mie --out I.nc";
    program.refuse(render, &["C.nc", "optics.effective_radius", "not set"]);
    program.succeed(&format!("{render} --set optics.effective_radius=10.0 --set wavelength=0.55"));
    let observation = read_observation(program.path("I.nc")).unwrap();
    assert_eq!(observation.light.wavelength, 0.55);
    assert!(observation.images.brightest() > 0.0);
    program.refuse(&format!("{render} --set optics.effective_radius=90.0"), &["90", "50 um"]);
    program.refuse(&format!("{render} --set optics.phase=magic"), &["magic", "config light"]);
}

/// Writes three voxels in a row, of which the central one has a liquid water content of 0.3 g/m3
/// and an effective radius of 10 um.
fn droplets(program: &Program, name: &str) {
    let grid = Grid::new(DVec3::ZERO, DVec3::splat(0.05), [1, 1, 3]).unwrap();
    let at = |value| Array3::from_shape_vec((1, 1, 3), vec![0.0, value, 0.0]).unwrap();
    let droplets = Microphysics {
        liquid_water_content: at(0.3),
        effective_radius: at(10.0),
        effective_variance: at(0.1),
    };
    let cloud = Cloud::from_microphysics(grid, droplets).unwrap();
    let provenance = Provenance {
        title: "A test".into(),
        configuration: String::new(),
        seed: 0,
        ..Provenance::default()
    };
    write_cloud(program.path(name), &cloud, &provenance).unwrap();
}

/// `score` uses the same extinction as `render`: 45 km-1 for every phase function, multiplied by
/// 2.104 / 2 if the Mie extinction is requested. The extinction of `render` follows from the
/// fraction of the light that is transmitted unscattered.
#[test]
fn rendering_and_scoring_take_the_same_extinction() {
    let program = Program::new();
    droplets(&program, "C.nc");
    let render = "render C.nc --views cloudct-10 --samples 2 --out I.nc --sun-zenith 0 --fluxes";
    let share = |text: &str, what: &str| -> f64 {
        let row = text.lines().find(|line| line.contains(what)).unwrap();
        row.split_whitespace().rev().nth(1).unwrap().parse().unwrap()
    };
    let truth = |extinction: f64| {
        let grid = Grid::new(DVec3::ZERO, DVec3::splat(0.05), [1, 1, 3]).unwrap();
        let values = vec![0.0, extinction as f32, 0.0];
        let values = Array3::from_shape_vec((1, 1, 3), values).unwrap();
        let volume = Volume::new(grid, values).unwrap();
        let provenance = Provenance {
            title: "V".into(),
            configuration: String::new(),
            seed: 0,
            ..Provenance::default()
        };
        write_volume(program.path("V.nc"), &volume, &provenance).unwrap();
    };
    for (settings, extinction) in [
        ("--set optics.phase=hg", 45.0),
        ("--set optics.phase=mie", 45.0),
        ("--set optics.phase=mie --set optics.extinction=mie", 47.34),
    ] {
        let text = program.succeed(&format!("{render} {settings}"));
        let unscattered = share(&text, "unscattered");
        let expected = 2.0 / 3.0 + f64::exp(-0.05 * extinction) / 3.0;
        assert!((unscattered - expected).abs() < 1e-3, "{settings}: {unscattered} {expected}");
        truth(extinction);
        let score = format!("score --truth C.nc V.nc --json {settings}");
        let rows: serde_json::Value = serde_json::from_str(&program.succeed(&score)).unwrap();
        let error = rows[0]["relative_error"].as_f64().unwrap();
        assert!(error < 2e-3, "{settings}: {error}");
        let faces = ["the top  ", "the bottom", "the sides", "by droplets"];
        let sum: f64 = faces.map(|face| share(&text, face)).iter().sum();
        assert!((sum - 1.0).abs() < 1e-5, "{text}");
    }
}

#[test]
fn views_of_a_file() {
    let program = Program::new();
    cloud(&program, "C.nc");
    let views = "image_size = [3, 4]\n[[view]]\nview_zenith_deg = 20.0\nview_azimuth_deg = 270.0\n\
                 pixel_km = 0.1\n";
    std::fs::write(program.path("views.toml"), views).unwrap();
    program.succeed("render C.nc --views views.toml --samples 4 --sun-zenith 60 --out I.nc");
    let observation = read_observation(program.path("I.nc")).unwrap();
    assert_eq!(observation.images.shape(), [1, 3, 4]);
    assert!((observation.geometry().view_azimuth_deg[0] - 270.0).abs() < 1e-9);
    assert!((observation.geometry().sun_zenith_deg - 60.0).abs() < 1e-9);
}

#[test]
fn wrong_input_is_refused() {
    let program = Program::new();
    cloud(&program, "C.nc");
    std::fs::write(program.path("bad.toml"), "[[view]]\nzenith = 20.0\n").unwrap();
    std::fs::write(program.path("text.nc"), "not an HDF5 file").unwrap();
    program.refuse("render none.nc --views cloudct-10 --out I.nc", &["none.nc"]);
    program.refuse("render text.nc --views cloudct-10 --out I.nc", &["text.nc", "HDF5"]);
    program.refuse("render C.nc --views cloudct-11 --out I.nc", &["cloudct-11", "pearls-32"]);
    program.refuse("render C.nc --views bad.toml --out I.nc", &["bad.toml", "zenith"]);
    let refuse = |option: &str, words: &[&str]| {
        program.refuse(&format!("render C.nc --views cloudct-10 {option} --out I.nc"), words);
    };
    refuse("--samples 1", &["samples", "at least 2"]);
    refuse("--sun-zenith 95", &["solar zenith", "95"]);
    refuse("--surface-albedo 1.5", &["surface albedo", "1.5"]);
}

#[test]
fn images_are_written_as_openexr_too() {
    let program = Program::new();
    cloud(&program, "C.nc");
    program.succeed("render C.nc --views cloudct-10 --samples 2 --out I.nc --exr I.exr");
    let bytes = std::fs::read(program.path("I.exr")).unwrap();
    // The magic number of OpenEXR (20000630 in little-endian).
    assert_eq!(bytes[..4], 20_000_630_u32.to_le_bytes());
    assert!(bytes.windows(7).any(|name| name == b"view_09"));
}

#[test]
fn a_wanted_noise_is_reached() {
    let program = Program::new();
    cloud(&program, "C.nc");
    let printed = program.succeed("render C.nc --views cloudct-10 --noise 0.1 --out I.nc");
    assert!(printed.contains("photon paths per pixel"), "{printed}");
    let observation = read_observation(program.path("I.nc")).unwrap();
    let (images, errors) = (observation.images, observation.standard_error.unwrap());
    let (mut squares, mut bright) = (0.0, 0.0);
    for view in 0..10 {
        let image = images.image(view);
        let brightest = image.iter().copied().fold(0.0, f32::max);
        for (value, error) in image.iter().zip(errors.image(view)) {
            if *value >= 0.5 * brightest {
                squares += (error / value).powi(2);
                bright += 1.0;
            }
        }
    }
    let noise = f32::sqrt(squares / bright);
    assert!(noise <= 0.1001 && noise > 0.03, "{noise}");
    // The noise that is printed is the one that was asked for.
    assert!(printed.contains(&format!("noise      {:.2} % of bright pixels", 100.0 * noise)));
    // Fewer paths than a round has, and a noise that they do not reach.
    program.succeed("render C.nc --views cloudct-10 --samples 8 --noise 0.001 --out few.nc");
    program.refuse("render C.nc --views cloudct-10 --noise 0 --out I.nc", &["noise", "above 0"]);
}

#[test]
fn air_and_waves_add_light_and_more_of_it_in_the_blue() {
    let program = Program::new();
    cloud(&program, "C.nc");
    let command = "render C.nc --views cloudct-10 --samples 64 --surface-albedo 0";
    program.succeed(&format!("{command} --out dark.nc"));
    program.succeed(&format!("{command} --wind-speed 5 --out sea.nc"));
    program.succeed(&format!(
        "{command} --air --wavelength 0.45,0.86 --solar-irradiance 2 --out I.nc --png I.png"
    ));
    let sum = |name: &str| read_observation(program.path(name)).unwrap().images.values.sum();
    let dark = sum("dark.nc");
    assert!(sum("sea.nc") > dark);
    assert!(sum("I-0.86um.nc") > 2.0 * dark && sum("I-0.45um.nc") > 1.2 * sum("I-0.86um.nc"));
    assert!(
        (read_observation(program.path("I-0.45um.nc")).unwrap().light.wavelength - 0.45).abs()
            < 1e-9
    );
    let png = std::fs::read(program.path("I-0.86um.png")).unwrap();
    assert!(png.starts_with(b"\x89PNG"));
    let refuse = |option: &str, words: &[&str]| {
        program.refuse(&format!("render C.nc --views cloudct-10 {option} --out I.nc"), words);
    };
    refuse("--wind-speed 100", &["wind speed", "100"]);
    refuse("--solar-irradiance -1", &["solar_irradiance"]);
    refuse("--air --wavelength 9", &["wavelength", "9"]);
}

/// Images like those of the training of a network have its cameras, altitude, Sun and illumination,
/// so that the network takes them; other options replace them.
#[test]
fn images_are_like_those_of_a_network() {
    let program = Program::new();
    program.succeed("cloud generate --set width_km=0.4 --out C.nc");
    let command = "render C.nc --like cloudct-10 --solver ordinates --accuracy 0.1";
    program.succeed(&format!("{command} --out I.nc"));
    let images = read_observation(program.path("I.nc")).unwrap();
    assert!(images.light.air && (images.views[0].target.z - 1.12).abs() < 1e-9);
    program.succeed("infer I.nc --weights cloudct-10 --out V.nc");
    program
        .succeed(&format!("{command} --out J.nc --target-altitude 1 --sun-zenith 20 --air=false"));
    let other = read_observation(program.path("J.nc")).unwrap();
    assert!(!other.light.air && (other.views[0].target.z - 1.0).abs() < 1e-9);
    assert!((other.geometry().sun_zenith_deg - 20.0).abs() < 1e-9);
    assert_eq!(other.geometry().sun_azimuth_deg, images.geometry().sun_azimuth_deg);
    let general = "render C.nc --like general --samples 2 --out I.nc";
    program.refuse(general, &["general", "--views"]);
    program.succeed(&format!("{general} --views cloudct-10"));
    assert!(read_observation(program.path("I.nc")).unwrap().light.air);
    program.refuse("render C.nc --like C.nc --out I.nc", &["C.nc", "netCDF", "not safetensors"]);
    program.refuse(&format!("{general} --views cloudct-10 --target-altitude nan"), &["altitude"]);
}

/// A trilinear block has the optical depth of one that is constant in voxels, but wider sides.
#[test]
fn an_extinction_may_be_trilinear() {
    let program = Program::new();
    let grid = Grid::new(DVec3::new(0.0, 0.0, 0.6), DVec3::splat(0.05), [5, 7, 7]).unwrap();
    let write = |name: &str, inside: fn(usize) -> bool| {
        let value = |(k, j, i): (usize, usize, usize)| {
            if inside(k) && (2..5).contains(&j) && (2..5).contains(&i) { 4.0 } else { 0.0 }
        };
        let extinction = Volume::new(grid, Array3::from_shape_fn(grid.shape, value)).unwrap();
        let cloud = Cloud::from_extinction(extinction).unwrap();
        let provenance = Provenance { title: "A test".into(), ..Provenance::default() };
        write_cloud(program.path(name), &cloud, &provenance).unwrap();
    };
    write("C.nc", |level| (1..4).contains(&level));
    write("top.nc", |level| level > 1);
    let sum = |options: &str| {
        let command =
            format!("render C.nc --views cloudct-10 --samples 512 --surface-albedo 0 {options}");
        program.succeed(&format!("{command} --out I.nc"));
        read_observation(program.path("I.nc")).unwrap().images.image(5).to_owned()
    };
    let (constant, trilinear) = (sum(""), sum("--trilinear"));
    // Multiple scattering is the only difference of the sums; beyond the sides of the voxels, only
    // the trilinear block is seen.
    assert!((trilinear.sum() / constant.sum() - 1.0).abs() < 0.06);
    assert!(constant[[3, 1]] < 1e-3 * constant[[3, 3]]);
    assert!(trilinear[[3, 1]] > 0.05 * trilinear[[3, 3]]);
    program.refuse(
        "render top.nc --views cloudct-10 --samples 1 --trilinear --out I.nc",
        &["top.nc", "outermost voxels", "clear voxels"],
    );
}

/// The extinction of a file may be that of droplets at one wavelength only.
#[test]
fn an_extinction_for_every_wavelength_is_told() {
    let program = Program::new();
    program.succeed("cloud generate --set width_km=0.3 --set shape=[8,12,14] --out C.nc");
    let render = "--views cloudct-10 --samples 2 --wavelength 0.55,0.67 --out I.nc";
    assert_eq!(program.run(&format!("render C.nc {render} -q")).stderr, "");
    let mut cloud = read_cloud(program.path("C.nc")).unwrap();
    cloud.extinction = Some(extinction(&cloud).unwrap().values);
    write_cloud(program.path("D.nc"), &cloud, &Provenance::default()).unwrap();
    let run = program.run(&format!("render D.nc {render} -q"));
    assert!(
        run.stderr.contains("D.nc: its extinction is used at every wavelength"),
        "{}",
        run.stderr
    );
}

/// What is printed as rows is printed as JSON, too.
#[test]
fn results_are_printed_as_json() {
    let program = Program::new();
    cloud(&program, "C.nc");
    let json = |command: &str| -> serde_json::Value {
        serde_json::from_str(&program.succeed(&format!("{command} --json -q"))).unwrap()
    };
    let render = "render C.nc --views cloudct-10 --samples 64 --wavelength 0.55,0.67 --out I.nc";
    let images = json(&format!("{render} --fluxes=1000"));
    assert_eq!(images[1]["out"], "I-0.67um.nc");
    assert_eq!(images[0]["shape"], serde_json::json!([10, 6, 7]));
    assert!(images[0]["fluxes"][0]["fraction"].as_f64().unwrap() > 0.0);
    let sensed = json("sense I-0.67um.nc --out N.nc");
    let read = read_observation(program.path("N.nc")).unwrap();
    let saturated = read.saturated.map_or(0, |marks| marks.iter().filter(|mark| **mark).count());
    assert_eq!(sensed["saturated_pixels"], saturated);
    let inverted = json("invert N.nc --grid C.nc --iterations 2 --truth C.nc --out V.nc");
    assert_eq!(inverted["voxels"], 210);
    assert!(inverted["relative_error"].as_f64().unwrap() < 1.0);
    let resampled = json("regrid V.nc --like C.nc --out W.nc");
    assert_eq!(resampled["extinction"], 1.0);
}
