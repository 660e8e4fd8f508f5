//! `invert` and `hybrid`: retrieval of a cloud with a forward model.

use crate::array::{Placed, copied, give, volume};
use crate::cloud::read;
use crate::compute::{Progress, Watch, at_length};
use crate::error::raise;
use crate::exchange::{dataset, provenance, write};
use crate::field;
use crate::grid::Grid;
use crate::light::{Light, warn, warn_of_neglected};
use crate::lineage::Lineage;
use crate::network::NetworkChoice;
use crate::observation::{Given, first_band, observations};
use crate::record::{Record, attributes, record};
use crate::view::ViewSequence;
use deepct_core::carve::{CarveSettings, carve};
use deepct_core::grid::{Mask, Volume};
use deepct_core::inversion::{
    self, InversionSettings, OrdinatesModels, Problem, StandardErrors, Start, network_grid,
};
use deepct_core::network::Estimate;
use deepct_core::scene::{self, Observation};
use deepct_core::transport::OrdinatesSettings;
use deepct_core::{Result, io};
use numpy::PyArray3;
use numpy::ndarray::Array3;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;

/// The result of an inversion.
///
/// Parameters
/// ----------
/// grid : Grid
///     The grid of the arrays.
/// extinction : array, [z, y, x]
///     Extinction (1/km). That of the droplets of a `Cloud` is the one in the `light`.
/// mask : array of bool, [z, y, x]
///     The voxels in which the extinction was retrieved.
/// history : list of dict
///     One entry for each step, as in the attribute.
/// ending : str
///     The reason for termination, as in the attribute.
/// light : Light
///     Scene illumination of the images, those of the first band.
/// effective_radius : array, [z, y, x], optional
///     Effective radius (um), if it was retrieved.
/// standard_errors : dict, optional
///     Standard errors of the voxels, as in the attribute.
/// calibrations : list of list of dict, optional
///     Calibrations of the cameras, as in the attribute.
/// lineage : Lineage, optional
///     Its time and history. Default: unknown.
#[pyclass(frozen, module = "deepct_py")]
pub(crate) struct Reconstruction {
    /// The grid of the arrays.
    #[pyo3(get)]
    grid: Grid,
    /// Extinction (1/km), 0 outside the mask: numpy.ndarray, float32, [z, y, x].
    #[pyo3(get)]
    extinction: Py<PyArray3<f32>>,
    /// The voxels in which the extinction was retrieved: numpy.ndarray, bool, [z, y, x].
    #[pyo3(get)]
    mask: Py<PyArray3<bool>>,
    /// One dict for each step, with the keys `stage`, `block`, `iteration`, `seconds`, `misfit`,
    /// `value` (of the cost function), `evaluations` and, if the true extinction was given,
    /// `relative_error` and `mass_error`.
    #[pyo3(get)]
    history: Py<PyAny>,
    /// The reason for termination: "noise" (the noise explains the misfit), "iterations" (the maximum
    /// number of steps was reached) or "stalled" (the cost function no longer decreased).
    #[pyo3(get)]
    ending: String,
    /// Scene illumination of the images, those of the first band.
    #[pyo3(get)]
    light: Light,
    /// Effective radius (um), 0 outside the mask: numpy.ndarray, float32, [z, y, x]; None if it was not
    /// retrieved.
    #[pyo3(get)]
    effective_radius: Option<Py<PyArray3<f32>>>,
    /// Standard errors of each voxel, 0 outside the mask, from the spread of `members` inversions: a dict of
    /// numpy.ndarray, float32, [z, y, x], with the keys "extinction" (1/km) and, if the effective radius
    /// was retrieved, "effective_radius" (um) and "liquid_water_content" (g/m3); empty without members.
    #[pyo3(get)]
    standard_errors: Py<PyDict>,
    /// The calibration of the camera of each view of each band: a list with one list for each band, of
    /// dicts with the keys `gain`, the factor by which the radiances are too large, and `offset`, the
    /// distance [rows, columns] of the point that a pixel shows from the pixel.
    #[pyo3(get)]
    calibrations: Py<PyAny>,
    /// Its time and history.
    #[pyo3(get)]
    lineage: Lineage,
}

record!(@volume Reconstruction);

impl Record for Reconstruction {
    fn arguments<'py>(of: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        let names = [
            "grid",
            "extinction",
            "mask",
            "history",
            "ending",
            "light",
            "effective_radius",
            "standard_errors",
            "calibrations",
            "lineage",
        ];
        attributes(of.as_any(), &names)
    }
}

#[pymethods]
impl Reconstruction {
    #[new]
    #[pyo3(signature = (
        grid, extinction, mask, history, ending, light, effective_radius = None, *,
        standard_errors = None, calibrations = None, lineage = None,
    ))]
    // In Python the last four have defaults.
    #[allow(clippy::too_many_arguments)]
    fn new(
        grid: Grid,
        extinction: &Bound<'_, PyAny>,
        mask: &Bound<'_, PyAny>,
        history: &Bound<'_, PyAny>,
        ending: &str,
        light: Light,
        effective_radius: Option<&Bound<'_, PyAny>>,
        standard_errors: Option<&Bound<'_, PyDict>>,
        calibrations: Option<&Bound<'_, PyAny>>,
        lineage: Option<Lineage>,
    ) -> PyResult<Self> {
        let py = extinction.py();
        let field = |field: &Bound<'_, PyAny>, name: &str| {
            Volume::new(grid.0, volume(field, name)?.on(grid.0)?).map_err(raise)
        };
        let radius = effective_radius.map(|radius| field(radius, "effective_radius"));
        let errors = standard_errors.filter(|errors| !errors.is_empty());
        let errors = errors.map(|errors| given_errors(errors, &field)).transpose()?;
        let values = field::extinction(extinction, "extinction", &light.core)?.on(grid.0)?;
        let mask = field::mask(mask, "mask")?.on(grid.0)?;
        let core = inversion::Reconstruction {
            extinction: Volume::new(grid.0, values).map_err(raise)?,
            effective_radius: radius.transpose()?,
            standard_errors: errors,
            calibrations: match calibrations {
                Some(calibrations) => parsed(&dumped(calibrations)?, "calibrations")?,
                None => Vec::new(),
            },
            history: parsed(&dumped(history)?, "history")?,
            ending: parsed(&format!("\"{ending}\""), "ending")?,
        };
        let mask = Mask::new(grid.0, mask).map_err(raise)?;
        let made = Self::give(py, core, mask, light, lineage.unwrap_or_default())?;
        // Numbers that are read from text may differ in their last digit.
        Ok(Self { history: history.clone().unbind(), ..made })
    }

    /// Write a netCDF file that all commands, `read_cloud`, `read_volume` and `read_mask` read. If the
    /// effective radius was retrieved, it contains the liquid water content. A file that deepct did not
    /// write is replaced only with `overwrite`.
    #[pyo3(signature = (path, *, title = "Extinction by inversion", overwrite = false))]
    fn to_netcdf(
        &self,
        py: Python<'_>,
        path: PathBuf,
        title: &str,
        overwrite: bool,
    ) -> PyResult<()> {
        let volume = |values: &Py<PyArray3<f32>>| {
            Volume::new(self.grid.0, copied(py, values)?).map_err(raise)
        };
        let errors = self.standard_errors.bind(py);
        let errors = (!errors.is_empty()).then(|| {
            given_errors(errors, &|field, _| {
                let field = field.cast::<PyArray3<f32>>()?.clone().unbind();
                volume(&field)
            })
        });
        let core = inversion::Reconstruction {
            extinction: volume(&self.extinction)?,
            effective_radius: self.effective_radius.as_ref().map(volume).transpose()?,
            standard_errors: errors.transpose()?,
            calibrations: parsed(&dumped(self.calibrations.bind(py))?, "calibrations")?,
            history: parsed(&dumped(self.history.bind(py))?, "history")?,
            ending: parsed(&format!("\"{}\"", self.ending), "ending")?,
        };
        let mask = Mask::new(self.grid.0, copied(py, &self.mask)?).map_err(raise)?;
        let images = self.light.of_no_images();
        let provenance = provenance(title, &self.lineage);
        write(py, &path, overwrite, |path| {
            io::write_reconstruction(path, &core, &mask, &images, &provenance)
        })
    }

    /// The reconstruction as a data set of xarray, with the variables of its file.
    fn to_xarray<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        dataset(py, |path| self.to_netcdf(py, path.into(), "Extinction by inversion", false))
    }
}

impl Reconstruction {
    fn give(
        py: Python<'_>,
        answer: inversion::Reconstruction,
        mask: Mask,
        light: Light,
        lineage: Lineage,
    ) -> PyResult<Self> {
        let text = |value: serde_json::Result<String>| value.expect("plain numbers and text");
        let object = |text: String| -> PyResult<Py<PyAny>> {
            Ok(py.import("json")?.call_method1("loads", (text,))?.unbind())
        };
        let standard_errors = PyDict::new(py);
        if let Some(errors) = answer.standard_errors {
            let StandardErrors { extinction, effective_radius, liquid_water_content } = errors;
            let fields = [Some(extinction), effective_radius, liquid_water_content];
            for (name, field) in ERRORS.into_iter().zip(fields) {
                if let Some(field) = field {
                    standard_errors.set_item(name, give(py, field.values))?;
                }
            }
        }
        Ok(Self {
            grid: Grid(answer.extinction.grid),
            extinction: give(py, answer.extinction.values),
            mask: give(py, mask.values),
            history: object(text(serde_json::to_string(&answer.history)))?,
            standard_errors: standard_errors.unbind(),
            calibrations: object(text(serde_json::to_string(&answer.calibrations)))?,
            ending: text(serde_json::to_string(&answer.ending)).trim_matches('"').to_owned(),
            light,
            effective_radius: answer.effective_radius.map(|radius| give(py, radius.values)),
            lineage,
        })
    }
}

/// The keys of `Reconstruction.standard_errors`.
const ERRORS: [&str; 3] = ["extinction", "effective_radius", "liquid_water_content"];

/// The standard errors in a dict, whose fields are converted.
fn given_errors(
    errors: &Bound<'_, PyDict>,
    convert: &dyn Fn(&Bound<'_, PyAny>, &str) -> PyResult<Volume>,
) -> PyResult<StandardErrors> {
    let unknown =
        |name: &Bound<'_, PyAny>| !ERRORS.iter().any(|known| name.eq(known).unwrap_or(false));
    if let Some(name) = errors.keys().iter().find(unknown) {
        let known = ERRORS.join(", ");
        return Err(PyValueError::new_err(format!("standard_errors has {name}, not {known}")));
    }
    let field = |name: &str| {
        let field = errors.get_item(name)?;
        field.map(|field| convert(&field, name)).transpose()
    };
    let missing = || PyValueError::new_err("standard_errors has no extinction");
    let [extinction, effective_radius, liquid_water_content] = ERRORS.map(field);
    Ok(StandardErrors {
        extinction: extinction?.ok_or_else(missing)?,
        effective_radius: effective_radius?,
        liquid_water_content: liquid_water_content?,
    })
}

/// An object of Python as JSON.
fn dumped(object: &Bound<'_, PyAny>) -> PyResult<String> {
    object.py().import("json")?.call_method1("dumps", (object,))?.extract()
}

fn parsed<T: serde::de::DeserializeOwned>(text: &str, name: &str) -> PyResult<T> {
    serde_json::from_str(text).map_err(|problem| {
        PyValueError::new_err(format!("{name} is not that of a reconstruction: {problem}"))
    })
}

/// The converted arguments that `invert` and `hybrid` have in common.
struct Request {
    bands: Vec<Observation>,
    mask: Option<Placed<bool>>,
    truth: Option<Placed<f32>>,
    settings: InversionSettings,
    lineage: Lineage,
}

/// The mask and the truth of a request, on its grid.
struct OnGrid {
    grid: deepct_core::grid::Grid,
    mask: Option<Array3<bool>>,
    truth: Option<Array3<f32>>,
}

impl Request {
    fn new(
        bands: Vec<Observation>,
        mask: Option<&Bound<'_, PyAny>>,
        truth: Option<&Bound<'_, PyAny>>,
        settings: InversionSettings,
        lineage: Lineage,
    ) -> PyResult<Self> {
        let light = &bands[0].light;
        let truth = truth.map(|truth| field::extinction(truth, "truth", light)).transpose()?;
        let mask = mask.map(|mask| field::mask(mask, "mask")).transpose()?;
        Ok(Self { bands, mask, truth, settings, lineage })
    }

    /// The request on a grid, to which what it contains must belong.
    fn on(
        self,
        grid: deepct_core::grid::Grid,
    ) -> PyResult<(OnGrid, Vec<Observation>, InversionSettings)> {
        let mask = self.mask.map(|mask| mask.on(grid)).transpose()?;
        let truth = self.truth.map(|truth| truth.on(grid)).transpose()?;
        Ok((OnGrid { grid, mask, truth }, self.bands, self.settings))
    }

    /// Retrieves the cloud on a grid.
    fn solve(
        self,
        py: Python<'_>,
        grid: deepct_core::grid::Grid,
        progress: &Progress,
        method: impl FnOnce(
            &Problem,
            &mut OrdinatesModels,
            &InversionSettings,
            &Watch,
        ) -> Result<Answer>
        + Send
        + 'static,
    ) -> PyResult<Reconstruction> {
        let lights = self
            .bands
            .iter()
            .map(|band| Light { core: band.light.clone(), assumed: band.assumed.clone() });
        let lights: Vec<Light> = lights.collect();
        for light in &lights {
            light.warn_of_assumed(py)?;
            warn_of_neglected(py, &light.core)?;
        }
        let light = lights[0].clone();
        let lineage = self.lineage.clone();
        let (on_grid, bands, settings) = self.on(grid)?;
        let solved =
            at_length(py, progress, move |watch| on_grid.solve(&bands, &settings, watch, method))?;
        for warning in &solved.warnings {
            warn(py, warning)?;
        }
        Reconstruction::give(py, solved.answer, solved.mask, light, lineage)
    }
}

impl OnGrid {
    /// The given mask or, if there is none, the mask carved from the images, with warnings.
    fn mask(&mut self, bands: &[Observation]) -> Result<(Mask, Vec<String>)> {
        let mut warnings = Vec::new();
        let mask = match self.mask.take() {
            Some(values) => Mask::new(self.grid, values)?,
            None => {
                let carved = carve(&bands[0], &self.grid, &CarveSettings::default())?;
                warnings.extend(carved.warning());
                carved.mask
            }
        };
        let unseen = mask.count() - inversion::shown(&mask, bands)?.count();
        if unseen > 0 && unseen < mask.count() {
            let count = mask.count();
            warnings.push(format!(
                "no image shows {unseen} of {count} voxels of the mask: their extinction is not \
                 retrieved and is 0"
            ));
        }
        Ok((mask, warnings))
    }

    fn solve(
        mut self,
        bands: &[Observation],
        settings: &InversionSettings,
        watch: &Watch,
        method: impl FnOnce(
            &Problem,
            &mut OrdinatesModels,
            &InversionSettings,
            &Watch,
        ) -> Result<Answer>,
    ) -> Result<Solved> {
        let truth = self.truth.take().map(|values| Volume::new(self.grid, values)).transpose()?;
        let (mask, mut warnings) = self.mask(bands)?;
        let solver = OrdinatesSettings::default();
        let mut models = OrdinatesModels::of(bands, &self.grid, settings.radius, solver)?;
        models.stop = watch.stop.clone();
        let problem = Problem { bands, mask: &mask, truth: truth.as_ref() };
        let answer = method(&problem, &mut models, settings, watch)?;
        if let Some(problem) = answer.explanation().problem() {
            warnings.push(format!(
                "{problem}; check light, views and grid, or begin elsewhere (init=\"auto\")"
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
/// radiance : Observation, array [view, row, col], str or path, or list of Observation
///     Images (1/sr), or those of each band. The extinction and the mask are those of the first band.
/// views : Views or sequence of View, optional
///     The camera geometry of each image, unless the images are an observation.
/// grid : Grid, object or path
///     The grid of the extinction: a `Grid`, an object that has one, such as a `Cloud`, or a file with one.
///     Default: that of `init`, if it has one.
/// light : Light, optional
///     Scene illumination of the images, unless they are an observation. Default: `Light()`.
/// init : float, array [z, y, x], Estimate, Cloud, path or "auto", optional
///     Initial extinction (1/km); that of a `Cloud` as for `truth`. "auto" selects the constant that
///     fits the images best. Default: 0.01.
/// mask : array of bool [z, y, x], Carved, str or path, optional
///     The voxels in which the extinction is retrieved. By default the mask is carved from the
///     images with `carve`.
/// standard_error : array, [view, row, col], optional
///     Standard error of each pixel (1/sr); infinite for pixels that are left out.
/// saturated : array of bool, [view, row, col], optional
///     The pixels that are saturated: they are at least as bright as their radiance.
/// truth : array [z, y, x], Cloud, str or path, optional
///     The true extinction (1/km). If it is given, the history contains the errors of each step. The
///     extinction of a cloud that is given by its droplets is the one in the light of the images.
/// progress : bool or callable
///     True shows a line of progress on the standard error. A function is called with a dict such as
///     those of `Reconstruction.history` after each step; an exception that it raises ends the
///     computation.
/// **settings
///     Settings of the inversion, such as `iterations`, `radius`, with which the effective radius is
///     retrieved ("uniform", "adiabatic" or "field"), or `members`, which gives standard errors. The
///     command `deepct config invert` lists them under `[inversion]`.
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
///
/// Examples
/// --------
/// >>> cloud = deepct_py.generate_cloud(seed=3, width_km=0.4)
/// >>> images = deepct_py.render(cloud, views="cloudct-10", solver="ordinates")
/// >>> result = deepct_py.invert(images, grid=cloud.grid, iterations=1, coarse=[])
/// >>> result.ending
/// 'iterations'
#[pyfunction]
#[pyo3(signature = (
    radiance, views = None, grid = None, light = None, *, init = None, mask = None,
    standard_error = None, saturated = None, truth = None, progress = Progress::None, **settings,
), text_signature = "(radiance, views=None, grid=None, light=None, *, init=0.01, mask=None, \
                     standard_error=None, saturated=None, truth=None, progress=False, **settings)")]
// In Python these are keyword arguments with defaults.
#[allow(clippy::too_many_arguments)]
pub(crate) fn invert<'py>(
    radiance: &Bound<'py, PyAny>,
    views: Option<ViewSequence>,
    grid: Option<Grid>,
    light: Option<Light>,
    init: Option<&Bound<'py, PyAny>>,
    mask: Option<&Bound<'py, PyAny>>,
    standard_error: Option<Bound<'py, PyAny>>,
    saturated: Option<Bound<'py, PyAny>>,
    truth: Option<&Bound<'py, PyAny>>,
    progress: Progress,
    settings: Option<&Bound<'py, PyDict>>,
) -> PyResult<Reconstruction> {
    let py = radiance.py();
    let given = Given { views, light, standard_error, saturated };
    let default_light = |_: &_| Ok(Light::from(scene::Light::default()));
    let bands = observations(radiance, given, default_light)?;
    let lineage = Lineage::after(&first_band(radiance)?, "invert")?;
    let request = Request::new(bands, mask, truth, keywords(py, settings)?, lineage)?;
    let init = match init {
        None => Init::Start(Start::Constant(0.01)),
        Some(init) => match (init.extract::<f64>(), init.extract::<String>()) {
            (Ok(number), _) => Init::Start(Start::Constant(number)),
            (_, Ok(word)) if word == "auto" => Init::Start(Start::Search),
            _ => Init::Volume(field::extinction(init, "init", &request.bands[0].light)?),
        },
    };
    let grid = match (grid, &init) {
        (Some(Grid(grid)), _) => grid,
        (None, Init::Volume(values)) => values.grid(None)?,
        (None, Init::Start(_)) => return Err(PyTypeError::new_err("grid is missing")),
    };
    let start = match init {
        Init::Start(start) => start,
        Init::Volume(values) => {
            Estimate::from(Volume::new(grid, values.on(grid)?).map_err(raise)?).into()
        }
    };
    request.solve(py, grid, &progress, move |problem, models, settings, watch| {
        inversion::invert(problem, models, &start, settings, watch)
    })
}

/// The initial extinction of an argument.
enum Init {
    Start(Start),
    Volume(Placed<f32>),
}

/// Retrieve the extinction with the hybrid method: an inversion that starts from the estimate of
/// the network.
///
/// Parameters
/// ----------
/// radiance : Observation, array [view, row, col], str or path
///     Images (1/sr).
/// views : Views or sequence of View, optional
///     The camera geometry of each image, unless the images are an observation.
/// network : Network, str or path, optional
///     The network, or the name or file of its weights. Default: `"general"`.
/// light : Light, optional
///     Scene illumination of the images, unless they are an observation; required for general weights.
///     Default: `Light()`.
/// grid : Grid, object or path, optional
///     The grid of the result, as in `invert`. Default: `network.grid(views)`.
/// quick : bool
///     Use the quick hybrid method: 12 steps and one correction by the accurate solver.
/// mask : array of bool [z, y, x], Carved, str or path, optional
///     The voxels in which the extinction is retrieved. By default the mask is carved from the
///     images with `carve`.
/// standard_error, saturated, truth, progress, **settings
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
///
/// Examples
/// --------
/// >>> cloud = deepct_py.generate_cloud(seed=3, width_km=0.4)
/// >>> images = deepct_py.render(cloud, views="cloudct-10", solver="ordinates")
/// >>> network = deepct_py.Network.load("cloudct-10")
/// >>> result = deepct_py.hybrid(images, network=network, iterations=1)
/// >>> result.extinction.shape == result.grid.shape
/// True
#[pyfunction]
#[pyo3(signature = (
    radiance, views = None, network = None, light = None, *, grid = None, quick = false,
    mask = None, standard_error = None, saturated = None, truth = None,
    progress = Progress::None, **settings,
), text_signature = "(radiance, views=None, network=None, light=None, *, grid=None, quick=False, \
                     mask=None, standard_error=None, saturated=None, truth=None, progress=False, \
                     **settings)")]
#[allow(clippy::too_many_arguments)]
pub(crate) fn hybrid<'py>(
    radiance: &Bound<'py, PyAny>,
    views: Option<ViewSequence>,
    network: Option<NetworkChoice<'py>>,
    light: Option<Light>,
    grid: Option<Grid>,
    quick: bool,
    mask: Option<&Bound<'py, PyAny>>,
    standard_error: Option<Bound<'py, PyAny>>,
    saturated: Option<Bound<'py, PyAny>>,
    truth: Option<&Bound<'py, PyAny>>,
    progress: Progress,
    settings: Option<&Bound<'py, PyDict>>,
) -> PyResult<Reconstruction> {
    let py = radiance.py();
    let general = || NetworkChoice::Name(io::GENERAL_WEIGHTS.into());
    let network = network.unwrap_or_else(general).network(py)?;
    let network = network.get();
    let given = Given { views, light, standard_error, saturated };
    let bands = observations(radiance, given, |_| network.default_light())?;
    let settings = keywords(py, settings)?;
    let settings = if quick { settings.quick() } else { settings };
    let lineage = Lineage::after(&first_band(radiance)?, "hybrid")?;
    let request = Request::new(bands, mask, truth, settings, lineage)?;
    let network = network.inner();
    let grid = match grid {
        Some(Grid(grid)) => grid,
        None => network_grid(&network, &request.bands[0]).map_err(raise)?,
    };
    request.solve(py, grid, &progress, move |problem, models, settings, watch| {
        if quick {
            *models = models.clone().quick();
        }
        inversion::hybrid(problem, &network, models, settings, watch)
    })
}

fn keywords(py: Python<'_>, settings: Option<&Bound<'_, PyDict>>) -> PyResult<InversionSettings> {
    let nothing = PyDict::new(py);
    read(settings.unwrap_or(&nothing))
}
