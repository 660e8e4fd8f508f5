//! A view: one image with its camera geometry.

use crate::error::{Error, Result};
use crate::math::{DVec3, Ray, zenith_and_azimuth};
use crate::memory;
use glam::DVec2;

/// The projection of points of the scene onto the image.
#[derive(Debug, Clone, Copy, PartialEq)]
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
        /// Unit vector from the scene towards the camera.
        towards: DVec3,
        /// Pixel size in the horizontal plane (km).
        pixel_km: f64,
    },
}

/// A camera pointed at a target. Rows increase towards north and columns towards east.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// The point at the centre of the image (km).
    pub target: DVec3,
    /// The projection of points onto the image.
    pub projection: Projection,
    /// Number of rows.
    pub rows: usize,
    /// Number of columns.
    pub cols: usize,
}

impl View {
    /// A perspective camera at `position` (km) pointed at `target` (km), with the pixel size over
    /// focal length `pixel_tangent` and `[rows, cols]` pixels.
    ///
    /// # Errors
    /// Returns an error if the camera is not above its target, if the pixel size is not positive,
    /// or if the image is empty.
    pub fn perspective(
        position: DVec3,
        target: DVec3,
        pixel_tangent: f64,
        [rows, cols]: [usize; 2],
    ) -> Result<Self> {
        let projection = Projection::Perspective { position, pixel_tangent };
        Self { target, projection, rows, cols }.checked(pixel_tangent)
    }

    /// A camera at infinity in the direction `towards`, with pixels of size `pixel_km` in the
    /// horizontal plane through `target` (km) and `[rows, cols]` pixels.
    ///
    /// # Errors
    /// As [`View::perspective`].
    pub fn orthographic(
        towards: DVec3,
        target: DVec3,
        pixel_km: f64,
        [rows, cols]: [usize; 2],
    ) -> Result<Self> {
        let projection = Projection::Orthographic { towards: towards.normalize(), pixel_km };
        Self { target, projection, rows, cols }.checked(pixel_km)
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
        if !(towards.is_finite() && self.target.is_finite() && towards.z > 1e-3) {
            return Err(Error::out_of_range(
                "view direction",
                towards,
                "upwards from the target to the camera",
            ));
        }
        Ok(self)
    }

    /// Unit vector from the target towards the camera.
    pub fn towards(&self) -> DVec3 {
        match self.projection {
            Projection::Perspective { position, .. } => (position - self.target).normalize(),
            Projection::Orthographic { towards, .. } => towards,
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
    /// horizontal plane for an orthographic one.
    pub fn pixel_km(&self) -> f64 {
        match self.projection {
            Projection::Perspective { position, pixel_tangent } => {
                position.distance(self.target) * pixel_tangent
            }
            Projection::Orthographic { pixel_km, .. } => pixel_km,
        }
    }

    /// Distance of the camera from the target (km); `None` for an orthographic camera.
    pub fn distance_km(&self) -> Option<f64> {
        match self.projection {
            Projection::Perspective { position, .. } => Some(position.distance(self.target)),
            Projection::Orthographic { .. } => None,
        }
    }

    /// The image axes as unit vectors: column (east) and row (north), both normal to
    /// the line of sight.
    fn axes(&self) -> (DVec3, DVec3) {
        let towards = self.towards();
        let col = (DVec3::X - DVec3::X.dot(towards) * towards).normalize();
        (col, towards.cross(col))
    }

    /// The line of sight through a point of the image, from the camera into the scene. `row` and
    /// `col` are continuous: pixel `[r, c]` spans `r..r+1, c..c+1`.
    ///
    /// The ray of an orthographic view starts at a distance of 1000 km from the horizontal plane
    /// through the target.
    #[inline]
    pub fn ray(&self, row: f64, col: f64) -> Ray {
        let (row, col) = (row - 0.5 * self.rows as f64, col - 0.5 * self.cols as f64);
        match self.projection {
            Projection::Perspective { position, pixel_tangent } => {
                let (col_axis, row_axis) = self.axes();
                let direction = pixel_tangent * (col * col_axis + row * row_axis) - self.towards();
                Ray { origin: position, direction: direction.normalize() }
            }
            Projection::Orthographic { towards, pixel_km } => {
                let point = self.target + pixel_km * DVec3::new(col, row, 0.0);
                Ray { origin: point + 1000.0 * towards, direction: -towards }
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

    /// Prepares the projection of many points.
    pub(crate) fn projector(&self) -> Projector {
        let middle = 0.5 * DVec2::new(self.rows as f64, self.cols as f64);
        match self.projection {
            Projection::Perspective { position, pixel_tangent } => {
                let (col_axis, row_axis) = self.axes();
                let towards = self.towards();
                Projector {
                    origin: position,
                    axes: [row_axis / pixel_tangent, col_axis / pixel_tangent, -towards],
                    depth: 0.0,
                    middle,
                }
            }
            Projection::Orthographic { towards, pixel_km } => {
                // The point is projected along the line of sight onto the horizontal plane.
                let axis =
                    |along: DVec3| (along - along.dot(towards) / towards.z * DVec3::Z) / pixel_km;
                Projector {
                    origin: self.target,
                    axes: [axis(DVec3::Y), axis(DVec3::X), DVec3::ZERO],
                    depth: 1.0,
                    middle,
                }
            }
        }
    }
}

/// The projection of a view as a linear map in homogeneous coordinates, for many points.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Projector {
    origin: DVec3,
    /// Gradients of row times depth, column times depth, and depth.
    axes: [DVec3; 3],
    /// The depth of the origin.
    depth: f64,
    /// Row and column of the image centre.
    middle: DVec2,
}

impl Projector {
    /// As [`View::project`].
    #[inline]
    pub(crate) fn project(&self, point: DVec3) -> Option<(f64, f64)> {
        let offset = point - self.origin;
        let [row, col, depth] = self.axes.map(|axis| axis.dot(offset));
        let depth = self.depth + depth;
        let place = DVec2::new(row, col) / depth + self.middle;
        (depth > 0.0).then_some((place.x, place.y))
    }

    /// Projects equidistant points, which start at `first` and are `step` apart, to `(row, col)`.
    /// The result is NaN for points behind the camera.
    #[inline]
    pub(crate) fn project_row(&self, first: DVec3, step: DVec3, pixels: &mut [DVec2]) {
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

/// The common target of all views (km), the point at the centre of every image.
///
/// # Errors
/// Returns an error if there is no view, or if the targets differ by more than a metre.
pub fn target(views: &[View]) -> Result<DVec3> {
    let Some(first) = views.first() else {
        return Err(Error::out_of_range("number of views", 0, "at least 1"));
    };
    match views.iter().position(|view| view.target.distance(first.target) > 1e-3) {
        None => Ok(first.target),
        Some(number) => Err(Error::mismatch(
            format!("target of view {number} (km)"),
            format!("{}, the target of view 0", first.target),
            views[number].target,
            "give views that look at one point",
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
                        let step = DVec3::new(0.02, 0.0, 0.01);
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

    #[test]
    fn a_camera_below_the_horizon_is_refused() {
        let down = DVec3::new(0.0, 0.0, -1.0);
        assert!(View::orthographic(down, DVec3::ZERO, 0.05, [8, 8]).is_err());
        assert!(View::perspective(DVec3::ZERO, DVec3::ZERO, 1e-5, [8, 8]).is_err());
        assert!(View::orthographic(DVec3::Z, DVec3::ZERO, 0.0, [8, 8]).is_err());
    }

    #[test]
    fn views_of_one_point_have_it_as_their_target() {
        let at = |x| View::orthographic(DVec3::Z, DVec3::new(x, 0.7, 1.0), 0.05, [8, 8]).unwrap();
        assert_eq!(target(&[at(0.8), at(0.8)]).unwrap(), DVec3::new(0.8, 0.7, 1.0));
        let message = target(&[at(0.8), at(0.8), at(0.9)]).unwrap_err().to_string();
        assert!(message.contains("view 2") && message.contains("0.9"), "{message}");
        assert!(target(&[]).is_err());
    }
}
