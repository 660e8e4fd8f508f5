//! The table of ARCHITECTURE.md, "Imports point one way", held against the sources.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Each module and the modules that it may import, besides `error` and `math`, which
/// are below everything. A module stands after all that it imports, so the table has no
/// cycle.
const TABLE: [(&str, &[&str]); 21] = [
    ("error", &[]),
    ("math", &[]),
    ("rng", &[]),
    ("grid", &[]),
    ("image", &[]),
    ("conv", &[]),
    ("traverse", &["grid"]),
    ("metrics", &["grid"]),
    ("cloud", &["grid", "rng"]),
    ("optics", &["cloud", "grid"]),
    ("scene", &["grid", "image", "optics", "rng"]),
    ("transport", &["grid", "image", "optics", "rng", "scene", "traverse"]),
    ("sensor", &["image", "rng"]),
    ("carve", &["grid", "image", "scene"]),
    ("network", &["conv", "grid", "image"]),
    (
        "inversion",
        &[
            "carve",
            "grid",
            "image",
            "metrics",
            "network",
            "optics",
            "rng",
            "scene",
            "transport",
            "traverse",
        ],
    ),
    ("io", &["cloud", "grid", "image", "inversion", "network", "scene"]),
    ("plot", &["grid", "image", "metrics"]),
    // The cases with known answers: each is a scene and what transport makes of it.
    (
        "validation",
        &["cloud", "grid", "image", "io", "optics", "rng", "scene", "transport", "traverse"],
    ),
    (
        "dataset",
        &[
            "carve",
            "cloud",
            "grid",
            "image",
            "io",
            "metrics",
            "network",
            "optics",
            "rng",
            "scene",
            "sensor",
            "transport",
        ],
    ),
    (
        "experiment",
        &[
            "carve",
            "cloud",
            "dataset",
            "grid",
            "image",
            "inversion",
            "io",
            "metrics",
            "network",
            "optics",
            "plot",
            "scene",
            "sensor",
            "transport",
        ],
    ),
];

fn sources() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src")
}

/// All Rust files below a folder.
fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files.extend(rust_files(&path));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
    files.sort();
    files
}

/// The module of the crate's root that a file belongs to; `lib` for the root itself.
fn module_of(file: &Path) -> String {
    let first = file.strip_prefix(sources()).unwrap().components().next().unwrap();
    Path::new(first.as_os_str()).file_stem().unwrap().to_str().unwrap().to_owned()
}

/// The code of a file without its comments and without the unit tests at its end, which
/// may compare with whatever they like.
fn code_of(file: &Path) -> String {
    let text = std::fs::read_to_string(file).unwrap();
    let code = text.split("#[cfg(test)]\nmod ").next().unwrap();
    code.lines().map(|line| line.split("//").next().unwrap()).collect::<Vec<_>>().join("\n")
}

/// The names of the crate's root that a text uses, in paths such as `crate::grid::Grid`
/// and in groups such as `crate::{grid::Grid, rng}`.
fn imports(code: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for (at, _) in code.match_indices("crate::") {
        let before = code[..at].chars().next_back();
        if before.is_some_and(|letter| letter.is_alphanumeric() || letter == '_' || letter == '$') {
            continue;
        }
        let path = code[at + "crate::".len()..].trim_start();
        match path.strip_prefix('{') {
            Some(group) => found.extend(heads_of_group(group)),
            None => found.extend(head(path)),
        }
    }
    found
}

/// The first name of a path.
fn head(path: &str) -> Option<String> {
    let name: String =
        path.trim_start().chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
    (!name.is_empty()).then_some(name)
}

/// The first names of the paths of a `{...}` group, of which `group` begins after the
/// opening brace.
fn heads_of_group(group: &str) -> Vec<String> {
    let (mut depth, mut start, mut heads) = (0, 0, Vec::new());
    for (at, letter) in group.char_indices() {
        match letter {
            '{' => depth += 1,
            '}' if depth > 0 => depth -= 1,
            ',' | '}' if depth == 0 => {
                heads.extend(head(&group[start..at]));
                start = at + 1;
                if letter == '}' {
                    break;
                }
            }
            _ => {}
        }
    }
    heads
}

#[test]
fn the_table_has_no_cycle_and_names_every_module() {
    for (at, (module, allowed)) in TABLE.iter().enumerate() {
        for import in *allowed {
            let above = TABLE[..at].iter().any(|(name, _)| name == import);
            assert!(above, "`{module}` may import `{import}`, so `{import}` stands above it");
        }
    }
    let root = std::fs::read_to_string(sources().join("lib.rs")).unwrap();
    let declared = root
        .lines()
        .filter_map(|line| line.trim_start_matches("pub ").strip_prefix("mod "))
        .map(|name| name.trim_end_matches(';'));
    for module in declared {
        let listed = TABLE.iter().any(|(name, _)| *name == module);
        assert!(listed, "lib.rs has a module `{module}` that the table does not name");
    }
}

#[test]
fn imports_point_one_way() {
    let table: BTreeMap<_, _> = TABLE.into_iter().collect();
    let mut wrong = Vec::new();
    for file in rust_files(&sources()) {
        let module = module_of(&file);
        let Some(allowed) = table.get(module.as_str()) else { continue };
        let code = code_of(&file);
        for import in imports(&code) {
            let import = match import.as_str() {
                "Error" | "Result" => "error",
                name => name,
            };
            let base = import == "error" || (import == "math" && module != "error");
            if !base && import != module && !allowed.contains(&import) {
                wrong.push(format!("{}: `{module}` imports `crate::{import}`", file.display()));
            }
        }
        // A way round the table: `super` of a module's first file is the root itself.
        let first = file.ends_with(format!("src/{module}.rs"))
            || file.ends_with(format!("src/{module}/mod.rs"));
        if code.contains("super::super::") || (first && code.contains("super::")) {
            wrong.push(format!("{}: write `crate::`, not `super::`, here", file.display()));
        }
    }
    assert!(wrong.is_empty(), "imports that the table does not allow:\n{}", wrong.join("\n"));
}

#[test]
fn every_form_of_import_is_seen() {
    let code = "use crate::grid::{Grid, Volume};\n\
                use crate::{rng, scene::{Sun, View}, io::read as r};\n\
                let e = crate::Error::io(path); let x = <crate :: x>; my_crate::y; $crate::z";
    let found = imports(code);
    let expected = ["grid", "rng", "scene", "io", "Error"];
    assert_eq!(found, expected.into_iter().map(str::to_owned).collect());
}
