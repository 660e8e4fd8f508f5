//! Code shared by `deepct invert` and `deepct hybrid`.

use crate::config::{self, Values};
use crate::defaults;
use crate::files::lineage;
use crate::global::Global;
use crate::light::{LightFlags, resolve_light};
use crate::outcome::Outcome;
use crate::progress::{InversionProgress, stop, stopped};
use crate::summary::{self, Form};
use deepct_core::carve::{CarveSettings, carve};
use deepct_core::files::check_output;
use deepct_core::grid::{Grid, Mask, Volume};
use deepct_core::inversion::{
    Calibration, Ending, Explanation, InversionSettings, OrdinatesModels, Problem, Radius,
    Reconstruction, Start, invert, resume, shown,
};
use deepct_core::io::{
    Provenance, inversion_identity, read_checkpoint, read_cloud, read_mask, read_observations,
    write_reconstruction,
};
use deepct_core::math::DVec3;
use deepct_core::scene::{Light, Observation};
use deepct_core::transport::OrdinatesSettings;
use deepct_core::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Options of both verbs.
#[derive(Debug, clap::Args)]
pub(crate) struct Flags {
    /// Restrict the cloud to this mask; by default to the mask that `deepct carve` finds
    #[arg(long, value_name = "M.nc")]
    mask: Option<PathBuf>,
    /// Maximum number of optimiser steps, which replaces the setting inversion.iterations
    #[arg(long, value_name = "K")]
    iterations: Option<usize>,
    /// Unknowns that describe the effective radius, which replaces the setting inversion.radius: given
    /// (none), uniform (one radius), adiabatic (a profile above the cloud base) or field (each voxel)
    #[arg(long, value_name = "NAME")]
    radius: Option<String>,
    /// Standard errors of the result, from the spread of this many further inversions of images with
    /// other noise, which replaces the setting inversion.members
    #[arg(long, value_name = "N")]
    members: Option<usize>,
    /// File of the true cloud; the errors with respect to it are reported after each step
    #[arg(long, value_name = "C.nc")]
    pub(crate) truth: Option<PathBuf>,
    /// Continue an interrupted run from its checkpoint
    #[arg(long)]
    resume: bool,
    /// File of the extinction to write; until the run is complete, a checkpoint file with the
    /// additional ending .checkpoint is kept beside it
    #[arg(long, value_name = "V.nc")]
    out: PathBuf,
    #[command(flatten)]
    pub(crate) form: Form,
    #[command(flatten)]
    settings: config::Settings,
    #[command(flatten)]
    light: LightFlags,
}

impl Flags {
    /// The file to write.
    pub(crate) fn out(&self) -> &Path {
        &self.out
    }

    /// The file of the given mask.
    pub(crate) fn mask(&self) -> Option<&Path> {
        self.mask.as_deref()
    }

    /// The settings of the run, and the values of the scene illumination that replace those in the
    /// file of the images.
    pub(crate) fn resolve(&self) -> Result<(InvertSettings, Values)> {
        check_output(&self.out)?;
        let (mut settings, mut values): (InvertSettings, Values) =
            self.settings.resolve_with_light(defaults::INVERT)?;
        if let Some(name) = &self.radius {
            settings.inversion.radius = parse_radius(name)?;
        }
        settings.inversion.members = self.members.unwrap_or(settings.inversion.members);
        settings.inversion.check()?;
        settings.solver.check()?;
        values.extend(self.light.values(&[])?);
        Ok((settings, values))
    }
}

/// Reads the images of each band, of which a file may contain several; the given values replace those of their scene illumination.
pub(crate) fn read_bands(
    paths: &[PathBuf],
    given: &Values,
    global: &Global,
) -> Result<Vec<Observation>> {
    let mut bands = Vec::new();
    for path in paths {
        for mut observation in read_observations(path)? {
            resolve_light(&mut observation, path, given, global.quiet)?;
            bands.push(observation);
        }
    }
    Ok(bands)
}

fn parse_radius(name: &str) -> Result<Radius> {
    let name = toml::Value::String(name.to_owned());
    name.clone()
        .try_into()
        .map_err(|_| Error::out_of_range("--radius", name, "given, uniform, adiabatic or field"))
}

/// The settings of a run.
#[derive(Debug, Clone, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct InvertSettings {
    pub(crate) carve: CarveSettings,
    pub(crate) solver: SolverSettings,
    pub(crate) inversion: InversionSettings,
}

/// The settings of the deterministic solver.
#[derive(Debug, Clone, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct SolverSettings {
    zenith_angles: usize,
    step_zenith_angles: usize,
    tolerance: f64,
    rays_per_pixel: usize,
    cell_depth: f64,
}

impl SolverSettings {
    /// Checks the settings of both solvers before anything is computed.
    fn check(&self) -> Result<()> {
        let steps =
            OrdinatesSettings { zenith_angles: self.step_zenith_angles, ..self.ordinates() };
        steps.check()?;
        self.ordinates().check()
    }

    fn ordinates(&self) -> OrdinatesSettings {
        OrdinatesSettings {
            zenith_angles: self.zenith_angles,
            tolerance: self.tolerance,
            rays_per_pixel: self.rays_per_pixel,
            cell_depth: self.cell_depth,
            ..Default::default()
        }
    }
}

/// An inversion and its inputs, ready to run.
pub(crate) struct Job<'a> {
    /// Name shown in the progress report.
    pub(crate) what: &'static str,
    /// Path of the images of each band.
    pub(crate) images: &'a [PathBuf],
    pub(crate) flags: &'a Flags,
    /// Whether to use the looser solver settings of the quick hybrid for the steps.
    pub(crate) quick: bool,
    pub(crate) settings: InvertSettings,
    /// The images of each band.
    pub(crate) bands: Vec<Observation>,
    /// Grid of the estimate.
    pub(crate) grid: Grid,
    pub(crate) start: Start,
    /// The start as given on the command line.
    pub(crate) init: String,
}

/// Parameters of the run, recorded in the output file.
#[derive(Debug, Serialize)]
struct Resolved<'a> {
    images: &'a [PathBuf],
    init: &'a str,
    mask: Option<&'a Path>,
    #[serde(flatten)]
    settings: &'a InvertSettings,
    /// The scene illumination of each band.
    light: Vec<&'a Light>,
}

impl Job<'_> {
    /// Runs the inversion, writes the output file and prints a summary.
    pub(crate) fn run(mut self, global: &Global) -> Result<Outcome> {
        let flags = self.flags;
        self.settings.inversion.iterations = self.iterations();
        let mask = self.mask()?;
        let unseen = mask.count() - shown(&mask, &self.bands)?.count();
        if unseen > 0 && unseen < mask.count() {
            note!(
                "deepct: no image shows {unseen} of {} voxels of the mask: their extinction is not \
                 retrieved and is 0",
                mask.count()
            );
        }
        let truth = flags.truth.as_deref().map(|path| self.truth(path)).transpose()?;
        let problem = Problem { bands: &self.bands, mask: &mask, truth: truth.as_ref() };
        let checkpoint = beside(&flags.out);
        let identity = inversion_identity(&problem, &self.start, &self.configuration());
        if checkpoint.exists() && !flags.resume && !global.quiet {
            note!(
                "deepct: {} is of an earlier run and will be replaced; --resume would continue it",
                checkpoint.display()
            );
        }
        let reconstruction = self
            .invert(global, &problem, Some((&checkpoint, &identity)))
            .map_err(Error::in_file(&self.images[0]))?;
        let provenance = Provenance {
            title: "Extinction by inversion".into(),
            configuration: self.resolved(&self.settings),
            seed: global.seed,
            lineage: lineage(self.what, &self.images[0]),
        };
        write_reconstruction(&flags.out, &reconstruction, &mask, &self.bands[0], &provenance)?;
        if reconstruction.ending == Ending::Interrupted && stopped() {
            note!("deepct: stopped early; repeat the command with --resume to continue");
        } else if checkpoint.exists() {
            std::fs::remove_file(&checkpoint).map_err(Error::io(&checkpoint))?;
        }
        flags.form.print(&Summary::of(self.images, &flags.out, &reconstruction, &mask), global);
        if reconstruction.ending == Ending::Interrupted {
            return Ok(Outcome::Interrupted);
        }
        let explanation = reconstruction.explanation();
        if let Some(problem) = explanation.problem() {
            note!(
                "deepct: {problem}; check the light, the views and the grid, or begin elsewhere \
                 (`deepct invert --init auto`)"
            );
        }
        match explanation {
            Explanation::None(_) => Ok(Outcome::CheckFailed),
            _ => Ok(Outcome::Success),
        }
    }

    fn invert(
        &self,
        global: &Global,
        problem: &Problem,
        kept: Option<(&Path, &str)>,
    ) -> Result<Reconstruction> {
        let mut models = self.models()?;
        let settings = &self.settings.inversion;
        let coarse = match self.start {
            Start::Estimate(_) => 0,
            _ => settings.coarse.len() * settings.coarse_iterations,
        };
        let steps = settings.iterations + coarse;
        let watch = InversionProgress::start(global, self.what, steps, kept);
        if let Some((path, identity)) = kept.filter(|(path, _)| self.flags.resume && path.exists())
        {
            let checkpoint = read_checkpoint(path, identity)?;
            return resume(problem, &mut models, (&self.start, checkpoint), settings, &watch);
        }
        invert(problem, &mut models, &self.start, settings, &watch)
    }

    /// Runs the inversion of a tile of a field, within a mask. Nothing is known of what is beyond the
    /// tile: the pixels of lines of sight that pass through it are left out.
    pub(crate) fn tile(mut self, global: &Global, mask: &Mask, field: &Grid) -> Result<Volume> {
        self.settings.inversion.iterations = self.iterations();
        let parts = self.bands.into_iter().map(|band| within(band, &self.grid, field));
        self.bands = parts.collect();
        let problem = Problem { bands: &self.bands, mask, truth: None };
        if shown(mask, &self.bands)?.count() == 0 {
            return Ok(Volume::constant(self.grid, 0.0));
        }
        Ok(self.invert(global, &problem, None)?.extinction)
    }

    fn iterations(&self) -> usize {
        self.flags.iterations.unwrap_or(self.settings.inversion.iterations)
    }

    fn truth(&self, path: &Path) -> Result<Volume> {
        self.bands[0].light.extinction(&read_cloud(path)?).map_err(Error::in_file(path))
    }

    fn models(&self) -> Result<OrdinatesModels> {
        let (solver, radius) = (&self.settings.solver, self.settings.inversion.radius);
        let mut models = OrdinatesModels::of(&self.bands, &self.grid, radius, solver.ordinates())?;
        models.settings.zenith_angles = solver.step_zenith_angles;
        models.stop = stop();
        Ok(if self.quick { models.quick() } else { models })
    }

    /// The given mask, or else a carved one, on the grid of the estimate.
    fn mask(&self) -> Result<Mask> {
        let Some(path) = &self.flags.mask else {
            let images = &self.images[0];
            let carved = carve(&self.bands[0], &self.grid, &self.settings.carve);
            let carved = carved.map_err(Error::in_file(images))?;
            // A mask that no image shows is refused later on.
            let is_shown = shown(&carved.mask, &self.bands)?.count() > 0;
            if let Some(warning) = carved.warning().filter(|_| is_shown) {
                note!("deepct: warning: {}: {warning}", images.display());
            }
            return Ok(carved.mask);
        };
        let mask = read_mask(path)?;
        if mask.grid.matches(&self.grid) {
            return Ok(mask);
        }
        Err(Error::mismatch(
            format!("{}: grid of the mask", path.display()),
            self.grid,
            mask.grid,
            "carve a mask on the grid of the estimate, or omit --mask",
        ))
    }

    pub(crate) fn resolved(&self, settings: &InvertSettings) -> String {
        let resolved = Resolved {
            images: self.images,
            init: &self.init,
            mask: self.flags.mask.as_deref(),
            settings,
            light: self.bands.iter().map(|band| &band.light).collect(),
        };
        toml::to_string(&resolved).expect("plain numbers and text")
    }

    /// The parameters that identify the inversion in a checkpoint: all except the stopping criteria.
    fn configuration(&self) -> String {
        let mut settings = self.settings.clone();
        settings.inversion.iterations = 0;
        settings.inversion.misfit = 0.0;
        settings.inversion.change = 0.0;
        self.resolved(&settings)
    }
}

/// The observation of a part of a field, without the pixels whose lines of sight pass through other
/// parts of it.
fn within(observation: Observation, part: &Grid, field: &Grid) -> Observation {
    let (lower, upper) = (part.lower(), part.upper());
    // Beyond the sides of the field, there is nothing.
    let tolerance = 1e-6 * field.spacing;
    let [west, south] = [0, 1].map(|axis| lower[axis] > field.lower()[axis] + tolerance[axis]);
    let [east, north] = [0, 1].map(|axis| upper[axis] < field.upper()[axis] - tolerance[axis]);
    let leaves = |point: DVec3| {
        (west && point.x < lower.x)
            || (south && point.y < lower.y)
            || (east && point.x > upper.x)
            || (north && point.y > upper.y)
    };
    let views = observation.views.clone();
    observation.without(|[view, row, col]| {
        let ray = views[view].ray(row as f64 + 0.5, col as f64 + 0.5);
        let at = |altitude: f64| ray.at((altitude - ray.origin.z) / ray.direction.z);
        leaves(at(lower.z)) || leaves(at(upper.z))
    })
}

/// The path of the checkpoint file of an output file.
fn beside(out: &Path) -> PathBuf {
    let mut name = out.as_os_str().to_owned();
    name.push(".checkpoint");
    name.into()
}

fn is_unknown(camera: &Calibration) -> bool {
    *camera != Calibration::NOMINAL
}

/// What is printed about an inversion.
#[derive(Debug, Serialize)]
struct Summary<'a> {
    images: &'a [PathBuf],
    out: &'a Path,
    /// Number of voxels of the grid, and of those inside the mask.
    voxels: usize,
    mask_voxels: usize,
    /// Number of steps, on coarser grids too.
    steps: usize,
    /// Run time (s), and the state at the end.
    seconds: f64,
    misfit: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    relative_error: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    mass_error: Option<f64>,
    /// Why the inversion ended.
    ending: &'static str,
    /// Largest extinction (1/km).
    largest: f32,
    /// Mean effective radius (um), weighted by the extinction, if it was retrieved.
    #[serde(skip_serializing_if = "Option::is_none")]
    effective_radius: Option<f64>,
    /// Epsilon that the standard errors let expect.
    #[serde(skip_serializing_if = "Option::is_none")]
    expected_relative_error: Option<f64>,
    /// Gain and offset (pixels; row, column) of the camera of each view of each band, if they were
    /// unknown.
    #[serde(skip_serializing_if = "<[_]>::is_empty")]
    calibrations: &'a [Vec<Calibration>],
}

impl<'a> Summary<'a> {
    fn of(images: &'a [PathBuf], out: &'a Path, result: &'a Reconstruction, mask: &Mask) -> Self {
        let Reconstruction { extinction, history, ending, .. } = result;
        let last = history.last();
        Self {
            images,
            out,
            voxels: mask.grid.len(),
            mask_voxels: mask.count(),
            steps: history.iter().filter(|record| record.iteration > 0).count(),
            seconds: last.map_or(0.0, |last| last.seconds),
            misfit: last.map_or(f64::NAN, |last| last.misfit),
            relative_error: last.and_then(|last| last.relative_error),
            mass_error: last.and_then(|last| last.mass_error),
            ending: ending.description(),
            largest: extinction.values.iter().copied().fold(0.0, f32::max),
            effective_radius: result.mean_effective_radius(),
            expected_relative_error: result.expected_relative_error(),
            calibrations: match result.calibrations.iter().flatten().any(is_unknown) {
                true => &result.calibrations,
                false => &[],
            },
        }
    }
}

impl summary::Summary for Summary<'_> {
    fn say(&self) {
        say!("mask     {} of {} voxels", self.mask_voxels, self.voxels);
        say!("steps    {} in {:.1} s: {}", self.steps, self.seconds, self.ending);
        say!("misfit   {:.3}", self.misfit);
        if let (Some(epsilon), Some(delta)) = (self.relative_error, self.mass_error) {
            say!("epsilon  {epsilon:.4}");
            say!("delta    {delta:.4}");
        }
        say!("largest  {:.3} km-1", self.largest);
        if let Some(radius) = self.effective_radius {
            say!("radius   {radius:.2} um");
        }
        if let Some(expected) = self.expected_relative_error {
            say!("expected epsilon {expected:.4}");
        }
        for (band, cameras) in self.calibrations.iter().enumerate() {
            for (view, Calibration { gain, offset: [row, col] }) in cameras.iter().enumerate() {
                say!(
                    "camera   band {band}, view {view}: gain {gain:.4}, offset {row:+.2} {col:+.2} pixels"
                );
            }
        }
    }
}
