//! `View` and `Views`: the camera geometry.

use crate::error::raise;
use crate::number::{point, reals, sizes, whole};
use crate::observation::views_of;
use crate::record::{Record, attributes, record};
use deepct_core::math::{DVec3, towards};
use deepct_core::{Error, scene};
use numpy::ndarray::{Array1, Array2, Array3};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods};
use pyo3::exceptions::{PyIndexError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyIterator, PyList, PySlice, PyTuple};
use std::path::{Path, PathBuf};
use std::sync::Arc;

type Point = (f64, f64, f64);

/// The position (km) of a camera in the local system of a scene: x to the east, y to the north and z up
/// from the point of the ellipsoid WGS 84 with this geodetic latitude and longitude. `position` (km)
/// is Earth-centred and Earth-fixed (ECEF, ITRS), as orbit software gives it at the time of the image.
///
/// Altitudes refer to the ellipsoid, not to the geoid. Raises ValueError for a position that is not
/// that of a satellite above the horizon.
#[pyfunction]
pub(crate) fn camera_from_ecef(
    position: &Bound<'_, PyAny>,
    latitude_deg: f64,
    longitude_deg: f64,
) -> PyResult<Point> {
    let (latitude, longitude) = (latitude_deg.to_radians(), longitude_deg.to_radians());
    let position = point(position, "position")?;
    scene::camera_from_ecef(position, latitude, longitude).map(Into::into).map_err(raise)
}

/// The geometry of a camera that points at a target. Image rows increase towards the north,
/// columns towards the east.
///
/// `View.perspective`, `View.orthographic` and `View.lines_of_sight` are the usual ways to construct it.
/// The arguments are those of the attributes: `position` and `pixel_tangent` for a perspective camera,
/// `direction` and `pixel_km` for a camera at infinity, `points` and `directions` for an instrument with a
/// line of sight for each pixel.
///
/// Examples
/// --------
/// >>> view = deepct_py.View.perspective([0, -300, 520], [0, 0, 1], 1e-4, size=(64, 64))
/// >>> round(view.zenith_deg, 2), view.azimuth_deg
/// (30.03, 180.0)
#[pyclass(frozen, from_py_object, module = "deepct_py")]
#[derive(Clone)]
pub(crate) struct View(scene::View);

record!(View);

impl Record for View {
    fn arguments<'py>(of: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        let names: &[&str] = match of.get().0.projection {
            scene::Projection::Perspective { .. } => {
                &["target", "position", "pixel_tangent", "size", "shift"]
            }
            scene::Projection::LinesOfSight { .. } => &["target", "points", "directions"],
            _ => &["target", "direction", "pixel_km", "size", "shift"],
        };
        attributes(of.as_any(), names)
    }
}

/// The names of two numbers of pixels.
const PIXELS: [&str; 2] = ["rows", "cols"];

/// The size of images, by default 32 x 32 pixels.
fn size_of(size: Option<&Bound<'_, PyAny>>) -> PyResult<[usize; 2]> {
    size.map_or(Ok([32, 32]), |size| sizes(size, "size", PIXELS))
}

#[pymethods]
impl View {
    #[new]
    #[pyo3(
        signature = (
            *, target, position = None, pixel_tangent = None, direction = None, pixel_km = None,
            points = None, directions = None, size = None, shift = None,
        ),
        text_signature = "(*, target, position=None, pixel_tangent=None, direction=None, \
                          pixel_km=None, points=None, directions=None, size=(32, 32), \
                          shift=(0.0, 0.0))",
    )]
    // In Python these are keyword arguments with defaults.
    #[allow(clippy::too_many_arguments)]
    fn new(
        target: &Bound<'_, PyAny>,
        position: Option<&Bound<'_, PyAny>>,
        pixel_tangent: Option<f64>,
        direction: Option<&Bound<'_, PyAny>>,
        pixel_km: Option<f64>,
        points: Option<&Bound<'_, PyAny>>,
        directions: Option<&Bound<'_, PyAny>>,
        size: Option<&Bound<'_, PyAny>>,
        shift: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        if let (Some(points), Some(directions), None, None) = (points, directions, size, shift) {
            return Self::lines_of_sight(points, directions, Some(target));
        }
        let (target, size) = (point(target, "target")?, size_of(size)?);
        let view = match (position, pixel_tangent, direction, pixel_km) {
            (Some(position), Some(tangent), None, None) => {
                scene::View::perspective(point(position, "position")?, target, tangent, size)
            }
            (None, None, Some(direction), Some(pixel_km)) => {
                let direction = point(direction, "direction")?;
                parallel(direction, target, pixel_km, size)
            }
            _ => {
                let problem = "give position and pixel_tangent, direction and pixel_km, or points and \
                               directions alone";
                return Err(PyTypeError::new_err(problem));
            }
        };
        let shift = shift.map(|shift| reals(shift, "shift", PIXELS)).transpose()?;
        view.and_then(|view| view.with_shift(shift.unwrap_or_default())).map(Self).map_err(raise)
    }

    /// A pinhole camera at `position` (km) that points at `target` (km). The image has `size`
    /// (rows, cols) pixels; `pixel_tangent` is the pixel size divided by the focal length.
    #[staticmethod]
    #[pyo3(
        signature = (position, target, pixel_tangent, size = None),
        text_signature = "(position, target, pixel_tangent, size=(32, 32))",
    )]
    fn perspective(
        position: &Bound<'_, PyAny>,
        target: &Bound<'_, PyAny>,
        pixel_tangent: f64,
        size: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let (position, target) = (point(position, "position")?, point(target, "target")?);
        scene::View::perspective(position, target, pixel_tangent, size_of(size)?)
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
        signature = (zenith_deg, azimuth_deg, target, pixel_km, size = None, *, looks_up = false),
        text_signature = "(zenith_deg, azimuth_deg, target, pixel_km, size=(32, 32), *, \
                          looks_up=False)",
    )]
    fn orthographic(
        zenith_deg: f64,
        azimuth_deg: f64,
        target: &Bound<'_, PyAny>,
        pixel_km: f64,
        size: Option<&Bound<'_, PyAny>>,
        looks_up: bool,
    ) -> PyResult<Self> {
        let towards = towards(zenith_deg.to_radians(), azimuth_deg.to_radians());
        let view = if looks_up { scene::View::looking_up } else { scene::View::orthographic };
        view(towards, point(target, "target")?, pixel_km, size_of(size)?).map(Self).map_err(raise)
    }

    /// An instrument with a line of sight for each pixel, such as a scanner, whose position changes along the
    /// image. `points` [row, col, 3] (km) are on the lines of sight of the pixel centres, and `directions`
    /// [row, col, 3] point from there to the instrument, which is above the scene. Rows go northwards and
    /// columns eastwards. `target` (km) is by default the point of the middle of the image.
    #[staticmethod]
    #[pyo3(signature = (points, directions, target = None))]
    fn lines_of_sight(
        points: &Bound<'_, PyAny>,
        directions: &Bound<'_, PyAny>,
        target: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let (points, directions) = (vectors(points, "points")?, vectors(directions, "directions")?);
        let target = target.map(|target| point(target, "target")).transpose()?;
        let view = scene::LinesOfSight::new(&points, &directions)
            .and_then(|lines| scene::View::lines_of_sight(Arc::new(lines)));
        view.and_then(|view| target.map_or(Ok(view.clone()), |target| view.aimed_at(target)))
            .map(Self)
            .map_err(raise)
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

    /// Pixel size divided by the focal length; None for a camera at infinity.
    #[getter]
    fn pixel_tangent(&self) -> Option<f64> {
        match self.0.projection {
            scene::Projection::Perspective { pixel_tangent, .. } => Some(pixel_tangent),
            _ => None,
        }
    }

    /// Points (km) on the lines of sight of the pixel centres: numpy.ndarray, float64, [row, col, 3]; None
    /// for cameras.
    #[getter]
    fn points<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray3<f64>>> {
        self.0.pixel_lines().map(|[points, _]| components(&points).into_pyarray(py))
    }

    /// Vectors from these points to the instrument with a vertical component of 1: numpy.ndarray, float64,
    /// [row, col, 3]; None for cameras.
    #[getter]
    fn directions<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray3<f64>>> {
        self.0.pixel_lines().map(|[_, directions]| components(&directions).into_pyarray(py))
    }

    /// Unit vector from the target towards the camera.
    #[getter]
    fn direction(&self) -> Point {
        self.0.towards().into()
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

    /// The view of a larger image of `size` pixels, of which this one is the part that begins at the
    /// pixel `first`; the inverse of `part`.
    fn enlarged(&self, first: &Bound<'_, PyAny>, size: &Bound<'_, PyAny>) -> PyResult<Self> {
        let (first, size) = (sizes(first, "first", PIXELS)?, sizes(size, "size", PIXELS)?);
        self.0.enlarged(first, size).map(Self).map_err(raise)
    }

    /// The view of a part of the image: `size` (rows, cols) pixels from the pixel `first` (row, col).
    /// It belongs to `image[first[0]:first[0] + size[0], first[1]:first[1] + size[1]]`.
    fn part(&self, first: &Bound<'_, PyAny>, size: &Bound<'_, PyAny>) -> PyResult<Self> {
        let (first, size) = (sizes(first, "first", PIXELS)?, sizes(size, "size", PIXELS)?);
        self.0.part(first, size).map(Self).map_err(raise)
    }

    /// Project a point (km) onto the image. Returns continuous (row, col) coordinates, in which
    /// pixel `[r, c]` spans `r..r+1, c..c+1`, or None for a point behind the camera.
    fn project(&self, point: &Bound<'_, PyAny>) -> PyResult<Option<(f64, f64)>> {
        Ok(self.0.project(crate::number::point(point, "point")?))
    }

    /// Origin (km) and unit direction of the line of sight through a point of the image (continuous
    /// row and col). The direction is from the camera into the scene.
    fn ray(&self, row: f64, col: f64) -> (Point, Point) {
        let ray = self.0.ray(row, col);
        (ray.origin.into(), ray.direction.into())
    }
}

/// The vectors of an array [row, col, 3].
fn vectors(object: &Bound<'_, PyAny>, name: &str) -> PyResult<Array2<DVec3>> {
    let numpy = object.py().import("numpy")?;
    let array = numpy.call_method1("ascontiguousarray", (object, "float64"))?;
    let shape: Vec<usize> = array.getattr("shape")?.extract()?;
    let [rows, cols, 3] = shape[..] else {
        let problem = format!("{name} has shape {shape:?}, but must be [row, col, 3]");
        return Err(PyValueError::new_err(problem));
    };
    let array = array.cast_into::<PyArray3<f64>>()?.try_readonly()?;
    let array = array.as_array();
    Ok(Array2::from_shape_fn((rows, cols), |(row, col)| {
        DVec3::from_array([0, 1, 2].map(|axis| array[[row, col, axis]]))
    }))
}

/// The components of vectors, [row, col, 3].
fn components(vectors: &Array2<DVec3>) -> Array3<f64> {
    let (rows, cols) = vectors.dim();
    Array3::from_shape_fn((rows, cols, 3), |(row, col, axis)| vectors[[row, col]][axis])
}

/// A camera at infinity whose direction, if it is a unit vector, is kept exactly: normalising it again
/// may change it.
fn parallel(
    direction: DVec3,
    target: DVec3,
    pixel_km: f64,
    size: [usize; 2],
) -> deepct_core::Result<scene::View> {
    let view = match direction.z < 0.0 {
        true => scene::View::looking_up(direction, target, pixel_km, size)?,
        false => scene::View::orthographic(direction, target, pixel_km, size)?,
    };
    if !direction.is_normalized() {
        return Ok(view);
    }
    let projection = scene::Projection::Orthographic { towards: direction, pixel_km };
    Ok(scene::View { projection, ..view })
}

/// The camera geometry of a stack of images: a sequence of `View`.
///
/// Parameters
/// ----------
/// views : sequence of View
///     One view for each image, at least one.
///
/// Examples
/// --------
/// >>> views = deepct_py.Views.load("cloudct-10", target=(0.8, 0.8, 1.12))
/// >>> len(views), len(views[2:5] + views[:1])
/// (10, 4)
/// >>> views.position.shape
/// (10, 3)
#[pyclass(frozen, sequence, from_py_object, module = "deepct_py")]
#[derive(Clone)]
pub(crate) struct Views(pub(crate) Vec<scene::View>);

record!(Views);

impl Record for Views {
    fn arguments<'py>(of: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        let views = of.get().0.iter().map(|view| View(view.clone()));
        let arguments = PyDict::new(of.py());
        arguments.set_item("views", PyList::new(of.py(), views.collect::<Vec<_>>())?)?;
        Ok(arguments)
    }
}

#[pymethods]
impl Views {
    #[new]
    fn new(views: Vec<View>) -> PyResult<Self> {
        Self::of(views.into_iter().map(|view| view.0).collect())
    }

    /// Load the views of a formation, either by its name, `"cloudct-10"` or `"pearls-32"` (cameras
    /// 600 km above the target with pixels of 50 m at nadir), or from a TOML file, whose format is
    /// described by `deepct render --help`.
    ///
    /// The cameras point at `target` (km) and take images of `size` (rows, cols) pixels, unless the
    /// file specifies other values.
    #[staticmethod]
    #[pyo3(
        signature = (name_or_path, target, size = None),
        text_signature = "(name_or_path, target, size=(32, 32))",
    )]
    fn load(
        name_or_path: PathBuf,
        target: &Bound<'_, PyAny>,
        size: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        Self::find(&name_or_path, point(target, "target")?, size_of(size)?)
    }

    /// The views of the images in a data set of xarray with the variables of a file of images.
    #[staticmethod]
    fn from_dataset(dataset: &Bound<'_, PyAny>) -> PyResult<Self> {
        views_of(dataset)
    }

    /// The views of a string-of-pearls formation: satellites at equal distances on one orbit, with
    /// satellite number 0 at the zenith of the target.
    ///
    /// Parameters
    /// ----------
    /// target : (float, float, float)
    ///     The point at which all cameras are pointed (km).
    /// altitude_km : float
    ///     Altitude of the orbit (km).
    /// arc_km : float
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
            target, altitude_km = 600.0, arc_km = 100.0, first = None, last = None,
            *, track_azimuth_deg = 0.0, pixel_km = 0.05, size = None,
        ),
        text_signature = "(target, altitude_km=600.0, arc_km=100.0, first=-16, last=15, *, \
                          track_azimuth_deg=0.0, pixel_km=0.05, size=(32, 32))",
    )]
    // In Python these are keyword arguments with defaults.
    #[allow(clippy::too_many_arguments)]
    fn string_of_pearls(
        target: &Bound<'_, PyAny>,
        altitude_km: f64,
        arc_km: f64,
        first: Option<&Bound<'_, PyAny>>,
        last: Option<&Bound<'_, PyAny>>,
        track_azimuth_deg: f64,
        pixel_km: f64,
        size: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let first: i32 = first.map_or(Ok(-16), |first| whole(first, "first"))?;
        let last: i32 = last.map_or(Ok(15), |last| whole(last, "last"))?;
        let formation =
            scene::Formation::string_of_pearls(altitude_km, arc_km, first..=last).map_err(raise)?;
        let track_azimuth = track_azimuth_deg.to_radians();
        scene::Formation { track_azimuth, pixel_km, ..formation }
            .views(point(target, "target")?, size_of(size)?)
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

    /// The point at which each camera is pointed (km): numpy.ndarray, float64, [view, 3].
    #[getter]
    fn target<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        self.vectors(py, |view| view.target)
    }

    /// Position of each camera (km): numpy.ndarray, float64, [view, 3]; NaN for cameras at infinity.
    #[getter]
    fn position<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        self.vectors(py, |view| match view.projection {
            scene::Projection::Perspective { position, .. } => position,
            _ => DVec3::NAN,
        })
    }

    /// Unit vector from the target towards each camera: numpy.ndarray, float64, [view, 3].
    #[getter]
    fn direction<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        self.vectors(py, scene::View::towards)
    }

    /// Number of rows and columns of each image.
    #[getter]
    fn size(&self) -> Vec<(usize, usize)> {
        self.0.iter().map(|view| (view.rows, view.cols)).collect()
    }

    fn __len__(&self) -> usize {
        self.0.len()
    }

    fn __iter__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyIterator>> {
        let views = self.0.iter().map(|view| View(view.clone()));
        PyTuple::new(py, views.collect::<Vec<_>>())?.try_iter()
    }

    fn __getitem__<'py>(&self, index: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let py = index.py();
        if let Ok(slice) = index.cast::<PySlice>() {
            let count = self.0.len() as isize;
            let indices = slice.indices(count)?;
            let chosen = (0..indices.slicelength as isize)
                .map(|step| self.0[(indices.start + step * indices.step) as usize].clone());
            return Ok(Bound::new(py, Self::of(chosen.collect())?)?.into_any());
        }
        let index: i64 = index.extract()?;
        let wrapped = if index < 0 { index + self.0.len() as i64 } else { index };
        let view = usize::try_from(wrapped).ok().and_then(|index| self.0.get(index));
        let view =
            view.ok_or_else(|| PyIndexError::new_err(format!("there is no view {index}")))?;
        Ok(Bound::new(py, View(view.clone()))?.into_any())
    }

    fn __add__(&self, other: ViewSequence) -> Self {
        Self([&self.0[..], &other.0].concat())
    }

    fn __radd__(&self, other: ViewSequence) -> Self {
        Self([&other.0[..], &self.0].concat())
    }
}

impl Views {
    fn of(views: Vec<scene::View>) -> PyResult<Self> {
        if views.is_empty() {
            return Err(raise(Error::out_of_range("number of views", 0, "at least 1")));
        }
        Ok(Self(views))
    }

    /// The views of a formation, by its name or file.
    pub(crate) fn find(name_or_path: &Path, target: DVec3, size: [usize; 2]) -> PyResult<Self> {
        scene::ViewList::find(&name_or_path.to_string_lossy())
            .and_then(|list| list.views(target, size))
            .map(Self)
            .map_err(raise)
    }

    fn each<'py>(
        &self,
        py: Python<'py>,
        number: impl Fn(&scene::View) -> f64,
    ) -> Bound<'py, PyArray1<f64>> {
        self.0.iter().map(number).collect::<Array1<_>>().into_pyarray(py)
    }

    fn vectors<'py>(
        &self,
        py: Python<'py>,
        vector: impl Fn(&scene::View) -> DVec3,
    ) -> Bound<'py, PyArray2<f64>> {
        let vectors: Vec<DVec3> = self.0.iter().map(vector).collect();
        Array2::from_shape_fn((vectors.len(), 3), |(view, axis)| vectors[view][axis])
            .into_pyarray(py)
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
        let views: Vec<View> = object.extract().map_err(|_| {
            let found = object.get_type();
            PyTypeError::new_err(format!(
                "views must be Views or a sequence of View, not {found}; for images that are an \
                 Observation, give the further arguments by their names"
            ))
        })?;
        Views::new(views).map(|views| Self(views.0))
    }
}
