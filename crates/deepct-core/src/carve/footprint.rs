//! The pixels onto which a voxel projects.

use crate::grid::Grid;
use crate::math::DVec3;
use crate::scene::Projector;
use glam::DVec2;
use ndarray::Array2;
use std::ops::Range;

/// Overlaps thinner than this (pixels) are rounding errors.
const TOUCH: f64 = 1e-6;

/// The two corners that each edge of a voxel connects. Corner `4 k + 2 j + i` is the upper one
/// along z if `k`, along y if `j`, and along x if `i` is 1.
const EDGES: [(usize, usize); 12] = [
    (0, 1),
    (2, 3),
    (4, 5),
    (6, 7),
    (0, 2),
    (1, 3),
    (4, 6),
    (5, 7),
    (0, 4),
    (1, 5),
    (2, 6),
    (3, 7),
];

/// Projections of the corners of a block of voxels onto an image: `(row, col)`, NaN for a corner
/// behind the camera.
#[derive(Default)]
pub(super) struct CornerPixels {
    corners: Vec<DVec2>,
    /// Number of corners along z, y, x.
    count: [usize; 3],
}

impl CornerPixels {
    /// Projects `count` corners along z, y, x, starting at the lower corner of voxel `first`.
    pub(super) fn find(
        &mut self,
        grid: &Grid,
        first: [usize; 3],
        count: [usize; 3],
        projector: &Projector,
    ) {
        self.count = count;
        self.corners.resize(count.iter().product(), DVec2::ZERO);
        let step = DVec3::new(grid.spacing.x, 0.0, 0.0);
        for (number, row) in self.corners.chunks_exact_mut(count[2]).enumerate() {
            let (k, j) = (first[0] + number / count[1], first[1] + number % count[1]);
            projector.project_row(corner(grid, [k, j, first[2]]), step, row);
        }
    }

    /// The footprint of voxel `[k, j, i]` of the block; `None` if a part of it is behind the
    /// camera.
    pub(super) fn footprint(&self, [k, j, i]: [usize; 3]) -> Option<Footprint> {
        let [_, rows, cols] = self.count;
        let first = (k * rows + j) * cols + i;
        let footprint = std::array::from_fn(|number| {
            let [k, j, i] = [number >> 2, number >> 1 & 1, number & 1];
            self.corners[first + (k * rows + j) * cols + i]
        });
        Footprint::new(footprint)
    }
}

/// The lower corner of a voxel.
fn corner(grid: &Grid, [k, j, i]: [usize; 3]) -> DVec3 {
    grid.origin + grid.spacing * DVec3::new(i as f64, j as f64, k as f64)
}

/// The cloudy pixels of an image, and those that may or may not be.
pub(super) struct CloudyPixels {
    cloudy: MarkedPixels,
    unknown: Option<MarkedPixels>,
}

impl CloudyPixels {
    pub(super) fn new(cloudy: Array2<bool>, unknown: Array2<bool>) -> Self {
        let any = unknown.iter().any(|unknown| *unknown);
        let unknown = any.then(|| MarkedPixels::new(unknown));
        Self { cloudy: MarkedPixels::new(cloudy), unknown }
    }
}

/// Pixels of an image that are marked.
struct MarkedPixels {
    marks: Array2<bool>,
    /// Summed-area table: the number of marked pixels in all rows and columns before an index.
    sums: Array2<u32>,
}

impl MarkedPixels {
    fn new(marks: Array2<bool>) -> Self {
        let (rows, cols) = marks.dim();
        let mut sums = Array2::zeros((rows + 1, cols + 1));
        for ((row, col), &marked) in marks.indexed_iter() {
            sums[[row + 1, col + 1]] =
                u32::from(marked) + sums[[row, col + 1]] + sums[[row + 1, col]] - sums[[row, col]];
        }
        Self { marks, sums }
    }

    /// Whether a point is in the interior of a marked pixel.
    fn is_marked_at(&self, point: DVec2) -> bool {
        let pixel = point.floor();
        let within = point - pixel;
        let inside = within.cmpgt(DVec2::splat(TOUCH)).all()
            && within.cmplt(DVec2::splat(1.0 - TOUCH)).all()
            && pixel.cmpge(DVec2::ZERO).all();
        // Casts from floats saturate, so points beyond the frame do not index a pixel.
        inside && self.marks.get([pixel.x as usize, pixel.y as usize]).is_some_and(|marked| *marked)
    }

    /// Number of marked pixels in a rectangle.
    fn count(&self, rows: &Range<usize>, cols: &Range<usize>) -> u32 {
        if rows.is_empty() || cols.is_empty() {
            return 0;
        }
        let sum = |row, col| self.sums[[row, col]];
        sum(rows.end, cols.end) + sum(rows.start, cols.start)
            - sum(rows.start, cols.end)
            - sum(rows.end, cols.start)
    }
}

/// The projection of a voxel onto an image: the convex hull of its projected corners, `(row, col)`.
pub(super) struct Footprint([DVec2; 8]);

/// A direction in the image and the extent of the footprint along it.
struct Side {
    normal: DVec2,
    low: f64,
    high: f64,
}

impl Footprint {
    /// The footprint of a block of voxels, of which `first` is the lowest; `None` if a part of it
    /// is behind the camera.
    pub(super) fn of_block(
        grid: &Grid,
        first: [usize; 3],
        shape: [usize; 3],
        projector: &Projector,
    ) -> Option<Self> {
        let mut footprint = [DVec2::ZERO; 8];
        for (number, pixel) in footprint.iter_mut().enumerate() {
            let at = |axis: usize| first[axis] + (number >> (2 - axis) & 1) * shape[axis];
            *pixel = projector.project(corner(grid, [at(0), at(1), at(2)])).map(DVec2::from)?;
        }
        Self::new(footprint)
    }

    /// `None` if a corner is behind the camera and its projection is therefore NaN.
    fn new(corners: [DVec2; 8]) -> Option<Self> {
        let sum: DVec2 = corners.iter().sum();
        (!sum.is_nan()).then_some(Self(corners))
    }

    /// The common vote of all voxels of a block with this footprint, if there is one: the footprint
    /// must be completely inside the frame, and all of the pixels in its rows and columns must be cloudy,
    /// or none of them cloudy or unknown.
    pub(super) fn vote_of_all(&self, image: &CloudyPixels) -> Option<bool> {
        let (inside, [rows, cols]) = self.frame(image);
        let count = image.cloudy.count(&rows, &cols) as usize;
        let unknown = || image.unknown.as_ref().map_or(0, |unknown| unknown.count(&rows, &cols));
        let is_decided = count == rows.len() * cols.len() || (count == 0 && unknown() == 0);
        (inside && is_decided).then_some(count > 0)
    }

    /// Its ranges of rows and columns in an image of this shape.
    pub(super) fn pixels(&self, shape: (usize, usize)) -> [Range<usize>; 2] {
        self.frame_of(shape).1
    }

    fn frame(&self, image: &CloudyPixels) -> (bool, [Range<usize>; 2]) {
        self.frame_of(image.cloudy.marks.dim())
    }

    /// Whether the footprint is completely inside the frame of an image of this shape, and its ranges of
    /// rows and columns.
    fn frame_of(&self, (row_count, col_count): (usize, usize)) -> (bool, [Range<usize>; 2]) {
        let frame = DVec2::new(row_count as f64, col_count as f64);
        let low = self.0.iter().copied().fold(DVec2::INFINITY, DVec2::min);
        let high = self.0.iter().copied().fold(DVec2::NEG_INFINITY, DVec2::max);
        let inside = low.cmpge(DVec2::splat(-TOUCH)).all() && high.cmple(frame + TOUCH).all();
        (inside, [pixels(low.x, high.x, row_count), pixels(low.y, high.y, col_count)])
    }

    /// Whether a cloudy pixel overlaps the footprint; `None` if no cloudy pixel does, but an unknown one,
    /// or if the footprint is not completely inside the frame.
    pub(super) fn vote(&self, image: &CloudyPixels) -> Option<bool> {
        let (inside, pixels) = self.frame(image);
        if self.overlaps_any(&image.cloudy, inside, &pixels) {
            return Some(true);
        }
        let is_known = |unknown| !self.overlaps_any(unknown, inside, &pixels);
        (inside && image.unknown.as_ref().is_none_or(is_known)).then_some(false)
    }

    /// Whether a marked pixel, among those in its rows and columns, overlaps the footprint.
    fn overlaps_any(
        &self,
        image: &MarkedPixels,
        inside: bool,
        [rows, cols]: &[Range<usize>; 2],
    ) -> bool {
        let count = image.count(rows, cols);
        if count == 0 {
            return false;
        }
        // Inside the frame, at least one pixel within these rows and columns overlaps the
        // footprint, so no overlap test is needed if all of them are marked.
        if inside && count as usize == rows.len() * cols.len() {
            return true;
        }
        // The centre or a corner of most footprints is in the interior of a marked pixel.
        let middle = self.0.iter().sum::<DVec2>() / self.0.len() as f64;
        if image.is_marked_at(middle) || self.0.iter().any(|corner| image.is_marked_at(*corner)) {
            return true;
        }
        let sides = self.sides();
        rows.clone()
            .flat_map(|row| cols.clone().map(move |col| (row, col)))
            .any(|(row, col)| image.marks[[row, col]] && overlaps(&sides, row, col))
    }

    /// The normals of the projected edges of the voxel, which include all sides of the footprint.
    fn sides(&self) -> [Side; EDGES.len()] {
        EDGES.map(|(from, to)| {
            let normal = (self.0[to] - self.0[from]).perp();
            let length = normal.length();
            // An edge along the line of sight projects to a point and has no normal.
            if length <= TOUCH {
                return Side { normal, low: f64::NEG_INFINITY, high: f64::INFINITY };
            }
            let normal = normal / length;
            let along = self.0.map(|corner| corner.dot(normal));
            let low = along.iter().copied().fold(f64::INFINITY, f64::min);
            let high = along.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            Side { normal, low, high }
        })
    }
}

/// Whether a pixel overlaps the footprint with these sides. Two convex figures overlap unless a
/// line parallel to a side of one of them separates them. The sides of the pixel need no test,
/// because only pixels within the rows and columns of the footprint are tested.
fn overlaps(sides: &[Side], row: usize, col: usize) -> bool {
    let middle = DVec2::new(row as f64 + 0.5, col as f64 + 0.5);
    sides.iter().all(|side| {
        let at = middle.dot(side.normal);
        let reach = 0.5 * (side.normal.x.abs() + side.normal.y.abs());
        at + reach > side.low + TOUCH && at - reach < side.high - TOUCH
    })
}

/// The pixels that a range overlaps along one axis of an image.
fn pixels(low: f64, high: f64, count: usize) -> Range<usize> {
    // Casts from floats saturate, so a range outside the frame gives an empty range of pixels.
    let first = (low + TOUCH).floor() as usize;
    let last = (high - TOUCH).ceil() as usize;
    first..last.min(count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Formation;

    /// Twice the signed area spanned by three points.
    fn turn(a: DVec2, b: DVec2, c: DVec2) -> f64 {
        (b - a).perp_dot(c - a)
    }

    /// The convex hull of points (Andrew 1979), counter-clockwise.
    fn hull(mut points: Vec<DVec2>) -> Vec<DVec2> {
        points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
        let half = |points: &mut dyn Iterator<Item = DVec2>| {
            let mut chain: Vec<DVec2> = Vec::new();
            for point in points {
                while let [.., a, b] = chain[..]
                    && turn(a, b, point) <= 0.0
                {
                    chain.pop();
                }
                chain.push(point);
            }
            chain.pop();
            chain
        };
        let mut chain = half(&mut points.iter().copied());
        chain.extend(half(&mut points.iter().rev().copied()));
        chain
    }

    /// The area that a convex polygon shares with a pixel, found by clipping the polygon at each
    /// side of the pixel (Sutherland and Hodgman 1974).
    fn shared_area(mut polygon: Vec<DVec2>, pixel: DVec2) -> f64 {
        let corners = [DVec2::ZERO, DVec2::X, DVec2::ONE, DVec2::Y].map(|corner| pixel + corner);
        for side in 0..4 {
            let (from, to) = (corners[side], corners[(side + 1) % 4]);
            let mut cut = Vec::new();
            for (index, &point) in polygon.iter().enumerate() {
                let before = polygon[(index + polygon.len() - 1) % polygon.len()];
                let (a, b) = (turn(from, to, before), turn(from, to, point));
                if (a < 0.0) != (b < 0.0) {
                    cut.push(before.lerp(point, a / (a - b)));
                }
                if b >= 0.0 {
                    cut.push(point);
                }
            }
            polygon = cut;
        }
        let next = polygon.iter().cycle().skip(1);
        polygon.iter().zip(next).map(|(&a, &b)| turn(pixel, a, b)).sum::<f64>() / 2.0
    }

    #[test]
    fn the_pixels_of_a_voxel_are_those_that_share_area_with_it() {
        let grid = Grid::new(DVec3::new(0.0, 0.0, 0.5), DVec3::new(0.05, 0.06, 0.04), [14, 13, 16])
            .unwrap();
        for view in Formation::pearls_32().views(grid.center(), [26, 26]).unwrap() {
            let mut corners = CornerPixels::default();
            corners.find(&grid, [0; 3], [15, 14, 17], &view.projector());
            for k in [0, 9] {
                for (j, i) in [(0, 0), (4, 11), (8, 3), (12, 15)] {
                    let footprint = corners.footprint([k, j, i]).unwrap();
                    let polygon = hull(footprint.0.to_vec());
                    for (row, col) in (0..26).flat_map(|row| (0..26).map(move |col| (row, col))) {
                        let clear = Array2::from_elem((26, 26), false);
                        let mut cloudy = clear.clone();
                        cloudy[[row, col]] = true;
                        let shared =
                            shared_area(polygon.clone(), DVec2::new(row as f64, col as f64));
                        let vote =
                            footprint.vote(&CloudyPixels::new(cloudy, clear.clone())) == Some(true);
                        assert_eq!(
                            vote,
                            shared > 1e-12,
                            "{view:?} {k} {j} {i} {row} {col} {shared}"
                        );
                    }
                }
            }
        }
    }
}
