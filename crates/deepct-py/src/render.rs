//! `render`: simulation of the images of an extinction field.

use crate::array::{agreed, volume};
use crate::compute::{Progress, at_length};
use crate::error::raise;
use crate::field;
use crate::grid::Grid;
use crate::light::{Light, warn, warn_of_neglected};
use crate::lineage::Lineage;
use crate::number::{whole, whole_if_given};
use crate::observation::{Observation, PARTS};
use crate::record::{Record, attributes, record};
use crate::view::{ViewSequence, Views};
use deepct_core::grid::Volume;
use deepct_core::scene::{self, PhaseModel};
use deepct_core::transport::{self, MonteCarloSettings, OrdinatesSettings, Solver};
use deepct_core::{Error, cloud, io};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;

/// Photon paths per pixel if neither their number nor the noise is given.
const SAMPLES: u32 = 1024;
/// Maximum number of photon paths per pixel if the noise is given.
const MOST_SAMPLES: u32 = 1 << 24;

/// Simulated images of a scene: an observation, and how it was computed. Its standard error is None for
/// the discrete-ordinates solver.
///
/// Constructed by `render`; the arguments are those of `Observation` and the attributes.
#[pyclass(frozen, extends = Observation, module = "deepct_py")]
pub(crate) struct Rendering {
    /// Number of photon paths per pixel; 0 for the discrete-ordinates solver.
    #[pyo3(get)]
    samples_per_pixel: u32,
    /// Relative error of the bright pixels as estimated by the discrete-ordinates solver; None if it is
    /// not estimated.
    #[pyo3(get)]
    estimated_error: Option<f64>,
}

record!(Rendering);

impl Record for Rendering {
    fn arguments<'py>(of: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        let own = ["samples_per_pixel", "estimated_error"];
        attributes(of.as_any(), &[&PARTS[..], &own[..]].concat())
    }
}

#[pymethods]
impl Rendering {
    #[new]
    // In Python these are keyword arguments with defaults.
    #[allow(clippy::too_many_arguments)]
    #[pyo3(signature = (
        radiance, views, light = None, *, standard_error = None, saturated = None,
        samples_per_pixel, estimated_error = None, lineage = None,
    ))]
    fn new(
        radiance: &Bound<'_, PyAny>,
        views: ViewSequence,
        light: Option<Light>,
        standard_error: Option<Bound<'_, PyAny>>,
        saturated: Option<Bound<'_, PyAny>>,
        samples_per_pixel: &Bound<'_, PyAny>,
        estimated_error: Option<f64>,
        lineage: Option<Lineage>,
    ) -> PyResult<PyClassInitializer<Self>> {
        let samples_per_pixel = whole(samples_per_pixel, "samples_per_pixel")?;
        let images = Observation::new(radiance, views, light, standard_error, saturated, lineage)?;
        let rendering = Self { samples_per_pixel, estimated_error };
        Ok(PyClassInitializer::from(images).add_subclass(rendering))
    }
}

/// Simulate images of an extinction field.
///
/// The Monte Carlo solver traces photon paths backwards from each pixel and adds the sunlight
/// scattered into the path at each scattering event. The same seed gives the same images for any
/// number of threads. The discrete-ordinates solver is free of noise and takes seconds; its error
/// in bright pixels is about 1 %.
///
/// Parameters
/// ----------
/// extinction : Cloud, Estimate, Reconstruction, array [z, y, x], str or path
///     The cloud, or an extinction (1/km). The droplets of a `Cloud` are used if the light refers to
///     Mie theory.
/// grid : Grid, object or path, optional
///     The grid of the extinction: a `Grid`, an object or a file that has one. By default that of the
///     extinction, if it is an object or an xarray object with coordinates.
/// views : Views, sequence of View, str or path
///     The cameras, all with the same image size; or the name or file of a formation as in
///     `Views.load`, which points at the centre of the grid and takes one pixel for each column.
/// light : Light, optional
///     Scene illumination: Sun, wavelength, droplet optics, molecular atmosphere and surface.
///     Default: `Light()`.
/// solver : str
///     "monte-carlo" or "ordinates". The parameters `samples`, `noise`, `seed` and
///     `similarity_after` are for "monte-carlo", `accuracy` and `estimate_error` for "ordinates".
/// samples : int, optional
///     Number of photon paths per pixel; if `noise` is given, the maximum number. Default: 1024,
///     or as many as required to reach `noise`.
/// noise : float, optional
///     Add photon paths until the relative standard error of the bright pixels has fallen to this
///     value, for example 0.01. It is the root mean square over all pixels that are at least half
///     as bright as the brightest pixel of their view.
/// seed : int
///     Seed of the random number generator.
/// effective_radius : array, [z, y, x], optional
///     Effective radius of the droplets in each voxel (um), in place of the `effective_radius` of
///     the light. The phase function of the light must be "mie". The extinction is not changed.
/// trilinear : bool
///     Interpolate the extinction trilinearly between voxel centres. By default it is constant in
///     each voxel.
/// similarity_after : int, optional
///     Number of scattering events after which a path continues in equivalent media with a
///     reduced forward peak: faster and less noisy, but biased. By default the paths are unbiased.
/// accuracy : float, optional
///     Approximate relative error of the bright pixels by the "ordinates" solver, from 0.003 to 0.1.
///     With 0.03 and more it is several times faster than by default, which corresponds to 0.01.
/// estimate_error : bool
///     Whether the "ordinates" solver estimates its error from a second, coarser solution, which
///     takes 6 to 50 % of the time.
/// progress : bool or callable
///     True shows a line of progress on the standard error. A function is called from time to time with
///     a dict that has the keys `share`, `samples` and `noise`; an exception that it raises ends the
///     computation.
///
/// Returns
/// -------
/// Rendering
///
/// Raises
/// ------
/// ValueError
///     The shape of an array is not that of the grid, an extinction is negative or not finite, a
///     trilinear field is not surrounded by clear voxels, or a parameter is out of range.
///
/// Examples
/// --------
/// >>> cloud = deepct_py.generate_cloud(seed=3, width_km=0.4)
/// >>> light = deepct_py.Light(sun=(40, 120))
/// >>> images = deepct_py.render(cloud, views="cloudct-10", light=light, samples=16)
/// >>> images.radiance.shape
/// (10, 32, 32)
#[pyfunction]
#[pyo3(
    signature = (
        extinction, grid = None, views = None, light = None, *, solver = "monte-carlo",
        samples = None, noise = None, seed = None, effective_radius = None, trilinear = false,
        similarity_after = None, accuracy = None, estimate_error = true,
        progress = Progress::None,
    ),
    text_signature = "(extinction, grid=None, views=None, light=None, *, solver='monte-carlo', \
                      samples=None, noise=None, seed=1, effective_radius=None, trilinear=False, \
                      similarity_after=None, accuracy=None, estimate_error=True, progress=False)",
)]
// In Python these are keyword arguments with defaults.
#[allow(clippy::too_many_arguments)]
pub(crate) fn render<'py>(
    extinction: &Bound<'py, PyAny>,
    grid: Option<Grid>,
    views: Option<&Bound<'py, PyAny>>,
    light: Option<Light>,
    solver: &str,
    samples: Option<&Bound<'py, PyAny>>,
    noise: Option<f64>,
    seed: Option<&Bound<'py, PyAny>>,
    effective_radius: Option<&Bound<'py, PyAny>>,
    trilinear: bool,
    similarity_after: Option<&Bound<'py, PyAny>>,
    accuracy: Option<f64>,
    estimate_error: bool,
    progress: Progress,
) -> PyResult<Py<Rendering>> {
    let py = extinction.py();
    let light = light.map_or_else(scene::Light::default, |light| light.core);
    let lineage = Lineage::after(extinction, "render")?;
    let cloud = cloud_of(extinction, grid, effective_radius, &light)?;
    let views = match views {
        Some(views) => views_of(views, &cloud.grid)?,
        None => {
            let problem = "views is missing: give Views, or the name or file of a formation";
            return Err(PyTypeError::new_err(problem));
        }
    };
    let most = if noise.is_some() { MOST_SAMPLES } else { SAMPLES };
    let paths = MonteCarloSettings {
        samples_per_pixel: whole_if_given(samples, "samples")?.unwrap_or(most),
        noise,
        seed: seed.map_or(Ok(1), |seed| whole(seed, "seed"))?,
        similarity_after: whole_if_given(similarity_after, "similarity_after")?,
    };
    let of_paths = [
        ("samples", samples.is_some()),
        ("noise", noise.is_some()),
        ("similarity_after", similarity_after.is_some()),
    ];
    let unused = match solver {
        "ordinates" => of_paths.into_iter().find(|(_, is_given)| *is_given).map(|(name, _)| {
            (name, "omitted for the solver \"ordinates\", which has no photon paths: give accuracy")
        }),
        _ => accuracy.map(|_| ("accuracy", "omitted for the solver \"monte-carlo\": give noise")),
    };
    if let Some((name, range)) = unused {
        return Err(raise(Error::out_of_range(name, "given", range)));
    }
    let solver = match solver {
        "monte-carlo" => Solver::MonteCarlo(paths),
        "ordinates" => Solver::Ordinates(OrdinatesSettings {
            estimate_error,
            ..accuracy
                .map_or(Ok(OrdinatesSettings::default()), OrdinatesSettings::with_accuracy)
                .map_err(raise)?
        }),
        _ => {
            let known = "\"monte-carlo\" or \"ordinates\"";
            return Err(raise(Error::out_of_range("solver", format!("\"{solver}\""), known)));
        }
    };
    if matches!(solver, Solver::Ordinates(_)) {
        warn_of_neglected(py, &light)?;
    }
    let shown = views.clone();
    let (rendering, light) = at_length(py, &progress, move |watch| {
        let mut scene = light.scene(&cloud)?;
        if trilinear {
            scene = scene.with_trilinear_extinction()?;
        }
        Ok((transport::render(&scene, &shown, &solver, watch)?, light.recorded(&cloud)))
    })?;
    for text in rendering.warnings() {
        warn(py, &text)?;
    }
    let own = Rendering {
        samples_per_pixel: rendering.samples_per_pixel,
        estimated_error: rendering.estimated_error,
    };
    let mut observed = scene::Observation::new(light, views, rendering.images).map_err(raise)?;
    observed.standard_error = rendering.standard_error;
    let images = Observation::give(py, observed, lineage);
    Py::new(py, PyClassInitializer::from(images).add_subclass(own))
}

/// The cloud of an argument: a `Cloud`, or an extinction and optionally effective radii.
fn cloud_of(
    extinction: &Bound<'_, PyAny>,
    grid: Option<Grid>,
    effective_radius: Option<&Bound<'_, PyAny>>,
    light: &scene::Light,
) -> PyResult<cloud::Cloud> {
    if effective_radius.is_some() && light.optics.phase != PhaseModel::Mie {
        let range = "\"mie\" where effective_radius is an array";
        return Err(raise(Error::out_of_range("phase of the light", "another", range)));
    }
    let given = grid.map(|Grid(grid)| grid);
    let name = "extinction";
    let own = match extinction.extract::<PathBuf>() {
        Ok(path) => Some(extinction.py().detach(|| io::read_cloud(path)).map_err(raise)?),
        Err(_) => field::cloud(extinction)?,
    };
    if let (Some(cloud), None) = (own, effective_radius) {
        agreed(name, given, Some(cloud.grid))?;
        return Ok(cloud);
    }
    let values = field::extinction(extinction, name, light)?;
    let grid = values.grid(given)?;
    let extinction = Volume::new(grid, values.values).map_err(raise)?;
    let cloud = match effective_radius {
        None => cloud::Cloud::from_extinction(extinction),
        Some(radii) => {
            let radii = volume(radii, "effective_radius")?.on(grid)?;
            cloud::Cloud::from_extinction_and_radii(extinction, radii)
        }
    };
    cloud.map_err(raise)
}

/// The views of an argument: cameras, or a formation that points at the centre of the grid and takes
/// images of as many pixels as the grid has columns.
pub(crate) fn views_of(
    views: &Bound<'_, PyAny>,
    grid: &deepct_core::grid::Grid,
) -> PyResult<Vec<scene::View>> {
    if let Ok(name) = views.extract::<PathBuf>() {
        let [_, rows, cols] = grid.shape;
        return Ok(Views::find(&name, grid.center(), [rows, cols])?.0);
    }
    Ok(views.extract::<ViewSequence>()?.0)
}
