//! `Estimate`: an extinction field with its uncertainty, by a network or from a file.

use crate::array::{copied, give, volume};
use crate::error::raise;
use crate::exchange::{dataset, provenance, through_file, warn_of_incomplete, write};
use crate::grid::Grid;
use crate::light::Light;
use crate::record::{Record, attributes, record};
use deepct_core::grid::Volume;
use deepct_core::{io, network};
use numpy::PyArray3;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;

/// An extinction field, with its uncertainty if that is known: the contents of a file of a volume.
///
/// Parameters
/// ----------
/// grid : Grid
///     The grid of the arrays.
/// extinction : array, [z, y, x]
///     Extinction (1/km).
/// uncertainty : array, [z, y, x], optional
///     Expected absolute error of the extinction of each voxel (1/km).
/// light : Light, optional
///     Scene illumination of the images.
#[pyclass(frozen, module = "deepct_py")]
pub(crate) struct Estimate {
    /// The grid of the arrays.
    #[pyo3(get)]
    grid: Grid,
    /// Extinction (1/km): numpy.ndarray, float32, [z, y, x].
    #[pyo3(get)]
    extinction: Py<PyArray3<f32>>,
    /// Expected absolute error of the extinction of each voxel (1/km): numpy.ndarray, float32,
    /// [z, y, x]; None if it is unknown.
    #[pyo3(get)]
    uncertainty: Option<Py<PyArray3<f32>>>,
    /// Scene illumination of the images; None if it is unknown.
    #[pyo3(get)]
    light: Option<Light>,
}

record!(Estimate);

impl Record for Estimate {
    fn arguments<'py>(of: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        attributes(of.as_any(), &["grid", "extinction", "uncertainty", "light"])
    }
}

#[pymethods]
impl Estimate {
    #[new]
    #[pyo3(signature = (grid, extinction, uncertainty = None, light = None))]
    fn new(
        grid: Grid,
        extinction: &Bound<'_, PyAny>,
        uncertainty: Option<&Bound<'_, PyAny>>,
        light: Option<Light>,
    ) -> PyResult<Self> {
        let values = |object: &Bound<'_, PyAny>, name| {
            let values = Volume::new(grid.0, volume(object, name)?.on(grid.0)?).map_err(raise)?;
            values.check_non_negative(name).map_err(raise)?;
            Ok::<_, PyErr>(values)
        };
        let extinction_values = values(extinction, "extinction")?;
        let uncertainty = uncertainty.map(|object| values(object, "uncertainty")).transpose()?;
        let estimate = network::Estimate { extinction: extinction_values, uncertainty };
        Ok(Self::give(extinction.py(), estimate, light))
    }

    /// The extinction in a data set of xarray with the variables of a file of a volume: `extinction`
    /// and, if it is known, `uncertainty`.
    #[staticmethod]
    fn from_dataset(dataset: &Bound<'_, PyAny>) -> PyResult<Self> {
        let py = dataset.py();
        through_file(dataset, |path| read_volume(py, path.into()))
    }

    /// Write a netCDF file that all commands and `read_volume` read.
    #[pyo3(signature = (path, *, title = "Extinction"))]
    fn to_netcdf(&self, py: Python<'_>, path: PathBuf, title: &str) -> PyResult<()> {
        let on_grid = |values| Volume::new(self.grid.0, copied(py, values)?).map_err(raise);
        let estimate = network::Estimate {
            extinction: on_grid(&self.extinction)?,
            uncertainty: self.uncertainty.as_ref().map(on_grid).transpose()?,
        };
        let images = self.light.as_ref().map(Light::of_no_images);
        write(py, &path, |path| {
            io::write_estimate(path, &estimate, images.as_ref(), &provenance(title))
        })
    }

    /// The extinction as a data set of xarray, with the variables of a file of a volume.
    fn to_xarray<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        dataset(py, |path| self.to_netcdf(py, path.into(), "Extinction"))
    }
}

impl Estimate {
    /// The estimate of the library as an object of Python.
    pub(crate) fn give(py: Python<'_>, estimate: network::Estimate, light: Option<Light>) -> Self {
        Self {
            grid: Grid(estimate.extinction.grid),
            extinction: give(py, estimate.extinction.values),
            uncertainty: estimate.uncertainty.map(|values| give(py, values.values)),
            light,
        }
    }

    /// The array of the extinction.
    pub(crate) fn into_extinction(self) -> Py<PyArray3<f32>> {
        self.extinction
    }
}

/// Read an extinction field from a netCDF file: an estimate of a network, the result of an inversion
/// or any other file with `extinction` on `(z, y, x)`.
///
/// Raises
/// ------
/// OSError
///     The file cannot be read.
/// DeepctError
///     The contents of the file are invalid; the message names the variable.
#[pyfunction]
pub(crate) fn read_volume(py: Python<'_>, path: PathBuf) -> PyResult<Estimate> {
    warn_of_incomplete(py, &path)?;
    let estimate = py.detach(|| io::read_estimate(&path)).map_err(raise)?;
    Ok(Estimate::give(py, estimate, Light::read(&path)?))
}
