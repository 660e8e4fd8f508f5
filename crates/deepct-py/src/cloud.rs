//! `generate_cloud`: a synthetic cloud from a seed.

use crate::array::give;
use crate::compute::compute;
use crate::error::raise;
use crate::grid::Grid;
use deepct_core::Error;
use deepct_core::cloud::{CumulusSettings, FieldSettings, cumulus, field};
use deepct_core::optics::extinction;
use numpy::PyArray3;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde::de::DeserializeOwned;

/// A synthetic cloud.
///
/// Attributes
/// ----------
/// grid : Grid
///     The grid of the arrays.
/// extinction : numpy.ndarray, float32, [z, y, x]
///     Extinction (1/km).
/// liquid_water_content : numpy.ndarray, float32, [z, y, x]
///     Liquid water content (g/m3).
/// effective_radius : numpy.ndarray, float32, [z, y, x]
///     Effective radius of the droplets (um); zero where there is no liquid water.
/// effective_variance : numpy.ndarray, float32, [z, y, x]
///     Effective variance of the droplet size distribution (1).
#[pyclass(frozen, module = "deepct_py", get_all)]
pub(crate) struct Cloud {
    grid: Grid,
    extinction: Py<PyArray3<f32>>,
    liquid_water_content: Py<PyArray3<f32>>,
    effective_radius: Py<PyArray3<f32>>,
    effective_variance: Py<PyArray3<f32>>,
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
#[pyfunction]
#[pyo3(signature = (grid = None, *, kind = "cumulus", seed = 1, **settings))]
pub(crate) fn generate_cloud(
    py: Python<'_>,
    grid: Option<Grid>,
    kind: &str,
    seed: u64,
    settings: Option<&Bound<'_, PyDict>>,
) -> PyResult<Cloud> {
    let settings = settings.map_or_else(|| Ok(PyDict::new(py)), |given| given.copy())?;
    if let Some(Grid(grid)) = grid {
        settings.set_item("shape", grid.shape)?;
        settings.set_item("spacing_km", grid.spacing.to_array())?;
        settings.set_item("origin_km", grid.origin.to_array())?;
    }
    let cloud = match kind {
        "cumulus" => {
            let settings: CumulusSettings = read(&settings)?;
            compute(py, move |_| cumulus(&settings, seed))?
        }
        "field" => {
            let settings: FieldSettings = read(&settings)?;
            compute(py, move |_| field(&settings, seed))?
        }
        _ => {
            return Err(raise(Error::out_of_range(
                "kind",
                format!("\"{kind}\""),
                "cumulus or field",
            )));
        }
    };
    give_cloud(py, cloud)
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

fn give_cloud(py: Python<'_>, cloud: deepct_core::cloud::Cloud) -> PyResult<Cloud> {
    let extinction = extinction(&cloud).map_err(raise)?;
    let droplets = cloud.microphysics.expect("the generator makes droplets");
    Ok(Cloud {
        grid: Grid(cloud.grid),
        extinction: give(py, extinction.values),
        liquid_water_content: give(py, droplets.liquid_water_content),
        effective_radius: give(py, droplets.effective_radius),
        effective_variance: give(py, droplets.effective_variance),
    })
}
