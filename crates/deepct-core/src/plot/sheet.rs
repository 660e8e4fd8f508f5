//! The contact sheet: all images of an observation in one figure.

use super::figure::{Anchor, BLACK, Colour, Figure, Frame, TICK, TITLE, draw_arrow};
use super::panel::{ColourBar, ColourScale, draw_map, robust_limit};
use crate::error::{Error, Result};
use crate::image::{ViewGeometry, ViewStack};
use glam::DVec2;

/// Minimum length of the longer side of an image in the figure (pixels). Smaller images are enlarged
/// by an integer factor.
const LEAST_SIDE: usize = 176;
/// The same for an image that is alone.
const LEAST_SIDE_ALONE: usize = 520;
/// Minimum width of the figure (pixels).
const LEAST_WIDTH: i32 = 680;
/// Distance between images (pixels).
const GAP: i32 = 20;
/// Height of a line of the label of an image (pixels).
const LINE: i32 = 20;
/// Height of the label of an image (pixels).
const LABELS: i32 = 2 * LINE;
/// Height of the title and the line below it (pixels).
const HEAD: i32 = 96;
/// Width of the colour bar with its numbers and label (pixels).
const BAR: i32 = 130;
/// Half of the length of the arms of a cross (pixels).
const CROSS: f64 = 9.0;
const CROSS_COLOUR: Colour = [220, 40, 40];
/// The colour of missing pixels.
const MISSING: Colour = [240, 190, 120];

/// Draw all images in one figure, with north up and east to the right, on a common grey scale from
/// zero to the 99.8th percentile of the pixels; missing pixels are orange. The direction and the pixel
/// size of each view are above its image, and a scale bar is below it; the wavelength (um) and the
/// directions of north and of the Sun are at the top. `marks` are points `(row, col)` of the images that are marked by a
/// cross, one for each image or none at all.
///
/// # Errors
/// Returns an error if the geometry is not that of all images, or if there is not one mark (if there
/// are any) per image.
pub fn contact_sheet(
    images: &ViewStack,
    geometry: &ViewGeometry,
    wavelength: f64,
    marks: &[Option<(f64, f64)>],
    title: &str,
) -> Result<Figure> {
    let [views, rows, cols] = images.shape();
    let labels = view_labels(geometry);
    if labels.len() != views {
        let remedy = "give the geometry of all images";
        return Err(Error::mismatch("number of views", views, labels.len(), remedy));
    }
    if !marks.is_empty() && marks.len() != views {
        let remedy = "give one mark per image, or none";
        return Err(Error::mismatch("number of marks", views, marks.len(), remedy));
    }
    let least = if views == 1 { LEAST_SIDE_ALONE } else { LEAST_SIDE };
    let zoom = least.div_ceil(rows.max(cols));
    let (width, height) = ((cols * zoom) as i32, (rows * zoom) as i32);
    // The figure is about twice as wide as high.
    let across = (views as f64 * 2.0).sqrt().ceil().min(views as f64) as i32;
    let down = (views as i32 + across - 1) / across;
    let cell = (width + GAP, LABELS + height + LINE + GAP);
    let content = GAP + across * cell.0 + BAR;
    let size = [content.max(LEAST_WIDTH), HEAD + down * cell.1];
    let start = (size[0] - content) / 2;
    let known = images.values.iter().filter(|value| !value.is_nan());
    let values = known.map(|&value| f64::from(value));
    let scale = ColourScale::new(colorous::GREYS, robust_limit(values)).reversed();
    let brightest = f64::from(images.brightest());
    let mut figure = Figure::new(title, size)?;
    figure.text(title, TITLE, Anchor::On, size[0] / 2, 32);
    let (zenith, azimuth) = (geometry.sun_zenith_deg, geometry.sun_azimuth_deg);
    let missing = match images.values.iter().any(|value| value.is_nan()) {
        true => "; missing pixels are orange",
        false => "",
    };
    let conditions = format!(
        "{wavelength} \u{b5}m; north up, east to the right; Sun at zenith {zenith:.0}\u{b0}, azimuth \
         {azimuth:.0}\u{b0}{missing}"
    );
    figure.text(&conditions, TICK, Anchor::On, size[0] / 2, 66);
    let (sine, cosine) = azimuth.to_radians().sin_cos();
    let corner = DVec2::new(f64::from(size[0] - 70), 62.0);
    draw_arrow(&mut figure, corner, DVec2::NEG_Y, "N");
    draw_arrow(&mut figure, corner, DVec2::new(sine, -cosine), "Sun");
    for (view, label) in labels.iter().enumerate() {
        let (column, line) = (view as i32 % across, view as i32 / across);
        let left = start + GAP + column * cell.0;
        let top = HEAD + line * cell.1 + LABELS;
        draw_label(&mut figure, label, left + width / 2, top);
        let image = images.image(view);
        let frame = Frame { left, top, width, height };
        draw_map(&mut figure, frame, (rows, cols), |at| match image[at] {
            radiance if radiance.is_nan() => MISSING,
            radiance => scale.colour(f64::from(radiance)),
        });
        if let Some(Some((row, col))) = marks.get(view) {
            let at = DVec2::new(col / cols as f64, 1.0 - row / rows as f64);
            draw_cross(&mut figure, frame, at);
        }
        draw_length(&mut figure, frame, geometry.pixel_km[view] * cols as f64);
    }
    let top = HEAD + LABELS;
    let bar = Frame {
        left: start + GAP + across * cell.0 + 8,
        top,
        width: 18,
        height: HEAD + down * cell.1 - GAP - LINE - top,
    };
    let mut label = String::from("radiance (sr\u{207b}\u{b9})");
    if brightest > scale.high {
        label += &format!(", largest {brightest:.3}");
    }
    ColourBar::linear(scale, &label, bar.height).draw(&mut figure, bar);
    Ok(figure)
}

/// Draw a scale bar below a frame that is `width_km` wide: a round length, at most a third of it.
fn draw_length(figure: &mut Figure, frame: Frame, width_km: f64) {
    let most = width_km / 3.0;
    let power = 10_f64.powf(most.log10().floor());
    let factors = [5.0, 2.0, 1.0];
    let length = factors.map(|factor| factor * power).into_iter().find(|length| *length <= most);
    let length = length.unwrap_or(power);
    let y = f64::from(frame.bottom()) + 12.0;
    let (from, to) =
        (f64::from(frame.left), f64::from(frame.left) + length / width_km * f64::from(frame.width));
    figure.line(DVec2::new(from, y), DVec2::new(to, y), 3.0, BLACK);
    figure.text(&format!("{length} km"), TICK, Anchor::RightOf, to as i32 + 6, y as i32);
}

/// Draw a cross at a point of a frame, given as the shares of its width and height; none outside.
fn draw_cross(figure: &mut Figure, frame: Frame, at: DVec2) {
    if !(0.0..=1.0).contains(&at.x) || !(0.0..=1.0).contains(&at.y) {
        return;
    }
    let corner = DVec2::new(f64::from(frame.left), f64::from(frame.top));
    let middle = corner + at * DVec2::new(f64::from(frame.width), f64::from(frame.height));
    for arm in [DVec2::X, DVec2::Y] {
        figure.line(middle - CROSS * arm, middle + CROSS * arm, 2.0, CROSS_COLOUR);
    }
}

/// Labels with the viewing direction and the pixel size of each image.
fn view_labels(geometry: &ViewGeometry) -> Vec<String> {
    let directions = geometry.view_zenith_deg.iter().zip(&geometry.view_azimuth_deg);
    directions
        .zip(&geometry.pixel_km)
        .map(|((zenith, azimuth), pixel)| {
            format!("zenith {zenith:.1}°\nazimuth {azimuth:.0}°, pixel {:.0} m", 1000.0 * pixel)
        })
        .collect()
}

/// Draw the lines of a label above a point.
fn draw_label(figure: &mut Figure, label: &str, x: i32, bottom: i32) {
    for (number, line) in label.lines().rev().enumerate() {
        figure.text(line, TICK, Anchor::Above, x, bottom - 4 - number as i32 * LINE);
    }
}
