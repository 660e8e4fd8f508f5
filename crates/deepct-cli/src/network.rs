//! Options of the verbs that use a network.

use deepct_core::grid::Grid;
use deepct_core::io::{GENERAL_WEIGHTS, ImagesFile, load_trained_weights, read_grid};
use deepct_core::network::{Estimate, Estimator};
use deepct_core::scene::{Observation, imaging_geometry};
use deepct_core::{Result, conv};
use std::path::PathBuf;

/// Number of saturated pixels that does not change an estimate: sensors saturate at the brightest
/// pixel of the images.
const FEW_PIXELS: usize = 5;

/// Share of the extinction in the lowest or highest level above which a cloud may be cut off.
const SHARE_AT_END: f64 = 0.03;

/// The weights of the network, and the grid of its estimate.
#[derive(Debug, clap::Args)]
pub(crate) struct NetworkFlags {
    /// Network weights: a file, or the name of built-in weights: general (any formation and any
    /// Sun), cloudct-10 or pearls-32 (one formation and one Sun)
    #[arg(long, value_name = "FILE|NAME", default_value = GENERAL_WEIGHTS)]
    pub(crate) weights: PathBuf,
    /// Grid of the estimate: the file of a cloud or volume, or a TOML file (see `deepct formats`).
    /// By default one column of voxels for each pixel; the general weights then have 32 levels,
    /// centred on the target, and voxels as wide as the smallest pixel
    #[arg(long, value_name = "C.nc|GRID.toml")]
    pub(crate) grid: Option<PathBuf>,
}

impl NetworkFlags {
    /// The estimator with these weights, also outside the range of their training if `force` is set.
    pub(crate) fn estimator(&self, settings: conv::Settings, force: bool) -> Result<Estimator> {
        let estimator = Estimator::with_settings(load_trained_weights(&self.weights)?, settings);
        Ok(if force { estimator.outside_training() } else { estimator })
    }

    /// Warns of images that do not look like those of the training.
    pub(crate) fn warn_of_unusual_images(
        &self,
        estimator: &Estimator,
        observation: &Observation,
        estimate: &Estimate,
    ) -> Result<()> {
        let (known, missing) = (observation.known(), observation.images.missing());
        let unknown = known.iter().zip(&missing).filter(|(known, missing)| !**known && !**missing);
        let (unknown, pixels) = (unknown.count(), known.len());
        if unknown > FEW_PIXELS.max(pixels / 1000) {
            note!(
                "deepct: warning: {unknown} of {pixels} pixels are saturated, or their standard error is \
                 above the brightest radiance; the network takes their radiances as measured"
            );
        }
        let observation = observation.on_ideal_cameras()?;
        let geometry = observation.imaging_geometry()?;
        for unusual in estimator.unusual(&observation.images, &geometry, estimate)? {
            note!(
                "deepct: warning: the network was not trained on such images: {unusual}; the \
                 estimate may be wrong"
            );
        }
        Ok(())
    }

    /// Warns of an estimate that reaches the lowest or the highest level.
    pub(crate) fn warn_of_ends(&self, estimate: &Estimate) {
        let grid = &estimate.extinction.grid;
        let altitudes = [grid.lower().z, grid.upper().z];
        let ends = [("bottom", altitudes[0]), ("top", altitudes[1])];
        for ((end, altitude), share) in ends.into_iter().zip(estimate.shares_at_ends()) {
            if grid.shape[0] > 2 && share > SHARE_AT_END {
                note!(
                    "deepct: warning: {:.0} % of the estimated extinction is in the level at the \
                     {end} of the grid ({altitude:.3} km): the cloud may extend beyond it; give a \
                     higher grid with --grid",
                    100.0 * share
                );
            }
        }
    }

    /// The requested grid.
    pub(crate) fn grid(&self) -> Result<Option<Grid>> {
        self.grid.as_deref().map(read_grid).transpose()
    }
}

/// The requested grid, or that of the network for the images of a file.
pub(crate) fn network_grid(
    network: &Estimator,
    requested: Option<Grid>,
    file: &ImagesFile,
) -> Result<Grid> {
    let views = file.views();
    match requested {
        Some(grid) => Ok(grid),
        None => {
            let size = [views[0].rows, views[0].cols];
            network.grid(&imaging_geometry(file.light(), views)?, size)
        }
    }
}
