//! Command-line interface of deepct. Each stage of the processing is one verb, and each verb is
//! implemented in one file.
//!
//! Exit status: 0 on success, 1 if a requested check failed, 2 on an error. An error prints one
//! message that states the cause and the remedy.

#[macro_use]
mod print;

mod carve;
mod cloud;
mod completions;
mod config;
mod convert;
mod dataset;
mod defaults;
mod demo;
mod examples;
mod experiment;
mod field;
mod files;
mod formats;
mod global;
mod hybrid;
mod images;
mod infer;
mod inversion;
mod invert;
mod light;
mod man;
mod network;
mod outcome;
mod output;
mod photograph;
mod plot;
mod progress;
mod regrid;
mod render;
mod score;
mod sense;
mod summary;
mod validate;
mod view;
mod weights;

use clap::{Command, CommandFactory, FromArgMatches, Parser, Subcommand};
use deepct_core::Error;
use global::Global;
use outcome::Outcome;
use std::process::ExitCode;
use std::time::Duration;

/// 3D cloud tomography: simulate satellite images of clouds and reconstruct clouds from them.
#[derive(Debug, Parser)]
#[command(name = "deepct", version, arg_required_else_help = true)]
struct Cli {
    #[command(flatten)]
    global: Global,
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    Cloud(cloud::Args),
    Render(render::Args),
    Sense(sense::Args),
    Carve(carve::Args),
    Infer(infer::Args),
    Invert(invert::Args),
    Hybrid(hybrid::Args),
    Score(score::Args),
    Demo(demo::Args),
    Dataset(dataset::Args),
    Experiment(experiment::Args),
    Weights(weights::Args),
    Plot(plot::Args),
    View(view::ViewArgs),
    Report(view::ReportArgs),
    Convert(convert::Args),
    Regrid(regrid::Args),
    Images(images::Args),
    Formats(formats::Args),
    Validate(validate::Args),
    Config(config::Args),
    Completions(completions::Args),
    Man(man::Args),
}

fn run(cli: Cli) -> deepct_core::Result<Outcome> {
    cli.global.start()?;
    output::check_outputs(std::env::args_os(), cli.global.force)?;
    output::warn_of_incomplete(std::env::args_os());
    match cli.verb {
        Verb::Cloud(args) => cloud::run(&args, &cli.global),
        Verb::Render(args) => render::run(&args, &cli.global),
        Verb::Sense(args) => sense::run(&args, &cli.global),
        Verb::Carve(args) => carve::run(&args, &cli.global),
        Verb::Infer(args) => infer::run(&args, &cli.global),
        Verb::Invert(args) => invert::run(&args, &cli.global),
        Verb::Hybrid(args) => hybrid::run(&args, &cli.global),
        Verb::Score(args) => score::run(&args, &cli.global),
        Verb::Demo(args) => demo::run(&args, &cli.global),
        Verb::Dataset(args) => dataset::run(&args, &cli.global),
        Verb::Experiment(args) => experiment::run(&args, &cli.global),
        Verb::Weights(args) => weights::run(&args),
        Verb::Plot(args) => plot::run(&args, &cli.global),
        Verb::View(args) => view::view(&args, &cli.global),
        Verb::Report(args) => view::report(&args, &cli.global),
        Verb::Convert(args) => convert::run(&args, &cli.global),
        Verb::Regrid(args) => regrid::run(&args, &cli.global),
        Verb::Images(args) => images::run(&args),
        Verb::Formats(args) => formats::run(&args),
        Verb::Validate(args) => validate::run(&args, &cli.global),
        Verb::Config(args) => config::run(&args),
        Verb::Completions(args) => completions::run(&args),
        Verb::Man(args) => man::run(&args),
    }
}

/// The command line, with examples in the help of each verb.
fn command() -> Command {
    examples::add_to(Cli::command())
}

/// Ends the program if reading a damaged file does not end.
fn end_endless_reading() {
    loop {
        std::thread::sleep(Duration::from_secs(1));
        if let Some(error) = deepct_core::io::endless_reading() {
            note!("deepct: {error}");
            std::process::exit(2);
        }
    }
}

fn main() -> ExitCode {
    std::thread::spawn(end_endless_reading);
    let code = match run(
        Cli::from_arg_matches(&command().get_matches()).unwrap_or_else(|error| error.exit())
    ) {
        Ok(Outcome::Success) => ExitCode::SUCCESS,
        Ok(Outcome::CheckFailed) => ExitCode::from(1),
        // As of a program that is ended by SIGINT, so that `&&` and scripts do not go on.
        Ok(Outcome::Interrupted) => ExitCode::from(130),
        Err(Error::Interrupted) => {
            note!("deepct: interrupted before there was a result");
            ExitCode::from(130)
        }
        Err(error) => {
            note!("deepct: {error}");
            ExitCode::from(2)
        }
    };
    if code == ExitCode::SUCCESS && !print::succeeded() { ExitCode::from(2) } else { code }
}
