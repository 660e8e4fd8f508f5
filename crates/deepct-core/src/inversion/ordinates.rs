//! The discrete-ordinates solver as the forward model of an inversion.

use super::{Domain, ForwardModel, Models};
use crate::error::{Error, Result};
use crate::grid::{Grid, Volume};
use crate::image::ViewStack;
use crate::optics::Scattering;
use crate::scene::{Scene, View};
use crate::stop::Stop;
use crate::transport::{OrdinatesModel, OrdinatesSettings};
use ndarray::{Array3, Zip};

/// Tolerance of the solver in a few quick iterations, which end before a smaller tolerance would
/// make a difference.
pub const QUICK_TOLERANCE: f64 = 1e-2;

/// Number of rays per pixel in the quick iterations.
const QUICK_RAYS: usize = 3;
/// Smallest tolerance in all other iterations. With a tolerance of 3e-3, the iterations stop early
/// because images and derivatives are inconsistent.
const STEP_TOLERANCE: f64 = 1e-3;
/// Largest number of rays per pixel in all other iterations.
const STEP_RAYS: usize = 5;

/// Smallest extinction for which the voxels of a mask are prepared (1/km), because iterations may
/// fill empty voxels.
const LEAST_PREPARED: f32 = 20.0;

/// The discrete-ordinates solver on any grid: the iterations use a fast solver, whose images an
/// accurate solver corrects.
///
/// On the full-resolution grid and near the solution, the difference between the images of the
/// accurate and of the fast solver at the first extinction of a stage is added to all later images.
/// An iteration then costs as much as one of the fast solver, and each stage ends closer to the
/// solution of the accurate solver (defect correction: Stetter 1978).
#[derive(Debug, Clone)]
pub struct OrdinatesModels {
    /// The scene whose medium defines the scattering properties; its extinction has no effect.
    pub scene: Scene,
    /// The views of the observation.
    pub views: Vec<View>,
    /// Settings of the fast solver, which is used in the iterations on all grids.
    pub settings: OrdinatesSettings,
    /// Settings of the accurate solver that corrects the fast one, if any.
    pub accurate_settings: Option<OrdinatesSettings>,
    /// Ends an evaluation that is running when it is requested.
    pub stop: Stop,
}

impl OrdinatesModels {
    /// Creates models that are corrected by a solver with the given settings. The fast solver uses
    /// about half of the ordinates and fewer rays, and does not subdivide voxels.
    pub fn new(scene: Scene, views: Vec<View>, settings: OrdinatesSettings) -> Self {
        let steps = OrdinatesSettings {
            zenith_angles: (settings.zenith_angles / 8 * 4).max(4),
            most_parts: 1,
            rays_per_pixel: settings.rays_per_pixel.min(STEP_RAYS),
            tolerance: settings.tolerance.max(STEP_TOLERANCE),
            ..settings
        };
        let accurate_settings = Some(settings);
        Self { scene, views, settings: steps, accurate_settings, stop: Stop::default() }
    }

    /// Returns the models with [`QUICK_TOLERANCE`] and fewer rays in the fast solver; the accurate
    /// solver does not change.
    pub fn quick(self) -> Self {
        let settings = OrdinatesSettings {
            tolerance: QUICK_TOLERANCE,
            rays_per_pixel: QUICK_RAYS,
            ..self.settings
        };
        Self { settings, ..self }
    }

    /// The scattering properties on a grid of blocks of voxels.
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
            model.stop_by(self.stop.clone());
            Ok::<_, Error>(model)
        };
        let cheap = make(&self.settings)?;
        let Some(accurate) = self.accurate_settings.filter(|_| fine && near) else {
            return Ok(Box::new(cheap));
        };
        Ok(Box::new(Corrected { cheap, accurate: Some(make(&accurate)?), defect: None }))
    }
}

/// A fast model, corrected by its defect at the first extinction.
struct Corrected {
    cheap: OrdinatesModel,
    /// `None` after its first use.
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

    fn forget(&mut self) {
        self.cheap.forget();
    }
}

impl ForwardModel for OrdinatesModel {
    fn images(&mut self, extinction: &Volume) -> Result<ViewStack> {
        Self::images(self, extinction)
    }

    fn gradient(&mut self, weights: &ViewStack) -> Result<Volume> {
        Self::gradient(self, weights)
    }

    fn forget(&mut self) {
        Self::forget(self);
    }
}
