//! `Cloud`: clouds that are generated, imported from simulations, or given by arrays.

use crate::array::{copied, give, volume};
use crate::compute::{interruptibly, quickly};
use crate::error::{in_python, raise};
use crate::exchange::{dataset, is_dataset, provenance, through_field, through_file, write};
use crate::grid::Grid;
use crate::light::warn;
use crate::lineage::Lineage;
use crate::number::{point, sizes, whole, whole_if_given};
use crate::record::{Record, attributes, record};
use deepct_core::cloud::{self, CumulusSettings, FieldSettings, Microphysics, cumulus, field};
use deepct_core::grid::Volume;
use deepct_core::io::import::{AirDensity, Axes, Crop, ImportSettings};
use deepct_core::optics::extinction;
use deepct_core::{Error, io};
use numpy::PyArray3;
use numpy::ndarray::Array3;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A cloud or a field of clouds on a grid, given by its droplets, its extinction or both.
///
/// Parameters
/// ----------
/// grid : Grid
///     The grid of the arrays.
/// extinction : array, [z, y, x], optional
///     Extinction (1/km). By default it is computed from the droplets.
/// liquid_water_content : array, [z, y, x], optional
///     Liquid water content (g/m3).
/// effective_radius : array, [z, y, x], optional
///     Effective radius of the droplets (um), required with the liquid water content.
/// effective_variance : array, [z, y, x], optional
///     Effective variance of the droplet size distribution (1). Default: 0.1.
/// lineage : Lineage, optional
///     Its time and history. Default: unknown.
///
/// Raises
/// ------
/// ValueError
///     A shape is not that of the grid, or a value is out of range.
///
/// Examples
/// --------
/// >>> grid = deepct_py.Grid(shape=(2, 3, 4), spacing=(0.05, 0.05, 0.04))
/// >>> water = np.full(grid.shape, 0.3)
/// >>> cloud = deepct_py.Cloud(grid, liquid_water_content=water, effective_radius=0 * water + 10)
/// >>> round(float(cloud.extinction.max()), 3)
/// 45.0
#[pyclass(frozen, module = "deepct_py")]
pub(crate) struct Cloud {
    /// The grid of the arrays.
    #[pyo3(get)]
    grid: Grid,
    /// Extinction (1/km), geometric unless it was given: numpy.ndarray, float32, [z, y, x].
    #[pyo3(get)]
    extinction: Py<PyArray3<f32>>,
    /// Liquid water content (g/m3): numpy.ndarray, float32, [z, y, x]; None if it is unknown.
    #[pyo3(get)]
    liquid_water_content: Option<Py<PyArray3<f32>>>,
    /// Effective radius of the droplets (um), zero where there is no liquid water: numpy.ndarray,
    /// float32, [z, y, x]; None if it is unknown.
    #[pyo3(get)]
    effective_radius: Option<Py<PyArray3<f32>>>,
    /// Effective variance of the droplet size distribution (1): numpy.ndarray, float32, [z, y, x];
    /// None if it is unknown.
    #[pyo3(get)]
    effective_variance: Option<Py<PyArray3<f32>>>,
    /// Whether the extinction was given, rather than computed from the droplets.
    is_extinction_given: bool,
    /// Its time and history.
    #[pyo3(get)]
    lineage: Lineage,
}

record!(@volume Cloud);

impl Record for Cloud {
    fn arguments<'py>(of: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        let droplets = ["liquid_water_content", "effective_radius", "effective_variance"];
        let given = of.get().is_extinction_given.then_some("extinction");
        let names: Vec<&str> =
            ["grid", "lineage"].into_iter().chain(given).chain(droplets).collect();
        attributes(of.as_any(), &names)
    }

    fn shown<'py>(of: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        let names = ["liquid_water_content", "effective_radius", "effective_variance"];
        attributes(of.as_any(), &[&["grid", "extinction"], &names[..]].concat())
    }
}

#[pymethods]
impl Cloud {
    #[new]
    #[pyo3(signature = (
        grid, *, extinction = None, liquid_water_content = None, effective_radius = None,
        effective_variance = None, lineage = None,
    ))]
    fn new(
        py: Python<'_>,
        grid: Grid,
        extinction: Option<&Bound<'_, PyAny>>,
        liquid_water_content: Option<&Bound<'_, PyAny>>,
        effective_radius: Option<&Bound<'_, PyAny>>,
        effective_variance: Option<&Bound<'_, PyAny>>,
        lineage: Option<Lineage>,
    ) -> PyResult<Self> {
        let values = |object: Option<&Bound<'_, PyAny>>, name| {
            object.map(|object| volume(object, name)?.on(grid.0)).transpose()
        };
        let extinction = values(extinction, "extinction")?;
        let water = values(liquid_water_content, "liquid_water_content")?;
        let radius = values(effective_radius, "effective_radius")?;
        let variance = values(effective_variance, "effective_variance")?;
        let droplets = match (water, radius) {
            (Some(liquid_water_content), Some(effective_radius)) => Some(Microphysics {
                liquid_water_content,
                effective_radius,
                effective_variance: variance
                    .unwrap_or_else(|| Array3::from_elem(grid.0.shape, cloud::EFFECTIVE_VARIANCE)),
            }),
            (None, None) if variance.is_none() && extinction.is_some() => None,
            _ => {
                let problem = "a cloud needs its extinction, or liquid_water_content and \
                               effective_radius";
                return Err(PyTypeError::new_err(problem));
            }
        };
        let cloud = assembled(grid, extinction, droplets).map_err(raise)?;
        Self::give(py, cloud, lineage.unwrap_or_default())
    }

    /// The cloud in a data set of xarray with the variables of a file of a cloud: `lwc`, `reff` and
    /// `veff`, or `extinction`, or all of them. Coordinates may descend.
    #[staticmethod]
    pub(crate) fn from_dataset(dataset: &Bound<'_, PyAny>) -> PyResult<Self> {
        let py = dataset.py();
        through_field(dataset, "", |path| read_cloud(py, path.into(), false))
    }

    /// Write a netCDF file that all commands and `read_cloud` read. A file that deepct did not write is
    /// replaced only with `overwrite`.
    #[pyo3(signature = (path, *, title = "Cloud", overwrite = false))]
    fn to_netcdf(
        &self,
        py: Python<'_>,
        path: PathBuf,
        title: &str,
        overwrite: bool,
    ) -> PyResult<()> {
        let cloud = self.core(py)?;
        let provenance = provenance(title, &self.lineage);
        write(py, &path, overwrite, |path| io::write_cloud(path, &cloud, &provenance))
    }

    /// The cloud as a data set of xarray, with the variables of a file of a cloud.
    fn to_xarray<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        dataset(py, |path| self.to_netcdf(py, path.into(), "Cloud", false))
    }
}

fn assembled(
    Grid(grid): Grid,
    extinction: Option<Array3<f32>>,
    droplets: Option<Microphysics>,
) -> deepct_core::Result<cloud::Cloud> {
    let extinction = extinction
        .map(|values| cloud::Cloud::from_extinction(Volume::new(grid, values)?))
        .transpose()?
        .and_then(|cloud| cloud.extinction);
    match droplets {
        None => Ok(cloud::Cloud { grid, microphysics: None, extinction }),
        Some(droplets) => {
            Ok(cloud::Cloud { extinction, ..cloud::Cloud::from_microphysics(grid, droplets)? })
        }
    }
}

impl Cloud {
    /// The cloud of the library as an object of Python.
    fn give(py: Python<'_>, cloud: cloud::Cloud, lineage: Lineage) -> PyResult<Self> {
        let extinction = extinction(&cloud).map_err(raise)?;
        let is_extinction_given = cloud.extinction.is_some();
        let [water, radius, variance] = match cloud.microphysics {
            None => [None, None, None],
            Some(droplets) => [
                droplets.liquid_water_content,
                droplets.effective_radius,
                droplets.effective_variance,
            ]
            .map(|values| Some(give(py, values))),
        };
        Ok(Self {
            grid: Grid(cloud.grid),
            extinction: give(py, extinction.values),
            liquid_water_content: water,
            effective_radius: radius,
            effective_variance: variance,
            is_extinction_given,
            lineage,
        })
    }

    /// The cloud of the library.
    pub(crate) fn core(&self, py: Python<'_>) -> PyResult<cloud::Cloud> {
        let array = |values: &Option<Py<PyArray3<f32>>>| {
            values.as_ref().map(|values| copied(py, values)).transpose()
        };
        let droplets = match (
            array(&self.liquid_water_content)?,
            array(&self.effective_radius)?,
            array(&self.effective_variance)?,
        ) {
            (Some(liquid_water_content), Some(effective_radius), Some(effective_variance)) => {
                Some(Microphysics { liquid_water_content, effective_radius, effective_variance })
            }
            _ => None,
        };
        let given = self.is_extinction_given;
        let extinction = given.then(|| copied(py, &self.extinction)).transpose()?;
        assembled(self.grid, extinction, droplets).map_err(raise)
    }
}

/// Read a cloud from a netCDF file of deepct: its droplets, its extinction or both. `import_cloud` reads
/// the files of simulations and other programs.
///
/// Parameters
/// ----------
/// path : str or path
///     The file.
/// allow_implausible : bool
///     Accept values that are far beyond those of clouds with a warning.
///
/// Raises
/// ------
/// OSError
///     The file cannot be read.
/// DeepctError
///     The contents of the file are invalid; the message names the variable.
#[pyfunction]
#[pyo3(signature = (path, *, allow_implausible = false))]
pub(crate) fn read_cloud(
    py: Python<'_>,
    path: PathBuf,
    allow_implausible: bool,
) -> PyResult<Cloud> {
    let read = || match allow_implausible {
        true => io::read_implausible_cloud(&path),
        false => Ok((io::read_cloud(&path)?, Vec::new())),
    };
    let (cloud, warnings) = py.detach(read).map_err(raise)?;
    for warning in warnings {
        warn(py, &warning)?;
    }
    Cloud::give(py, cloud, Lineage(io::read_lineage(&path)))
}

/// Import a large-eddy simulation (netCDF), arrays of NumPy, MATLAB, Mitsuba, VTK or a pickle, or a text
/// file of pySHDOM, AT3D, SHDOM or MYSTIC. A pickle executes nothing.
///
/// Liquid water and axes are identified by CF conventions or by customary names. From which variable
/// each quantity is taken, and what is assumed, is logged to the logger `deepct_py` (level INFO).
///
/// Parameters
/// ----------
/// path : str, path or xarray.Dataset
///     The file, or its contents.
/// time : int
///     Index of the time step.
/// crop : (int, int, int, int), optional
///     Columns to read: index of the first one along x and y, and their number along x and y; the
///     selection wraps around the sides of the domain.
/// droplets : float, optional
///     Droplet number concentration (1/cm3), from which effective radii are computed. By default the
///     radii of the file are used, or 100 if it has none.
/// air_density : float or str, optional
///     Air density, for a mixing ratio: a number (kg/m3), or a profile as "FILE:VARIABLE". By default
///     that of the file, from its pressure and temperature, or that of the standard atmosphere.
/// variable : str, optional
///     Name of the liquid water variable, if it is not identified automatically.
/// axes : str, optional
///     The axes of the variables of a file that does not name them, such as one of NumPy or MATLAB, the
///     slowest one first: "z,y,x"; that is the reverse of the order of MATLAB. Their cells have the size
///     `spacing`.
/// spacing : (float, float, float) or "file"
///     Voxel size along x, y, z (km), or "file" to keep that of the file.
/// base : float, optional
///     Altitude of the bottom of the lowest level (km). Default: that of the file.
/// levels : int, optional
///     Number of levels. By default all levels up to the top of the file.
/// units : dict of str to str, optional
///     Units of variables, in place of those in the file, such as `{"ql": "kg kg-1"}`.
/// allow_implausible : bool
///     Accept values that are far beyond those of clouds with a warning.
///
/// Returns
/// -------
/// Cloud
///
/// Raises
/// ------
/// OSError
///     The file cannot be read.
/// DeepctError
///     The contents of the file cannot be used; the message names the variable and the remedy.
#[pyfunction]
#[pyo3(
    signature = (
        path, *, time = None, crop = None, droplets = None, air_density = None, variable = None,
        axes = None, spacing = None, base = None, levels = None, units = BTreeMap::new(),
        allow_implausible = false,
    ),
    text_signature = "(path, *, time=0, crop=None, droplets=None, air_density=None, \
                      variable=None, axes=None, spacing=(0.05, 0.05, 0.04), base=None, levels=None, \
                      units={}, allow_implausible=False)",
)]
// In Python these are keyword arguments with defaults.
#[allow(clippy::too_many_arguments)]
pub(crate) fn import_cloud(
    path: &Bound<'_, PyAny>,
    time: Option<&Bound<'_, PyAny>>,
    crop: Option<&Bound<'_, PyAny>>,
    droplets: Option<f64>,
    air_density: Option<&Bound<'_, PyAny>>,
    variable: Option<String>,
    axes: Option<&str>,
    spacing: Option<&Bound<'_, PyAny>>,
    base: Option<f64>,
    levels: Option<&Bound<'_, PyAny>>,
    units: BTreeMap<String, String>,
    allow_implausible: bool,
) -> PyResult<Cloud> {
    let crop = crop.map(|crop| sizes(crop, "crop", ["x0", "y0", "nx", "ny"])).transpose()?;
    let is_own =
        |spacing: &Bound<'_, PyAny>| spacing.extract::<String>().is_ok_and(|word| word == "file");
    if axes.is_some() && spacing.is_none() {
        let problem = "axes are stated without the size of their cells: give spacing (km)";
        return Err(PyValueError::new_err(problem));
    }
    let defaults = ImportSettings::default();
    let settings = ImportSettings {
        time: whole_if_given(time, "time")?.unwrap_or(defaults.time),
        crop: crop.map(|[x0, y0, nx, ny]| Crop { x0, y0, nx, ny }),
        droplets_per_cm3: droplets,
        air_density: air_density.map(density).transpose()?,
        variable,
        axes: axes.map(order).transpose()?,
        spacing: match spacing {
            None => defaults.spacing,
            Some(spacing) if is_own(spacing) => None,
            Some(spacing) => Some(point(spacing, "spacing")?),
        },
        base,
        levels: whole_if_given(levels, "levels")?,
        units,
        allow_implausible,
    };
    let py = path.py();
    if is_dataset(path)? {
        return through_file(path, "", |file| import(py, file, "", &settings));
    }
    let path: PathBuf = path.extract()?;
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    import(py, &path, &format!("{name} "), &settings)
}

/// Imports a cloud, and warns and logs what is to be known of it.
fn import(py: Python<'_>, path: &Path, name: &str, settings: &ImportSettings) -> PyResult<Cloud> {
    let (cloud, report) = quickly(py, || io::import::import_cloud(path, settings))?;
    for warning in report.warnings {
        warn(py, &warning)?;
    }
    let logger = py.import("logging")?.call_method1("getLogger", ("deepct_py",))?;
    for taken in report.taken {
        logger.call_method1("info", ("%s", in_python(&taken)))?;
    }
    let line = format!("cloud import {name}--time {}", settings.time);
    Cloud::give(py, cloud, Lineage(report.lineage.then(&line)))
}

fn order(given: &str) -> PyResult<Axes> {
    given.parse().map_err(|remedy| PyValueError::new_err(format!("axes is \"{given}\": {remedy}")))
}

fn density(given: &Bound<'_, PyAny>) -> PyResult<AirDensity> {
    let text = given.str()?.to_string();
    text.parse().map_err(|remedy| {
        PyValueError::new_err(format!("air_density is {text}, which is neither of both: {remedy}"))
    })
}

/// Generate a synthetic cloud. The same seed gives the same cloud.
///
/// Parameters
/// ----------
/// grid : Grid, optional
///     The grid of the cloud. Default: 32 x 32 columns for a cumulus, 128 x 128 for a field, each
///     50 m wide, with levels of 40 m.
/// kind : str
///     `"cumulus"` (one cloud in the middle of the grid) or `"field"` (a periodic cloud field).
/// seed : int
///     Seed of the random number generator.
/// **settings
///     Settings of the generator, such as `width_km` or `droplets_per_cm3`. The commands
///     `deepct config cloud-cumulus` and `deepct config cloud-field` list them.
///
/// Returns
/// -------
/// Cloud
///
/// Raises
/// ------
/// TypeError
///     A setting is unknown or has a value of the wrong type.
/// ValueError
///     A setting is out of range, or the cloud does not fit into the grid.
///
/// Examples
/// --------
/// >>> cloud = deepct_py.generate_cloud(seed=3, width_km=0.4)
/// >>> cloud.grid.shape[1:]
/// (32, 32)
#[pyfunction]
#[pyo3(
    signature = (grid = None, *, kind = "cumulus", seed = None, **settings),
    text_signature = "(grid=None, *, kind='cumulus', seed=1, **settings)",
)]
pub(crate) fn generate_cloud(
    py: Python<'_>,
    grid: Option<Grid>,
    kind: &str,
    seed: Option<&Bound<'_, PyAny>>,
    settings: Option<&Bound<'_, PyDict>>,
) -> PyResult<Cloud> {
    let seed = seed.map_or(Ok(1), |seed| whole(seed, "seed"))?;
    let settings = settings.map_or_else(|| Ok(PyDict::new(py)), |given| given.copy())?;
    if let Some(Grid(grid)) = grid {
        settings.set_item("shape", grid.shape)?;
        settings.set_item("spacing_km", grid.spacing.to_array())?;
        settings.set_item("origin_km", grid.origin.to_array())?;
    }
    let cloud = match kind {
        "cumulus" => {
            let settings: CumulusSettings = read(&settings)?;
            interruptibly(py, move || cumulus(&settings, seed))?
        }
        "field" => {
            let settings: FieldSettings = read(&settings)?;
            interruptibly(py, move || field(&settings, seed))?
        }
        _ => {
            return Err(raise(Error::out_of_range(
                "kind",
                format!("\"{kind}\""),
                "cumulus or field",
            )));
        }
    };
    Cloud::give(py, cloud, Lineage::default())
}

/// Settings from keyword arguments; settings that are not given have their defaults.
///
/// # Errors
/// `TypeError` for an unknown keyword or a value of the wrong type.
pub(crate) fn read<T: DeserializeOwned>(keywords: &Bound<'_, PyDict>) -> PyResult<T> {
    let py = keywords.py();
    let options = PyDict::new(py);
    // NumPy numbers and arrays are serialised by their method `tolist`.
    options
        .set_item("default", py.import("operator")?.call_method1("methodcaller", ("tolist",))?)?;
    let text = py.import("json")?.call_method("dumps", (keywords,), Some(&options))?;
    serde_json::from_str(&text.extract::<String>()?).map_err(|problem| {
        let problem = problem.to_string();
        PyTypeError::new_err(problem.split(" at line").next().unwrap_or_default().to_owned())
    })
}
