//! Where a verb may write.

use deepct_core::{Error, Result};
use std::path::Path;

/// Returns an error if the output is one of the inputs, which it would replace.
pub(crate) fn check_output(out: &Path, inputs: &[&Path]) -> Result<()> {
    deepct_core::files::check_output(out)?;
    let Ok(place) = out.canonicalize() else { return Ok(()) };
    match inputs.iter().find(|input| input.canonicalize().is_ok_and(|input| input == place)) {
        None => Ok(()),
        Some(_) => Err(Error::file(
            out,
            "--out",
            "is an input of this command, which would be lost",
            "give another name",
        )),
    }
}
