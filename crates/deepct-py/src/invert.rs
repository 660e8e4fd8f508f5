//! `invert` and `hybrid`: from images to extinction by physics.

use crate::array::{Floats, IMAGES, VOLUME, booleans, give};
use crate::cloud::read;
use crate::error::raise;
use crate::grid::Grid;
use crate::light::{Light, or_default};
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
use deepct_core::transport::OrdinatesSettings;
use numpy::PyArray3;
use numpy::ndarray::Array3;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// What an inversion came to.
///
/// Attributes
/// ----------
/// extinction : numpy.ndarray, float32, [z, y, x]
///     Extinction (1/km), 0 outside the mask.
/// mask : numpy.ndarray, bool, [z, y, x]
///     Where cloud was looked for.
/// history : list of dict
///     What was reached, step by step: `block`, `iteration`, `seconds`, `misfit`, `value`,
///     `evaluations` and, where the truth was given, `relative_error` and `mass_error`.
/// ending : str
///     Why it ended: "noise" (the misfit is what the noise explains), "iterations" (all
///     steps were taken) or "stalled" (steps did not lower the misfit any more).
#[pyclass(frozen, module = "deepct_py", get_all)]
pub(crate) struct Reconstruction {
    extinction: Py<PyArray3<f32>>,
    mask: Py<PyArray3<bool>>,
    history: Py<PyAny>,
    ending: String,
}

/// Arrays and settings of both functions, converted.
struct Request {
    observation: Observation,
    mask: Option<Array3<bool>>,
    truth: Option<Array3<f32>>,
    settings: InversionSettings,
}

impl Request {
    /// The mask that was given, or else is carved.
    fn mask(&mut self, grid: deepct_core::grid::Grid) -> Result<Mask> {
        match self.mask.take() {
            Some(values) => Mask::new(grid, values),
            None => Ok(carve(&self.observation, &grid, &CarveSettings::default())?.mask),
        }
    }

    fn models(&self, grid: deepct_core::grid::Grid) -> Result<OrdinatesModels> {
        let scene = self.observation.light.scene_of(Volume::constant(grid, 0.0))?;
        let views = self.observation.views.clone();
        Ok(OrdinatesModels::new(scene, views, OrdinatesSettings::default()))
    }

    fn solve(
        mut self,
        grid: deepct_core::grid::Grid,
        way: impl FnOnce(&Problem, &mut OrdinatesModels, &InversionSettings) -> Result<Answer>,
    ) -> Result<(Answer, Mask)> {
        let truth = self.truth.take().map(|values| Volume::new(grid, values)).transpose()?;
        let mask = self.mask(grid)?;
        let mut models = self.models(grid)?;
        let problem =
            Problem { observation: &self.observation, mask: &mask, truth: truth.as_ref() };
        Ok((way(&problem, &mut models, &self.settings)?, mask))
    }
}

type Answer = inversion::Reconstruction;

/// Invert images: the extinction whose computed images are those given.
///
/// A deterministic solver gives images and their exact derivatives; a bounded quasi-Newton
/// method fits them, on grids from coarse to fine where the start is a number.
///
/// Parameters
/// ----------
/// radiance : array, [view, row, col]
///     Images (1/sr).
/// views : Views or sequence of View
///     How they were taken, one for each image.
/// grid : Grid
///     Where the voxels are.
/// light : Light, optional
///     The light that they were taken in.
/// start : float, array [z, y, x] or "auto"
///     Extinction (1/km) to start from; "auto" takes the number that fits the images best.
/// mask : array of bool, [z, y, x], optional
///     Where cloud is looked for; carved from the images where it is not given.
/// standard_error : array, [view, row, col], optional
///     Standard error of each pixel (1/sr).
/// truth : array, [z, y, x], optional
///     The true extinction: the history then tells how far each step is from it.
/// settings
///     Keywords: the settings that `deepct config invert` prints under `[inversion]`, such
///     as `iterations`.
///
/// Returns
/// -------
/// Reconstruction
///
/// Raises
/// ------
/// TypeError
///     An unknown setting, or a value of a wrong type.
/// ValueError
///     Arrays that do not fit each other, a number out of range.
#[pyfunction]
#[pyo3(signature = (
    radiance, views, grid, light = None, *, start = None, mask = None, standard_error = None,
    truth = None, **settings,
))]
// Keywords with defaults on the side that users see.
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
    truth: Option<&Bound<'_, PyAny>>,
    settings: Option<&Bound<'_, PyDict>>,
) -> PyResult<Reconstruction> {
    let request = Request {
        observation: observation(radiance, views, light, standard_error)?,
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
    let solved = py.detach(|| {
        request.solve(grid.0, |problem, models, settings| {
            inversion::invert(problem, models, &start, settings, &())
        })
    });
    give_reconstruction(py, solved)
}

/// The network, then the inversion from its answer.
///
/// Parameters
/// ----------
/// radiance : array, [view, row, col]
///     Images (1/sr).
/// views : Views or sequence of View
///     How they were taken, one for each image.
/// network : Network
///     The network; the answer is on `network.grid(views)`.
/// light : Light, optional
///     The light that they were taken in.
/// quick : bool
///     Take 12 steps only, corrected once by the accurate solver.
/// mask : array of bool, [z, y, x], optional
///     Where cloud is looked for; carved from the images where it is not given.
/// standard_error, truth, settings
///     As in `invert`.
///
/// Returns
/// -------
/// Reconstruction
///
/// Raises
/// ------
/// TypeError
///     An unknown setting, or a value of a wrong type.
/// ValueError
///     Images that are not what the weights are for; arrays that do not fit each other, a
///     number out of range.
#[pyfunction]
#[pyo3(signature = (
    radiance, views, network, light = None, *, quick = false, mask = None, standard_error = None,
    truth = None, **settings,
))]
#[allow(clippy::too_many_arguments)]
pub(crate) fn hybrid(
    py: Python<'_>,
    radiance: &Bound<'_, PyAny>,
    views: ViewSequence,
    network: &Network,
    light: Option<Light>,
    quick: bool,
    mask: Option<&Bound<'_, PyAny>>,
    standard_error: Option<&Bound<'_, PyAny>>,
    truth: Option<&Bound<'_, PyAny>>,
    settings: Option<&Bound<'_, PyDict>>,
) -> PyResult<Reconstruction> {
    let mut request = Request {
        observation: observation(radiance, views, light, standard_error)?,
        mask: mask.map(|mask| booleans(mask, "mask", VOLUME)).transpose()?,
        truth: optional(truth, "truth")?,
        settings: keywords(py, settings)?,
    };
    if quick {
        request.settings = request.settings.quick();
    }
    let network = network.inner();
    let solved = py.detach(|| {
        let grid = network_grid(network, &request.observation)?;
        request.solve(grid, |problem, models, settings| {
            if quick {
                *models = models.clone().quick();
            }
            inversion::hybrid(problem, network, models, settings, &())
        })
    });
    give_reconstruction(py, solved)
}

fn observation(
    radiance: &Bound<'_, PyAny>,
    views: ViewSequence,
    light: Option<Light>,
    standard_error: Option<&Bound<'_, PyAny>>,
) -> PyResult<Observation> {
    let images = ViewStack::new(Floats::new(radiance, "radiance", IMAGES)?.to_owned());
    let light = or_default(light);
    let mut observation =
        images.and_then(|images| Observation::new(light, views.0, images)).map_err(raise)?;
    if let Some(errors) = standard_error {
        let errors = Floats::new(errors, "standard_error", IMAGES)?.to_owned();
        observation.standard_error = Some(ViewStack::new(errors).map_err(raise)?);
    }
    Ok(observation)
}

fn optional(volume: Option<&Bound<'_, PyAny>>, name: &str) -> PyResult<Option<Array3<f32>>> {
    volume.map(|volume| Ok(Floats::new(volume, name, VOLUME)?.to_owned())).transpose()
}

fn keywords(py: Python<'_>, settings: Option<&Bound<'_, PyDict>>) -> PyResult<InversionSettings> {
    let nothing = PyDict::new(py);
    read(settings.unwrap_or(&nothing))
}

fn give_reconstruction(py: Python<'_>, solved: Result<(Answer, Mask)>) -> PyResult<Reconstruction> {
    let (answer, mask) = solved.map_err(raise)?;
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
