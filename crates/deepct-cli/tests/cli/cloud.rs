use crate::program::Program;
use deepct_core::io::{read_cloud, read_grid};
use std::path::PathBuf;

/// The path of a small simulation written by the netCDF library (see les.py in the same folder).
fn simulation(name: &str) -> String {
    let fixtures = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../deepct-core/tests/fixtures");
    fixtures.join(name).canonicalize().unwrap().display().to_string()
}

#[test]
fn the_same_seed_writes_the_same_file_for_any_number_of_threads() {
    let program = Program::new();
    let printed = program.succeed("cloud generate --kind cumulus --seed 3 --threads 1 --out a.nc");
    assert!(printed.contains("32 x 32 x 32 of 50 x 50 x 40 m"), "{printed}");
    program.succeed("cloud generate --seed 3 --threads 3 --out b.nc --quiet");
    program.succeed("cloud generate --seed 4 --out c.nc --quiet");
    let bytes = ["a.nc", "b.nc", "c.nc"].map(|name| std::fs::read(program.path(name)).unwrap());
    assert!(bytes[0] == bytes[1], "the number of threads changed the file");
    assert!(bytes[0] != bytes[2], "another seed made the same file");
}

#[test]
fn printed_defaults_are_the_defaults_and_settings_replace_them() {
    let program = Program::new();
    for kind in ["cumulus", "field"] {
        let defaults = program.succeed(&format!("config cloud-{kind}"));
        std::fs::write(program.path("settings.toml"), defaults).unwrap();
        let make = format!("cloud generate --kind {kind} --seed 2 --quiet");
        program.succeed(&format!("{make} --out a.nc"));
        program.succeed(&format!("{make} --config settings.toml --out b.nc"));
        let cloud = read_cloud(program.path("a.nc")).unwrap();
        assert_eq!(cloud, read_cloud(program.path("b.nc")).unwrap());
        program.succeed(&format!("{make} --set droplets_per_cm3=300 --out c.nc"));
        assert_ne!(cloud, read_cloud(program.path("c.nc")).unwrap());
    }
    program.succeed("cloud generate --set shape=[20,24,28] --set width_km=0.5 --out d.nc");
    assert_eq!(read_grid(program.path("d.nc")).unwrap().shape, [20, 24, 28]);
}

#[test]
fn a_simulation_is_imported() {
    let program = Program::new();
    let file = simulation("cf.nc");
    program.succeed(&format!("cloud import {file} --time 1 --crop 8,0,4,3 --out C.nc"));
    let cloud = read_cloud(program.path("C.nc")).unwrap();
    assert_eq!(cloud.grid.shape, [6, 3, 4]);
    let water = cloud.microphysics.unwrap().liquid_water_content;
    // The formula of the fixture at time 1; the third column is the file's first.
    for ((k, j, i), value) in water.indexed_iter() {
        let expected = ((7 + 5 * k + 3 * j + 2 * ((i + 8) % 10)) % 13) as f32 * 0.1;
        assert!((value - expected).abs() < 2e-6);
    }
    let window = "--base 0.42 --levels 2 --spacing 0.1,0.1,0.08";
    program.succeed(&format!("cloud import {file} {window} --droplets 70 --out D.nc"));
    assert_eq!(read_grid(program.path("D.nc")).unwrap().shape, [2, 4, 5]);
    let mixing = simulation("mixing.nc");
    program.succeed(&format!("cloud import {mixing} --spacing file --out E.nc"));
    assert_eq!(read_grid(program.path("E.nc")).unwrap().shape, [5, 4, 6]);
}

#[test]
fn units_can_be_stated_and_are_recorded() {
    let program = Program::new();
    // The fixture is a mixing ratio in g/kg with a density of air.
    let file = simulation("mixing.nc");
    let import = format!("cloud import {file} --spacing 0.025,0.025,0.04");
    program.succeed(&format!("{import} --out a.nc"));
    program.succeed(&format!("{import} --units QC=g/kg --units RHO=kg.m-3 --out b.nc"));
    assert_eq!(
        read_cloud(program.path("a.nc")).unwrap(),
        read_cloud(program.path("b.nc")).unwrap()
    );
    program.succeed(&format!("{import} --units QC=g/m3 --out c.nc"));
    let water = |name| {
        let cloud = read_cloud(program.path(name)).unwrap();
        f64::from(cloud.microphysics.unwrap().liquid_water_content[[0, 0, 1]])
    };
    // The density of the lowest level is 1.2 kg/m3.
    assert!((water("a.nc") / water("c.nc") - 1.2).abs() < 1e-6);
    program.refuse(
        &format!("{import} --units QC=kg/kg --out d.nc"),
        &["mixing.nc", "g m-3", "--units"],
    );
    program.refuse(&format!("{import} --units QX=g/kg --out d.nc"), &["QX", "is missing"]);
    program.refuse(&format!("{import} --units QC=kilos --out d.nc"), &["QC", "kilos"]);
    program.refuse(&format!("{import} --units RHO=Pa --out d.nc"), &["RHO", "Pa", "--air-density"]);
    let run = program.run(&format!("{import} --units QC --out d.nc"));
    assert!(run.code == 2 && run.stderr.contains("ql=kg kg-1"), "{}", run.stderr);
}

#[test]
fn implausible_clouds_are_refused_unless_allowed() {
    let program = Program::new();
    let text = "# a cloud\n2 2 2\n0.05 0.05 0.5 0.54\n0 0 0 30.0 20.0\n0 0 1 0.2 20.0\n";
    std::fs::write(program.path("C.txt"), text).unwrap();
    let import = "cloud import C.txt --spacing file --out C.nc";
    program.refuse(import, &["C.txt", "30 g m-3", "[z 0, y 0, x 0]", "--allow-implausible"]);
    let run = program.run(&format!("{import} --allow-implausible"));
    assert!(run.code == 0 && run.stderr.contains("warning: C.txt"), "{}", run.stderr);
    let render = "render C.nc --views cloudct-10 --samples 2 --out I.nc";
    program.refuse(render, &["C.nc", "30 g m-3", "--allow-implausible"]);
    let run = program.run(&format!("{render} --allow-implausible"));
    assert!(run.code == 0 && run.stderr.contains("warning: C.nc"), "{}", run.stderr);
}

#[test]
fn isolated_clouds_are_written_one_by_one() {
    let program = Program::new();
    program.succeed("cloud generate --kind field --seed 5 --out field.nc --quiet");
    let printed = program.succeed("cloud import field.nc --isolate 32 --out clouds");
    let line = printed.lines().find(|line| line.contains(" clouds in ")).unwrap();
    let count: usize = line.split_whitespace().next().unwrap().parse().unwrap();
    assert!(count >= 3, "{printed}");
    let files = std::fs::read_dir(program.path("clouds")).unwrap();
    let clouds: Vec<_> = files.map(|file| read_cloud(file.unwrap().path()).unwrap()).collect();
    assert_eq!(clouds.len(), count);
    for cloud in clouds {
        assert_eq!(cloud.grid.shape, [36, 32, 32]);
        let water = cloud.microphysics.unwrap().liquid_water_content;
        let edge = water
            .indexed_iter()
            .filter(|((_, j, i), _)| [0, 31].contains(j) || [0, 31].contains(i));
        assert!(water.sum() > 0.0 && edge.map(|(_, water)| water).sum::<f32>() == 0.0);
    }
}

#[test]
fn wrong_input_is_refused() {
    let program = Program::new();
    let file = simulation("cf.nc");
    for (set, words) in [
        ("widht_km=1", ["widht_km", "config"]),
        ("shape=[1,2]", ["--set", "length"]),
        ("width_km=3", ["width_km", "grid"]),
        ("turbulence=-1", ["turbulence", "between 0 and 1"]),
    ] {
        program.refuse(&format!("cloud generate --set {set} --out C.nc"), &words);
    }
    program.refuse("cloud generate --config none.toml --out C.nc", &["none.toml"]);
    program.refuse("cloud generate --out no/such/folder/C.nc", &["no/such/folder/C.nc"]);
    program.refuse("cloud import none.nc --out C.nc", &["none.nc", "does not exist"]);
    program.refuse(&format!("cloud import {file} --time 9 --out C.nc"), &["cf.nc", "--time"]);
    program.refuse(&format!("cloud import {file} --crop 0,0,99,1 --out C.nc"), &["crop", "10 x 8"]);
    program.refuse(&format!("cloud import {file} --droplets 0 --out C.nc"), &["droplet"]);
    program.refuse(&format!("cloud import {file} --isolate 32 --out d"), &["isolated", "32"]);
    let ratio = simulation("mixing.nc");
    program.refuse(&format!("cloud import {ratio} --variable RHO --out C.nc"), &["RHO", "axis"]);
    let whole = std::fs::read(&file).unwrap();
    std::fs::write(program.path("cut.nc"), &whole[..whole.len() / 2]).unwrap();
    program.refuse("cloud import cut.nc --out C.nc", &["cut.nc", "truncated"]);
    std::fs::write(program.path("words.txt"), "no cloud at all\n").unwrap();
    program.refuse("cloud import words.txt --out C.nc", &["words.txt", "line 1"]);
}

#[test]
fn formats_are_listed() {
    let printed = Program::new().succeed("formats");
    for name in ["lwc", "pySHDOM", "AT3D", "netCDF-4", "OpenEXR", "safetensors"] {
        assert!(printed.contains(name), "no {name}");
    }
}
