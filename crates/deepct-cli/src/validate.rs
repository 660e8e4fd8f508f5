//! `deepct validate`: validation of the physics against published and independent results.

use crate::global::Global;
use crate::outcome::Outcome;
use crate::summary::print_json;
use deepct_core::validation::{Effort, Row, Suite, validate};
use deepct_core::{Error, Result};
use std::path::PathBuf;

/// Validate the physics against published and independent results
///
/// Prints one row per case: value, standard error, reference, tolerance, verdict and run time in
/// seconds. The tolerance is three standard errors, plus in some cases an allowance for systematic
/// differences between solver and reference. The exit status is 1 if any case fails.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Suite of cases to run
    #[arg(long, value_enum, default_value_t = Choice::All)]
    suite: Choice,
    /// Folder with rico32_cloud.nc and rico32_views.nc for the suite rico, and with
    /// mie_water_672nm.nc for additional cases of the suite mie
    #[arg(long, value_name = "DIR")]
    reference: Option<PathBuf>,
    /// Folder in which the suite clouds stores its Monte Carlo images for reuse by later runs
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
    /// Increase the work by a factor of 25 or more, for a noise of 1e-3 of the values or less
    #[arg(long)]
    long: bool,
    /// Print one JSON array
    #[arg(long)]
    json: bool,
}

/// Name of a suite.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Choice {
    /// Plane-parallel layers
    Slabs,
    /// Plane-parallel layers by the deterministic solver, with thin and with thick cells
    Layers,
    /// Derivatives of the deterministic solver; with --reference also for a simulated cumulus
    Gradients,
    /// Isolated cubes and a sphere
    Cubes,
    /// Step cloud of I3RC
    Step,
    /// Droplet optics (Mie theory); more cases with --reference
    Mie,
    /// Simulated cumulus; requires --reference
    Rico,
    /// Cube cloud of the project IPRT
    Iprt,
    /// Deterministic solver against Monte Carlo solver for whole clouds; more clouds with
    /// --reference
    Clouds,
    /// All suites; rico only if --reference is given
    All,
}

impl Choice {
    fn suites(self, reference: bool) -> Vec<Suite> {
        match self {
            Self::Slabs => vec![Suite::Slabs],
            Self::Layers => vec![Suite::Layers],
            Self::Gradients => vec![Suite::Gradients],
            Self::Cubes => vec![Suite::Cubes],
            Self::Step => vec![Suite::Step],
            Self::Mie => vec![Suite::Mie],
            Self::Rico => vec![Suite::Rico],
            Self::Iprt => vec![Suite::Iprt],
            Self::Clouds => vec![Suite::Clouds],
            Self::All => {
                Suite::ALL.into_iter().filter(|suite| reference || *suite != Suite::Rico).collect()
            }
        }
    }
}

pub(crate) fn run(args: &Args, global: &Global) -> Result<Outcome> {
    if args.suite == Choice::Rico && args.reference.is_none() {
        let range = "a folder with rico32_cloud.nc and rico32_views.nc";
        return Err(Error::out_of_range("--reference", "not given", range));
    }
    let effort = if args.long { Effort::LONG } else { Effort::QUICK };
    let effort = Effort { seed: global.seed, ..effort };
    let mut rows = Vec::new();
    if !args.json {
        say!("{HEADER}");
    }
    for suite in args.suite.suites(args.reference.is_some()) {
        validate(suite, effort, args.reference.as_deref(), args.cache.as_deref(), &mut |row| {
            if !args.json {
                say!("{}", line(&row));
            }
            rows.push(row);
        })?;
    }
    let failed = rows.iter().filter(|row| !row.passed).count();
    if args.json {
        print_json(&rows);
    } else {
        let skipped = args.suite == Choice::All && args.reference.is_none();
        let note = if skipped { "; suite rico skipped, as it requires --reference" } else { "" };
        say!("{} of {} rows passed{note}", rows.len() - failed, rows.len());
    }
    Ok(if failed == 0 { Outcome::Success } else { Outcome::CheckFailed })
}

const HEADER: &str = "suite     case                                                            \
                      value     error  reference tolerance verdict seconds";

fn line(row: &Row) -> String {
    let verdict = if row.passed { "passed" } else { "FAILED" };
    format!(
        "{:9} {:58} {:10.6} {:9.6} {:10.6} {:9.6} {verdict:7} {:7.2}",
        row.suite.name(),
        row.case,
        row.value,
        row.standard_error,
        row.reference,
        row.tolerance,
        row.seconds
    )
}
