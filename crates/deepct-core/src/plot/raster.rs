//! Figures as pixels.

use super::figure::{Colour, Figure, Mark, Picture, Text};
use crate::error::{Error, Result};
use ab_glyph::{Font, PxScale, point};
use glam::{DVec2, IVec2};

/// The contents of a PNG file.
///
/// # Errors
/// None for figures of this module.
pub(super) fn encode(figure: &Figure) -> Result<Vec<u8>> {
    let [width, height] = [figure.width, figure.height].map(i32::unsigned_abs);
    png(&Raster::of(figure).pixels, [width, height], image::ExtendedColorType::Rgb8)
}

/// Pixels as a PNG file.
///
/// # Errors
/// None for pixels of the given size.
pub(super) fn png(
    pixels: &[u8],
    [width, height]: [u32; 2],
    colours: image::ExtendedColorType,
) -> Result<Vec<u8>> {
    let mut encoded = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new(&mut encoded);
    image::ImageEncoder::write_image(encoder, pixels, width, height, colours).map_err(
        |problem| Error::out_of_range("picture", problem.to_string(), "one that PNG can hold"),
    )?;
    Ok(encoded)
}

/// A figure that has been drawn.
struct Raster {
    width: i32,
    height: i32,
    /// Red, green and blue, row by row from the top.
    pixels: Vec<u8>,
}

impl Raster {
    fn of(figure: &Figure) -> Self {
        let Figure { width, height, .. } = *figure;
        let pixels = vec![255; width as usize * height as usize * 3];
        let mut raster = Self { width, height, pixels };
        for mark in &figure.marks {
            match mark {
                Mark::Picture(picture) => raster.picture(picture),
                Mark::Line { from, to, width, colour } => raster.line(*from, *to, *width, *colour),
                Mark::Text(text) => raster.text(figure, text),
            }
        }
        raster
    }

    /// Blend a colour into a pixel; pixels outside are ignored.
    fn mix(&mut self, x: i32, y: i32, colour: Colour, opacity: f64) {
        if (0..self.width).contains(&x) && (0..self.height).contains(&y) {
            let at = 3 * (y as usize * self.width as usize + x as usize);
            for (pixel, channel) in self.pixels[at..at + 3].iter_mut().zip(colour) {
                let (old, new) = (f64::from(*pixel), f64::from(channel));
                *pixel = (old + opacity * (new - old)).round() as u8;
            }
        }
    }

    fn picture(&mut self, Picture { frame, rows, cols, cells }: &Picture) {
        for y in 0..frame.height {
            for x in 0..frame.width {
                let row = y as usize * rows / frame.height as usize;
                let col = x as usize * cols / frame.width as usize;
                let [red, green, blue, opacity] = cells[row * cols + col];
                let opacity = f64::from(opacity) / 255.0;
                self.mix(frame.left + x, frame.top + y, [red, green, blue], opacity);
            }
        }
    }

    /// Draw a straight line with smooth edges and round ends.
    fn line(&mut self, from: DVec2, to: DVec2, width: f64, colour: Colour) {
        let along = to - from;
        let reach = DVec2::splat(0.5 * width + 1.0);
        let low = (from.min(to) - reach).floor().as_ivec2();
        let high = (from.max(to) + reach).ceil().as_ivec2();
        for y in low.y..=high.y {
            for x in low.x..=high.x {
                let point = IVec2::new(x, y).as_dvec2() + 0.5;
                let share = (point - from).dot(along) / along.length_squared();
                let distance = point.distance(from + share.clamp(0.0, 1.0) * along);
                let opacity = (0.5 * width + 0.5 - distance).clamp(0.0, 1.0);
                self.mix(x, y, colour, opacity);
            }
        }
    }

    fn text(&mut self, figure: &Figure, text: &Text) {
        for (letter, letter_start) in text.text.chars().zip(&text.letters) {
            let mut glyph = figure.font.glyph_id(letter).with_scale(PxScale::from(text.size));
            glyph.position = point(text.start[0] + letter_start, text.start[1]);
            let Some(outline) = figure.font.outline_glyph(glyph) else { continue };
            let bounds = outline.px_bounds();
            outline.draw(|column, line, cover| {
                let right = column as i32 + bounds.min.x as i32;
                let down = line as i32 + bounds.min.y as i32;
                let (dx, dy) = if text.upwards { (down, -right) } else { (right, down) };
                let opacity = f64::from(cover.min(1.0));
                self.mix(text.at.x + dx, text.at.y + dy, [0; 3], opacity);
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::figure::{Anchor, BLACK, Frame};
    use super::*;

    /// The smallest frame that contains all dark pixels.
    fn inked(figure: &Figure) -> Frame {
        let figure = Raster::of(figure);
        let dark = |x: i32, y: i32| figure.pixels[3 * (y * figure.width + x) as usize] < 128;
        let points: Vec<_> = (0..figure.height)
            .flat_map(|y| (0..figure.width).map(move |x| (x, y)))
            .filter(|&(x, y)| dark(x, y))
            .collect();
        let left = points.iter().map(|point| point.0).min().unwrap();
        let top = points.iter().map(|point| point.1).min().unwrap();
        let width = points.iter().map(|point| point.0).max().unwrap() - left + 1;
        let height = points.iter().map(|point| point.1).max().unwrap() - top + 1;
        Frame { left, top, width, height }
    }

    #[test]
    fn text_stands_where_its_anchor_says() {
        let drawn = |anchor| {
            let mut figure = Figure::new("", [200, 200]).unwrap();
            figure.text("HEX 10", 20.0, anchor, 100, 100);
            inked(&figure)
        };
        let centred = |middle: i32| (middle - 100).abs() <= 2;
        let on = drawn(Anchor::On);
        assert!(centred(on.middle()) && centred(on.half_way()), "{on:?}");
        assert!(drawn(Anchor::Above).bottom() <= 100 && drawn(Anchor::Below).top >= 100);
        assert!(drawn(Anchor::LeftOf).right() <= 101 && drawn(Anchor::RightOf).left >= 99);
        let upwards = drawn(Anchor::UpwardsLeftOf);
        assert!(upwards.right() <= 100 && centred(upwards.half_way()), "{upwards:?}");
        assert!((upwards.height - on.width).abs() <= 1 && (upwards.width - on.height).abs() <= 1);
        assert!(drawn(Anchor::UpwardsRightOf).left >= 100);
    }

    #[test]
    fn a_line_covers_its_length_times_its_width() {
        let mut figure = Figure::new("", [100, 100]).unwrap();
        figure.line(DVec2::new(10.0, 20.0), DVec2::new(80.0, 70.0), 3.0, BLACK);
        let pixels = Raster::of(&figure).pixels;
        let ink: f64 = pixels.iter().step_by(3).map(|&value| 1.0 - f64::from(value) / 255.0).sum();
        let length = 70.0_f64.hypot(50.0);
        // The round ends add at most the area of a circle.
        assert!(ink > 3.0 * length - 1.0 && ink < 3.0 * length + 9.0, "{ink} {length}");
    }

    #[test]
    fn a_file_has_the_pixels() {
        let mut figure = Figure::new("", [4, 3]).unwrap();
        let frame = Frame { left: 1, top: 0, width: 2, height: 2 };
        figure.fill(frame, (1, 2), |_, col| [[10, 20, 30], [40, 50, 60]][col]);
        let read = image::load_from_memory(&encode(&figure).unwrap()).unwrap().to_rgb8();
        assert_eq!(read.dimensions(), (4, 3));
        let at = |x, y| read.get_pixel(x, y).0;
        assert_eq!(
            [at(0, 0), at(1, 1), at(2, 1), at(2, 2)],
            [[255; 3], [10, 20, 30], [40, 50, 60], [255; 3]]
        );
    }
}
