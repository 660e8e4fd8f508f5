//! `deepct dataset`: data sets for training.

use crate::config::Settings;
use crate::defaults;
use crate::global::Global;
use crate::outcome::Outcome;
use crate::progress::Progress;
use clap::Subcommand;
use deepct_core::Result;
use deepct_core::dataset::{self, DatasetSettings, Generated, Plan, Share, Split};
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
    Plan(Order),
    /// Generate the samples that do not exist yet; can be interrupted and restarted at any time
    Generate {
        #[command(flatten)]
        order: Order,
        /// Generate one of several shares only, such as 3/8, each in a separate process; a final
        /// call without this option collects their samples and writes the manifest
        #[arg(long, value_name = "NUMBER/OF")]
        share: Option<Share>,
    },
    /// Compare every sample with the manifest
    Check {
        /// Folder of the data set
        folder: PathBuf,
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
        Action::Plan(order) => {
            let plan = order.plan(global)?;
            let [train, validation, test] =
                [Split::Train, Split::Validation, Split::Test].map(|split| plan.count(split));
            say!("{train} train, {validation} validation and {test} test samples");
        }
        Action::Generate { order, share } => generate(order, *share, global)?,
        Action::Check { folder } => {
            let samples = dataset::Manifest::read(folder)?.samples.len() as u64;
            let progress = Progress::start(global, "samples", samples);
            let manifest = dataset::check(folder, &|done| progress.advance(done))?;
            drop(progress);
            say!("{} samples, all consistent with the manifest", manifest.samples.len());
        }
    }
    Ok(Outcome::Success)
}

fn generate(order: &Order, share: Option<Share>, global: &Global) -> Result<()> {
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
    say!("{samples} samples, {made} of them made now in {:.0} s", start.elapsed().as_secs_f64());
    if made > 0 {
        say!("{:.0} samples per hour", per_hour(made as u64));
    }
    Ok(())
}
