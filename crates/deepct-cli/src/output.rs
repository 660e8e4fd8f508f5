//! Files that a command line would write over its own inputs.

use deepct_core::{Error, Result};
use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};

/// Options whose value is a file to write.
const OUTPUTS: [&str; 3] = ["--out", "--png", "--exr"];

/// Ending of the checkpoint that is kept beside an output and removed at the end.
const CHECKPOINT: &str = ".checkpoint";

/// Returns an error if an output of a command line is also one of its inputs, which would be lost,
/// or another output.
pub(crate) fn check_outputs(arguments: impl IntoIterator<Item = OsString>) -> Result<()> {
    let mut files = Vec::new();
    let mut option = None;
    for argument in arguments.into_iter().skip(1) {
        let text = argument.to_string_lossy();
        match text.split_once('=') {
            Some((name, value)) if name.starts_with("--") => {
                files.push((Some(name.to_owned()), PathBuf::from(value)));
                option = None;
            }
            _ if text.starts_with("--") => option = Some(text.into_owned()),
            _ => files.push((option.take(), PathBuf::from(argument))),
        }
    }
    let is_output =
        |option: &Option<String>| option.as_deref().is_some_and(|option| OUTPUTS.contains(&option));
    for (number, (option, out)) in files.iter().enumerate().filter(|(_, (name, _))| is_output(name))
    {
        let [place, checkpoint] = [out.as_os_str(), &with_ending(out)].map(place);
        for (_, (other, file)) in files.iter().enumerate().filter(|(at, _)| *at != number) {
            let found = place_of_file(file, is_output(other));
            if found.is_some() && (found == place || found == checkpoint) {
                let what = if is_output(other) { "another output" } else { "an input" };
                let problem = format!("is {what} of this command, which would be lost");
                let field = option.clone().unwrap_or_default();
                return Err(Error::file(out, field, problem, "give another name"));
            }
        }
    }
    Ok(())
}

fn with_ending(out: &Path) -> OsString {
    let mut name = out.as_os_str().to_owned();
    name.push(CHECKPOINT);
    name
}

/// The absolute path of a file that exists, or that will be written.
fn place_of_file(file: &Path, is_output: bool) -> Option<PathBuf> {
    if is_output || file.is_file() { place(file.as_os_str()) } else { None }
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
