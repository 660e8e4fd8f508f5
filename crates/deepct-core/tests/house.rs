//! Checks the imports of the sources against the table in ARCHITECTURE.md, "Imports point one way".

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Each module and the modules that it may import in addition to those of [`BASE`], in the order of
/// the table.
fn table() -> Vec<(String, Vec<String>)> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../ARCHITECTURE.md");
    let text = std::fs::read_to_string(path).unwrap();
    let (_, section) = text.split_once("## Imports point one way").expect("the section");
    let section = section.split("\n## ").next().unwrap();
    let rows = section.lines().filter_map(|line| line.strip_prefix("| `"));
    let names = |cell: &str| cell.split('`').skip(1).step_by(2).map(str::to_owned).collect();
    rows.map(|row| row.split_once('|').expect("two columns"))
        .flat_map(|(modules, allowed)| {
            let modules: Vec<String> = names(&format!("`{modules}"));
            let allowed: Vec<String> = names(allowed);
            modules.into_iter().map(move |module| (module, allowed.clone()))
        })
        .collect()
}

/// The modules that every module may import.
const BASE: [&str; 4] = ["error", "math", "memory", "stop"];

fn sources() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src")
}

/// All Rust files in a folder and its subfolders.
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

/// The top-level module to which a file belongs; `lib` for the crate root itself.
fn module_of(file: &Path) -> String {
    let first = file.strip_prefix(sources()).unwrap().components().next().unwrap();
    Path::new(first.as_os_str()).file_stem().unwrap().to_str().unwrap().to_owned()
}

/// The code of a file without its comments and without the unit tests at its end, which may import
/// any module.
fn code_of(file: &Path) -> String {
    let text = std::fs::read_to_string(file).unwrap();
    let code = text.split("#[cfg(test)]\nmod ").next().unwrap();
    code.lines().map(|line| line.split("//").next().unwrap()).collect::<Vec<_>>().join("\n")
}

/// The names in the crate root that the code uses, in paths such as `crate::grid::Grid` and in
/// groups such as `crate::{grid::Grid, rng}`.
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

/// The first names of the paths in a `{...}` group; `group` is the code after the opening brace.
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
    let table = table();
    assert!(table.len() > 15, "{table:?}");
    for (at, (module, allowed)) in table.iter().enumerate() {
        for import in allowed {
            let above = table[..at].iter().any(|(name, _)| name == import);
            assert!(above, "`{module}` may import `{import}`, so `{import}` must precede it");
        }
    }
    let root = std::fs::read_to_string(sources().join("lib.rs")).unwrap();
    let declared = root
        .lines()
        .filter_map(|line| line.trim_start_matches("pub ").strip_prefix("mod "))
        .map(|name| name.trim_end_matches(';'));
    for module in declared {
        let listed = table.iter().any(|(name, _)| name == module);
        assert!(listed, "lib.rs has a module `{module}` that is not in the table");
    }
}

#[test]
fn imports_point_one_way() {
    let table: BTreeMap<_, _> = table().into_iter().collect();
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
            let base = BASE.contains(&import) && !BASE.contains(&module.as_str());
            if !base && import != module && !allowed.iter().any(|name| name == import) {
                wrong.push(format!("{}: `{module}` imports `crate::{import}`", file.display()));
            }
        }
        // `super` in the first file of a module is the crate root and would bypass the table.
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
