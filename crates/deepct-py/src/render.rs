//! `render`: from an extinction field to its images.

use crate::array::{Floats, VOLUME, give};
use crate::error::raise;
use crate::grid::Grid;
use crate::light::{Light, or_default};
use crate::view::ViewSequence;
use deepct_core::Error;
use deepct_core::cloud::Cloud;
use deepct_core::grid::Volume;
use deepct_core::optics::Interpolation;
use deepct_core::scene::PhaseModel;
use deepct_core::transport::{self, MonteCarloSettings, OrdinatesSettings, Solver};
use numpy::PyArray3;
use pyo3::prelude::*;

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
///     Photon paths of each pixel; 0 by a solver that follows none.
/// light : Light
///     The light that they were made in, with the mean effective radius of the droplets.
#[pyclass(frozen, module = "deepct_py", get_all)]
pub(crate) struct Rendering {
    radiance: Py<PyArray3<f32>>,
    standard_error: Option<Py<PyArray3<f32>>>,
    samples_per_pixel: u32,
    light: Light,
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
/// light : Light, optional
///     Sun, wavelength, droplet optics, atmosphere and surface.
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
/// effective_radius : array, [z, y, x], optional
///     Effective radius of the droplets of each voxel (um), for a light whose phase function is
///     "mie", in place of its `effective_radius`. Extinction stays as it is given.
/// trilinear : bool
///     Extinction is trilinear between voxel centres, not constant in each voxel.
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
    extinction, grid, views, light = None, *, solver = "monte-carlo", samples_per_pixel = None,
    noise = None, seed = 1, effective_radius = None, trilinear = false, similarity_after = None,
))]
// Keywords with defaults on the side that users see.
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
) -> PyResult<Rendering> {
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
    let (rendering, light) = py
        .detach(|| {
            let extinction = Volume::new(grid.0, extinction)?;
            let cloud = match radii {
                Some(radii) => Cloud::from_extinction_and_radii(extinction, radii)?,
                None => Cloud::from_extinction(extinction)?,
            };
            let mut scene = light.scene(&cloud)?;
            scene.medium.interpolation = interpolation;
            Ok((transport::render(&scene, &views.0, &solver, &())?, light.recorded(&cloud)))
        })
        .map_err(raise)?;
    Ok(Rendering {
        radiance: give(py, rendering.images.values),
        standard_error: rendering.standard_error.map(|stack| give(py, stack.values)),
        samples_per_pixel: rendering.samples_per_pixel,
        light: Light(light),
    })
}
