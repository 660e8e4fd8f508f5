//! Runs that are interrupted, and outputs that are closed or full.

use crate::program::Program;
use std::fs::read;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Starts a command line whose outputs are not read.
fn start(program: &Program, arguments: &str) -> Child {
    program.command(arguments).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}

/// Sends a signal by name to a program.
fn send(child: &Child, signal: &str) {
    let sent = Command::new("kill").args([&format!("-{signal}"), &child.id().to_string()]).status();
    assert!(sent.unwrap().success());
}

/// A command that would run for minutes ends within seconds after Ctrl-C, with the status of an
/// interruption.
#[test]
fn ctrl_c_ends_long_commands() {
    let program = Program::new();
    program.succeed("cloud generate --seed 5 --out cloud.nc");
    program.succeed("render cloud.nc --views cloudct-10 --samples 16 --out images.nc");
    for arguments in [
        "render cloud.nc --views cloudct-10 --samples 1000000 --out a.nc",
        "render cloud.nc --views cloudct-10 --samples 2 --fluxes=100000000000 --out b.nc",
        "render cloud.nc --views pearls-32 --solver ordinates --accuracy 0.003 --out c.nc",
        "invert images.nc --grid cloud.nc --out d.nc --set inversion.misfit=0",
    ] {
        let mut child = start(&program, arguments);
        std::thread::sleep(Duration::from_millis(1500));
        let pressed = Instant::now();
        send(&child, "INT");
        let status = child.wait().unwrap();
        assert_eq!(status.code(), Some(130), "{arguments}");
        // One second on an idle machine.
        assert!(pressed.elapsed() < Duration::from_secs(5), "{arguments}: {:?}", pressed.elapsed());
    }
    let left: Vec<_> =
        program.files().into_iter().filter(|name| name.contains(".partial")).collect();
    assert!(left.is_empty(), "{left:?}");
}

/// An inversion that is killed twice and resumed has the extinction of one that was not.
#[test]
fn a_killed_inversion_resumes_with_the_same_bits() {
    let program = Program::new();
    program.succeed("cloud generate --seed 5 --set width_km=0.4 --out cloud.nc");
    program.succeed("render cloud.nc --views cloudct-10 --samples 64 --out images.nc");
    let command = |out: &str| {
        format!(
            "-q invert images.nc --grid cloud.nc --iterations 12 --set inversion.misfit=0 --out {out}"
        )
    };
    program.succeed(&command("whole.nc"));
    for milliseconds in [700, 1500] {
        let mut child = start(&program, &(command("part.nc") + " --resume"));
        std::thread::sleep(Duration::from_millis(milliseconds));
        // It may have ended already on a fast machine.
        let _ = child.kill();
        child.wait().unwrap();
    }
    program.succeed(&(command("part.nc") + " --resume"));
    let scores = program.succeed("score part.nc --truth whole.nc");
    assert!(scores.contains("0.0000") && !scores.contains("NaN"), "{scores}");
    let extinction = |name: &str| deepct_core::io::read_volume(program.path(name)).unwrap().values;
    assert_eq!(extinction("part.nc"), extinction("whole.nc"));
}

/// A checkpoint does not fit images whose values have changed.
#[test]
fn a_checkpoint_of_other_images_is_refused() {
    let program = Program::new();
    program.succeed("cloud generate --seed 5 --set width_km=0.4 --out cloud.nc");
    program.succeed("render cloud.nc --views cloudct-10 --samples 16 --out images.nc");
    let arguments = "invert images.nc --grid cloud.nc --set inversion.misfit=0 --out v.nc --resume";
    let mut child = start(&program, arguments);
    while !program.path("v.nc.checkpoint").exists() {
        std::thread::sleep(Duration::from_millis(20));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let kept = read(program.path("v.nc.checkpoint")).unwrap();
    program.succeed("render cloud.nc --views cloudct-10 --samples 16 --seed 2 --out images.nc");
    let run = program.run(arguments);
    assert_eq!(run.code, 2, "{}", run.stderr);
    assert!(run.stderr.contains("other images or settings"), "{}", run.stderr);
    assert_eq!(read(program.path("v.nc.checkpoint")).unwrap(), kept);
}

/// The files of a computation are written, whether its text can be printed or not.
#[cfg(target_os = "linux")]
#[test]
fn a_closed_or_full_output_loses_nothing() {
    let program = Program::new();
    program.succeed("cloud generate --seed 3 --out cloud.nc");
    let arguments = "render cloud.nc --views cloudct-10 --samples 2 --out";
    let full = || std::fs::File::options().write(true).open("/dev/full").unwrap();
    let mut command = program.command(&format!("{arguments} full.nc"));
    let status = command.stdout(full()).stderr(full()).status().unwrap();
    assert_eq!(status.code(), Some(2));
    let mut command = program.command(&format!("{arguments} closed.nc"));
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    drop(child.stderr.take());
    assert_eq!(child.wait().unwrap().code(), Some(0));
    for name in ["full.nc", "closed.nc"] {
        program.succeed(&format!("plot {name} --out {name}.png"));
    }
}

/// A link is followed: the file that it names is replaced, and the link stays.
#[test]
fn an_output_that_is_a_link_is_followed() {
    let program = Program::new();
    std::fs::create_dir(program.path("folder")).unwrap();
    std::os::unix::fs::symlink("folder/cloud.nc", program.path("link.nc")).unwrap();
    for seed in [1, 2] {
        program.succeed(&format!("cloud generate --seed {seed} --out link.nc"));
        assert!(program.path("link.nc").is_symlink() && program.path("folder/cloud.nc").is_file());
    }
}
