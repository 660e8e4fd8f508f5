//! Resampling of a field onto another grid.
//!
//! The axes are resampled one after another. If a new cell is at least as large as the old
//! cells that it overlaps, its value is their mean weighted by the overlap, which conserves the
//! integral (first-order conservative). If it is smaller, and the old cells have one size, its value is
//! interpolated linearly between their centres; between cells of different sizes this would not
//! conserve the integral, and the mean is used as well. The field is zero outside the old cells.

use super::{Grid, Mask, Volume};
use crate::error::{Error, Result};
use ndarray::{Array1, Array3, Axis};

/// The indices and weights of the old cells that contribute to one new cell.
type Row = Vec<(usize, f32)>;

/// The cell edges (km) that belong to given ascending cell centres (km). Inner edges lie halfway
/// between the centres; the outermost cells are symmetric around their centres.
///
/// # Errors
/// Returns an error if there are fewer than two centres or they do not ascend.
pub fn edges(centres: &[f64]) -> Result<Vec<f64>> {
    if centres.len() < 2 || !centres.is_sorted_by(|a, b| a < b) {
        return Err(Error::out_of_range(
            "cell centres",
            format!("{} values", centres.len()),
            "two or more, ascending",
        ));
    }
    let last = centres.len() - 1;
    let mut edges = vec![1.5 * centres[0] - 0.5 * centres[1]];
    edges.extend(centres.windows(2).map(|pair| 0.5 * (pair[0] + pair[1])));
    edges.push(1.5 * centres[last] - 0.5 * centres[last - 1]);
    Ok(edges)
}

/// Resamples `values` `[z, y, x]` from cells with the given `edges` along z, y and x (km, one
/// edge more than cells) onto `grid`.
///
/// # Errors
/// Returns an error if the number of edges along an axis is not one more than that of the cells.
pub fn resample(values: &Array3<f32>, edges: [&[f64]; 3], grid: &Grid) -> Result<Array3<f32>> {
    let mut values = values.clone();
    for (axis, edges) in edges.into_iter().enumerate() {
        if edges.len() != values.shape()[axis] + 1 {
            return Err(Error::mismatch(
                "cell edges",
                values.shape()[axis] + 1,
                edges.len(),
                "give one edge more than cells",
            ));
        }
        // The components of grid vectors are x, y, z; the array axes are z, y, x.
        let (origin, step) = (grid.origin[2 - axis], grid.spacing[2 - axis]);
        let count = grid.shape[axis];
        if !same_cells(edges, origin, step, count) {
            values = along(&values, Axis(axis), &rows(edges, origin, step, count));
        }
    }
    Ok(values)
}

impl Volume {
    /// The volume on another grid; it is zero outside its own.
    pub fn resampled(&self, grid: &Grid) -> Volume {
        let [z, y, x] = grid_edges(&self.grid);
        let values = resample(&self.values, [&z, &y, &x], grid).expect("the edges of its cells");
        Volume { grid: *grid, values }
    }
}

impl Mask {
    /// The mask on another grid: the voxels of which a part is inside.
    pub fn resampled(&self, grid: &Grid) -> Mask {
        let inside = self.values.mapv(|inside| if inside { 1.0 } else { 0.0 });
        let inside = Volume { grid: self.grid, values: inside }.resampled(grid);
        Mask { grid: *grid, values: inside.values.mapv(|share| share > 0.0) }
    }
}

/// Share of a new cell below which an old one overlaps it by rounding errors of the edges only, in single precision too. It would
/// leave a trace of cloud in clear cells.
const ROUNDING: f32 = 1e-5;

fn same_cells(edges: &[f64], origin: f64, step: f64, count: usize) -> bool {
    let expected = |index: usize| origin + step * index as f64;
    edges.len() == count + 1
        && edges.iter().enumerate().all(|(i, edge)| (edge - expected(i)).abs() <= 1e-3 * step)
}

fn rows(edges: &[f64], origin: f64, step: f64, count: usize) -> Vec<Row> {
    let cells = edges.len() - 1;
    let stretched = !same_cells(edges, edges[0], (edges[cells] - edges[0]) / cells as f64, cells);
    (0..count)
        .map(|index| {
            let lower = origin + step * index as f64;
            let first = edges.partition_point(|edge| *edge <= lower).saturating_sub(1);
            let last = edges.partition_point(|edge| *edge < lower + step);
            let cells = edges[first..(last + 1).min(edges.len())].windows(2);
            let widest = cells.map(|cell| cell[1] - cell[0]).fold(0.0, f64::max);
            if stretched || step >= 0.999 * widest {
                overlap(edges, lower, lower + step)
            } else {
                between(edges, lower + 0.5 * step)
            }
        })
        .collect()
}

/// The mean over the cells between `lower` and `upper`, weighted by the overlap.
fn overlap(edges: &[f64], lower: f64, upper: f64) -> Row {
    let first = edges.partition_point(|edge| *edge <= lower).saturating_sub(1);
    edges[first..]
        .windows(2)
        .enumerate()
        .take_while(|(_, cell)| cell[0] < upper)
        .map(|(offset, cell)| {
            let share = (cell[1].min(upper) - cell[0].max(lower)) / (upper - lower);
            (first + offset, share as f32)
        })
        .filter(|(_, share)| *share > ROUNDING)
        .collect()
}

/// Linear interpolation between cell centres. Values are constant in the outermost half cells.
fn between(edges: &[f64], at: f64) -> Row {
    let cells = edges.len() - 1;
    if at < edges[0] || at > edges[cells] {
        return Vec::new();
    }
    let centre = |cell: usize| 0.5 * (edges[cell] + edges[cell + 1]);
    let above = (0..cells).position(|cell| centre(cell) > at).unwrap_or(cells);
    if above == 0 || above == cells {
        return vec![(above.min(cells - 1), 1.0)];
    }
    let share = (at - centre(above - 1)) / (centre(above) - centre(above - 1));
    vec![(above - 1, (1.0 - share) as f32), (above, share as f32)]
}

fn along(values: &Array3<f32>, axis: Axis, rows: &[Row]) -> Array3<f32> {
    let mut shape = values.raw_dim();
    shape[axis.index()] = rows.len();
    let mut result = Array3::zeros(shape);
    for (row, mut lane) in rows.iter().zip(result.axis_iter_mut(axis)) {
        for &(cell, weight) in row {
            lane.scaled_add(weight, &values.index_axis(axis, cell));
        }
    }
    result
}

/// The `count + 1` cell edges of an axis with uniform spacing.
pub fn uniform_edges(lower: f64, spacing: f64, count: usize) -> Vec<f64> {
    Array1::from_iter((0..=count).map(|index| lower + spacing * index as f64)).to_vec()
}

/// The faces of the voxels of a grid along z, y and x (km), as [`resample`] takes them.
pub fn grid_edges(grid: &Grid) -> [Vec<f64>; 3] {
    // The components of grid vectors are x, y, z.
    [0, 1, 2]
        .map(|axis| uniform_edges(grid.origin[2 - axis], grid.spacing[2 - axis], grid.shape[axis]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::DVec3;

    fn wavy(shape: [usize; 3]) -> Array3<f32> {
        Array3::from_shape_fn(shape, |(k, j, i)| ((k * 7 + j * 5 + i * 3) % 11) as f32)
    }

    #[test]
    fn coarser_and_shifted_cells_keep_all_the_water() {
        let z = edges(&[0.1, 0.2, 0.4, 0.7, 1.0]).unwrap();
        let (y, x) = (uniform_edges(0.0, 0.02, 9), uniform_edges(0.0, 0.03, 8));
        let values = wavy([5, 9, 8]);
        let grid = Grid::new(DVec3::new(-0.01, 0.0, 0.0), DVec3::new(0.05, 0.07, 0.35), [4, 3, 6])
            .unwrap();
        let coarse = resample(&values, [&z, &y, &x], &grid).unwrap();
        let before: f64 = values
            .indexed_iter()
            .map(|((k, ..), value)| f64::from(*value) * (z[k + 1] - z[k]) * 0.02 * 0.03)
            .sum();
        let after = coarse.iter().map(|value| f64::from(*value)).sum::<f64>() * 0.05 * 0.07 * 0.35;
        assert!((after / before - 1.0).abs() < 1e-6, "{before} g became {after} g");
    }

    /// Cells of 10, 20, 40 and 80 m with 0, 0, 0.1 and 0.5 g/m3 contain 44 g/m2.
    #[test]
    fn finer_cells_between_stretched_ones_keep_all_the_water() {
        let z = [0.0, 0.01, 0.03, 0.07, 0.15];
        let values = Array3::from_shape_vec((4, 1, 1), vec![0.0, 0.0, 0.1, 0.5]).unwrap();
        for step in [0.01, 0.03, 0.04, 0.05, 0.15] {
            let count = (0.15_f64 / step).ceil() as usize;
            let grid = Grid::new(DVec3::ZERO, DVec3::new(1.0, 1.0, step), [count, 1, 1]).unwrap();
            let fine = resample(&values, [&z, &[0.0, 1.0], &[0.0, 1.0]], &grid).unwrap();
            let path = 1e3 * step * f64::from(fine.sum());
            assert!((path - 44.0).abs() < 1e-4, "{path} g/m2 in cells of {step} km");
        }
    }

    /// Edges that differ by rounding errors leave no trace in the next cell.
    #[test]
    fn rounding_errors_of_edges_leave_no_trace() {
        let x: Vec<f64> = (0..=8).map(|i| 0.38 + 0.04 * f64::from(i) + 1e-14).collect();
        let mut values = Array3::zeros((1, 1, 8));
        values[[0, 0, 3]] = 1.0_f32;
        let grid = Grid::new(DVec3::new(0.38, 0.0, 0.0), DVec3::new(0.04, 1.0, 1.0), [1, 1, 4]);
        let same = resample(&values, [&[0.0, 1.0], &[0.0, 1.0], &x], &grid.unwrap()).unwrap();
        assert_eq!(same.iter().filter(|value| **value > 0.0).count(), 1);
    }

    #[test]
    fn finer_cells_follow_a_straight_line() {
        let x = uniform_edges(0.0, 0.1, 6);
        let values = Array3::from_shape_fn((1, 1, 6), |(_, _, i)| 2.0 * (i as f32 + 0.5) * 0.1);
        let one = [0.0, 1.0];
        let grid = Grid::new(DVec3::ZERO, DVec3::new(0.025, 1.0, 1.0), [1, 1, 24]).unwrap();
        let fine = resample(&values, [&one, &one, &x], &grid).unwrap();
        for i in 2..22 {
            let expected = 2.0 * grid.voxel_center([0, 0, i]).x as f32;
            assert!((fine[[0, 0, i]] - expected).abs() < 1e-6);
        }
    }

    #[test]
    fn the_same_cells_are_left_as_they_are() {
        let values = wavy([3, 4, 5]);
        let grid = Grid::new(DVec3::new(0.1, 0.2, 0.3), DVec3::splat(0.05), [3, 4, 5]).unwrap();
        let edges: Vec<_> =
            (0..3).map(|a| uniform_edges(grid.origin[2 - a], 0.05, grid.shape[a])).collect();
        let same = resample(&values, [&edges[0], &edges[1], &edges[2]], &grid).unwrap();
        assert_eq!(same, values);
    }
}
