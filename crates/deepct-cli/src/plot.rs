//! `deepct plot`: figures of volumes and of images.

use crate::outcome::Outcome;
use deepct_core::io::{Drawing, read_drawing, read_extinction};
use deepct_core::plot::{contact_sheet, view_labels, volume_figure};
use deepct_core::{Error, Result};
use std::path::PathBuf;

/// Draw a volume, alone or beside the truth, or a sheet of images, as a PNG file
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// File of a volume, a cloud or images
    file: PathBuf,
    /// File of the true cloud, drawn beside the volume and in a scatter plot against it
    #[arg(long, value_name = "C.nc")]
    truth: Option<PathBuf>,
    /// Title of the figure; by default the name of the file
    #[arg(long, value_name = "TEXT")]
    title: Option<String>,
    /// PNG file to write
    #[arg(long, value_name = "FIG.png")]
    out: PathBuf,
}

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    deepct_core::files::check_output(&args.out)?;
    if args.out.extension().is_none_or(|extension| !extension.eq_ignore_ascii_case("png")) {
        let range = "the name of a PNG file, ending in .png";
        return Err(Error::out_of_range("--out", args.out.display(), range));
    }
    let name = || args.file.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let title = args.title.clone().unwrap_or_else(name);
    let (content, light) = read_drawing(&args.file)?;
    match content {
        Drawing::Volume(estimate) => {
            let truth = args.truth.as_deref().map(|path| read_extinction(path, &light));
            let truth = truth.transpose()?;
            volume_figure(&args.out, &estimate, truth.as_ref(), &title)
                .map_err(Error::in_file(&args.file))?;
        }
        Drawing::Images(_) if args.truth.is_some() => {
            return Err(Error::file(
                &args.file,
                "radiance",
                "are images, which cannot be compared with a truth",
                "omit --truth, or give a volume",
            ));
        }
        Drawing::Images(observation) => {
            contact_sheet(
                &args.out,
                &observation.images,
                &view_labels(&observation.geometry()),
                &[],
                &title,
            )?;
        }
    }
    Ok(Outcome::Success)
}
