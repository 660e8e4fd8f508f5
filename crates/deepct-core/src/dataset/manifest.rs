//! What a data set holds, and how it was made.

use super::{DatasetSettings, Split};
use crate::error::{Error, Result};
use crate::image::ViewGeometry;
use crate::network::Levels;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The name of the format, in every manifest.
pub const FORMAT: &str = "deepct-dataset 2";

/// One sample of a data set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sample {
    /// Its file, relative to the data set's folder.
    pub file: PathBuf,
    /// The set that it belongs to.
    pub split: Split,
    /// The simulation that it is from.
    pub source: PathBuf,
    /// The index of the snapshot.
    pub snapshot: usize,
    /// Row and column of the simulation at its south-west corner; beyond the sides, it
    /// is counted into the periodic neighbours.
    pub corner: [i64; 2],
    /// SHA-256 of the file, in hexadecimal.
    pub sha256: String,
}

/// `manifest.json`: what a data set holds and how it was made.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// [`FORMAT`].
    pub format: String,
    /// Version of the program that made it.
    pub deepct_version: String,
    /// Formation that looked at the clouds.
    pub formation: String,
    /// Its geometry in numbers.
    pub geometry: ViewGeometry,
    /// Rows and columns of an image.
    pub image_shape: [usize; 2],
    /// Size of a voxel along x, y, z (km).
    pub voxel_spacing_km: [f64; 3],
    /// The vertical axis.
    pub levels: Levels,
    /// The settings that made it.
    pub configuration: DatasetSettings,
    /// The samples, in the order of the plan.
    pub samples: Vec<Sample>,
}

impl Manifest {
    /// The manifest of a data set's folder.
    ///
    /// # Errors
    /// A manifest that is missing, unreadable or of another format.
    pub fn read(folder: &Path) -> Result<Self> {
        let path = Self::path(folder);
        let text = std::fs::read_to_string(&path).map_err(Error::io(&path))?;
        let remedy = "make the data set again with `deepct dataset generate`";
        let manifest: Self = serde_json::from_str(&text)
            .map_err(|problem| Error::file(&path, "manifest", problem.to_string(), remedy))?;
        if manifest.format != FORMAT {
            let problem = format!("\"{}\" is not \"{FORMAT}\"", manifest.format);
            return Err(Error::file(&path, "format", problem, remedy));
        }
        Ok(manifest)
    }

    /// Where the manifest of a data set's folder is.
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
