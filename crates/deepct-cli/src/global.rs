//! The options that all verbs have in common.

use deepct_core::io::allow_external_files;
use deepct_core::{Error, Result, memory};

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
    /// Upper limit of the memory that the size of a grid, an image or a variable may require, in GB;
    /// by default three quarters of the memory of the machine
    #[arg(long, global = true, value_name = "GB")]
    max_memory: Option<f64>,
    /// Read HDF5 files that refer to other files: external links, external storage, virtual data
    /// sets. Only for files that you trust
    #[arg(long, global = true)]
    allow_external: bool,
    /// Do what is refused otherwise: replace a file that deepct did not write, and use a network outside
    /// the range of its training
    #[arg(long, global = true)]
    pub(crate) force: bool,
    /// Print errors and warnings only
    #[arg(short, long, global = true)]
    pub(crate) quiet: bool,
    /// Print more detail; may be repeated
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    pub(crate) verbose: u8,
}

impl Global {
    /// The same options for a part of a computation that reports no progress of its own.
    pub(crate) fn silent(&self) -> Self {
        Self { quiet: true, ..self.clone() }
    }

    /// Sets the limits of this process, and starts the global thread pool that runs all parallel
    /// work.
    pub(crate) fn start(&self) -> Result<()> {
        if let Some(limit) = self.max_memory {
            if !(limit.is_finite() && limit > 0.0) {
                return Err(Error::out_of_range("--max-memory", limit, "positive (GB)"));
            }
            memory::set_limit((limit * 1e9) as u64);
        }
        if self.allow_external {
            allow_external_files();
        }
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
