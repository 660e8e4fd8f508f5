//! Figures as SVG: lines and text as such, pictures as PNG of the size of their cells.

use super::figure::{Figure, Mark, Picture, Text};
use super::raster::png;
use crate::encoding::base64;
use crate::error::Result;
use std::fmt::Write;

/// The font of PNG and PDF, and similar ones for programs that lack it.
const FONTS: &str = "DejaVu Sans, Bitstream Vera Sans, Verdana, sans-serif";

/// The contents of an SVG file. The second line tells that deepct wrote it.
///
/// # Errors
/// None for figures of this module.
pub(super) fn encode(figure: &Figure) -> Result<Vec<u8>> {
    let Figure { title, width, height, .. } = figure;
    let mut svg = format!(
        "<?xml version=\"1.0\"?>\n<!-- deepct -->\n<svg xmlns=\"http://www.w3.org/2000/svg\" \
         xmlns:xlink=\"http://www.w3.org/1999/xlink\" width=\"{width}\" height=\"{height}\" \
         viewBox=\"0 0 {width} {height}\" font-family=\"{FONTS}\" stroke-linecap=\"round\">\n\
         <title>{}</title>\n<rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>\n",
        escaped(title)
    );
    for mark in &figure.marks {
        let element = match mark {
            Mark::Picture(picture) => element_of_picture(picture)?,
            Mark::Line { from, to, width, colour: [red, green, blue] } => format!(
                "<path d=\"M{:.2} {:.2}L{:.2} {:.2}\" stroke-width=\"{width}\" \
                 stroke=\"#{red:02x}{green:02x}{blue:02x}\"/>",
                from.x, from.y, to.x, to.y
            ),
            Mark::Text(text) => element_of_text(text, figure.font_size(text)),
        };
        writeln!(svg, "{element}").expect("writing to a string cannot fail");
    }
    Ok((svg + "</svg>\n").into_bytes())
}

fn element_of_picture(picture: &Picture) -> Result<String> {
    let Picture { frame, rows, cols, cells } = picture;
    let channels = if picture.is_opaque() { 3 } else { 4 };
    let pixels: Vec<u8> = cells.iter().flat_map(|cell| &cell[..channels]).copied().collect();
    let colours = match channels {
        3 => image::ExtendedColorType::Rgb8,
        _ => image::ExtendedColorType::Rgba8,
    };
    let png = base64(&png(&pixels, [*cols as u32, *rows as u32], colours)?);
    // The edges of cells stay sharp: the attribute is that of SVG 1.1, the style that of browsers.
    Ok(format!(
        "<image x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" preserveAspectRatio=\"none\" \
         image-rendering=\"optimizeSpeed\" style=\"image-rendering: pixelated\" \
         xlink:href=\"data:image/png;base64,{png}\"/>",
        frame.left, frame.top, frame.width, frame.height
    ))
}

/// The text has the width that it has in the font of the figure.
fn element_of_text(text: &Text, size: f32) -> String {
    let turned = if text.upwards { " rotate(-90)" } else { "" };
    let Text { at, start: [x, y], width, .. } = text;
    format!(
        "<text transform=\"translate({} {}){turned}\" x=\"{x:.2}\" y=\"{y:.2}\" \
         font-size=\"{size:.2}\" textLength=\"{width:.2}\">{}</text>",
        at.x,
        at.y,
        escaped(&text.text)
    )
}

/// Text as XML, in which control characters are not allowed.
fn escaped(text: &str) -> String {
    let mut xml = String::new();
    for letter in text.chars() {
        match letter {
            '&' => xml += "&amp;",
            '<' => xml += "&lt;",
            '>' => xml += "&gt;",
            other if other.is_control() => xml.push(char::REPLACEMENT_CHARACTER),
            other => xml.push(other),
        }
    }
    xml
}

#[cfg(test)]
mod tests {
    use super::super::figure::{Anchor, Frame};
    use super::*;
    use glam::DVec2;

    #[test]
    fn marks_are_elements() {
        let mut figure = Figure::new("<a> & \u{1}", [100, 80]).unwrap();
        let frame = Frame { left: 10, top: 20, width: 30, height: 40 };
        figure.fill(frame, (1, 2), |_, col| [[1, 2, 3], [4, 5, 6]][col]);
        figure.line(DVec2::new(1.0, 2.0), DVec2::new(3.5, 4.0), 1.5, [255, 0, 16]);
        figure.text("extinction (km\u{207b}\u{b9})", 20.0, Anchor::UpwardsLeftOf, 50, 60);
        let svg = String::from_utf8(encode(&figure).unwrap()).unwrap();
        assert!(svg.contains("<title>&lt;a&gt; &amp; \u{fffd}</title>"), "{svg}");
        assert!(svg.contains(
            "<path d=\"M1.00 2.00L3.50 4.00\" stroke-width=\"1.5\" stroke=\"#ff0010\"/>"
        ));
        assert!(svg.contains("<text transform=\"translate(50 60) rotate(-90)\""), "{svg}");
        assert!(svg.contains(">extinction (km\u{207b}\u{b9})</text>"), "{svg}");
        assert!(svg.contains("<image x=\"10\" y=\"20\" width=\"30\" height=\"40\""), "{svg}");
        let (_, data) = svg.split_once("base64,").unwrap();
        let pixels: [[u8; 3]; 2] = [[1, 2, 3], [4, 5, 6]];
        let png = png(pixels.as_flattened(), [2, 1], image::ExtendedColorType::Rgb8).unwrap();
        assert!(data.starts_with(&(base64(&png) + "\"")));
    }
}
