use crate::program::Program;
use deepct_core::grid::{Grid, Mask, Volume};
use deepct_core::image::ViewStack;
use deepct_core::io::{Provenance, write_estimate, write_mask, write_observation, write_volume};
use deepct_core::math::DVec3;
use deepct_core::network::Estimate;
use deepct_core::scene::{Formation, Light, Observation, Sun};
use ndarray::Array3;

pub(crate) fn scene(program: &Program) {
    let provenance = Provenance { title: "A test".into(), ..Provenance::default() };
    let volume = |shape: [usize; 3]| {
        let grid = Grid::new(DVec3::ZERO, DVec3::splat(0.05), shape).unwrap();
        let values = Array3::from_shape_fn(shape, |(k, j, i)| (k * j * i) as f32);
        Volume::new(grid, values).unwrap()
    };
    write_volume(program.path("V.nc"), &volume([8, 9, 10]), &provenance).unwrap();
    write_volume(program.path("flat.nc"), &volume([2, 9, 10]), &provenance).unwrap();
    let grid = Grid::new(DVec3::ZERO, DVec3::splat(0.05), [8, 9, 10]).unwrap();
    let mask = Mask::new(grid, Array3::from_shape_fn(grid.shape, |(k, _, _)| k > 2)).unwrap();
    write_mask(program.path("M.nc"), &mask, &provenance).unwrap();
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
    program.succeed("plot V.nc --through 0.1,0.1,0.1 --out through.png");
    program.succeed("plot V.nc --truth V.nc --title Twins --out pair.png");
    program.succeed("plot I.nc --out sheet.png");
    let (alone, pair) = (size(&program, "alone.png"), size(&program, "pair.png"));
    assert!(pair[0] > alone[0] + 300 && pair[1] > alone[1] + 300, "{alone:?} {pair:?}");
    program.succeed("plot M.nc --out mask.png");
    program.succeed("plot M.nc --truth V.nc --out carved.png");
    let ([mask, _], [carved, _]) = (size(&program, "mask.png"), size(&program, "carved.png"));
    assert!(carved > mask + 300, "{mask} {carved}");
    let [wide, high] = size(&program, "sheet.png");
    assert!(wide > 5 * 176 && high > 2 * 150 && wide > high);
    for (name, start) in
        [("sheet.svg", "<?xml version=\"1.0\"?>\n<!-- deepct -->\n<svg"), ("sheet.PDF", "%PDF-1.7")]
    {
        program.succeed(&format!("plot I.nc --out {name}"));
        let bytes = std::fs::read(program.path(name)).unwrap();
        assert!(bytes.starts_with(start.as_bytes()), "{name}");
    }
}

#[test]
fn wrong_input_is_refused() {
    let program = Program::new();
    scene(&program);
    std::fs::write(program.path("text.nc"), "not an HDF5 file").unwrap();
    program.refuse("plot none.nc --out a.png", &["none.nc"]);
    program.refuse("plot text.nc --out a.png", &["text.nc", "HDF5"]);
    program.refuse("plot V.nc --out a.jpg", &["--out", "a.jpg", ".png, .svg or .pdf"]);
    program.refuse("images check I.nc --png a.jpg", &["--png", "a.jpg", ".png, .svg or .pdf"]);
    program.refuse("plot V.nc --truth flat.nc --out a.png", &["V.nc", "same grid"]);
    program.refuse("plot I.nc --truth V.nc --out a.png", &["I.nc", "--truth"]);
    program.refuse("plot V.nc --out nowhere/a.png", &["nowhere"]);
    program.refuse("plot M.nc --photograph --out a.png", &["M.nc", "extinction"]);
    program.refuse(
        "plot V.nc --through 0.1,0.1,-7 --out a.png",
        &["V.nc", "(x, y, z)", "in the grid"],
    );
    program.refuse("plot I.nc --through 0,0,0 --out a.png", &["I.nc", "--through"]);
    program.refuse("plot I.nc --photograph --out a.png", &["I.nc", "--photograph"]);
}

/// In both pictures a cloud is brighter than the dark surface below, and on the half of the picture
/// on which it is: in the east, which is on the right side from the south.
#[test]
fn a_photograph_shows_the_cloud_where_it_is() {
    let program = Program::new();
    let grid = Grid::new(DVec3::new(0.0, 0.0, 0.3), DVec3::splat(0.1), [4, 8, 8]).unwrap();
    let values =
        Array3::from_shape_fn(
            grid.shape,
            |(_, j, i)| {
                if i > 4 && (2..6).contains(&j) { 20.0 } else { 0.0 }
            },
        );
    let provenance = Provenance { title: "A test".into(), ..Provenance::default() };
    let volume = Volume::new(grid, values).unwrap();
    for (sun, name, is_right) in [(180.0, "south", true), (0.0, "north", false)] {
        let light = Light::from(Sun::from_degrees(40.0, sun).unwrap());
        let views = Formation::cloudct_10().views(DVec3::ONE, [4, 4]).unwrap();
        let images = ViewStack::new(Array3::from_elem((10, 4, 4), 0.1)).unwrap();
        let observation = Observation::new(light, views, images).unwrap();
        let estimate = Estimate::from(volume.clone());
        let path = program.path(&format!("{name}.nc"));
        write_estimate(path, &estimate, Some(&observation), &provenance).unwrap();
        program.succeed(&format!("plot {name}.nc --photograph --out {name}.png"));
        let (width, pixels) = pixels(&program, &format!("{name}.png"));
        let brightness = |from: usize, to: usize| -> u64 {
            let rows = pixels.chunks(width).skip(110).take(460);
            rows.flat_map(|row| &row[from..to]).map(|&value| u64::from(value)).sum()
        };
        let (left, right) = (brightness(30, width / 2), brightness(width / 2, width - 30));
        assert_eq!(right > left, is_right, "{name}: {left} {right}");
    }
}

/// The width of a picture and the red values of its pixels.
fn pixels(program: &Program, name: &str) -> (usize, Vec<u8>) {
    let picture = image::ImageReader::open(program.path(name)).unwrap().decode().unwrap().to_rgb8();
    (picture.width() as usize, picture.pixels().map(|pixel| pixel.0[0]).collect())
}
