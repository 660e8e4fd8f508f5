//! Partition of a periodic cloud field into squares.

use super::Cloud;
use super::isolate::{Overview, Piece, cut};
use crate::error::{Error, Result};

/// A column is cloudy if the liquid water content of any of its voxels exceeds this (g/m3).
const CLOUDY: f32 = 0.01;

/// Partitions a periodic field into as many squares of `side` columns as fit, starting at the row
/// and column `origin` and ordered from south to north and west to east. All water within a square
/// is included, so clouds that cross its edges are cut.
///
/// # Errors
/// Returns an error if the field has no droplets, or if the side is 0 or exceeds the field.
pub fn tile(field: &Cloud, side: usize, origin: [usize; 2]) -> Result<Vec<Piece>> {
    let overview = Overview::of(field)?;
    let [_, rows, cols] = field.grid.shape;
    if !(1..=rows.min(cols)).contains(&side) {
        let range = format!("at least 1 and within {rows} x {cols}");
        return Err(Error::out_of_range("side of a square", side, range));
    }
    let corners = ndarray::indices((rows / side, cols / side)).into_iter();
    let piece = |(row, col): (usize, usize)| {
        let corner = [origin[0] + row * side, origin[1] + col * side].map(|at| at as i64);
        let square: Vec<_> = ndarray::indices((side, side))
            .into_iter()
            .map(|(row, col)| [corner[0] + row as i64, corner[1] + col as i64])
            .collect();
        let seen = square.iter().map(|at| overview.wrap(*at));
        Ok(Piece {
            cloud: cut(field, &overview, &square, corner, side)?,
            corner,
            columns: seen.clone().filter(|at| overview.highest[*at] > CLOUDY).count(),
            water_path: seen.map(|at| overview.path[at]).fold(0.0, f32::max),
        })
    };
    corners.map(piece).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::Microphysics;
    use crate::grid::Grid;
    use crate::math::DVec3;
    use ndarray::Array3;

    /// A field in which each column has a different liquid water content, in some below the
    /// threshold of a cloudy column.
    fn field(rows: usize, cols: usize) -> Cloud {
        let grid = Grid::new(DVec3::ZERO, DVec3::new(0.05, 0.05, 0.04), [2, rows, cols]).unwrap();
        let water =
            Array3::from_shape_fn(grid.shape, |(k, j, i)| (k * (j * cols + i)) as f32 * 1e-3);
        let droplets = Microphysics::from_droplet_number(water, 100.0).unwrap();
        Cloud::from_microphysics(grid, droplets).unwrap()
    }

    fn water(cloud: &Cloud) -> &Array3<f32> {
        &cloud.microphysics.as_ref().unwrap().liquid_water_content
    }

    #[test]
    fn squares_across_the_sides_hold_every_column_once() {
        let field = field(6, 9);
        let squares = tile(&field, 3, [4, 7]).unwrap();
        assert_eq!(squares.len(), 6);
        assert_eq!(squares[0].corner, [4, 7]);
        assert_eq!(squares[5].corner, [7, 13]);
        let mut all: Vec<f32> = Vec::new();
        for Piece { cloud, corner, columns, water_path } in &squares {
            assert_eq!(water(cloud).dim(), (2, 3, 3));
            let (j, i) = (corner[0] as usize + 1, corner[1] as usize + 2);
            assert_eq!(water(cloud)[[1, 1, 2]], water(&field)[[1, j % 6, i % 9]]);
            let origin = 0.05 * DVec3::new(corner[1] as f64, corner[0] as f64, 0.0);
            assert!(cloud.grid.origin.distance(origin) < 1e-12);
            assert_eq!(*columns, water(cloud).iter().filter(|water| **water > 0.01).count());
            let most = water(cloud).iter().copied().fold(0.0, f32::max);
            assert!((water_path / (40.0 * most) - 1.0).abs() < 1e-6);
            all.extend(water(cloud));
        }
        let mut expected: Vec<f32> = water(&field).iter().copied().collect();
        all.sort_by(f32::total_cmp);
        expected.sort_by(f32::total_cmp);
        assert_eq!(all, expected);
    }

    #[test]
    fn squares_leave_out_what_is_left_over() {
        assert_eq!(tile(&field(10, 7), 4, [0, 0]).unwrap().len(), 2);
        assert!(tile(&field(10, 7), 8, [0, 0]).is_err());
        assert!(tile(&field(10, 7), 0, [0, 0]).is_err());
    }
}
