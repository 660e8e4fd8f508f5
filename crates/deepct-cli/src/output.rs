//! The files that a command line names: outputs over its own inputs or over files of other programs, and
//! incomplete inputs.

use deepct_core::io::{incomplete, is_replaceable};
use deepct_core::{Error, Result};
use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};

/// Options whose value is a file to write.
const OUTPUTS: [&str; 3] = ["--out", "--png", "--exr"];

/// Ending of the checkpoint that is kept beside an output and removed at the end.
const CHECKPOINT: &str = ".checkpoint";

/// A value on the command line, which may be a file.
struct Argument {
    /// The option before it, with its hyphens; empty for a positional argument.
    option: String,
    value: OsString,
}

impl Argument {
    fn is_output(&self) -> bool {
        OUTPUTS.contains(&self.option.as_str())
    }

    /// The absolute path of the file, if there is one or if it will be written.
    fn place(&self) -> Option<PathBuf> {
        let is_file = self.is_output() || Path::new(&self.value).is_file();
        is_file.then(|| place(&self.value)).flatten()
    }
}

/// Returns an error if an output of a command line is the standard output, is also one of its inputs,
/// which would be lost, or another output; and unless `force` is set, if it is a file of another program.
pub(crate) fn check_outputs(
    command_line: impl IntoIterator<Item = OsString>,
    force: bool,
) -> Result<()> {
    let arguments = split(command_line);
    for out in arguments.iter().filter(|argument| argument.is_output()) {
        if out.value == "-" {
            let problem = "is the standard output, and files are not written in one pass";
            return Err(Error::file(&out.value, &out.option, problem, "name a file"));
        }
    }
    for (number, out) in arguments.iter().enumerate().filter(|(_, argument)| argument.is_output()) {
        let mut checkpoint = out.value.clone();
        checkpoint.push(CHECKPOINT);
        let lost = [out.place(), place(&checkpoint)];
        let others = arguments.iter().enumerate().filter(|(other, _)| *other != number);
        for (_, other) in others {
            let found = other.place();
            if found.is_some() && lost.contains(&found) {
                let what = if other.is_output() { "another output" } else { "an input" };
                let problem = format!("is {what} of this command, which would be lost");
                return Err(Error::file(&out.value, &out.option, problem, "give another name"));
            }
        }
    }
    let mut outputs = arguments.iter().filter(|argument| argument.is_output());
    outputs.try_for_each(|out| check_origin(Path::new(&out.value), &out.option, force))
}

/// Returns an error if a file at `path`, which `option` names, would be lost: one that deepct did not
/// write.
pub(crate) fn check_origin(path: &Path, option: &str, force: bool) -> Result<()> {
    if force || is_replaceable(path) {
        return Ok(());
    }
    let problem = "exists and is not a file that deepct wrote there before";
    Err(Error::file(path, option, problem, "give another name, or --force to replace it"))
}

/// Whether two paths are those of one file.
pub(crate) fn is_same_file(one: &Path, other: &Path) -> bool {
    place(one.as_os_str()).is_some_and(|found| Some(found) == place(other.as_os_str()))
}

/// Warns of inputs whose computation was interrupted.
pub(crate) fn warn_of_incomplete(command_line: impl IntoIterator<Item = OsString>) {
    for input in split(command_line).iter().filter(|argument| !argument.is_output()) {
        let path = Path::new(&input.value);
        // A pipe or a device must not be opened.
        let lacking = path.is_file().then(|| incomplete(path)).flatten();
        if let Some(lacking) = lacking {
            note!("deepct: warning: {} is incomplete: {lacking}", path.display());
        }
    }
}

/// The values on a command line with their options, given as `--option value` or `--option=value`.
fn split(command_line: impl IntoIterator<Item = OsString>) -> Vec<Argument> {
    let mut arguments = Vec::new();
    let mut option = String::new();
    for argument in command_line.into_iter().skip(1) {
        let text = argument.to_string_lossy();
        match text.split_once('=') {
            Some((name, value)) if name.starts_with("--") => {
                arguments.push(Argument { option: name.into(), value: value.into() });
                option.clear();
            }
            _ if text.starts_with("--") => option = text.into_owned(),
            _ => arguments.push(Argument { option: std::mem::take(&mut option), value: argument }),
        }
    }
    arguments
}

/// An absolute path without links, whether the file exists or not.
fn place(path: &OsStr) -> Option<PathBuf> {
    let path = Path::new(path);
    path.canonicalize().ok().or_else(|| {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        let folder = folder.unwrap_or(Path::new(".")).canonicalize().ok()?;
        Some(folder.join(path.file_name()?))
    })
}
