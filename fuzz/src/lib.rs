//! Functions shared by the fuzz targets.

mod edits;
pub mod valid;

pub use edits::{Edit, edited};

use deepct_core::cloud::Cloud;
use deepct_core::io::Provenance;
use libfuzzer_sys::arbitrary::{self, Arbitrary};
use ndarray::Array3;
use std::path::Path;
use std::sync::OnceLock;

/// A folder for the files of this process, in memory where the system has a file system there: most
/// executions write a file.
pub fn folder() -> &'static Path {
    static FOLDER: OnceLock<tempfile::TempDir> = OnceLock::new();
    let create = || tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap();
    FOLDER.get_or_init(create).path()
}

/// Writes `bytes` to a file and calls `read` with its path. The same file is used again, as the
/// process has one thread.
pub fn with_file(bytes: &[u8], suffix: &str, read: impl FnOnce(&Path)) {
    let path = folder().join(format!("input{suffix}"));
    std::fs::write(&path, bytes).unwrap();
    read(&path);
}

/// A safetensors file with the given header, and zeros for the tensors that it declares. Without
/// the length of the header in front, mutations of the header reach the parser.
pub fn safetensors_with(header: &[u8]) -> Vec<u8> {
    const MOST: u64 = 1 << 20;
    let declared = serde_json::from_slice::<serde_json::Value>(header).ok();
    let tensors = declared.as_ref().and_then(|value| value.as_object());
    let ends = tensors.into_iter().flat_map(|tensors| {
        tensors.values().filter_map(|tensor| tensor.get("data_offsets")?.get(1)?.as_u64())
    });
    let data = ends.max().unwrap_or(0).min(MOST) as usize;
    let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
    bytes.extend_from_slice(header);
    bytes.resize(bytes.len() + data, 0);
    bytes
}

/// Asserts that a cloud has finite values.
pub fn check_cloud(cloud: &Cloud) {
    let finite = |values: &Array3<f32>| values.iter().all(|value| value.is_finite());
    let positive = |values: &Array3<f32>| values.iter().all(|value| (0.0..1e9).contains(value));
    if let Some(droplets) = &cloud.microphysics {
        assert!(positive(&droplets.liquid_water_content), "{droplets:?}");
        assert!(finite(&droplets.effective_radius) && finite(&droplets.effective_variance));
    }
    if let Some(extinction) = &cloud.extinction {
        assert!(positive(extinction), "{extinction}");
    }
}

/// The provenance of files of the targets.
pub fn provenance() -> Provenance {
    Provenance { title: "fuzzing".into(), ..Provenance::default() }
}

/// Numbers that are used one after another, and then again from the first.
#[derive(Debug, Arbitrary)]
pub struct Values {
    numbers: Vec<f32>,
    used: u8,
}

impl Values {
    /// A field of the next numbers.
    pub fn field(&mut self, shape: [usize; 3]) -> Array3<f32> {
        let Self { numbers, used } = self;
        Array3::from_shape_simple_fn(shape, || {
            *used = used.wrapping_add(1);
            numbers.get(usize::from(*used) % numbers.len().max(1)).copied().unwrap_or(0.5)
        })
    }
}
