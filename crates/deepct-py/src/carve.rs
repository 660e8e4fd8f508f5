//! `carve`: the voxels that may contain cloud, given the images.

use crate::array::{Floats, IMAGES, booleans, give};
use crate::compute::quickly;
use crate::grid::Grid;
use crate::view::ViewSequence;
use deepct_core::Error;
use deepct_core::carve::CarveSettings;
use deepct_core::image::ViewStack;
use deepct_core::scene::{Light, Observation};
use numpy::{PyArray1, PyArray3, ToPyArray};
use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;
use std::ffi::CString;

/// A carved cloud mask and the radiance thresholds that it is based on.
///
/// Attributes
/// ----------
/// mask : numpy.ndarray, bool, [z, y, x]
///     True in the voxels that may contain cloud. A voxel on which no view has a vote is kept.
/// thresholds : numpy.ndarray, float32, [view]
///     The radiance (1/sr) above which a pixel of each view was classified as cloudy.
#[pyclass(frozen, module = "deepct_py", get_all)]
pub(crate) struct Carved {
    mask: Py<PyArray3<bool>>,
    thresholds: Py<PyArray1<f32>>,
}

/// Carve a cloud mask from images: keep the voxels that a sufficient fraction of the views see
/// as cloudy.
///
/// A view votes for a voxel when one of its cloudy pixels sees some part of the voxel, and against
/// it when it sees the whole voxel and none of those pixels is cloudy. Otherwise it has no vote.
///
/// Parameters
/// ----------
/// radiance : array, [view, row, col]
///     Images (1/sr).
/// views : Views or sequence of View
///     The camera geometry of each image.
/// grid : Grid
///     The grid of the mask.
/// threshold : float, optional
///     A pixel is cloudy above this radiance (1/sr). By default the threshold of each view is derived
///     from the distributions of the radiances of all images.
/// standard_error : array, [view, row, col], optional
///     Standard error of the radiance (1/sr), such as the noise that `sense` returns: the derived
///     threshold is at least three times that of the clear pixels above them. Pixels with an infinite
///     standard error may show cloud.
/// saturated : array of bool, [view, row, col], optional
///     The pixels that are saturated, which may show cloud.
/// agreement : float, optional
///     A voxel is kept when at least this fraction of the views that have a vote on it vote for
///     it (0 to 1). Default: 0.9.
///
/// Returns
/// -------
/// Carved
///
/// Raises
/// ------
/// ValueError
///     The images do not match the views, or a parameter is out of range.
#[pyfunction]
#[pyo3(signature = (
    radiance, views, grid, *, threshold = None, standard_error = None, saturated = None,
    agreement = None,
))]
#[allow(clippy::too_many_arguments)]
pub(crate) fn carve(
    py: Python<'_>,
    radiance: &Bound<'_, PyAny>,
    views: ViewSequence,
    grid: Grid,
    threshold: Option<f32>,
    standard_error: Option<Bound<'_, PyAny>>,
    saturated: Option<Bound<'_, PyAny>>,
    agreement: Option<f64>,
) -> PyResult<Carved> {
    let defaults = CarveSettings::default();
    let settings = CarveSettings { threshold, agreement: agreement.unwrap_or(defaults.agreement) };
    let radiance = Floats::new(radiance, "radiance", IMAGES)?.to_owned();
    let errors = standard_error
        .map(|errors| Ok::<_, PyErr>(Floats::new(&errors, "standard_error", IMAGES)?.to_owned()))
        .transpose()?;
    let saturated = saturated.map(|marks| booleans(&marks, "saturated", IMAGES)).transpose()?;
    let carved = quickly(py, || {
        let images = ViewStack::new(radiance)?;
        // Carving does not depend on the scene illumination; the images may have any unit.
        let mut light = Light::default();
        light.sun.irradiance = f64::from(images.brightest()).max(1.0);
        let mut observation = Observation::new(light, views.0, images)?;
        observation.standard_error = errors.map(ViewStack::of_errors).transpose()?;
        if let Some(errors) = &observation.standard_error {
            let (found, expected) = (errors.shape(), observation.images.shape());
            if found != expected {
                let range = format!("{expected:?}, that of the radiance");
                return Err(Error::out_of_range(
                    "shape of standard_error",
                    format!("{found:?}"),
                    range,
                ));
            }
        }
        if let Some(saturated) = saturated {
            observation = observation.with_saturated(saturated)?;
        }
        deepct_core::carve::carve(&observation, &grid.0, &settings)
    })?;
    if let Some(warning) = carved.warning() {
        warn(py, &warning)?;
    }
    let thresholds = carved.thresholds.to_pyarray(py).unbind();
    Ok(Carved { mask: give(py, carved.mask.values), thresholds })
}

/// Issues a warning.
pub(crate) fn warn(py: Python<'_>, warning: &str) -> PyResult<()> {
    let text = CString::new(warning).expect("no zero byte");
    PyErr::warn(py, &py.get_type::<PyUserWarning>(), &text, 1)
}
