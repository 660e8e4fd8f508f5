//! Grey-scale pictures of images: TIFF and PNG with 16 bits per pixel, north up.

use crate::error::{Error, Result};
use crate::scene::Observation;
use ndarray::ArrayView2;
use std::path::{Path, PathBuf};
use tiff::encoder::{TiffEncoder, colortype::Gray16};
use tiff::tags::Tag;

/// The grey level of the brightest pixel.
const WHITE: f32 = u16::MAX as f32;

/// Write a page for each view. Returns the radiance (1/sr) of the largest grey level.
pub(super) fn write_tiff(path: &Path, observation: &Observation) -> Result<f32> {
    let white = white(observation);
    let output = crate::files::Output::create(path)?;
    let file = std::fs::File::create(output.temporary()).map_err(Error::io(path))?;
    let pages = || -> tiff::TiffResult<()> {
        let mut encoder = TiffEncoder::new(std::io::BufWriter::new(file))?;
        for (number, view) in observation.views.iter().enumerate() {
            let mut page = encoder.new_image::<Gray16>(view.cols as u32, view.rows as u32)?;
            let description = format!(
                "view {number}: zenith {:.4} deg, azimuth {:.4} deg; radiance (sr-1) = {:e} * grey level",
                view.zenith().to_degrees(),
                view.azimuth().to_degrees(),
                white / WHITE,
            );
            page.encoder().write_tag(Tag::ImageDescription, description.as_str())?;
            page.write_data(&levels(observation.images.image(number), white))?;
        }
        Ok(())
    };
    pages().map_err(|problem| failed(path, &problem))?;
    output.finish()?;
    Ok(white)
}

/// Write a file for each view, with its number added to the name. Returns the files and the radiance
/// (1/sr) of the largest grey level.
pub(super) fn write_pngs(path: &Path, observation: &Observation) -> Result<(Vec<PathBuf>, f32)> {
    let white = white(observation);
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let mut files = Vec::new();
    for (number, view) in observation.views.iter().enumerate() {
        let file = path.with_file_name(format!("{stem}-{number:02}.png"));
        let levels = levels(observation.images.image(number), white);
        let picture = image::ImageBuffer::<image::Luma<u16>, _>::from_raw(
            view.cols as u32,
            view.rows as u32,
            levels,
        );
        let output = crate::files::Output::create(&file)?;
        picture
            .expect("a grey level for each pixel")
            .save_with_format(output.temporary(), image::ImageFormat::Png)
            .map_err(|problem| failed(&file, &problem))?;
        output.finish()?;
        files.push(file);
    }
    Ok((files, white))
}

/// The largest radiance, or 1 if all images are black.
fn white(observation: &Observation) -> f32 {
    let brightest = observation.images.brightest();
    if brightest > 0.0 { brightest } else { 1.0 }
}

/// Grey levels in the order of a picture, whose first line is the northernmost row. Negative
/// radiances, which noise causes, are black.
fn levels(image: ArrayView2<'_, f32>, white: f32) -> Vec<u16> {
    let lines = image.rows().into_iter().rev().flatten();
    lines.map(|radiance| (WHITE * (radiance / white).clamp(0.0, 1.0)).round() as u16).collect()
}

fn failed(path: &Path, problem: &dyn std::fmt::Display) -> Error {
    let problem = format!("cannot be written: {problem}");
    Error::file(path, "file", problem, "check that the disk has room and the folder can be written")
}
