//! A view: one image with its camera geometry.

use super::lines::LinesOfSight;
use crate::error::{Error, Result};
use crate::image::first_of_padded;
use crate::math::{DVec3, Ray, zenith_and_azimuth};
use crate::memory;
use glam::DVec2;
use ndarray::Array2;
use std::ops::Range;
use std::sync::Arc;

/// The projection of points of the scene onto the image.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Projection {
    /// Central projection: all rays pass through the camera position, and the image plane is normal
    /// to the line of sight.
    Perspective {
        /// Position of the camera (km).
        position: DVec3,
        /// Pixel size over focal length (dimensionless).
        pixel_tangent: f64,
    },
    /// Parallel rays; pixels are squares in the horizontal plane through the target.
    Orthographic {
        /// Unit vector from the scene towards the camera. If it points downwards, the lines of sight
        /// look up and begin in the horizontal plane through the target.
        towards: DVec3,
        /// Pixel size in the horizontal plane (km).
        pixel_km: f64,
    },
    /// A line of sight for each pixel.
    LinesOfSight {
        /// The lines of sight of a whole image.
        lines: Arc<LinesOfSight>,
        /// The row and column in it of the first pixel of this image.
        first: [f64; 2],
    },
}

/// Largest shift of an image (pixels): that of a part of any image there is.
const MOST_SHIFT: f64 = 1e6;

/// Distance (km) up to which targets are the same: that of rounding errors.
const SAME_TARGET: f64 = 1e-6;

/// Largest displacement (pixels) of a pixel of an image whose plane is turned to another target.
const TURNED_PIXEL: f64 = 0.1;

/// A camera pointed at a target. Rows increase towards north and columns towards east: on the image
/// plane of a perspective camera, columns along the projection of the east vector, and rows along the
/// normal of both it and the line of sight.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// The point that the camera is pointed at (km), at the centre of the image unless it is shifted.
    pub target: DVec3,
    /// The projection of points onto the image.
    pub projection: Projection,
    /// Position of the centre of the image relative to the target, in rows and columns; `[0, 0]`
    /// unless the image is a part of a larger one.
    pub shift: [f64; 2],
    /// Number of rows.
    pub rows: usize,
    /// Number of columns.
    pub cols: usize,
}

impl View {
    /// A perspective camera at `position` (km) pointed at `target` (km), with the pixel size over
    /// focal length `pixel_tangent` and `[rows, cols]` pixels.
    ///
    /// The camera may be anywhere: above the scene, inside it, or below its target.
    ///
    /// # Errors
    /// Returns an error if the camera is at the altitude of its target, if the pixel size is not
    /// positive, or if the image is empty.
    pub fn perspective(
        position: DVec3,
        target: DVec3,
        pixel_tangent: f64,
        [rows, cols]: [usize; 2],
    ) -> Result<Self> {
        let projection = Projection::Perspective { position, pixel_tangent };
        Self { target, projection, shift: [0.0, 0.0], rows, cols }.checked(pixel_tangent)
    }

    /// A camera at infinity in the direction `towards`, with pixels of size `pixel_km` in the
    /// horizontal plane through `target` (km) and `[rows, cols]` pixels.
    ///
    /// # Errors
    /// As [`View::perspective`], and if the camera is below the horizon.
    pub fn orthographic(
        towards: DVec3,
        target: DVec3,
        pixel_km: f64,
        size: [usize; 2],
    ) -> Result<Self> {
        if towards.z < 0.0 {
            return Err(Error::out_of_range(
                "view direction",
                towards,
                "upwards from the target to the camera, or that of a view that looks up",
            ));
        }
        Self::parallel(towards, target, pixel_km, size)
    }

    /// Parallel lines of sight that look up from the horizontal plane through `target` (km) in the
    /// direction opposite to `towards`, which points downwards, with pixels of size `pixel_km` in
    /// this plane and `[rows, cols]` pixels.
    ///
    /// # Errors
    /// As [`View::perspective`], and if the view does not look up.
    pub fn looking_up(
        towards: DVec3,
        target: DVec3,
        pixel_km: f64,
        size: [usize; 2],
    ) -> Result<Self> {
        if towards.z > 0.0 {
            let range = "downwards, as a view that looks up has its camera below its target";
            return Err(Error::out_of_range("view direction", towards, range));
        }
        Self::parallel(towards, target, pixel_km, size)
    }

    /// An image with a line of sight for each pixel, whose middle shows the target.
    ///
    /// # Errors
    /// As [`View::perspective`].
    pub fn lines_of_sight(lines: Arc<LinesOfSight>) -> Result<Self> {
        let [rows, cols] = lines.size();
        let (target, _) = lines.at(0.5 * DVec2::new(rows as f64, cols as f64), lines.altitude());
        let target = target.extend(lines.altitude());
        let projection = Projection::LinesOfSight { lines, first: [0.0, 0.0] };
        let view = Self { target, projection, shift: [0.0, 0.0], rows, cols };
        let pixel = view.pixel_km();
        view.checked(pixel)
    }

    /// Whether the camera is below its target.
    pub fn looks_up(&self) -> bool {
        self.towards().z < 0.0
    }

    fn parallel(
        towards: DVec3,
        target: DVec3,
        pixel_km: f64,
        [rows, cols]: [usize; 2],
    ) -> Result<Self> {
        let projection = Projection::Orthographic { towards: towards.normalize(), pixel_km };
        Self { target, projection, shift: [0.0, 0.0], rows, cols }.checked(pixel_km)
    }

    /// The same camera with an image whose centre is `shift` rows and columns from the target, as
    /// those cut out of larger images.
    ///
    /// # Errors
    /// Returns an error if the shift is not finite or so large that the image cannot show the scene.
    pub fn with_shift(self, shift: [f64; 2]) -> Result<Self> {
        if shift.iter().any(|pixels| pixels.is_nan() || pixels.abs() > MOST_SHIFT) {
            let range = format!("at most {MOST_SHIFT:e} rows and columns");
            return Err(Error::out_of_range("shift of an image", format!("{shift:?}"), range));
        }
        Ok(Self { shift, ..self })
    }

    /// The points (km) on the lines of sight of the pixel centres, and vectors from there to the instrument
    /// with a vertical component of 1, `[row, col]`; `None` for a camera of another kind.
    pub fn pixel_lines(&self) -> Option<[Array2<DVec3>; 2]> {
        let Projection::LinesOfSight { lines, first } = &self.projection else { return None };
        let line = |part: usize| {
            Array2::from_shape_fn((self.rows, self.cols), |(row, col)| {
                let pixel = DVec2::new(row as f64, col as f64);
                lines.line(DVec2::from(*first) + pixel + 0.5)[part]
            })
        };
        Some([line(0), line(1)])
    }

    /// The view of a part of the image: `[rows, cols]` pixels from the pixel `first`.
    ///
    /// # Errors
    /// Returns an error if the part is empty or extends beyond the image.
    pub fn part(&self, first: [usize; 2], [rows, cols]: [usize; 2]) -> Result<Self> {
        let ends = [first[0].checked_add(rows), first[1].checked_add(cols)];
        let inside = |end: Option<usize>, whole: usize| end.is_some_and(|end| end <= whole);
        if rows == 0 || cols == 0 || !inside(ends[0], self.rows) || !inside(ends[1], self.cols) {
            let found = format!("{rows} x {cols} pixels from {first:?}");
            let range = format!("within {} x {} pixels, and not empty", self.rows, self.cols);
            return Err(Error::out_of_range("part of an image", found, range));
        }
        self.framed(first.map(|first| first as f64), [rows, cols])
    }

    /// The view of an image in whose middle this one is, see [`ViewStack::of_images`].
    ///
    /// # Errors
    /// Returns an error if the other image is smaller.
    ///
    /// [`ViewStack::of_images`]: crate::image::ViewStack::of_images
    pub fn padded(&self, size: [usize; 2]) -> Result<Self> {
        if size[0] < self.rows || size[1] < self.cols {
            let range = format!("at least [{}, {}], that of the view", self.rows, self.cols);
            return Err(Error::out_of_range("image size [row, col]", format!("{size:?}"), range));
        }
        if size == [self.rows, self.cols] {
            return Ok(self.clone());
        }
        let before = first_of_padded([self.rows, self.cols], size);
        self.framed(before.map(|before| -(before as f64)), size)
    }

    /// The view of `[rows, cols]` pixels from the pixel `first` of this image, which may be outside it.
    pub(crate) fn framed(&self, first: [f64; 2], [rows, cols]: [usize; 2]) -> Result<Self> {
        let moved = |axis: usize, size: usize, whole: usize| {
            self.shift[axis] + first[axis] + 0.5 * size as f64 - 0.5 * whole as f64
        };
        let shift = [moved(0, rows, self.rows), moved(1, cols, self.cols)];
        let mut view = Self { rows, cols, ..self.clone() };
        if let Projection::LinesOfSight { first: before, .. } = &mut view.projection {
            *before = [before[0] + first[0], before[1] + first[1]];
        }
        view.with_shift(shift)
    }

    /// The view of a larger image of `[rows, cols]` pixels, of which this one is the part that begins at
    /// the pixel `first`; the inverse of [`View::part`].
    ///
    /// # Errors
    /// Returns an error if the image is not larger.
    pub fn enlarged(&self, first: [usize; 2], [rows, cols]: [usize; 2]) -> Result<Self> {
        if first[0] + self.rows > rows || first[1] + self.cols > cols {
            let found = format!("{} x {} pixels from {first:?}", self.rows, self.cols);
            let range = format!("within {rows} x {cols} pixels");
            return Err(Error::out_of_range("part of an image", found, range));
        }
        self.framed(first.map(|first| -(first as f64)), [rows, cols])
    }

    /// The view of the same image with another target (km), from which the image is shifted. For a
    /// perspective camera, the image plane is turned to be normal to the line of sight to the new
    /// target.
    ///
    /// # Errors
    /// Returns an error if the new target is behind the camera, or if turning the image plane would
    /// move a pixel by more than a tenth of its size.
    pub fn aimed_at(&self, target: DVec3) -> Result<Self> {
        if self.target.distance(target) <= SAME_TARGET {
            return Ok(self.clone());
        }
        let [rows, cols] = [self.rows as f64, self.cols as f64];
        let moved = self.project(target).and_then(|(row, col)| {
            let view = Self { target, ..self.clone() };
            let view = view.with_shift([0.5 * rows - row, 0.5 * cols - col]).ok()?;
            let corners = [(0.0, 0.0), (0.0, cols), (rows, 0.0), (rows, cols)];
            let same = corners.into_iter().all(|(row, col)| {
                let ray = self.ray(row, col);
                // The point of the ray that is as far from the camera as the target.
                let point = ray.at((target - ray.origin).dot(ray.direction));
                view.project(point).is_some_and(|(other_row, other_col)| {
                    (other_row - row).hypot(other_col - col) < TURNED_PIXEL
                })
            });
            same.then_some(view)
        });
        moved.ok_or_else(|| {
            let remedy = "point all cameras at one target: these are too near for their distance \
                          from it";
            Error::mismatch("target (km)", target, self.target, remedy)
        })
    }

    /// The pixel coordinates of the target, `(row, col)`.
    fn middle(&self) -> DVec2 {
        DVec2::new(0.5 * self.rows as f64 - self.shift[0], 0.5 * self.cols as f64 - self.shift[1])
    }

    fn checked(self, pixel: f64) -> Result<Self> {
        if !(pixel.is_finite() && pixel > 0.0) {
            return Err(Error::out_of_range("pixel size", pixel, "positive and finite"));
        }
        if self.rows == 0 || self.cols == 0 {
            return Err(Error::out_of_range(
                "image size [row, col]",
                format!("[{}, {}]", self.rows, self.cols),
                "at least 1 along each axis",
            ));
        }
        memory::check("memory for an image", self.rows as f64 * self.cols as f64, 32.0)?;
        let towards = self.towards();
        if !(towards.is_finite() && self.target.is_finite() && towards.z.abs() > 1e-3) {
            let range = "upwards or downwards from the target to the camera, not horizontal";
            return Err(Error::out_of_range("view direction", towards, range));
        }
        Ok(self)
    }

    /// Unit vector from the target towards the camera.
    pub fn towards(&self) -> DVec3 {
        match self.projection {
            Projection::Perspective { position, .. } => (position - self.target).normalize(),
            Projection::Orthographic { towards, .. } => towards,
            Projection::LinesOfSight { .. } => {
                let DVec2 { x: row, y: col } = self.middle();
                -self.ray(row, col).direction
            }
        }
    }

    /// View zenith angle at the target (radians).
    pub fn zenith(&self) -> f64 {
        zenith_and_azimuth(self.towards()).0
    }

    /// Azimuth from the target towards the camera, clockwise from north (radians).
    pub fn azimuth(&self) -> f64 {
        zenith_and_azimuth(self.towards()).1
    }

    /// Pixel size at the target (km): normal to the line of sight for a perspective camera, in the
    /// horizontal plane for an orthographic one; for lines of sight, the root of the area of the pixel that
    /// shows the target in this plane.
    pub fn pixel_km(&self) -> f64 {
        match &self.projection {
            Projection::Perspective { position, pixel_tangent } => {
                position.distance(self.target) * pixel_tangent
            }
            Projection::Orthographic { pixel_km, .. } => *pixel_km,
            Projection::LinesOfSight { lines, first } => {
                let place = self.middle() + DVec2::from(*first);
                let (_, [north, east]) = lines.at(place, self.target.z);
                east.perp_dot(north).abs().sqrt()
            }
        }
    }

    /// The largest angle between the lines of sight of neighbouring pixels (radians).
    pub(crate) fn pixel_angle(&self) -> f64 {
        match &self.projection {
            Projection::Perspective { pixel_tangent, .. } => *pixel_tangent,
            Projection::Orthographic { .. } => 0.0,
            Projection::LinesOfSight { lines, .. } => lines.pixel_angle(),
        }
    }

    /// The largest angle between the line of sight to the target and those at the corners (radians).
    pub(crate) fn spread(&self) -> f64 {
        let (rows, cols) = (self.rows as f64, self.cols as f64);
        let corners = [(0.0, 0.0), (0.0, cols), (rows, 0.0), (rows, cols)];
        let angle = |(row, col)| (-self.ray(row, col).direction).angle_between(self.towards());
        corners.into_iter().map(angle).fold(0.0, f64::max)
    }

    /// Distance of the camera from the target (km); `None` for an orthographic camera and for lines of
    /// sight.
    pub fn distance_km(&self) -> Option<f64> {
        match self.projection {
            Projection::Perspective { position, .. } => Some(position.distance(self.target)),
            Projection::Orthographic { .. } | Projection::LinesOfSight { .. } => None,
        }
    }

    /// The image axes as unit vectors: column (east) and row (north), both normal to
    /// the line of sight. The image of a camera that looks up is oriented as a map, too.
    fn axes(&self) -> (DVec3, DVec3) {
        let towards = self.towards();
        let col = (DVec3::X - DVec3::X.dot(towards) * towards).normalize();
        (col, towards.cross(col) * towards.z.signum())
    }

    /// The line of sight through a point of the image, from the camera into the scene. `row` and
    /// `col` are continuous: pixel `[r, c]` spans `r..r+1, c..c+1`.
    ///
    /// The ray of an orthographic view starts at a distance of 1000 km from the horizontal plane
    /// through the target, or in this plane if it looks up; one of lines of sight, at this distance from
    /// their points.
    #[inline]
    pub fn ray(&self, row: f64, col: f64) -> Ray {
        let at = DVec2::new(row, col) - self.middle();
        match &self.projection {
            Projection::Perspective { position, pixel_tangent } => {
                let (col_axis, row_axis) = self.axes();
                let direction =
                    *pixel_tangent * (at.y * col_axis + at.x * row_axis) - self.towards();
                Ray { origin: *position, direction: direction.normalize() }
            }
            Projection::LinesOfSight { lines, first } => lines.ray(row + first[0], col + first[1]),
            &Projection::Orthographic { towards, pixel_km } => {
                let point = self.target + pixel_km * DVec3::new(at.y, at.x, 0.0);
                let start = if towards.z > 0.0 { 1000.0 } else { 0.0 };
                Ray { origin: point + start * towards, direction: -towards }
            }
        }
    }

    /// Projects a point of the scene (km) to continuous image coordinates `(row, col)`. A result
    /// outside `0..rows, 0..cols` is outside the image. Returns `None` for a point behind the
    /// camera.
    #[inline]
    pub fn project(&self, point: DVec3) -> Option<(f64, f64)> {
        self.projector().project(point)
    }

    /// Whether a point of the scene (km) is inside the image.
    pub fn shows(&self, point: DVec3) -> bool {
        self.project(point).is_some_and(|(row, col)| {
            (0.0..=self.rows as f64).contains(&row) && (0.0..=self.cols as f64).contains(&col)
        })
    }

    /// Prepares the projection of many points.
    pub(crate) fn projector(&self) -> Projector {
        let middle = self.middle();
        let map = match self.projection {
            Projection::LinesOfSight { ref lines, first } => {
                return Projector::Search { lines: lines.clone(), first: DVec2::from(first) };
            }
            Projection::Perspective { position, pixel_tangent } => {
                let (col_axis, row_axis) = self.axes();
                let towards = self.towards();
                LinearMap {
                    origin: position,
                    axes: [row_axis / pixel_tangent, col_axis / pixel_tangent, -towards],
                    depth: 0.0,
                    lowest: f64::NEG_INFINITY,
                    middle,
                }
            }
            Projection::Orthographic { towards, pixel_km } => {
                // The point is projected along the line of sight onto the horizontal plane.
                let axis =
                    |along: DVec3| (along - along.dot(towards) / towards.z * DVec3::Z) / pixel_km;
                LinearMap {
                    origin: self.target,
                    axes: [axis(DVec3::Y), axis(DVec3::X), DVec3::ZERO],
                    depth: 1.0,
                    lowest: if towards.z > 0.0 { f64::NEG_INFINITY } else { self.target.z },
                    middle,
                }
            }
        };
        Projector::Linear(map)
    }
}

/// The projection of a view for many points.
#[derive(Debug, Clone)]
pub(crate) enum Projector {
    /// By a linear map.
    Linear(LinearMap),
    /// By a search among lines of sight, which begin with a row and a column.
    Search { lines: Arc<LinesOfSight>, first: DVec2 },
}

/// A linear map in homogeneous coordinates.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LinearMap {
    origin: DVec3,
    /// Gradients of row times depth, column times depth, and depth.
    axes: [DVec3; 3],
    /// The depth of the origin.
    depth: f64,
    /// Altitude (km) below which points are behind the camera.
    lowest: f64,
    /// Row and column of the target.
    middle: DVec2,
}

impl Projector {
    /// As [`View::project`].
    #[inline]
    pub(crate) fn project(&self, point: DVec3) -> Option<(f64, f64)> {
        match self {
            Self::Linear(map) => map.project(point),
            Self::Search { lines, first } => lines.project(point).map(|at| (at - first).into()),
        }
    }

    /// Projects equidistant points at one altitude, which start at `first` and are `step` apart, to
    /// `(row, col)`. The result is NaN for points that the view does not show.
    #[inline]
    pub(crate) fn project_row(&self, first: DVec3, step: DVec3, pixels: &mut [DVec2]) {
        match self {
            Self::Linear(map) => map.project_row(first, step, pixels),
            Self::Search { .. } => {
                for (number, pixel) in pixels.iter_mut().enumerate() {
                    let place = self.project(first + number as f64 * step);
                    *pixel = place.map_or(DVec2::NAN, DVec2::from);
                }
            }
        }
    }
}

impl LinearMap {
    /// As [`View::project`].
    #[inline]
    fn project(&self, point: DVec3) -> Option<(f64, f64)> {
        let offset = point - self.origin;
        let [row, col, depth] = self.axes.map(|axis| axis.dot(offset));
        let depth = self.depth + depth;
        let place = DVec2::new(row, col) / depth + self.middle;
        (depth > 0.0 && point.z >= self.lowest).then_some((place.x, place.y))
    }

    /// As [`Projector::project_row`].
    #[inline]
    fn project_row(&self, first: DVec3, step: DVec3, pixels: &mut [DVec2]) {
        if first.z < self.lowest {
            pixels.fill(DVec2::NAN);
            return;
        }
        let first = self.axes.map(|axis| axis.dot(first - self.origin));
        let step = self.axes.map(|axis| axis.dot(step));
        for (number, pixel) in pixels.iter_mut().enumerate() {
            let at = |part: usize| first[part] + number as f64 * step[part];
            let depth = self.depth + at(2);
            let scale = if depth > 0.0 { depth.recip() } else { f64::NAN };
            *pixel = DVec2::new(at(0), at(1)) * scale + self.middle;
        }
    }
}

/// The rows and columns of the images that show a box between two corners (km), the same for all
/// views; `None` if no image shows it. The images are of one size.
pub(super) fn pixels_that_show(views: &[View], corners: [DVec3; 2]) -> Option<[Range<usize>; 2]> {
    let first = views.first()?;
    let size = [first.rows, first.cols].map(|pixels| pixels as f64);
    let mut found = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
    for view in views {
        for corner in 0..8 {
            let of = |axis: usize| corners[corner >> axis & 1][axis];
            let shown = match view.project(DVec3::new(of(0), of(1), of(2))) {
                Some((row, col)) => [[row; 2], [col; 2]],
                // A box that is partly behind a camera may be anywhere in its image.
                None => size.map(|pixels| [0.0, pixels]),
            };
            for (ends, shown) in found.iter_mut().zip(shown) {
                *ends = [ends[0].min(shown[0]), ends[1].max(shown[1])];
            }
        }
    }
    let range = |axis: usize| {
        let [low, high] = found[axis].map(|pixel| pixel.clamp(0.0, size[axis]));
        low.floor() as usize..high.ceil() as usize
    };
    let ranges = [range(0), range(1)];
    ranges.iter().all(|range| !range.is_empty()).then_some(ranges)
}

/// The common target of all views (km): the mean of their targets.
///
/// # Errors
/// Returns an error if there is no view, or if one of the images does not show the common target.
pub fn target(views: &[View]) -> Result<DVec3> {
    let Some(first) = views.first() else {
        return Err(Error::out_of_range("number of views", 0, "at least 1"));
    };
    if views.iter().all(|view| view.target.distance(first.target) <= SAME_TARGET) {
        return Ok(first.target);
    }
    let mean = views.iter().map(|view| view.target).sum::<DVec3>() / views.len() as f64;
    match views.iter().position(|view| !view.shows(mean)) {
        None => Ok(mean),
        Some(number) => Err(Error::mismatch(
            format!("target of view {number} (km)"),
            format!("a point in the same place as those of the other views, around {mean}"),
            views[number].target,
            "give views whose lines of sight meet in the cloud; the targets of images that were \
             registered on the ground have an altitude of 0",
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::towards;

    #[test]
    fn a_ray_and_the_projection_are_inverse() {
        let target = DVec3::new(0.8, 0.7, 1.1);
        for (zenith, azimuth) in [(0.0, 0.0), (0.8, 0.0), (0.8, 3.1), (1.2, 0.9), (1.0, 4.7)] {
            let towards = towards(zenith, azimuth);
            let views = [
                View::perspective(target + 700.0 * towards, target, 5e-5, [32, 40]).unwrap(),
                View::orthographic(towards, target, 0.05, [32, 40]).unwrap(),
            ];
            for view in views {
                assert!((view.zenith() - zenith).abs() < 1e-9);
                for (row, col) in [(0.0, 0.0), (16.0, 20.0), (31.2, 3.3)] {
                    let ray = view.ray(row, col);
                    for distance in [690.0, 703.0] {
                        let (r, c) = view.project(ray.at(distance)).unwrap();
                        assert!((r - row).abs() < 1e-6 && (c - col).abs() < 1e-6);
                        let step = DVec3::new(0.02, 0.01, 0.0);
                        let mut row = [DVec2::ZERO; 3];
                        view.projector().project_row(ray.at(distance) - step, step, &mut row);
                        assert!((row[1] - DVec2::new(r, c)).length() < 1e-8);
                    }
                }
            }
        }
    }

    #[test]
    fn row_grows_to_the_north_and_col_to_the_east() {
        let target = DVec3::new(0.0, 0.0, 1.0);
        for zenith in [-1.2, -0.5, 0.0, 0.5, 1.2] {
            let towards = towards(zenith, 0.0);
            let view = View::perspective(target + 700.0 * towards, target, 7e-5, [8, 8]).unwrap();
            let (row, col) = view.project(target + DVec3::new(0.02, 0.03, 0.0)).unwrap();
            assert!(row > 4.0 && col > 4.0, "zenith {zenith}: {row}, {col}");
        }
    }

    /// Images of cameras that look up are maps too, and show nothing below the camera.
    #[test]
    fn a_view_may_look_up() {
        let (target, towards) = (DVec3::new(0.8, 0.7, 0.2), towards(2.4, 2.2));
        let up = View::looking_up(towards, target, 0.05, [32, 40]).unwrap();
        let camera = target + 0.15 * towards;
        let near = View::perspective(camera, target, 0.05, [32, 40]).unwrap();
        for view in [up.clone(), near] {
            assert!(view.looks_up());
            let ray = view.ray(10.25, 30.5);
            assert!(ray.direction.z > 0.0);
            let (row, col) = view.project(ray.at(2.0)).unwrap();
            assert!((row - 10.25).abs() < 1e-9 && (col - 30.5).abs() < 1e-9);
            let above = target + DVec3::new(0.02, 0.03, 0.05);
            let (row, col) = view.project(above).unwrap();
            let (north, east) = view.project(above + DVec3::new(0.01, 0.01, 0.0)).unwrap();
            assert!(north > row && east > col);
            assert!(view.project(ray.at(-0.1)).is_none());
        }
        assert!((up.ray(16.0, 20.0).origin - target).length() < 1e-12);
        let mut row = [DVec2::ZERO; 2];
        up.projector().project_row(target - 0.1 * DVec3::Z, 0.05 * DVec3::X, &mut row);
        assert!(row.iter().all(|pixel| pixel.is_nan()));
        assert!(View::looking_up(-towards, target, 0.05, [8, 8]).is_err());
    }

    #[test]
    fn a_camera_below_the_horizon_must_look_up_on_purpose() {
        let down = DVec3::new(0.0, 0.0, -1.0);
        assert!(View::orthographic(down, DVec3::ZERO, 0.05, [8, 8]).is_err());
        let level = DVec3::new(1.0, 0.0, 0.0);
        assert!(View::perspective(level, DVec3::ZERO, 0.05, [8, 8]).is_err());
        assert!(View::perspective(DVec3::ZERO, DVec3::ZERO, 1e-5, [8, 8]).is_err());
        assert!(View::orthographic(DVec3::Z, DVec3::ZERO, 0.0, [8, 8]).is_err());
    }

    #[test]
    fn views_of_one_point_have_it_as_their_target() {
        let at = |x| View::orthographic(DVec3::Z, DVec3::new(x, 0.7, 1.0), 0.05, [8, 8]).unwrap();
        assert_eq!(target(&[at(0.8), at(0.8)]).unwrap(), DVec3::new(0.8, 0.7, 1.0));
        let mean = target(&[at(0.8), at(0.8), at(0.83)]).unwrap();
        assert!(mean.distance(DVec3::new(0.81, 0.7, 1.0)) < 1e-12);
        let message = target(&[at(0.8), at(0.8), at(1.4)]).unwrap_err().to_string();
        assert!(message.contains("view 2") && message.contains("1.4"), "{message}");
        assert!(target(&[]).is_err());
    }

    /// A part of an image has the rays and the projections of the whole image.
    #[test]
    fn a_part_of_an_image_sees_what_the_whole_image_sees_there() {
        let (target, towards) = (DVec3::new(0.8, 0.7, 1.1), towards(0.7, 2.2));
        for distance in [4.0, 700.0] {
            let position = target + distance * towards;
            for whole in [
                View::perspective(position, target, 0.05 / distance, [32, 40]).unwrap(),
                View::orthographic(towards, target, 0.05, [32, 40]).unwrap(),
            ] {
                let part = whole.part([2, 6], [12, 30]).unwrap().part([1, 4], [9, 20]).unwrap();
                assert_eq!((part.rows, part.cols, part.shift), (9, 20, [-8.5, 0.0]));
                assert_eq!(part.enlarged([3, 10], [32, 40]).unwrap(), whole);
                assert!(part.enlarged([3, 10], [11, 40]).is_err());
                let (one, other) = (whole.ray(4.5, 17.25), part.ray(1.5, 7.25));
                assert!(one.origin.distance(other.origin) < 1e-9);
                assert!(one.direction.distance(other.direction) < 1e-12);
                let (row, col) = part.project(whole.ray(4.5, 17.25).at(1.0)).unwrap();
                assert!((row - 1.5).abs() < 1e-6 && (col - 7.25).abs() < 1e-6);
                assert!(whole.shows(target) && !part.shows(target));
                for (first, size) in [([0, 0], [33, 1]), ([32, 0], [1, 1]), ([0, 0], [0, 5])] {
                    assert!(whole.part(first, size).is_err());
                }
            }
        }
        let view = View::orthographic(towards, target, 0.05, [9, 20]).unwrap();
        assert!(view.with_shift([f64::NAN, 0.0]).is_err());
    }

    #[test]
    fn another_target_leaves_the_lines_of_sight() {
        let (target, towards) = (DVec3::new(0.8, 0.7, 1.1), towards(0.7, 2.2));
        let aim = target + DVec3::new(0.11, -0.06, 0.02);
        let position = target + 700.0 * towards;
        for view in [
            View::perspective(position, target, 7e-5, [32, 40]).unwrap(),
            View::orthographic(towards, target, 0.05, [32, 40]).unwrap(),
        ] {
            let aimed = view.aimed_at(aim).unwrap();
            assert_eq!(aimed.target, aim);
            for (row, col) in [(0.5, 0.5), (16.0, 20.0), (31.5, 3.5)] {
                let point = view.ray(row, col).at(700.0);
                let (other_row, other_col) = aimed.project(point).unwrap();
                assert!((other_row - row).abs() < 0.02 && (other_col - col).abs() < 0.02);
            }
        }
        // An aircraft two kilometres above sees another perspective.
        let near = View::perspective(target + 2.0 * towards, target, 0.025, [64, 64]).unwrap();
        let far = target + DVec3::new(0.5, 0.3, 0.0);
        assert!(near.aimed_at(far).unwrap_err().to_string().contains("one target"));
    }
}
