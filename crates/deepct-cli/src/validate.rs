//! `deepct validate`: the physics against published and independent results.

use crate::global::Global;
use crate::outcome::Outcome;
use deepct_core::validation::{Effort, Row, Suite, validate};
use deepct_core::{Error, Result};
use std::path::PathBuf;

/// Compare the physics with published and independent results
///
/// Prints a row per case: value, standard error, reference, difference that is
/// tolerated (three standard errors, and what the references differ by among
/// themselves), verdict, seconds. The exit status is 1 if a case fails.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The cases
    #[arg(long, value_enum, default_value_t = Choice::All)]
    suite: Choice,
    /// Folder with rico32_cloud.nc and rico32_views.nc, for the suite rico, and with
    /// mie_water_672nm.nc, for more of the suite mie
    #[arg(long, value_name = "DIR")]
    reference: Option<PathBuf>,
    /// Folder where the suite clouds keeps its Monte Carlo images, to be found there again
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
    /// Twenty-five times the work or more, for a noise of 1e-3 of the values or less
    #[arg(long)]
    long: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// A suite by its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Choice {
    /// Plane-parallel layers
    Slabs,
    /// The same by the deterministic solver, in thin and in thick cells
    Layers,
    /// Derivatives by the deterministic solver, of a simulated cumulus too with --reference
    Gradients,
    /// Isolated cubes and a sphere
    Cubes,
    /// The step cloud of I3RC
    Step,
    /// Droplets, more of them with --reference
    Mie,
    /// A simulated cumulus; needs --reference
    Rico,
    /// A cube cloud of the project IPRT
    Iprt,
    /// The deterministic solver on whole clouds, against the Monte Carlo solver; more clouds with
    /// --reference
    Clouds,
    /// All of them; rico if --reference is given
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
        println!("{HEADER}");
    }
    for suite in args.suite.suites(args.reference.is_some()) {
        validate(suite, effort, args.reference.as_deref(), args.cache.as_deref(), &mut |row| {
            if !args.json {
                println!("{}", line(&row));
            }
            rows.push(row);
        })?;
    }
    let failed = rows.iter().filter(|row| !row.passed).count();
    if args.json {
        println!("{}", serde_json::to_string_pretty(&rows).expect("plain numbers and text"));
    } else {
        let skipped = args.suite == Choice::All && args.reference.is_none();
        let note = if skipped { "; rico left out, as it needs --reference" } else { "" };
        println!("{} of {} rows passed{note}", rows.len() - failed, rows.len());
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
