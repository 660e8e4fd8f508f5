use crate::program::Program;

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
