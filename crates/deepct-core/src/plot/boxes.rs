//! Box plots of the distribution of values in groups.

use super::figure::{Anchor, BLACK, Colour, Figure, Frame, LABEL, TICK, TITLE};
use super::panel::ticks;
use crate::error::{Error, Result};
use glam::DVec2;

const FILL: Colour = [120, 160, 210];
const MEDIAN: Colour = [200, 40, 30];
/// Width of a group (pixels).
const STEP: i32 = 130;

/// A named group of values.
#[derive(Debug, Clone, PartialEq)]
pub struct BoxGroup {
    /// The label below the box.
    pub name: &'static str,
    /// The values.
    pub values: Vec<f64>,
}

/// Minimum, quartiles and maximum.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Quartiles {
    low: f64,
    first: f64,
    median: f64,
    third: f64,
    high: f64,
}

impl Quartiles {
    /// The quartiles of `values`, by linear interpolation between the sorted values.
    fn of(values: &[f64]) -> Self {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let at = |share: f64| {
            let place = share * (sorted.len() - 1) as f64;
            let (below, above) = (place.floor() as usize, place.ceil() as usize);
            sorted[below] + (place - below as f64) * (sorted[above] - sorted[below])
        };
        Self { low: at(0.0), first: at(0.25), median: at(0.5), third: at(0.75), high: at(1.0) }
    }
}

/// Draw box plots, with one panel for each label and its groups. A box extends from
/// the first to the third quartile and shows the median, whiskers extend to the extremes, and
/// each value is shown as a point.
///
/// # Errors
/// Returns an error if a group has no values or if a value is not finite.
pub fn box_figure(panels: &[(&str, Vec<BoxGroup>)], title: &str) -> Result<Figure> {
    let groups = || panels.iter().flat_map(|(_, groups)| groups);
    if let Some(group) = groups().find(|group| group.values.is_empty()) {
        return Err(Error::out_of_range("numbers of a box", group.name, "at least one"));
    }
    if let Some(value) = groups().flat_map(|group| &group.values).find(|value| !value.is_finite()) {
        return Err(Error::out_of_range("number of a box", value, "finite"));
    }
    let widths = panels.iter().map(|(_, groups)| groups.len() as i32 * STEP);
    let total = widths.clone().map(|width| width + 120).sum::<i32>().max(400);
    let mut figure = Figure::new(title, [total, 560])?;
    figure.text(title, TITLE, Anchor::On, total / 2, 36);
    let mut left = 90;
    for ((label, groups), width) in panels.iter().zip(widths) {
        draw_panel(&mut figure, Frame { left, top: 80, width, height: 400 }, label, groups);
        left += width + 120;
    }
    Ok(figure)
}

fn draw_panel(figure: &mut Figure, frame: Frame, label: &str, groups: &[BoxGroup]) {
    let values = || groups.iter().flat_map(|group| &group.values).copied();
    let (low, high) = (values().fold(0.0, f64::min), values().fold(0.0, f64::max));
    let margin = 0.05 * (high - low).max(1e-9);
    let low = if low < 0.0 { low - margin } else { low };
    let range = low..high + margin;
    let height = |value: f64| {
        let share = (value - range.start) / (range.end - range.start);
        f64::from(frame.bottom()) - share * f64::from(frame.height)
    };
    figure.border(frame);
    let right = f64::from(frame.right());
    let left = f64::from(frame.left);
    for (value, text) in ticks(&range, frame.height / 50) {
        let y = height(value);
        figure.line(DVec2::new(left - 6.0, y), DVec2::new(left, y), 1.0, BLACK);
        figure.text(&text, TICK, Anchor::LeftOf, frame.left - 9, y as i32);
    }
    figure.line(DVec2::new(left, height(0.0)), DVec2::new(right, height(0.0)), 1.0, [170; 3]);
    figure.text(label, LABEL, Anchor::UpwardsLeftOf, frame.left - 52, frame.half_way());
    for (number, group) in groups.iter().enumerate() {
        let middle = frame.left + STEP / 2 + number as i32 * STEP;
        draw_box(figure, f64::from(middle), &Quartiles::of(&group.values), &height);
        for value in &group.values {
            let point = DVec2::new(f64::from(middle) + 0.32 * f64::from(STEP), height(*value));
            figure.line(point - DVec2::X * 2.0, point + DVec2::X * 2.0, 4.0, [90; 3]);
        }
        figure.text(group.name, LABEL, Anchor::Below, middle, frame.bottom() + 12);
    }
}

fn draw_box(figure: &mut Figure, middle: f64, of: &Quartiles, height: &dyn Fn(f64) -> f64) {
    let half = 0.2 * f64::from(STEP);
    let at = |x: f64, value: f64| DVec2::new(middle + x * half, height(value));
    figure.line(at(0.0, of.low), at(0.0, of.high), 1.5, BLACK);
    let (top, bottom) = (height(of.third), height(of.first));
    let frame = Frame {
        left: (middle - half) as i32,
        top: top as i32,
        width: (2.0 * half) as i32,
        height: ((bottom - top) as i32).max(1),
    };
    figure.fill(frame, (1, 1), |_, _| FILL);
    figure.border(frame);
    figure.line(at(-1.0, of.median), at(1.0, of.median), 3.0, MEDIAN);
    for value in [of.low, of.high] {
        figure.line(at(-0.5, value), at(0.5, value), 1.5, BLACK);
    }
}

#[cfg(test)]
mod tests {
    use super::super::Format;
    use super::*;

    /// numpy.percentile([1, 2, 4, 8, 16, 32], [0, 25, 50, 75, 100]).
    #[test]
    fn quartiles_are_those_of_numpy() {
        let found = Quartiles::of(&[16.0, 1.0, 8.0, 2.0, 32.0, 4.0]);
        let expected = Quartiles { low: 1.0, first: 2.5, median: 6.0, third: 14.0, high: 32.0 };
        assert_eq!(found, expected);
        let one = Quartiles::of(&[3.0]);
        assert!(one.low == 3.0 && one.median == 3.0 && one.high == 3.0);
    }

    #[test]
    fn a_figure_is_drawn_and_nothing_is_refused() {
        let group = |values: &[f64]| BoxGroup { name: "network", values: values.into() };
        let panels = [("error (%)", vec![group(&[1.0, 2.0, 7.0]), group(&[-3.0])])];
        let figure = box_figure(&panels, "Errors").unwrap();
        let png = figure.encode(Format::Png).unwrap();
        let picture = image::load_from_memory(&png).unwrap().to_rgb8();
        assert!(picture.pixels().any(|pixel| pixel.0 == FILL));
        assert!(box_figure(&[("", vec![group(&[])])], "").is_err());
        assert!(box_figure(&[("", vec![group(&[f64::NAN])])], "").is_err());
    }
}
