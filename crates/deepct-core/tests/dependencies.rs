//! Checks the licences and the origin of all dependencies by the rules of `deny.toml`, without
//! cargo-deny.

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// The output of cargo, which runs in the folder of the workspace.
fn cargo(arguments: &[&str]) -> String {
    let output = Command::new(env!("CARGO")).args(arguments).current_dir(root()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// Whether a licence expression is met by the allowed licences. AND binds more strongly than OR; `/`
/// is an old form of OR.
fn is_met(expression: &str, allowed: &[String]) -> bool {
    let expression = expression.trim();
    let parts = |separator: &str| outside_parentheses(expression, separator);
    for separator in [" OR ", "/"] {
        let parts = parts(separator);
        if parts.len() > 1 {
            return parts.iter().any(|part| is_met(part, allowed));
        }
    }
    let factors = parts(" AND ");
    if factors.len() > 1 {
        return factors.iter().all(|part| is_met(part, allowed));
    }
    match expression.strip_prefix('(').and_then(|inner| inner.strip_suffix(')')) {
        Some(inner) => is_met(inner, allowed),
        None => allowed.iter().any(|licence| licence == expression),
    }
}

/// The parts of a text between separators that are not in parentheses.
fn outside_parentheses<'a>(text: &'a str, separator: &str) -> Vec<&'a str> {
    let (mut parts, mut start) = (Vec::new(), 0);
    for (at, _) in text.match_indices(separator) {
        let before = &text[..at];
        if before.matches('(').count() == before.matches(')').count() {
            parts.push(&text[start..at]);
            start = at + separator.len();
        }
    }
    parts.push(&text[start..]);
    parts
}

#[test]
fn licences_are_permissive() {
    let rules = std::fs::read_to_string(root().join("deny.toml")).unwrap();
    let rules: toml::Table = rules.parse().unwrap();
    let texts = |list: &toml::Value| -> Vec<String> { list.clone().try_into().unwrap() };
    let allowed = texts(&rules["licenses"]["allow"]);
    let exceptions = rules["licenses"]["exceptions"].as_array().unwrap();
    let excepted = |name: &str| exceptions.iter().any(|rule| rule["crate"].as_str() == Some(name));

    // Only the packages of this platform are certain to have been fetched.
    let version = cargo(&["-vV"]);
    let host = version.lines().find_map(|line| line.strip_prefix("host: ")).unwrap();
    let metadata = ["metadata", "--offline", "--locked", "--format-version", "1"];
    let metadata = cargo(&[&metadata[..], &["--filter-platform", host]].concat());
    let metadata: Value = serde_json::from_str(&metadata).unwrap();
    let packages = metadata["packages"].as_array().unwrap();
    assert!(packages.len() > 100, "{} packages", packages.len());
    for package in packages {
        let name = package["name"].as_str().unwrap();
        let licence = package["license"].as_str();
        let permitted = licence.is_some_and(|licence| is_met(licence, &allowed)) || excepted(name);
        assert!(permitted, "{name}: the licence {licence:?} is not in deny.toml");
    }
}

/// Every package that is not of this workspace comes from the registry, with its checksum.
#[test]
fn sources_are_the_registry() {
    for lock in ["Cargo.lock", "fuzz/Cargo.lock"] {
        let lock = std::fs::read_to_string(root().join(lock)).unwrap();
        let lock: toml::Table = lock.parse().unwrap();
        for package in lock["package"].as_array().unwrap() {
            let name = package["name"].as_str().unwrap();
            if name.starts_with("deepct-") {
                continue;
            }
            let source = package.get("source").and_then(toml::Value::as_str);
            let registry = "registry+https://github.com/rust-lang/crates.io-index";
            assert_eq!(source, Some(registry), "{name}");
            assert!(package.get("checksum").is_some(), "{name} has no checksum");
        }
    }
}

#[test]
fn licence_expressions_are_evaluated() {
    let allowed = ["MIT".to_owned(), "Unicode-3.0".to_owned()];
    let met = ["MIT", "MIT/Apache-2.0", "(MIT OR Apache-2.0) AND Unicode-3.0", "GPL-3.0 OR MIT"];
    let unmet = ["GPL-3.0", "MIT AND GPL-3.0", "MIT WITH other", "", "(GPL-3.0 OR BSD) AND MIT"];
    assert!(met.iter().all(|expression| is_met(expression, &allowed)));
    assert!(!unmet.iter().any(|expression| is_met(expression, &allowed)));
}
