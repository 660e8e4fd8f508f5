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
/// Least tolerance of all other steps: with 3e-3 they end where images and derivatives contradict each
/// other.
const STEP_TOLERANCE: f64 = 1e-3;
/// Rays of a pixel in all other steps.
const STEP_RAYS: usize = 5;

/// The least extinction that voxels of a mask are prepared for (1/km): steps may fill empty ones.
const LEAST_PREPARED: f32 = 20.0;

/// The deterministic solver on any grid: steps are taken by a cheap one, whose images an accurate one
/// corrects.
///
/// On the grid of the answer and near it, the images of the accurate solver at the extinction that a
/// stage begins with, minus those of the cheap one, are added to all later images: a step costs what the
/// cheap solver does, and stage after stage ends closer to the accurate one's answer (defect correction:
/// Stetter 1978).
#[derive(Debug, Clone)]
pub struct OrdinatesModels {
    /// The scene whose medium tells the scattering; its extinction does not matter.
    pub scene: Scene,
    /// The views of the observation.
    pub views: Vec<View>,
    /// Settings of the solver that takes the steps, on all grids.
    pub settings: OrdinatesSettings,
    /// Settings of the solver that corrects it, if any.
    pub accurate_settings: Option<OrdinatesSettings>,
}

impl OrdinatesModels {
    /// Corrected by the solver of the given settings; steps by half of its ordinates, fewer rays, and
    /// voxels that are not split.
    pub fn new(scene: Scene, views: Vec<View>, settings: OrdinatesSettings) -> Self {
        let steps = OrdinatesSettings {
            zenith_angles: (settings.zenith_angles / 8 * 4).max(4),
            most_parts: 1,
            rays_per_pixel: settings.rays_per_pixel.min(STEP_RAYS),
            tolerance: settings.tolerance.max(STEP_TOLERANCE),
            ..settings
        };
        Self { scene, views, settings: steps, accurate_settings: Some(settings) }
    }

    /// Steps with [`QUICK_TOLERANCE`] and fewer rays, corrected by the same solver as before.
    pub fn quick(self) -> Self {
        let settings = OrdinatesSettings {
            tolerance: QUICK_TOLERANCE,
            rays_per_pixel: QUICK_RAYS,
            ..self.settings
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
    fn are_corrected(&self) -> bool {
        self.accurate_settings.is_some()
    }

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
        let cheap = make(&self.settings)?;
        let Some(accurate) = self.accurate_settings.filter(|_| fine && near) else {
            return Ok(Box::new(cheap));
        };
        Ok(Box::new(Corrected { cheap, accurate: Some(make(&accurate)?), defect: None }))
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
