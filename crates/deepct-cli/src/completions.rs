//! `deepct completions`: shell completion scripts.

use crate::{Cli, Outcome};
use clap::CommandFactory;

/// Print the completion script for a shell
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Name of the shell
    shell: clap_complete::Shell,
}

pub(crate) fn run(args: &Args) -> deepct_core::Result<Outcome> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "deepct", &mut script);
    crate::print::raw(&String::from_utf8_lossy(&script));
    Ok(Outcome::Success)
}
