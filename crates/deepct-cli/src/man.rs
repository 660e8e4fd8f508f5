//! `deepct man`: manual pages.

use crate::{Cli, Outcome};
use clap::CommandFactory;
use deepct_core::Error;
use std::path::PathBuf;

/// Write the manual pages, one per verb
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder to write the manual pages to
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

pub(crate) fn run(args: &Args) -> deepct_core::Result<Outcome> {
    std::fs::create_dir_all(&args.out).map_err(Error::io(&args.out))?;
    clap_mangen::generate_to(Cli::command(), &args.out).map_err(Error::io(&args.out))?;
    Ok(Outcome::Success)
}
