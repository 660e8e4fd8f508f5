//! The sequence of an inversion: stages on several grids, each with several iterations.

use super::blocks::{coarsen, means, refine, shares};
use super::calibration::slopes;
use super::objective::Objective;
use super::optimiser::{Function, Minimiser, MinimiserSettings, Step};
use super::prior::Prior;
use super::problem::shown;
use super::radius::{LOGARITHM, PROFILE_ERROR, Profile};
use super::scale::scale;
use super::variables::{Unknowns, Variables};
use super::{
    Calibration, Checkpoint, Domain, Ending, Fields, InversionSettings, Measurement, Models,
    Problem, Reconstruction, Record, StandardErrors, Start, Watch,
};
use crate::error::{Error, Result};
use crate::grid::{Grid, Mask, Volume};
use crate::metrics;
use crate::network::Estimate;
use crate::rng::{Purpose, stream};
use crate::scene::Observation;
use ndarray::Array3;
use std::time::Instant;

/// Number of iterations to which [`InversionSettings::change`] applies.
const PATIENCE: usize = 5;
/// Maximum number of steps of a member, and the number of them that are stored. Where the images tell
/// little, the last steps change the objective function hardly, but the member much.
const MEMBER_STEPS: usize = 40;
const MEMBER_MEMORY: usize = 100;
/// Share of the relative change at which an inversion has stalled, at which a member has.
const MEMBER_CHANGE: f64 = 0.01;

/// Number of iterations between two states from which an inversion can be resumed. At each of them,
/// the model forgets the solution from which the next one would start, and the objective function is
/// evaluated again, because the value found from another solution differs by more than a step gains.
const KEPT: usize = 10;

/// Smallest uncertainty of a start (1/km), because voxels that a network estimates as clear may
/// contain thin cloud.
const LEAST_UNCERTAINTY: f64 = 0.1;

/// Retrieves the cloud inside the mask whose simulated images fit those of the observations.
///
/// # Errors
/// Settings out of range, an empty mask, a start or truth on another grid, images without light,
/// and the errors of the models and of the progress callback.
pub fn invert(
    problem: &Problem,
    models: &mut dyn Models,
    start: &Start,
    settings: &InversionSettings,
    watch: &dyn Watch,
) -> Result<Reconstruction> {
    let mut run = Run::new(problem, models, start, settings, watch)?;
    let (mut unknowns, search) = run.first(start)?;
    let mut ending = Ending::Iterations;
    for number in 0..run.stages.len() {
        let level = run.level(number)?;
        let from = Beginning::Unknowns(&unknowns, number == 0 && search);
        (unknowns, ending) = run.solve(&level, models, from)?;
        if ending == Ending::Interrupted {
            break;
        }
    }
    run.reconstruction(unknowns, ending)
}

/// Resumes [`invert`] from a checkpoint, with the same problem, models, start and settings.
///
/// # Errors
/// The errors of [`invert`]; a checkpoint of another problem.
pub fn resume(
    problem: &Problem,
    models: &mut dyn Models,
    (start, checkpoint): (&Start, Checkpoint),
    settings: &InversionSettings,
    watch: &dyn Watch,
) -> Result<Reconstruction> {
    let mut run = Run::new(problem, models, start, settings, watch)?;
    run.history = checkpoint.history.clone();
    run.seconds = checkpoint.history.last().map_or(0.0, |record| record.seconds);
    let first = checkpoint.stage;
    if first >= run.stages.len() {
        return Err(Error::mismatch(
            "stage of the checkpoint",
            format!("below {}", run.stages.len()),
            first,
            "resume with the settings with which the inversion was started",
        ));
    }
    let level = run.level(first)?;
    let (mut unknowns, mut ending) =
        run.solve(&level, models, Beginning::Checkpoint(checkpoint))?;
    for number in first + 1..run.stages.len() {
        if ending == Ending::Interrupted {
            break;
        }
        let level = run.level(number)?;
        (unknowns, ending) = run.solve(&level, models, Beginning::Unknowns(&unknowns, false))?;
    }
    run.reconstruction(unknowns, ending)
}

/// A part of an inversion with one model; the next stage creates a new one.
#[derive(Debug, Clone, Copy)]
struct Stage {
    /// Side length (voxels) of the blocks that are solved for.
    block: usize,
    /// Whether the stage begins near the solution.
    near: bool,
}

/// A stage and its grid.
struct Level {
    number: usize,
    block: usize,
    near: bool,
    grid: Grid,
    shares: Array3<f64>,
}

impl Level {
    /// The blocks that contain voxels of the mask.
    fn mask(&self) -> Result<Mask> {
        Mask::new(self.grid, self.shares.mapv(|share| share > 0.0))
    }
}

/// The start of a stage.
enum Beginning<'a> {
    /// Unknowns on the grid of the solution, and whether to search for the factor of the extinction
    /// that fits the images best.
    Unknowns(&'a Unknowns, bool),
    /// The state of an interrupted inversion.
    Checkpoint(Checkpoint),
}

/// The data that all stages of an inversion share.
struct Run<'a> {
    bands: &'a [Observation],
    mask: Mask,
    truth: Option<&'a Volume>,
    settings: &'a InversionSettings,
    watch: &'a dyn Watch,
    measurements: Vec<Measurement>,
    profile: Profile,
    /// The start if it is an estimate, which the prior expects.
    expected: Option<&'a Estimate>,
    stages: Vec<Stage>,
    history: Vec<Record>,
    members: Vec<Fields>,
    /// The most likely calibration of the camera of each view of each band at the end of the last stage.
    calibrations: Vec<Vec<Calibration>>,
    /// The change of the value when the objective function was last evaluated again at one point.
    shift: f64,
    /// Time spent before the inversion was resumed (s).
    seconds: f64,
    began: Instant,
}

impl<'a> Run<'a> {
    fn new(
        problem: &Problem<'a>,
        models: &dyn Models,
        start: &'a Start,
        settings: &'a InversionSettings,
        watch: &'a dyn Watch,
    ) -> Result<Self> {
        settings.check()?;
        let Problem { bands, mask, truth } = *problem;
        if bands.is_empty() {
            return Err(Error::out_of_range("number of bands", 0, "at least 1"));
        }
        if mask.count() == 0 {
            let range = "at least 1: the lines of sight of cloudy pixels do not meet in the grid. Check \
                         the grid, the threshold and the targets of the views (images that were \
                         registered on the ground have targets at its altitude)";
            return Err(Error::out_of_range("voxels of the mask", 0, range));
        }
        if let Some(truth) = truth {
            check_grid("grid of the truth", &mask.grid, &truth.grid)?;
            metrics::check_truth(truth)?;
        }
        let mask = shown(mask, bands)?;
        let measurements = bands
            .iter()
            .map(|band| Ok(Measurement::new(band, settings)?.of_mask(&mask, &band.views)));
        let measurements = Measurement::together(measurements.collect::<Result<_>>()?);
        if measurements.iter().all(|band| band.counted().iter().all(|counted| !*counted)) {
            let range =
                "at least 1: no image shows a voxel of the mask; check grid, mask and views";
            return Err(Error::out_of_range("number of pixels that show the mask", 0, range));
        }
        let expected = match start {
            Start::Estimate(estimate) => {
                let Estimate { extinction, uncertainty, effective_radius } = &**estimate;
                check_grid("grid of the start", &mask.grid, &extinction.grid)?;
                extinction.check_non_negative("extinction of the start")?;
                if let Some(uncertainty) = uncertainty {
                    check_grid("grid of the uncertainty", &mask.grid, &uncertainty.grid)?;
                    uncertainty.check_non_negative("uncertainty of the start")?;
                }
                if let Some(radius) = effective_radius {
                    check_grid("grid of the effective radius", &mask.grid, &radius.grid)?;
                    radius.check_non_negative("effective radius of the start")?;
                }
                Some(&**estimate)
            }
            Start::Constant(_) | Start::Search => None,
        };
        let (history, began) = (Vec::new(), Instant::now());
        let nominal = bands.iter().map(|band| vec![Calibration::NOMINAL; band.views.len()]);
        Ok(Self {
            bands,
            profile: Profile::new(settings.radius, &mask),
            mask,
            truth,
            settings,
            watch,
            measurements,
            expected,
            stages: stages(start, models.are_corrected(), settings),
            history,
            members: Vec::new(),
            calibrations: nominal.collect(),
            shift: 0.0,
            seconds: 0.0,
            began,
        })
    }

    /// The unknowns of the start, and whether to search for the factor of the extinction.
    fn first(&self, start: &Start) -> Result<(Unknowns, bool)> {
        let grid = self.mask.grid;
        let (volume, search) = match start {
            Start::Search => (Volume::constant(grid, 1.0), true),
            Start::Constant(extinction) if extinction.is_finite() && *extinction > 0.0 => {
                (Volume::constant(grid, *extinction as f32), self.settings.scale_start)
            }
            Start::Constant(extinction) => {
                return Err(Error::out_of_range("start", extinction, "positive (1/km)"));
            }
            Start::Estimate(estimate) => {
                let mut unknowns = self.begin_at(estimate.extinction.clone());
                if let Some(radius) = &estimate.effective_radius {
                    let (profile, deviations) = self.profile.nearest(radius, &estimate.extinction);
                    unknowns.profile = profile;
                    unknowns.deviations.values = deviations.mapv(|deviation| deviation as f32);
                }
                return Ok((unknowns, false));
            }
        };
        Ok((self.begin_at(volume), search))
    }

    /// The unknowns with an extinction, and with the effective radius that the prior expects.
    fn begin_at(&self, extinction: Volume) -> Unknowns {
        let deviations = Volume::constant(extinction.grid, 0.0);
        Unknowns { extinction, profile: vec![0.0; self.profile.len()], deviations }
    }

    /// The means of unknowns over the blocks of a level.
    fn means(&self, unknowns: &Unknowns, block: usize) -> Result<Unknowns> {
        Ok(Unknowns {
            extinction: means(&unknowns.extinction, &self.mask, block)?,
            profile: unknowns.profile.clone(),
            deviations: means(&unknowns.deviations, &self.mask, block)?,
        })
    }

    /// The result with the given unknowns on the grid of the solution.
    fn reconstruction(self, unknowns: Unknowns, ending: Ending) -> Result<Reconstruction> {
        let effective_radius = self.radius(&unknowns)?;
        let extinction = unknowns.extinction;
        let Self { bands, members, calibrations, history, .. } = self;
        let standard_errors = (members.len() > 1 && ending != Ending::Interrupted)
            .then(|| StandardErrors::of(&members, &bands[0].light));
        Ok(Reconstruction {
            extinction,
            effective_radius,
            standard_errors: standard_errors.transpose()?,
            calibrations,
            history,
            ending,
        })
    }

    /// The effective radius (um) of unknowns, 0 outside the mask; `None` if it is given.
    fn radius(&self, unknowns: &Unknowns) -> Result<Option<Volume>> {
        let deviations = unknowns.deviations.values.mapv(f64::from);
        let mut radius = self.profile.volume(&self.mask.grid, &unknowns.profile, &deviations)?;
        if let Some(radius) = &mut radius {
            self.mask.apply(radius)?;
        }
        Ok(radius)
    }

    /// The prior of the variables of a level.
    fn prior(&self, level: &Level, variables: &Variables) -> Result<Prior> {
        let Level { block, grid, shares, .. } = level;
        let mut prior = Prior::new(grid, shares, *block, self.settings.typical_gradient);
        if let Some(uncertainty) = self.uncertainty() {
            let errors = means(uncertainty, &self.mask, *block)?
                .values
                .mapv(|value| self.settings.start_error * f64::from(value).max(LEAST_UNCERTAINTY));
            prior = prior.with_errors(&variables.gather(&errors));
        }
        let profile = Prior::independent(&vec![PROFILE_ERROR; variables.of_profile().len()]);
        let deviations = variables.of_deviations();
        let deviations = match deviations.len() {
            0 => Prior::independent(&[]),
            count => {
                let InversionSettings { radius_error, radius_gradient, .. } = self.settings;
                let errors = vec![radius_error / LOGARITHM; count];
                Prior::new(grid, shares, *block, radius_gradient / LOGARITHM).with_errors(&errors)
            }
        };
        let before = variables.of_profile();
        Ok(prior.followed_by(before.start, profile).followed_by(before.end, deviations))
    }

    /// The uncertainty of the start, if it is given and used. The inversion then seeks the most
    /// likely extinction, not the first one that is consistent with the noise.
    fn uncertainty(&self) -> Option<&'a Volume> {
        let told = self.expected.and_then(|start| start.uncertainty.as_ref());
        told.filter(|_| self.settings.start_error > 0.0)
    }

    fn level(&self, number: usize) -> Result<Level> {
        let Stage { block, near } = self.stages[number];
        let grid = coarsen(&self.mask.grid, block)?;
        Ok(Level { number, block, near, grid, shares: shares(&self.mask, block, grid.shape) })
    }

    /// Solves one stage and returns the unknowns on the grid of the solution.
    fn solve(
        &mut self,
        level: &Level,
        models: &mut dyn Models,
        beginning: Beginning,
    ) -> Result<(Unknowns, Ending)> {
        let Level { block, near, grid, shares, .. } = level;
        // On coarse grids, the profile has no deviations.
        let profile = if *block > 1 { self.profile.alone() } else { self.profile };
        let variables = Variables::new(*grid, shares, self.settings, profile);
        let prior = self.prior(level, &variables)?;
        let coarse_error = if *near { 0.0 } else { *block as f64 * self.settings.coarse_error };
        let offsets = match &beginning {
            Beginning::Unknowns(..) => self.offsets(),
            Beginning::Checkpoint(checkpoint) => checkpoint.offsets.clone(),
        };
        let from = match &beginning {
            Beginning::Unknowns(unknowns, _) => variables.of(&self.means(unknowns, *block)?),
            Beginning::Checkpoint(checkpoint) => {
                let count = checkpoint.began_at.len();
                let views = checkpoint.offsets.iter().map(Vec::len);
                let is_of_other_views = views.ne(self.bands.iter().map(|band| band.views.len()));
                let other = checkpoint.point.x.len() != count || is_of_other_views;
                if count != variables.len() || other {
                    return Err(Error::mismatch(
                        "number of variables in the checkpoint",
                        variables.len(),
                        count,
                        "resume with the images, grid and mask with which the inversion was started",
                    ));
                }
                checkpoint.began_at.clone()
            }
        };
        let expected = variables.fields(&from)?;
        let mask = level.mask()?;
        let pixels: Vec<_> = self.measurements.iter().map(Measurement::counted).collect();
        let domain = Domain {
            mask: &mask,
            expected: &expected,
            near: *near,
            pixels: &pixels,
            offsets: &offsets,
        };
        let slopes = match *near && self.settings.pointing_error > 0.0 {
            true => match slopes(models, &domain) {
                Err(Error::Interrupted) => {
                    return Ok((self.answer(level, &variables, &from)?, Ending::Interrupted));
                }
                slopes => slopes?.into_iter().map(Some).collect(),
            },
            false => vec![None; self.bands.len()],
        };
        let measurements = self.measurements.iter().zip(&offsets).zip(slopes);
        let measurements: Vec<_> = measurements
            .map(|((band, offsets), slopes)| {
                band.with_model_error(coarse_error).of_views(offsets, slopes)
            })
            .collect();
        let model = models.model(&domain)?;
        let mut objective = Objective::new(model, measurements.clone(), variables, prior);
        if let Some(expected) = self.expected {
            let expected = self.begin_at(expected.extinction.clone());
            objective.expect(&self.means(&expected, *block)?);
        }
        let resumed = matches!(beginning, Beginning::Checkpoint(_));
        let begun = match beginning {
            Beginning::Unknowns(unknowns, search) => {
                let unknowns = self.means(unknowns, *block)?;
                self.begin(&mut objective, unknowns, search).map(|minimiser| (minimiser, 0))
            }
            Beginning::Checkpoint(checkpoint) => self.restore(&mut objective, checkpoint),
        };
        let (mut minimiser, mut iteration) = match begun {
            Err(Error::Interrupted) => {
                return Ok((self.answer(level, &objective.variables, &from)?, Ending::Interrupted));
            }
            begun => begun?,
        };
        if !resumed {
            self.note(level, &objective, &minimiser, 0)?;
            self.keep(level, &objective, &minimiser, (0, &from, &offsets))?;
        }
        let most = if *near { self.settings.iterations } else { self.settings.coarse_iterations };
        let mut ending = loop {
            if let Some(ending) = self.ended(iteration, most, level.number) {
                break ending;
            }
            match minimiser.step(&mut objective) {
                Ok(Step::NoDescent) => break Ending::Stalled,
                Err(Error::Interrupted) => break Ending::Interrupted,
                other => other?,
            };
            iteration += 1;
            self.note(level, &objective, &minimiser, iteration)?;
            if iteration.is_multiple_of(KEPT) {
                self.keep(level, &objective, &minimiser, (iteration, &from, &offsets))?;
                match self.evaluate_again(&mut minimiser, &mut objective) {
                    Err(Error::Interrupted) => break Ending::Interrupted,
                    done => done?,
                }
            }
        };
        let x = minimiser.point().x.clone();
        if ending != Ending::Interrupted {
            let done = self.calibrate(&mut objective, &x, &offsets).and_then(|()| {
                match level.number + 1 == self.stages.len() {
                    true => self.spread(level, &mut objective, &measurements, &minimiser),
                    false => Ok(()),
                }
            });
            match done {
                Err(Error::Interrupted) => ending = Ending::Interrupted,
                done => done?,
            }
        }
        Ok((self.answer(level, &objective.variables, &x)?, ending))
    }

    /// Finds the calibrations, if they are unknown, at the solution `x` of a stage, whose model has these
    /// offsets.
    fn calibrate(
        &mut self,
        objective: &mut Objective,
        x: &[f64],
        offsets: &[Vec<[f64; 2]>],
    ) -> Result<()> {
        let InversionSettings { camera_gain_error, pointing_error, .. } = *self.settings;
        if camera_gain_error == 0.0 && pointing_error == 0.0 {
            return Ok(());
        }
        self.calibrations = objective.calibrations(x)?;
        let cameras = self.calibrations.iter_mut().flatten();
        for (camera, [row, col]) in cameras.zip(offsets.iter().flatten()) {
            camera.offset[0] += row;
            camera.offset[1] += col;
        }
        Ok(())
    }

    /// The offsets of the views of each band, as far as they are known.
    fn offsets(&self) -> Vec<Vec<[f64; 2]>> {
        let bands = self.calibrations.iter();
        bands.map(|cameras| cameras.iter().map(|camera| camera.offset).collect()).collect()
    }

    /// Finds the members at the solution of the last stage. A member minimises
    /// the objective function with other measurements and another prior; in a linear problem, members
    /// have the distribution of the solution given the images (randomised maximum likelihood: Oliver, He
    /// and Reynolds 1996). Each begins with the steps stored before it, as the second derivatives of all
    /// are nearly the same.
    fn spread(
        &mut self,
        level: &Level,
        objective: &mut Objective,
        measurements: &[Measurement],
        solution: &Minimiser,
    ) -> Result<()> {
        let x = &solution.point().x;
        let mut minimiser = solution.clone().with_memory(MEMBER_MEMORY);
        for number in 0..self.settings.members {
            objective.disturb(measurements, &mut stream(0, Purpose::Members, &[number as u64]));
            minimiser.restart(objective, x)?;
            let mut values = vec![minimiser.point().value];
            while values.len() <= MEMBER_STEPS
                && !has_stalled(&values, MEMBER_CHANGE * self.settings.change, 0.0)
            {
                if self.watch.interrupted() {
                    return Err(Error::Interrupted);
                }
                if let Step::NoDescent = minimiser.step(objective)? {
                    break;
                }
                values.push(minimiser.point().value);
            }
            let found = self.answer(level, &objective.variables, &minimiser.point().x)?;
            let effective_radius = self.radius(&found)?;
            self.members.push(Fields { extinction: found.extinction, effective_radius });
            self.watch.has_members(self.members.len());
        }
        Ok(())
    }

    /// Scales the start, estimates the second derivatives, and computes the first gradient.
    fn begin(
        &mut self,
        objective: &mut Objective,
        mut unknowns: Unknowns,
        search: bool,
    ) -> Result<Minimiser> {
        if search {
            scale(objective, &mut unknowns)?;
            // A resumed inversion does not search.
            objective.forget();
        }
        let x = objective.variables.of(&unknowns);
        objective.probe(&x, self.settings, self.bands)?;
        objective.forget();
        self.shift = 0.0;
        let bounds = objective.variables.bounds();
        Minimiser::start(objective, &x, bounds, minimiser_settings(self.settings))
    }

    /// Restores the minimisation of a checkpoint and the number of its iterations.
    fn restore(
        &mut self,
        objective: &mut Objective,
        checkpoint: Checkpoint,
    ) -> Result<(Minimiser, usize)> {
        let Checkpoint { probed_at, point, pairs, iteration, history, .. } = checkpoint;
        objective.probe(&probed_at, self.settings, self.bands)?;
        // A corrected model is corrected at the first point of the stage.
        objective.value(&probed_at)?;
        let bounds = objective.variables.bounds();
        // The evaluation of the start is made again, and counted then.
        let last = history.last().filter(|record| record.iteration > 0);
        let values = last.map_or(0, |record| record.evaluations);
        let settings = minimiser_settings(self.settings);
        let mut minimiser = Minimiser::resume(point, pairs, bounds, settings, values);
        self.evaluate_again(&mut minimiser, objective)?;
        Ok((minimiser, iteration))
    }

    /// Evaluates the objective function again, without the solution from which the model would start.
    fn evaluate_again(
        &mut self,
        minimiser: &mut Minimiser,
        objective: &mut Objective,
    ) -> Result<()> {
        let before = minimiser.point().value;
        objective.forget();
        minimiser.refresh(objective)?;
        self.shift = minimiser.point().value - before;
        Ok(())
    }

    /// The reason to end the stage, if there is one.
    fn ended(&self, iteration: usize, most: usize, stage: usize) -> Option<Ending> {
        let here: Vec<&Record> =
            self.history.iter().filter(|record| record.stage == stage).collect();
        let last = here.last()?;
        if self.watch.interrupted() {
            return Some(Ending::Interrupted);
        }
        if last.misfit <= self.settings.misfit && self.uncertainty().is_none() {
            return Some(Ending::Noise);
        }
        if iteration >= most {
            return Some(Ending::Iterations);
        }
        let evaluated_again = iteration / KEPT * KEPT;
        let recent = iteration.saturating_sub(PATIENCE)..iteration;
        let shift = if recent.contains(&evaluated_again) { self.shift } else { 0.0 };
        let values: Vec<f64> = here.iter().map(|record| record.value).collect();
        has_stalled(&values, self.settings.change, shift).then_some(Ending::Stalled)
    }

    /// Records an iteration and passes it to the progress callback.
    fn note(
        &mut self,
        level: &Level,
        objective: &Objective,
        minimiser: &Minimiser,
        iteration: usize,
    ) -> Result<()> {
        let (mut relative_error, mut mass_error) = (None, None);
        if let Some(truth) = self.truth {
            let estimate =
                self.answer(level, &objective.variables, &minimiser.point().x)?.extinction;
            relative_error = Some(metrics::relative_error(truth, &estimate)?);
            mass_error = Some(metrics::mass_error(truth, &estimate)?);
        }
        let record = Record {
            stage: level.number,
            block: level.block,
            iteration,
            seconds: self.seconds + self.began.elapsed().as_secs_f64(),
            misfit: objective.misfit(),
            value: minimiser.point().value,
            evaluations: minimiser.values(),
            relative_error,
            mass_error,
        };
        self.history.push(record);
        self.watch.reached(&record);
        Ok(())
    }

    /// Passes the state to the progress callback.
    fn keep(
        &self,
        level: &Level,
        objective: &Objective,
        minimiser: &Minimiser,
        (iteration, began_at, offsets): (usize, &[f64], &[Vec<[f64; 2]>]),
    ) -> Result<()> {
        self.watch.keep(&Checkpoint {
            stage: level.number,
            iteration,
            began_at: began_at.to_vec(),
            probed_at: objective.probed_at().to_vec(),
            point: minimiser.point().clone(),
            pairs: minimiser.pairs().cloned().collect(),
            offsets: offsets.to_vec(),
            history: self.history.clone(),
        })
    }

    /// The unknowns at `x` on the grid of the solution, with an extinction of 0 outside the mask.
    fn answer(&self, level: &Level, variables: &Variables, x: &[f64]) -> Result<Unknowns> {
        let mut unknowns = variables.unknowns(x)?;
        for volume in [&mut unknowns.extinction, &mut unknowns.deviations] {
            if level.block > 1 {
                *volume = refine(volume, &level.shares, &self.mask.grid)?;
            }
            volume.grid = self.mask.grid;
            self.mask.apply(volume)?;
        }
        Ok(unknowns)
    }
}

/// The stages of an inversion. From a uniform start, these are the blocks from coarse to fine, the
/// full-resolution grid without correction, and the corrections; from an estimate, only the
/// corrections. If the models are not corrected, there is one stage on the full-resolution grid.
fn stages(start: &Start, corrected: bool, settings: &InversionSettings) -> Vec<Stage> {
    let near = Stage { block: 1, near: true };
    let corrections = if corrected { settings.corrections } else { 1 };
    let coarse = match start {
        Start::Estimate(_) => &[][..],
        Start::Constant(_) | Start::Search => &settings.coarse,
    };
    let first = (corrected && !matches!(start, Start::Estimate(_))).then_some(1);
    let far = coarse.iter().copied().chain(first).map(|block| Stage { block, near: false });
    far.chain(std::iter::repeat_n(near, corrections)).collect()
}

/// Whether the last iterations have reduced the values of the objective function by less than the relative
/// change. The last values are larger by `shift` than the earlier ones.
fn has_stalled(values: &[f64], change: f64, shift: f64) -> bool {
    let Some(earlier) = values.len().checked_sub(PATIENCE + 1) else { return false };
    let (before, last) = (values[earlier], values[values.len() - 1]);
    before - last + shift < change * before
}

fn minimiser_settings(settings: &InversionSettings) -> MinimiserSettings {
    MinimiserSettings { memory: settings.memory, ..Default::default() }
}

fn check_grid(what: &str, expected: &Grid, found: &Grid) -> Result<()> {
    if expected.matches(found) {
        return Ok(());
    }
    let remedy = "give all volumes on the grid of the mask";
    Err(Error::mismatch(what, expected, found, remedy))
}

#[cfg(test)]
mod tests;
