//! The result of an inversion and the record of its iterations.

use super::{Calibration, Checkpoint, Fields};
use crate::error::Result;
use crate::grid::Volume;
use crate::scene::Light;
use ndarray::{Array3, ArrayView3};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// One iteration of an inversion.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Index of the stage, from 0: the grids from coarse to fine, then the corrections.
    pub stage: usize,
    /// Side length (voxels) of the blocks that are solved for; 1 on the full-resolution grid.
    pub block: usize,
    /// Number of the iteration in that stage; 0 is the start of the stage.
    pub iteration: usize,
    /// Time since the start of the inversion (s).
    pub seconds: f64,
    /// Mean over all pixels of the squared ratio of the residual to its standard error.
    pub misfit: f64,
    /// Value of the objective function.
    pub value: f64,
    /// Number of evaluations of the forward model in that stage.
    pub evaluations: usize,
    /// Relative error epsilon, if the truth is known.
    pub relative_error: Option<f64>,
    /// Relative error of the total extinction delta, if the truth is known.
    pub mass_error: Option<f64>,
}

/// The reason why an inversion ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Ending {
    /// The misfit reached the level explained by the noise.
    Noise,
    /// The maximum number of iterations was reached.
    Iterations,
    /// The iterations no longer reduced the objective function.
    Stalled,
    /// The progress callback interrupted the inversion.
    Interrupted,
}

impl Ending {
    /// A description of the reason why the inversion ended.
    pub fn description(self) -> &'static str {
        match self {
            Self::Noise => "the misfit is at the noise level",
            Self::Iterations => "maximum number of iterations reached",
            Self::Stalled => "no further decrease of the objective function",
            Self::Interrupted => "stopped",
        }
    }
}

/// Misfit above which the images are not explained: noise and errors of the model are about 1.
const UNEXPLAINED: f64 = 100.0;
/// Misfit above which they are explained in part only: tens are found where air, surface or droplets
/// are not those of the images.
const DOUBTFUL: f64 = 10.0;

/// How well a result explains the images.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Explanation {
    /// Within a few standard errors, or the inversion was not allowed to change its start.
    Complete,
    /// In part; the misfit.
    Partial(f64),
    /// Not at all, as when an inversion cannot leave its start; the misfit.
    None(f64),
}

impl Explanation {
    /// A sentence about a result that does not explain the images.
    pub fn problem(self) -> Option<String> {
        let (part, misfit) = match self {
            Self::Complete => return None,
            Self::Partial(misfit) => ("explains the images in part only", misfit),
            Self::None(misfit) => ("does not explain the images", misfit),
        };
        Some(format!("the result {part}: the misfit is {misfit:.1}, but should be about 1"))
    }
}

/// The result of an inversion.
#[derive(Debug, Clone, PartialEq)]
pub struct Reconstruction {
    /// The extinction (1/km), 0 outside the mask.
    pub extinction: Volume,
    /// The effective radius (um), 0 outside the mask; `None` if it was given.
    pub effective_radius: Option<Volume>,
    /// `None` if [`InversionSettings::members`](super::InversionSettings::members) is 0.
    pub standard_errors: Option<StandardErrors>,
    /// The most likely calibration of the camera of each view of each band.
    pub calibrations: Vec<Vec<Calibration>>,
    /// The record of each iteration.
    pub history: Vec<Record>,
    /// The reason why the inversion ended.
    pub ending: Ending,
}

/// Standard errors of a result in each voxel, 0 outside the mask: the spread of the results for images
/// with other noise and with another prior.
#[derive(Debug, Clone, PartialEq)]
pub struct StandardErrors {
    /// That of the extinction (1/km).
    pub extinction: Volume,
    /// That of the effective radius (um); `None` if it was given.
    pub effective_radius: Option<Volume>,
    /// That of the liquid water content (g/m3); `None` if the effective radius was given.
    pub liquid_water_content: Option<Volume>,
}

impl StandardErrors {
    /// The spread of at least two members, of which each is as likely as the others given the images.
    pub(super) fn of(members: &[Fields], light: &Light) -> Result<Self> {
        let water = |member: &Fields| {
            let Fields { extinction, effective_radius } = member;
            let droplets = effective_radius.as_ref().map(|r| light.droplets_of(extinction, r));
            droplets.transpose().map(|droplets| droplets.map(|d| d.liquid_water_content))
        };
        let radii: Option<Vec<_>> =
            members.iter().map(|m| m.effective_radius.as_ref().map(|r| r.values.view())).collect();
        let water: Vec<_> = members.iter().map(water).collect::<Result<_>>()?;
        let water: Option<Vec<_>> = water.iter().map(|w| Some(w.as_ref()?.view())).collect();
        let grid = members[0].extinction.grid;
        let volume = |values| Volume::new(grid, values);
        let extinctions: Vec<_> = members.iter().map(|m| m.extinction.values.view()).collect();
        Ok(Self {
            extinction: volume(standard_deviation(&extinctions))?,
            effective_radius: radii.map(|r| volume(standard_deviation(&r))).transpose()?,
            liquid_water_content: water.map(|w| volume(standard_deviation(&w))).transpose()?,
        })
    }
}

/// The standard deviation of at least two samples of each voxel.
fn standard_deviation(samples: &[ArrayView3<f32>]) -> Array3<f32> {
    let count = samples.len() as f32;
    let mut mean = Array3::zeros(samples[0].raw_dim());
    samples.iter().for_each(|sample| mean.scaled_add(1.0 / count, sample));
    let mut variance = Array3::<f32>::zeros(mean.raw_dim());
    for sample in samples {
        variance.scaled_add(1.0 / (count - 1.0), &(sample - &mean).mapv(|d| d * d));
    }
    variance.mapv(f32::sqrt)
}

impl Reconstruction {
    /// The mean effective radius (um), weighted by the extinction; `None` if it was given, or if there
    /// is no cloud.
    pub fn mean_effective_radius(&self) -> Option<f64> {
        let pairs = self.effective_radius.iter().flat_map(|radius| &radius.values);
        let (mut sum, mut total) = (0.0, 0.0);
        for (extinction, radius) in self.extinction.values.iter().zip(pairs) {
            sum += f64::from(*extinction) * f64::from(*radius);
            total += f64::from(*extinction);
        }
        (total > 0.0).then(|| sum / total).filter(|_| self.effective_radius.is_some())
    }

    /// The relative error epsilon that the standard errors of the extinction let expect, for errors
    /// with a normal distribution; `None` if there are no standard errors, or no cloud.
    pub fn expected_relative_error(&self) -> Option<f64> {
        let errors = &self.standard_errors.as_ref()?.extinction.values;
        let sum = |values: &Array3<f32>| values.iter().map(|value| f64::from(*value)).sum::<f64>();
        let total = sum(&self.extinction.values);
        (total > 0.0).then(|| (2.0 / PI).sqrt() * sum(errors) / total)
    }

    /// How well the extinction explains the images, by the misfit at the end.
    pub fn explanation(&self) -> Explanation {
        let Some(misfit) = self.history.last().map(|record| record.misfit) else {
            return Explanation::Complete;
        };
        let moved = self.history.iter().any(|record| record.iteration > 0);
        if misfit <= DOUBTFUL || self.ending == Ending::Iterations && !moved {
            Explanation::Complete
        } else if misfit <= UNEXPLAINED {
            Explanation::Partial(misfit)
        } else {
            Explanation::None(misfit)
        }
    }
}

/// Progress callback; `()` ignores all events.
pub trait Watch {
    /// Called after each iteration.
    fn reached(&self, _record: &Record) {}

    /// Called when the number of members, from which the standard errors follow, has increased.
    fn has_members(&self, _count: usize) {}

    /// Called every few iterations with the state from which the inversion can be resumed.
    ///
    /// # Errors
    /// A checkpoint that cannot be stored; the inversion then ends with this error.
    fn keep(&self, _checkpoint: &Checkpoint) -> Result<()> {
        Ok(())
    }

    /// Whether to stop and return the current result. Called before each iteration.
    fn interrupted(&self) -> bool {
        false
    }
}

impl Watch for () {}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;
    use crate::math::DVec3;

    /// A result after one iteration that ends with a misfit.
    fn result(misfit: f64) -> Reconstruction {
        let record = |iteration, misfit| Record {
            stage: 0,
            block: 1,
            iteration,
            misfit,
            value: misfit,
            evaluations: 1,
            seconds: 0.0,
            relative_error: None,
            mass_error: None,
        };
        let grid = Grid::new(DVec3::ZERO, DVec3::ONE, [1, 1, 1]).unwrap();
        Reconstruction {
            extinction: Volume::constant(grid, 1.0),
            effective_radius: None,
            standard_errors: None,
            calibrations: Vec::new(),
            history: vec![record(0, 1e4), record(1, misfit)],
            ending: Ending::Stalled,
        }
    }

    #[test]
    fn a_large_misfit_is_told() {
        assert_eq!(result(1.3).explanation().problem(), None);
        let problem = |misfit| result(misfit).explanation().problem().unwrap();
        assert!(problem(83.0).contains("in part only: the misfit is 83.0"));
        assert!(problem(150.0).contains("does not explain the images"));
        assert!(problem(f64::NAN).contains("does not explain the images"));
        // Nothing is said of a start that may not be changed.
        let mut start = result(1.0);
        start.history.truncate(1);
        start.ending = Ending::Iterations;
        assert_eq!(start.explanation(), Explanation::Complete);
    }
}
