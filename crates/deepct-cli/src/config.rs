//! Settings: commented defaults, a file over them, `--set key=value` over both; and
//! `deepct config`, which prints the defaults.

use crate::Outcome;
use deepct_core::{Error, Result};
use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};

/// Print the default settings of a verb, with a comment each
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The verb, and for `cloud generate` the kind of cloud
    #[arg(value_parser = DEFAULTS.map(|(verb, _)| verb))]
    verb: String,
}

/// The verbs that have settings, and their commented defaults in TOML.
const DEFAULTS: [(&str, &str); 7] = [
    ("cloud-cumulus", crate::cloud::CUMULUS),
    ("cloud-field", crate::cloud::FIELD),
    ("infer", crate::infer::DEFAULTS),
    ("invert", crate::inversion::DEFAULTS),
    ("dataset", crate::dataset::DEFAULTS),
    ("experiment", crate::experiment::DEFAULTS),
    ("render", crate::render::DEFAULTS),
];

/// The flags of a verb that has settings.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct Settings {
    /// File of settings (TOML) that replace the defaults
    #[arg(long, value_name = "FILE.toml")]
    config: Option<PathBuf>,
    /// Replace one setting; see `deepct config VERB` for the keys
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
}

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    let (_, defaults) =
        DEFAULTS.iter().find(|(verb, _)| *verb == args.verb).expect("clap accepts no other verb");
    print!("{defaults}");
    Ok(Outcome::Success)
}

impl Settings {
    /// From a file and single values that were not given as flags of this name.
    pub(crate) fn new(config: Option<PathBuf>, set: Vec<String>) -> Self {
        Self { config, set }
    }

    /// The settings that result from `defaults`, the file and the single values.
    ///
    /// # Errors
    /// A file that cannot be read or parsed, an unknown key, a value of a wrong type.
    pub(crate) fn resolve<T: DeserializeOwned>(&self, defaults: &str) -> Result<T> {
        let mut table: toml::Table = defaults.parse().expect("defaults are valid TOML");
        if let Some(path) = &self.config {
            let text = std::fs::read_to_string(path).map_err(|problem| {
                let remedy = "name a TOML file; `deepct config` prints the settings of a verb";
                Error::file(path, "settings", problem.to_string(), remedy)
            })?;
            let file: toml::Table =
                text.parse().map_err(|problem| invalid(path, &problem, defaults))?;
            overlay(&mut table, file);
        }
        for setting in &self.set {
            overlay(&mut table, single(setting)?);
        }
        let origin = self.config.as_deref().unwrap_or(Path::new("--set"));
        table.try_into().map_err(|problem| invalid(origin, &problem, defaults))
    }
}

/// The table of one `key=value`, where the key may be dotted; a value that is not
/// TOML is taken as a string.
fn single(setting: &str) -> Result<toml::Table> {
    let Some((key, value)) = setting.split_once('=') else {
        return Err(Error::out_of_range("--set", setting, "of the form key=value"));
    };
    format!("{key} = {value}")
        .parse()
        .or_else(|_| format!("{key} = {value:?}").parse())
        .map_err(|_| Error::out_of_range("--set", setting, "a valid key and value of TOML"))
}

/// Put the keys of `over` into `table`, tables key by key.
fn overlay(table: &mut toml::Table, over: toml::Table) {
    for (key, value) in over {
        match (table.get_mut(&key), value) {
            (Some(toml::Value::Table(below)), toml::Value::Table(above)) => overlay(below, above),
            (_, value) => {
                table.insert(key, value);
            }
        }
    }
}

fn invalid(path: &Path, problem: &toml::de::Error, defaults: &str) -> Error {
    let verb = DEFAULTS.iter().find(|(_, text)| *text == defaults).map_or("VERB", |(verb, _)| verb);
    Error::file(
        path,
        "settings",
        problem.message().replace('\n', " "),
        format!("see `deepct config {verb}` for the keys and their defaults"),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Example {
        samples: u32,
        sun: Sun,
    }

    #[derive(Debug, PartialEq, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Sun {
        zenith_deg: f64,
        name: String,
    }

    const EXAMPLE: &str = "samples = 3\n[sun]\nzenith_deg = 30.0\nname = \"noon\"\n";

    fn resolve(set: &[&str]) -> Result<Example> {
        let set = set.iter().map(ToString::to_string).collect();
        Settings { config: None, set }.resolve(EXAMPLE)
    }

    #[test]
    fn single_values_replace_defaults() {
        let example = resolve(&["sun.zenith_deg=10.5", "sun.name=dawn", "samples=7"]).unwrap();
        let sun = Sun { zenith_deg: 10.5, name: "dawn".into() };
        assert_eq!(example, Example { samples: 7, sun });
    }

    #[test]
    fn unknown_keys_and_wrong_types_are_refused() {
        for set in ["sun.zenit_deg=1.0", "smaples=3", "samples=many", "samples"] {
            assert!(resolve(&[set]).is_err(), "{set}");
        }
    }
}
