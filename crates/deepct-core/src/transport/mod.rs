//! Radiative transfer: from a scene to its images.
//!
//! [`render`] makes the images of a scene, [`radiances`] answers for single rays, and
//! [`fluxes`] counts where the light that enters through the top leaves. Which method
//! does the work is a [`Solver`].
//!
//! The equation solved is that of unpolarised, monochromatic light in a medium that
//! scatters and absorbs but does not emit, lit by the Sun, above a surface and in air where there is some.

mod air_column;
mod field;
mod guide;
mod monte_carlo;
mod ordinates;
mod path;
mod peak;
mod photons;

pub use monte_carlo::{MonteCarloSettings, Radiance};
pub use ordinates::{OrdinatesModel, OrdinatesSettings};
pub use photons::{FluxSettings, Fluxes, Share, fluxes};

use crate::error::{Error, Result};
use crate::image::ViewStack;
use crate::math::Ray;
use crate::optics::Interpolation;
use crate::scene::{Scene, View};

/// How the radiative-transfer equation is solved.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Solver {
    /// Random photon paths from the camera to the Sun: exact up to noise, which the
    /// answer tells.
    MonteCarlo(MonteCarloSettings),
    /// Discrete directions and finite elements: without noise, in seconds, and bright pixels about
    /// 1 % off.
    Ordinates(OrdinatesSettings),
}

impl Default for Solver {
    fn default() -> Self {
        Self::MonteCarlo(MonteCarloSettings::default())
    }
}

/// The images of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Rendering {
    /// Radiance (1/sr for a Sun of unit irradiance), the mean over each pixel's area.
    pub images: ViewStack,
    /// Standard error of each pixel, in the same unit; none by a solver without noise.
    pub standard_error: Option<ViewStack>,
    /// Number of photon paths of each pixel; 0 by a solver that follows none.
    pub samples_per_pixel: u32,
    /// Whether the watch stopped the work before it was done.
    pub interrupted: bool,
    /// Whether the deterministic solver came to its tolerance; true by one without an iteration.
    pub converged: bool,
}

/// How far a rendering is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Progress {
    /// Share of the work that is done, in `[0, 1]`; a guess where a noise is the target.
    pub share: f64,
    /// Number of photon paths of each pixel so far; 0 by a solver that follows none.
    pub samples_per_pixel: u32,
    /// Standard error over radiance, the root mean square over all bright pixels: those
    /// with at least half the radiance of the brightest one of their view; 0 where there is none.
    pub noise: f64,
}

/// Whoever waits for a rendering; `()` does so without a word.
pub trait Watch: Sync {
    /// Called now and then.
    fn reached(&self, _progress: &Progress) {}

    /// Whether to stop and give what is there. Asked often, from any thread.
    fn interrupted(&self) -> bool {
        false
    }
}

impl Watch for () {}

/// The images of `scene` by `views`; `watch` learns how far they are, and may stop them.
///
/// The result of photon paths does not depend on the number of threads.
///
/// # Errors
/// No view, views of different sizes, a setting out of range, or a trilinear medium
/// with a single layer.
pub fn render(
    scene: &Scene,
    views: &[View],
    solver: &Solver,
    watch: &dyn Watch,
) -> Result<Rendering> {
    check_scene(scene)?;
    check_sizes(views)?;
    match solver {
        Solver::MonteCarlo(settings) => monte_carlo::render(scene, views, settings, watch),
        Solver::Ordinates(settings) => {
            let mut model = OrdinatesModel::new(scene, views, None, settings)?;
            Ok(Rendering {
                images: model.watched(&scene.medium.extinction, watch)?,
                standard_error: None,
                samples_per_pixel: 0,
                interrupted: watch.interrupted() && !model.converged(),
                converged: model.converged(),
            })
        }
    }
}

/// The radiance that arrives at the origin of each ray from the direction the ray
/// goes to. Unlike the rays of a view these may start anywhere and look upwards; the
/// Sun's disc itself is never seen.
///
/// `samples_per_pixel` of the settings is the number of samples of each ray.
///
/// # Errors
/// A setting out of range, or a trilinear medium with a single layer.
pub fn radiances(
    scene: &Scene,
    rays: &[Ray],
    settings: &MonteCarloSettings,
) -> Result<Vec<Radiance>> {
    check_scene(scene)?;
    monte_carlo::radiances(scene, rays, settings)
}

fn check_scene(scene: &Scene) -> Result<()> {
    let shape = scene.medium.extinction.grid.shape;
    if scene.medium.interpolation == Interpolation::Trilinear && shape.contains(&1) {
        return Err(Error::out_of_range(
            "shape [z, y, x] of a trilinear medium",
            format!("{shape:?}"),
            "at least 2 along every axis, as the medium lies between voxel centres",
        ));
    }
    Ok(())
}

fn check_sizes(views: &[View]) -> Result<()> {
    let Some(first) = views.first() else {
        return Err(Error::out_of_range("number of views", 0, "at least 1"));
    };
    match views.iter().position(|view| (view.rows, view.cols) != (first.rows, first.cols)) {
        None => Ok(()),
        Some(number) => Err(Error::mismatch(
            format!("image size [row, col] of view {number}"),
            format!("[{}, {}], the size of view 0,", first.rows, first.cols),
            format!("[{}, {}]", views[number].rows, views[number].cols),
            "give all views of a stack one size, or render them one by one",
        )),
    }
}
