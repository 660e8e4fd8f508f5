//! Which pixels of an image a file contains, and in which order.

use super::Input;
use crate::error::Result;
use ndarray::{Array3, ArrayD, Axis};
use std::ops::Range;

/// The axes of an image, with the variable that holds the position of the target on them. Pixel
/// centres have the numbers of the axis, so that these positions also hold for parts of an image.
pub(super) const PIXEL_AXES: [(&str, &str); 2] = [("row", "target_row"), ("col", "target_col")];

/// What the pixel numbers of a file say about its images, which may be parts or averages of others.
pub(super) struct Window {
    /// The centre of each image relative to the target, `[row, col]` (pixels).
    pub(super) shifts: Vec<[f64; 2]>,
    /// The width of a pixel in pixels of the camera.
    pub(super) pixel: f64,
    /// Whether the pixel numbers decrease along rows and columns.
    reversed: [bool; 2],
}

/// The directions in which pixel numbers increase along rows and columns.
const DIRECTIONS: [(&str, &str); 2] = [("south", "north"), ("west", "east")];

impl Window {
    /// # Errors
    /// Returns an error if the numbers are not equidistant, if pixels are not squares, or if the
    /// images are not whole and the pixel of the target is unknown.
    pub(super) fn read(
        input: &Input,
        axes: [&'static str; 2],
        [count, rows, cols]: [usize; 3],
    ) -> Result<Self> {
        let mut window = Self { shifts: vec![[0.0; 2]; count], pixel: 1.0, reversed: [false; 2] };
        let mut steps = [1.0; 2];
        for (axis, (name, size)) in axes.into_iter().zip([rows, cols]).enumerate() {
            let (_, target) = PIXEL_AXES[axis];
            let [first, last] = pixel_numbers(input, name, size)?;
            let step = if size > 1 { (last - first) / (size - 1) as f64 } else { 1.0 };
            (steps[axis], window.reversed[axis]) = (step.abs(), step < 0.0);
            let middle = 0.5 * (first + last);
            if input.has(target) {
                let at: ArrayD<f64> = input.variable_on(target, &["view"])?.reals_of_layout("1")?;
                check_count(input, target, at.len(), count)?;
                for (shift, at) in window.shifts.iter_mut().zip(at) {
                    shift[axis] = (middle - at) / step.abs();
                }
            } else if first.min(last) != 0.0 || step.abs() != 1.0 {
                let problem = format!(
                    "begins with {first} in steps of {step}: the images are parts or averages of \
                     others, and it is unknown which pixel shows the target"
                );
                let remedy = format!("add {target}(view), the position of the target along {name}");
                return Err(input.error(name, problem, &remedy));
            }
        }
        let [tall, wide] = steps;
        if (tall - wide).abs() > 1e-6 * tall {
            let problem = format!("have steps of {tall} and {wide}, but pixels must be squares");
            return Err(input.error("row, col", problem, "average as many rows as columns"));
        }
        window.pixel = tall;
        Ok(window)
    }

    /// What the order of the pixels means, unless it is that of deepct.
    pub(super) fn notes(&self, axes: [&str; 2]) -> Vec<String> {
        let reversed = (0..2).filter(|&axis| self.reversed[axis]);
        let note = |axis: usize| {
            let (from, to) = DIRECTIONS[axis];
            format!(
                "{} decreases: the first pixels are in the {to}, the last in the {from}",
                axes[axis]
            )
        };
        reversed.map(note).collect()
    }

    /// The ranges of the file that hold these rows (from the south) and columns (from the west) of images
    /// of the size `whole`.
    pub(super) fn in_file(
        &self,
        ranges: [Range<usize>; 2],
        whole: [usize; 2],
    ) -> [Range<usize>; 2] {
        [0, 1].map(|axis| {
            let Range { start, end } = ranges[axis];
            if self.reversed[axis] { whole[axis] - end..whole[axis] - start } else { start..end }
        })
    }

    /// The images with rows to the north and columns to the east.
    pub(super) fn oriented<T>(&self, mut pixels: Array3<T>) -> Array3<T> {
        for (axis, _) in self.reversed.iter().enumerate().filter(|(_, reversed)| **reversed) {
            pixels.invert_axis(Axis(1 + axis));
        }
        pixels
    }
}

/// The first and the last number of the pixels along an axis; from 0 if the file does not number
/// them. Of positions, which have a unit, only the direction counts.
fn pixel_numbers(input: &Input, name: &str, count: usize) -> Result<[f64; 2]> {
    let last = count as f64 - 1.0;
    if !input.has(name) {
        return Ok([0.0, last]);
    }
    let axis = input.variable_on(name, &[name])?;
    let is_position = axis.unit_text().is_some_and(|unit| unit != "1");
    let numbers: ArrayD<f64> = axis.reals()?;
    check_count(input, name, numbers.len(), count)?;
    let numbers: Vec<f64> = numbers.into_iter().collect();
    let ends = [numbers[0], numbers[count - 1]];
    let step = (ends[1] - ends[0]) / last.max(1.0);
    let expected = |index: usize| ends[0] + step * index as f64;
    let off = numbers.iter().enumerate().map(|(index, number)| (number - expected(index)).abs());
    // Positions may be rounded.
    let tolerance = if is_position { 0.1 } else { 1e-6 };
    if off.fold(0.0, f64::max) <= tolerance * step.abs() || count == 1 {
        return Ok(match is_position {
            true if step < 0.0 => [last, 0.0],
            true => [0.0, last],
            false => ends,
        });
    }
    let problem = "holds pixel numbers that are not equidistant";
    Err(input.error(name, problem, "give whole images, or select pixels in equal steps"))
}

/// The names of the dimensions of the rows and the columns of the images.
pub(super) fn pixel_axes(input: &Input) -> Result<[&'static str; 2]> {
    let radiance = input.variable("radiance")?;
    let has = |name| (0..radiance.shape.len()).any(|axis| radiance.dimension(axis) == Some(name));
    let named = |(name, _): (&'static str, _), other| if has(other) { other } else { name };
    Ok([named(PIXEL_AXES[0], "y"), named(PIXEL_AXES[1], "x")])
}

/// Check the number of values that a variable has along the views.
pub(super) fn check_count(input: &Input, name: &str, found: usize, expected: usize) -> Result<()> {
    if found == expected {
        return Ok(());
    }
    let problem = format!("has {found} values, but the images require {expected}");
    Err(input.error(name, problem, "write one camera per image"))
}
