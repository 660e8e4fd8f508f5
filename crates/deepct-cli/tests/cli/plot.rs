use crate::program::Program;
use deepct_core::grid::{Grid, Volume};
use deepct_core::image::ViewStack;
use deepct_core::io::{Provenance, write_observation, write_volume};
use deepct_core::math::DVec3;
use deepct_core::scene::{Formation, Observation, Sun};
use ndarray::Array3;

fn scene(program: &Program) {
    let provenance = Provenance {
        title: "A test".into(),
        configuration: String::new(),
        seed: 0,
        ..Provenance::default()
    };
    let volume = |shape: [usize; 3]| {
        let grid = Grid::new(DVec3::ZERO, DVec3::splat(0.05), shape).unwrap();
        let values = Array3::from_shape_fn(shape, |(k, j, i)| (k * j * i) as f32);
        Volume::new(grid, values).unwrap()
    };
    write_volume(program.path("V.nc"), &volume([8, 9, 10]), &provenance).unwrap();
    write_volume(program.path("flat.nc"), &volume([2, 9, 10]), &provenance).unwrap();
    let views = Formation::cloudct_10().views(DVec3::ONE, [6, 7]).unwrap();
    let images = ViewStack::new(Array3::from_elem((10, 6, 7), 0.1)).unwrap();
    let observation = Observation::new(Sun::default(), views, images).unwrap();
    write_observation(program.path("I.nc"), &observation, &provenance).unwrap();
}

/// Reads the width and height from the header of a PNG file.
fn size(program: &Program, name: &str) -> [u32; 2] {
    let bytes = std::fs::read(program.path(name)).unwrap();
    assert_eq!(&bytes[..8], b"\x89PNG\r\n\x1a\n");
    [16, 20].map(|at| u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap()))
}

#[test]
fn volumes_and_images_become_pictures() {
    let program = Program::new();
    scene(&program);
    program.succeed("plot V.nc --out alone.png");
    program.succeed("plot V.nc --truth V.nc --title Twins --out pair.png");
    program.succeed("plot I.nc --out sheet.png");
    let ([width, alone], [same_width, pair]) =
        (size(&program, "alone.png"), size(&program, "pair.png"));
    assert!(width == same_width && pair > alone + 400, "{alone} {pair}");
    let [wide, high] = size(&program, "sheet.png");
    assert!(wide > 5 * 176 && high > 2 * 150 && wide > high);
}

#[test]
fn wrong_input_is_refused() {
    let program = Program::new();
    scene(&program);
    std::fs::write(program.path("text.nc"), "not an HDF5 file").unwrap();
    program.refuse("plot none.nc --out a.png", &["none.nc"]);
    program.refuse("plot text.nc --out a.png", &["text.nc", "HDF5"]);
    program.refuse("plot V.nc --out a.jpg", &["--out", "a.jpg", ".png"]);
    program.refuse("plot V.nc --truth flat.nc --out a.png", &["V.nc", "same grid"]);
    program.refuse("plot I.nc --truth V.nc --out a.png", &["I.nc", "--truth"]);
    program.refuse("plot V.nc --out nowhere/a.png", &["nowhere"]);
}
