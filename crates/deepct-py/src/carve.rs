//! `carve`: which voxels the images allow to hold cloud.

use crate::array::{Floats, IMAGES, give};
use crate::error::raise;
use crate::grid::Grid;
use crate::view::ViewSequence;
use deepct_core::carve::CarveSettings;
use deepct_core::image::ViewStack;
use deepct_core::scene::{Light, Observation};
use numpy::PyArray3;
use pyo3::prelude::*;

/// A carved mask and what it was made with.
///
/// Attributes
/// ----------
/// mask : numpy.ndarray, bool, [z, y, x]
///     The voxels that are kept. One that no view has a vote on is kept.
/// threshold : float
///     The radiance (1/sr) above which a pixel was taken as cloudy.
#[pyclass(frozen, module = "deepct_py", get_all)]
pub(crate) struct Carved {
    mask: Py<PyArray3<bool>>,
    threshold: f32,
}

/// Carve a grid by the images of a cloud: keep the voxels that enough views vote for.
///
/// Parameters
/// ----------
/// radiance : array, [view, row, col]
///     Images (1/sr).
/// views : Views or sequence of View
///     How they were taken, one for each image.
/// grid : Grid
///     Where the voxels are.
/// threshold : float, optional
///     A pixel is cloudy above this radiance (1/sr). Found from the histogram of all
///     images where it is not given.
/// agreement : float
///     A voxel is kept when at least this share of the views that have a vote on it vote
///     for it.
///
/// Returns
/// -------
/// Carved
///
/// Raises
/// ------
/// ValueError
///     Images that do not fit the views, a number out of range, or images in which no
///     threshold can be found.
#[pyfunction]
#[pyo3(signature = (radiance, views, grid, *, threshold = None, agreement = None))]
pub(crate) fn carve(
    py: Python<'_>,
    radiance: &Bound<'_, PyAny>,
    views: ViewSequence,
    grid: Grid,
    threshold: Option<f32>,
    agreement: Option<f64>,
) -> PyResult<Carved> {
    let defaults = CarveSettings::default();
    let settings = CarveSettings { threshold, agreement: agreement.unwrap_or(defaults.agreement) };
    let radiance = Floats::new(radiance, "radiance", IMAGES)?.to_owned();
    let carved = py
        .detach(|| {
            // Carving does not ask where the light came from.
            let images = ViewStack::new(radiance)?;
            let observation = Observation::new(Light::default(), views.0, images)?;
            deepct_core::carve::carve(&observation, &grid.0, &settings)
        })
        .map_err(raise)?;
    Ok(Carved { mask: give(py, carved.mask.values), threshold: carved.threshold })
}
