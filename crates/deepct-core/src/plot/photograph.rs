//! Pictures of scenes as a camera sees them, side by side with the same exposure.

use super::figure::{Anchor, Figure, Frame, LABEL, TICK, TITLE};
use super::panel::robust_limit;
use crate::error::{Error, Result};
use ndarray::Array2;

/// Number of pixels of the figure along each side of a pixel.
const ZOOM: usize = 2;
/// Distance between pictures (pixels).
const GAP: i32 = 24;
/// Height of the title and the names of the pictures (pixels).
const HEAD: i32 = 96;
/// Height of the line at the bottom (pixels).
const FOOT: i32 = 44;

/// Draw pictures with their names. The radiances are in any unit, with the first row at
/// the top. White is the 99.8th percentile of all pixels, and the tone curve is that of sRGB.
///
/// # Errors
/// Returns an error if there is no picture, or if pictures differ in size or are empty.
pub fn photograph_figure(
    pictures: &[(&str, Array2<f32>)],
    title: &str,
    caption: &str,
) -> Result<Figure> {
    let size = pictures.first().map_or((0, 0), |(_, picture)| picture.dim());
    if size.0 == 0 || size.1 == 0 {
        return Err(Error::out_of_range("pictures", "none", "at least one that is not empty"));
    }
    if let Some((name, other)) = pictures.iter().find(|(_, picture)| picture.dim() != size) {
        let text = |(rows, cols): (usize, usize)| format!("{rows} x {cols} pixels");
        let remedy = "give pictures of one size";
        return Err(Error::mismatch(*name, text(size), text(other.dim()), remedy));
    }
    let values = pictures.iter().flat_map(|(_, picture)| picture).map(|&value| f64::from(value));
    let white = robust_limit(values).max(f64::MIN_POSITIVE);
    let [height, width] = [size.0, size.1].map(|n| (n * ZOOM) as i32);
    let across = GAP + pictures.len() as i32 * (width + GAP);
    let mut figure = Figure::new(title, [across, HEAD + height + FOOT])?;
    figure.text(title, TITLE, Anchor::On, across / 2, 32);
    for ((name, picture), number) in pictures.iter().zip(0..) {
        let frame = Frame { left: GAP + number * (width + GAP), top: HEAD, width, height };
        figure.text(name, LABEL, Anchor::Above, frame.middle(), frame.top - 8);
        figure.fill(frame, size, |row, col| {
            [(255.0 * tone(f64::from(picture[[row, col]]) / white)).round() as u8; 3]
        });
        figure.border(frame);
    }
    figure.text(caption, TICK, Anchor::On, across / 2, HEAD + height + FOOT / 2);
    Ok(figure)
}

/// The tone curve of sRGB (IEC 61966-2-1): the value of a pixel for a share of the light of white.
fn tone(light: f64) -> f64 {
    let light = light.clamp(0.0, 1.0);
    if light <= 0.003_130_8 { 12.92 * light } else { 1.055 * light.powf(1.0 / 2.4) - 0.055 }
}

#[cfg(test)]
mod tests {
    use super::super::Format;
    use super::*;

    /// Middle grey of 18 % has the value 118 of sRGB, and 21.4 % have 127.5.
    #[test]
    fn the_tone_curve_is_that_of_srgb() {
        assert!((255.0 * tone(0.18) - 117.6).abs() < 0.1, "{}", 255.0 * tone(0.18));
        assert!((tone(0.2140) - 0.5).abs() < 1e-3);
        assert_eq!((tone(-1.0), tone(0.0)), (0.0, 0.0));
        assert!((tone(2.0) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn pictures_have_one_exposure() {
        let bright = Array2::from_elem((4, 6), 1.0_f32);
        let dark = &bright * 0.18;
        let pictures = [("a", bright.clone()), ("b", dark)];
        let png = photograph_figure(&pictures, "", "").unwrap().encode(Format::Png).unwrap();
        let picture = image::load_from_memory(&png).unwrap().to_rgb8();
        let at = |x: i32| picture.get_pixel(x as u32, HEAD as u32 + 3).0[0];
        assert_eq!((at(GAP + 2), at(2 * GAP + 12 + 2)), (255, 118));
        assert!(photograph_figure(&[], "", "").is_err());
        let other = Array2::from_elem((4, 5), 1.0_f32);
        assert!(photograph_figure(&[("a", bright), ("b", other)], "", "").is_err());
    }
}
