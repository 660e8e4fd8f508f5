use crate::program::Program;
use deepct_core::grid::{Grid, Mask, Volume};
use deepct_core::io::{Provenance, write_mask, write_volume};
use deepct_core::math::DVec3;
use ndarray::Array3;

fn write(program: &Program, name: &str, shape: [usize; 3], value: impl Fn(usize) -> f32) {
    let grid = Grid::new(DVec3::ZERO, DVec3::splat(0.05), shape).unwrap();
    let values = Array3::from_shape_fn(shape, |(_, _, i)| value(i));
    let provenance = Provenance {
        title: "A test".into(),
        configuration: String::new(),
        seed: 0,
        ..Provenance::default()
    };
    write_volume(program.path(name), &Volume::new(grid, values).unwrap(), &provenance).unwrap();
}

/// Writes a truth with extinctions of 0, 10, 20 and 30 from west to east, an estimate of 5
/// everywhere, and a mask of the westernmost and easternmost columns.
fn scene(program: &Program) {
    write(program, "C.nc", [2, 3, 4], |i| 10.0 * i as f32);
    write(program, "flat.nc", [2, 3, 4], |_| 5.0);
    let grid = Grid::new(DVec3::ZERO, DVec3::splat(0.05), [2, 3, 4]).unwrap();
    let values = Array3::from_shape_fn(grid.shape, |(_, _, i)| i == 0 || i == 3);
    let provenance = Provenance {
        title: "A test".into(),
        configuration: String::new(),
        seed: 0,
        ..Provenance::default()
    };
    write_mask(program.path("M.nc"), &Mask::new(grid, values).unwrap(), &provenance).unwrap();
}

#[test]
fn a_row_per_file() {
    let program = Program::new();
    scene(&program);
    let table = program.succeed("score --truth C.nc C.nc flat.nc M.nc");
    let rows: Vec<Vec<&str>> =
        table.lines().map(|line| line.split_whitespace().collect()).collect();
    assert_eq!(rows[1], ["C.nc", "0.0000", "0.0000", "0.0000", "1.0000"]);
    // Computed by hand: (5 + 5 + 15 + 25) / 60, (60 - 20) / 60, sqrt((25 + 25 + 225 + 625) / 4).
    assert_eq!(rows[2], ["flat.nc", "0.8333", "0.6667", "15.0000", "-"]);
    assert_eq!(rows[4], ["M.nc", "0.5000", "0.50000", "1.0000", "0.6667"]);
}

#[test]
fn json_has_all_scores() {
    let program = Program::new();
    scene(&program);
    let json = program.succeed("score --truth C.nc flat.nc M.nc --json");
    let rows: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(rows[0]["file"], "flat.nc");
    assert!((rows[0]["relative_error"].as_f64().unwrap() - 5.0 / 6.0).abs() < 1e-12);
    assert!((rows[0]["mass_error"].as_f64().unwrap() - 2.0 / 3.0).abs() < 1e-12);
    assert_eq!(rows[0]["profile"].as_array().unwrap().len(), 2);
    assert!((rows[0]["profile"][1]["altitude"].as_f64().unwrap() - 0.075).abs() < 1e-9);
    assert!(rows[0]["correlation"].is_null());
    assert!((rows[1]["extinction_missed"].as_f64().unwrap() - 0.5).abs() < 1e-12);
}

#[test]
fn wrong_input_is_refused() {
    let program = Program::new();
    scene(&program);
    write(&program, "wide.nc", [2, 3, 5], |_| 1.0);
    write(&program, "empty.nc", [2, 3, 4], |_| 0.0);
    program.refuse("score --truth none.nc C.nc", &["none.nc"]);
    program.refuse("score --truth C.nc none.nc", &["none.nc"]);
    program
        .refuse("score --truth C.nc wide.nc", &["wide.nc", "[2, 3, 4]", "[2, 3, 5]", "one grid"]);
    program
        .refuse("score --truth empty.nc C.nc", &["empty.nc", "extinction", "positive somewhere"]);
    program.refuse("score --truth M.nc C.nc", &["M.nc", "extinction"]);
}
