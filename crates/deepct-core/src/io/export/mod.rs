//! Export of fields and images to formats of other programs.
//!
//! The format follows from the ending of the file's name:
//!
//! | ending | of | content |
//! |---|---|---|
//! | `.vti` | fields | VTK image data (ParaView, PyVista): one value per cell, lengths in km |
//! | `.vol` | fields | grid volume of Mitsuba 3: the extinction (1/km) in a box in km |
//! | `.npz` | both | NumPy arrays, named as in deepct's own files |
//! | `.mat` | both | MATLAB 5 arrays, named as in deepct's own files |
//! | `.tif` | images | 16-bit grey levels, one page per view, north up |
//! | `.png` | images | 16-bit grey levels, one file per view, north up |
//! | `.exr` | images | 32-bit floats, one layer per view, north up |

mod arrays;
mod matlab;
mod mitsuba;
mod numpy;
mod pictures;
mod vtk;

pub use arrays::{Field, Fields};

use crate::error::{Error, Result};
use crate::scene::Observation;
use std::path::{Path, PathBuf};

/// Endings of the formats of fields.
const FIELD_FORMATS: [&str; 4] = ["vti", "vol", "npz", "mat"];
/// Endings of the formats of images.
const IMAGE_FORMATS: [&str; 5] = ["npz", "mat", "tif", "png", "exr"];

/// Write fields in the format that the ending of `path` names.
///
/// # Errors
/// Returns an error if there is no such format for fields, if the format cannot hold them, or if
/// the file cannot be written.
pub fn export_fields(path: impl AsRef<Path>, fields: &Fields) -> Result<()> {
    let path = path.as_ref();
    match ending(path).as_str() {
        "vti" => vtk::write(path, fields),
        "vol" => mitsuba::write(path, fields),
        "npz" => numpy::write(path, &fields.arrays()),
        "mat" => matlab::write(path, &fields.arrays()),
        _ => Err(unknown_ending(path, "fields", &FIELD_FORMATS)),
    }
}

/// Write images in the format that the ending of `path` names. Returns the files, and the radiance
/// (1/sr) of the largest grey level where images are stored as grey levels.
///
/// # Errors
/// As [`export_fields`].
pub fn export_images(
    path: impl AsRef<Path>,
    observation: &Observation,
) -> Result<(Vec<PathBuf>, Option<f32>)> {
    let path = path.as_ref();
    let one = |written: Result<()>| written.map(|()| (vec![path.to_owned()], None));
    match ending(path).as_str() {
        "npz" => one(numpy::write(path, &arrays::of_images(observation))),
        "mat" => one(matlab::write(path, &arrays::of_images(observation))),
        "exr" => one(super::write_exr(path, observation)),
        "tif" | "tiff" => {
            let white = pictures::write_tiff(path, observation)?;
            Ok((vec![path.to_owned()], Some(white)))
        }
        "png" => {
            let (files, white) = pictures::write_pngs(path, observation)?;
            Ok((files, Some(white)))
        }
        _ => Err(unknown_ending(path, "images", &IMAGE_FORMATS)),
    }
}

fn ending(path: &Path) -> String {
    path.extension().unwrap_or_default().to_string_lossy().to_lowercase()
}

fn unknown_ending(path: &Path, content: &str, formats: &[&str]) -> Error {
    let problem = format!("has no ending of a format for {content}");
    let endings: Vec<_> = formats.iter().map(|format| format!(".{format}")).collect();
    Error::file(path, "name", problem, format!("use one of {}", endings.join(", ")))
}
