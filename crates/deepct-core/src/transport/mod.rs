//! Radiative transfer: images, radiances and fluxes of a scene.
//!
//! [`render`] renders the images of a scene by the method that a [`Solver`] selects, [`radiances`]
//! computes the radiance along single rays, and [`fluxes`] computes the fluxes of the sunlight that
//! enters through the top of the grid.
//!
//! The radiative-transfer equation is solved for unpolarised, monochromatic light in a medium that
//! scatters and absorbs but does not emit. The Sun is the only source; the scene may include a
//! reflecting surface and a molecular atmosphere.

mod air_column;
mod field;
mod guide;
mod monte_carlo;
mod ordinates;
mod path;
mod peak;
mod photons;

pub use monte_carlo::{MonteCarloSettings, Radiance};
pub use ordinates::{Derivatives, OrdinatesModel, OrdinatesSettings};
pub use photons::{FluxSettings, Fluxes, Share, fluxes};

use crate::error::{Error, Result};
use crate::image::ViewStack;
use crate::math::Ray;
use crate::memory;
use crate::optics::Interpolation;
use crate::scene::{Scene, View};

/// Method by which the radiative-transfer equation is solved.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Solver {
    /// Monte Carlo: backward photon paths from the camera to the Sun, exact up to noise, whose
    /// standard error is reported.
    MonteCarlo(MonteCarloSettings),
    /// Discrete ordinates with finite elements: free of noise, with run times of seconds and an
    /// error of about 1 % in bright pixels.
    Ordinates(OrdinatesSettings),
}

impl Default for Solver {
    fn default() -> Self {
        Self::MonteCarlo(MonteCarloSettings::default())
    }
}

/// Rendered images of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Rendering {
    /// Radiance (1/sr for a Sun of unit irradiance), averaged over the area of each pixel.
    pub images: ViewStack,
    /// Standard error of each pixel, in the same unit; `None` for a solver without noise.
    pub standard_error: Option<ViewStack>,
    /// Number of photon paths per pixel; 0 for a solver that traces none.
    pub samples_per_pixel: u32,
    /// Whether the progress callback stopped the Monte Carlo solver before it was complete.
    pub interrupted: bool,
    /// Whether the discrete-ordinates solver reached its tolerance; always `true` for the Monte
    /// Carlo solver, which does not iterate.
    pub converged: bool,
    /// Estimated relative error of the discrete-ordinates solver in bright pixels (root mean square
    /// over the pixels with at least half the radiance of the brightest pixel of their view), if
    /// [`OrdinatesSettings::estimate_error`] requests it.
    pub estimated_error: Option<f64>,
    /// [`OrdinatesModel::thickest_cell`] of the discrete-ordinates solver; 0 for the Monte Carlo
    /// solver, which has no cells.
    pub thickest_cell: f64,
    /// [`Progress::noise`] of the images by the Monte Carlo solver.
    pub noise: Option<f64>,
}

/// Largest optical depth of a voxel for which images are computed. Photon paths in a thicker one
/// hardly end.
const THICKEST_VOXEL: f64 = 1e5;

/// Largest delta-M scaled optical depth of a cell with which images are usable. The radiance of a
/// layer is 1 % too low with 0.8, 3 % with 1.7, 4 % with 3.4 and 60 % with 425
/// (`docs/notes/deterministic_solver.md`, "Thick layers"). Cells of 2 are a setting.
const THICK_CELL: f64 = 2.5;

impl Rendering {
    /// Reasons why images by the discrete-ordinates solver may be wrong, as sentences.
    pub fn warnings(&self) -> Vec<String> {
        warnings(self.converged || self.interrupted, self.thickest_cell)
    }
}

/// Reasons why images by the discrete-ordinates solver may be wrong, given whether it reached its
/// tolerance and the largest delta-M scaled optical depth of a cell.
fn warnings(converged: bool, thickest_cell: f64) -> Vec<String> {
    let mut warnings = Vec::new();
    if !converged {
        warnings.push(
            "the discrete-ordinates solver has not converged to its tolerance; the cloud is very \
             thick, or the domain is small and periodic: use the Monte Carlo solver"
                .to_owned(),
        );
    }
    if thickest_cell > THICK_CELL {
        warnings.push(format!(
            "voxels are too thick for the discrete-ordinates solver, which splits them into cells \
             of an optical depth of up to {thickest_cell:.1}: thick parts of the cloud are several \
             percent too dark; use smaller voxels, a better accuracy, or the Monte Carlo solver"
        ));
    }
    warnings
}

/// Progress of a rendering.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Progress {
    /// Completed share of the work, in `[0, 1]`; an estimate if a noise is the target.
    pub share: f64,
    /// Number of photon paths per pixel so far; 0 for a solver that traces none.
    pub samples_per_pixel: u32,
    /// Relative standard error: root mean square of standard error over radiance for all bright
    /// pixels, those with at least half the radiance of the brightest pixel of their view. 0 if
    /// there are none.
    pub noise: f64,
}

/// Progress callback; `()` ignores all events.
pub trait Watch: Sync {
    /// Called from time to time with the progress.
    fn reached(&self, _progress: &Progress) {}

    /// Whether to stop and return the result so far. Called often, from any thread.
    fn interrupted(&self) -> bool {
        false
    }
}

impl Watch for () {}

/// A callback that may stop the computation, without the progress.
struct Silent<'a>(&'a dyn Watch);

impl Watch for Silent<'_> {
    fn interrupted(&self) -> bool {
        self.0.interrupted()
    }
}

/// Render the images of `scene` for `views`. `watch` receives the progress and may stop the
/// computation.
///
/// The result of the Monte Carlo solver does not depend on the number of threads.
///
/// # Errors
/// Fails if there is no view, if the views differ in size, if a setting is out of range, or if a
/// trilinear medium has only one voxel along an axis.
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
            let images = model.watched(&scene.medium.extinction, watch)?;
            let coarser = settings.coarser().filter(|_| settings.estimate_error);
            let estimated_error = match coarser {
                Some(coarser) => {
                    let mut model = OrdinatesModel::new(scene, views, None, &coarser)?;
                    let coarse = model.watched(&scene.medium.extinction, &Silent(watch))?;
                    Some(ERROR_SHARE * bright_difference(&images, &coarse))
                }
                None => None,
            };
            Ok(Rendering {
                images,
                standard_error: None,
                samples_per_pixel: 0,
                interrupted: false,
                converged: model.converged(),
                estimated_error,
                thickest_cell: model.thickest_cell(),
                noise: None,
            })
        }
    }
}

/// Pixels with at least this share of the radiance of the brightest pixel of their view are bright.
pub(crate) const BRIGHT: f64 = 0.5;
/// Ratio of the error of the images to their difference from those of a coarser solution.
const ERROR_SHARE: f64 = 0.2;

/// Relative difference of two stacks of images: root mean square over the bright pixels of the
/// first one.
fn bright_difference(images: &ViewStack, others: &ViewStack) -> f64 {
    let (mut squares, mut count) = (0.0, 0.0);
    for (image, other) in images.values.outer_iter().zip(others.values.outer_iter()) {
        let brightest = image.iter().copied().fold(0.0, f32::max);
        for (value, other) in image.iter().zip(other) {
            if *value > 0.0 && f64::from(*value) >= BRIGHT * f64::from(brightest) {
                squares += f64::from(other / value - 1.0).powi(2);
                count += 1.0;
            }
        }
    }
    if count > 0.0 { f64::sqrt(squares / count) } else { 0.0 }
}

/// Radiance that arrives at the origin of each ray from the direction in which the ray points.
/// Unlike the rays of a view, these rays may start anywhere and point upwards; the solar disc
/// itself is never included.
///
/// `samples_per_pixel` of the settings is the number of samples per ray.
///
/// # Errors
/// Fails if a setting is out of range, or if a trilinear medium has only one voxel along an axis.
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
    let extinction = &scene.medium.extinction;
    let most = extinction.values.iter().copied().fold(0.0, f32::max);
    let depth = f64::from(most) * extinction.grid.spacing.max_element();
    if depth > THICKEST_VOXEL {
        let range = format!("at most {THICKEST_VOXEL:e}: check the units of the extinction");
        return Err(Error::out_of_range("optical depth of a voxel", format!("{depth:.1e}"), range));
    }
    Ok(())
}

fn check_sizes(views: &[View]) -> Result<()> {
    let Some(first) = views.first() else {
        return Err(Error::out_of_range("number of views", 0, "at least 1"));
    };
    match views.iter().position(|view| (view.rows, view.cols) != (first.rows, first.cols)) {
        None => {
            let pixels = views.len() as f64 * first.rows as f64 * first.cols as f64;
            memory::check("memory for the images", pixels, 32.0)
        }
        Some(number) => Err(Error::mismatch(
            format!("image size [row, col] of view {number}"),
            format!("[{}, {}], the size of view 0,", first.rows, first.cols),
            format!("[{}, {}]", views[number].rows, views[number].cols),
            "give all views of a stack the same size, or render them separately",
        )),
    }
}
