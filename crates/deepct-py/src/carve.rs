//! `carve`: the voxels that may contain cloud, given the images.

use crate::array::{Floats, IMAGES, give};
use crate::compute::quickly;
use crate::grid::Grid;
use crate::view::ViewSequence;
use deepct_core::Error;
use deepct_core::carve::CarveSettings;
use deepct_core::image::ViewStack;
use deepct_core::scene::{Light, Observation};
use numpy::PyArray3;
use pyo3::prelude::*;

/// A carved cloud mask and the radiance threshold that it is based on.
///
/// Attributes
/// ----------
/// mask : numpy.ndarray, bool, [z, y, x]
///     True in the voxels that may contain cloud. A voxel on which no view has a vote is kept.
/// threshold : float
///     The radiance (1/sr) above which a pixel was classified as cloudy.
#[pyclass(frozen, module = "deepct_py", get_all)]
pub(crate) struct Carved {
    mask: Py<PyArray3<bool>>,
    threshold: f32,
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
///     A pixel is cloudy above this radiance (1/sr). By default the threshold is derived from the
///     distribution of the radiances of all images.
/// standard_error : array, [view, row, col], optional
///     Standard error of the radiance (1/sr), such as the noise that `sense` returns: the derived
///     threshold is at least three times that of the clear pixels above them.
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
    radiance, views, grid, *, threshold = None, standard_error = None, agreement = None,
))]
pub(crate) fn carve(
    py: Python<'_>,
    radiance: &Bound<'_, PyAny>,
    views: ViewSequence,
    grid: Grid,
    threshold: Option<f32>,
    standard_error: Option<Bound<'_, PyAny>>,
    agreement: Option<f64>,
) -> PyResult<Carved> {
    let defaults = CarveSettings::default();
    let settings = CarveSettings { threshold, agreement: agreement.unwrap_or(defaults.agreement) };
    let radiance = Floats::new(radiance, "radiance", IMAGES)?.to_owned();
    let errors = standard_error
        .map(|errors| Ok::<_, PyErr>(Floats::new(&errors, "standard_error", IMAGES)?.to_owned()))
        .transpose()?;
    let carved = quickly(py, || {
        let images = ViewStack::new(radiance)?;
        // Carving does not depend on the scene illumination; the images may have any unit.
        let mut light = Light::default();
        light.sun.irradiance = f64::from(images.brightest()).max(1.0);
        let mut observation = Observation::new(light, views.0, images)?;
        observation.standard_error = errors.map(ViewStack::new).transpose()?;
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
        deepct_core::carve::carve(&observation, &grid.0, &settings)
    })?;
    Ok(Carved { mask: give(py, carved.mask.values), threshold: carved.threshold })
}
