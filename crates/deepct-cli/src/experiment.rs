//! `deepct experiment`: comparison of the four methods over a set of clouds, with a report.

use crate::config::Settings;
use crate::defaults;
use crate::global::Global;
use crate::outcome::Outcome;
use crate::progress::{InversionProgress, stopped};
use crate::summary::{self, Form};
use deepct_core::dataset::Share;
use deepct_core::experiment::{self, Experiment, ExperimentSettings, Method};
use deepct_core::inversion::{Checkpoint, Record, Watch};
use deepct_core::{Error, Result};
use std::cell::RefCell;
use std::path::PathBuf;

/// Compare network, inversion, hybrid and quick hybrid over a set of clouds and write a report;
/// the run can be interrupted and restarted at any time
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Settings of the experiment (TOML); `deepct config experiment` prints all keys
    #[arg(value_name = "CONFIG.toml")]
    config: PathBuf,
    /// Replace one setting
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Folder for the results and the report
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Compute the results of one of several shares of the clouds only, such as 3/8, each in a separate
    /// process; a final call without this option writes the report
    #[arg(long, value_name = "NUMBER/OF")]
    share: Option<Share>,
    #[command(flatten)]
    form: Form,
}

pub(crate) fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let settings = Settings::new(Some(args.config.clone()), args.set.clone());
    let settings: ExperimentSettings = settings.resolve(defaults::EXPERIMENT)?;
    settings.check().map_err(Error::in_file(&args.config))?;
    let watch = ExperimentProgress { global, settings: &settings, inversion: RefCell::default() };
    let Experiment { outcomes, made, interrupted } =
        experiment::run(&settings, &args.out, args.share, &watch)?;
    drop(watch);
    if interrupted {
        note!("deepct: stopped early; repeat the command to continue");
        return Ok(Outcome::Interrupted);
    }
    let report = args.share.is_none().then(|| args.out.join("report.md"));
    args.form.print(&Summary { outcomes, made, report }, global);
    Ok(Outcome::Success)
}

/// What is printed about an experiment.
#[derive(Debug, serde::Serialize)]
struct Summary {
    outcomes: Vec<experiment::Outcome>,
    /// Number of results that this run computed.
    made: usize,
    /// The report, unless other shares are missing.
    report: Option<PathBuf>,
}

impl summary::Summary for Summary {
    fn say(&self) {
        say!("{} results, {} of them made now", self.outcomes.len(), self.made);
        if let Some(report) = &self.report {
            say!("report: {}", report.display());
        }
    }
}

/// Reports the current cloud and method, and the progress of the inversion.
struct ExperimentProgress<'a> {
    global: &'a Global,
    settings: &'a ExperimentSettings,
    inversion: RefCell<Option<InversionProgress<'a>>>,
}

impl Watch for ExperimentProgress<'_> {
    fn reached(&self, record: &Record) {
        if let Some(inversion) = &*self.inversion.borrow() {
            inversion.reached(record);
        }
    }

    fn keep(&self, _checkpoint: &Checkpoint) -> Result<()> {
        Ok(())
    }

    fn interrupted(&self) -> bool {
        stopped()
    }
}

impl experiment::Watch for ExperimentProgress<'_> {
    fn begins(&self, cloud: &str, method: Method, number: usize, total: usize) {
        let inversion = &self.settings.inversion;
        let steps = match method {
            Method::Network => 1,
            Method::Physics => {
                inversion.iterations + inversion.coarse.len() * inversion.coarse_iterations
            }
            Method::Hybrid => inversion.iterations,
            Method::QuickHybrid => self.settings.quick_iterations,
            _ => inversion.iterations,
        };
        if self.global.verbose > 0 {
            note!("{number} of {total}: {cloud}, {}", method.name());
        }
        let progress = InversionProgress::start(self.global, method.name(), steps, None);
        *self.inversion.borrow_mut() = Some(progress.quiet_without_terminal());
    }

    fn made(&self, outcome: &experiment::Outcome) {
        *self.inversion.borrow_mut() = None;
        if !self.global.quiet {
            say!(
                "{:<24} {:<13} epsilon {:.3}  delta {:>6.3}  {:>8.2} s",
                outcome.cloud,
                outcome.method.name(),
                outcome.relative_error,
                outcome.mass_error,
                outcome.seconds
            );
        }
    }
}
