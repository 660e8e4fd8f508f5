//! `View` and `Views`: the camera geometry.

use crate::error::raise;
use deepct_core::math::towards;
use deepct_core::{Error, scene};
use numpy::ndarray::Array1;
use numpy::{IntoPyArray, PyArray1};
use pyo3::exceptions::{PyIndexError, PyTypeError};
use pyo3::prelude::*;
use pyo3::types::{PyIterator, PyTuple};
use std::path::PathBuf;

type Point = (f64, f64, f64);

/// The position (km) of a camera in the local system of a scene: x to the east, y to the north and z up
/// from the point of the ellipsoid WGS 84 with this geodetic latitude and longitude. `position` (km)
/// is Earth-centred and Earth-fixed (ECEF, ITRS), as orbit software gives it at the time of the image.
///
/// Altitudes refer to the ellipsoid, not to the geoid. Raises ValueError for a position that is not
/// that of a satellite above the horizon.
#[pyfunction]
pub(crate) fn camera_from_ecef(
    position: Point,
    latitude_deg: f64,
    longitude_deg: f64,
) -> PyResult<Point> {
    let (latitude, longitude) = (latitude_deg.to_radians(), longitude_deg.to_radians());
    scene::camera_from_ecef(position.into(), latitude, longitude).map(Into::into).map_err(raise)
}

/// The geometry of a camera that points at a target. Image rows increase towards the north,
/// columns towards the east.
///
/// Construct it with `View.perspective` or `View.orthographic`.
#[pyclass(frozen, eq, from_py_object, module = "deepct_py")]
#[derive(Clone, Copy, PartialEq)]
pub(crate) struct View(scene::View);

#[pymethods]
impl View {
    /// A pinhole camera at `position` (km) that points at `target` (km). The image has `size`
    /// (rows, cols) pixels; `pixel_tangent` is the pixel size divided by the focal length.
    #[staticmethod]
    #[pyo3(
        signature = (position, target, pixel_tangent, size = [32, 32]),
        text_signature = "(position, target, pixel_tangent, size=(32, 32))",
    )]
    fn perspective(
        position: Point,
        target: Point,
        pixel_tangent: f64,
        size: [usize; 2],
    ) -> PyResult<Self> {
        scene::View::perspective(position.into(), target.into(), pixel_tangent, size)
            .map(Self)
            .map_err(raise)
    }

    /// A camera at infinity with parallel lines of sight. The angles (degrees, azimuth clockwise
    /// from north) give its direction as seen from `target` (km). The image has `size` (rows,
    /// cols) pixels, which are squares of `pixel_km` in the horizontal plane through the target.
    ///
    /// With `looks_up`, the lines of sight look up and begin in this plane; the zenith angle, which
    /// remains that of the direction from the scene to the camera, is above 90 degrees.
    #[staticmethod]
    #[pyo3(
        signature = (zenith_deg, azimuth_deg, target, pixel_km, size = [32, 32], *, looks_up = false),
        text_signature = "(zenith_deg, azimuth_deg, target, pixel_km, size=(32, 32), *, \
                          looks_up=False)",
    )]
    fn orthographic(
        zenith_deg: f64,
        azimuth_deg: f64,
        target: Point,
        pixel_km: f64,
        size: [usize; 2],
        looks_up: bool,
    ) -> PyResult<Self> {
        let towards = towards(zenith_deg.to_radians(), azimuth_deg.to_radians());
        let view = if looks_up { scene::View::looking_up } else { scene::View::orthographic };
        view(towards, target.into(), pixel_km, size).map(Self).map_err(raise)
    }

    /// View zenith angle: the angle at the target between +z and the camera (degrees).
    #[getter]
    fn zenith_deg(&self) -> f64 {
        self.0.zenith().to_degrees()
    }

    /// View azimuth: the azimuth from the target to the camera, clockwise from north (degrees).
    #[getter]
    fn azimuth_deg(&self) -> f64 {
        self.0.azimuth().to_degrees()
    }

    /// Size of a pixel at the target (km), perpendicular to the line of sight for a perspective
    /// camera and in the horizontal plane for an orthographic one.
    #[getter]
    fn pixel_km(&self) -> f64 {
        self.0.pixel_km()
    }

    /// The point at which the camera is pointed (km), at the centre of the image unless it is shifted.
    #[getter]
    fn target(&self) -> Point {
        self.0.target.into()
    }

    /// Position of the camera (km); None for a camera at infinity.
    #[getter]
    fn position(&self) -> Option<Point> {
        match self.0.projection {
            scene::Projection::Perspective { position, .. } => Some(position.into()),
            _ => None,
        }
    }

    /// Number of rows and columns.
    #[getter]
    fn size(&self) -> (usize, usize) {
        (self.0.rows, self.0.cols)
    }

    /// Position of the centre of the image relative to the target (rows, cols); (0, 0) unless the
    /// image is a part of a larger one.
    #[getter]
    fn shift(&self) -> (f64, f64) {
        self.0.shift.into()
    }

    /// The view of a part of the image: `size` (rows, cols) pixels from the pixel `first` (row, col).
    /// It belongs to `image[first[0]:first[0] + size[0], first[1]:first[1] + size[1]]`.
    fn part(&self, first: [usize; 2], size: [usize; 2]) -> PyResult<Self> {
        self.0.part(first, size).map(Self).map_err(raise)
    }

    /// Project a point (km) onto the image. Returns continuous (row, col) coordinates, in which
    /// pixel `[r, c]` spans `r..r+1, c..c+1`, or None for a point behind the camera.
    fn project(&self, point: Point) -> Option<(f64, f64)> {
        self.0.project(point.into())
    }

    /// Origin (km) and unit direction of the line of sight through a point of the image (continuous
    /// row and col). The direction is from the camera into the scene.
    fn ray(&self, row: f64, col: f64) -> (Point, Point) {
        let ray = self.0.ray(row, col);
        (ray.origin.into(), ray.direction.into())
    }

    fn __repr__(&self) -> String {
        format!(
            "View(zenith_deg={:.3}, azimuth_deg={:.3}, pixel_km={:.6}, size=({}, {}))",
            self.zenith_deg(),
            self.azimuth_deg(),
            self.pixel_km(),
            self.0.rows,
            self.0.cols
        )
    }
}

/// The camera geometry of a stack of images: a sequence of `View`.
///
/// Parameters
/// ----------
/// views : sequence of View
///     One view for each image, at least one.
#[pyclass(frozen, eq, sequence, module = "deepct_py")]
#[derive(Clone, PartialEq)]
pub(crate) struct Views(pub(crate) Vec<scene::View>);

#[pymethods]
impl Views {
    #[new]
    fn new(views: Vec<View>) -> PyResult<Self> {
        if views.is_empty() {
            return Err(raise(Error::out_of_range("number of views", 0, "at least 1")));
        }
        Ok(Self(views.into_iter().map(|view| view.0).collect()))
    }

    /// Load the views of a formation, either by its name, `"cloudct-10"` or `"pearls-32"` (cameras
    /// 600 km above the target with pixels of 50 m at nadir), or from a TOML file, whose format is
    /// described by `deepct render --help`.
    ///
    /// The cameras point at `target` (km) and take images of `size` (rows, cols) pixels, unless the
    /// file specifies other values.
    #[staticmethod]
    #[pyo3(
        signature = (name_or_path, target, size = [32, 32]),
        text_signature = "(name_or_path, target, size=(32, 32))",
    )]
    fn load(name_or_path: PathBuf, target: Point, size: [usize; 2]) -> PyResult<Self> {
        scene::ViewList::find(&name_or_path.to_string_lossy())
            .and_then(|list| list.views(target.into(), size))
            .map(Self)
            .map_err(raise)
    }

    /// The views of a string-of-pearls formation: satellites at equal distances on one orbit, with
    /// satellite number 0 at the zenith of the target.
    ///
    /// Parameters
    /// ----------
    /// target : (float, float, float)
    ///     The point at which all cameras are pointed (km).
    /// altitude : float
    ///     Altitude of the orbit (km).
    /// arc : float
    ///     Distance between adjacent satellites along the orbit (km).
    /// first, last : int
    ///     Numbers of the first and the last satellite.
    /// track_azimuth_deg : float
    ///     Azimuth of the flight direction, clockwise from north (degrees).
    /// pixel_km : float
    ///     Size of a pixel at nadir (km).
    /// size : (int, int)
    ///     Number of rows and columns.
    #[staticmethod]
    #[pyo3(
        signature = (
            target, altitude = 600.0, arc = 100.0, first = -16, last = 15,
            *, track_azimuth_deg = 0.0, pixel_km = 0.05, size = [32, 32],
        ),
        text_signature = "(target, altitude=600.0, arc=100.0, first=-16, last=15, *, \
                          track_azimuth_deg=0.0, pixel_km=0.05, size=(32, 32))",
    )]
    // In Python these are keyword arguments with defaults.
    #[allow(clippy::too_many_arguments)]
    fn string_of_pearls(
        target: Point,
        altitude: f64,
        arc: f64,
        first: i32,
        last: i32,
        track_azimuth_deg: f64,
        pixel_km: f64,
        size: [usize; 2],
    ) -> PyResult<Self> {
        let formation =
            scene::Formation::string_of_pearls(altitude, arc, first..=last).map_err(raise)?;
        let track_azimuth = track_azimuth_deg.to_radians();
        scene::Formation { track_azimuth, pixel_km, ..formation }
            .views(target.into(), size)
            .map(Self)
            .map_err(raise)
    }

    /// View zenith angle of each camera (degrees).
    #[getter]
    fn zenith_deg<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.each(py, |view| view.zenith().to_degrees())
    }

    /// View azimuth of each camera, from the target to the camera, clockwise from north (degrees).
    #[getter]
    fn azimuth_deg<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.each(py, |view| view.azimuth().to_degrees())
    }

    /// Pixel size of each camera at the target (km).
    #[getter]
    fn pixel_km<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.each(py, scene::View::pixel_km)
    }

    fn __len__(&self) -> usize {
        self.0.len()
    }

    fn __iter__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyIterator>> {
        let views = self.0.iter().map(|view| View(*view));
        PyTuple::new(py, views.collect::<Vec<_>>())?.try_iter()
    }

    fn __getitem__(&self, index: isize) -> PyResult<View> {
        let wrapped = if index < 0 { index + self.0.len() as isize } else { index };
        usize::try_from(wrapped)
            .ok()
            .and_then(|index| self.0.get(index))
            .map(|view| View(*view))
            .ok_or_else(|| PyIndexError::new_err(format!("there is no view {index}")))
    }

    fn __repr__(&self) -> String {
        format!("Views({})", self.0.len())
    }
}

impl Views {
    fn each<'py>(
        &self,
        py: Python<'py>,
        number: impl Fn(&scene::View) -> f64,
    ) -> Bound<'py, PyArray1<f64>> {
        self.0.iter().map(number).collect::<Array1<_>>().into_pyarray(py)
    }
}

/// Views given as an argument: `Views` or any sequence of `View`.
pub(crate) struct ViewSequence(pub(crate) Vec<scene::View>);

impl<'py> FromPyObject<'_, 'py> for ViewSequence {
    type Error = PyErr;

    fn extract(object: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        if let Ok(views) = object.cast::<Views>() {
            return Ok(Self(views.get().0.clone()));
        }
        let views: Vec<View> = object
            .extract()
            .map_err(|_| PyTypeError::new_err("views must be Views or a sequence of View"))?;
        Views::new(views).map(|views| Self(views.0))
    }
}
