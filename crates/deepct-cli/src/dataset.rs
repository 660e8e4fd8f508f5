//! `deepct dataset`: data sets for training.

use crate::config::Settings;
use crate::defaults;
use crate::global::Global;
use crate::outcome::Outcome;
use crate::progress::Progress;
use crate::summary::{Form, Summary};
use clap::Subcommand;
use deepct_core::Result;
use deepct_core::dataset::{self, DatasetSettings, Generated, Plan, Share, Split};
use serde::Serialize;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

/// Generate a data set for training, or check an existing one
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Select the samples, write the selection to plan.json and print the number per split
    Plan {
        #[command(flatten)]
        order: Order,
        #[command(flatten)]
        form: Form,
    },
    /// Generate the samples that do not exist yet; can be interrupted and restarted at any time
    Generate {
        #[command(flatten)]
        order: Order,
        /// Generate one of several shares only, such as 3/8, each in a separate process; a final
        /// call without this option collects their samples and writes the manifest
        #[arg(long, value_name = "NUMBER/OF")]
        share: Option<Share>,
        #[command(flatten)]
        form: Form,
    },
    /// Compare every sample with the manifest
    Check {
        /// Folder of the data set
        folder: PathBuf,
        #[command(flatten)]
        form: Form,
    },
}

/// Settings, input folder and output folder of a data set.
#[derive(Debug, clap::Args)]
struct Order {
    /// Settings of the data set (TOML); `deepct config dataset` prints all keys
    #[arg(value_name = "CONFIG.toml")]
    config: PathBuf,
    /// Folder of the simulations that are listed in the settings
    #[arg(long, value_name = "DIR", default_value = ".")]
    simulations: PathBuf,
    /// Replace one setting
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Folder of the data set
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

impl Order {
    fn plan(&self, global: &Global) -> Result<Plan> {
        let settings: DatasetSettings = Settings::new(Some(self.config.clone()), self.set.clone())
            .resolve(defaults::DATASET)?;
        let snapshots = settings.snapshots().count() as u64;
        let progress = Progress::start(global, "snapshots read", snapshots);
        dataset::plan(&settings, &self.simulations, &self.out, &|done| progress.advance(done))
    }
}

pub(crate) fn run(args: &Args, global: &Global) -> Result<Outcome> {
    match &args.action {
        Action::Plan { order, form } => {
            let plan = order.plan(global)?;
            let [train, validation, test] =
                [Split::Train, Split::Validation, Split::Test].map(|split| plan.count(split));
            form.print(&Planned { train, validation, test }, global);
        }
        Action::Generate { order, share, form } => {
            form.print(&generate(order, *share, global)?, global);
        }
        Action::Check { folder, form } => {
            let samples = dataset::Manifest::read(folder)?.samples.len() as u64;
            let progress = Progress::start(global, "samples", samples);
            let manifest = dataset::check(folder, &|done| progress.advance(done))?;
            drop(progress);
            form.print(&Checked { samples: manifest.samples.len() }, global);
        }
    }
    Ok(Outcome::Success)
}

/// The number of samples of each split.
#[derive(Debug, Serialize)]
struct Planned {
    train: usize,
    validation: usize,
    test: usize,
}

impl Summary for Planned {
    fn say(&self) {
        let Self { train, validation, test } = self;
        say!("{train} train, {validation} validation and {test} test samples");
    }
}

/// The number of samples that agree with the manifest: all of them.
#[derive(Debug, Serialize)]
struct Checked {
    samples: usize,
}

impl Summary for Checked {
    fn say(&self) {
        say!("{} samples, all consistent with the manifest", self.samples);
    }
}

/// The number of samples, and of those made by this run, which took a time.
#[derive(Debug, Serialize)]
struct Made {
    samples: usize,
    made: usize,
    seconds: f64,
}

impl Summary for Made {
    fn say(&self) {
        let Self { samples, made, seconds } = self;
        say!("{samples} samples, {made} of them made now in {seconds:.0} s");
        if *made > 0 {
            say!("{:.0} samples per hour", 3600.0 * *made as f64 / seconds);
        }
    }
}

fn generate(order: &Order, share: Option<Share>, global: &Global) -> Result<Made> {
    let plan = order.plan(global)?;
    let missing = plan.missing(&order.out, share) as u64;
    let start = Instant::now();
    let per_hour = |made: u64| 3600.0 * made as f64 / start.elapsed().as_secs_f64();
    let progress = Progress::start(global, "samples", missing);
    let made = AtomicU64::new(0);
    let generated = dataset::generate(&plan, &order.simulations, &order.out, share, &|done| {
        let made = made.fetch_add(done, Ordering::Relaxed) + done;
        let text = format!("{made} of {missing}, {:.0} per hour", per_hour(made));
        progress.advance_with(done, Some(&text));
    })?;
    drop(progress);
    let Generated { samples, made } = generated;
    Ok(Made { samples, made, seconds: start.elapsed().as_secs_f64() })
}
