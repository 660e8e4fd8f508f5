//! The options that all verbs have in common.

use deepct_core::{Error, Result};

/// Upper limit of `--threads`, above the thread count of any processor, to catch typing errors.
const MOST_THREADS: usize = 1024;

/// Options of every verb.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Options of every verb")]
pub(crate) struct Global {
    /// Number of threads; 0 uses one per processor
    #[arg(long, global = true, default_value_t = 0, value_name = "N")]
    pub(crate) threads: usize,
    /// Seed of all random numbers of this run
    #[arg(long, global = true, default_value_t = 1, value_name = "N")]
    pub(crate) seed: u64,
    /// Print errors only
    #[arg(short, long, global = true)]
    pub(crate) quiet: bool,
    /// Print more detail; may be repeated
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    pub(crate) verbose: u8,
}

impl Global {
    /// Starts the global thread pool that runs all parallel work.
    pub(crate) fn start_threads(&self) -> Result<()> {
        if self.threads > MOST_THREADS {
            let range = format!("at most {MOST_THREADS}");
            return Err(Error::out_of_range("--threads", self.threads, range));
        }
        rayon::ThreadPoolBuilder::new()
            .num_threads(self.threads)
            .build_global()
            .map_err(|problem| Error::out_of_range("--threads", self.threads, problem.to_string()))
    }
}
