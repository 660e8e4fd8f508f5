//! Fields as arguments: objects of this module, data sets of xarray, arrays, or the names of files.

use crate::array::{Placed, volume};
use crate::cloud::Cloud;
use crate::error::raise;
use crate::exchange::{is_dataset, warn_of_incomplete};
use deepct_core::{cloud, grid, io, scene};
use pyo3::prelude::*;
use std::path::PathBuf;

/// The extinction of an argument. That of droplets is the one in the given light, as on the command line.
///
/// # Errors
/// As [`volume`]; a file that cannot be read, or droplets without an extinction in this light.
pub(crate) fn extinction(
    object: &Bound<'_, PyAny>,
    name: &str,
    light: &scene::Light,
) -> PyResult<Placed<f32>> {
    let found = match cloud(object)? {
        Some(cloud) => light.extinction(&cloud).map_err(raise)?,
        None => match object.extract::<PathBuf>() {
            Ok(path) => {
                warn_of_incomplete(object.py(), &path)?;
                object.py().detach(|| io::read_extinction(path, light)).map_err(raise)?
            }
            Err(_) => return volume(object, name),
        },
    };
    Ok(Placed::new(found.grid, found.values, name))
}

/// The cloud of an argument that is a `Cloud`, or a data set of one that is given by its droplets.
pub(crate) fn cloud(object: &Bound<'_, PyAny>) -> PyResult<Option<cloud::Cloud>> {
    let py = object.py();
    if let Ok(cloud) = object.cast::<Cloud>() {
        return cloud.get().core(py).map(Some);
    }
    let has_droplets =
        is_dataset(object)? && object.contains("lwc")? && !object.contains("extinction")?;
    has_droplets.then(|| Cloud::from_dataset(object)?.core(py)).transpose()
}

/// The mask of an argument.
///
/// # Errors
/// As [`crate::array::mask`]; a file that cannot be read.
pub(crate) fn mask(object: &Bound<'_, PyAny>, name: &str) -> PyResult<Placed<bool>> {
    let Ok(path) = object.extract::<PathBuf>() else { return crate::array::mask(object, name) };
    warn_of_incomplete(object.py(), &path)?;
    let found: grid::Mask = object.py().detach(|| io::read_mask(path)).map_err(raise)?;
    Ok(Placed::new(found.grid, found.values, name))
}
