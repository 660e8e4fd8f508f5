//! The deterministic solver as the model of an inversion.

use super::{Domain, ForwardModel, Models};
use crate::error::{Error, Result};
use crate::grid::{Grid, Volume};
use crate::image::ViewStack;
use crate::optics::Scattering;
use crate::scene::{Scene, View};
use crate::transport::{OrdinatesModel, OrdinatesSettings};
use ndarray::{Array3, Zip};

/// The tolerance of the solver in a few quick steps, which do not end where a finer one shows.
pub const QUICK_TOLERANCE: f64 = 1e-2;

/// Rays of a pixel in those steps.
const QUICK_RAYS: usize = 3;
/// Tolerance and rays of a pixel of all other steps.
const STEP_TOLERANCE: f64 = 3e-3;
const STEP_RAYS: usize = 5;

/// The least extinction that voxels of a mask are prepared for (1/km): steps may fill empty ones.
const LEAST_PREPARED: f32 = 20.0;

/// The deterministic solver on any grid.
#[derive(Debug, Clone)]
pub struct OrdinatesModels {
    /// The scene whose medium tells the scattering; its extinction does not matter.
    pub scene: Scene,
    /// The views of the observation.
    pub views: Vec<View>,
    /// Settings on the grid of the answer, for steps from an estimate of it.
    pub settings: OrdinatesSettings,
    /// Settings on coarser grids, where voxels are not split.
    pub coarse_settings: OrdinatesSettings,
    /// Settings of a more accurate solver, if any. Its images of the estimate, minus those by
    /// `settings`, are added to all later ones: a step then costs what the cheap solver does, and near
    /// the estimate its error is that of the accurate one (defect correction: Stetter 1978). From any
    /// other start the accurate solver takes all steps.
    pub accurate_settings: Option<OrdinatesSettings>,
}

impl OrdinatesModels {
    /// Steps by larger cells, fewer rays and a tolerance of a few thousandths, corrected at the start
    /// by the solver of the given settings; half of its ordinates on coarser grids.
    pub fn new(scene: Scene, views: Vec<View>, settings: OrdinatesSettings) -> Self {
        let coarse_settings = OrdinatesSettings {
            zenith_angles: (settings.zenith_angles / 8 * 4).max(4),
            most_parts: 1,
            ..settings
        };
        let steps = OrdinatesSettings {
            cell_depth: 2.0 * settings.cell_depth,
            rays_per_pixel: settings.rays_per_pixel.min(STEP_RAYS),
            tolerance: settings.tolerance.max(STEP_TOLERANCE),
            ..settings
        };
        Self { scene, views, settings: steps, coarse_settings, accurate_settings: Some(settings) }
    }

    /// Steps by the ordinates of the coarser grids with [`QUICK_TOLERANCE`], corrected at the start by
    /// the same solver as before.
    pub fn quick(self) -> Self {
        let settings = OrdinatesSettings {
            tolerance: QUICK_TOLERANCE,
            rays_per_pixel: QUICK_RAYS,
            ..self.coarse_settings
        };
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
    fn model(&mut self, domain: &Domain) -> Result<Box<dyn ForwardModel + '_>> {
        let Domain { mask, expected, near, pixels } = *domain;
        let fine = mask.grid.shape == self.scene.medium.extinction.grid.shape;
        let mut scene = self.scene.clone();
        scene.medium.scattering = self.scattering(&mask.grid);
        scene.medium.extinction = Volume {
            grid: mask.grid,
            values: Zip::from(&mask.values)
                .and(&expected.values)
                .map_collect(|inside, value| if *inside { value.max(LEAST_PREPARED) } else { 0.0 }),
        };
        let make = |settings| {
            let mut model = OrdinatesModel::new(&scene, &self.views, Some(mask), settings)?;
            model.look_at(pixels)?;
            Ok::<_, Error>(model)
        };
        if !fine {
            return Ok(Box::new(make(&self.coarse_settings)?));
        }
        let Some(accurate) = &self.accurate_settings else {
            return Ok(Box::new(make(&self.settings)?));
        };
        if !near {
            return Ok(Box::new(make(accurate)?));
        }
        let cheap = make(&self.settings)?;
        Ok(Box::new(Corrected { cheap, accurate: Some(make(accurate)?), defect: None }))
    }
}

/// A cheap model with the defect that it had at the first extinction.
struct Corrected {
    cheap: OrdinatesModel,
    /// Until it has been used.
    accurate: Option<OrdinatesModel>,
    defect: Option<ViewStack>,
}

impl ForwardModel for Corrected {
    fn images(&mut self, extinction: &Volume) -> Result<ViewStack> {
        let mut images = self.cheap.images(extinction)?;
        if let Some(mut accurate) = self.accurate.take() {
            let right = accurate.images(extinction)?;
            self.defect = Some(ViewStack::new(right.values - &images.values)?);
        }
        if let Some(defect) = &self.defect {
            images.values += &defect.values;
        }
        Ok(images)
    }

    fn gradient(&mut self, weights: &ViewStack) -> Result<Volume> {
        self.cheap.gradient(weights)
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
