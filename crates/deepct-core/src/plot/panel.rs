//! A panel: a map of values in colour with axes, and its colour bar.

use super::page::{Area, Drawn, Frame, LABEL, TICK, letters, upward_letters};
use ndarray::ArrayView2;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};
use std::ops::Range;

/// A colour map.
pub(super) type Gradient = colorous::Gradient;

/// The colours of values from zero to `high`.
#[derive(Clone, Copy)]
pub(super) struct ColourScale {
    pub(super) gradient: Gradient,
    pub(super) high: f64,
    /// Whether the gradient's end stands for zero.
    pub(super) reversed: bool,
}

impl ColourScale {
    /// Colours from zero to `high`; to 1 where there is nothing to show.
    pub(super) fn new(gradient: Gradient, high: f64) -> Self {
        Self { gradient, high: if high > 0.0 { high } else { 1.0 }, reversed: false }
    }

    pub(super) fn colour(&self, value: f64) -> RGBColor {
        let share = (value / self.high).clamp(0.0, 1.0);
        let share = if self.reversed { 1.0 - share } else { share };
        let colour = self.gradient.eval_continuous(share);
        RGBColor(colour.r, colour.g, colour.b)
    }
}

/// An axis of a panel: what it shows, and from where to where.
#[derive(Clone)]
pub(super) struct PanelAxis {
    pub(super) label: &'static str,
    pub(super) range: Range<f64>,
}

/// A map of values with its axes.
pub(super) struct Panel<'a> {
    pub(super) title: String,
    /// Values `[up, right]`: the first row is drawn at the bottom.
    pub(super) values: ArrayView2<'a, f64>,
    pub(super) right: PanelAxis,
    pub(super) up: PanelAxis,
    pub(super) scale: ColourScale,
}

impl Panel<'_> {
    /// Draw the map into `frame`, the labels outside it.
    pub(super) fn draw(&self, page: &Area<'_>, frame: Frame) -> Drawn {
        self.draw_cells(page, frame)?;
        draw_axes(page, frame, &self.title, &self.right, &self.up)
    }

    /// One colour per pixel of the page, so that cells of any size leave no seam.
    fn draw_cells(&self, page: &Area<'_>, frame: Frame) -> Drawn {
        let (rows, cols) = self.values.dim();
        for y in 0..frame.height {
            let row = ((frame.height - 1 - y) as usize * rows) / frame.height as usize;
            for x in 0..frame.width {
                let col = x as usize * cols / frame.width as usize;
                let colour = self.scale.colour(self.values[[row, col]]);
                page.draw_pixel((frame.left + x, frame.top + y), &colour)?;
            }
        }
        Ok(())
    }
}

/// Frame, ticks, numbers, labels and title around a panel.
pub(super) fn draw_axes(
    page: &Area<'_>,
    frame: Frame,
    title: &str,
    right: &PanelAxis,
    up: &PanelAxis,
) -> Drawn {
    draw_border(page, frame)?;
    let at = |value: f64, range: &Range<f64>, pixels: i32| {
        ((value - range.start) / (range.end - range.start) * f64::from(pixels)).round() as i32
    };
    for (value, text) in ticks(&right.range, frame.width / 55) {
        let x = frame.left + at(value, &right.range, frame.width);
        tick(page, (x, frame.bottom()), (0, 5))?;
        let style = letters(TICK, HPos::Center, VPos::Top);
        page.draw_text(&text, &style, (x, frame.bottom() + 8))?;
    }
    for (value, text) in ticks(&up.range, frame.height / 30) {
        let y = frame.bottom() - at(value, &up.range, frame.height);
        tick(page, (frame.left, y), (-5, 0))?;
        let style = letters(TICK, HPos::Right, VPos::Center);
        page.draw_text(&text, &style, (frame.left - 8, y))?;
    }
    let below = letters(LABEL, HPos::Center, VPos::Top);
    page.draw_text(right.label, &below, (frame.middle(), frame.bottom() + 28))?;
    let left = upward_letters(LABEL);
    page.draw_text(up.label, &left, (frame.left - 44, frame.top + frame.height / 2))?;
    let above = letters(LABEL, HPos::Center, VPos::Bottom);
    page.draw_text(title, &above, (frame.middle(), frame.top - 8))?;
    Ok(())
}

/// Draw the colours of `scale` as a bar with numbers and a label to its right.
pub(super) fn draw_colour_bar(
    page: &Area<'_>,
    frame: Frame,
    scale: ColourScale,
    label: &str,
) -> Drawn {
    let numbers = ticks(&(0.0..scale.high), frame.height / 40);
    draw_bar_with(page, frame, scale, label, &numbers)
}

/// As [`draw_colour_bar`], with given numbers at given values.
pub(super) fn draw_bar_with(
    page: &Area<'_>,
    frame: Frame,
    scale: ColourScale,
    label: &str,
    numbers: &[(f64, String)],
) -> Drawn {
    for y in 0..frame.height {
        let share = (f64::from(frame.height - y) - 0.5) / f64::from(frame.height);
        let colour = scale.colour(share * scale.high);
        for x in 0..frame.width {
            page.draw_pixel((frame.left + x, frame.top + y), &colour)?;
        }
    }
    draw_border(page, frame)?;
    let mut widest = 0;
    for (value, text) in numbers {
        let y = frame.bottom() - (value / scale.high * f64::from(frame.height)).round() as i32;
        tick(page, (frame.right(), y), (5, 0))?;
        let style = letters(TICK, HPos::Left, VPos::Center);
        page.draw_text(text, &style, (frame.right() + 8, y))?;
        widest = widest.max(page.estimate_text_size(text, &style)?.0 as i32);
    }
    let x = frame.right() + 8 + widest + 8;
    page.draw_text(label, &upward_letters(LABEL), (x, frame.top + frame.height / 2))?;
    Ok(())
}

pub(super) fn draw_border(page: &Area<'_>, frame: Frame) -> Drawn {
    let corners = [(frame.left - 1, frame.top - 1), (frame.right(), frame.bottom())];
    page.draw(&Rectangle::new(corners, BLACK))?;
    Ok(())
}

fn tick(page: &Area<'_>, from: (i32, i32), length: (i32, i32)) -> Drawn {
    let to = (from.0 + length.0, from.1 + length.1);
    page.draw(&PathElement::new(vec![from, to], BLACK))?;
    Ok(())
}

/// Round numbers in a range, at most `most` of them but at least two, as values and
/// as text with the decimals that they need.
pub(super) fn ticks(range: &Range<f64>, most: i32) -> Vec<(f64, String)> {
    let length = range.end - range.start;
    let rough = length / f64::from(most.max(2));
    let power = 10_f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|factor| factor * power);
    let step = step.into_iter().find(|step| *step >= rough * (1.0 - 1e-9)).unwrap_or(10.0 * power);
    let decimals = (-step.log10().floor()).max(0.0) as usize;
    let first = (range.start / step - 1e-6).ceil() as i64;
    let last = (range.end / step + 1e-6).floor() as i64;
    (first..=last)
        .map(|number| {
            let value = number as f64 * step;
            // No "-0.0".
            (value, format!("{:.decimals$}", if number == 0 { 0.0 } else { value }))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        let text = |range: Range<f64>, most| -> Vec<String> {
            ticks(&range, most).into_iter().map(|(_, text)| text).collect()
        };
        assert_eq!(text(0.0..1.6, 4), ["0.0", "0.5", "1.0", "1.5"]);
        assert_eq!(
            text(0.0..1.6, 9),
            ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0", "1.2", "1.4", "1.6"]
        );
        assert_eq!(text(-0.3..0.3, 3), ["-0.2", "0.0", "0.2"]);
        assert_eq!(text(0.0..137.0, 5), ["0", "50", "100"]);
        assert_eq!(text(0.0..0.034, 4), ["0.00", "0.01", "0.02", "0.03"]);
    }
}
