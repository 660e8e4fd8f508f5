//! Tests of what all verbs share: common options, help, settings, manual pages, completions.

use crate::program::Program;

/// The verbs that `deepct --help` lists.
fn verbs(program: &Program) -> Vec<String> {
    let help = program.succeed("--help");
    let (_, list) = help.split_once("Commands:\n").unwrap();
    let (list, _) = list.split_once("\n\n").unwrap();
    let first = |line: &str| line.split_whitespace().next().unwrap().to_owned();
    // Continuation lines of a description have a larger indent.
    list.lines().filter(|line| !line.starts_with("   ")).map(first).collect()
}

#[test]
fn every_verb_has_a_help_that_tells_its_own_options_from_the_common_ones() {
    let program = Program::new();
    let verbs = verbs(&program);
    assert!(verbs.iter().any(|verb| verb == "render"), "{verbs:?}");
    for verb in verbs.iter().filter(|verb| *verb != "help") {
        let help = program.succeed(&format!("{verb} --help"));
        let (own, common) = help.split_once("Options of every verb:").unwrap();
        assert!(common.contains("--threads") && !own.contains("--threads"), "{verb}: {help}");
    }
}

#[test]
fn there_is_a_manual_page_for_every_verb_and_a_completion_for_every_shell() {
    let program = Program::new();
    program.succeed("man --out pages");
    for verb in verbs(&program).iter().filter(|verb| *verb != "help") {
        let page = std::fs::read_to_string(program.path(&format!("pages/deepct-{verb}.1")));
        assert!(page.unwrap().contains(".SH SYNOPSIS"), "{verb}");
    }
    for shell in ["bash", "fish", "zsh"] {
        assert!(program.succeed(&format!("completions {shell}")).contains("render"));
    }
}

#[test]
fn more_threads_than_any_machine_has_are_refused() {
    let program = Program::new();
    program.refuse("--threads 100000 formats", &["--threads", "100000", "1024"]);
    program.succeed("--threads 2 formats");
}

#[test]
fn settings_are_printed_by_verb() {
    let program = Program::new();
    assert!(program.succeed("config cloud-cumulus").contains("width_km"));
    let run = program.run("config cloud");
    assert!(run.code == 2 && run.stderr.contains("cloud-cumulus"), "{}", run.stderr);
    let wrong = "cloud generate --set widht_km=1 --out c.nc";
    program.refuse(wrong, &["widht_km", "deepct config cloud-cumulus"]);
}
