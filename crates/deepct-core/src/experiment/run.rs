//! Execution of an experiment: every cloud by every method, with each result in a separate file.

use super::case::{Case, cases, check_files};
use super::{Experiment, ExperimentSettings, Method, Outcome, Watch, report};
use crate::carve::carve;
use crate::dataset::Share;
use crate::error::{Error, Result};
use crate::files;
use crate::grid::{Mask, Volume};
use crate::inversion::{
    Ending, InversionSettings, OrdinatesModels, Problem, Reconstruction, Start, hybrid, invert,
};
use crate::io::{self, Provenance};
use crate::metrics;
use crate::network::Estimator;
use crate::plot::{VolumeFields, volume_figure};
use crate::scene::Observation;
use crate::transport::OrdinatesSettings;
use ndarray::Axis;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Run the experiment of `settings` in `folder`. Results that exist in the folder are not computed
/// again, so that an interrupted run can be resumed. With a share, only the results of its clouds are
/// computed, at the same time as other processes compute theirs, and there is no report.
///
/// # Errors
/// Returns an error if the folder contains an experiment with other settings, if settings are out
/// of range, or if clouds, weights or results cannot be read or written.
pub fn run(
    settings: &ExperimentSettings,
    folder: &Path,
    share: Option<Share>,
    watch: &dyn Watch,
) -> Result<Experiment> {
    settings.check()?;
    settings.sensor()?;
    let network = Estimator::new(io::load_trained_weights(&settings.weights)?);
    let cases = cases(settings)?;
    check_files(settings)?;
    let runner = MethodRunner { settings, folder, network };
    runner.claim(&cases)?;
    let mut experiment = Experiment { outcomes: Vec::new(), made: 0, interrupted: false };
    let cases: Vec<&Case> = share.unwrap_or_default().part(cases.iter()).collect();
    let total = cases.len() * settings.methods.len();
    for case in cases {
        let mut work = None;
        for &method in &settings.methods {
            watch.begins(&case.name, method, experiment.outcomes.len() + 1, total);
            if let Some(outcome) = runner.found(case, method)? {
                experiment.outcomes.push(outcome);
                continue;
            }
            let work = match &mut work {
                Some(work) => work,
                none => none.insert(runner.open(case)?),
            };
            let Some(outcome) = runner.make(case, method, work, watch)? else {
                experiment.interrupted = true;
                return Ok(experiment);
            };
            watch.made(&outcome);
            experiment.outcomes.push(outcome);
            experiment.made += 1;
        }
    }
    if share.is_none() {
        report::write(folder, settings, &experiment.outcomes)?;
    }
    Ok(experiment)
}

/// Runs the methods; contains the data that are common to all clouds.
struct MethodRunner<'a> {
    settings: &'a ExperimentSettings,
    folder: &'a Path,
    network: Estimator,
}

/// A cloud that is being reconstructed.
struct Work {
    truth: Volume,
    /// The images, with the scene illumination of the inversions.
    observation: Observation,
    mask: Mask,
    /// Duration of the space carving (s).
    carving: f64,
}

impl MethodRunner<'_> {
    /// Create the folders and check that they belong to this experiment: to the same settings,
    /// clouds and weights.
    fn claim(&self, cases: &[Case]) -> Result<()> {
        for name in ["clouds", "results", "volumes", "figures"] {
            let path = self.folder.join(name);
            std::fs::create_dir_all(&path).map_err(Error::io(&path))?;
        }
        let settings = toml::to_string(self.settings).expect("plain numbers and text");
        let remedy = "choose another folder, or the settings with which the experiment was started";
        self.same("experiment.toml", &settings, "settings", remedy)?;
        let mut inputs = String::new();
        let weights = Path::new(&self.settings.weights);
        if weights.is_file() {
            inputs += &format!("{}  {}\n", files::sha256(weights)?, weights.display());
        }
        for case in cases {
            if let Some(sha256) = case.sha256()? {
                inputs += &format!("{sha256}  {}\n", case.name);
            }
        }
        let remedy = "choose another folder, or the files with which the experiment was started";
        self.same("inputs.sha256", &inputs, "clouds and weights", remedy)
    }

    /// Check that a file has this text, which is written if the file does not exist.
    fn same(&self, name: &str, text: &str, what: &str, remedy: &str) -> Result<()> {
        let path = self.folder.join(name);
        match std::fs::read_to_string(&path) {
            Ok(found) if found == text => Ok(()),
            Ok(_) => {
                let problem = "differ from those with which the experiment was started";
                Err(Error::file(path, what, problem, remedy))
            }
            Err(_) => files::write(&path, text),
        }
    }

    fn file(&self, folder: &str, case: &Case, method: Method, ending: &str) -> PathBuf {
        self.folder.join(folder).join(format!("{}-{}.{ending}", case.name, method.name()))
    }

    /// The result of a previous run, if there is one.
    fn found(&self, case: &Case, method: Method) -> Result<Option<Outcome>> {
        let path = self.file("results", case, method, "json");
        if !path.exists() {
            return Ok(None);
        }
        let text = files::read_text(&path)?;
        let remedy = "delete the file: the result is then computed again";
        let outcome = serde_json::from_str(&text)
            .map_err(|problem| Error::file(&path, "result", problem.to_string(), remedy))?;
        Ok(Some(outcome))
    }

    fn open(&self, case: &Case) -> Result<Work> {
        let path = self.folder.join("clouds").join(format!("{}.nc", case.name));
        let formation = self.settings.formation.as_deref().or(self.network.weights().formation());
        let (cloud, observation) = case.open(&path, self.settings, formation)?;
        let mut observation = observation;
        if let Some(radius) = self.settings.effective_radius {
            observation.light.optics.effective_radius = Some(radius);
        }
        let truth = observation.light.extinction(&cloud)?;
        let began = Instant::now();
        let mask = carve(&observation, &truth.grid, &self.settings.carve)?.mask;
        let carving = began.elapsed().as_secs_f64();
        Ok(Work { truth, observation, mask, carving })
    }

    /// Reconstruct one cloud by one method and store the result. Returns `None` if the progress
    /// callback interrupted the inversion.
    fn make(
        &self,
        case: &Case,
        method: Method,
        work: &Work,
        watch: &dyn Watch,
    ) -> Result<Option<Outcome>> {
        let began = Instant::now();
        let (reconstruction, expected_relative_error) = self.reconstruct(method, work, watch)?;
        let seconds = work.carving + began.elapsed().as_secs_f64();
        if reconstruction.ending == Ending::Interrupted {
            return Ok(None);
        }
        let Reconstruction { extinction, history, ending, .. } = &reconstruction;
        let (steps, misfit) = (history.len(), history.last().map(|record| record.misfit));
        let outcome = Outcome {
            cloud: case.name.clone(),
            method,
            optical_depth: thickest(&work.truth),
            relative_error: metrics::relative_error(&work.truth, extinction)?,
            mass_error: metrics::mass_error(&work.truth, extinction)?,
            expected_relative_error,
            seconds,
            steps: steps.saturating_sub(1),
            misfit,
            ending: misfit.map(|_| *ending),
        };
        let title = format!("{}: {}", case.name, method.name());
        let provenance = Provenance {
            title: title.clone(),
            configuration: toml::to_string(self.settings).expect("plain numbers and text"),
            seed: self.settings.seed,
            ..Provenance::default()
        };
        let volume = self.file("volumes", case, method, "nc");
        io::write_reconstruction(
            &volume,
            &reconstruction,
            &work.mask,
            &work.observation,
            &provenance,
        )?;
        let figure = self.file("figures", case, method, "png");
        let fields = VolumeFields {
            extinction: Some(extinction),
            truth: Some(&work.truth),
            mask: Some(&work.mask),
            ..Default::default()
        };
        volume_figure(&fields, &title)?.write(&figure)?;
        let text = serde_json::to_string_pretty(&outcome).expect("plain numbers and text");
        files::write(&self.file("results", case, method, "json"), &text)?;
        Ok(Some(outcome))
    }

    /// The reconstruction of a cloud and, for the network, the epsilon that it expects.
    fn reconstruct(
        &self,
        method: Method,
        work: &Work,
        watch: &dyn Watch,
    ) -> Result<(Reconstruction, Option<f64>)> {
        let Work { truth, observation, mask, .. } = work;
        let bands = std::slice::from_ref(observation);
        let problem = Problem { bands, mask, truth: Some(truth) };
        let settings = &self.settings.inversion;
        let solver = OrdinatesSettings::default();
        let mut models = OrdinatesModels::of(bands, &truth.grid, settings.radius, solver)?;
        let reconstruction = match method {
            Method::Network => {
                let geometry = observation.imaging_geometry()?;
                let grid = Some(&truth.grid);
                let estimate = self.network.estimate(&observation.images, &geometry, grid)?;
                let expected = estimate.expected_relative_error();
                let mut extinction = estimate.extinction;
                mask.apply(&mut extinction)?;
                let found = Reconstruction {
                    extinction,
                    effective_radius: None,
                    standard_errors: None,
                    calibrations: Vec::new(),
                    history: Vec::new(),
                    ending: Ending::Iterations,
                };
                return Ok((found, expected));
            }
            Method::Physics => {
                let start = Start::Constant(self.settings.start);
                invert(&problem, &mut models, &start, settings, watch)
            }
            Method::Hybrid => hybrid(&problem, &self.network, &mut models, settings, watch),
            Method::QuickHybrid => {
                let iterations = self.settings.quick_iterations;
                let quick = InversionSettings { iterations, ..settings.clone().quick() };
                hybrid(&problem, &self.network, &mut models.quick(), &quick, watch)
            }
        };
        Ok((reconstruction?, None))
    }
}

/// Largest optical depth of a column.
fn thickest(extinction: &Volume) -> f64 {
    let columns = extinction.values.sum_axis(Axis(0));
    let largest = columns.iter().copied().fold(0.0, f32::max);
    f64::from(largest) * extinction.grid.spacing.z
}
