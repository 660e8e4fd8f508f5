//! Writing of files through a temporary name, checksums, and reading of TOML files.

use crate::error::{Error, Result};
use serde::de::DeserializeOwned;
use std::path::Path;

/// Creates an empty temporary file in the folder of `path`, to which an output is written until it
/// is complete. The file is removed unless it is persisted.
///
/// # Errors
/// A folder that does not exist or cannot be written to.
#[cfg(any(feature = "files", feature = "plot"))]
pub(crate) fn temporary_beside(path: &Path) -> Result<tempfile::TempPath> {
    let folder = match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    };
    let mut builder = tempfile::Builder::new();
    builder.prefix(".deepct-").suffix(".partial");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // These are the default permissions of a new file, which the umask of the process reduces.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    let file = builder.tempfile_in(folder).map_err(Error::io(path))?;
    Ok(file.into_temp_path())
}

/// Writes a file under a temporary name and renames it, so that an interrupted run leaves no
/// incomplete file behind.
///
/// # Errors
/// A file that cannot be written.
#[cfg(any(feature = "files", feature = "plot"))]
pub(crate) fn write(path: &Path, contents: impl AsRef<[u8]>) -> Result<()> {
    let temporary = temporary_beside(path)?;
    std::fs::write(&temporary, contents).map_err(Error::io(path))?;
    temporary.persist(path).map_err(|problem| Error::io(path)(problem.error))
}

/// SHA-256 of a file, in hexadecimal.
///
/// # Errors
/// A file that cannot be read.
#[cfg(feature = "files")]
pub(crate) fn sha256(path: &Path) -> Result<String> {
    use sha2::{Digest, Sha256};
    let bytes = std::fs::read(path).map_err(Error::io(path))?;
    Ok(Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Reads a TOML file. An error message names the content as `what` and suggests `remedy`.
///
/// # Errors
/// A file that cannot be read or is not valid TOML; an unknown or missing key, a value of a wrong
/// type.
pub(crate) fn read_toml<T: DeserializeOwned>(path: &Path, what: &str, remedy: &str) -> Result<T> {
    let text = std::fs::read_to_string(path).map_err(Error::io(path))?;
    toml::from_str(&text)
        .map_err(|problem| Error::file(path, what, problem.message().replace('\n', " "), remedy))
}
