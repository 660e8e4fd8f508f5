//! What the fuzz targets share.

use std::io::Write;

/// Put `bytes` into a temporary file with that suffix and hand its path to `read`.
pub fn with_file(bytes: &[u8], suffix: &str, read: impl FnOnce(&std::path::Path)) {
    let mut file = tempfile::Builder::new().suffix(suffix).tempfile().unwrap();
    file.write_all(bytes).unwrap();
    read(file.path());
}
