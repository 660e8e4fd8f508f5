//! The manifest of a data set.

use super::{DatasetSettings, Split};
use crate::error::{Error, Result};
use crate::image::ViewGeometry;
use crate::network::Levels;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The name and version of the format, stated in every manifest.
pub const FORMAT: &str = "deepct-dataset 2";

/// One sample of a data set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sample {
    /// The file of the sample, relative to the folder of the data set.
    pub file: PathBuf,
    /// The split to which the sample belongs.
    pub split: Split,
    /// The simulation from which it was taken.
    pub source: PathBuf,
    /// The index of the snapshot.
    pub snapshot: usize,
    /// Row and column of the simulation at the south-west corner of the sample. They may lie
    /// outside the field, in its periodic continuation.
    pub corner: [i64; 2],
    /// SHA-256 of the file in hexadecimal.
    pub sha256: String,
}

/// The contents of `manifest.json`: the samples of a data set and the settings from which they
/// were generated.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// [`FORMAT`].
    pub format: String,
    /// Version of deepct that generated the data set.
    pub deepct_version: String,
    /// Name of the formation that observed the clouds.
    pub formation: String,
    /// View geometry of the formation.
    pub geometry: ViewGeometry,
    /// Number of rows and columns of an image.
    pub image_shape: [usize; 2],
    /// Size of a voxel along x, y, z (km).
    pub voxel_spacing_km: [f64; 3],
    /// The vertical axis.
    pub levels: Levels,
    /// The settings from which the data set was generated.
    pub configuration: DatasetSettings,
    /// The samples, in the order of the plan.
    pub samples: Vec<Sample>,
}

impl Manifest {
    /// Read the manifest of a data set from its folder.
    ///
    /// # Errors
    /// Returns an error if the manifest is missing, unreadable or in another format.
    pub fn read(folder: &Path) -> Result<Self> {
        let path = Self::path(folder);
        let text = crate::files::read_text(&path)?;
        let remedy = "make the data set again with `deepct dataset generate`";
        let manifest: Self = serde_json::from_str(&text)
            .map_err(|problem| Error::file(&path, "manifest", problem.to_string(), remedy))?;
        if manifest.format != FORMAT {
            let problem = format!("\"{}\" is not \"{FORMAT}\"", manifest.format);
            return Err(Error::file(&path, "format", problem, remedy));
        }
        Ok(manifest)
    }

    /// The path of the manifest in the folder of a data set.
    pub fn path(folder: &Path) -> PathBuf {
        folder.join("manifest.json")
    }

    pub(super) fn write(&self, folder: &Path) -> Result<()> {
        let path = Self::path(folder);
        let text = serde_json::to_string_pretty(self).map_err(|problem| {
            Error::file(&path, "manifest", problem.to_string(), "report this as a bug")
        })?;
        crate::files::write(&path, &text)
    }
}
