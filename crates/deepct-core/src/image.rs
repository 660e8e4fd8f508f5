//! Stacks of images and the description of their geometry.

mod fill;

use crate::error::{Error, Result};
use fill::{fill, share_in_gaps};
use ndarray::{Array2, Array3, ArrayView2, Axis, s};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// One image: the radiance of each pixel (1/sr), array `[row, col]`. Rows increase to the north and
/// columns to the east.
pub type Image<'a> = ArrayView2<'a, f32>;

/// The images of one scene from several views, all of the same size.
#[derive(Debug, Clone)]
pub struct ViewStack {
    /// Radiance (1/sr), `[view, row, col]`; NaN for a pixel that is missing.
    pub values: Array3<f32>,
}

impl PartialEq for ViewStack {
    /// Whether all values are equal; missing pixels equal each other.
    fn eq(&self, other: &Self) -> bool {
        let same = |(one, other): (&f32, &f32)| one == other || (one.is_nan() && other.is_nan());
        self.shape() == other.shape() && self.values.iter().zip(&other.values).all(same)
    }
}

impl ViewStack {
    /// Creates a stack without missing pixels from its values.
    ///
    /// # Errors
    /// An empty axis or a value that is not finite.
    pub fn new(values: Array3<f32>) -> Result<Self> {
        Self::checked(values, "radiance", f32::is_finite, "finite")
    }

    /// Creates a stack from values that are NaN for missing pixels.
    ///
    /// # Errors
    /// An empty axis or an infinite value.
    pub fn with_missing(values: Array3<f32>) -> Result<Self> {
        Self::checked(
            values,
            "radiance",
            |value| !value.is_infinite(),
            "finite, or NaN where missing",
        )
    }

    /// Creates a stack of images of different sizes. The smaller ones are in the middle of missing pixels;
    /// if the difference is odd, there is one more of them after the image than before it.
    ///
    /// # Errors
    /// As [`ViewStack::with_missing`].
    pub fn of_images(images: &[Array2<f32>]) -> Result<Self> {
        let most = |axis: usize| images.iter().map(|image| image.shape()[axis]).max().unwrap_or(0);
        let mut values = Array3::from_elem((images.len(), most(0), most(1)), f32::NAN);
        for (image, mut whole) in images.iter().zip(values.outer_iter_mut()) {
            let (rows, cols) = image.dim();
            let [row, col] = first_of_padded([rows, cols], [whole.nrows(), whole.ncols()]);
            whole.slice_mut(s![row..row + rows, col..col + cols]).assign(image);
        }
        Self::with_missing(values)
    }

    /// Creates a stack of the standard errors of images (1/sr). The standard error of a pixel that is
    /// left out, because it is saturated or defective, is infinite.
    ///
    /// # Errors
    /// An empty axis, a negative value or one that is not a number.
    pub fn of_errors(values: Array3<f32>) -> Result<Self> {
        let range = "0 or more (1/sr), or infinite to leave a pixel out";
        Self::checked(values, "standard error", |error| error >= 0.0, range)
    }

    fn checked(
        values: Array3<f32>,
        name: &'static str,
        is_valid: impl Fn(f32) -> bool,
        range: &str,
    ) -> Result<Self> {
        if values.is_empty() {
            return Err(Error::out_of_range(
                "image stack shape [view, row, col]",
                format!("{:?}", values.shape()),
                "at least 1 along every axis",
            ));
        }
        match values.indexed_iter().find(|(_, value)| !is_valid(**value)) {
            None => Ok(Self { values }),
            Some(((view, row, col), value)) => {
                let found = format!("{value} at [view {view}, row {row}, col {col}]");
                Err(Error::out_of_range(name, found, range))
            }
        }
    }

    /// Number of views, rows and columns.
    pub fn shape(&self) -> [usize; 3] {
        let (views, rows, cols) = self.values.dim();
        [views, rows, cols]
    }

    /// The image of one view.
    pub fn image(&self, view: usize) -> Image<'_> {
        self.values.index_axis(Axis(0), view)
    }

    /// Whether each pixel is missing.
    pub fn missing(&self) -> Array3<bool> {
        self.values.mapv(f32::is_nan)
    }

    /// Whether no pixel of a view is known.
    pub fn is_empty(&self, view: usize) -> bool {
        self.image(view).iter().all(|value| value.is_nan())
    }

    /// The images with missing pixels interpolated from the known ones of the same view, such that each
    /// has the mean of its neighbours (a discrete harmonic function). Beyond the last known pixels, their
    /// values continue. A view without known pixels becomes 0.
    pub fn filled(&self) -> Cow<'_, Self> {
        if !self.values.iter().any(|value| value.is_nan()) {
            return Cow::Borrowed(self);
        }
        let mut filled = self.clone();
        filled.values.outer_iter_mut().for_each(fill);
        Cow::Owned(filled)
    }

    /// The share of the pixels that are missing in gaps of the images: without a known pixel within two
    /// rows and columns. Missing rows and columns at the edges are no gaps, but make an image smaller.
    pub fn share_in_gaps(&self) -> f64 {
        let shares = self.values.outer_iter().map(share_in_gaps);
        shares.sum::<f64>() / self.values.len_of(Axis(0)) as f64
    }

    /// The largest radiance in all views (1/sr).
    pub fn brightest(&self) -> f32 {
        self.values.iter().copied().fold(f32::NEG_INFINITY, f32::max)
    }
}

/// The first row and column of an image of `size` rows and columns in the middle of a larger one, see
/// [`ViewStack::of_images`].
pub fn first_of_padded(size: [usize; 2], whole: [usize; 2]) -> [usize; 2] {
    [0, 1].map(|axis| (whole[axis] - size[axis]) / 2)
}

/// The imaging geometry of a stack of images in numbers. Network weights are trained for one such
/// geometry, and the images they are applied to must match it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ViewGeometry {
    /// Angle at the scene between +z and the Sun (degrees).
    pub sun_zenith_deg: f64,
    /// Azimuth towards the Sun, clockwise from north (degrees).
    pub sun_azimuth_deg: f64,
    /// Angle at the scene between +z and each satellite (degrees, not negative).
    pub view_zenith_deg: Vec<f64>,
    /// Azimuth towards each satellite, clockwise from north (degrees).
    pub view_azimuth_deg: Vec<f64>,
    /// Pixel size at the target for each view (km): perpendicular to the line of sight for a camera
    /// at a finite distance, in the horizontal plane for parallel rays.
    pub pixel_km: Vec<f64>,
    /// Distance of each camera from the target (km); `None` for parallel rays. Empty if the
    /// distances are not known.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub camera_distance_km: Vec<Option<f64>>,
}

/// The conditions under which a stack of images was taken; a network compares them with those of
/// its training.
#[derive(Debug, Clone, PartialEq)]
pub struct ImagingGeometry {
    /// Angles of the Sun and of the cameras, and pixel sizes.
    pub views: ViewGeometry,
    /// The point x, y, z (km) that all images show, at their centres unless they are shifted.
    pub target_km: [f64; 3],
    /// Position of the centre of each image relative to the target, `[row, col]` (pixels); empty if
    /// the target is at the centre of every image.
    pub shifts: Vec<[f64; 2]>,
    /// Wavelength (um).
    pub wavelength_um: f64,
    /// Solar irradiance in the unit of the radiances times sr; networks are trained for 1.
    pub solar_irradiance: f64,
}

impl ImagingGeometry {
    /// The geometry of some of the views.
    pub fn of_views(&self, chosen: &[usize]) -> Self {
        fn some<T: Clone>(all: &[T], chosen: &[usize]) -> Vec<T> {
            chosen.iter().filter_map(|view| all.get(*view).cloned()).collect()
        }
        let views = ViewGeometry {
            view_zenith_deg: some(&self.views.view_zenith_deg, chosen),
            view_azimuth_deg: some(&self.views.view_azimuth_deg, chosen),
            pixel_km: some(&self.views.pixel_km, chosen),
            camera_distance_km: some(&self.views.camera_distance_km, chosen),
            ..self.views
        };
        Self { views, shifts: some(&self.shifts, chosen), ..self.clone() }
    }

    /// The horizontal position (x, y; km) of the middle of the images, with pixels as wide as the
    /// smallest: that of the target unless the images are shifted.
    pub fn middle_km(&self) -> [f64; 2] {
        let [x, y, _] = self.target_km;
        let pixel = self.views.pixel_km.iter().copied().fold(f64::INFINITY, f64::min);
        let count = self.shifts.len().max(1) as f64;
        let mean = |axis: usize| self.shifts.iter().map(|shift| shift[axis]).sum::<f64>() / count;
        let [north, east] = [0, 1].map(|axis| match mean(axis) {
            0.0 => 0.0,
            shift => shift * pixel,
        });
        [x + east, y + north]
    }
}
