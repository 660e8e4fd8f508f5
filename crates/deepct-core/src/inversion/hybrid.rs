//! The hybrid method: an inversion that starts from the estimate of the network.

use super::{InversionSettings, Models, Problem, Reconstruction, Watch, invert};
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::network::Network;
use crate::scene::{Observation, target};

/// Number of iterations of the quick hybrid.
pub const QUICK_ITERATIONS: usize = 12;

/// The grid of the network's estimate for the images of an observation.
///
/// # Errors
/// Views without a common target point.
pub fn network_grid(network: &Network, observation: &Observation) -> Result<Grid> {
    let target = target(&observation.views)?;
    let [_, rows, cols] = observation.images.shape();
    network.grid([target.x, target.y], [rows, cols])
}

/// Inverts the images of an observation, starting from the estimate of the network.
///
/// # Errors
/// The errors of [`Network::estimate`] and [`invert`]; a mask that is not on [`network_grid`].
pub fn hybrid(
    problem: &Problem,
    network: &Network,
    models: &mut dyn Models,
    settings: &InversionSettings,
    watch: &dyn Watch,
) -> Result<Reconstruction> {
    let mut start =
        network.estimate(&problem.observation.images, &problem.observation.imaging_geometry()?)?;
    let grid = start.extinction.grid;
    if !grid.matches(&problem.mask.grid) {
        return Err(Error::mismatch(
            "grid of the mask",
            format!("{:?} voxels from {} km", grid.shape, grid.origin),
            format!("{:?} voxels from {} km", problem.mask.grid.shape, problem.mask.grid.origin),
            "carve a mask on the grid of the network's estimate",
        ));
    }
    problem.mask.apply(&mut start.extinction)?;
    invert(problem, models, &start.into(), settings, watch)
}
