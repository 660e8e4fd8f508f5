//! `Grid`: the regular grid of a volume.

use crate::error::raise;
use deepct_core::grid;
use deepct_core::math::DVec3;
use numpy::ndarray::Array1;
use numpy::{IntoPyArray, PyArray1};
use pyo3::prelude::*;

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
#[pyclass(frozen, eq, from_py_object, module = "deepct_py")]
#[derive(Clone, Copy, PartialEq)]
pub(crate) struct Grid(pub(crate) grid::Grid);

#[pymethods]
impl Grid {
    #[new]
    #[pyo3(
        signature = (shape, spacing, origin = (0.0, 0.0, 0.0)),
        text_signature = "(shape, spacing, origin=(0.0, 0.0, 0.0))",
    )]
    fn new(shape: [usize; 3], spacing: (f64, f64, f64), origin: (f64, f64, f64)) -> PyResult<Self> {
        grid::Grid::new(origin.into(), spacing.into(), shape).map(Self).map_err(raise)
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

    fn __repr__(&self) -> String {
        let grid::Grid { origin, spacing, shape: [nz, ny, nx] } = self.0;
        let words = |v: DVec3| format!("({}, {}, {})", v.x, v.y, v.z);
        format!(
            "Grid(shape=({nz}, {ny}, {nx}), spacing={}, origin={})",
            words(spacing),
            words(origin)
        )
    }
}

impl Grid {
    fn axis<'py>(&self, py: Python<'py>, axis: usize) -> Bound<'py, PyArray1<f64>> {
        Array1::from(self.0.axes()[axis].clone()).into_pyarray(py)
    }
}
