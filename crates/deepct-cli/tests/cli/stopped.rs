//! Runs that are interrupted, and outputs that are closed, full, or written by several runs.

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
    let extinction = |name: &str| deepct_core::io::read_volume(program.path(name)).unwrap().values;
    for verb in ["invert", "hybrid"] {
        let command = |out: &str| {
            format!(
                "-q {verb} images.nc --grid cloud.nc --iterations 12 --set inversion.misfit=0 \
                 --out {out}"
            )
        };
        program.succeed(&command("whole.nc"));
        let resumed = command("part.nc") + " --resume";
        kill(&program, &resumed, &[700, 1500]);
        program.succeed(&resumed);
        assert!(extinction("part.nc") == extinction("whole.nc"), "{verb}");
        std::fs::remove_file(program.path("part.nc")).unwrap();
    }
}

/// Starts a command several times and kills it after some milliseconds. It may have ended already on
/// a fast machine.
fn kill(program: &Program, arguments: &str, moments: &[u64]) {
    for milliseconds in moments {
        let mut child = start(program, arguments);
        std::thread::sleep(Duration::from_millis(*milliseconds));
        let _ = child.kill();
        child.wait().unwrap();
    }
}

/// An experiment that is killed and continued has the results of one that was not.
#[test]
fn a_killed_experiment_continues_with_the_same_results() {
    let program = Program::new();
    let shape = "--set shape=[12,16,16] --set width_km=0.4 --set depth_km=0.2";
    program.succeed(&format!("cloud generate --seed 5 {shape} --out cloud.nc"));
    let settings = "clouds = [\"cloud.nc\"]\ngenerated = 0\nweights = \"general\"\n\
                    formation = \"cloudct-10\"\nsamples_per_pixel = 32\nquick_iterations = 2\n\
                    [inversion]\niterations = 4\n";
    std::fs::write(program.path("settings.toml"), settings).unwrap();
    let command = |out: &str| format!("-q experiment settings.toml --out {out}");
    program.succeed(&command("whole"));
    kill(&program, &command("part"), &[200, 1000, 2000]);
    program.succeed(&command("part"));
    for method in ["network", "physics", "hybrid", "quick-hybrid"] {
        let volume = |run: &str| {
            let path = program.path(&format!("{run}/volumes/cloud-{method}.nc"));
            deepct_core::io::read_volume(path).unwrap()
        };
        assert!(volume("part") == volume("whole"), "{method}");
        let result = |run: &str| {
            let text = read(program.path(&format!("{run}/results/cloud-{method}.json"))).unwrap();
            let lines = String::from_utf8(text).unwrap();
            let timeless = lines.lines().filter(|line| !line.contains("seconds"));
            timeless.map(str::to_owned).collect::<Vec<_>>()
        };
        assert_eq!(result("part"), result("whole"), "{method}");
    }
}

/// Images of an interrupted rendering, and the extinction of an interrupted inversion, are marked as
/// incomplete; every command that reads them warns.
#[test]
fn what_is_incomplete_is_marked() {
    let program = Program::new();
    let shape = "--set shape=[16,16,16] --set width_km=0.4 --set depth_km=0.3";
    program.succeed(&format!("cloud generate --seed 5 {shape} --out cloud.nc"));
    program.succeed("render cloud.nc --views cloudct-10 --samples 64 --out images.nc");
    for (arguments, out, readers) in [
        (
            "render cloud.nc --views cloudct-10 --noise 0.00001 --out part.nc",
            "part.nc",
            ["sense part.nc --out noisy.nc", "plot noisy.nc --out noisy.png"],
        ),
        (
            "invert images.nc --grid cloud.nc --iterations 100000 --set inversion.change=0 --out v.nc",
            "v.nc",
            ["score v.nc --truth cloud.nc", "plot v.nc --out v.png"],
        ),
    ] {
        let mut child = start(&program, arguments);
        std::thread::sleep(Duration::from_millis(2500));
        send(&child, "INT");
        assert_eq!(child.wait().unwrap().code(), Some(130), "{arguments}");
        let lacking = deepct_core::io::incomplete(program.path(out)).expect(arguments);
        assert!(lacking.contains("interrupted"), "{lacking}");
        for reader in readers {
            let run = program.run(reader);
            assert_eq!(run.code, 0, "{reader}: {}", run.stderr);
            let file = reader.split(' ').nth(1).unwrap();
            let warning = format!("deepct: warning: {file} is incomplete: the ");
            assert!(run.stderr.contains(&warning), "{reader}: {}", run.stderr);
        }
    }
    assert_eq!(deepct_core::io::incomplete(program.path("images.nc")), None);
    assert_eq!(deepct_core::io::incomplete(program.path("cloud.nc")), None);
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

/// The program with a limit of 4 kB on the size of files, which stands for a full disk: writing
/// beyond it fails in the same way.
#[cfg(target_os = "linux")]
fn on_a_full_disk(program: &Program, arguments: &str) -> std::process::Output {
    let wanted = program.command(arguments);
    let mut command = Command::new("sh");
    command
        .args(["-c", "trap '' XFSZ; ulimit -f 8; exec \"$0\" \"$@\""])
        .arg(wanted.get_program())
        .args(wanted.get_args())
        .current_dir(program.path("."))
        .env("HDF5_USE_FILE_LOCKING", "FALSE");
    command.output().unwrap()
}

/// On a full disk, a command ends with one message that names its output. It leaves no file, and
/// an output that existed remains as it was.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_reported_and_loses_nothing() {
    let program = Program::new();
    program.succeed("cloud generate --seed 5 --out cloud.nc");
    program.succeed("render cloud.nc --views cloudct-10 --samples 4 --out images.nc");
    program.succeed("infer images.nc --out volume.nc");
    let grid = "--set width_km=0.4";
    for (arguments, out) in [
        (format!("cloud generate --seed 6 {grid} --out"), "cloud.nc"),
        ("render cloud.nc --views cloudct-10 --samples 2 --out".into(), "images.nc"),
        ("render cloud.nc --views cloudct-10 --samples 2 --out".into(), "images.exr"),
        ("sense images.nc --out".into(), "noisy.nc"),
        ("carve images.nc --grid cloud.nc --out".into(), "mask.nc"),
        ("infer images.nc --out".into(), "volume.nc"),
        ("plot cloud.nc --out".into(), "cloud.png"),
        ("invert images.nc --grid cloud.nc --iterations 1 --out".into(), "volume.nc"),
    ] {
        let before: Vec<_> =
            program.files().into_iter().map(|name| read(program.path(&name)).unwrap()).collect();
        let names = program.files();
        let run = on_a_full_disk(&program, &format!("--quiet {arguments} {out}"));
        let text = String::from_utf8(run.stderr).unwrap();
        assert_eq!(run.status.code(), Some(2), "{arguments} {out}: {text}");
        let errors: Vec<_> = text.lines().filter(|line| !line.contains("warning: ")).collect();
        assert!(errors.len() == 1 && errors[0].contains(out), "{arguments}: {text}");
        assert_eq!(program.files(), names, "{arguments} {out}");
        let after = names.iter().map(|name| read(program.path(name)).unwrap());
        assert!(after.eq(before), "{arguments} {out}");
    }
}

/// Several runs that write the same file at the same time leave the complete file of one of them.
#[test]
fn several_runs_can_write_one_file() {
    let program = Program::new();
    program.succeed("cloud generate --seed 5 --set width_km=0.4 --out cloud.nc");
    let render = |seed: u64, out: &str| {
        format!("render cloud.nc --views cloudct-10 --samples 4 --seed {seed} --out {out}")
    };
    let images = |name: &str| deepct_core::io::read_observation(program.path(name)).unwrap().images;
    let seeds = [1, 2, 3, 4];
    let runs = seeds.map(|seed| start(&program, &render(seed, "one.nc")));
    for mut run in runs {
        assert_eq!(run.wait().unwrap().code(), Some(0));
    }
    let alone = seeds.map(|seed| {
        program.succeed(&render(seed, "alone.nc"));
        images("alone.nc")
    });
    assert!(alone.contains(&images("one.nc")));
    assert_eq!(program.files(), ["alone.nc", "cloud.nc", "one.nc"]);
}

/// The names and the contents of the files of a data set, without the manifest, whose provenance
/// differs.
fn samples(program: &Program, folder: &str) -> Vec<(String, Vec<u8>)> {
    let entries = std::fs::read_dir(program.path(folder).join("samples")).unwrap();
    let mut files: Vec<_> = entries
        .map(|entry| entry.unwrap())
        .map(|entry| (entry.file_name().into_string().unwrap(), read(entry.path()).unwrap()))
        .collect();
    files.sort();
    files
}

/// A data set that several runs make at the same time, and that is killed and continued, has the
/// bytes of one that a single run makes.
#[test]
fn a_data_set_has_the_same_bytes_whoever_makes_it() {
    let program = Program::new();
    program.succeed("cloud generate --kind field --seed 3 --out field.nc");
    let settings = "formation = \"cloudct-10\"\ncolumns = 24\n[[sources]]\nfile = \"field.nc\"\n\
                    split = \"train\"\nfirst = 0\nlast = 0\nevery = 1\nclouds = 3\n";
    std::fs::write(program.path("set.toml"), settings).unwrap();
    let generate = |folder: &str| format!("--quiet dataset generate set.toml --out {folder}");
    program.succeed(&generate("alone"));
    let runs = [(); 3].map(|()| start(&program, &generate("together")));
    for mut run in runs {
        assert_eq!(run.wait().unwrap().code(), Some(0));
    }
    kill(&program, &generate("killed"), &[50, 400, 1200]);
    program.succeed(&generate("killed"));
    let expected = samples(&program, "alone");
    assert_eq!(expected.len(), 3);
    assert!(samples(&program, "together") == expected);
    let killed: Vec<_> = samples(&program, "killed")
        .into_iter()
        .filter(|(name, _)| name.ends_with(".nc") && !name.starts_with('.'))
        .collect();
    assert!(killed == expected);
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
