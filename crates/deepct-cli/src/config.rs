//! Settings: commented defaults, a file over them, `--set key=value` over both; and
//! `deepct config`, which prints the defaults.

use crate::defaults;
use crate::outcome::Outcome;
use deepct_core::scene::Light;
use deepct_core::{Error, Result};
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Print the default settings of a verb, with a comment each
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The verb, for `cloud generate` the kind of cloud, or `light`
    #[arg(value_parser = defaults::ALL.map(|(verb, _)| verb))]
    verb: String,
}

/// Values by their key, with dots between the levels of a table.
pub(crate) type Values = BTreeMap<String, toml::Value>;

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
    let mut all = defaults::ALL.iter();
    let (_, text) = all.find(|(verb, _)| *verb == args.verb).expect("clap accepts no other verb");
    print!("{text}");
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
        self.resolved(defaults, self.given()?)
    }

    /// The same, and apart from it those of the given settings that describe the light.
    ///
    /// # Errors
    /// As [`Settings::resolve`].
    pub(crate) fn resolve_with_light<T: DeserializeOwned>(
        &self,
        defaults: &str,
    ) -> Result<(T, Values)> {
        let (light, own) = self.given()?.into_iter().partition(|(key, _)| is_light(key));
        Ok((self.resolved(defaults, own)?, flattened(light)))
    }

    /// What the file and the single values say.
    fn given(&self) -> Result<toml::Table> {
        let mut table = toml::Table::new();
        if let Some(path) = &self.config {
            table = read_table(path, "VERB")?;
        }
        for setting in &self.set {
            overlay(&mut table, single(setting)?);
        }
        Ok(table)
    }

    fn resolved<T: DeserializeOwned>(&self, defaults: &str, given: toml::Table) -> Result<T> {
        let mut table: toml::Table = defaults.parse().expect("defaults are valid TOML");
        overlay(&mut table, given);
        let origin = self.config.as_deref().unwrap_or(Path::new("--set"));
        let verb = defaults::ALL.iter().find(|(_, text)| *text == defaults);
        let verb = verb.map_or("VERB", |(verb, _)| verb);
        table.try_into().map_err(|problem| invalid(origin, &problem, verb))
    }
}

/// The table in a TOML file of settings of a verb.
pub(crate) fn read_table(path: &Path, verb: &str) -> Result<toml::Table> {
    let text = std::fs::read_to_string(path).map_err(|problem| {
        let remedy = format!("name a TOML file; `deepct config {verb}` prints the settings");
        Error::file(path, "settings", problem.to_string(), remedy)
    })?;
    text.parse().map_err(|problem| invalid(path, &problem, verb))
}

/// Whether a top-level key belongs to the light.
fn is_light(key: &str) -> bool {
    Light::keys().iter().any(|known| known.split('.').next() == Some(key))
}

/// The values of a table and of those in it, by keys with dots; whole numbers as real ones.
pub(crate) fn flattened(table: toml::Table) -> Values {
    let mut values = Values::new();
    for (key, value) in table {
        match value {
            toml::Value::Table(below) => values.extend(
                flattened(below).into_iter().map(|(name, value)| (format!("{key}.{name}"), value)),
            ),
            toml::Value::Integer(number) => {
                values.insert(key, toml::Value::Float(number as f64));
            }
            value => {
                values.insert(key, value);
            }
        }
    }
    values
}

/// The table of one `key=value`, where the key may be dotted; a value that is not
/// TOML is taken as a string.
pub(crate) fn single(setting: &str) -> Result<toml::Table> {
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

fn invalid(path: &Path, problem: &toml::de::Error, verb: &str) -> Error {
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
