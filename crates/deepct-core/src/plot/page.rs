//! A page: pixels, letters, and the file they go to.

use crate::error::{Error, Result};
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::FontTransform;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::io::Write;
use std::path::Path;
use std::sync::Once;

/// The name under which the embedded letters (DejaVu Sans) are known.
const FONT: &str = "sans-serif";
/// Height of the letters of titles (pixels).
pub(super) const TITLE: u32 = 26;
/// Height of the letters of labels (pixels).
pub(super) const LABEL: u32 = 18;
/// Height of the letters at ticks (pixels).
pub(super) const TICK: u32 = 15;

/// Where pictures are drawn.
pub(super) type Area<'a> = DrawingArea<BitMapBackend<'a>, Shift>;

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

    pub(super) fn middle(&self) -> i32 {
        self.left + self.width / 2
    }
}

/// A style of letters: `size` pixels high, anchored at a point.
pub(super) fn letters(size: u32, horizontal: HPos, vertical: VPos) -> TextStyle<'static> {
    (FONT, size).into_font().color(&BLACK).pos(Pos::new(horizontal, vertical))
}

/// Letters that run upwards, centred on a point.
pub(super) fn upward_letters(size: u32) -> TextStyle<'static> {
    (FONT, size)
        .into_font()
        .transform(FontTransform::Rotate270)
        .color(&BLACK)
        .pos(Pos::new(HPos::Center, VPos::Bottom))
}

/// Draw a white page of `[width, height]` pixels and write it as a PNG file, to a
/// temporary name first: a run that dies leaves no half picture behind.
///
/// # Errors
/// A page that is too large to draw, a folder that cannot be written.
pub(super) fn draw_page(
    path: &Path,
    [width, height]: [i32; 2],
    draw: impl FnOnce(&Area<'_>) -> Drawn,
) -> Result<()> {
    register_letters();
    let (width, height) = (width.unsigned_abs(), height.unsigned_abs());
    if width > MAX_SIDE || height > MAX_SIDE {
        return Err(Error::out_of_range(
            "size of the picture",
            format!("{width} x {height} pixels"),
            format!("at most {MAX_SIDE} pixels along each side: draw fewer views"),
        ));
    }
    let mut pixels = vec![255; (width * height * 3) as usize];
    {
        let area = BitMapBackend::with_buffer(&mut pixels, (width, height)).into_drawing_area();
        draw(&area).and_then(|()| area.present().map_err(Into::into)).map_err(|problem| {
            Error::file(path, "picture", problem.to_string(), "report this as an error of deepct")
        })?;
    }
    write_png(path, &pixels, [width, height])
}

/// What drawing returns: the errors of the library that draws are of many types.
pub(super) type Drawn = std::result::Result<(), Box<dyn std::error::Error>>;

/// The longest side of a picture (pixels).
const MAX_SIDE: u32 = 20_000;

fn register_letters() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let registered =
            plotters::style::register_font(FONT, FontStyle::Normal, dejavu::sans::regular());
        assert!(registered.is_ok(), "the embedded font is whole");
    });
}

fn write_png(path: &Path, pixels: &[u8], [width, height]: [u32; 2]) -> Result<()> {
    let mut encoded = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new(&mut encoded);
    image::ImageEncoder::write_image(
        encoder,
        pixels,
        width,
        height,
        image::ExtendedColorType::Rgb8,
    )
    .map_err(|problem| {
        Error::file(path, "picture", problem.to_string(), "report this as an error of deepct")
    })?;
    let folder = match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    };
    let mut builder = tempfile::Builder::new();
    builder.prefix(".deepct-").suffix(".partial");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // What any new file gets: the process's mask takes away from this.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    let mut file = builder.tempfile_in(folder).map_err(Error::io(path))?;
    file.write_all(&encoded).map_err(Error::io(path))?;
    file.persist(path).map_err(|problem| Error::io(path)(problem.error))?;
    Ok(())
}
