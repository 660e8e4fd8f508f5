//! Figures as PDF: lines and text as such with the letters that occur, pictures as pixels of the size of
//! their cells.

use super::figure::{Figure, Mark, Picture, Text};
use crate::encoding::compressed;
use crate::error::{Error, Result};
use ab_glyph::Font;
use pdf_writer::types::{CidFontType, FontFlags, LineCapStyle, SystemInfo, UnicodeCmap};
use pdf_writer::{Content, Filter, Finish, Name, Pdf, Rect, Ref, Str, TextStr};
use std::collections::BTreeMap;
use subsetter::GlyphRemapper;

/// Points of a pixel, so that tick labels have about 7 points.
const POINTS: f32 = 0.5;
/// Units of the widths of letters by the size of the font.
const UNITS: f32 = 1000.0;
/// What follows `%PDF-1.7\n%` in files of deepct: `deep` with the bits that mark the file as binary.
const MARKER: [u8; 4] = [0xe4, 0xe5, 0xe5, 0xf0];

const FONT_NAME: Name<'static> = Name(b"DEEPCT+DejaVuSans");
const SYSTEM: SystemInfo<'static> =
    SystemInfo { registry: Str(b"Adobe"), ordering: Str(b"Identity"), supplement: 0 };

/// Numbers of the objects of a file; those of pictures follow.
mod number {
    use pdf_writer::Ref;
    pub(super) const CATALOG: Ref = Ref::new(1);
    pub(super) const PAGES: Ref = Ref::new(2);
    pub(super) const PAGE: Ref = Ref::new(3);
    pub(super) const CONTENT: Ref = Ref::new(4);
    pub(super) const INFORMATION: Ref = Ref::new(5);
    pub(super) const FONT: Ref = Ref::new(6);
    pub(super) const LETTERS: Ref = Ref::new(7);
    pub(super) const DESCRIPTOR: Ref = Ref::new(8);
    pub(super) const FONT_FILE: Ref = Ref::new(9);
    pub(super) const UNICODE: Ref = Ref::new(10);
    pub(super) const PICTURES: i32 = 11;
}

/// The contents of a PDF file of one page.
///
/// # Errors
/// None for figures of this module.
pub(super) fn encode(figure: &Figure) -> Result<Vec<u8>> {
    let mut pdf = Pdf::new();
    pdf.set_binary_marker(&MARKER);
    pdf.catalog(number::CATALOG).pages(number::PAGES);
    pdf.pages(number::PAGES).kids([number::PAGE]).count(1);
    pdf.document_info(number::INFORMATION)
        .title(TextStr(&figure.title))
        .creator(TextStr(concat!("deepct ", env!("CARGO_PKG_VERSION"))));
    let pictures = add_pictures(&mut pdf, figure);
    let [width, height] = [figure.width, figure.height].map(|side| POINTS * side as f32);
    let mut page = pdf.page(number::PAGE);
    page.parent(number::PAGES).contents(number::CONTENT);
    page.media_box(Rect::new(0.0, 0.0, width, height));
    let mut resources = page.resources();
    resources.fonts().pair(Name(b"F"), number::FONT);
    let mut objects = resources.x_objects();
    for (index, picture) in pictures.iter().enumerate() {
        objects.pair(Name(name(index).as_bytes()), *picture);
    }
    objects.finish();
    resources.finish();
    page.finish();
    let mut letters = Letters { glyphs: GlyphRemapper::new(), characters: BTreeMap::new() };
    let content = content(figure, &mut letters);
    pdf.stream(number::CONTENT, &content).filter(Filter::FlateDecode);
    add_font(&mut pdf, figure, &letters)?;
    Ok(pdf.finish())
}

/// The name of a picture in the content.
fn name(index: usize) -> String {
    format!("P{index}")
}

/// The letters of a figure.
struct Letters {
    glyphs: GlyphRemapper,
    /// The character of each glyph, by its number in the file.
    characters: BTreeMap<u16, char>,
}

/// The drawing, in pixels from the upper left corner.
fn content(figure: &Figure, letters: &mut Letters) -> Vec<u8> {
    let mut content = Content::new();
    content.transform([POINTS, 0.0, 0.0, -POINTS, 0.0, POINTS * figure.height as f32]);
    content.set_line_cap(LineCapStyle::RoundCap);
    let mut pictures = 0;
    for mark in &figure.marks {
        match mark {
            Mark::Picture(Picture { frame, .. }) => {
                let [left, bottom] = [frame.left, frame.bottom()].map(|at| at as f32);
                let [width, height] = [frame.width, frame.height].map(|side| side as f32);
                content.save_state().transform([width, 0.0, 0.0, -height, left, bottom]);
                content.x_object(Name(name(pictures).as_bytes())).restore_state();
                pictures += 1;
            }
            Mark::Line { from, to, width, colour } => {
                let [red, green, blue] = colour.map(|channel| f32::from(channel) / 255.0);
                content.set_stroke_rgb(red, green, blue).set_line_width(*width as f32);
                content.move_to(from.x as f32, from.y as f32);
                content.line_to(to.x as f32, to.y as f32).stroke();
            }
            Mark::Text(text) => add_text(&mut content, figure, text, letters),
        }
    }
    compressed(&content.finish())
}

fn add_text(content: &mut Content, figure: &Figure, text: &Text, letters: &mut Letters) {
    let size = figure.font_size(text);
    let [x, y] = [text.at.x, text.at.y].map(|at| at as f32);
    let [right, down] = text.start;
    // The page has y downwards, and letters upwards.
    let place = match text.upwards {
        false => [1.0, 0.0, 0.0, -1.0, x + right, y + down],
        true => [0.0, -1.0, -1.0, 0.0, x + down, y - right],
    };
    content.begin_text().set_font(Name(b"F"), size).set_text_matrix(place);
    let mut positioned = content.show_positioned();
    let mut items = positioned.items();
    let mut end = 0.0;
    for (letter, start) in text.text.chars().zip(&text.letters) {
        let glyph = figure.font.glyph_id(letter);
        if (start - end).abs() > 1e-3 {
            items.adjust((end - start) / size * UNITS);
        }
        let number = letters.glyphs.remap(glyph.0);
        if glyph.0 != 0 {
            letters.characters.entry(number).or_insert(letter);
        }
        items.show(Str(&number.to_be_bytes()));
        end = start + width(figure, glyph.0) / UNITS * size;
    }
    items.finish();
    positioned.finish();
    content.end_text();
}

/// The width of a glyph by the size of the font, times [`UNITS`].
fn width(figure: &Figure, glyph: u16) -> f32 {
    let units = figure.font.units_per_em().unwrap_or(UNITS);
    figure.font.h_advance_unscaled(ab_glyph::GlyphId(glyph)) / units * UNITS
}

/// Adds the pictures, each with its opacity if it has any, and returns their numbers.
fn add_pictures(pdf: &mut Pdf, figure: &Figure) -> Vec<Ref> {
    let mut next = Ref::new(number::PICTURES);
    let mut numbers = Vec::new();
    let pictures = figure.marks.iter().filter_map(|mark| match mark {
        Mark::Picture(picture) => Some(picture),
        _ => None,
    });
    for picture in pictures {
        let colours: Vec<u8> = picture.cells.iter().flat_map(|cell| &cell[..3]).copied().collect();
        let colours = compressed(&colours);
        let [width, height] = [picture.cols, picture.rows].map(|count| count as i32);
        let number = next.bump();
        let opacity = (!picture.is_opaque()).then(|| next.bump());
        let mut image = pdf.image_xobject(number, &colours);
        image.filter(Filter::FlateDecode);
        image.width(width).height(height).bits_per_component(8);
        image.color_space().device_rgb();
        opacity.map(|opacity| image.s_mask(opacity));
        image.finish();
        if let Some(opacity) = opacity {
            let opacities: Vec<u8> = picture.cells.iter().map(|cell| cell[3]).collect();
            let opacities = compressed(&opacities);
            let mut image = pdf.image_xobject(opacity, &opacities);
            image.filter(Filter::FlateDecode);
            image.width(width).height(height).bits_per_component(8);
            image.color_space().device_gray();
        }
        numbers.push(number);
    }
    numbers
}

/// Adds the letters, so that the file looks the same everywhere and its text can be searched.
fn add_font(pdf: &mut Pdf, figure: &Figure, letters: &Letters) -> Result<()> {
    let Letters { glyphs, characters } = letters;
    let file = subsetter::subset(dejavu::sans::regular(), 0, glyphs)
        .map_err(|problem| Error::out_of_range("font", problem.to_string(), "a valid font"))?;
    let units = figure.font.units_per_em().unwrap_or(UNITS);
    let scaled = |value: f32| value / units * UNITS;
    pdf.type0_font(number::FONT)
        .base_font(FONT_NAME)
        .encoding_predefined(Name(b"Identity-H"))
        .descendant_font(number::LETTERS)
        .to_unicode(number::UNICODE);
    let mut cid = pdf.cid_font(number::LETTERS);
    cid.subtype(CidFontType::Type2).base_font(FONT_NAME).system_info(SYSTEM);
    cid.font_descriptor(number::DESCRIPTOR).default_width(0.0);
    cid.cid_to_gid_map_predefined(Name(b"Identity"));
    cid.widths().consecutive(0, glyphs.remapped_gids().map(|glyph| width(figure, glyph)));
    cid.finish();
    let (ascent, descent) = (figure.font.ascent_unscaled(), figure.font.descent_unscaled());
    // The box and the heights are those of the whole font.
    pdf.font_descriptor(number::DESCRIPTOR)
        .name(FONT_NAME)
        .flags(FontFlags::SYMBOLIC)
        .bbox(Rect::new(scaled(-2090.0), scaled(-948.0), scaled(3673.0), scaled(2524.0)))
        .italic_angle(0.0)
        .ascent(scaled(ascent))
        .descent(scaled(descent))
        .cap_height(scaled(1493.0))
        .stem_v(80.0)
        .font_file2(number::FONT_FILE);
    let length = file.len() as i32;
    let file = compressed(&file);
    let mut stream = pdf.stream(number::FONT_FILE, &file);
    stream.filter(Filter::FlateDecode);
    stream.pair(Name(b"Length1"), length);
    stream.finish();
    let mut unicode = UnicodeCmap::<u16>::new(Name(b"Unicode"), SYSTEM);
    characters.iter().for_each(|(glyph, character)| unicode.pair(*glyph, *character));
    pdf.cmap(number::UNICODE, &unicode.finish());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::figure::{Anchor, Frame};
    use super::*;
    use glam::DVec2;

    /// The only page has half a point per pixel, and each picture is an object with its opacity.
    #[test]
    fn a_figure_is_a_page() {
        let mut figure = Figure::new("title", [100, 80]).unwrap();
        let frame = Frame { left: 10, top: 20, width: 30, height: 40 };
        figure.fill(frame, (1, 2), |_, col| [[1, 2, 3], [4, 5, 6]][col]);
        figure.picture(Picture { frame, rows: 1, cols: 1, cells: vec![[1, 2, 3, 128]] });
        figure.line(DVec2::new(1.0, 2.0), DVec2::new(3.5, 4.0), 1.5, [255, 0, 16]);
        figure.text("extinction (km\u{207b}\u{b9})", 20.0, Anchor::UpwardsLeftOf, 50, 60);
        let bytes = encode(&figure).unwrap();
        assert!(bytes.starts_with(b"%PDF-1.7\n%\xe4\xe5\xe5\xf0"));
        let text = String::from_utf8_lossy(&bytes);
        assert!(text.contains("/MediaBox [0 0 50 40]"), "{text}");
        assert_eq!(text.matches("/Subtype /Image").count(), 3);
        assert_eq!(text.matches("/SMask").count(), 1);
        // The whole font has 757,076 bytes.
        assert!(bytes.len() < 20_000, "{}", bytes.len());
    }
}
