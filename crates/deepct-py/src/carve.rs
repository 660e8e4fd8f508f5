//! `carve`: the voxels that may contain cloud, given the images.

use crate::array::{copied, give};
use crate::compute::interruptibly;
use crate::error::raise;
use crate::exchange::{dataset, provenance, through_field, warn_of_incomplete, write};
use crate::grid::Grid;
use crate::light::{Light, warn};
use crate::lineage::Lineage;
use crate::observation::{Given, observation};
use crate::record::{Record, attributes, record};
use crate::view::ViewSequence;
use deepct_core::carve::CarveSettings;
use deepct_core::grid::Mask;
use deepct_core::{io, scene};
use numpy::{PyArray1, PyArray3, ToPyArray};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;

/// A cloud mask and the radiance thresholds that it is based on. Functions accept it as their `mask`.
///
/// Parameters
/// ----------
/// grid : Grid
///     The grid of the mask.
/// mask : array of bool, [z, y, x]
///     True in the voxels that may contain cloud.
/// thresholds : array, [view], optional
///     The radiance (1/sr) above which a pixel of each view was classified as cloudy.
/// lineage : Lineage, optional
///     Its time and history. Default: unknown.
#[pyclass(frozen, module = "deepct_py")]
pub(crate) struct Carved {
    /// The grid of the mask.
    #[pyo3(get)]
    grid: Grid,
    /// True in the voxels that may contain cloud; a voxel on which no view has a vote is kept:
    /// numpy.ndarray, bool, [z, y, x].
    #[pyo3(get)]
    mask: Py<PyArray3<bool>>,
    /// The radiance (1/sr) above which a pixel of each view was classified as cloudy: numpy.ndarray,
    /// float32, [view]; None if it is unknown.
    #[pyo3(get)]
    thresholds: Option<Py<PyArray1<f32>>>,
    /// Its time and history.
    #[pyo3(get)]
    lineage: Lineage,
}

record!(@volume Carved);

impl Record for Carved {
    fn arguments<'py>(of: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        attributes(of.as_any(), &["grid", "mask", "thresholds", "lineage"])
    }
}

#[pymethods]
impl Carved {
    #[new]
    #[pyo3(signature = (grid, mask, thresholds = None, *, lineage = None))]
    fn new(
        grid: Grid,
        mask: &Bound<'_, PyAny>,
        thresholds: Option<Vec<f32>>,
        lineage: Option<Lineage>,
    ) -> PyResult<Self> {
        let py = mask.py();
        let values = crate::array::mask(mask, "mask")?.on(grid.0)?;
        let mask = Mask::new(grid.0, values).map_err(raise)?;
        let thresholds = thresholds.map(|values| values.to_pyarray(py).unbind());
        Ok(Self::give(py, mask, thresholds, lineage.unwrap_or_default()))
    }

    /// The mask in a data set of xarray with the variable `mask`. Coordinates may descend.
    #[staticmethod]
    fn from_dataset(dataset: &Bound<'_, PyAny>) -> PyResult<Self> {
        let py = dataset.py();
        through_field(dataset, "", |path| read_mask(py, path.into()))
    }

    /// Write a netCDF file that all commands and `read_mask` read. The thresholds are not in it. A file
    /// that deepct did not write is replaced only with `overwrite`.
    #[pyo3(signature = (path, *, title = "Voxels that may contain cloud", overwrite = false))]
    fn to_netcdf(
        &self,
        py: Python<'_>,
        path: PathBuf,
        title: &str,
        overwrite: bool,
    ) -> PyResult<()> {
        let mask = Mask::new(self.grid.0, copied(py, &self.mask)?).map_err(raise)?;
        let provenance = provenance(title, &self.lineage);
        write(py, &path, overwrite, |path| io::write_mask(path, &mask, &provenance))
    }

    /// The mask as a data set of xarray, with the variable of a file of a mask.
    fn to_xarray<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        dataset(py, |path| self.to_netcdf(py, path.into(), "Voxels that may contain cloud", false))
    }
}

impl Carved {
    fn give(
        py: Python<'_>,
        mask: Mask,
        thresholds: Option<Py<PyArray1<f32>>>,
        lineage: Lineage,
    ) -> Self {
        Self { grid: Grid(mask.grid), mask: give(py, mask.values), thresholds, lineage }
    }
}

/// Read a mask from a netCDF file: one of `carve`, or of a reconstruction.
///
/// Raises
/// ------
/// OSError
///     The file cannot be read.
/// DeepctError
///     The contents of the file are invalid; the message names the variable.
#[pyfunction]
pub(crate) fn read_mask(py: Python<'_>, path: PathBuf) -> PyResult<Carved> {
    warn_of_incomplete(py, &path)?;
    let mask = py.detach(|| io::read_mask(&path)).map_err(raise)?;
    Ok(Carved::give(py, mask, None, Lineage(io::read_lineage(&path))))
}

/// Carve a cloud mask from images: keep the voxels that a sufficient fraction of the views see
/// as cloudy.
///
/// A view votes for a voxel when one of its cloudy pixels sees some part of the voxel, and against
/// it when it sees the whole voxel and none of those pixels is cloudy. Otherwise it has no vote.
///
/// Parameters
/// ----------
/// radiance : Observation, array [view, row, col], str or path
///     Images (1/sr).
/// views : Views or sequence of View, optional
///     The camera geometry of each image, unless the images are an observation.
/// grid : Grid, object or path
///     The grid of the mask: a `Grid`, an object that has one, such as a `Cloud`, or a file with one.
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
///
/// Examples
/// --------
/// >>> cloud = deepct_py.generate_cloud(seed=3, width_km=0.4)
/// >>> images = deepct_py.render(cloud, views="cloudct-10", samples=16)
/// >>> carved = deepct_py.carve(images, grid=cloud.grid)
/// >>> bool(carved.mask[cloud.extinction > 20].mean() > 0.9)
/// True
#[pyfunction]
#[pyo3(
    signature = (
        radiance, views = None, grid = None, *, threshold = None, standard_error = None,
        saturated = None, agreement = None,
    ),
    text_signature = "(radiance, views=None, grid=None, *, threshold=None, standard_error=None, \
                      saturated=None, agreement=0.9)",
)]
#[allow(clippy::too_many_arguments)]
pub(crate) fn carve<'py>(
    radiance: &Bound<'py, PyAny>,
    views: Option<ViewSequence>,
    grid: Option<Grid>,
    threshold: Option<f32>,
    standard_error: Option<Bound<'py, PyAny>>,
    saturated: Option<Bound<'py, PyAny>>,
    agreement: Option<f64>,
) -> PyResult<Carved> {
    let py = radiance.py();
    let defaults = CarveSettings::default();
    let settings = CarveSettings { threshold, agreement: agreement.unwrap_or(defaults.agreement) };
    let lineage = Lineage::after(radiance, "carve")?;
    let Grid(grid) = grid.ok_or_else(|| PyTypeError::new_err("grid is missing"))?;
    let given = Given { views, light: None, standard_error, saturated };
    let observation = observation(radiance, given, |images| {
        // Carving does not depend on the scene illumination; the images may have any unit.
        let mut light = scene::Light::default();
        light.sun.irradiance = f64::from(images.brightest()).max(1.0);
        Ok(Light::from(light))
    })?;
    let carved =
        interruptibly(py, move || deepct_core::carve::carve(&observation, &grid, &settings))?;
    if let Some(warning) = carved.warning() {
        warn(py, &warning)?;
    }
    let thresholds = carved.thresholds.to_pyarray(py).unbind();
    Ok(Carved::give(py, carved.mask, Some(thresholds), lineage))
}
