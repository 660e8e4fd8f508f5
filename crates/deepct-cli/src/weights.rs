//! `deepct weights`: inspection of network weights.

use crate::outcome::Outcome;
use deepct_core::Result;
use deepct_core::io::load_weights;
use deepct_core::network::{ImageLayout, Planes, WeightsMetadata, receptive_field};
use std::path::PathBuf;

/// Inspect weights of the network
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// Print the formation and grid that the weights were trained for, their layers and scores
    Inspect {
        /// Weights: a file, or the name of built-in ones (cloudct-10, pearls-32)
        #[arg(value_name = "FILE|NAME")]
        weights: PathBuf,
        /// Print one JSON object
        #[arg(long)]
        json: bool,
    },
}

/// The metadata, and quantities derived from them.
#[derive(Debug, serde::Serialize)]
struct Report<'a> {
    layers: usize,
    parameters: usize,
    receptive_field: usize,
    #[serde(flatten)]
    metadata: &'a WeightsMetadata,
}

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    let Action::Inspect { weights, json } = &args.action;
    let weights = load_weights(weights)?;
    let architecture = &weights.metadata.architecture;
    let report = Report {
        layers: architecture.layers(),
        parameters: architecture.parameters(),
        receptive_field: receptive_field(architecture.layers()),
        metadata: &weights.metadata,
    };
    if *json {
        println!("{}", serde_json::to_string_pretty(&report).expect("plain numbers and text"));
    } else {
        print_report(&report);
    }
    Ok(Outcome::Success)
}

/// The output quantities of the network as text.
fn outputs(metadata: &WeightsMetadata) -> String {
    let words = metadata.outputs.iter().map(|output| output.name());
    words.collect::<Vec<_>>().join(" and ")
}

fn print_report(report: &Report<'_>) {
    let WeightsMetadata { formation, view_geometry, levels, training, .. } = report.metadata;
    let metadata = report.metadata;
    let degrees = |angles: &[f64]| {
        angles.iter().map(|angle| format!("{angle:.1}")).collect::<Vec<_>>().join(" ")
    };
    let (zenith, azimuth) = (view_geometry.sun_zenith_deg, view_geometry.sun_azimuth_deg);
    let [dx, dy] = metadata.horizontal_spacing_km;
    let top = levels.bottom_km + levels.count as f64 * levels.spacing_km;
    println!("formation        {formation}, {} views", view_geometry.view_zenith_deg.len());
    println!("view zenith      {} degrees", degrees(&view_geometry.view_zenith_deg));
    println!("view azimuth     {} degrees", degrees(&view_geometry.view_azimuth_deg));
    println!("Sun              zenith {zenith:.1} degrees, azimuth {azimuth:.1} degrees");
    println!(
        "target           {} km high, at {} um",
        metadata.target_altitude_km, metadata.wavelength_um
    );
    println!("voxels           {dx} x {dy} x {} km", levels.spacing_km);
    println!("levels           {} from {} to {top} km", levels.count, levels.bottom_km);
    println!("images           {}", layout(&metadata.image_layout));
    println!("layers           {}, {} parameters", report.layers, report.parameters);
    println!("channels         {}", runs(&metadata.architecture.channels));
    println!("receptive field  {0} x {0} pixels", report.receptive_field);
    println!("input            radiance (sr-1) x {}", metadata.input_scale);
    println!("output           {} (km-1) / {}", outputs(metadata), metadata.output_scale);
    println!("trained on       {}, {} samples", training.data, training.samples);
    println!("data identity    {}", training.identity);
    println!("written by       {}", metadata.program);
    for (name, score) in &metadata.scores {
        println!("{name:15}  {score:.4}");
    }
}

fn layout(layout: &ImageLayout) -> String {
    let ImageLayout::Planes(Planes { altitudes_km }) = layout else {
        return "in camera geometry".into();
    };
    let altitudes: Vec<_> = altitudes_km.iter().map(|at| format!("{at:.2}")).collect();
    format!("resampled onto {} planes at {} km", altitudes.len(), altitudes.join(" "))
}

/// The numbers as text, with runs of equal numbers combined, such as `10 12 14 (3 times)`.
fn runs(numbers: &[usize]) -> String {
    let runs = numbers.chunk_by(|a, b| a == b).map(|run| match run.len() {
        1 => run[0].to_string(),
        times => format!("{} ({times} times)", run[0]),
    });
    runs.collect::<Vec<_>>().join(" ")
}
