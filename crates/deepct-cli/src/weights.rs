//! `deepct weights`: inspection of network weights.

use crate::outcome::Outcome;
use crate::summary::print_json;
use deepct_core::Result;
use deepct_core::io::load_trained_weights;
use deepct_core::network::{
    GeneralMetadata, ImageLayout, NetworkOutput, Planes, TrainedWeights, WeightsMetadata,
    receptive_field,
};
use std::path::PathBuf;

/// Inspect weights of the network
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// Print the formations and grids that the weights were trained for, their layers and scores
    Inspect {
        /// Weights: a file, or the name of built-in ones (general, cloudct-10,
        /// pearls-32)
        #[arg(value_name = "FILE|NAME")]
        weights: PathBuf,
        /// Print one JSON object
        #[arg(long)]
        json: bool,
    },
}

/// The metadata, and quantities derived from them.
#[derive(Debug, serde::Serialize)]
struct Report<M> {
    layers: usize,
    parameters: usize,
    receptive_field: usize,
    #[serde(flatten)]
    metadata: M,
}

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    let Action::Inspect { weights, json } = &args.action;
    match load_trained_weights(weights)? {
        TrainedWeights::Formation(weights) => {
            let architecture = &weights.metadata.architecture;
            let report = Report {
                layers: architecture.layers(),
                parameters: architecture.parameters(),
                receptive_field: receptive_field(architecture.layers()),
                metadata: &weights.metadata,
            };
            print(&report, *json, print_report);
        }
        TrainedWeights::General(weights) => {
            let layers = weights.metadata.architecture.layers;
            let report = Report {
                layers,
                parameters: weights.parameters(),
                receptive_field: receptive_field(layers),
                metadata: &weights.metadata,
            };
            print(&report, *json, print_general_report);
        }
    }
    Ok(Outcome::Success)
}

fn print<M: serde::Serialize>(report: &Report<M>, json: bool, as_text: fn(&Report<M>)) {
    if json {
        print_json(report);
    } else {
        as_text(report);
    }
}

/// The output quantities of the network as text.
fn outputs(outputs: &[NetworkOutput]) -> String {
    let words = outputs.iter().map(|output| output.name());
    words.collect::<Vec<_>>().join(" and ")
}

fn print_report(report: &Report<&WeightsMetadata>) {
    let WeightsMetadata { formation, view_geometry, levels, training, .. } = report.metadata;
    let metadata = report.metadata;
    let degrees = |angles: &[f64]| {
        angles.iter().map(|angle| format!("{angle:.1}")).collect::<Vec<_>>().join(" ")
    };
    let (zenith, azimuth) = (view_geometry.sun_zenith_deg, view_geometry.sun_azimuth_deg);
    let [dx, dy] = metadata.horizontal_spacing_km;
    let top = levels.bottom_km + levels.count as f64 * levels.spacing_km;
    say!("formation        {formation}, {} views", view_geometry.view_zenith_deg.len());
    say!("view zenith      {} degrees", degrees(&view_geometry.view_zenith_deg));
    say!("view azimuth     {} degrees", degrees(&view_geometry.view_azimuth_deg));
    say!("Sun              zenith {zenith:.1} degrees, azimuth {azimuth:.1} degrees");
    let wavelengths: Vec<_> = metadata.wavelengths_um.iter().map(f64::to_string).collect();
    say!(
        "target           {} km high, at {} um",
        metadata.target_altitude_km,
        wavelengths.join(" and ")
    );
    say!("voxels           {dx} x {dy} x {} km", levels.spacing_km);
    say!("levels           {} from {} to {top} km", levels.count, levels.bottom_km);
    say!("images           {}", layout(&metadata.image_layout));
    say!("layers           {}, {} parameters", report.layers, report.parameters);
    say!("channels         {}", runs(&metadata.architecture.channels));
    say!("receptive field  {0} x {0} pixels", report.receptive_field);
    say!("input            radiance (sr-1) x {}", metadata.input_scale);
    let (radius, others): (Vec<_>, Vec<_>) = metadata
        .outputs
        .iter()
        .copied()
        .partition(|output| *output == NetworkOutput::EffectiveRadius);
    say!("output           {} (km-1) / {}", outputs(&others), metadata.output_scale);
    if let Some(scale) = metadata.effective_radius_scale {
        say!("                 {} (um) / {scale}", outputs(&radius));
    }
    say!("trained on       {}, {} samples", training.data, training.samples);
    say!("data identity    {}", training.identity);
    say!("written by       {}", metadata.program);
    for (name, score) in &metadata.scores {
        say!("{name:15}  {score:.4}");
    }
}

fn print_general_report(report: &Report<&GeneralMetadata>) {
    let GeneralMetadata { architecture, levels, ranges, training, .. } = report.metadata;
    let metadata = report.metadata;
    let range = |[low, high]: [f64; 2]| format!("{low} to {high}");
    say!("formation        any, {} views", range(ranges.views));
    say!("view zenith      {} degrees", range(ranges.view_zenith_deg));
    say!("Sun              zenith {} degrees", range(ranges.sun_zenith_deg));
    say!("pixels           {} voxels wide", range(ranges.pixel_per_voxel));
    say!("wavelength       {} um", range(ranges.wavelength_um));
    say!("voxels           {} km wide, {} as high", range(ranges.voxel_km), levels.height);
    say!("levels           {}", levels.count);
    say!(
        "images           resampled onto {} planes{}",
        architecture.planes,
        if architecture.extremes { ", with the minimum and maximum over the views" } else { "" }
    );
    say!("virtual views    {}", architecture.virtual_views);
    say!("layers           {}, {} parameters", report.layers, report.parameters);
    say!("channels         {} between the layers", architecture.width);
    say!("receptive field  {0} x {0} pixels", report.receptive_field);
    say!("input            radiance (sr-1) x {}", metadata.input_scale);
    say!(
        "output           {} (km-1) / {} for voxels of {} km",
        outputs(&metadata.outputs),
        metadata.output_scale,
        metadata.voxel_km
    );
    say!("trained on       {}, {} samples", training.data, training.samples);
    say!("data identity    {}", training.identity);
    say!("written by       {}", metadata.program);
    for (name, score) in &metadata.scores {
        say!("{name:15}  {score:.4}");
    }
}

fn layout(layout: &ImageLayout) -> String {
    let ImageLayout::Planes(Planes { altitudes_km, .. }) = layout else {
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
