//! `Estimate`: an extinction field with further quantities, by a network or from a file.

use crate::array::{Placed, copied, give, volume};
use crate::error::raise;
use crate::exchange::{dataset, provenance, through_field, warn_of_incomplete, write};
use crate::field;
use crate::grid::Grid;
use crate::light::Light;
use crate::lineage::Lineage;
use crate::record::{Record, attributes, record};
use deepct_core::grid::Volume;
use deepct_core::{io, network, scene};
use numpy::PyArray3;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;

/// An extinction field, with its uncertainty and the effective radius if they are known: the contents of
/// a file of a volume.
///
/// Parameters
/// ----------
/// grid : Grid
///     The grid of the arrays.
/// extinction : array, [z, y, x]
///     Extinction (1/km). That of the droplets of a `Cloud` is the one in the `light`.
/// uncertainty : array, [z, y, x], optional
///     Expected absolute error of the extinction of each voxel (1/km).
/// light : Light, optional
///     Scene illumination of the images.
/// effective_radius : array, [z, y, x], optional
///     Effective radius (um); it has no meaning where there is no extinction.
/// lineage : Lineage, optional
///     Its time and history. Default: unknown.
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
    /// Effective radius (um), 0 where there is no extinction: numpy.ndarray, float32, [z, y, x]; None if
    /// it is unknown.
    #[pyo3(get)]
    effective_radius: Option<Py<PyArray3<f32>>>,
    /// Scene illumination of the images; None if it is unknown.
    #[pyo3(get)]
    light: Option<Light>,
    /// Its time and history.
    #[pyo3(get)]
    lineage: Lineage,
}

record!(@volume Estimate);

impl Record for Estimate {
    fn arguments<'py>(of: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        let names = ["grid", "extinction", "uncertainty", "light", "effective_radius", "lineage"];
        attributes(of.as_any(), &names)
    }
}

#[pymethods]
impl Estimate {
    #[new]
    #[pyo3(signature = (
        grid, extinction, uncertainty = None, light = None, *, effective_radius = None, lineage = None,
    ))]
    fn new(
        grid: Grid,
        extinction: &Bound<'_, PyAny>,
        uncertainty: Option<&Bound<'_, PyAny>>,
        light: Option<Light>,
        effective_radius: Option<&Bound<'_, PyAny>>,
        lineage: Option<Lineage>,
    ) -> PyResult<Self> {
        let py = extinction.py();
        let in_light =
            light.as_ref().map_or_else(scene::Light::default, |light| light.core.clone());
        let values = |placed: Placed<f32>, name| {
            let values = Volume::new(grid.0, placed.on(grid.0)?).map_err(raise)?;
            values.check_non_negative(name).map_err(raise)?;
            Ok::<_, PyErr>(values)
        };
        let name = "extinction";
        let extinction = values(field::extinction(extinction, name, &in_light)?, name)?;
        let of = |object: Option<&Bound<'_, PyAny>>, name| {
            object.map(|object| values(volume(object, name)?, name)).transpose()
        };
        let estimate = network::Estimate {
            extinction,
            uncertainty: of(uncertainty, "uncertainty")?,
            effective_radius: of(effective_radius, "effective_radius")?,
        };
        Ok(Self::give(py, estimate, light, lineage.unwrap_or_default()))
    }

    /// The extinction in a data set of xarray with the variables of a file of a volume: `extinction`
    /// and, if they are known, `uncertainty` and `reff`. Coordinates may descend.
    #[staticmethod]
    fn from_dataset(dataset: &Bound<'_, PyAny>) -> PyResult<Self> {
        let py = dataset.py();
        through_field(dataset, "", |path| read_volume(py, path.into()))
    }

    /// Write a netCDF file that all commands and `read_volume` read. A file that deepct did not write is
    /// replaced only with `overwrite`.
    #[pyo3(signature = (path, *, title = "Extinction", overwrite = false))]
    fn to_netcdf(
        &self,
        py: Python<'_>,
        path: PathBuf,
        title: &str,
        overwrite: bool,
    ) -> PyResult<()> {
        let on_grid = |values| Volume::new(self.grid.0, copied(py, values)?).map_err(raise);
        let estimate = network::Estimate {
            extinction: on_grid(&self.extinction)?,
            uncertainty: self.uncertainty.as_ref().map(on_grid).transpose()?,
            effective_radius: self.effective_radius.as_ref().map(on_grid).transpose()?,
        };
        let images = self.light.as_ref().map(Light::of_no_images);
        let provenance = provenance(title, &self.lineage);
        write(py, &path, overwrite, |path| {
            io::write_estimate(path, &estimate, images.as_ref(), &provenance)
        })
    }

    /// The extinction as a data set of xarray, with the variables of a file of a volume.
    fn to_xarray<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        dataset(py, |path| self.to_netcdf(py, path.into(), "Extinction", false))
    }
}

impl Estimate {
    /// The estimate of the library as an object of Python.
    pub(crate) fn give(
        py: Python<'_>,
        estimate: network::Estimate,
        light: Option<Light>,
        lineage: Lineage,
    ) -> Self {
        Self {
            grid: Grid(estimate.extinction.grid),
            extinction: give(py, estimate.extinction.values),
            uncertainty: estimate.uncertainty.map(|values| give(py, values.values)),
            effective_radius: estimate.effective_radius.map(|values| give(py, values.values)),
            light,
            lineage,
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
    Ok(Estimate::give(py, estimate, Light::read(&path)?, Lineage(io::read_lineage(&path))))
}
