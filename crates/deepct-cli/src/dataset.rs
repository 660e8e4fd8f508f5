//! `deepct dataset`: samples for training.

use crate::Outcome;
use crate::config::Settings;
use crate::global::Global;
use crate::progress::Progress;
use clap::Subcommand;
use deepct_core::Result;
use deepct_core::dataset::{self, DatasetSettings, Generated};
use std::path::PathBuf;
use std::time::Instant;

/// The commented defaults of `dataset generate`.
pub(crate) const DEFAULTS: &str = include_str!("defaults/dataset.toml");

/// Make samples for training, or check those that are there
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Make the samples that are not there yet; stop and start it as you like
    Generate {
        /// Settings of the data set (TOML); `deepct config dataset` prints them all
        #[arg(value_name = "CONFIG.toml")]
        config: PathBuf,
        /// Folder with the simulations that the settings name
        #[arg(long, value_name = "DIR", default_value = ".")]
        simulations: PathBuf,
        /// Replace one setting
        #[arg(long, value_name = "KEY=VALUE")]
        set: Vec<String>,
        /// Folder of the data set
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
    },
    /// Compare every sample with the manifest
    Check {
        /// Folder of the data set
        folder: PathBuf,
    },
}

pub(crate) fn run(args: &Args, global: &Global) -> Result<Outcome> {
    match &args.action {
        Action::Generate { config, simulations, set, out } => {
            let settings: DatasetSettings =
                Settings::new(Some(config.clone()), set.clone()).resolve(DEFAULTS)?;
            let snapshots = settings.snapshots() as u64;
            let progress = Progress::start(global, "snapshots", snapshots);
            let start = Instant::now();
            let generated =
                dataset::generate(&settings, simulations, out, &|_| progress.advance(1))?;
            drop(progress);
            report(generated, start.elapsed().as_secs_f64());
        }
        Action::Check { folder } => {
            let samples = dataset::Manifest::read(folder)?.samples.len() as u64;
            let progress = Progress::start(global, "samples", samples);
            let manifest = dataset::check(folder, &|done| progress.advance(done))?;
            drop(progress);
            println!("{} samples, all as the manifest says", manifest.samples.len());
        }
    }
    Ok(Outcome::Success)
}

fn report(Generated { samples, made }: Generated, seconds: f64) {
    println!("{samples} samples, {made} of them made now in {seconds:.0} s");
    if made > 0 {
        println!("{:.0} samples per hour", made as f64 / seconds * 3600.0);
    }
}
