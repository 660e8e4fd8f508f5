use crate::program::Program;
use deepct_core::grid::{Grid, Volume};
use deepct_core::io::{Provenance, read_observation, write_observation, write_volume};
use deepct_core::math::DVec3;
use ndarray::Array3;
use serde_json::Value;

/// The centre of a ball of cloud (km), which is not where the cameras are pointed.
const BALL: DVec3 = DVec3::new(1.1, 0.5, 0.8);

fn provenance() -> Provenance {
    Provenance {
        title: "A test".into(),
        configuration: String::new(),
        seed: 0,
        ..Provenance::default()
    }
}

fn images() -> Program {
    let program = Program::new();
    let grid = Grid::new(DVec3::new(0.0, 0.0, 0.5), DVec3::new(0.05, 0.05, 0.04), [32, 32, 32]);
    let grid = grid.unwrap();
    let values = Array3::from_shape_fn(grid.shape, |(k, j, i)| {
        if grid.voxel_center([k, j, i]).distance(BALL) < 0.2 { 20.0 } else { 0.0 }
    });
    let volume = Volume::new(grid, values).unwrap();
    write_volume(program.path("C.nc"), &volume, &provenance()).unwrap();
    program.succeed("render C.nc --views cloudct-10 --solver ordinates --accuracy 0.1 --out I.nc");
    program
}

#[test]
fn bright_parts_meet_in_the_cloud() {
    let program = images();
    let text = program.succeed("images check I.nc");
    for words in ["10 views of 32 x 32", "zenith 30.00, azimuth 45.00", "0.672 um", "image centres"]
    {
        assert!(text.contains(words), "{text}");
    }
    let json: Value = serde_json::from_str(&program.succeed("images check I.nc --json")).unwrap();
    let point = |key: &str| {
        DVec3::from_array([0, 1, 2].map(|axis| json[key]["point_km"][axis].as_f64().unwrap()))
    };
    assert!(point("centres_meet").distance(DVec3::new(0.8, 0.8, 1.14)) < 1e-6);
    // The sunlit side is brighter.
    assert!(point("bright_parts_meet").distance(BALL) < 0.12, "{}", point("bright_parts_meet"));
    assert_eq!(json["views"].as_array().unwrap().len(), 10);
    assert!((json["views"][0]["zenith_deg"].as_f64().unwrap() - 46.0).abs() < 1e-6);
    assert!((json["views"][0]["altitude_km"].as_f64().unwrap() - 576.0).abs() < 1.0);
    program.succeed("images check I.nc --png M.png");
}

#[test]
fn images_in_another_order_are_noticed() {
    let program = images();
    let mut observation = read_observation(program.path("I.nc")).unwrap();
    assert!(!program.run("images check I.nc").stderr.contains("warning"));
    observation.views.rotate_left(4);
    write_observation(program.path("R.nc"), &observation, &provenance()).unwrap();
    let run = program.run("images check R.nc");
    assert!(run.code == 0 && run.stderr.contains("do not meet"), "{}{}", run.stdout, run.stderr);
}

#[test]
fn other_files_are_refused() {
    let program = images();
    program.refuse("images check C.nc", &["C.nc", "radiance"]);
    program.refuse("images check none.nc", &["none.nc", "does not exist"]);
    program.refuse("images check I.nc --png nowhere/a.png", &["nowhere"]);
    program.refuse("images check I.nc --png I.nc", &["I.nc", "is an input"]);
}
