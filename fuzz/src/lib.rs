//! Functions shared by the fuzz targets.

use std::io::Write;

/// Write `bytes` to a temporary file with the given suffix and call `read` with its path.
pub fn with_file(bytes: &[u8], suffix: &str, read: impl FnOnce(&std::path::Path)) {
    let mut file = tempfile::Builder::new().suffix(suffix).tempfile().unwrap();
    file.write_all(bytes).unwrap();
    read(file.path());
}
