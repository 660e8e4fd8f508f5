//! `deepct convert`: clouds, volumes, masks and images in the formats of other programs.

use crate::cloud::import_as_it_is;
use crate::global::Global;
use crate::outcome::Outcome;
use crate::output::{check_origin, is_same_file};
use deepct_core::files::check_output;
use deepct_core::io::export::{Fields, export_fields, export_images};
use deepct_core::io::{Content, Provenance, read_content, write_cloud};
use deepct_core::scene::Observation;
use deepct_core::{Error, Result};
use std::path::{Path, PathBuf};

/// Convert a cloud, a volume, a mask or images to a format of other programs
///
/// The ending of OUTPUT names the format (see `deepct formats`): .vti, .vol, .npz or .mat for
/// fields; .npz, .mat, .tif, .png or .exr for images. Clouds of other programs are read as by
/// `deepct cloud import --spacing file`, which has options for them.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// File to read
    input: PathBuf,
    /// File to write
    output: PathBuf,
}

pub(crate) fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let Args { input, output } = args;
    if is_same_file(input, output) {
        let problem = "is the input of this command, which would be lost";
        return Err(Error::file(output, "OUTPUT", problem, "give another name"));
    }
    check_output(output)?;
    check_origin(output, "OUTPUT", global.force)?;
    match read_content(input)? {
        Some(_) if is_netcdf(output) => {
            let remedy = "name another format (see `deepct formats`), or copy the file";
            return Err(Error::file(input, "file", "is one of deepct already", remedy));
        }
        Some(Content::Images(observation)) => write_images(output, &observation, global)?,
        Some(Content::Cloud(cloud)) => export_fields(output, &Fields::of_cloud(&cloud)?)?,
        Some(Content::Estimate(estimate)) => {
            export_fields(output, &Fields::of_estimate(&estimate))?;
        }
        Some(Content::Mask(mask)) => export_fields(output, &Fields::of_mask(&mask))?,
        None => convert_foreign(input, output, global)?,
    }
    Ok(Outcome::Success)
}

fn is_netcdf(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("nc"))
}

fn convert_foreign(input: &Path, output: &Path, global: &Global) -> Result<()> {
    let cloud = import_as_it_is(input, global)?;
    if !is_netcdf(output) {
        return export_fields(output, &Fields::of_cloud(&cloud)?);
    }
    let provenance = Provenance {
        title: "Cloud imported from another file".into(),
        configuration: toml::to_string(&Resolved { file: input }).expect("a path"),
        seed: global.seed,
    };
    write_cloud(output, &cloud, &provenance)
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
