//! `deepct convert`: clouds, volumes, masks and images in the formats of other programs.

use crate::cloud::Selection;
use crate::global::Global;
use crate::outcome::Outcome;
use crate::output::{check_origin, is_same_file};
use deepct_core::files::check_output;
use deepct_core::io::export::{Fields, export_fields, export_images};
use deepct_core::io::{
    Content, Lineage, Provenance, read_lineage, write_cloud, write_estimate, write_mask,
    write_observation,
};
use deepct_core::scene::Observation;
use deepct_core::{Error, Result};
use std::path::{Path, PathBuf};

/// Convert a cloud, a volume, a mask or images to a format of other programs
///
/// The ending of OUTPUT names the format (see `deepct formats`): .vti, .vol, .npz or .mat for
/// fields; .npz, .mat, .tif, .png or .exr for images. Clouds of other programs are read as by
/// `deepct cloud import --spacing file`, which has further options for them. They, and files that this
/// command wrote, are also converted to .nc.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// File to read
    input: PathBuf,
    /// File to write
    output: PathBuf,
    #[command(flatten)]
    selection: Selection,
}

pub(crate) fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let Args { input, output, selection } = args;
    if is_same_file(input, output) {
        let problem = "is the input of this command, which would be lost";
        return Err(Error::file(output, "OUTPUT", problem, "give another name"));
    }
    check_output(output)?;
    check_origin(output, "OUTPUT", global.force)?;
    match selection.own_content(input)? {
        Some(_) if is_netcdf(input) && is_netcdf(output) => {
            let remedy = "name another format (see `deepct formats`), or copy the file";
            return Err(Error::file(input, "file", "is one of deepct already", remedy));
        }
        Some(content) if is_netcdf(output) => {
            write_netcdf(input, output, &content, read_lineage(input), global)?;
        }
        Some(Content::Images(observation)) => write_images(output, &observation, global)?,
        Some(Content::Cloud(cloud)) => export_fields(output, &Fields::of_cloud(&cloud)?)?,
        Some(Content::Estimate(estimate)) => {
            export_fields(output, &Fields::of_estimate(&estimate))?;
        }
        Some(Content::Mask(mask)) => export_fields(output, &Fields::of_mask(&mask))?,
        None => convert_foreign(args, global)?,
    }
    Ok(Outcome::Success)
}

fn is_netcdf(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("nc"))
}

fn convert_foreign(args: &Args, global: &Global) -> Result<()> {
    let Args { input, output, selection } = args;
    let (cloud, lineage) = selection.import_as_it_is(input, global)?;
    match is_netcdf(output) {
        true => write_netcdf(input, output, &Content::Cloud(cloud), lineage, global),
        false => export_fields(output, &Fields::of_cloud(&cloud)?),
    }
}

/// Write what another file contains as a file of deepct.
fn write_netcdf(
    input: &Path,
    output: &Path,
    content: &Content,
    lineage: Lineage,
    global: &Global,
) -> Result<()> {
    let name = input.file_name().unwrap_or_default().to_string_lossy();
    let lineage = lineage.then(&format!("convert {name}"));
    let provenance = |what: &str| Provenance {
        title: format!("{what} imported from another file"),
        configuration: toml::to_string(&Resolved { file: input }).expect("a path"),
        seed: global.seed,
        lineage: lineage.clone(),
    };
    match content {
        Content::Cloud(cloud) => write_cloud(output, cloud, &provenance("Cloud")),
        Content::Estimate(estimate) => {
            write_estimate(output, estimate, None, &provenance("Extinction"))
        }
        Content::Mask(mask) => write_mask(output, mask, &provenance("Mask")),
        Content::Images(observation) => {
            write_observation(output, observation, &provenance("Images"))
        }
    }
}

fn write_images(output: &Path, observation: &Observation, global: &Global) -> Result<()> {
    let (files, white) = export_images(output, observation)?;
    if global.quiet {
        return Ok(());
    }
    if let [first, .., last] = files.as_slice() {
        say!("files  {} to {}", first.display(), last.display());
    }
    if let Some(white) = white {
        say!("white  {white} sr-1 (grey level 65535)");
    }
    Ok(())
}

/// Parameters of the run, recorded in the output file.
#[derive(Debug, serde::Serialize)]
struct Resolved<'a> {
    file: &'a Path,
}
