//! `Grid`: the regular grid of a volume.

use crate::array::grid_of;
use crate::error::raise;
use crate::number::{point, sizes};
use crate::record::{Record, attributes, record};
use deepct_core::{grid, io};
use numpy::ndarray::Array1;
use numpy::{IntoPyArray, PyArray1};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;

/// A regular grid of voxels: voxel `[k, j, i]` (z, y, x) spans from
/// `origin + (i, j, k) * spacing` to `origin + (i + 1, j + 1, k + 1) * spacing`.
///
/// Parameters
/// ----------
/// shape : (int, int, int)
///     Number of voxels along z, y, x: the shape of an array on this grid.
/// spacing : (float, float, float)
///     Voxel size along x, y, z (km).
/// origin : (float, float, float)
///     The south-west-bottom corner of the grid along x, y, z (km).
///
/// Raises
/// ------
/// ValueError
///     A spacing is not positive, an axis has no voxels, or the grid has too many voxels.
///
/// Examples
/// --------
/// >>> grid = deepct_py.Grid(shape=(20, 32, 32), spacing=(0.05, 0.05, 0.04))
/// >>> grid.center
/// (0.8, 0.8, 0.4)
#[pyclass(frozen, module = "deepct_py")]
#[derive(Clone, Copy)]
pub(crate) struct Grid(pub(crate) grid::Grid);

record!(Grid);

impl Record for Grid {
    fn arguments<'py>(of: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        attributes(of.as_any(), &["shape", "spacing", "origin"])
    }
}

#[pymethods]
impl Grid {
    #[new]
    #[pyo3(
        signature = (shape, spacing, origin = None),
        text_signature = "(shape, spacing, origin=(0.0, 0.0, 0.0))",
    )]
    fn new(
        shape: &Bound<'_, PyAny>,
        spacing: &Bound<'_, PyAny>,
        origin: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let origin = origin.map(|origin| point(origin, "origin")).transpose()?.unwrap_or_default();
        let shape = sizes(shape, "shape", ["z", "y", "x"])?;
        grid::Grid::new(origin, point(spacing, "spacing")?, shape).map(Self).map_err(raise)
    }

    /// The grid of an xarray object, from the coordinates z, y and x of the voxel centres (km unless
    /// their attribute `units` states another unit). Coordinates may descend.
    #[staticmethod]
    fn from_dataset(dataset: &Bound<'_, PyAny>) -> PyResult<Self> {
        grid_of(dataset).map(Self)
    }

    /// Read a grid from any file with coordinates z, y and x, or from a TOML file with `origin_km`,
    /// `spacing_km` (x, y, z) and `shape` (z, y, x).
    #[staticmethod]
    fn from_file(path: PathBuf) -> PyResult<Self> {
        io::read_grid(path).map(Self).map_err(raise)
    }

    /// Number of voxels along z, y, x.
    #[getter]
    fn shape(&self) -> (usize, usize, usize) {
        self.0.shape.into()
    }

    /// Voxel size along x, y, z (km).
    #[getter]
    fn spacing(&self) -> (f64, f64, f64) {
        self.0.spacing.into()
    }

    /// The south-west-bottom corner of the grid along x, y, z (km).
    #[getter]
    fn origin(&self) -> (f64, f64, f64) {
        self.0.origin.into()
    }

    /// The centre of the grid along x, y, z (km).
    #[getter]
    fn center(&self) -> (f64, f64, f64) {
        self.0.center().into()
    }

    /// Coordinates of the voxel centres along x, towards the east (km).
    #[getter]
    fn x<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.axis(py, 0)
    }

    /// Coordinates of the voxel centres along y, towards the north (km).
    #[getter]
    fn y<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.axis(py, 1)
    }

    /// Altitudes of the voxel centres (km).
    #[getter]
    fn z<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.axis(py, 2)
    }
}

/// A grid as an argument: itself, or what has one.
impl FromPyObject<'_, '_> for Grid {
    type Error = PyErr;

    fn extract(object: Borrowed<'_, '_, PyAny>) -> PyResult<Self> {
        let is_grid = |object: &Bound<'_, PyAny>| Some(*object.cast::<Self>().ok()?.get());
        let own = is_grid(&object).or_else(|| is_grid(&object.getattr("grid").ok()?));
        if let Some(grid) = own {
            return Ok(grid);
        }
        if let Ok(path) = object.extract() {
            return Self::from_file(path);
        }
        if object.hasattr("coords")? {
            return Self::from_dataset(&object);
        }
        let found = object.get_type();
        Err(PyTypeError::new_err(format!(
            "grid must be a Grid, an object that has one, such as a Cloud, or the name of a file with one, \
             not {found}"
        )))
    }
}

/// The grid of an argument for the functions of this package that are written in Python.
#[pyfunction]
pub(crate) fn grid_from(grid: Grid) -> Grid {
    grid
}

impl Grid {
    fn axis<'py>(&self, py: Python<'py>, axis: usize) -> Bound<'py, PyArray1<f64>> {
        Array1::from(self.0.axes()[axis].clone()).into_pyarray(py)
    }
}
