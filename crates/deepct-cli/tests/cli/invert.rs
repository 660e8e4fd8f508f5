use crate::program::Program;
use deepct_core::cloud::Cloud;
use deepct_core::grid::{Grid, Volume};
use deepct_core::io::{
    Provenance, read_cloud, read_light, read_mask, read_observation, read_volume, write_cloud,
};
use deepct_core::math::DVec3;
use deepct_core::metrics::relative_error;

/// Renders the images of a ball with an extinction of 20 /km above a surface. Returns the true
/// extinction.
fn ball(program: &Program) -> Volume {
    let grid = Grid::new(DVec3::new(0.0, 0.0, 0.8), DVec3::splat(0.05), [8, 16, 16]).unwrap();
    let mut ball = Volume::constant(grid, 0.0);
    for ((k, j, i), extinction) in ball.values.indexed_iter_mut() {
        if grid.voxel_center([k, j, i]).distance(grid.center()) < 0.15 {
            *extinction = 20.0;
        }
    }
    let provenance = Provenance {
        title: "A ball".into(),
        configuration: "".into(),
        seed: 0,
        ..Provenance::default()
    };
    let cloud = Cloud::from_extinction(ball.clone()).unwrap();
    write_cloud(program.path("C.nc"), &cloud, &provenance).unwrap();
    program.succeed("render C.nc --views cloudct-10 --samples 256 --out I.nc");
    ball
}

#[test]
fn an_inversion_comes_near_the_truth_and_leaves_nothing_but_its_answer() {
    let program = Program::new();
    let truth = ball(&program);
    let line = "invert I.nc --grid C.nc --truth C.nc --iterations 12 --set inversion.coarse=[2] \
                --out V.nc";
    let run = program.run(line);
    assert_eq!(run.code, 0, "{}", run.stderr);
    // Without a terminal, every step is reported on a line.
    assert!(run.stderr.contains("blocks of 2, step 1, misfit"), "{}", run.stderr);
    assert!(run.stdout.contains("epsilon") && run.stdout.contains("steps"), "{}", run.stdout);
    assert_eq!(program.files(), ["C.nc", "I.nc", "V.nc"]);
    let (found, mask) =
        (read_volume(program.path("V.nc")).unwrap(), read_mask(program.path("V.nc")).unwrap());
    let epsilon = relative_error(&truth, &found).unwrap();
    assert!(epsilon < 0.48, "{epsilon}");
    let mut outside = found.values.iter().zip(&mask.values).filter(|(_, inside)| !**inside);
    assert!(mask.count() < mask.values.len() && outside.all(|(value, _)| *value == 0.0));
    // A second run starts from this estimate and takes one more step.
    let again = program.run("invert I.nc --grid C.nc --init V.nc --iterations 1 --out W.nc");
    assert!(again.code == 0 && again.stderr.contains("step 0"), "{}", again.stderr);
    program.succeed("score --truth C.nc V.nc W.nc");
}

/// Images in two bands, of a cloud whose droplets have 14 um, give a cloud with droplets near this size;
/// its liquid water follows from an extinction efficiency of 2.
#[test]
fn two_bands_give_the_droplets() {
    let program = Program::new();
    let ball = ball(&program);
    let optics = "--phase mie --effective-radius 14 --solver ordinates --views cloudct-10";
    for (wavelength, out) in [("0.672", "visible.nc"), ("2.13", "infrared.nc")] {
        program.succeed(&format!("render C.nc {optics} --wavelength {wavelength} --out {out}"));
    }
    let line = "invert visible.nc infrared.nc --grid C.nc --init auto --iterations 30 \
                --set inversion.coarse=[2] --set inversion.corrections=1 --truth C.nc";
    program.succeed(&format!("{line} --radius uniform --out V.nc"));
    let found = read_cloud(program.path("V.nc")).unwrap();
    let radius = found.mean_effective_radius().unwrap();
    assert!((radius - 14.0).abs() < 1.0, "{radius}");
    let water: f32 = found.microphysics.unwrap().liquid_water_content.sum();
    let expected = ball.values.sum() * 14.0 / 1500.0;
    assert!((water / expected - 1.0).abs() < 0.05, "{water} {expected}");
    let uniform = "invert I.nc --grid C.nc --radius uniform --out W.nc";
    program.refuse(uniform, &["optics.phase", "mie"]);
}

/// The inversion reads the scene illumination from the file of the images and reproduces the images
/// of the truth. An option that contradicts the file is reported.
#[test]
fn the_light_travels_with_the_images() {
    let program = Program::new();
    ball(&program);
    let light = "sun_zenith_deg = 40.0\nair = true\nwavelength = 0.55\nsurface_albedo = 0.2\n\
                 wind_speed = 4.0\n[optics]\nphase = \"mie\"\neffective_radius = 7.0\n";
    std::fs::write(program.path("L.toml"), light).unwrap();
    let render = "render C.nc --views cloudct-10 --solver ordinates --light L.toml --out I.nc";
    program.succeed(&format!("{render} --sun-azimuth 100"));
    let stated = read_observation(program.path("I.nc")).unwrap().light;
    assert_eq!(stated.values()["sun_azimuth_deg"].as_float(), Some(100.0));
    assert_eq!(stated.values()["optics.effective_radius"].as_float(), Some(7.0));
    let misfit = |more: &str| {
        let run = program.run(&format!(
            "invert I.nc --grid C.nc --init C.nc --mask M.nc --iterations 0 --out V.nc {more}"
        ));
        assert_eq!(run.code, 0, "{}", run.stderr);
        let line = run.stdout.lines().find_map(|line| line.strip_prefix("misfit"));
        (line.unwrap().trim().parse::<f64>().unwrap(), run.stderr)
    };
    program.succeed("carve I.nc --grid C.nc --agreement 0.1 --out M.nc");
    let (same, said) = misfit("");
    assert!(same < 0.1 && !said.contains("was given"), "{same} {said}");
    let (other, said) = misfit("--surface-albedo 0.05");
    assert!(other > 1.0, "{other}");
    assert!(said.contains("surface_albedo is 0.2 in I.nc, but 0.05 was given"), "{said}");
    assert!(misfit("--air=false").0 > 1.0 && misfit("--effective-radius 12").0 > 1.5 * same);
    let estimate = read_light(program.path("V.nc")).unwrap().unwrap().0;
    assert_eq!(estimate.optics.effective_radius, Some(12.0));
    program.refuse("render C.nc --views cloudct-10 --light I.nc --out J.nc", &["I.nc"]);
    let before = std::fs::read(program.path("I.nc")).unwrap();
    program.refuse("sense I.nc --out I.nc", &["I.nc", "--out", "would be lost"]);
    program.refuse("invert I.nc --grid C.nc --out ./I.nc", &["I.nc", "--out", "would be lost"]);
    assert_eq!(std::fs::read(program.path("I.nc")).unwrap(), before);
    assert!(misfit("--wind-speed 9").1.contains("warning: wind_speed is 4.0 in I.nc, but 9.0"));
    std::fs::write(program.path("L.toml"), "sun_zenit = 3.0").unwrap();
    program.refuse(render, &["L.toml", "sun_zenit", "config light"]);
}

#[test]
fn what_cannot_be_inverted_is_refused() {
    let program = Program::new();
    ball(&program);
    let line = "invert I.nc --grid C.nc --out V.nc";
    for (wrong, words) in [
        ("--init -3", ["--init", "positive"]),
        ("--init none.nc", ["none.nc", "does not exist"]),
        ("--mask I.nc", ["I.nc", "mask"]),
        ("--set inversion.memroy=3", ["memroy", "deepct config invert"]),
        ("--set inversion.softness=0", ["softness", "positive"]),
        ("--set inversion.corrections=0", ["corrections", "at least 1"]),
        ("--surface-albedo 2", ["surface albedo", "2"]),
        ("--phase magic", ["magic", "config light"]),
    ] {
        program.refuse(&format!("{line} {wrong}"), &words);
    }
    let wrong = "invert C.nc --grid C.nc --out V.nc";
    program.refuse(wrong, &["C.nc", "radiance"]);
    // The target altitude of the images is not that of the weights.
    program.refuse("hybrid I.nc --weights cloudct-10 --out V.nc", &["I.nc"]);
}

#[test]
fn an_experiment_is_run_once_and_reported() {
    let program = Program::new();
    let settings = "generated = 1\nsamples_per_pixel = 8\nquick_iterations = 1\n\
                    [inversion]\niterations = 1\ncoarse = [8]\ncoarse_iterations = 2\n";
    std::fs::write(program.path("E.toml"), settings).unwrap();
    let first = program.succeed("experiment E.toml --out E");
    assert!(first.contains("4 results, 4 of them made now"), "{first}");
    std::fs::remove_file(program.path("E/results/generated-1-hybrid.json")).unwrap();
    let again = program.succeed("experiment E.toml --out E");
    assert!(again.contains("4 results, 1 of them made now"), "{again}");
    let report = std::fs::read_to_string(program.path("E/report.md")).unwrap();
    for method in ["network", "physics", "hybrid", "quick-hybrid"] {
        assert!(report.contains(&format!("| generated-1 | {method} |")), "{report}");
        assert!(program.path(&format!("E/figures/generated-1-{method}.png")).exists());
        read_volume(program.path(&format!("E/volumes/generated-1-{method}.nc"))).unwrap();
    }
    assert!(program.path("E/figures/errors.png").exists());
    // Shares have the clouds in turns, and no report.
    for (share, made) in [("1/2", 4), ("2/2", 0)] {
        let said = program.succeed(&format!("experiment E.toml --out F --share {share}"));
        assert!(said.ends_with(&format!("{made} results, {made} of them made now\n")), "{said}");
        assert!(!program.path("F/report.md").exists());
    }
    program.refuse("experiment E.toml --set seed=2 --out E", &["experiment.toml", "settings"]);
    program.refuse("experiment E.toml --set generated=0 --out G", &["E.toml", "clouds"]);
}

/// A row of clouds that is longer than a tile: the hybrid comes nearer to the truth than the network, also
/// beside the seam, and an interrupted run is continued.
#[test]
fn a_hybrid_of_a_field_is_computed_in_tiles() {
    let program = Program::new();
    let grid =
        Grid::new(DVec3::new(0.0, 0.0, 0.6), DVec3::new(0.05, 0.05, 0.04), [12, 16, 150]).unwrap();
    let mut truth = Volume::constant(grid, 0.0);
    for ((k, j, i), extinction) in truth.values.indexed_iter_mut() {
        // Clouds of eight columns in every sixteen, one of them across the seam at 96.
        let inside = (3..9).contains(&k) && (5..11).contains(&j) && (i + 4) % 16 < 8;
        *extinction = if inside { 25.0 } else { 0.0 };
    }
    let provenance = Provenance { title: "Blocks".into(), ..Provenance::default() };
    let cloud = Cloud::from_extinction(truth.clone()).unwrap();
    write_cloud(program.path("C.nc"), &cloud, &provenance).unwrap();
    program.succeed(
        "render C.nc --views cloudct-10 --like general --effective-radius 10 --solver ordinates \
         --accuracy 0.1 --out clean.nc",
    );
    program.succeed("sense clean.nc --out I.nc");
    program.succeed("infer I.nc --grid C.nc --carve --out network.nc");
    let hybrid = "hybrid I.nc --grid C.nc --iterations 4 --effective-radius 10 --out V.nc";
    let printed = program.succeed(hybrid);
    assert!(printed.contains("12 levels of 16 x 150 columns"), "{printed}");
    assert!(!program.path("V.nc.tiles").exists());
    let read = |name: &str| read_volume(program.path(name)).unwrap();
    let error = |name: &str, cols: std::ops::Range<usize>| {
        let part = |volume: &Volume| volume.part(0..16, cols.clone()).unwrap();
        relative_error(&part(&truth), &part(&read(name))).unwrap()
    };
    let [network, whole] = ["network.nc", "V.nc"].map(|name| error(name, 0..150));
    assert!(whole < 0.9 * network, "{whole} {network}");
    let seam = error("V.nc", 88..104);
    assert!(seam < 1.1 * whole, "{seam} {whole}");
    // A field of fewer columns is computed as one. Far from its end, the result is as good.
    program.succeed("cloud import C.nc --crop 0,0,140,16 --spacing file --out cut.nc");
    program.succeed(&hybrid.replace("--grid C.nc", "--grid cut.nc").replace("V.nc", "one.nc"));
    for cols in [0..32, 32..88, 88..104] {
        let (tiled, one) = (error("V.nc", cols.clone()), error("one.nc", cols.clone()));
        assert!(tiled < 1.05 * one, "{cols:?}: {tiled} {one}");
    }

    let bytes = std::fs::read(program.path("V.nc")).unwrap();
    std::fs::create_dir(program.path("V.nc.tiles")).unwrap();
    std::fs::copy(program.path("network.nc"), program.path("V.nc.tiles/0.nc")).unwrap();
    program.succeed(hybrid);
    assert_eq!(std::fs::read(program.path("V.nc")).unwrap(), bytes);
}
