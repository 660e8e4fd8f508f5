//! Stacks of images, and the numbers that say how they were taken.

use crate::error::{Error, Result};
use ndarray::{Array3, ArrayView2, Axis};
use serde::{Deserialize, Serialize};

/// One image: radiance by pixel (1/sr), array `[row, col]`, row to the north and
/// column to the east.
pub type Image<'a> = ArrayView2<'a, f32>;

/// The images of one scene by several views, all of one size.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewStack {
    /// Radiance (1/sr), `[view, row, col]`.
    pub values: Array3<f32>,
}

impl ViewStack {
    /// A stack from its values.
    ///
    /// # Errors
    /// When an axis is empty or a value is not finite.
    pub fn new(values: Array3<f32>) -> Result<Self> {
        if values.is_empty() {
            return Err(Error::out_of_range(
                "image stack shape [view, row, col]",
                format!("{:?}", values.shape()),
                "at least 1 along every axis",
            ));
        }
        if let Some(((view, row, col), value)) =
            values.indexed_iter().find(|(_, value)| !value.is_finite())
        {
            return Err(Error::out_of_range(
                "radiance",
                format!("{value} at [view {view}, row {row}, col {col}]"),
                "finite",
            ));
        }
        Ok(Self { values })
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

    /// The brightest pixel over all views (1/sr).
    pub fn brightest(&self) -> f32 {
        self.values.iter().copied().fold(f32::NEG_INFINITY, f32::max)
    }
}

/// The geometry of a stack of images in plain numbers: what weights are trained for
/// and what images must match to be used with them.
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
    /// Size of a pixel at the target, by view (km): square-on to the line of sight of a
    /// camera at a distance, in the horizontal plane for parallel rays.
    pub pixel_km: Vec<f64>,
    /// Distance of each camera from the target (km); none for parallel rays. Empty where it
    /// is not known.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub camera_distance_km: Vec<Option<f64>>,
}

/// How a stack of images was taken: what a network compares with what it was trained for.
#[derive(Debug, Clone, PartialEq)]
pub struct ImagingGeometry {
    /// Angles of the Sun and the cameras, sizes of pixels.
    pub views: ViewGeometry,
    /// The point x, y, z (km) that the middle of every image shows.
    pub target_km: [f64; 3],
    /// Wavelength (um).
    pub wavelength_um: f64,
}
