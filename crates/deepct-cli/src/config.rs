//! Settings of the verbs, and `deepct config`, which prints the defaults. A file replaces default
//! values, and `--set key=value` replaces values of both.

use crate::defaults;
use crate::outcome::Outcome;
use deepct_core::files::{read_text, toml_problem};
use deepct_core::scene::Light;
use deepct_core::{Error, Result};
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Print the default settings of a verb, with a comment on each setting
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Name of the settings: a verb, a kind of cloud for `cloud generate`, or `light` for the scene
    /// illumination
    #[arg(value_parser = defaults::ALL.map(|(verb, _)| verb))]
    verb: String,
}

/// Values by key; dots separate the levels of nested tables.
pub(crate) type Values = BTreeMap<String, toml::Value>;

/// Options of a verb that has settings.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct Settings {
    /// File of settings (TOML) that replace the default values
    #[arg(long, value_name = "FILE.toml")]
    config: Option<PathBuf>,
    /// Replace one setting; `deepct config` prints the keys
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
}

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    let mut all = defaults::ALL.iter();
    let (_, text) = all.find(|(verb, _)| *verb == args.verb).expect("clap accepts no other verb");
    crate::print::raw(text);
    Ok(Outcome::Success)
}

impl Settings {
    /// Settings from a file and single values that are not given by the options `--config` and
    /// `--set` of this type.
    pub(crate) fn new(config: Option<PathBuf>, set: Vec<String>) -> Self {
        Self { config, set }
    }

    /// The settings that result from `defaults`, the file and the single values, in this order of
    /// increasing precedence.
    ///
    /// # Errors
    /// Returns an error if the file cannot be read or parsed, if a key is unknown or if a value has
    /// the wrong type.
    pub(crate) fn resolve<T: DeserializeOwned>(&self, defaults: &str) -> Result<T> {
        self.resolved(defaults, self.given()?)
    }

    /// Like [`Settings::resolve`], but returns the given values of the scene illumination
    /// separately.
    ///
    /// # Errors
    /// Returns the errors of [`Settings::resolve`].
    pub(crate) fn resolve_with_light<T: DeserializeOwned>(
        &self,
        defaults: &str,
    ) -> Result<(T, Values)> {
        let (light, own) = self.given()?.into_iter().partition(|(key, _)| is_light(key));
        Ok((self.resolved(defaults, own)?, flattened(light)))
    }

    /// The values of the file, replaced by the single values.
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
        let origin = self.config.as_deref().unwrap_or(Path::new("--set"));
        let verb = defaults::ALL.iter().find(|(_, text)| *text == defaults);
        let verb = verb.map_or("VERB", |(verb, _)| verb);
        for key in given.keys().filter(|key| !table.contains_key(*key)) {
            let mut sections =
                table.iter().filter_map(|(name, value)| Some((name, value.as_table()?)));
            if let Some((section, _)) = sections.find(|(_, section)| section.contains_key(key)) {
                let remedy =
                    format!("write {section}.{key}; `deepct config {verb}` lists the keys");
                return Err(Error::file(origin, "settings", format!("unknown key {key}"), remedy));
            }
        }
        overlay(&mut table, given);
        table.try_into().map_err(|problem| invalid(origin, &problem, verb))
    }
}

/// Reads the TOML file of settings of a verb.
pub(crate) fn read_table(path: &Path, verb: &str) -> Result<toml::Table> {
    let text = read_text(path)?;
    text.parse().map_err(|problem| {
        let problem = toml_problem(&text, &problem);
        let remedy = format!("`deepct config {verb}` prints all settings");
        Error::file(path, "settings", problem, remedy)
    })
}

/// Whether a top-level key belongs to the scene illumination.
fn is_light(key: &str) -> bool {
    Light::keys().iter().any(|known| known.split('.').next() == Some(key))
}

/// The values of nested tables by dotted keys; integers are converted to floating-point numbers.
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

/// Parses one `key=value` into a table. The key may be dotted; a value that is not valid TOML is
/// taken as a string.
pub(crate) fn single(setting: &str) -> Result<toml::Table> {
    let Some((key, value)) = setting.split_once('=') else {
        return Err(Error::out_of_range("--set", setting, "of the form key=value"));
    };
    format!("{key} = {value}")
        .parse()
        .or_else(|_| format!("{key} = {value:?}").parse())
        .map_err(|_| Error::out_of_range("--set", setting, "a valid key and value of TOML"))
}

/// Inserts the keys of `over` into `table`, and merges nested tables key by key.
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
        let nested = resolve(&["zenith_deg=3.0"]).unwrap_err().to_string();
        assert!(nested.contains("write sun.zenith_deg"), "{nested}");
        for set in ["sun.zenit_deg=1.0", "smaples=3", "samples=many", "samples"] {
            assert!(resolve(&[set]).is_err(), "{set}");
        }
    }
}
