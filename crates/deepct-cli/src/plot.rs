//! `deepct plot`: figures of volumes and of images.

use crate::outcome::Outcome;
use deepct_core::grid::Volume;
use deepct_core::io::{read_cloud, read_light, read_observation};
use deepct_core::plot::{contact_sheet, volume_figure};
use deepct_core::scene::{Light, Observation};
use deepct_core::{Error, Result};
use std::path::{Path, PathBuf};

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

/// Content of a file that can be drawn.
enum Content {
    Volume(Volume),
    Images(Box<Observation>),
}

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    deepct_core::files::check_output(&args.out)?;
    if args.out.extension().is_none_or(|extension| !extension.eq_ignore_ascii_case("png")) {
        let range = "the name of a PNG file, ending in .png";
        return Err(Error::out_of_range("--out", args.out.display(), range));
    }
    let name = || args.file.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let title = args.title.clone().unwrap_or_else(name);
    let light = read_light(&args.file)?.map_or_else(Light::default, |(light, _)| light);
    match read_content(&args.file, &light)? {
        Content::Volume(estimate) => {
            let truth = args.truth.as_deref().map(|path| read_extinction(path, &light));
            let truth = truth.transpose()?;
            volume_figure(&args.out, &estimate, truth.as_ref(), &title)
                .map_err(Error::in_file(&args.file))?;
        }
        Content::Images(_) if args.truth.is_some() => {
            return Err(Error::file(
                &args.file,
                "radiance",
                "are images, which cannot be compared with a truth",
                "omit --truth, or give a volume",
            ));
        }
        Content::Images(observation) => {
            contact_sheet(&args.out, &observation.images, &labels(&observation), &[], &title)?;
        }
    }
    Ok(Outcome::Success)
}

/// Reads a volume, or else images. If the file is neither, the error of the kind that it resembles
/// is returned: that of images if it has a radiance variable, otherwise that of a volume.
fn read_content(path: &Path, light: &Light) -> Result<Content> {
    let problem = match read_extinction(path, light) {
        Ok(volume) => return Ok(Content::Volume(volume)),
        Err(problem) => problem,
    };
    match read_observation(path) {
        Ok(observation) => Ok(Content::Images(Box::new(observation))),
        Err(Error::File { field, problem: missing, .. })
            if field == "radiance" && missing == "is missing" =>
        {
            Err(problem)
        }
        Err(of_images) => Err(of_images),
    }
}

/// The extinction in the light of the file that is drawn.
fn read_extinction(path: &Path, light: &Light) -> Result<Volume> {
    light.extinction(&read_cloud(path)?).map_err(Error::in_file(path))
}

/// Labels with the viewing direction and the pixel size of each image.
pub(crate) fn labels(observation: &Observation) -> Vec<String> {
    let geometry = observation.geometry();
    let directions = geometry.view_zenith_deg.iter().zip(&geometry.view_azimuth_deg);
    directions
        .zip(&geometry.pixel_km)
        .map(|((zenith, azimuth), pixel)| {
            format!("zenith {zenith:.1}°\nazimuth {azimuth:.0}°, {:.0} m", 1000.0 * pixel)
        })
        .collect()
}
