//! `invert` and `hybrid`: retrieval of the extinction with a forward model.

use crate::array::{Floats, IMAGES, VOLUME, booleans, give};
use crate::carve::warn;
use crate::cloud::read;
use crate::compute::{Stopped, at_length};
use crate::error::raise;
use crate::grid::Grid;
use crate::light::{Light, or_default, warn_of_neglected};
use crate::network::Network;
use crate::view::ViewSequence;
use deepct_core::Result;
use deepct_core::carve::{CarveSettings, carve};
use deepct_core::grid::{Mask, Volume};
use deepct_core::image::ViewStack;
use deepct_core::inversion::{
    self, InversionSettings, OrdinatesModels, Problem, Start, network_grid,
};
use deepct_core::network::Estimate;
use deepct_core::scene::Observation;
use deepct_core::stop::Stop;
use deepct_core::transport::OrdinatesSettings;
use numpy::PyArray3;
use numpy::ndarray::Array3;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// The result of an inversion.
///
/// Attributes
/// ----------
/// extinction : numpy.ndarray, float32, [z, y, x]
///     Extinction (1/km), 0 outside the mask.
/// mask : numpy.ndarray, bool, [z, y, x]
///     The voxels in which the extinction was retrieved.
/// history : list of dict
///     One entry for each step, with the keys `stage`, `block`, `iteration`, `seconds`, `misfit`,
///     `value` (of the cost function), `evaluations` and, if the true extinction was given,
///     `relative_error` and `mass_error`.
/// ending : str
///     The reason for termination: "noise" (the noise explains the misfit), "iterations" (the
///     maximum number of steps was reached) or "stalled" (the cost function no longer decreased).
#[pyclass(frozen, module = "deepct_py", get_all)]
pub(crate) struct Reconstruction {
    extinction: Py<PyArray3<f32>>,
    mask: Py<PyArray3<bool>>,
    history: Py<PyAny>,
    ending: String,
}

/// The converted arguments that `invert` and `hybrid` have in common.
struct Request {
    observation: Observation,
    mask: Option<Array3<bool>>,
    truth: Option<Array3<f32>>,
    settings: InversionSettings,
}

impl Request {
    /// The given mask or, if there is none, the mask carved from the images, with warnings.
    fn mask(&mut self, grid: deepct_core::grid::Grid) -> Result<(Mask, Vec<String>)> {
        let mut warnings = Vec::new();
        let mask = match self.mask.take() {
            Some(values) => Mask::new(grid, values)?,
            None => {
                let carved = carve(&self.observation, &grid, &CarveSettings::default())?;
                warnings.extend(carved.warning());
                carved.mask
            }
        };
        let unseen = mask.count() - inversion::shown(&mask, &self.observation)?.count();
        if unseen > 0 && unseen < mask.count() {
            let count = mask.count();
            warnings.push(format!(
                "no image shows {unseen} of {count} voxels of the mask: their extinction is not \
                 retrieved and is 0"
            ));
        }
        Ok((mask, warnings))
    }

    fn models(&self, grid: deepct_core::grid::Grid) -> Result<OrdinatesModels> {
        let scene = self.observation.light.scene_of(Volume::constant(grid, 0.0))?;
        let views = self.observation.views.clone();
        Ok(OrdinatesModels::new(scene, views, OrdinatesSettings::default()))
    }

    fn solve(
        mut self,
        grid: deepct_core::grid::Grid,
        stop: &Stop,
        way: impl FnOnce(&Problem, &mut OrdinatesModels, &InversionSettings) -> Result<Answer>,
    ) -> Result<Solved> {
        let truth = self.truth.take().map(|values| Volume::new(grid, values)).transpose()?;
        let (mask, mut warnings) = self.mask(grid)?;
        let mut models = self.models(grid)?;
        models.stop = stop.clone();
        let problem =
            Problem { observation: &self.observation, mask: &mask, truth: truth.as_ref() };
        let answer = way(&problem, &mut models, &self.settings)?;
        if let Some(misfit) = answer.unexplained() {
            warnings.push(format!(
                "the result does not explain the images: the misfit is {misfit:.1}, but should be \
                 about 1; check light, views and grid, or begin elsewhere (start=\"auto\")"
            ));
        }
        Ok(Solved { answer, mask, warnings })
    }
}

type Answer = inversion::Reconstruction;

/// The result of an inversion, with the mask it was restricted to and warnings about it.
struct Solved {
    answer: Answer,
    mask: Mask,
    warnings: Vec<String>,
}

/// Retrieve the extinction whose simulated images match the given images.
///
/// The discrete-ordinates solver computes the images and their exact derivatives. A bounded
/// quasi-Newton method fits them to the given images, on successively finer grids if `start` is a
/// constant.
///
/// Parameters
/// ----------
/// radiance : array, [view, row, col]
///     Images (1/sr).
/// views : Views or sequence of View
///     The camera geometry of each image.
/// grid : Grid
///     The grid of the extinction.
/// light : Light, optional
///     Scene illumination of the images. Default: `Light()`.
/// start : float, array [z, y, x] or "auto", optional
///     Initial extinction (1/km). "auto" selects the constant that fits the images best.
///     Default: 0.01.
/// mask : array of bool, [z, y, x], optional
///     The voxels in which the extinction is retrieved. By default the mask is carved from the
///     images with `carve`.
/// standard_error : array, [view, row, col], optional
///     Standard error of each pixel (1/sr); infinite for pixels that are left out.
/// saturated : array of bool, [view, row, col], optional
///     The pixels that are saturated: they are at least as bright as their radiance.
/// truth : array, [z, y, x], optional
///     The true extinction (1/km). If it is given, the history contains the errors of each step.
/// **settings
///     Settings of the inversion, such as `iterations`. The command `deepct config invert` lists
///     them under `[inversion]`.
///
/// Returns
/// -------
/// Reconstruction
///
/// Raises
/// ------
/// TypeError
///     A setting is unknown or has a value of the wrong type.
/// ValueError
///     The shapes of the arrays do not match, or a parameter is out of range.
#[pyfunction]
#[pyo3(signature = (
    radiance, views, grid, light = None, *, start = None, mask = None, standard_error = None,
    saturated = None,
    truth = None, **settings,
))]
// In Python these are keyword arguments with defaults.
#[allow(clippy::too_many_arguments)]
pub(crate) fn invert(
    py: Python<'_>,
    radiance: &Bound<'_, PyAny>,
    views: ViewSequence,
    grid: Grid,
    light: Option<Light>,
    start: Option<&Bound<'_, PyAny>>,
    mask: Option<&Bound<'_, PyAny>>,
    standard_error: Option<&Bound<'_, PyAny>>,
    saturated: Option<&Bound<'_, PyAny>>,
    truth: Option<&Bound<'_, PyAny>>,
    settings: Option<&Bound<'_, PyDict>>,
) -> PyResult<Reconstruction> {
    let request = Request {
        observation: observation(radiance, views, light, standard_error, saturated)?,
        mask: mask.map(|mask| booleans(mask, "mask", VOLUME)).transpose()?,
        truth: optional(truth, "truth")?,
        settings: keywords(py, settings)?,
    };
    let start = match start {
        None => Start::Constant(0.01),
        Some(start) => match (start.extract::<f64>(), start.extract::<String>()) {
            (Ok(number), _) => Start::Constant(number),
            (_, Ok(word)) if word == "auto" => Start::Search,
            _ => {
                let values = Floats::new(start, "start", VOLUME)?.to_owned();
                Estimate::from(Volume::new(grid.0, values).map_err(raise)?).into()
            }
        },
    };
    warn_of_neglected(py, &request.observation.light)?;
    let solved = at_length(py, |stop| {
        request.solve(grid.0, stop, |problem, models, settings| {
            inversion::invert(problem, models, &start, settings, &Stopped(stop))
        })
    })?;
    give_reconstruction(py, solved)
}

/// Retrieve the extinction with the hybrid method: an inversion that starts from the estimate of
/// the network.
///
/// Parameters
/// ----------
/// radiance : array, [view, row, col]
///     Images (1/sr).
/// views : Views or sequence of View
///     The camera geometry of each image.
/// network : Network
///     The network.
/// light : Light, optional
///     Scene illumination of the images, required for general weights. Default: `Light()`.
/// grid : Grid, optional
///     The grid of the result. Default: `network.grid(views)`.
/// quick : bool
///     Use the quick hybrid method: 12 steps and one correction by the accurate solver.
/// mask : array of bool, [z, y, x], optional
///     The voxels in which the extinction is retrieved. By default the mask is carved from the
///     images with `carve`.
/// standard_error, saturated, truth, **settings
///     As in `invert`.
///
/// Returns
/// -------
/// Reconstruction
///
/// Raises
/// ------
/// TypeError
///     A setting is unknown or has a value of the wrong type.
/// ValueError
///     The images do not have the geometry that the network was trained for, the shapes of the
///     arrays do not match, or a parameter is out of range.
#[pyfunction]
#[pyo3(signature = (
    radiance, views, network, light = None, *, grid = None, quick = false, mask = None,
    standard_error = None, saturated = None, truth = None, **settings,
))]
#[allow(clippy::too_many_arguments)]
pub(crate) fn hybrid(
    py: Python<'_>,
    radiance: &Bound<'_, PyAny>,
    views: ViewSequence,
    network: &Network,
    light: Option<Light>,
    grid: Option<Grid>,
    quick: bool,
    mask: Option<&Bound<'_, PyAny>>,
    standard_error: Option<&Bound<'_, PyAny>>,
    saturated: Option<&Bound<'_, PyAny>>,
    truth: Option<&Bound<'_, PyAny>>,
    settings: Option<&Bound<'_, PyDict>>,
) -> PyResult<Reconstruction> {
    let mut request = Request {
        observation: observation(
            radiance,
            views,
            Some(Light(network.light(light)?)),
            standard_error,
            saturated,
        )?,
        mask: mask.map(|mask| booleans(mask, "mask", VOLUME)).transpose()?,
        truth: optional(truth, "truth")?,
        settings: keywords(py, settings)?,
    };
    if quick {
        request.settings = request.settings.quick();
    }
    warn_of_neglected(py, &request.observation.light)?;
    let network = network.inner();
    let solved = at_length(py, |stop| {
        let grid = match grid {
            Some(grid) => grid.0,
            None => network_grid(network, &request.observation)?,
        };
        request.solve(grid, stop, |problem, models, settings| {
            if quick {
                *models = models.clone().quick();
            }
            inversion::hybrid(problem, network, models, settings, &Stopped(stop))
        })
    })?;
    give_reconstruction(py, solved)
}

fn observation(
    radiance: &Bound<'_, PyAny>,
    views: ViewSequence,
    light: Option<Light>,
    standard_error: Option<&Bound<'_, PyAny>>,
    saturated: Option<&Bound<'_, PyAny>>,
) -> PyResult<Observation> {
    let images = ViewStack::new(Floats::new(radiance, "radiance", IMAGES)?.to_owned());
    let light = or_default(light);
    let mut observation =
        images.and_then(|images| Observation::new(light, views.0, images)).map_err(raise)?;
    if let Some(errors) = standard_error {
        let errors = Floats::new(errors, "standard_error", IMAGES)?.to_owned();
        observation.standard_error = Some(ViewStack::of_errors(errors).map_err(raise)?);
    }
    match saturated {
        None => Ok(observation),
        Some(marks) => {
            observation.with_saturated(booleans(marks, "saturated", IMAGES)?).map_err(raise)
        }
    }
}

fn optional(volume: Option<&Bound<'_, PyAny>>, name: &str) -> PyResult<Option<Array3<f32>>> {
    volume.map(|volume| Ok(Floats::new(volume, name, VOLUME)?.to_owned())).transpose()
}

fn keywords(py: Python<'_>, settings: Option<&Bound<'_, PyDict>>) -> PyResult<InversionSettings> {
    let nothing = PyDict::new(py);
    read(settings.unwrap_or(&nothing))
}

fn give_reconstruction(py: Python<'_>, solved: Solved) -> PyResult<Reconstruction> {
    let Solved { answer, mask, warnings } = solved;
    for warning in &warnings {
        warn(py, warning)?;
    }
    let text = |value: serde_json::Result<String>| value.expect("plain numbers and text");
    let history = text(serde_json::to_string(&answer.history));
    let ending = text(serde_json::to_string(&answer.ending)).trim_matches('"').to_owned();
    Ok(Reconstruction {
        extinction: give(py, answer.extinction.values),
        mask: give(py, mask.values),
        history: py.import("json")?.call_method1("loads", (history,))?.unbind(),
        ending,
    })
}
