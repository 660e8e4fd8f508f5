use crate::program::Program;
use deepct_core::image::ViewStack;
use deepct_core::io::{Provenance, read_observation, write_observation};
use deepct_core::math::DVec3;
use deepct_core::scene::{Formation, Observation, Sun};
use ndarray::Array3;

/// Writes ten views of 8 x 8 pixels with a radiance that increases to the east, multiplied by
/// `sign`.
fn images(program: &Program, name: &str, sign: f32) {
    let views = Formation::cloudct_10().views(DVec3::new(0.2, 0.2, 1.0), [8, 8]).unwrap();
    let radiance =
        Array3::from_shape_fn((10, 8, 8), |(_, _, col)| sign * 0.03 * (col as f32 + 1.0));
    let images = ViewStack::new(radiance).unwrap();
    let observation = Observation::new(Sun::default(), views, images).unwrap();
    let provenance = Provenance {
        title: "A test".into(),
        configuration: String::new(),
        seed: 0,
        ..Provenance::default()
    };
    write_observation(program.path(name), &observation, &provenance).unwrap();
}

#[test]
fn noise_is_that_of_the_sensor_and_of_the_seed() {
    let program = Program::new();
    images(&program, "I.nc", 1.0);
    program.succeed("sense I.nc --out N.nc --seed 5");
    program.succeed("sense I.nc --out same.nc --seed 5 --threads 1");
    program.succeed("sense I.nc --out other.nc --seed 6");
    let read = |name: &str| read_observation(program.path(name)).unwrap();
    let (clean, noisy) = (read("I.nc"), read("N.nc"));
    assert_eq!(noisy, read("same.nc"));
    assert_ne!(noisy, read("other.nc"));
    assert_eq!((&clean.views, &clean.light), (&noisy.views, &noisy.light));
    let deviation = noisy.standard_error.unwrap().values;
    for ((at, noisy), clean) in noisy.images.values.indexed_iter().zip(&clean.images.values) {
        assert!((noisy - clean).abs() < 6.0 * deviation[at], "{at:?}");
    }
}

#[test]
fn a_sensor_of_a_file_and_a_scale() {
    let program = Program::new();
    images(&program, "I.nc", 1.0);
    let sensor = "full_well = 1e9\nread_noise = 0.0\ndark_current = 0.0\nbits = 24\n\
                  exposure = 1.0\npixel_pitch = 5.0\n";
    std::fs::write(program.path("good.toml"), sensor).unwrap();
    let printed = program.succeed("sense I.nc --sensor good.toml --scale 4e9 --out N.nc");
    assert!(printed.contains("4.000000e9 electrons"), "{printed}");
    let read = |name: &str| read_observation(program.path(name)).unwrap().images.values;
    for (noisy, clean) in read("N.nc").iter().zip(&read("I.nc")) {
        assert!((noisy / clean - 1.0).abs() < 1e-3, "{noisy} {clean}");
    }
}

#[test]
fn wrong_input_is_refused() {
    let program = Program::new();
    images(&program, "I.nc", 1.0);
    images(&program, "negative.nc", -1.0);
    std::fs::write(program.path("bad.toml"), "full_well = 1e4\nwell = 3\n").unwrap();
    std::fs::write(program.path("text.nc"), "not an HDF5 file").unwrap();
    program.refuse("sense none.nc --out N.nc", &["none.nc"]);
    program.refuse("sense text.nc --out N.nc", &["text.nc", "HDF5"]);
    program.refuse("sense negative.nc --out N.nc", &["negative.nc", "radiance", "not negative"]);
    program.refuse("sense I.nc --sensor bad.toml --out N.nc", &["bad.toml", "well"]);
    program.refuse("sense I.nc --sensor ccd --out N.nc", &["--sensor", "ccd", "cmv4000"]);
    program.refuse("sense I.nc --scale -3 --out N.nc", &["--scale"]);
    program.refuse("sense I.nc --scale 0 --out N.nc", &["--scale", "positive"]);
    program.refuse("sense I.nc --out nowhere/N.nc", &["nowhere"]);
}
