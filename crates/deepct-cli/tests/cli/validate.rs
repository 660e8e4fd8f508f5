use crate::program::Program;

#[test]
fn the_step_cloud_is_right_and_says_so_in_json() {
    let program = Program::new();
    let printed = program.succeed("validate --suite step --json");
    let rows: serde_json::Value = serde_json::from_str(&printed).unwrap();
    let rows = rows.as_array().unwrap();
    assert!(rows.len() >= 10, "{printed}");
    for row in rows {
        assert_eq!(row["suite"], "step");
        assert_eq!(row["passed"], true);
        let difference = row["value"].as_f64().unwrap() - row["reference"].as_f64().unwrap();
        assert!(difference.abs() <= row["tolerance"].as_f64().unwrap());
    }
}

#[test]
fn derivatives_of_the_deterministic_solver_are_differences() {
    let printed = Program::new().succeed("validate --suite gradients --json");
    let rows: serde_json::Value = serde_json::from_str(&printed).unwrap();
    let rows = rows.as_array().unwrap();
    // One comparison with Monte Carlo images, then eight voxels and four directions for each of four
    // extinctions.
    assert_eq!(rows.len(), 1 + 48, "{printed}");
    assert_eq!(rows[0]["passed"], true, "{printed}");
    for row in &rows[1..] {
        assert!((row["value"].as_f64().unwrap() - 1.0).abs() < 0.02, "{row}");
        assert_eq!(row["passed"], true);
    }
}

#[test]
fn wrong_input_is_refused() {
    let program = Program::new();
    program.refuse("validate --suite rico", &["--reference", "rico32_cloud.nc"]);
    program.refuse("validate --suite rico --reference nowhere", &["nowhere", "rico32_cloud.nc"]);
    std::fs::write(program.path("rico32_cloud.nc"), "not an HDF5 file").unwrap();
    program.refuse("validate --suite rico --reference .", &["rico32_cloud.nc", "HDF5"]);
}
