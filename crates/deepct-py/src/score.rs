//! `score`: errors of an estimate of the extinction.

use crate::compute::quickly;
use crate::field::extinction;
use crate::light::Light;
use crate::record::{Record, attributes, record};
use deepct_core::grid::{Grid, Volume};
use deepct_core::math::DVec3;
use deepct_core::{metrics, scene};
use numpy::ndarray::Array1;
use numpy::{IntoPyArray, PyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Errors of an estimated extinction field relative to the true field.
///
/// Constructed by `score`; the keyword arguments are the attributes.
#[pyclass(frozen, module = "deepct_py")]
pub(crate) struct Scores(metrics::Scores);

record!(Scores);

/// The values of all levels.
const BY_LEVEL: [&str; 3] = ["truth_by_level", "estimate_by_level", "relative_error_by_level"];

impl Record for Scores {
    fn arguments<'py>(of: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        let numbers = ["relative_error", "mass_error", "root_mean_square_error", "correlation"];
        let arguments = attributes(of.as_any(), &[&numbers[..], &BY_LEVEL[..]].concat())?;
        Ok(arguments)
    }
}

#[pymethods]
impl Scores {
    #[new]
    #[pyo3(signature = (
        *, relative_error, mass_error, root_mean_square_error, correlation = None, truth_by_level,
        estimate_by_level, relative_error_by_level,
    ))]
    fn new(
        relative_error: f64,
        mass_error: f64,
        root_mean_square_error: f64,
        correlation: Option<f64>,
        truth_by_level: Vec<f64>,
        estimate_by_level: Vec<f64>,
        relative_error_by_level: Vec<f64>,
    ) -> PyResult<Self> {
        let levels = truth_by_level.len();
        if estimate_by_level.len() != levels || relative_error_by_level.len() != levels {
            let lengths = "the values by level must have one length";
            return Err(PyValueError::new_err(lengths));
        }
        let profile = (0..levels).map(|level| metrics::LevelScore {
            altitude: level as f64 + 0.5,
            truth: truth_by_level[level],
            estimate: estimate_by_level[level],
            relative_error: Some(relative_error_by_level[level]).filter(|error| !error.is_nan()),
        });
        Ok(Self(metrics::Scores {
            relative_error,
            mass_error,
            root_mean_square_error,
            correlation,
            profile: profile.collect(),
        }))
    }

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
/// The extinction of a cloud that is given by its droplets is the one in the light that the estimate
/// states, as by `deepct score`: an `Estimate`, a `Reconstruction`, a data set of xarray or a file of
/// these. It is geometric where no light is known, as for arrays.
///
/// Parameters
/// ----------
/// truth, estimate : Cloud, Estimate, Reconstruction, array [z, y, x], str or path
///     Extinction (1/km).
///
/// Returns
/// -------
/// Scores
///
/// Raises
/// ------
/// ValueError
///     The shapes or the grids differ, a value is not finite, or the true field is zero everywhere.
///
/// Examples
/// --------
/// >>> truth = np.array([[[0.0, 10.0, 30.0]]])
/// >>> deepct_py.score(truth, [[[5.0, 10.0, 25.0]]]).relative_error
/// 0.25
#[pyfunction]
pub(crate) fn score(
    py: Python<'_>,
    truth: &Bound<'_, PyAny>,
    estimate: &Bound<'_, PyAny>,
) -> PyResult<Scores> {
    let light = Light::of(estimate)?.map_or_else(scene::Light::default, |light| light.core);
    let truth = extinction(truth, "truth", &light)?;
    let estimate = extinction(estimate, "estimate", &light)?;
    if let Some(grid) = truth.grid {
        estimate.grid(Some(grid))?;
    }
    let (truth, estimate) = (truth.values, estimate.values);
    quickly(py, || {
        // The scores do not depend on the position and size of the voxels.
        let (nz, ny, nx) = truth.dim();
        let grid = Grid::new(DVec3::ZERO, DVec3::ONE, [nz, ny, nx])?;
        metrics::score(&Volume::new(grid, truth)?, &Volume::new(grid, estimate)?)
    })
    .map(Scores)
}
