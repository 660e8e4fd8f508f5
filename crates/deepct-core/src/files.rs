//! Reading of small files, writing of files through a temporary name, and checksums.

use crate::error::{Error, Result};
use serde::de::DeserializeOwned;
use std::io::Read;
use std::path::Path;
#[cfg(any(feature = "files", feature = "plot"))]
use std::path::PathBuf;

/// Upper limit of the size of a text file of settings, views or grids (bytes), and of the files that
/// a data set or an experiment consists of.
const MAX_TEXT_BYTES: u64 = 1 << 28;

/// Returns an error unless `path` is a regular file. A device or a pipe may have no end.
///
/// # Errors
/// A path that does not exist, or is not a file.
pub(crate) fn check_regular(path: &Path) -> Result<()> {
    let kind = std::fs::metadata(path).map_err(Error::io(path))?;
    if kind.is_file() {
        return Ok(());
    }
    let problem = if kind.is_dir() { "is a folder" } else { "is a device or a pipe" };
    Err(Error::file(path, "file", problem, "give a regular file"))
}

/// Reads a regular file of at most `most` bytes.
///
/// # Errors
/// A path that is not a regular file; a file that is larger or cannot be read.
pub(crate) fn read(path: &Path, most: u64) -> Result<Vec<u8>> {
    check_regular(path)?;
    let mut bytes = Vec::new();
    // The size of a file can change, and is not stated by all file systems.
    let file = std::fs::File::open(path).map_err(Error::io(path))?;
    file.take(most.saturating_add(1)).read_to_end(&mut bytes).map_err(Error::io(path))?;
    if bytes.len() as u64 > most {
        let problem = format!("has more than {most} bytes");
        return Err(Error::file(path, "file", problem, "give a smaller file"));
    }
    Ok(bytes)
}

/// Reads a text file, such as one of settings.
///
/// # Errors
/// A path that is not a regular file; a file that is very large, cannot be read or is not UTF-8.
pub fn read_text(path: &Path) -> Result<String> {
    String::from_utf8(read(path, MAX_TEXT_BYTES)?)
        .map_err(|_| Error::file(path, "file", "is not text in UTF-8", "give a text file"))
}

/// Reads a TOML file. An error message names the content as `what` and suggests `remedy`.
///
/// # Errors
/// A file that cannot be read or is not valid TOML; an unknown or missing key, a value of a wrong
/// type.
pub(crate) fn read_toml<T: DeserializeOwned>(path: &Path, what: &str, remedy: &str) -> Result<T> {
    let text = read_text(path)?;
    toml::from_str(&text)
        .map_err(|problem| Error::file(path, what, toml_problem(&text, &problem), remedy))
}

/// A problem of a TOML text on one line, with the number of the line where it occurs.
pub fn toml_problem(text: &str, problem: &toml::de::Error) -> String {
    let message = problem.message().replace('\n', " ");
    match problem.span().and_then(|span| text.get(..span.start)) {
        Some(before) => format!("line {}: {message}", before.matches('\n').count() + 1),
        None => message,
    }
}

/// An output that is written under a temporary name in the same folder and renamed when it is
/// complete, so that an interrupted run leaves no incomplete file behind. It is removed if it is
/// dropped before.
#[cfg(any(feature = "files", feature = "plot"))]
#[derive(Debug)]
pub(crate) struct Output {
    temporary: tempfile::TempPath,
    /// The file that it becomes: the target, if the given path is a symbolic link.
    path: PathBuf,
}

#[cfg(any(feature = "files", feature = "plot"))]
impl Output {
    /// Creates the empty temporary file for the output `path`.
    ///
    /// # Errors
    /// As [`check_output`]; a folder that does not exist or cannot be written to.
    pub(crate) fn create(path: &Path) -> Result<Self> {
        let path = output_file(path)?;
        let folder = match path.parent() {
            Some(folder) if folder != Path::new("") => folder,
            _ => Path::new("."),
        };
        let mut builder = tempfile::Builder::new();
        builder.prefix(".deepct-").suffix(".partial");
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            // These are the default permissions of a new file, which the umask of the process
            // reduces.
            builder.permissions(std::fs::Permissions::from_mode(0o666));
        }
        let file = builder.tempfile_in(folder).map_err(Error::io(&path))?;
        Ok(Self { temporary: file.into_temp_path(), path })
    }

    /// The temporary file.
    pub(crate) fn temporary(&self) -> &Path {
        &self.temporary
    }

    /// Gives the file its name, in place of an existing file.
    ///
    /// # Errors
    /// A file that cannot be renamed.
    pub(crate) fn finish(self) -> Result<()> {
        let Self { temporary, path } = self;
        temporary.persist(&path).map_err(|problem| Error::io(&path)(problem.error))
    }

    /// Gives the file its name unless a file has it already.
    ///
    /// # Errors
    /// A file that cannot be renamed.
    #[cfg(feature = "files")]
    pub(crate) fn finish_if_new(self) -> Result<()> {
        let Self { temporary, path } = self;
        match temporary.persist_noclobber(&path) {
            Err(problem) if problem.error.kind() != std::io::ErrorKind::AlreadyExists => {
                Err(Error::io(&path)(problem.error))
            }
            _ => Ok(()),
        }
    }
}

/// The file that an output becomes.
#[cfg(any(feature = "files", feature = "plot"))]
fn output_file(path: &Path) -> Result<PathBuf> {
    match std::fs::metadata(path) {
        Ok(_) => {
            check_regular(path)?;
            path.canonicalize().map_err(Error::io(path))
        }
        // A link to a file that does not exist yet.
        Err(_) => {
            let folder = path.parent().filter(|folder| *folder != Path::new(""));
            if let Some(folder) = folder.filter(|folder| !folder.is_dir()) {
                let problem =
                    format!("is to be in the folder {}, which does not exist", folder.display());
                return Err(Error::file(path, "output", problem, "create the folder"));
            }
            match std::fs::read_link(path) {
                Ok(target) => Ok(path.parent().unwrap_or(Path::new("")).join(target)),
                Err(_) => Ok(path.into()),
            }
        }
    }
}

/// Returns an error if a command cannot write its output to `path`: a folder, a device or a pipe,
/// which a file would replace, or a path in a folder that does not exist.
///
/// # Errors
/// A path that exists and is not a regular file, or whose folder does not exist.
#[cfg(any(feature = "files", feature = "plot"))]
pub fn check_output(path: &Path) -> Result<()> {
    output_file(path).map(|_| ())
}

/// Writes a file under a temporary name, which then gets its own.
///
/// # Errors
/// A file that cannot be written.
#[cfg(any(feature = "files", feature = "plot"))]
pub fn write(path: &Path, contents: impl AsRef<[u8]>) -> Result<()> {
    let output = Output::create(path)?;
    std::fs::write(output.temporary(), contents).map_err(Error::io(path))?;
    output.finish()
}

/// SHA-256 of a file, in hexadecimal.
///
/// # Errors
/// A file that cannot be read.
#[cfg(feature = "files")]
pub fn sha256(path: &Path) -> Result<String> {
    use sha2::{Digest, Sha256};
    check_regular(path)?;
    let mut file = std::fs::File::open(path).map_err(Error::io(path))?;
    let mut digest = Sha256::new();
    let mut block = vec![0; 1 << 16];
    loop {
        match file.read(&mut block).map_err(Error::io(path))? {
            0 => break,
            count => digest.update(&block[..count]),
        }
    }
    Ok(hexadecimal(&digest.finalize()))
}

/// SHA-256 of parts of memory, in hexadecimal.
#[cfg(feature = "files")]
pub(crate) fn sha256_of<'a>(parts: impl IntoIterator<Item = &'a [u8]>) -> String {
    use sha2::{Digest, Sha256};
    let mut digest = Sha256::new();
    for part in parts {
        // With their lengths, so that other boundaries give another checksum.
        digest.update((part.len() as u64).to_le_bytes());
        digest.update(part);
    }
    hexadecimal(&digest.finalize())
}

#[cfg(feature = "files")]
fn hexadecimal(digest: &[u8]) -> String {
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}
