//! The picture of a cloud that an oblique camera takes.

use crate::global::Global;
use crate::progress::RenderProgress;
use deepct_core::Result;
use deepct_core::grid::Volume;
use deepct_core::math::{DVec3, towards};
use deepct_core::scene::{Light, Sun, View};
use deepct_core::transport::{OrdinatesSettings, Solver, render};
use ndarray::{Array2, s};

/// Numbers of rows and columns.
const SIZE: [usize; 2] = [240, 320];
/// Zenith angle of the camera (radians).
const ZENITH: f64 = 1.1;
/// Distance of the camera in units of the size of the picture.
const DISTANCE: f64 = 5.0;
/// Share of the picture that the cloud and its shadow fill.
const FILLED: f64 = 0.8;
/// Share of the largest extinction from which a voxel belongs to the subject of the picture.
const VISIBLE: f32 = 0.02;

/// A picture, with the zenith at the top.
pub(crate) struct Photograph {
    /// Radiances, with the first row at the top.
    pub(crate) picture: Array2<f32>,
    /// Where the camera is.
    pub(crate) from: &'static str,
}

/// The radiances of `volume` for a camera that is pointed at `subject` and its shadow, on the side
/// from which the Sun shines.
///
/// # Errors
/// A volume that is too large for the memory; an interruption.
pub(crate) fn photograph(
    volume: &Volume,
    subject: &Volume,
    light: &Light,
    global: &Global,
) -> Result<Photograph> {
    let scene = light.scene_of(volume.clone())?;
    // Images have north at the top. A camera in the south therefore sees the zenith at the top,
    // and one in the north at the bottom.
    let is_in_north = light.sun.azimuth.cos() > 0.0;
    let azimuth = if is_in_north { 0.0 } else { std::f64::consts::PI };
    let view = camera(subject, &light.sun, azimuth)?;
    let solver = Solver::Ordinates(OrdinatesSettings::default());
    let rendering = render(&scene, &[view], &solver, &RenderProgress::start(global, "photograph"))?;
    let image = rendering.images.image(0);
    let picture = if is_in_north { image.slice(s![.., ..;-1]) } else { image.slice(s![..;-1, ..]) };
    Ok(Photograph {
        picture: picture.to_owned(),
        from: if is_in_north { "north" } else { "south" },
    })
}

/// The camera at an azimuth that sees a cloud and its shadow on the surface.
fn camera(subject: &Volume, sun: &Sun, azimuth: f64) -> Result<View> {
    let (lower, upper) = bounds(subject);
    let sunlight = sun.towards();
    let corners = (0..8_usize).map(|bits| {
        let side = DVec3::new((bits & 1) as f64, (bits >> 1 & 1) as f64, (bits >> 2) as f64);
        lower + side * (upper - lower)
    });
    let points: Vec<DVec3> =
        corners.flat_map(|point| [point, point - point.z / sunlight.z * sunlight]).collect();
    let direction = towards(ZENITH, azimuth);
    let up = direction.cross(DVec3::X);
    // The smallest and the largest coordinate of the points in the picture along an axis.
    let range = |axis: DVec3| {
        let places = points.iter().map(|point| point.dot(axis));
        places.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), place| {
            (low.min(place), high.max(place))
        })
    };
    let (across, along) = (range(DVec3::X), range(up));
    let middle = |(low, high): (f64, f64)| 0.5 * (low + high);
    let depth = 0.5 * (lower + upper).dot(direction);
    let target = middle(across) * DVec3::X + middle(along) * up + depth * direction;
    let [rows, cols] = SIZE.map(|n| n as f64);
    let pixel = ((along.1 - along.0) / rows).max((across.1 - across.0) / cols) / FILLED;
    let distance = DISTANCE * pixel * cols;
    View::perspective(target + distance * direction, target, pixel / distance, SIZE)
}

/// The corners of the smallest box with all visible voxels; those of the grid if there are none.
fn bounds(volume: &Volume) -> (DVec3, DVec3) {
    let least = VISIBLE * volume.values.iter().copied().fold(0.0, f32::max);
    let visible = volume.values.indexed_iter().filter(|(_, value)| **value > least);
    let centers = visible.map(|((k, j, i), _)| volume.grid.voxel_center([k, j, i]));
    let half = 0.5 * volume.grid.spacing;
    centers
        .map(|center| (center - half, center + half))
        .reduce(|(low, high), (lower, upper)| (low.min(lower), high.max(upper)))
        .unwrap_or((volume.grid.lower(), volume.grid.upper()))
}
