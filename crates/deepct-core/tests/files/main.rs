//! Tests of files: files of the project are read back exactly, files of other programs are
//! imported, and invalid files are refused with a message that names the file, the field and the
//! remedy.

#![cfg(feature = "files")]

mod foreign;
mod import;
mod own;
mod values;

use deepct_core::{Error, Result};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Creates a temporary folder. Returns it and the path of a file in it.
fn place(name: &str) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    (folder, path)
}

/// Asserts that the result is an error whose message is one line that names the file, the field or
/// problem, and a remedy.
#[track_caller]
fn check_refusal<T>(result: Result<T>, path: &Path, names: &str) {
    let Err(error) = result else { panic!("{names}: was accepted") };
    assert!(matches!(error, Error::File { .. }), "{names}: {error:?}");
    let message = error.to_string();
    assert!(message.contains(&path.display().to_string()), "no path: {message}");
    assert!(message.contains(names), "no {names:?}: {message}");
    assert!(message.contains("; "), "no remedy: {message}");
    assert!(!message.contains('\n'), "more than one line: {message}");
}
