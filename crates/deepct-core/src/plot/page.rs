//! A page on which pixels, lines and text are drawn and which is written to a file.

use crate::error::{Error, Result};
use ab_glyph::{Font, FontRef, PxScale, ScaleFont, point};
use glam::{DVec2, IVec2};
use std::path::Path;

/// Font size of titles (pixels).
pub(super) const TITLE: f32 = 28.0;
/// Font size of labels (pixels).
pub(super) const LABEL: f32 = 20.0;
/// Font size of tick labels (pixels).
pub(super) const TICK: f32 = 17.0;

/// Maximum side length of a page (pixels).
const MAX_SIDE: i32 = 20_000;

/// Red, green and blue.
pub(super) type Colour = [u8; 3];
pub(super) const BLACK: Colour = [0, 0, 0];

/// A rectangle of a page (pixels).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Frame {
    pub(super) left: i32,
    pub(super) top: i32,
    pub(super) width: i32,
    pub(super) height: i32,
}

impl Frame {
    pub(super) fn right(&self) -> i32 {
        self.left + self.width
    }

    pub(super) fn bottom(&self) -> i32 {
        self.top + self.height
    }

    /// The horizontal centre.
    pub(super) fn middle(&self) -> i32 {
        self.left + self.width / 2
    }

    /// The vertical centre.
    pub(super) fn half_way(&self) -> i32 {
        self.top + self.height / 2
    }
}

/// Position of a text relative to the point at which it is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Anchor {
    /// Centred above the point.
    Above,
    /// Centred below the point.
    Below,
    /// Centred on the point.
    On,
    /// Left of the point, at its height.
    LeftOf,
    /// Right of the point, at its height.
    RightOf,
    /// Running upwards, centred left of the point.
    UpwardsLeftOf,
    /// Running upwards, centred right of the point.
    UpwardsRightOf,
}

/// A white page to draw on; `x` increases to the right and `y` downwards.
pub(super) struct Page {
    width: i32,
    height: i32,
    pixels: Vec<u8>,
    font: FontRef<'static>,
}

impl Page {
    /// An empty page.
    ///
    /// # Errors
    /// Returns an error if the page is too large.
    pub(super) fn new([width, height]: [i32; 2]) -> Result<Self> {
        if width > MAX_SIDE || height > MAX_SIDE {
            return Err(Error::out_of_range(
                "size of the picture",
                format!("{width} x {height} pixels"),
                format!("at most {MAX_SIDE} pixels along each side: draw less on one page"),
            ));
        }
        let pixels = vec![255; width as usize * height as usize * 3];
        let font = FontRef::try_from_slice(dejavu::sans::regular()).expect("the font is valid");
        Ok(Self { width, height, pixels, font })
    }

    /// Blend a colour into a pixel; pixels outside the page are ignored.
    pub(super) fn mix(&mut self, x: i32, y: i32, colour: Colour, opacity: f64) {
        if (0..self.width).contains(&x) && (0..self.height).contains(&y) {
            let at = 3 * (y as usize * self.width as usize + x as usize);
            for (pixel, channel) in self.pixels[at..at + 3].iter_mut().zip(colour) {
                let (old, new) = (f64::from(*pixel), f64::from(channel));
                *pixel = (old + opacity * (new - old)).round() as u8;
            }
        }
    }

    /// Colour the pixels of a frame according to their position relative to its upper left corner.
    pub(super) fn fill(&mut self, frame: Frame, colour: impl Fn(i32, i32) -> Colour) {
        for y in 0..frame.height {
            for x in 0..frame.width {
                self.mix(frame.left + x, frame.top + y, colour(x, y), 1.0);
            }
        }
    }

    /// Draw a border of one pixel around a frame.
    pub(super) fn border(&mut self, frame: Frame) {
        for x in frame.left - 1..=frame.right() {
            self.mix(x, frame.top - 1, BLACK, 1.0);
            self.mix(x, frame.bottom(), BLACK, 1.0);
        }
        for y in frame.top - 1..=frame.bottom() {
            self.mix(frame.left - 1, y, BLACK, 1.0);
            self.mix(frame.right(), y, BLACK, 1.0);
        }
    }

    /// Draw a straight line with smooth edges.
    pub(super) fn line(&mut self, from: DVec2, to: DVec2, width: f64, colour: Colour) {
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

    /// The width of a text (pixels).
    pub(super) fn text_width(&self, text: &str, size: f32) -> i32 {
        self.advances(text, size).1.ceil() as i32
    }

    /// The start of each letter of a text and the end of the text (pixels).
    fn advances(&self, text: &str, size: f32) -> (Vec<f32>, f32) {
        let font = self.font.as_scaled(PxScale::from(size));
        let mut at = 0.0;
        let mut before = None;
        let mut starts = Vec::new();
        for letter in text.chars() {
            let glyph = font.glyph_id(letter);
            at += before.map_or(0.0, |before| font.kern(before, glyph));
            starts.push(at);
            at += font.h_advance(glyph);
            before = Some(glyph);
        }
        (starts, at)
    }

    /// Write a line of text at a point.
    pub(super) fn text(&mut self, text: &str, size: f32, anchor: Anchor, x: i32, y: i32) {
        let (starts, width) = self.advances(text, size);
        let font = self.font.clone();
        let font = font.as_scaled(PxScale::from(size));
        // The height of capitals and digits is about three quarters of the ascent.
        let capital = 0.75 * font.ascent();
        let (start, baseline) = match anchor {
            Anchor::Above | Anchor::UpwardsLeftOf => (-0.5 * width, font.descent()),
            Anchor::Below | Anchor::UpwardsRightOf => (-0.5 * width, font.ascent()),
            Anchor::On => (-0.5 * width, 0.5 * capital),
            Anchor::LeftOf => (-width, 0.5 * capital),
            Anchor::RightOf => (0.0, 0.5 * capital),
        };
        let upwards = matches!(anchor, Anchor::UpwardsLeftOf | Anchor::UpwardsRightOf);
        for (letter, letter_start) in text.chars().zip(starts) {
            let mut glyph = font.scaled_glyph(letter);
            glyph.position = point(start + letter_start, baseline.round());
            let Some(outline) = font.outline_glyph(glyph) else { continue };
            let bounds = outline.px_bounds();
            outline.draw(|column, line, cover| {
                let right = column as i32 + bounds.min.x as i32;
                let down = line as i32 + bounds.min.y as i32;
                let (dx, dy) = if upwards { (down, -right) } else { (right, down) };
                self.mix(x + dx, y + dy, BLACK, f64::from(cover.min(1.0)));
            });
        }
    }

    /// Write the page as a PNG file, first under a temporary name, so that an aborted run leaves
    /// no incomplete file.
    ///
    /// # Errors
    /// Returns an error if the folder does not exist or cannot be written to.
    pub(super) fn write(&self, path: &Path) -> Result<()> {
        let mut encoded = Vec::new();
        let encoder = image::codecs::png::PngEncoder::new(&mut encoded);
        let (width, height) = (self.width.unsigned_abs(), self.height.unsigned_abs());
        let colours = image::ExtendedColorType::Rgb8;
        image::ImageEncoder::write_image(encoder, &self.pixels, width, height, colours).map_err(
            |problem| Error::file(path, "picture", problem.to_string(), "draw less on one page"),
        )?;
        crate::files::write(path, encoded)
    }
}

/// Length of an arrow (pixels).
const ARROW: f64 = 30.0;

/// Draw an arrow from a point into a direction, with a name beyond its head.
pub(super) fn draw_arrow(page: &mut Page, from: DVec2, direction: DVec2, name: &str) {
    let along = direction.normalize_or(DVec2::NEG_Y);
    let to = from + ARROW * along;
    page.line(from, to, 2.0, BLACK);
    for side in [along.perp(), -along.perp()] {
        page.line(to, to - 9.0 * along + 5.0 * side, 2.0, BLACK);
    }
    let text = (to + 14.0 * along).as_ivec2();
    page.text(name, TICK, Anchor::On, text.x, text.y);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The smallest frame that contains all dark pixels.
    fn inked(page: &Page) -> Frame {
        let dark = |x: i32, y: i32| page.pixels[3 * (y * page.width + x) as usize] < 128;
        let points: Vec<_> = (0..page.height)
            .flat_map(|y| (0..page.width).map(move |x| (x, y)))
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
            let mut page = Page::new([200, 200]).unwrap();
            page.text("HEX 10", 20.0, anchor, 100, 100);
            inked(&page)
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
        let mut page = Page::new([100, 100]).unwrap();
        page.line(DVec2::new(10.0, 20.0), DVec2::new(80.0, 70.0), 3.0, BLACK);
        let ink: f64 =
            page.pixels.iter().step_by(3).map(|&value| 1.0 - f64::from(value) / 255.0).sum();
        let length = 70.0_f64.hypot(50.0);
        // The round ends add at most the area of a circle.
        assert!(ink > 3.0 * length - 1.0 && ink < 3.0 * length + 9.0, "{ink} {length}");
    }

    #[test]
    fn a_page_too_large_and_a_missing_folder_are_refused() {
        assert!(Page::new([30_000, 10]).is_err());
        let folder = tempfile::tempdir().unwrap();
        let page = Page::new([4, 4]).unwrap();
        assert!(page.write(&folder.path().join("none/page.png")).is_err());
        page.write(&folder.path().join("page.png")).unwrap();
        let read = image::ImageReader::open(folder.path().join("page.png")).unwrap();
        assert_eq!(read.decode().unwrap().to_rgb8().into_raw(), page.pixels);
    }
}
