//! `Renderer`: the images of a scene as a function of the extinction and of the effective radius, and its
//! derivatives.

use crate::array::{give, images_in_any_unit, volume};
use crate::compute::{CHECKED, Progress, at_length};
use crate::error::raise;
use crate::field;
use crate::grid::Grid;
use crate::light::{Light, warn, warn_of_neglected};
use crate::record::{Record, attributes, record};
use crate::render::views_of;
use crate::view::Views;
use deepct_core::grid::{Mask, Volume};
use deepct_core::image::ViewStack;
use deepct_core::scene::{self, PhaseModel};
use deepct_core::stop::Stop;
use deepct_core::transport::{OrdinatesModel, OrdinatesSettings};
use deepct_core::{Error, Result};
use numpy::PyArray3;
use numpy::ndarray::Array3;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use rayon::prelude::*;
use std::sync::{Arc, Condvar, Mutex, PoisonError};

/// Default of the extinction (1/km) that is expected, which is that of an inversion.
const EXPECTED: f32 = 20.0;

/// The images of a scene as a function of its extinction, with derivatives, by the
/// discrete-ordinates solver.
///
/// For machine learning and optimisation of your own: `deepct_py.torch` and `deepct_py.jax` make it
/// a function of PyTorch and JAX, `deepct_py.scipy` makes its derivative a linear operator of SciPy.
/// The cells of the solver are made once. Every solution starts from the one before, so that a small
/// change of the extinction takes a fraction of the time; results therefore depend on earlier calls
/// within the tolerance. The derivatives are those of the discretised computation.
///
/// With the phase function "mie" and a light without `effective_radius`, the images are a function of the
/// extinction and of the effective radius of each voxel, which every method then takes as well.
/// `Light.extinction_per_water` leads from liquid water content to extinction.
///
/// Parameters
/// ----------
/// grid : Grid
///     The grid of the extinction.
/// views : Views, sequence of View, str or path
///     The cameras, all with the same image size; or the name or file of a formation as in
///     `Views.load`, which points at the centre of the grid and takes one pixel for each column.
/// light : Light, optional
///     Scene illumination: Sun, wavelength, droplet optics, molecular atmosphere and surface.
///     Default: `Light()`.
/// mask : array of bool [z, y, x], or Carved, optional
///     The voxels that may contain cloud. All others are clear, whatever extinction is given, and
///     derivatives are zero there. Default: all voxels; a mask saves most of the time and memory.
/// expected : float or array [z, y, x], optional
///     The extinction (1/km) that is expected, at least approximately. Voxels are divided into cells
///     that are thin enough for it, and for 20 per km in any case. Where the extinction becomes much
///     larger, images are less accurate, with one warning when they are several percent too dark;
///     where it stays smaller, time is lost. Default: 20.
/// accuracy : float, optional
///     Approximate relative error of the bright pixels, from 0.003 to 0.1. With 0.03 and more it is
///     several times faster than by default, which corresponds to 0.01.
/// tolerance : float, optional
///     Relative change of the radiance by a sweep of the solver at which a solution ends. Default:
///     1e-4, or 1e-3 for an accuracy of 0.03 and more; 3e-7 is close to the rounding of single
///     precision.
/// warm_start : bool
///     Whether a solution starts from the one before, so that a small change of the extinction takes a
///     fraction of the time. Results then depend on earlier calls, within the tolerance. Differences
///     of images of similar extinctions are too small, as their solutions are too close: for such
///     differences, and for the same bits whatever was computed before, give False.
///
/// Raises
/// ------
/// ValueError
///     A shape is not that of the grid, or a parameter is out of range.
///
/// Notes
/// -----
/// Arrays are computed in single precision. The solver is released from the interpreter lock and stops
/// at Ctrl-C. A renderer can be used by several threads, which wait for each other; copies
/// (`copy.copy(renderer)`) compute at the same time. It keeps the solution for the last extinction;
/// `nbytes` estimates the memory that a computation needs at most.
///
/// Examples
/// --------
/// >>> cloud = deepct_py.generate_cloud(seed=3, width_km=0.4)
/// >>> renderer = deepct_py.Renderer(cloud.grid, "cloudct-10", mask=cloud.extinction > 0)
/// >>> images = renderer.images(cloud)
/// >>> images.shape
/// (10, 32, 32)
/// >>> gradient = renderer.vjp(cloud, 2 * (images - 0.1))
/// >>> gradient.shape == cloud.grid.shape
/// True
///
/// Extinction and effective radius:
///
/// >>> light = deepct_py.Light(phase="mie")
/// >>> renderer = deepct_py.Renderer(cloud.grid, "cloudct-10", light, mask=cloud.extinction > 0)
/// >>> radius = np.full(cloud.grid.shape, 8.0)
/// >>> images = renderer.images(cloud.extinction, radius)
/// >>> by_extinction, by_radius = renderer.vjp(cloud.extinction, images, radius)
#[pyclass(frozen, module = "deepct_py")]
pub(crate) struct Renderer {
    /// The grid of the extinction.
    #[pyo3(get)]
    grid: Grid,
    views: Vec<scene::View>,
    /// Scene illumination.
    #[pyo3(get)]
    light: Light,
    /// The voxels that may contain cloud: numpy.ndarray, bool, [z, y, x].
    #[pyo3(get)]
    mask: Py<PyArray3<bool>>,
    /// The extinction (1/km) for which the voxels are divided into cells: numpy.ndarray, float32,
    /// [z, y, x], or a number.
    #[pyo3(get)]
    expected: Py<PyAny>,
    /// Approximate relative error of the bright pixels; None for the default.
    #[pyo3(get)]
    accuracy: Option<f64>,
    /// Relative change of the radiance at which a solution ends.
    #[pyo3(get)]
    tolerance: f64,
    /// Number of cells of the solver.
    #[pyo3(get)]
    cells: usize,
    /// Approximate memory that a computation needs at most (bytes).
    #[pyo3(get)]
    nbytes: u64,
    /// Whether a solution starts from the one before.
    #[pyo3(get)]
    warm_start: bool,
    solver: Arc<Desk>,
}

record!(Renderer);

impl Record for Renderer {
    fn arguments<'py>(of: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        let scene = ["grid", "views", "light", "mask", "expected"];
        let settings = ["accuracy", "tolerance", "warm_start"];
        attributes(of.as_any(), &[&scene[..], &settings[..]].concat())
    }
}

#[pymethods]
impl Renderer {
    #[new]
    #[pyo3(
        signature = (
            grid, views, light = None, *, mask = None, expected = None, accuracy = None,
            tolerance = None, warm_start = true,
        ),
        text_signature = "(grid, views, light=None, *, mask=None, expected=20.0, accuracy=None, \
                          tolerance=None, warm_start=True)",
    )]
    // In Python these are keyword arguments with defaults.
    #[allow(clippy::too_many_arguments)]
    fn new(
        grid: Grid,
        views: &Bound<'_, PyAny>,
        light: Option<Light>,
        mask: Option<&Bound<'_, PyAny>>,
        expected: Option<&Bound<'_, PyAny>>,
        accuracy: Option<f64>,
        tolerance: Option<f64>,
        warm_start: bool,
    ) -> PyResult<Self> {
        let py = views.py();
        let light = light.unwrap_or_else(|| scene::Light::default().into());
        warn_of_neglected(py, &light.core)?;
        let views = views_of(views, &grid.0)?;
        let mask = match mask {
            Some(values) => field::mask(values, "mask")?.on(grid.0)?,
            None => Array3::from_elem(grid.0.shape, true),
        };
        let mask = Mask::new(grid.0, mask).map_err(raise)?;
        if mask.count() == 0 {
            return Err(PyValueError::new_err(
                "mask has no voxels: mark those that may hold cloud",
            ));
        }
        let expected = match expected {
            None => Expected::Constant(EXPECTED),
            Some(given) => match given.extract::<f32>() {
                Ok(number) => Expected::Constant(number),
                Err(_) => {
                    let values = field::extinction(given, "expected", &light.core)?;
                    Expected::Volume(values.on(grid.0)?)
                }
            },
        };
        let mut prepared = match &expected {
            Expected::Constant(number) => Volume::constant(grid.0, *number),
            Expected::Volume(values) => Volume::new(grid.0, values.clone()).map_err(raise)?,
        };
        prepared.check_non_negative("expected").map_err(raise)?;
        prepared.values.mapv_inplace(|value| value.max(EXPECTED));
        mask.apply(&mut prepared).map_err(raise)?;
        let mut settings = accuracy
            .map_or(Ok(OrdinatesSettings::default()), OrdinatesSettings::with_accuracy)
            .map_err(raise)?;
        settings.tolerance = tolerance.unwrap_or(settings.tolerance);
        let (core, shown, voxels) = (light.core.clone(), views.clone(), mask.clone());
        let solver = at_length(py, &Progress::None, move |_| {
            let scene = match is_of_droplets(&core) {
                true => core.scene_of_any_droplets(prepared)?,
                false => core.scene_of(prepared)?,
            };
            let model = OrdinatesModel::new(&scene, &shown, Some(&voxels), &settings)?;
            Ok(Solver { model, warm_start, has_warned: false, solved: None })
        })?;
        Ok(Self {
            grid,
            views,
            light,
            mask: give(py, mask.values),
            expected: expected.give(py)?,
            accuracy,
            tolerance: settings.tolerance,
            warm_start,
            cells: solver.model.cells(),
            nbytes: solver.model.bytes() as u64,
            solver: Arc::new(Desk::new(solver)),
        })
    }

    /// The cameras.
    #[getter]
    fn views(&self) -> Views {
        Views(self.views.clone())
    }

    /// Shape [view, row, col] of the images.
    #[getter]
    fn shape(&self) -> (usize, usize, usize) {
        (self.views.len(), self.views[0].rows, self.views[0].cols)
    }

    /// The images of an extinction.
    ///
    /// Parameters
    /// ----------
    /// extinction : array [z, y, x], Cloud, Estimate or Reconstruction
    ///     Extinction (1/km). It counts in the voxels of the mask only.
    /// effective_radius : array [z, y, x], optional
    ///     Effective radius (um), with the phase function "mie" and a light that has none. Default: that
    ///     of the cloud, if the extinction is a `Cloud` with droplets.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray
    ///     Radiance (1/sr), float32, [view, row, col].
    ///
    /// Raises
    /// ------
    /// ValueError
    ///     An array is on another grid, negative or not finite; an effective radius is missing, of no
    ///     effect in this light, or beyond the table of droplet optics where there is extinction.
    #[pyo3(signature = (extinction, effective_radius = None))]
    fn images(
        &self,
        extinction: &Bound<'_, PyAny>,
        effective_radius: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Py<PyArray3<f32>>> {
        let py = extinction.py();
        let task = self.task(extinction, effective_radius, Wanted::Images)?;
        Ok(self.compute(py, task)?.remove(0))
    }

    /// Vector-Jacobian product: the derivative of `sum(cotangent * images)` with respect to the
    /// extinction of each voxel.
    ///
    /// The images are not computed again if the last call of any method was for the same extinction.
    ///
    /// Parameters
    /// ----------
    /// extinction : array [z, y, x], Cloud, Estimate or Reconstruction
    ///     The extinction (1/km) at which the derivative is taken.
    /// cotangent : array [view, row, col]
    ///     Derivative of a quantity with respect to each pixel (sr), for example
    ///     `2 * (images - measured)`; 0 for pixels that are left out.
    /// effective_radius : array [z, y, x], optional
    ///     As in `images`.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray, or a pair of them
    ///     Derivative of the quantity with respect to the extinction (km), float32, [z, y, x]; 0
    ///     outside the mask. If the images are also a function of the effective radius: both that with
    ///     respect to the extinction at constant radius and that with respect to the radius (1/um).
    ///
    /// Raises
    /// ------
    /// ValueError
    ///     As `images`; or the cotangent has another shape than the images or is not finite.
    #[pyo3(signature = (extinction, cotangent, effective_radius = None))]
    fn vjp<'py>(
        &self,
        extinction: &Bound<'py, PyAny>,
        cotangent: &Bound<'py, PyAny>,
        effective_radius: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let py = extinction.py();
        let wanted = self.cotangent(cotangent)?;
        let mut arrays = self.compute(py, self.task(extinction, effective_radius, wanted)?)?;
        match arrays.len() {
            1 => Ok(arrays.remove(0).into_bound(py).into_any()),
            _ => Ok(PyTuple::new(py, arrays)?.into_any()),
        }
    }

    /// Jacobian-vector product: the derivative of the images in a direction.
    ///
    /// It is the transpose of `vjp`. The images are not computed again if the last call of any
    /// method was for the same extinction.
    ///
    /// Parameters
    /// ----------
    /// extinction : array [z, y, x], Cloud, Estimate or Reconstruction
    ///     The extinction (1/km) at which the derivative is taken.
    /// direction : array [z, y, x]
    ///     Change of the extinction (1/km), of any sign.
    /// effective_radius : array [z, y, x], optional
    ///     As in `images`; it is constant in this direction.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray
    ///     Change of the radiance (1/sr), float32, [view, row, col].
    ///
    /// Raises
    /// ------
    /// ValueError
    ///     As `images`; or the direction is on another grid or not finite.
    #[pyo3(signature = (extinction, direction, effective_radius = None))]
    fn jvp(
        &self,
        extinction: &Bound<'_, PyAny>,
        direction: &Bound<'_, PyAny>,
        effective_radius: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Py<PyArray3<f32>>> {
        let py = extinction.py();
        let wanted = self.direction(direction)?;
        Ok(self.compute(py, self.task(extinction, effective_radius, wanted)?)?.remove(0))
    }
}

/// The results of one method of several renderers, computed at the same time: "images", "vjp" or
/// "jvp". The arguments for each renderer are the extinction, the effective radius if the images are a
/// function of it, and the cotangent or direction. Each has a list of results, of which `vjp` has one for
/// each of the first two.
#[pyfunction]
pub(crate) fn side_by_side(
    py: Python<'_>,
    renderers: Vec<Bound<'_, Renderer>>,
    method: &str,
    arguments: Vec<Vec<Bound<'_, PyAny>>>,
) -> PyResult<Vec<Vec<Py<PyArray3<f32>>>>> {
    let task = |(renderer, arguments): (&Bound<'_, Renderer>, &Vec<Bound<'_, PyAny>>)| {
        let renderer = renderer.get();
        let (point, last) = match method {
            "images" => (arguments.as_slice(), None),
            _ => {
                arguments.split_last().map_or((&[][..], None), |(last, point)| (point, Some(last)))
            }
        };
        let wanted = match (method, last) {
            ("images", None) => Wanted::Images,
            ("vjp", Some(cotangent)) => renderer.cotangent(cotangent)?,
            ("jvp", Some(direction)) => renderer.direction(direction)?,
            _ => return Err(PyTypeError::new_err(format!("no {method}"))),
        };
        match point {
            [extinction] => renderer.task(extinction, None, wanted),
            [extinction, radius] => renderer.task(extinction, Some(radius), wanted),
            _ => Err(PyTypeError::new_err(format!("no {method} of {} arguments", arguments.len()))),
        }
    };
    let tasks = renderers.iter().zip(&arguments).map(task).collect::<PyResult<Vec<_>>>()?;
    let solvers = renderers.iter().map(|renderer| &renderer.get().solver);
    compute(py, solvers.zip(tasks).collect())
}

/// Whether the images are a function of the effective radius.
fn is_of_droplets(light: &scene::Light) -> bool {
    light.optics.phase == PhaseModel::Mie && light.optics.effective_radius.is_none()
}

impl Renderer {
    fn task(
        &self,
        extinction: &Bound<'_, PyAny>,
        effective_radius: Option<&Bound<'_, PyAny>>,
        wanted: Wanted,
    ) -> PyResult<Task> {
        let light = &self.light.core;
        let values = field::extinction(extinction, "extinction", light)?.on(self.grid.0)?;
        let radii = match (is_of_droplets(light), effective_radius) {
            (true, Some(radii)) => Some(volume(radii, "effective_radius")?.on(self.grid.0)?),
            (true, None) => {
                let droplets = field::cloud(extinction)?.and_then(|cloud| cloud.microphysics);
                let cure = "give it, or the renderer a light with an effective_radius";
                let missing =
                    || PyValueError::new_err(format!("effective_radius is missing: {cure}"));
                Some(droplets.ok_or_else(missing)?.effective_radius)
            }
            (false, Some(_)) => {
                return Err(PyValueError::new_err(
                    "effective_radius is given, but has no effect in the light of this renderer: leave \
                     it out, or give the renderer a light with phase=\"mie\" and without effective_radius",
                ));
            }
            (false, None) => None,
        };
        let placed = |values| Volume::new(self.grid.0, values).map_err(raise);
        Ok(Task {
            extinction: placed(values)?,
            effective_radius: radii.map(placed).transpose()?,
            wanted,
        })
    }

    fn cotangent(&self, cotangent: &Bound<'_, PyAny>) -> PyResult<Wanted> {
        let values = images_in_any_unit(cotangent, "cotangent")?;
        if values.iter().any(|value| !value.is_finite()) {
            let range = "finite; give 0 for pixels that are left out";
            return Err(raise(Error::out_of_range("cotangent", "not finite somewhere", range)));
        }
        let expected: [usize; 3] = self.shape().into();
        if values.shape() != expected {
            return Err(raise(Error::mismatch(
                "shape [view, row, col] of the cotangent",
                format!("{expected:?}"),
                format!("{:?}", values.shape()),
                "give a derivative for each pixel of the images",
            )));
        }
        Ok(Wanted::Vjp(ViewStack { values }))
    }

    fn direction(&self, direction: &Bound<'_, PyAny>) -> PyResult<Wanted> {
        let values = volume(direction, "direction")?.on(self.grid.0)?;
        Ok(Wanted::Jvp(Volume::new(self.grid.0, values).map_err(raise)?))
    }

    fn compute(&self, py: Python<'_>, task: Task) -> PyResult<Vec<Py<PyArray3<f32>>>> {
        Ok(compute(py, vec![(&self.solver, task)])?.remove(0))
    }
}

/// The extinction that is expected.
enum Expected {
    Constant(f32),
    Volume(Array3<f32>),
}

impl Expected {
    fn give(self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        Ok(match self {
            Self::Constant(number) => number.into_pyobject(py)?.into_any().unbind(),
            Self::Volume(values) => give(py, values).into_any(),
        })
    }
}

/// What a renderer is asked for, at an extinction and an effective radius.
struct Task {
    extinction: Volume,
    effective_radius: Option<Volume>,
    wanted: Wanted,
}

enum Wanted {
    Images,
    Vjp(ViewStack),
    Jvp(Volume),
}

/// A model, and the images of the extinction and effective radius for which it is solved.
struct Solver {
    model: OrdinatesModel,
    warm_start: bool,
    /// Whether a warning has been given, which would only be repeated at each step of a method.
    has_warned: bool,
    solved: Option<(Volume, Option<Volume>, Array3<f32>)>,
}

impl Solver {
    fn compute(&mut self, task: &Task, stop: &Stop) -> Result<Vec<Array3<f32>>> {
        self.model.stop_by(stop.clone());
        if !self.warm_start {
            self.model.forget_adjoint();
        }
        let Task { extinction, effective_radius, wanted } = task;
        let images = match self.solved.take() {
            Some((solved, radius, images))
                if solved == *extinction && radius == *effective_radius =>
            {
                images
            }
            _ => {
                if !self.warm_start {
                    self.model.forget();
                }
                match effective_radius {
                    None => self.model.images(extinction),
                    Some(radius) => self.model.images_of_droplets(extinction, radius),
                }?
                .values
            }
        };
        let solved = (extinction.clone(), effective_radius.clone(), images);
        let (.., images) = self.solved.insert(solved);
        Ok(match wanted {
            Wanted::Images => vec![images.clone()],
            Wanted::Vjp(cotangent) => {
                let found = self.model.derivatives(cotangent)?;
                let by_radius = effective_radius.as_ref().map(|_| found.effective_radius.values);
                [found.extinction.values].into_iter().chain(by_radius).collect()
            }
            Wanted::Jvp(direction) => vec![self.model.directional_derivative(direction)?.values],
        })
    }
}

/// Where a solver lies while nobody uses it. It is taken before a computation, because a thread of the
/// pool that waited for it could be the one that has to give it back.
struct Desk {
    solver: Mutex<Option<Solver>>,
    returned: Condvar,
}

impl Desk {
    fn new(solver: Solver) -> Self {
        Self { solver: Mutex::new(Some(solver)), returned: Condvar::new() }
    }

    /// The solver, after all who have taken it have given it back.
    fn take(self: &Arc<Self>, py: Python<'_>) -> PyResult<Taken> {
        loop {
            let found = py.detach(|| {
                let solver = self.solver.lock().unwrap_or_else(PoisonError::into_inner);
                let is_away = |solver: &mut Option<Solver>| solver.is_none();
                let waited = self.returned.wait_timeout_while(solver, CHECKED, is_away);
                waited.unwrap_or_else(PoisonError::into_inner).0.take()
            });
            if let Some(solver) = found {
                return Ok(Taken { desk: self.clone(), solver: Some(solver) });
            }
            py.check_signals()?;
        }
    }
}

/// A solver that returns to its desk when it is dropped.
struct Taken {
    desk: Arc<Desk>,
    solver: Option<Solver>,
}

impl Taken {
    fn get(&mut self) -> &mut Solver {
        self.solver.as_mut().expect("present until it is dropped")
    }
}

impl Drop for Taken {
    fn drop(&mut self) {
        let mut solver = self.desk.solver.lock().unwrap_or_else(PoisonError::into_inner);
        *solver = self.solver.take();
        self.desk.returned.notify_one();
    }
}

/// Computes tasks of different solvers at the same time.
fn compute(
    py: Python<'_>,
    tasks: Vec<(&Arc<Desk>, Task)>,
) -> PyResult<Vec<Vec<Py<PyArray3<f32>>>>> {
    // All take the solvers in the same order, so that no two wait for each other.
    let mut order: Vec<usize> = (0..tasks.len()).collect();
    order.sort_by_key(|number| Arc::as_ptr(tasks[*number].0));
    if order.windows(2).any(|pair| Arc::ptr_eq(tasks[pair[0]].0, tasks[pair[1]].0)) {
        let cure = "give each scene its own, for example copy.copy(renderer)";
        return Err(PyValueError::new_err(format!("a renderer occurs twice: {cure}")));
    }
    let mut taken: Vec<Option<Taken>> = tasks.iter().map(|_| None).collect();
    for number in order {
        taken[number] = Some(tasks[number].0.take(py)?);
    }
    let tasks: Vec<_> =
        taken.into_iter().flatten().zip(tasks).map(|(t, (_, task))| (t, task)).collect();
    let results = at_length(py, &Progress::None, move |watch| {
        let computed = |(mut solver, task): (Taken, Task)| {
            let solver = solver.get();
            let values = solver.compute(&task, &watch.stop)?;
            let warnings = if solver.has_warned { Vec::new() } else { solver.model.warnings() };
            solver.has_warned |= !warnings.is_empty();
            Ok((values, warnings))
        };
        tasks.into_par_iter().map(computed).collect::<Result<Vec<_>>>()
    })?;
    let mut arrays = Vec::new();
    for (values, warnings) in results {
        for text in warnings {
            warn(py, &text)?;
        }
        arrays.push(values.into_iter().map(|values| give(py, values)).collect());
    }
    Ok(arrays)
}
