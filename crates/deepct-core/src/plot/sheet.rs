//! The contact sheet: all images of an observation on one page.

use super::page::{Anchor, Colour, Frame, LABEL, Page, TICK, TITLE};
use super::panel::{ColourBar, ColourScale, draw_map};
use crate::error::{Error, Result};
use crate::image::{ViewGeometry, ViewStack};
use glam::DVec2;
use std::path::Path;

/// Minimum length of the longer side of an image on the page (pixels). Smaller images are enlarged
/// by an integer factor.
const LEAST_SIDE: usize = 176;
/// Distance between images (pixels).
const GAP: i32 = 20;
/// Height of a line of the label of an image (pixels).
const LINE: i32 = 20;
/// Height of the title and the line below it (pixels).
const HEAD: i32 = 96;
/// Width of the colour bar with its numbers and label (pixels).
const BAR: i32 = 130;
/// Half of the length of the arms of a cross (pixels).
const CROSS: f64 = 9.0;
const CROSS_COLOUR: Colour = [220, 40, 40];
/// The colour of missing pixels.
const MISSING: Colour = [240, 190, 120];

/// Draw all images in one PNG file, with north up and east to the right, on a common grey scale
/// from zero to the brightest pixel; missing pixels are orange. The label of each image is drawn above it and may have
/// several lines. `marks` are points `(row, col)` of the images that are marked by a cross, one for each
/// image or none at all.
///
/// # Errors
/// Returns an error if there is not one label (and one mark, if there are any) per image, or if the file cannot be written.
pub fn contact_sheet(
    path: impl AsRef<Path>,
    images: &ViewStack,
    labels: &[String],
    marks: &[Option<(f64, f64)>],
    title: &str,
) -> Result<()> {
    let [views, rows, cols] = images.shape();
    if labels.len() != views {
        return Err(Error::mismatch(
            "number of labels",
            views,
            labels.len(),
            "give one label per image",
        ));
    }
    if !marks.is_empty() && marks.len() != views {
        let remedy = "give one mark per image, or none";
        return Err(Error::mismatch("number of marks", views, marks.len(), remedy));
    }
    let lines = labels.iter().map(|label| label.lines().count()).max().unwrap_or(0) as i32;
    let zoom = LEAST_SIDE.div_ceil(rows.max(cols));
    let (width, height) = ((cols * zoom) as i32, (rows * zoom) as i32);
    // The page is about twice as wide as high.
    let across = (views as f64 * 2.0).sqrt().ceil().min(views as f64) as i32;
    let down = (views as i32 + across - 1) / across;
    let cell = (width + GAP, height + GAP + lines * LINE);
    let size = [(GAP + across * cell.0 + BAR).max(640), HEAD + down * cell.1];
    let scale = ColourScale::new(colorous::GREYS, f64::from(images.brightest())).reversed();
    let mut page = Page::new(size)?;
    page.text(title, TITLE, Anchor::On, size[0] / 2, 32);
    let orientation = match images.values.iter().any(|value| value.is_nan()) {
        true => "north up, east to the right; missing pixels are orange",
        false => "north up, east to the right",
    };
    page.text(orientation, LABEL, Anchor::On, size[0] / 2, 66);
    for (view, label) in labels.iter().enumerate() {
        let (column, line) = (view as i32 % across, view as i32 / across);
        let left = GAP + column * cell.0;
        let top = HEAD + line * cell.1 + lines * LINE;
        draw_label(&mut page, label, left + width / 2, top);
        let image = images.image(view);
        let frame = Frame { left, top, width, height };
        draw_map(&mut page, frame, (rows, cols), |at| match image[at] {
            radiance if radiance.is_nan() => MISSING,
            radiance => scale.colour(f64::from(radiance)),
        });
        if let Some(Some((row, col))) = marks.get(view) {
            let at = DVec2::new(col / cols as f64, 1.0 - row / rows as f64);
            draw_cross(&mut page, frame, at);
        }
    }
    let top = HEAD + lines * LINE;
    let bar = Frame {
        left: GAP + across * cell.0 + 8,
        top,
        width: 18,
        height: HEAD + down * cell.1 - GAP - top,
    };
    ColourBar::linear(scale, "radiance (sr\u{207b}\u{b9})", bar.height).draw(&mut page, bar);
    page.write(path.as_ref())
}

/// Draw a cross at a point of a frame, given as the shares of its width and height; none outside.
fn draw_cross(page: &mut Page, frame: Frame, at: DVec2) {
    if !(0.0..=1.0).contains(&at.x) || !(0.0..=1.0).contains(&at.y) {
        return;
    }
    let corner = DVec2::new(f64::from(frame.left), f64::from(frame.top));
    let middle = corner + at * DVec2::new(f64::from(frame.width), f64::from(frame.height));
    for arm in [DVec2::X, DVec2::Y] {
        page.line(middle - CROSS * arm, middle + CROSS * arm, 2.0, CROSS_COLOUR);
    }
}

/// Labels for [`contact_sheet`] with the viewing direction and the pixel size of each image.
pub fn view_labels(geometry: &ViewGeometry) -> Vec<String> {
    let directions = geometry.view_zenith_deg.iter().zip(&geometry.view_azimuth_deg);
    directions
        .zip(&geometry.pixel_km)
        .map(|((zenith, azimuth), pixel)| {
            format!("zenith {zenith:.1}°\nazimuth {azimuth:.0}°, {:.0} m", 1000.0 * pixel)
        })
        .collect()
}

/// Draw the lines of a label above a point.
fn draw_label(page: &mut Page, label: &str, x: i32, bottom: i32) {
    for (number, line) in label.lines().rev().enumerate() {
        page.text(line, TICK, Anchor::Above, x, bottom - 4 - number as i32 * LINE);
    }
}
