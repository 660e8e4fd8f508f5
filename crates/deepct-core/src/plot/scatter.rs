//! The scatter plot of an estimate against the truth.

use super::page::{Area, Drawn, Frame, TITLE, draw_page, letters};
use super::panel::{ColourScale, PanelAxis, draw_axes, draw_bar_with};
use super::volume::check_pair;
use crate::error::Result;
use crate::grid::Volume;
use crate::metrics::{check_truth, score};
use ndarray::Array2;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};
use std::path::Path;

/// Cells of the plot along each axis.
const CELLS: usize = 75;

/// Draw the estimated against the true extinction as a PNG file: the number of voxels
/// in each cell of the plane, on a logarithmic scale, and the red line of a perfect
/// reconstruction, as in the paper (Sde-Chen et al. 2021, figure 6).
///
/// # Errors
/// Volumes on different grids, negative or non-finite values, an empty truth, a file
/// that cannot be written.
pub fn scatter_figure(
    path: impl AsRef<Path>,
    truth: &Volume,
    estimate: &Volume,
    title: &str,
) -> Result<()> {
    check_pair(truth, estimate)?;
    check_truth(truth)?;
    let frame = Frame { left: 90, top: 110, width: 600, height: 600 };
    draw_page(path.as_ref(), [840, 790], |page| {
        let style = letters(TITLE, HPos::Center, VPos::Center);
        page.draw_text(title, &style, (frame.middle(), 40))?;
        draw_scatter(page, frame, truth, estimate)
    })
}

/// Draw the plot into `frame`, its colour bar to the right.
pub(super) fn draw_scatter(
    page: &Area<'_>,
    frame: Frame,
    truth: &Volume,
    estimate: &Volume,
) -> Drawn {
    let both = truth.values.iter().chain(&estimate.values);
    let greatest = f64::from(both.copied().fold(0.0, f32::max)).max(f64::MIN_POSITIVE);
    let counts = count_voxels(truth, estimate, greatest);
    let most = counts.iter().copied().max().unwrap_or(1).max(10);
    let scale = ColourScale::new(colorous::VIRIDIS, f64::from(most).log10());
    let edge = |cell: usize, length: i32| (cell * length as usize / CELLS) as i32;
    for ((row, col), &count) in counts.indexed_iter().filter(|(_, count)| **count > 0) {
        let left_bottom = (edge(col, frame.width), edge(row, frame.height));
        let right_top = (edge(col + 1, frame.width), edge(row + 1, frame.height));
        let corners = [
            (frame.left + left_bottom.0, frame.bottom() - right_top.1),
            (frame.left + right_top.0 - 1, frame.bottom() - left_bottom.1 - 1),
        ];
        page.draw(&Rectangle::new(corners, scale.colour(f64::from(count).log10()).filled()))?;
    }
    let identity = vec![(frame.left, frame.bottom()), (frame.right(), frame.top)];
    page.draw(&PathElement::new(identity, RED.stroke_width(2)))?;
    let axis = |label| PanelAxis { label, range: 0.0..greatest };
    let title = match score(truth, estimate) {
        Ok(scores) => {
            format!("\u{3b5} = {:.3}, \u{3b4} = {:.3}", scores.relative_error, scores.mass_error)
        }
        Err(_) => String::new(),
    };
    let (right, up) =
        (axis("true extinction (km\u{207b}\u{b9})"), axis("estimate (km\u{207b}\u{b9})"));
    draw_axes(page, frame, &title, &right, &up)?;
    let bar = Frame { left: frame.right() + 24, width: 18, ..frame };
    let decades = most.ilog10();
    let numbers: Vec<_> =
        (0..=decades).map(|power| (f64::from(power), 10_u64.pow(power).to_string())).collect();
    draw_bar_with(page, bar, scale, "voxels", &numbers)
}

/// Voxels by estimate (row) and truth (column), both from zero to `greatest`.
fn count_voxels(truth: &Volume, estimate: &Volume, greatest: f64) -> Array2<u32> {
    let mut counts = Array2::zeros((CELLS, CELLS));
    let cell = |value: f32| ((f64::from(value) / greatest * CELLS as f64) as usize).min(CELLS - 1);
    for (&truth, &estimate) in truth.values.iter().zip(&estimate.values) {
        counts[[cell(estimate), cell(truth)]] += 1;
    }
    counts
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;
    use crate::math::DVec3;
    use ndarray::Array3;

    #[test]
    fn every_voxel_is_in_one_cell() {
        let grid = Grid::new(DVec3::ZERO, DVec3::ONE, [3, 4, 5]).unwrap();
        let truth = Array3::from_shape_fn(grid.shape, |(k, j, i)| (k + j + i) as f32);
        let truth = Volume::new(grid, truth).unwrap();
        let counts = count_voxels(&truth, &Volume::constant(grid, 9.0), 9.0);
        assert_eq!(counts.sum(), 60);
        assert_eq!(counts.row(CELLS - 1).sum(), 60);
        assert_eq!((counts[[CELLS - 1, 0]], counts[[CELLS - 1, CELLS - 1]]), (1, 1));
    }
}
