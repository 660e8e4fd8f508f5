//! A panel: a colour map of values with axes, and its colour bar.

use super::figure::{Anchor, BLACK, Colour, Figure, Frame, LABEL, TICK};
use colorous::Gradient;
use glam::DVec2;
use ndarray::ArrayView2;
use std::ops::Range;

/// Percentage of the values that are not zero up to which a scale extends, so that single bright
/// ones do not darken all others.
const ROBUST: f64 = 99.8;

/// The end of a colour scale for values that are not negative: their percentile, without zeros.
pub(super) fn robust_limit(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.filter(|value| *value > 0.0).collect();
    if values.is_empty() {
        return 0.0;
    }
    let place = (ROBUST / 100.0 * (values.len() - 1) as f64).ceil() as usize;
    *values.select_nth_unstable_by(place, f64::total_cmp).1
}

/// The colour scale of values from `low` to `high`.
#[derive(Clone, Copy)]
pub(super) struct ColourScale {
    gradient: Gradient,
    /// The value at the beginning of the scale.
    low: f64,
    /// The value at the end of the scale.
    pub(super) high: f64,
    reversed: bool,
}

impl ColourScale {
    /// A colour scale from zero to `high`, or to 1 if `high` is not positive.
    pub(super) fn new(gradient: Gradient, high: f64) -> Self {
        Self { gradient, low: 0.0, high: if high > 0.0 { high } else { 1.0 }, reversed: false }
    }

    /// A colour scale from `-high` to `high`, or of 1 if `high` is not positive.
    pub(super) fn diverging(gradient: Gradient, high: f64) -> Self {
        let scale = Self::new(gradient, high);
        Self { low: -scale.high, ..scale }
    }

    /// The same scale with the colours in reverse order.
    pub(super) fn reversed(self) -> Self {
        Self { reversed: !self.reversed, ..self }
    }

    /// The place of a value on the scale, from 0 to 1.
    fn share(&self, value: f64) -> f64 {
        (value - self.low) / (self.high - self.low)
    }

    pub(super) fn colour(&self, value: f64) -> Colour {
        let share = self.share(value).clamp(0.0, 1.0);
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
    pub(super) fn draw(&self, figure: &mut Figure, frame: Frame) {
        draw_map(figure, frame, self.values.dim(), |at| self.scale.colour(self.values[at]));
        draw_axes(figure, frame, &self.title, &self.right, &self.up);
    }
}

/// Fill `frame` with `rows` x `cols` cells, the first row at the bottom.
pub(super) fn draw_map(
    figure: &mut Figure,
    frame: Frame,
    (rows, cols): (usize, usize),
    colour: impl Fn([usize; 2]) -> Colour,
) {
    figure.fill(frame, (rows, cols), |row, col| colour([rows - 1 - row, col]));
    figure.border(frame);
}

/// Draw the frame, ticks, tick labels, axis labels and title of a panel.
pub(super) fn draw_axes(
    figure: &mut Figure,
    frame: Frame,
    title: &str,
    right: &PanelAxis,
    up: &PanelAxis,
) {
    figure.border(frame);
    let at = |value: f64, range: &Range<f64>, pixels: i32| {
        ((value - range.start) / (range.end - range.start) * f64::from(pixels - 1)).round() as i32
    };
    for (value, text) in ticks(&right.range, frame.width / 60) {
        let x = frame.left + at(value, &right.range, frame.width);
        tick(figure, (x, frame.bottom()), (0, 5));
        figure.text(&text, TICK, Anchor::Below, x, frame.bottom() + 7);
    }
    for (value, text) in ticks(&up.range, frame.height / 32) {
        let y = frame.bottom() - 1 - at(value, &up.range, frame.height);
        tick(figure, (frame.left - 1, y), (-5, 0));
        figure.text(&text, TICK, Anchor::LeftOf, frame.left - 9, y);
    }
    figure.text(right.label, LABEL, Anchor::Below, frame.middle(), frame.bottom() + 28);
    figure.text(up.label, LABEL, Anchor::UpwardsLeftOf, frame.left - 46, frame.half_way());
    figure.text(title, LABEL, Anchor::Above, frame.middle(), frame.top - 6);
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
        Self { scale, label, numbers: ticks(&(scale.low..scale.high), (height / 40).min(8)) }
    }

    /// Draw the bar into `frame`, with tick labels and label to its right.
    pub(super) fn draw(&self, figure: &mut Figure, frame: Frame) {
        let steps = frame.height as usize;
        figure.fill(frame, (steps, 1), |row, _| {
            let share = ((steps - row) as f64 - 0.5) / steps as f64;
            self.scale.colour(self.scale.low + share * (self.scale.high - self.scale.low))
        });
        figure.border(frame);
        for (value, text) in &self.numbers {
            let up = (self.scale.share(*value) * f64::from(frame.height - 1)).round() as i32;
            let y = frame.bottom() - 1 - up;
            tick(figure, (frame.right(), y), (5, 0));
            figure.text(text, TICK, Anchor::RightOf, frame.right() + 9, y);
        }
        let widths = self.numbers.iter().map(|(_, text)| figure.text_width(text, TICK));
        let x = frame.right() + 15 + widths.max().unwrap_or(0);
        figure.text(self.label, LABEL, Anchor::UpwardsRightOf, x, frame.half_way());
    }
}

fn tick(figure: &mut Figure, (x, y): (i32, i32), (dx, dy): (i32, i32)) {
    let from = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
    figure.line(from, from + DVec2::new(f64::from(dx), f64::from(dy)), 1.0, BLACK);
}

/// Round numbers in a range for ticks, as values and as text with the required number of decimals.
/// They divide the range into at most `max(most, 2)` intervals, unless there would be less than two.
pub(super) fn ticks(range: &Range<f64>, most: i32) -> Vec<(f64, String)> {
    let rough = (range.end - range.start) / f64::from(most.max(2));
    let power = 10_f64.powf(rough.log10().floor());
    let places = |step: f64| {
        let first = (range.start / step - 1e-6).ceil() as i64;
        first..=(range.end / step + 1e-6).floor() as i64
    };
    let steps = [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0].map(|factor| factor * power);
    let is_axis = |step: &f64| places(*step).count() > 1;
    let step = steps.into_iter().find(|step| *step >= rough * (1.0 - 1e-9)).filter(is_axis);
    let step = step.or_else(|| steps.into_iter().rev().find(is_axis)).unwrap_or(power);
    let decimals = (-(step.log10() + 1e-9).floor()).max(0.0) as usize;
    places(step)
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
        // One number alone does not make an axis.
        assert_eq!(text(0.6..1.7, 2), ["1.0", "1.5"]);
    }

    /// numpy.percentile([1, ..., 1000], 99.8, method="higher").
    #[test]
    fn single_bright_values_do_not_stretch_a_scale() {
        let values = || (1..=1000).map(f64::from);
        assert_eq!(robust_limit(values()), 999.0);
        assert_eq!(robust_limit(values().chain([1e9]).chain([0.0; 5000])), 999.0);
        assert_eq!(robust_limit([0.0].into_iter()), 0.0);
    }

    #[test]
    fn the_middle_of_a_diverging_scale_is_zero() {
        let scale = ColourScale::diverging(colorous::RED_BLUE, 4.0);
        let of = |share| {
            let colour = colorous::RED_BLUE.eval_continuous(share);
            [colour.r, colour.g, colour.b]
        };
        assert_eq!([-4.0, 0.0, 4.0].map(|value| scale.colour(value)), [0.0, 0.5, 1.0].map(of));
    }
}
