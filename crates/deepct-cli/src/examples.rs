//! Examples in the help of each verb.

use clap::Command;

/// Command lines by verb, each with what it does.
const EXAMPLES: &[(&str, &[(&str, &str)])] = &[
    (
        "cloud generate",
        &[
            (
                "a cumulus; another seed gives another one",
                "deepct cloud generate --seed 3 --out cloud.nc",
            ),
            ("a field of clouds", "deepct cloud generate --kind field --out field.nc"),
        ],
    ),
    (
        "cloud import",
        &[
            (
                "a simulation, on voxels of 50 x 50 x 40 m",
                "deepct cloud import LES.nc --spacing 0.05,0.05,0.04 --out cloud.nc",
            ),
            (
                "on the voxels of the file",
                "deepct cloud import LES.nc --spacing file --out cloud.nc",
            ),
            (
                "each cloud in a file of its own, of 32 x 32 columns",
                "deepct cloud import LES.nc --isolate 32 --out clouds",
            ),
        ],
    ),
    (
        "render",
        &[
            (
                "images like those that the network was trained for",
                "deepct render cloud.nc --like cloudct-10 --out images.nc",
            ),
            (
                "own cameras and another Sun, with air and Mie droplets",
                "deepct render cloud.nc --views views.toml --like general --sun-zenith 40 --out images.nc",
            ),
            (
                "without noise, in seconds",
                "deepct render cloud.nc --views cloudct-10 --solver ordinates --out images.nc",
            ),
        ],
    ),
    ("sense", &[("the noise of a CMV4000 sensor", "deepct sense images.nc --out noisy.nc")]),
    (
        "carve",
        &[(
            "the voxels that may contain cloud",
            "deepct carve noisy.nc --grid cloud.nc --out mask.nc",
        )],
    ),
    (
        "infer",
        &[
            (
                "the network for any views and any Sun",
                "deepct infer noisy.nc --carve --out volume.nc",
            ),
            ("many files", "deepct infer scenes/a.nc scenes/b.nc --out-dir volumes --json"),
            (
                "extinction and effective radius from two bands",
                "deepct infer visible.nc infrared.nc --weights two-bands.safetensors --out volume.nc",
            ),
        ],
    ),
    (
        "invert",
        &[(
            "from a uniform cloud",
            "deepct invert noisy.nc --grid cloud.nc --init auto --out volume.nc",
        )],
    ),
    (
        "hybrid",
        &[
            (
                "the network estimate, improved by physics",
                "deepct hybrid noisy.nc --quick --out volume.nc",
            ),
            ("continue an interrupted run", "deepct hybrid noisy.nc --resume --out volume.nc"),
        ],
    ),
    (
        "score",
        &[(
            "epsilon and delta of two estimates",
            "deepct score --truth cloud.nc network.nc hybrid.nc",
        )],
    ),
    ("demo", &[("the whole chain", "deepct demo --out demo")]),
    (
        "dataset generate",
        &[(
            "from a recipe; repeat the command to continue",
            "deepct dataset generate recipe.toml --simulations LES --out samples",
        )],
    ),
    (
        "experiment",
        &[("a comparison of the four methods", "deepct experiment recipe.toml --out results")],
    ),
    ("weights inspect", &[("what the network is for", "deepct weights inspect general")]),
    (
        "plot",
        &[
            (
                "an estimate beside the truth",
                "deepct plot volume.nc --truth cloud.nc --out figure.png",
            ),
            (
                "as a camera would see them",
                "deepct plot volume.nc --truth cloud.nc --photograph --out photograph.png",
            ),
        ],
    ),
    (
        "view",
        &[
            (
                "an estimate in 3D, beside the truth",
                "deepct view volume.nc --truth cloud.nc --open",
            ),
            ("images", "deepct view images.nc --out images.html"),
        ],
    ),
    (
        "report",
        &[
            ("the page of a folder", "deepct report demo"),
            (
                "of the files of a chain, with a truth elsewhere",
                "deepct report results --truth clouds/cloud.nc --out results.html",
            ),
        ],
    ),
    (
        "convert",
        &[
            ("for ParaView", "deepct convert volume.nc volume.vti"),
            ("for MATLAB", "deepct convert images.nc images.mat"),
        ],
    ),
    (
        "regrid",
        &[(
            "onto the grid of another file",
            "deepct regrid volume.nc --like cloud.nc --out regridded.nc",
        )],
    ),
    (
        "images check",
        &[("what an own file means to deepct", "deepct images check images.nc --png check.png")],
    ),
    ("validate", &[("plane-parallel layers", "deepct validate --suite slabs")]),
    ("config", &[("settings of the inversion", "deepct config invert")]),
    ("completions", &[("for bash", "deepct completions bash")]),
    ("man", &[("read the page of a verb", "deepct man render | man -l -")]),
];

/// Adds the examples to the long help of a command and those below it.
pub(crate) fn add_to(command: Command) -> Command {
    add_below("", command)
}

fn add_below(path: &str, command: Command) -> Command {
    let command = match of(path) {
        [] => command,
        examples => {
            let before = command.get_after_long_help().map(|help| format!("{help}\n\n"));
            let lines = examples.iter().map(|(what, line)| format!("  # {what}\n  {line}"));
            let lines: Vec<_> = lines.collect();
            let text = format!("{}Examples:\n{}", before.unwrap_or_default(), lines.join("\n"));
            command.after_long_help(text)
        }
    };
    command.mut_subcommands(|verb| {
        let path = format!("{path} {}", verb.get_name());
        add_below(path.trim_start(), verb)
    })
}

/// The examples of a verb, each with what it does.
fn of(path: &str) -> &'static [(&'static str, &'static str)] {
    EXAMPLES.iter().find(|(verb, _)| *verb == path).map_or(&[], |(_, examples)| examples)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every example has valid options, and every verb that does something has one.
    #[test]
    fn examples_are_command_lines() {
        for (path, examples) in EXAMPLES {
            for (_, line) in *examples {
                assert!(line.starts_with(&format!("deepct {path}")), "{line}");
                let words = line.split(" | ").next().unwrap().split(' ');
                if let Err(problem) = crate::command().try_get_matches_from(words) {
                    panic!("{line}: {problem}");
                }
            }
        }
        for verb in crate::command().get_subcommands() {
            let mut paths = EXAMPLES.iter().map(|(path, _)| *path);
            let found = paths.any(|path| path.split(' ').next() == Some(verb.get_name()));
            assert!(found || verb.get_name() == "formats", "{}", verb.get_name());
        }
    }
}
