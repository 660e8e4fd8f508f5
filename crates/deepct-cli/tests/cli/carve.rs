use crate::program::Program;
use deepct_core::grid::{Grid, Volume};
use deepct_core::image::ViewStack;
use deepct_core::io::{Provenance, read_mask, write_observation, write_volume};
use deepct_core::math::DVec3;
use deepct_core::scene::{Formation, Observation, Sun};
use ndarray::Array3;

/// Writes images in which the central four pixels of every view are bright, and a volume on a grid
/// whose centre the cameras point at. Returns the grid.
fn scene(program: &Program) -> Grid {
    let grid = Grid::new(DVec3::ZERO, DVec3::splat(0.05), [8, 8, 8]).unwrap();
    let views = Formation::cloudct_10().views(grid.center(), [16, 16]).unwrap();
    let radiance = Array3::from_shape_fn((10, 16, 16), |(_, row, col)| {
        if (7..9).contains(&row) && (7..9).contains(&col) { 0.2 } else { 0.014 }
    });
    let observation =
        Observation::new(Sun::default(), views, ViewStack::new(radiance).unwrap()).unwrap();
    let provenance = Provenance {
        title: "A test".into(),
        configuration: String::new(),
        seed: 0,
        ..Provenance::default()
    };
    write_observation(program.path("N.nc"), &observation, &provenance).unwrap();
    write_volume(program.path("C.nc"), &Volume::constant(grid, 1.0), &provenance).unwrap();
    grid
}

#[test]
fn the_middle_is_kept() {
    let program = Program::new();
    let grid = scene(&program);
    let printed = program.succeed("carve N.nc --grid C.nc --agreement 1 --out M.nc");
    let threshold: f32 =
        printed.lines().next().unwrap().split_whitespace().nth(1).unwrap().parse().unwrap();
    assert!(0.014 < threshold && threshold < 0.2, "{printed}");
    let mask = read_mask(program.path("M.nc")).unwrap();
    assert!(mask.grid.matches(&grid));
    assert!(mask.values[[3, 3, 3]] && mask.values[[4, 4, 4]]);
    assert!(!mask.values[[0, 0, 0]] && !mask.values[[4, 4, 7]] && mask.count() < 40);
    program.succeed("carve N.nc --grid C.nc --threshold 0.001 --out all.nc --quiet");
    assert_eq!(read_mask(program.path("all.nc")).unwrap().count(), grid.len());
}

#[test]
fn wrong_input_is_refused() {
    let program = Program::new();
    scene(&program);
    std::fs::write(program.path("bad.toml"), "orign = [0, 0, 0]\n").unwrap();
    program.refuse("carve none.nc --grid C.nc --out M.nc", &["none.nc"]);
    program.refuse("carve C.nc --grid C.nc --out M.nc", &["C.nc", "radiance"]);
    program.refuse("carve N.nc --grid bad.toml --out M.nc", &["bad.toml", "orign"]);
    program.refuse("carve N.nc --grid C.nc --agreement 1.5 --out M.nc", &["agreement", "1.5"]);
    program.refuse("carve N.nc --grid C.nc --threshold nan --out M.nc", &["threshold"]);
}
