//! The hybrid method: an inversion that starts from the estimate of the network.

use super::{InversionSettings, Models, Problem, Reconstruction, Watch, invert};
use crate::error::Result;
use crate::grid::Grid;
use crate::network::{BandImages, Estimate, Estimator};
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

/// The estimate of a network for the images of the bands that its weights are for, on a grid or on that
/// of [`network_grid`].
///
/// # Errors
/// The errors of [`Estimator::estimate_bands`].
pub fn network_estimate(
    network: &Estimator,
    bands: &[Observation],
    grid: Option<&Grid>,
) -> Result<Estimate> {
    let ideal = bands.iter().map(Observation::on_ideal_cameras).collect::<Result<Vec<_>>>()?;
    let geometries =
        ideal.iter().map(|band| band.imaging_geometry()).collect::<Result<Vec<_>>>()?;
    let pairs = ideal.iter().zip(&geometries);
    let bands = pairs.map(|(band, geometry)| BandImages { images: &band.images, geometry });
    network.estimate_bands(&bands.collect::<Vec<_>>(), grid)
}

/// The bands of an inversion that a network sees: the first ones, as many as its weights are for.
pub fn network_bands<'a>(network: &Estimator, bands: &'a [Observation]) -> &'a [Observation] {
    &bands[..network.bands().min(bands.len())]
}

/// Inverts the images of a problem, starting from the estimate of the network for those of
/// [`network_bands`] on the grid of the mask.
///
/// # Errors
/// The errors of [`network_estimate`] and [`invert`].
pub fn hybrid(
    problem: &Problem,
    network: &Estimator,
    models: &mut dyn Models,
    settings: &InversionSettings,
    watch: &dyn Watch,
) -> Result<Reconstruction> {
    let Problem { bands, mask, .. } = problem;
    let seen = network_bands(network, bands);
    let mut start = network_estimate(network, seen, Some(&mask.grid))?;
    mask.apply(&mut start.extinction)?;
    invert(problem, models, &start.into(), settings, watch)
}
