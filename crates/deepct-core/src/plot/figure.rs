//! A figure: what is drawn, independent of the format of the file.

use super::{pdf, raster, svg};
use crate::error::{Error, Result};
use ab_glyph::{Font, FontRef, PxScale, ScaleFont};
use glam::{DVec2, IVec2};
use std::path::Path;

/// Font size of titles (pixels).
pub(super) const TITLE: f32 = 28.0;
/// Font size of labels (pixels).
pub(super) const LABEL: f32 = 20.0;
/// Font size of tick labels (pixels).
pub(super) const TICK: f32 = 17.0;

/// Maximum side length of a figure (pixels).
const MAX_SIDE: i32 = 20_000;

/// Red, green and blue.
pub(super) type Colour = [u8; 3];
pub(super) const BLACK: Colour = [0, 0, 0];

/// The format of a figure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Format {
    /// Pixels.
    Png,
    /// Lines and text as such; colour maps as pixels of the size of their values.
    Svg,
    /// As SVG, with the letters of the text.
    Pdf,
}

impl Format {
    /// The format that the ending of a file name stands for.
    ///
    /// # Errors
    /// Another ending, or none; the message names the path as `what`.
    pub fn of(path: impl AsRef<Path>, what: &'static str) -> Result<Self> {
        let path = path.as_ref();
        let ending = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        match ending.as_str() {
            "png" => Ok(Self::Png),
            "svg" => Ok(Self::Svg),
            "pdf" => Ok(Self::Pdf),
            _ => {
                let range = "the name of a figure, ending in .png, .svg or .pdf";
                Err(Error::out_of_range(what, path.display(), range))
            }
        }
    }
}

/// A rectangle of a figure (pixels).
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

/// What is drawn, from the back to the front.
pub(super) enum Mark {
    Picture(Picture),
    Line { from: DVec2, to: DVec2, width: f64, colour: Colour },
    Text(Text),
}

/// Cells that fill a frame.
pub(super) struct Picture {
    pub(super) frame: Frame,
    pub(super) rows: usize,
    pub(super) cols: usize,
    /// Red, green, blue and opacity, row by row from the top.
    pub(super) cells: Vec<[u8; 4]>,
}

impl Picture {
    pub(super) fn is_opaque(&self) -> bool {
        self.cells.iter().all(|cell| cell[3] == u8::MAX)
    }
}

/// A line of black text.
pub(super) struct Text {
    pub(super) text: String,
    /// Font size as [`PxScale`] has it: from the descent to the ascent (pixels).
    pub(super) size: f32,
    pub(super) at: IVec2,
    /// The start of the baseline, relative to `at` before the text is turned (pixels).
    pub(super) start: [f32; 2],
    /// The start of each letter from that of the text (pixels).
    pub(super) letters: Vec<f32>,
    /// The end of the text from its start (pixels).
    pub(super) width: f32,
    /// Whether the text is turned to run upwards.
    pub(super) upwards: bool,
}

/// A drawing on white ground, which can be written as PNG, SVG and PDF; `x` increases to the right and `y`
/// downwards.
pub struct Figure {
    pub(super) title: String,
    pub(super) width: i32,
    pub(super) height: i32,
    pub(super) marks: Vec<Mark>,
    pub(super) font: FontRef<'static>,
}

impl std::fmt::Debug for Figure {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { title, width, height, .. } = self;
        write!(formatter, "Figure({title:?}, {width} x {height} pixels)")
    }
}

impl Figure {
    /// An empty figure.
    ///
    /// # Errors
    /// Returns an error if the figure is too large.
    pub(super) fn new(title: &str, [width, height]: [i32; 2]) -> Result<Self> {
        if width > MAX_SIDE || height > MAX_SIDE {
            return Err(Error::out_of_range(
                "size of the figure",
                format!("{width} x {height} pixels"),
                format!("at most {MAX_SIDE} pixels along each side: draw less in one figure"),
            ));
        }
        let font = FontRef::try_from_slice(dejavu::sans::regular()).expect("the font is valid");
        Ok(Self { title: title.into(), width, height, marks: Vec::new(), font })
    }

    /// Fill a frame with `rows` x `cols` cells, whose colours depend on the row, from the top, and
    /// the column.
    pub(super) fn fill(
        &mut self,
        frame: Frame,
        (rows, cols): (usize, usize),
        colour: impl Fn(usize, usize) -> Colour,
    ) {
        let places = (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col)));
        let opaque = |[red, green, blue]: Colour| [red, green, blue, u8::MAX];
        let cells = places.map(|(row, col)| opaque(colour(row, col))).collect();
        self.picture(Picture { frame, rows, cols, cells });
    }

    /// Draw a picture.
    pub(super) fn picture(&mut self, picture: Picture) {
        self.marks.push(Mark::Picture(picture));
    }

    /// Draw a border of one pixel around a frame.
    pub(super) fn border(&mut self, frame: Frame) {
        let corner = |x: i32, y: i32| DVec2::new(f64::from(x), f64::from(y)) + 0.5;
        let (left, right) = (frame.left - 1, frame.right());
        let (top, bottom) = (frame.top - 1, frame.bottom());
        for (from, to) in [
            (corner(left, top), corner(right, top)),
            (corner(left, bottom), corner(right, bottom)),
            (corner(left, top), corner(left, bottom)),
            (corner(right, top), corner(right, bottom)),
        ] {
            self.line(from, to, 1.0, BLACK);
        }
    }

    /// Draw a straight line.
    pub(super) fn line(&mut self, from: DVec2, to: DVec2, width: f64, colour: Colour) {
        self.marks.push(Mark::Line { from, to, width, colour });
    }

    /// The width of a text (pixels).
    pub(super) fn text_width(&self, text: &str, size: f32) -> i32 {
        self.letters(text, size).1.ceil() as i32
    }

    /// The start of each letter of a text and the end of the text (pixels).
    fn letters(&self, text: &str, size: f32) -> (Vec<f32>, f32) {
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
        let (letters, width) = self.letters(text, size);
        let font = self.font.as_scaled(PxScale::from(size));
        // The height of capitals and digits is about three quarters of the ascent.
        let capital = 0.75 * font.ascent();
        let (start, baseline) = match anchor {
            Anchor::Above | Anchor::UpwardsLeftOf => (-0.5 * width, font.descent()),
            Anchor::Below | Anchor::UpwardsRightOf => (-0.5 * width, font.ascent()),
            Anchor::On => (-0.5 * width, 0.5 * capital),
            Anchor::LeftOf => (-width, 0.5 * capital),
            Anchor::RightOf => (0.0, 0.5 * capital),
        };
        self.marks.push(Mark::Text(Text {
            text: text.into(),
            size,
            at: IVec2::new(x, y),
            start: [start, baseline.round()],
            letters,
            width,
            upwards: matches!(anchor, Anchor::UpwardsLeftOf | Anchor::UpwardsRightOf),
        }));
    }

    /// The size of the font in which a text is set: the side of the square of a letter (pixels).
    pub(super) fn font_size(&self, text: &Text) -> f32 {
        let height = self.font.height_unscaled();
        text.size * self.font.units_per_em().map_or(1.0, |units| units / height)
    }

    /// The contents of a file of the figure.
    ///
    /// # Errors
    /// None for figures of this module.
    pub fn encode(&self, format: Format) -> Result<Vec<u8>> {
        match format {
            Format::Png => raster::encode(self),
            Format::Svg => svg::encode(self),
            Format::Pdf => pdf::encode(self),
        }
    }

    /// Write the figure in the format that the ending of the path stands for, first under a temporary
    /// name, so that an aborted run leaves no incomplete file.
    ///
    /// # Errors
    /// Returns an error if the ending is of another format, or if the folder does not exist or cannot
    /// be written to.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<()> {
        let path = path.as_ref();
        crate::files::write(path, self.encode(Format::of(path, "name of a figure")?)?)
    }
}

/// Length of an arrow (pixels).
const ARROW: f64 = 30.0;

/// Draw an arrow from a point into a direction, with a name beyond its head.
pub(super) fn draw_arrow(figure: &mut Figure, from: DVec2, direction: DVec2, name: &str) {
    let along = direction.normalize_or(DVec2::NEG_Y);
    let to = from + ARROW * along;
    figure.line(from, to, 2.0, BLACK);
    for side in [along.perp(), -along.perp()] {
        figure.line(to, to - 9.0 * along + 5.0 * side, 2.0, BLACK);
    }
    let text = (to + 14.0 * along).as_ivec2();
    figure.text(name, TICK, Anchor::On, text.x, text.y);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ending_is_the_format() {
        assert_eq!(Format::of("a/b.PNG", "out").unwrap(), Format::Png);
        assert_eq!(Format::of("b.svg", "out").unwrap(), Format::Svg);
        assert_eq!(Format::of("b.pdf", "out").unwrap(), Format::Pdf);
        assert!(Format::of("b.eps", "out").is_err() && Format::of("png", "out").is_err());
    }

    #[test]
    fn a_figure_too_large_and_a_missing_folder_are_refused() {
        assert!(Figure::new("", [30_000, 10]).is_err());
        let folder = tempfile::tempdir().unwrap();
        let figure = Figure::new("", [4, 4]).unwrap();
        assert!(figure.write(folder.path().join("none/figure.png")).is_err());
        assert!(figure.write(folder.path().join("figure.eps")).is_err());
        figure.write(folder.path().join("figure.png")).unwrap();
    }
}
