use crate::program::Program;
use deepct_core::io::{Provenance, read_cloud, write_cloud};

const SETTINGS: &str = "formation = \"cloudct-10\"\ncolumns = 24\n\
    [[sources]]\nfile = \"field.nc\"\nsplit = \"train\"\nfirst = 0\nlast = 0\nevery = 1\n\
    clouds = 2\n";

/// A folder with the settings of a data set and the cloud field that they refer to.
fn program() -> Program {
    let program = Program::new();
    program.succeed("cloud generate --kind field --seed 3 --out field.nc");
    std::fs::write(program.path("set.toml"), SETTINGS).unwrap();
    program
}

#[test]
fn a_data_set_is_made_resumed_and_checked() {
    let program = program();
    let plan = program.succeed("dataset plan set.toml --out set");
    assert_eq!(plan, "2 train, 0 validation and 0 test samples\n");
    let one = program.succeed("dataset plan set.toml --set counts.train=1 --out one");
    assert!(one.starts_with("1 train, "), "{one}");
    let made = program.run("dataset generate set.toml --share 1/1 --out set");
    assert!(made.stdout.starts_with("2 samples, 2 of them made now"), "{}", made.stdout);
    let halfway = ["samples: 1 of 2, ", " per hour, ", " left\n", "samples: 2 of 2, "];
    assert!(halfway.iter().all(|text| made.stderr.contains(text)), "{}", made.stderr);
    program.refuse("dataset check set", &["manifest.json"]);
    let again = program.succeed("dataset generate set.toml --out set");
    assert!(again.starts_with("2 samples, 0 of them made now"), "{again}");
    let checked = program.succeed("dataset check set");
    assert_eq!(checked, "2 samples, all consistent with the manifest\n");
}

/// Replaces a cloud by one with more water.
fn moisten(program: &Program, name: &str) {
    let path = program.path(name);
    let mut cloud = read_cloud(&path).unwrap();
    let droplets = cloud.microphysics.as_mut().unwrap();
    droplets.liquid_water_content.mapv_inplace(|water| 1.5 * water);
    let provenance = Provenance {
        title: "a test".into(),
        configuration: String::new(),
        seed: 0,
        ..Provenance::default()
    };
    write_cloud(&path, &cloud, &provenance).unwrap();
}

/// A simulation that has changed since the plan was made is refused, and a sample that is cut off is
/// made again.
#[test]
fn a_data_set_knows_its_simulation_and_its_samples() {
    let program = program();
    program.succeed("dataset plan set.toml --out set");
    let field = std::fs::read(program.path("field.nc")).unwrap();
    moisten(&program, "field.nc");
    let generate = "dataset generate set.toml --quiet --out set";
    program.refuse(generate, &["field.nc", "has changed since the plan was made"]);
    std::fs::write(program.path("field.nc"), field).unwrap();
    program.succeed(generate);
    let samples = std::fs::read_dir(program.path("set/samples")).unwrap();
    let sample = samples.map(|entry| entry.unwrap().path()).next().unwrap();
    let whole = std::fs::read(&sample).unwrap();
    std::fs::write(&sample, &whole[..whole.len() / 2]).unwrap();
    let made = program.succeed(&format!("{generate} --json"));
    let made: serde_json::Value = serde_json::from_str(&made).unwrap();
    assert!(made["samples"] == 2 && made["made"] == 1, "{made}");
    assert!(std::fs::read(&sample).unwrap() == whole);
}

/// An experiment is not continued with another cloud under the same name.
#[test]
fn an_experiment_knows_its_clouds() {
    let program = Program::new();
    program.succeed("cloud generate --seed 5 --set width_km=0.4 --out cloud.nc");
    let settings = "clouds = [\"cloud.nc\"]\nmethods = [\"network\"]\nsamples_per_pixel = 4\n";
    std::fs::write(program.path("e.toml"), settings).unwrap();
    program.succeed("experiment e.toml --quiet --out E");
    program.succeed("experiment e.toml --quiet --out E");
    moisten(&program, "cloud.nc");
    program.refuse("experiment e.toml --quiet --out E", &["inputs.sha256", "clouds and weights"]);
}

#[test]
fn wrong_input_is_refused() {
    let program = program();
    let mistyped = SETTINGS.replace("columns", "colums");
    std::fs::write(program.path("mistyped.toml"), mistyped).unwrap();
    program.refuse("dataset generate mistyped.toml --out none", &["mistyped.toml", "colums"]);
    program.refuse("dataset generate missing.toml --out none", &["missing.toml"]);
    let counts = "dataset plan set.toml --quiet --set counts.test=3 --out none";
    program.refuse(counts, &["counts", "3 for test", "at most the 0"]);
    let formation = "dataset generate set.toml --set formation=ten --out none";
    program.refuse(formation, &["formation", "ten", "cloudct-10"]);
    program.refuse("dataset generate set.toml --simulations nowhere --out none", &["field.nc"]);
    program.refuse("dataset check set.toml", &["manifest.json"]);
    let share = program.run("dataset generate set.toml --share 3/2 --out none");
    assert!(share.code == 2 && share.stderr.contains("3/8"), "{}", share.stderr);
}

/// Every recipe in the repository is valid: planning fails only because the simulations, which are
/// not in the repository, are not found.
#[test]
fn recipes_that_ship_are_valid() {
    let program = Program::new();
    for name in ["bomex", "bomex-fields", "paper-main", "paper-auxiliary"] {
        let recipe = format!("{}/../../recipes/{name}.toml", env!("CARGO_MANIFEST_DIR"));
        program.refuse(
            &format!("dataset plan {recipe} --out none"),
            &["bomex_", ".nc: file: does not exist"],
        );
    }
}
