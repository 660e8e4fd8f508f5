//! Lines of sight of all pixels, for instruments that are no pinhole cameras: scanners, whose position
//! changes along the image, and cameras with distortion.

use crate::error::{Error, Result};
use crate::math::{DVec3, Ray};
use glam::{DMat2, DVec2};
use ndarray::{Array2, Zip};

/// Distance (km) at which rays begin.
const START_KM: f64 = 1000.0;

/// Distance (pixels) of successive positions at which the search of a projection ends, and maximum number
/// of its steps.
const CLOSE: f64 = 1e-9;
const MOST_STEPS: usize = 40;

/// Smallest cosine of the zenith angle of a line of sight.
const STEEPEST: f64 = 1e-3;

/// The line of sight of the centre of each pixel: at every altitude, the pixels are points of a plane,
/// between which positions are interpolated bilinearly, and beyond which they are extrapolated.
#[derive(Debug, Clone, PartialEq)]
pub struct LinesOfSight {
    /// The altitude of the points (km).
    altitude: f64,
    /// Where each line of sight is at this altitude, x and y (km), `[row, col]`.
    points: Array2<DVec2>,
    /// How far each line of sight moves, x and y, per height towards the instrument.
    slopes: Array2<DVec2>,
    /// The affine map from x, y at the altitude to row and column, in which the search begins.
    matrix: DMat2,
    middle: [DVec2; 2],
}

impl LinesOfSight {
    /// Lines of sight through `points` (km) in the `directions` from the scene towards the instrument, both
    /// of the pixel centres, `[row, col]`. The instrument is above the scene.
    ///
    /// # Errors
    /// Returns an error if there are fewer than two rows or columns, if the shapes differ, if a number is
    /// not finite or a direction not upwards, or if pixels that follow one another do not lie side by side
    /// with rows to the north and columns to the east.
    pub fn new(points: &Array2<DVec3>, directions: &Array2<DVec3>) -> Result<Self> {
        let (rows, cols) = points.dim();
        if rows < 2 || cols < 2 {
            let range = "at least 2 along each axis, between which lines of sight are interpolated";
            return Err(Error::out_of_range(
                "image size [row, col]",
                format!("[{rows}, {cols}]"),
                range,
            ));
        }
        if directions.dim() != points.dim() {
            let (found, expected) =
                (format!("{:?}", directions.shape()), format!("{:?}", points.shape()));
            let remedy = "give a point and a direction for each pixel";
            return Err(Error::mismatch("shape of the directions", expected, found, remedy));
        }
        for ((row, col), point) in points.indexed_iter() {
            let direction = directions[[row, col]];
            let cosine = direction.normalize_or_zero().z;
            if !point.is_finite() || !direction.is_finite() || cosine < STEEPEST {
                return Err(Error::out_of_range(
                    "line of sight",
                    format!("{point} towards {direction} at [row {row}, col {col}]"),
                    "finite, and upwards from the scene to the instrument",
                ));
            }
        }
        let altitude = points[[rows / 2, cols / 2]].z;
        let slopes = directions.mapv(|direction| direction.truncate() / direction.z);
        let points = Zip::from(points)
            .and(&slopes)
            .map_collect(|point, slope| point.truncate() + (altitude - point.z) * slope);
        let mut lines =
            Self { altitude, points, slopes, matrix: DMat2::IDENTITY, middle: [DVec2::ZERO; 2] };
        for (row, col) in (0..rows - 1).flat_map(|row| (0..cols - 1).map(move |col| (row, col))) {
            let (_, [north, east]) =
                lines.at(DVec2::new(row as f64 + 1.0, col as f64 + 1.0), altitude);
            if east.perp_dot(north) <= 0.0 {
                let found =
                    format!("at [row {row}, col {col}] to the north {north} and east {east}");
                let range =
                    "rows to the north and columns to the east: turn or transpose the images";
                return Err(Error::out_of_range("order of the lines of sight", found, range));
            }
        }
        let place = 0.5 * DVec2::new(rows as f64, cols as f64);
        let corner = |row: usize, col: usize| lines.points[[row, col]];
        let (last_row, last_col) = (rows - 1, cols - 1);
        let north =
            (corner(last_row, 0) + corner(last_row, last_col) - corner(0, 0) - corner(0, last_col))
                / (2.0 * last_row as f64);
        let east =
            (corner(0, last_col) + corner(last_row, last_col) - corner(0, 0) - corner(last_row, 0))
                / (2.0 * last_col as f64);
        (lines.matrix, lines.middle) =
            (DMat2::from_cols(north, east).inverse(), [lines.at(place, altitude).0, place]);
        Ok(lines)
    }

    /// The altitude of the points (km).
    pub fn altitude(&self) -> f64 {
        self.altitude
    }

    /// Number of rows and columns.
    pub fn size(&self) -> [usize; 2] {
        [self.points.nrows(), self.points.ncols()]
    }

    /// The largest angle between the lines of sight of neighbouring pixels (radians).
    pub(super) fn pixel_angle(&self) -> f64 {
        let directions = self.slopes.mapv(|slope| slope.extend(1.0));
        let along = |axis: usize| {
            let lanes = directions.lanes(ndarray::Axis(axis)).into_iter();
            lanes.flat_map(|lane| {
                let lane = lane.to_vec();
                lane.windows(2).map(|pair| pair[0].angle_between(pair[1])).collect::<Vec<_>>()
            })
        };
        along(0).chain(along(1)).fold(0.0, f64::max)
    }

    /// The point (km) and a vector towards the instrument, whose vertical component is 1, of the line of
    /// sight at a position.
    pub(super) fn line(&self, place: DVec2) -> [DVec3; 2] {
        let (index, weights) = self.cell(place);
        let point = interpolated(&self.points, index, weights).0;
        let slope = interpolated(&self.slopes, index, weights).0;
        [point.extend(self.altitude), slope.extend(1.0)]
    }

    /// The line of sight at a position of the image, in which pixel `[r, c]` spans `r..r+1, c..c+1`.
    pub(super) fn ray(&self, row: f64, col: f64) -> Ray {
        let [point, towards] = self.line(DVec2::new(row, col));
        let towards = towards.normalize();
        Ray { origin: point + START_KM * towards, direction: -towards }
    }

    /// The position `(row, col)` at which the image shows a point; `None` if none is found.
    pub(super) fn project(&self, point: DVec3) -> Option<DVec2> {
        let at = point.truncate();
        let rise = (point.z - self.altitude) * self.line(self.middle[1])[1].truncate();
        let mut place = self.middle[1] + self.matrix * (at - rise - self.middle[0]);
        for _ in 0..MOST_STEPS {
            let (found, [north, east]) = self.at(place, point.z);
            let step = DMat2::from_cols(north, east).inverse() * (at - found);
            place += step;
            if !place.is_finite() {
                return None;
            }
            if step.abs().max_element() < CLOSE {
                return Some(place);
            }
        }
        None
    }

    /// Where the line of sight of a position of the image is at an altitude, and the derivatives with respect
    /// to row and column.
    pub(super) fn at(&self, place: DVec2, altitude: f64) -> (DVec2, [DVec2; 2]) {
        let (index, weights) = self.cell(place);
        let (point, across) = interpolated(&self.points, index, weights);
        let (slope, turns) = interpolated(&self.slopes, index, weights);
        let rise = altitude - self.altitude;
        (point + rise * slope, [0, 1].map(|axis| across[axis] + rise * turns[axis]))
    }

    /// The first of the four pixel centres around a position, and the place between them.
    fn cell(&self, place: DVec2) -> ([usize; 2], DVec2) {
        let [rows, cols] = self.size();
        let centres = place - 0.5;
        let first = |at: f64, count: usize| at.clamp(0.0, (count - 2) as f64) as usize;
        let index = [first(centres.x, rows), first(centres.y, cols)];
        (index, centres - DVec2::new(index[0] as f64, index[1] as f64))
    }
}

/// The bilinear interpolation between four neighbours, and its derivatives along rows and columns.
fn interpolated(values: &Array2<DVec2>, [row, col]: [usize; 2], at: DVec2) -> (DVec2, [DVec2; 2]) {
    let (a, b) = (values[[row, col]], values[[row, col + 1]]);
    let (c, d) = (values[[row + 1, col]], values[[row + 1, col + 1]]);
    // This form is exact at the pixel centres.
    let between = |from: DVec2, to: DVec2, part: f64| (1.0 - part) * from + part * to;
    let (south, north) = (between(a, b, at.y), between(c, d, at.y));
    let (west, east) = (between(a, c, at.x), between(b, d, at.x));
    (between(south, north, at.x), [north - south, east - west])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::towards;
    use crate::scene::View;
    use std::sync::Arc;

    /// The lines of sight of a camera, at altitudes that differ from pixel to pixel.
    fn lines(view: &View) -> LinesOfSight {
        let ray = |row: usize, col: usize| view.ray(row as f64 + 0.5, col as f64 + 0.5);
        let size = (view.rows, view.cols);
        let points = Array2::from_shape_fn(size, |(row, col)| {
            let ray = ray(row, col);
            ray.at((0.8 + 0.01 * (row * col) as f64 - ray.origin.z) / ray.direction.z)
        });
        let directions = Array2::from_shape_fn(size, |(row, col)| -3.0 * ray(row, col).direction);
        LinesOfSight::new(&points, &directions).unwrap()
    }

    #[test]
    fn a_camera_by_its_lines_of_sight_is_the_same() {
        let target = DVec3::new(0.8, 0.7, 1.1);
        let towards = towards(0.8, 2.1);
        for camera in [
            View::perspective(target + 600.0 * towards, target, 8e-5, [32, 40]).unwrap(),
            View::orthographic(towards, target, 0.05, [32, 40]).unwrap(),
        ] {
            let view = View::lines_of_sight(Arc::new(lines(&camera))).unwrap();
            let view = view.aimed_at(target).unwrap();
            assert!((view.zenith() - camera.zenith()).abs() < 1e-6);
            assert!(view.towards().distance(camera.towards()) < 1e-6);
            let part = [view.part([3, 5], [8, 9]).unwrap(), camera.part([3, 5], [8, 9]).unwrap()];
            let padded = [view.padded([50, 51]).unwrap(), camera.padded([50, 51]).unwrap()];
            // Beyond the image, in its padding, lines of sight are extrapolated.
            let cases = [([view, camera], 1e-5), (part, 1e-5), (padded, 1e-3)];
            for ([view, camera], tolerance) in cases {
                for (row, col) in [(0.5, 0.5), (3.3, 7.9), (7.9, 8.9)] {
                    let (ray, expected) = (view.ray(row, col), camera.ray(row, col));
                    for altitude in [0.0, 1.5] {
                        let at = |ray: &Ray| ray.at((altitude - ray.origin.z) / ray.direction.z);
                        let distance = at(&ray).distance(at(&expected));
                        assert!(distance < tolerance, "{row} {col} {distance}");
                        let (found_row, found_col) = view.project(at(&ray)).unwrap();
                        assert!((found_row - row).abs() < 1e-6 && (found_col - col).abs() < 1e-6);
                    }
                }
            }
        }
    }

    /// A scanner that looks down obliquely: perspective across its track, which bends.
    #[test]
    fn the_projection_of_a_scanner_is_the_inverse_of_its_rays() {
        let instrument = |row: usize| {
            DVec3::new(0.002 * (row * row) as f64 / 30.0, 0.05 * row as f64 - 10.0, 20.0)
        };
        let points = Array2::from_shape_fn((30, 40), |(row, col)| {
            DVec3::new(0.05 * col as f64, 0.05 * row as f64, 0.0)
        });
        let directions =
            Array2::from_shape_fn((30, 40), |(row, col)| instrument(row) - points[[row, col]]);
        let lines = Arc::new(LinesOfSight::new(&points, &directions).unwrap());
        let view = View::lines_of_sight(lines).unwrap();
        for (row, col) in [(0.5, 0.5), (14.2, 33.3), (29.9, 0.1), (7.0, 20.0)] {
            for altitude in [0.0, 0.7, 2.4] {
                let ray = view.ray(row, col);
                let point = ray.at((altitude - ray.origin.z) / ray.direction.z);
                let (found_row, found_col) = view.project(point).unwrap();
                assert!((found_row - row).abs() < 1e-6 && (found_col - col).abs() < 1e-6);
            }
        }
        // The line of sight of a pixel passes through the instrument.
        let ray = view.ray(10.5, 5.5);
        let along = (instrument(10) - ray.origin).dot(ray.direction);
        assert!(ray.at(along).distance(instrument(10)) < 1e-9);
        let reversed = points.slice(ndarray::s![..;-1, ..]).to_owned();
        let problem = LinesOfSight::new(&reversed, &directions).unwrap_err().to_string();
        assert!(problem.contains("turn or transpose"), "{problem}");
        let down = directions.mapv(|direction| -direction);
        assert!(LinesOfSight::new(&points, &down).is_err());
    }
}
