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
        let page = page.unwrap();
        for section in ["SYNOPSIS", "\"EXIT STATUS\"", "\"SEE ALSO\""] {
            assert!(page.contains(&format!(".SH {section}\n")), "{verb}: {page}");
        }
    }
    let one = program.succeed("man cloud import");
    let same = std::fs::read_to_string(program.path("pages/deepct-cloud-import.1")).unwrap();
    assert_eq!(one, same);
    assert!(one.contains("deepct cloud import LES.nc") && one.contains("fBdeepct\\-cloud\\fR(1)"));
    program.refuse("man cloud nothing", &["nothing", "generate, import"]);
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

/// A file of another program is replaced only if the user insists; one of deepct is.
#[test]
fn files_of_other_programs_are_not_replaced() {
    let program = Program::new();
    program.succeed("cloud generate --out C.nc");
    program.succeed("cloud generate --seed 2 --out C.nc");
    for (name, command) in [
        ("letter.nc", "cloud generate --out letter.nc"),
        ("letter.png", "plot C.nc --out letter.png"),
        ("letter.svg", "plot C.nc --out letter.svg"),
        ("letter.pdf", "plot C.nc --out letter.pdf"),
        ("letter.vti", "convert C.nc letter.vti"),
    ] {
        std::fs::write(program.path(name), "Dear colleague,").unwrap();
        program.refuse(command, &[name, "not a file that deepct wrote", "--force"]);
        assert_eq!(std::fs::read_to_string(program.path(name)).unwrap(), "Dear colleague,");
        program.succeed(&format!("{command} --force"));
        program.succeed(command);
    }
    program.refuse("cloud generate --out -", &["standard output", "name a file"]);
    assert!(!program.path("-").exists());
}

/// Every file states by which commands it was made.
#[test]
fn files_have_a_history() {
    let program = Program::new();
    program.succeed("cloud generate --set shape=[8,12,12] --set width_km=0.3 --out C.nc");
    program.succeed("render C.nc --views cloudct-10 --samples 2 --out I.nc");
    program.succeed("sense I.nc --out N.nc");
    program.succeed("infer N.nc --grid C.nc --out V.nc");
    let history = deepct_core::io::read_lineage(program.path("V.nc")).history;
    let commands: Vec<_> = history.lines().filter_map(|line| line.split_once(": ")).collect();
    let commands: Vec<_> = commands.into_iter().map(|(_, command)| command).collect();
    assert_eq!(commands, ["infer N.nc", "sense I.nc", "render C.nc"]);
}
