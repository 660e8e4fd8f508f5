//! A panel: a colour map of values with axes, and its colour bar.

use super::page::{Anchor, BLACK, Colour, Frame, LABEL, Page, TICK};
use colorous::Gradient;
use glam::DVec2;
use ndarray::ArrayView2;
use std::ops::Range;

/// The colour scale of values from zero to `high`.
#[derive(Clone, Copy)]
pub(super) struct ColourScale {
    gradient: Gradient,
    /// The value at the end of the scale.
    pub(super) high: f64,
    reversed: bool,
}

impl ColourScale {
    /// A colour scale from zero to `high`, or to 1 if `high` is not positive.
    pub(super) fn new(gradient: Gradient, high: f64) -> Self {
        Self { gradient, high: if high > 0.0 { high } else { 1.0 }, reversed: false }
    }

    /// The same scale with the colours in reverse order.
    pub(super) fn reversed(self) -> Self {
        Self { reversed: !self.reversed, ..self }
    }

    pub(super) fn colour(&self, value: f64) -> Colour {
        let share = (value / self.high).clamp(0.0, 1.0);
        let share = if self.reversed { 1.0 - share } else { share };
        let colour = self.gradient.eval_continuous(share);
        [colour.r, colour.g, colour.b]
    }
}

/// The label and range of an axis of a panel.
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
    /// Draw the map into `frame` and the labels outside it.
    pub(super) fn draw(&self, page: &mut Page, frame: Frame) {
        draw_map(page, frame, self.values.dim(), |at| self.scale.colour(self.values[at]));
        draw_axes(page, frame, &self.title, &self.right, &self.up);
    }
}

/// Fill `frame` with `rows` x `cols` cells, the first row at the bottom.
pub(super) fn draw_map(
    page: &mut Page,
    frame: Frame,
    (rows, cols): (usize, usize),
    colour: impl Fn([usize; 2]) -> Colour,
) {
    page.fill(frame, |x, y| {
        let row = (frame.height - 1 - y) as usize * rows / frame.height as usize;
        colour([row, x as usize * cols / frame.width as usize])
    });
    page.border(frame);
}

/// Draw the frame, ticks, tick labels, axis labels and title of a panel.
pub(super) fn draw_axes(
    page: &mut Page,
    frame: Frame,
    title: &str,
    right: &PanelAxis,
    up: &PanelAxis,
) {
    page.border(frame);
    let at = |value: f64, range: &Range<f64>, pixels: i32| {
        ((value - range.start) / (range.end - range.start) * f64::from(pixels - 1)).round() as i32
    };
    for (value, text) in ticks(&right.range, frame.width / 60) {
        let x = frame.left + at(value, &right.range, frame.width);
        tick(page, (x, frame.bottom()), (0, 5));
        page.text(&text, TICK, Anchor::Below, x, frame.bottom() + 7);
    }
    for (value, text) in ticks(&up.range, frame.height / 32) {
        let y = frame.bottom() - 1 - at(value, &up.range, frame.height);
        tick(page, (frame.left - 1, y), (-5, 0));
        page.text(&text, TICK, Anchor::LeftOf, frame.left - 9, y);
    }
    page.text(right.label, LABEL, Anchor::Below, frame.middle(), frame.bottom() + 28);
    page.text(up.label, LABEL, Anchor::UpwardsLeftOf, frame.left - 46, frame.half_way());
    page.text(title, LABEL, Anchor::Above, frame.middle(), frame.top - 6);
}

/// The colour bar of a scale.
pub(super) struct ColourBar<'a> {
    pub(super) scale: ColourScale,
    pub(super) label: &'a str,
    /// Values on the scale and their tick labels.
    pub(super) numbers: Vec<(f64, String)>,
}

impl<'a> ColourBar<'a> {
    /// The colour bar of a linear scale, to be drawn with a height of `height` pixels.
    pub(super) fn linear(scale: ColourScale, label: &'a str, height: i32) -> Self {
        Self { scale, label, numbers: ticks(&(0.0..scale.high), (height / 40).min(8)) }
    }

    /// Draw the bar into `frame`, with tick labels and label to its right.
    pub(super) fn draw(&self, page: &mut Page, frame: Frame) {
        page.fill(frame, |_, y| {
            let share = (f64::from(frame.height - y) - 0.5) / f64::from(frame.height);
            self.scale.colour(share * self.scale.high)
        });
        page.border(frame);
        for (value, text) in &self.numbers {
            let up = (value / self.scale.high * f64::from(frame.height - 1)).round() as i32;
            let y = frame.bottom() - 1 - up;
            tick(page, (frame.right(), y), (5, 0));
            page.text(text, TICK, Anchor::RightOf, frame.right() + 9, y);
        }
        let widths = self.numbers.iter().map(|(_, text)| page.text_width(text, TICK));
        let x = frame.right() + 15 + widths.max().unwrap_or(0);
        page.text(self.label, LABEL, Anchor::UpwardsRightOf, x, frame.half_way());
    }
}

fn tick(page: &mut Page, (x, y): (i32, i32), (dx, dy): (i32, i32)) {
    let from = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
    page.line(from, from + DVec2::new(f64::from(dx), f64::from(dy)), 1.0, BLACK);
}

/// Round numbers in a range for ticks, as values and as text with the required number of decimals.
/// They divide the range into at most `max(most, 2)` intervals.
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
