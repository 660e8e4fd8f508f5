//! `score`: errors of an estimate of the extinction.

use crate::array::{Floats, VOLUME, check_same};
use crate::compute::compute;
use deepct_core::grid::{Grid, Volume};
use deepct_core::math::DVec3;
use deepct_core::metrics;
use numpy::ndarray::Array1;
use numpy::{IntoPyArray, PyArray1};
use pyo3::prelude::*;

/// Errors of an estimated extinction field relative to the true field.
#[pyclass(frozen, module = "deepct_py")]
pub(crate) struct Scores(metrics::Scores);

#[pymethods]
impl Scores {
    /// Relative error epsilon = ||truth - estimate||_1 / ||truth||_1 (Sde-Chen et al. 2021).
    #[getter]
    fn relative_error(&self) -> f64 {
        self.0.relative_error
    }

    /// Mass error delta = (||truth||_1 - ||estimate||_1) / ||truth||_1 (Sde-Chen et al. 2021):
    /// positive if the estimate contains too little extinction.
    #[getter]
    fn mass_error(&self) -> f64 {
        self.0.mass_error
    }

    /// Root mean square difference over all voxels (1/km).
    #[getter]
    fn root_mean_square_error(&self) -> f64 {
        self.0.root_mean_square_error
    }

    /// Pearson correlation coefficient over all voxels; None if one field is constant.
    #[getter]
    fn correlation(&self) -> Option<f64> {
        self.0.correlation
    }

    /// Mean of the true extinction at each level (1/km), [z].
    #[getter]
    fn truth_by_level<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.by_level(py, |level| level.truth)
    }

    /// Mean of the estimated extinction at each level (1/km), [z].
    #[getter]
    fn estimate_by_level<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.by_level(py, |level| level.estimate)
    }

    /// Relative error at each level, [z]; NaN at levels where the true extinction is zero.
    #[getter]
    fn relative_error_by_level<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.by_level(py, |level| level.relative_error.unwrap_or(f64::NAN))
    }

    fn __repr__(&self) -> String {
        let metrics::Scores { relative_error, mass_error, root_mean_square_error, .. } = self.0;
        format!(
            "Scores(relative_error={relative_error:.4}, mass_error={mass_error:.4}, \
             root_mean_square_error={root_mean_square_error:.4})"
        )
    }
}

impl Scores {
    fn by_level<'py>(
        &self,
        py: Python<'py>,
        number: impl Fn(&metrics::LevelScore) -> f64,
    ) -> Bound<'py, PyArray1<f64>> {
        self.0.profile.iter().map(number).collect::<Array1<_>>().into_pyarray(py)
    }
}

/// Compute the errors of an estimated extinction field. Both fields must be on the same grid.
///
/// Parameters
/// ----------
/// truth, estimate : array, [z, y, x]
///     Extinction (1/km).
///
/// Returns
/// -------
/// Scores
///
/// Raises
/// ------
/// ValueError
///     The shapes or the coordinates differ, a value is not finite, or the true field is zero everywhere.
#[pyfunction]
pub(crate) fn score(
    py: Python<'_>,
    truth: &Bound<'_, PyAny>,
    estimate: &Bound<'_, PyAny>,
) -> PyResult<Scores> {
    check_same(&[(Some(truth), "truth"), (Some(estimate), "estimate")], VOLUME)?;
    let truth = Floats::new(truth, "truth", VOLUME)?.to_owned();
    let estimate = Floats::new(estimate, "estimate", VOLUME)?.to_owned();
    compute(py, move |_| {
        // The scores do not depend on the position and size of the voxels.
        let (nz, ny, nx) = truth.dim();
        let grid = Grid::new(DVec3::ZERO, DVec3::ONE, [nz, ny, nx])?;
        metrics::score(&Volume::new(grid, truth)?, &Volume::new(grid, estimate)?)
    })
    .map(Scores)
}
