//! `render`: simulation of the images of an extinction field.

use crate::array::{Floats, VOLUME, check_on_grid, give};
use crate::compute::{Stopped, compute};
use crate::error::raise;
use crate::grid::Grid;
use crate::light::{Light, or_default, warn_of_neglected};
use crate::view::ViewSequence;
use deepct_core::Error;
use deepct_core::cloud::Cloud;
use deepct_core::grid::Volume;
use deepct_core::optics::Interpolation;
use deepct_core::scene::{Boundary, PhaseModel};
use deepct_core::transport::{self, MonteCarloSettings, OrdinatesSettings, Solver};
use numpy::PyArray3;
use numpy::ndarray::{Array3, Axis};
use pyo3::exceptions::{PyUserWarning, PyValueError};
use pyo3::prelude::*;
use std::ffi::CString;

/// Photon paths per pixel if neither their number nor the noise is given.
const SAMPLES: u32 = 256;
/// Maximum number of photon paths per pixel if the noise is given.
const MOST_SAMPLES: u32 = 1 << 24;

/// Simulated images of a scene.
///
/// Attributes
/// ----------
/// radiance : numpy.ndarray, float32, [view, row, col]
///     Radiance (1/sr for a solar irradiance of 1), averaged over the area of each pixel.
/// standard_error : numpy.ndarray, float32, [view, row, col], or None
///     Standard error of each pixel (1/sr); None for the discrete-ordinates solver.
/// samples_per_pixel : int
///     Number of photon paths per pixel; 0 for the discrete-ordinates solver.
/// light : Light
///     Scene illumination of the images, with the mean effective radius of the droplets.
/// estimated_error : float or None
///     Estimated relative error of the bright pixels by the deterministic solver.
#[pyclass(frozen, module = "deepct_py", get_all)]
pub(crate) struct Rendering {
    radiance: Py<PyArray3<f32>>,
    standard_error: Option<Py<PyArray3<f32>>>,
    samples_per_pixel: u32,
    light: Light,
    estimated_error: Option<f64>,
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
/// extinction : array, [z, y, x]
///     Extinction (1/km).
/// grid : Grid
///     The grid of the extinction.
/// views : Views or sequence of View
///     The cameras, all with the same image size.
/// light : Light, optional
///     Scene illumination: Sun, wavelength, droplet optics, molecular atmosphere and surface.
///     Default: `Light()`.
/// solver : str
///     "monte-carlo" or "ordinates". The parameters `samples_per_pixel`, `noise`, `seed` and
///     `similarity_after` are for "monte-carlo", `accuracy` and `estimate_error` for "ordinates".
/// samples_per_pixel : int, optional
///     Number of photon paths per pixel; if `noise` is given, the maximum number. Default: 256,
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
#[pyfunction]
#[pyo3(signature = (
    extinction, grid, views, light = None, *, solver = "monte-carlo", samples_per_pixel = None,
    noise = None, seed = 1, effective_radius = None, trilinear = false, similarity_after = None,
    accuracy = None, estimate_error = true,
))]
// In Python these are keyword arguments with defaults.
#[allow(clippy::too_many_arguments)]
pub(crate) fn render(
    py: Python<'_>,
    extinction: &Bound<'_, PyAny>,
    grid: Grid,
    views: ViewSequence,
    light: Option<Light>,
    solver: &str,
    samples_per_pixel: Option<u32>,
    noise: Option<f64>,
    seed: u64,
    effective_radius: Option<&Bound<'_, PyAny>>,
    trilinear: bool,
    similarity_after: Option<u32>,
    accuracy: Option<f64>,
    estimate_error: bool,
) -> PyResult<Rendering> {
    let volumes = [(Some(extinction), "extinction"), (effective_radius, "effective_radius")];
    check_on_grid(&grid.0, &volumes)?;
    let extinction = Floats::new(extinction, "extinction", VOLUME)?.to_owned();
    let radii = effective_radius
        .map(|radii| Ok::<_, PyErr>(Floats::new(radii, "effective_radius", VOLUME)?.to_owned()))
        .transpose()?;
    let light = or_default(light);
    if radii.is_some() && light.optics.phase != PhaseModel::Mie {
        let range = "\"mie\" where effective_radius is an array";
        return Err(raise(Error::out_of_range("phase of the light", "another", range)));
    }
    let most = if noise.is_some() { MOST_SAMPLES } else { SAMPLES };
    let samples_per_pixel = samples_per_pixel.unwrap_or(most);
    let unused = match solver {
        "ordinates" => {
            noise.map(|_| ("noise", "omitted for the solver \"ordinates\": give accuracy"))
        }
        _ => accuracy.map(|_| ("accuracy", "omitted for the solver \"monte-carlo\": give noise")),
    };
    if let Some((name, range)) = unused {
        return Err(raise(Error::out_of_range(name, "given", range)));
    }
    let solver = match solver {
        "monte-carlo" => Solver::MonteCarlo(MonteCarloSettings {
            samples_per_pixel,
            noise,
            seed,
            similarity_after,
        }),
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
    let interpolation = if trilinear { Interpolation::Trilinear } else { Interpolation::Constant };
    if trilinear {
        check_edges(&extinction, light.boundary)?;
    }
    let (rendering, light) = compute(py, move |stop| {
        let extinction = Volume::new(grid.0, extinction)?;
        let cloud = match radii {
            Some(radii) => Cloud::from_extinction_and_radii(extinction, radii)?,
            None => Cloud::from_extinction(extinction)?,
        };
        let mut scene = light.scene(&cloud)?;
        scene.medium.interpolation = interpolation;
        Ok((transport::render(&scene, &views.0, &solver, &Stopped(stop))?, light.recorded(&cloud)))
    })?;
    for warning in rendering.warnings() {
        let text = CString::new(warning).expect("no zero byte");
        PyErr::warn(py, &py.get_type::<PyUserWarning>(), &text, 1)?;
    }
    Ok(Rendering {
        radiance: give(py, rendering.images.values),
        standard_error: rendering.standard_error.map(|stack| give(py, stack.values)),
        samples_per_pixel: rendering.samples_per_pixel,
        light: Light(light),
        estimated_error: rendering.estimated_error,
    })
}

/// Refuse a trilinear medium whose outermost voxels are not clear: it ends at their centres, so that
/// half of them would be lost.
fn check_edges(extinction: &Array3<f32>, boundary: Boundary) -> PyResult<()> {
    let axes: &[usize] = if boundary == Boundary::Periodic { &[0] } else { &[0, 1, 2] };
    let outermost = axes.iter().flat_map(|&axis| {
        let axis = Axis(axis);
        [0, extinction.len_of(axis) - 1].map(|index| extinction.index_axis(axis, index))
    });
    if outermost.flatten().all(|value| *value == 0.0) {
        return Ok(());
    }
    let problem = "extinction is not zero in the outermost voxels, but a trilinear medium ends at their \
                   centres: surround it by clear voxels";
    Err(PyValueError::new_err(problem))
}
