//! `render`: from an extinction field to its images.

use crate::array::{Floats, VOLUME, give};
use crate::error::raise;
use crate::grid::Grid;
use crate::view::{Sun, ViewSequence};
use deepct_core::grid::Volume;
use deepct_core::optics::{Interpolation, Medium, PhaseFunction};
use deepct_core::scene::{self, Boundary, Scene, Surface};
use deepct_core::transport::{self, MonteCarloSettings, Solver};
use numpy::PyArray3;
use pyo3::prelude::*;

/// Images of a scene.
///
/// Attributes
/// ----------
/// radiance : numpy.ndarray, float32, [view, row, col]
///     Radiance (1/sr for a Sun of unit irradiance), the mean over each pixel's area.
/// standard_error : numpy.ndarray, float32, [view, row, col]
///     Standard error of each pixel (1/sr).
#[pyclass(frozen, module = "deepct_py", get_all)]
pub(crate) struct Rendering {
    radiance: Py<PyArray3<f32>>,
    standard_error: Py<PyArray3<f32>>,
}

/// Render the images of an extinction field.
///
/// Backward Monte Carlo: paths start in a pixel, scatter by chance, and look at the Sun
/// from each scattering. The same seed gives the same images, whatever the number of
/// threads.
///
/// Parameters
/// ----------
/// extinction : array, [z, y, x]
///     Extinction (1/km).
/// grid : Grid
///     Where the voxels are.
/// views : Views or sequence of View
///     The cameras, all of one image size.
/// sun : Sun, optional
///     Zenith 30 and azimuth 45 degrees where it is not given.
/// samples_per_pixel : int
///     Light paths of each pixel.
/// seed : int
///     Seed of the random numbers.
/// asymmetry : float
///     Asymmetry parameter of the Henyey-Greenstein phase function, in (-1, 1).
/// single_scattering_albedo : float
///     Probability that an interaction scatters and does not absorb.
/// surface_albedo : float
///     Share of the flux that the Lambertian surface at altitude 0 reflects.
/// trilinear : bool
///     Extinction is trilinear between voxel centres, not constant in each voxel.
/// periodic : bool
///     The field is repeated without end beyond its sides, where otherwise is clear air.
/// similarity_after : int, optional
///     After this many scatterings a path goes on in a similar medium without a forward
///     peak: faster and less noisy, but biased.
///
/// Returns
/// -------
/// Rendering
///
/// Raises
/// ------
/// ValueError
///     A shape that is not the grid's, a negative or non-finite extinction, a number out
///     of range.
#[pyfunction]
#[pyo3(signature = (
    extinction, grid, views, sun = None, *, samples_per_pixel = 256, seed = 1,
    asymmetry = 0.86, single_scattering_albedo = 1.0, surface_albedo = 0.05,
    trilinear = false, periodic = false, similarity_after = None,
))]
// Keywords with defaults on the side that users see.
#[allow(clippy::too_many_arguments)]
pub(crate) fn render(
    py: Python<'_>,
    extinction: &Bound<'_, PyAny>,
    grid: Grid,
    views: ViewSequence,
    sun: Option<Sun>,
    samples_per_pixel: u32,
    seed: u64,
    asymmetry: f64,
    single_scattering_albedo: f64,
    surface_albedo: f64,
    trilinear: bool,
    periodic: bool,
    similarity_after: Option<u32>,
) -> PyResult<Rendering> {
    let extinction = Floats::new(extinction, "extinction", VOLUME)?.to_owned();
    let solver = Solver::MonteCarlo(MonteCarloSettings {
        samples_per_pixel,
        seed,
        similarity_after,
        noise: None,
    });
    let surface = Surface { albedo: surface_albedo, ..Surface::OCEAN };
    let interpolation = if trilinear { Interpolation::Trilinear } else { Interpolation::Constant };
    let boundary = if periodic { Boundary::Periodic } else { Boundary::Open };
    let rendering = py
        .detach(|| {
            let phase_function = PhaseFunction::henyey_greenstein(asymmetry)?;
            let medium = Medium::new(
                Volume::new(grid.0, extinction)?,
                single_scattering_albedo,
                phase_function,
            )?
            .with_interpolation(interpolation);
            let sun = sun.map_or_else(scene::Sun::default, |sun| sun.0);
            let scene = Scene::new(medium, sun, surface)?.with_boundary(boundary);
            transport::render(&scene, &views.0, &solver, &())
        })
        .map_err(raise)?;
    Ok(Rendering {
        radiance: give(py, rendering.images.values),
        standard_error: give(py, rendering.standard_error.values),
    })
}
