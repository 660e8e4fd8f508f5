//! `render`: from an extinction field to its images.

use crate::array::{Floats, VOLUME, give};
use crate::error::raise;
use crate::grid::Grid;
use crate::view::{Sun, ViewSequence};
use deepct_core::grid::Volume;
use deepct_core::optics::air::Air;
use deepct_core::optics::{DropletSettings, DropletTable, Interpolation, Medium, PhaseFunction};
use deepct_core::scene::{self, Boundary, Scene, Surface, Waves};
use deepct_core::transport::{self, MonteCarloSettings, OrdinatesSettings, Solver};
use deepct_core::{Error, Result};
use numpy::PyArray3;
use numpy::ndarray::Array3;
use pyo3::prelude::*;
use std::sync::Arc;

/// Light paths of each pixel where neither their number nor the noise is given.
const SAMPLES: u32 = 256;
/// The most of them where the noise is given.
const MOST_SAMPLES: u32 = 1 << 24;

/// Images of a scene.
///
/// Attributes
/// ----------
/// radiance : numpy.ndarray, float32, [view, row, col]
///     Radiance (1/sr for a Sun of unit irradiance), the mean over each pixel's area.
/// standard_error : numpy.ndarray, float32, [view, row, col], or None
///     Standard error of each pixel (1/sr); None by a solver without noise.
/// samples_per_pixel : int
///     Light paths of each pixel; 0 by a solver that follows none.
#[pyclass(frozen, module = "deepct_py", get_all)]
pub(crate) struct Rendering {
    radiance: Py<PyArray3<f32>>,
    standard_error: Option<Py<PyArray3<f32>>>,
    samples_per_pixel: u32,
}

/// What scatters: Henyey and Greenstein's function, or droplets.
enum Phase {
    HenyeyGreenstein { asymmetry: f64, single_scattering_albedo: f64 },
    Droplets { effective_radius: Array3<f32>, settings: DropletSettings },
}

impl Phase {
    /// The medium of the given extinction.
    fn medium(self, extinction: Volume) -> Result<Medium> {
        match self {
            Self::HenyeyGreenstein { asymmetry, single_scattering_albedo } => {
                let phase_function = PhaseFunction::henyey_greenstein(asymmetry)?;
                Medium::new(extinction, single_scattering_albedo, phase_function)
            }
            Self::Droplets { effective_radius, settings } => Medium::of_droplets(
                extinction,
                effective_radius,
                Arc::new(DropletTable::of(&settings)?),
            ),
        }
    }
}

/// Render the images of an extinction field.
///
/// Backward Monte Carlo: paths start in a pixel, scatter by chance, and look at the Sun
/// from each scattering. The same seed gives the same images, whatever the number of
/// threads. Or discrete ordinates: without noise, in seconds, bright pixels about 1 % off.
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
/// solver : str
///     "monte-carlo" or "ordinates"; `samples_per_pixel`, `noise`, `seed` and
///     `similarity_after` are for the former.
/// samples_per_pixel : int, optional
///     Light paths of each pixel, the most of them where `noise` is given. 256, or as many
///     as `noise` wants, where it is not given.
/// noise : float, optional
///     Go on until the standard error of the bright pixels is this share of their radiance,
///     such as 0.01: the root mean square over all pixels that are at least half as bright
///     as the brightest one of their view.
/// seed : int
///     Seed of the random numbers.
/// asymmetry : float
///     Asymmetry parameter of the Henyey-Greenstein phase function, in (-1, 1).
/// single_scattering_albedo : float
///     Probability that an interaction scatters and does not absorb.
/// effective_radius : float or array, [z, y, x], optional
///     Effective radius of the droplets (um), 1 to 25: they scatter by Mie's theory at the
///     `wavelength`, in place of `asymmetry` and `single_scattering_albedo`. Extinction
///     stays as it is given.
/// effective_variance : float
///     Effective variance of the droplets' sizes, a gamma distribution.
/// wavelength : float
///     Wavelength (um), for droplets and air.
/// surface_albedo : float
///     Share of the flux that the Lambertian surface at altitude 0 reflects.
/// wind_speed : float, optional
///     Wind over the sea (m/s), whose waves mirror the light besides.
/// air : bool
///     Add the air of the standard atmosphere.
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
    extinction, grid, views, sun = None, *, solver = "monte-carlo", samples_per_pixel = None,
    noise = None, seed = 1, asymmetry = 0.86, single_scattering_albedo = 1.0, effective_radius = None,
    effective_variance = 0.1, wavelength = 0.672, surface_albedo = 0.05, wind_speed = None,
    air = false, trilinear = false, periodic = false, similarity_after = None,
))]
// Keywords with defaults on the side that users see.
#[allow(clippy::too_many_arguments)]
pub(crate) fn render(
    py: Python<'_>,
    extinction: &Bound<'_, PyAny>,
    grid: Grid,
    views: ViewSequence,
    sun: Option<Sun>,
    solver: &str,
    samples_per_pixel: Option<u32>,
    noise: Option<f64>,
    seed: u64,
    asymmetry: f64,
    single_scattering_albedo: f64,
    effective_radius: Option<&Bound<'_, PyAny>>,
    effective_variance: f64,
    wavelength: f64,
    surface_albedo: f64,
    wind_speed: Option<f64>,
    air: bool,
    trilinear: bool,
    periodic: bool,
    similarity_after: Option<u32>,
) -> PyResult<Rendering> {
    let extinction = Floats::new(extinction, "extinction", VOLUME)?.to_owned();
    let phase = match effective_radius {
        None => Phase::HenyeyGreenstein { asymmetry, single_scattering_albedo },
        Some(radius) => Phase::Droplets {
            effective_radius: match radius.extract::<f32>() {
                Ok(radius) => Array3::from_elem(extinction.raw_dim(), radius),
                Err(_) => Floats::new(radius, "effective_radius", VOLUME)?.to_owned(),
            },
            settings: DropletSettings { effective_variance, ..DropletSettings::water(wavelength) },
        },
    };
    let most = if noise.is_some() { MOST_SAMPLES } else { SAMPLES };
    let samples_per_pixel = samples_per_pixel.unwrap_or(most);
    let solver = match solver {
        "monte-carlo" => Solver::MonteCarlo(MonteCarloSettings {
            samples_per_pixel,
            noise,
            seed,
            similarity_after,
        }),
        "ordinates" => Solver::Ordinates(OrdinatesSettings::default()),
        _ => {
            let known = "\"monte-carlo\" or \"ordinates\"";
            return Err(raise(Error::out_of_range("solver", format!("\"{solver}\""), known)));
        }
    };
    let interpolation = if trilinear { Interpolation::Trilinear } else { Interpolation::Constant };
    let boundary = if periodic { Boundary::Periodic } else { Boundary::Open };
    let rendering = py
        .detach(|| {
            let medium = phase.medium(Volume::new(grid.0, extinction)?)?;
            let sun = sun.map_or_else(scene::Sun::default, |sun| sun.0);
            let waves = wind_speed.map(Waves::new).transpose()?;
            let surface = Surface { waves, ..Surface::lambertian(surface_albedo) };
            let air = if air { Some(Air::new(wavelength)?) } else { None };
            let scene = Scene::new(medium.with_interpolation(interpolation), sun, surface)?;
            let scene = Scene { air, boundary, ..scene };
            transport::render(&scene, &views.0, &solver, &())
        })
        .map_err(raise)?;
    Ok(Rendering {
        radiance: give(py, rendering.images.values),
        standard_error: rendering.standard_error.map(|stack| give(py, stack.values)),
        samples_per_pixel: rendering.samples_per_pixel,
    })
}
