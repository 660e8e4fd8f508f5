//! The deterministic solver as the model of an inversion.

use super::{ForwardModel, Models};
use crate::error::Result;
use crate::grid::{Grid, Mask, Volume};
use crate::image::ViewStack;
use crate::optics::Scattering;
use crate::scene::{Scene, View};
use crate::transport::{OrdinatesModel, OrdinatesSettings};
use ndarray::Array3;

/// The tolerance of the solver in a few quick steps, which do not end where a finer one shows.
pub const QUICK_TOLERANCE: f64 = 1e-2;

/// The deterministic solver on any grid.
#[derive(Debug, Clone)]
pub struct OrdinatesModels {
    /// The scene whose medium tells the scattering; its extinction does not matter.
    pub scene: Scene,
    /// The views of the observation.
    pub views: Vec<View>,
    /// Settings on the grid of the answer.
    pub settings: OrdinatesSettings,
    /// Settings on coarser grids.
    pub coarse_settings: OrdinatesSettings,
}

impl OrdinatesModels {
    /// The solver with its own settings, and half of its ordinates on coarser grids.
    pub fn new(scene: Scene, views: Vec<View>, settings: OrdinatesSettings) -> Self {
        let coarse_settings = OrdinatesSettings {
            zenith_angles: (settings.zenith_angles / 8 * 4).max(4),
            ..settings
        };
        Self { scene, views, settings, coarse_settings }
    }

    /// The same with the ordinates of the coarser grids on all and [`QUICK_TOLERANCE`].
    pub fn quick(self) -> Self {
        let settings = OrdinatesSettings { tolerance: QUICK_TOLERANCE, ..self.coarse_settings };
        Self { settings, ..self }
    }

    /// What collisions do on a grid of blocks of voxels.
    fn scattering(&self, grid: &Grid) -> Scattering {
        let Scattering::Droplets { effective_radius, table } = &self.scene.medium.scattering else {
            return self.scene.medium.scattering.clone();
        };
        let fine = &self.scene.medium.extinction.grid;
        let block = (grid.spacing.x / fine.spacing.x).round() as usize;
        let mut sums = Array3::<f32>::zeros(grid.shape);
        let mut counts = Array3::<f32>::zeros(grid.shape);
        for ((k, j, i), &radius) in effective_radius.indexed_iter() {
            if radius > 0.0 {
                sums[[k / block, j / block, i / block]] += radius;
                counts[[k / block, j / block, i / block]] += 1.0;
            }
        }
        sums.zip_mut_with(&counts, |sum, count| *sum /= count.max(1.0));
        Scattering::Droplets { effective_radius: sums, table: table.clone() }
    }
}

impl Models for OrdinatesModels {
    fn model(&mut self, mask: &Mask) -> Result<Box<dyn ForwardModel + '_>> {
        let fine = mask.grid.shape == self.scene.medium.extinction.grid.shape;
        let mut scene = self.scene.clone();
        scene.medium.scattering = self.scattering(&mask.grid);
        scene.medium.extinction = Volume::constant(mask.grid, 0.0);
        let settings = if fine { &self.settings } else { &self.coarse_settings };
        let solver = OrdinatesModel::new(&scene, &self.views, Some(mask), settings)?;
        Ok(Box::new(solver))
    }
}

impl ForwardModel for OrdinatesModel {
    fn images(&mut self, extinction: &Volume) -> Result<ViewStack> {
        Self::images(self, extinction)
    }

    fn gradient(&mut self, weights: &ViewStack) -> Result<Volume> {
        Self::gradient(self, weights)
    }
}
