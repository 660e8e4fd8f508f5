//! The hybrid method: an inversion that starts from the estimate of the network.

use super::{InversionSettings, Models, Problem, Reconstruction, Watch, invert};
use crate::error::Result;
use crate::grid::Grid;
use crate::network::Estimator;
use crate::scene::Observation;

/// Number of iterations of the quick hybrid.
pub const QUICK_ITERATIONS: usize = 12;

/// The grid of the network's estimate for the images of an observation, if no other is requested.
///
/// # Errors
/// Views without a common target point.
pub fn network_grid(network: &Estimator, observation: &Observation) -> Result<Grid> {
    let [_, rows, cols] = observation.images.shape();
    network.grid(&observation.imaging_geometry()?, [rows, cols])
}

/// Inverts the images of a problem, starting from the estimate of the network for those of the first
/// band on the grid of the mask.
///
/// # Errors
/// The errors of [`Estimator::estimate`] and [`invert`].
pub fn hybrid(
    problem: &Problem,
    network: &Estimator,
    models: &mut dyn Models,
    settings: &InversionSettings,
    watch: &dyn Watch,
) -> Result<Reconstruction> {
    let Problem { bands, mask, .. } = problem;
    let observation = bands[0].on_ideal_cameras()?;
    let geometry = observation.imaging_geometry()?;
    let mut start = network.estimate(&observation.images, &geometry, Some(&mask.grid))?;
    mask.apply(&mut start.extinction)?;
    invert(problem, models, &start.into(), settings, watch)
}
