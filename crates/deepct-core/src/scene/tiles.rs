//! Division of a field into tiles that are computed by themselves.

use super::View;
use super::view::pixels_that_show;
use crate::error::Result;
use crate::grid::Grid;
use crate::math::DVec3;
use std::ops::Range;

/// Columns beyond the grid of a tile whose pixels belong to it: those that a network reads beyond the
/// grid, and those of the interpolation.
const BEYOND: f64 = 10.0;

/// A tile of a field, and what its computation needs.
#[derive(Debug, Clone, PartialEq)]
pub struct Tile {
    /// The rows of the field.
    pub rows: Range<usize>,
    /// The columns of the field.
    pub cols: Range<usize>,
    /// The grid of the tile and of the columns around it.
    pub around: Grid,
    /// The rows and columns of the images that show this grid; `None` if no image shows it.
    pub pixels: Option<[Range<usize>; 2]>,
}

impl Tile {
    /// Divides a grid into tiles of at most `side` rows and columns, each with `halo` columns around it
    /// where the grid has them, which the views show in images of one size.
    ///
    /// # Errors
    /// None for valid grids.
    pub fn all(views: &[View], grid: &Grid, side: usize, halo: usize) -> Result<Vec<Self>> {
        let [_, all_rows, all_cols] = grid.shape;
        let widened = |range: &Range<usize>, all: usize| {
            range.start.saturating_sub(halo)..(range.end + halo).min(all)
        };
        let beyond = BEYOND * DVec3::new(grid.spacing.x, grid.spacing.y, 0.0);
        grid.tiles(side)
            .into_iter()
            .map(|[rows, cols]| {
                let around = grid.part(widened(&rows, all_rows), widened(&cols, all_cols))?;
                let corners = [around.lower() - beyond, around.upper() + beyond];
                let pixels = pixels_that_show(views, corners);
                Ok(Self { rows, cols, around, pixels })
            })
            .collect()
    }

    /// The rows and columns of the tile in the grid around it.
    pub fn inner(&self, grid: &Grid) -> [Range<usize>; 2] {
        let first = ((self.around.origin - grid.origin) / grid.spacing).round();
        let of = |range: &Range<usize>, first: f64| {
            range.start - first as usize..range.end - first as usize
        };
        [of(&self.rows, first.y), of(&self.cols, first.x)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::towards;

    /// The tiles cover the grid once, and the pixels of each show all of its voxels.
    #[test]
    fn tiles_cover_the_grid_and_are_shown() {
        let origin = DVec3::new(-1.0, 0.5, 0.6);
        let grid = Grid::new(origin, DVec3::new(0.05, 0.06, 0.04), [8, 50, 90]).unwrap();
        let target = grid.center();
        let views: Vec<View> = [(0.3, 1.0), (0.9, 4.0), (0.0, 0.0)]
            .map(|(zenith, azimuth)| {
                let position = target + 600.0 * towards(zenith, azimuth);
                View::perspective(position, target, 0.05 / 600.0, [70, 100]).unwrap()
            })
            .to_vec();
        let tiles = Tile::all(&views, &grid, 32, 5).unwrap();
        assert_eq!(tiles.len(), 6);
        let mut covered = vec![0; 50 * 90];
        for tile in &tiles {
            for row in tile.rows.clone() {
                tile.cols.clone().for_each(|col| covered[row * 90 + col] += 1);
            }
            let [rows, cols] = tile.inner(&grid);
            let around = tile.around.part(rows, cols).unwrap();
            assert!(around.matches(&grid.part(tile.rows.clone(), tile.cols.clone()).unwrap()));
            let [rows, cols] = tile.pixels.clone().unwrap();
            for view in &views {
                let [_, last_row, last_col] = tile.around.shape.map(|n| n - 1);
                for voxel in
                    [[0, 0, 0], [7, last_row, 0], [0, last_row, last_col], [7, 0, last_col]]
                {
                    let point = tile.around.voxel_center(voxel);
                    let (row, col) = view.project(point).unwrap();
                    let is_shown = view.shows(point);
                    let inside = rows.contains(&(row as usize)) && cols.contains(&(col as usize));
                    assert!(inside || !is_shown, "{row} {col}");
                }
            }
        }
        assert!(covered.iter().all(|count| *count == 1));
        let far = Grid { origin: DVec3::new(100.0, 0.0, 0.6), ..grid };
        assert!(Tile::all(&views, &far, 32, 5).unwrap()[0].pixels.is_none());
    }
}
