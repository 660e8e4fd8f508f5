//! Which files an output may replace: a file of another program would be lost.

use super::netcdf::is_own_file;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// The first bytes of formats in which files do not state their origin.
const SIGNATURES: [(&str, &[u8]); 10] = [
    ("html", b"<!DOCTYPE html>\n<!-- deepct -->"),
    ("png", b"\x89PNG"),
    ("svg", b"<?xml version=\"1.0\"?>\n<!-- deepct -->"),
    // `deep` with the bits that mark a file as binary.
    ("pdf", b"%PDF-1.7\n%\xe4\xe5\xe5\xf0"),
    ("exr", b"\x76\x2f\x31\x01"),
    ("tif", b"II"),
    ("npz", b"PK"),
    ("vol", b"VOL"),
    ("vti", b"<?xml"),
    ("mat", b"MATLAB 5.0"),
];

/// Whether an output may take the place of what is at `path`: nothing, an empty file, one that deepct wrote
/// or one of the format that deepct would write under this name.
pub fn is_replaceable(path: impl AsRef<Path>) -> bool {
    let path = path.as_ref();
    let Ok(found) = path.metadata() else { return true };
    // What is no file is refused by what writes.
    let holds_nothing = !found.is_file() || found.len() == 0;
    let ending = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let signature = SIGNATURES.iter().find(|(name, _)| *name == ending);
    holds_nothing
        || match signature {
            None => is_own_file(path),
            Some((_, expected)) => {
                let mut start = vec![0; expected.len()];
                let read = File::open(path).and_then(|mut file| file.read_exact(&mut start));
                read.is_ok() && start == *expected
            }
        }
}
