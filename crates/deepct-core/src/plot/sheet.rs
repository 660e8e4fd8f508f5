//! The contact sheet: all images of an observation on one page.

use super::page::{Area, Drawn, Frame, LABEL, TICK, TITLE, draw_page, letters};
use super::panel::{ColourScale, draw_border, draw_colour_bar};
use crate::error::{Error, Result};
use crate::image::{Image, ViewStack};
use plotters::style::text_anchor::{HPos, VPos};
use std::path::Path;

/// The least side of an image on the page (pixels): smaller ones are enlarged by a
/// whole number.
const LEAST_SIDE: usize = 160;
/// Between images.
const GAP: i32 = 16;
/// Room for a line of an image's label.
const LINE: i32 = 20;
/// Room for the title and the line below it.
const HEAD: i32 = 96;
/// Room for the colour bar with its numbers and label.
const BAR: i32 = 130;

/// Draw all images as one PNG file, north up and east to the right, in one scale of
/// grey from zero to the brightest pixel. Each has its label above it; a label may
/// have several lines.
///
/// # Errors
/// When there is not one label per image; a file that cannot be written.
pub fn contact_sheet(
    path: impl AsRef<Path>,
    images: &ViewStack,
    labels: &[String],
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
    let lines = labels.iter().map(|label| label.lines().count()).max().unwrap_or(0) as i32;
    let zoom = LEAST_SIDE.div_ceil(rows.max(cols));
    let (width, height) = ((cols * zoom) as i32, (rows * zoom) as i32);
    // About twice as wide as high.
    let across = (views as f64 * 2.0).sqrt().ceil().min(views as f64) as i32;
    let down = (views as i32 + across - 1) / across;
    let cell = (width + GAP, height + GAP + lines * LINE);
    let size = [(GAP + across * cell.0 + BAR).max(640), HEAD + down * cell.1];
    let scale = ColourScale::new(colorous::GREYS, f64::from(images.brightest()));
    let scale = ColourScale { reversed: true, ..scale };
    draw_page(path.as_ref(), size, |page| {
        page.draw_text(title, &letters(TITLE, HPos::Center, VPos::Center), (size[0] / 2, 32))?;
        let below = letters(LABEL, HPos::Center, VPos::Center);
        page.draw_text("north up, east to the right", &below, (size[0] / 2, 66))?;
        for (view, label) in labels.iter().enumerate() {
            let (column, line) = (view as i32 % across, view as i32 / across);
            let left = GAP + column * cell.0;
            let top = HEAD + line * cell.1 + lines * LINE;
            draw_label(page, label, (left + width / 2, top))?;
            draw_image(page, Frame { left, top, width, height }, images.image(view), scale)?;
        }
        let left = GAP + across * cell.0 + 8;
        let bar = Frame { left, top: HEAD + lines * LINE, width: 18, height };
        draw_colour_bar(page, bar, scale, "radiance (sr\u{207b}\u{b9})")
    })
}

/// Write the lines of a label above a point.
fn draw_label(page: &Area<'_>, label: &str, (x, bottom): (i32, i32)) -> Drawn {
    let style = letters(TICK, HPos::Center, VPos::Bottom);
    for (number, line) in label.lines().rev().enumerate() {
        page.draw_text(line, &style, (x, bottom - 4 - number as i32 * LINE))?;
    }
    Ok(())
}

/// Draw an image north up: its last row on top.
fn draw_image(page: &Area<'_>, frame: Frame, image: Image<'_>, scale: ColourScale) -> Drawn {
    let (rows, cols) = image.dim();
    for y in 0..frame.height {
        let row = (frame.height - 1 - y) as usize * rows / frame.height as usize;
        for x in 0..frame.width {
            let col = x as usize * cols / frame.width as usize;
            let colour = scale.colour(f64::from(image[[row, col]]));
            page.draw_pixel((frame.left + x, frame.top + y), &colour)?;
        }
    }
    draw_border(page, frame)
}
