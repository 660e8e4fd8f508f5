//! Metadata of weights: the imaging conditions that images must match, and the origin of the
//! weights.

use super::{Architecture, ImageLayout};
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::image::{ImagingGeometry, ViewGeometry};
use crate::math::DVec3;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The version of the metadata that this program writes. It also reads earlier versions: version 1
/// had neither planes nor camera distances; version 2 had no outputs other than the extinction.
pub const FORMAT_VERSION: u32 = 3;

/// Largest accepted difference of a direction of view or of the Sun from that of the weights
/// (degrees).
const ANGLE_TOLERANCE_DEG: f64 = 0.1;
/// Largest accepted relative difference of the pixel size and of the wavelength.
const RELATIVE_TOLERANCE: f64 = 0.01;
/// Largest accepted difference of the altitude of the target, in levels.
const LEVEL_TOLERANCE: f64 = 0.1;
/// Largest accepted relative difference of the distance of a camera. It displaces the edges of a
/// field of 6 km by 1/50 of a pixel.
const DISTANCE_TOLERANCE: f64 = 0.1;

/// The possible outputs of the last layer, in this order; the first one is mandatory.
const OUTPUTS: [NetworkOutput; 2] = [NetworkOutput::Extinction, NetworkOutput::Uncertainty];

/// Metadata of weights: the imaging conditions, the use of the network and the origin of the
/// weights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WeightsMetadata {
    /// [`FORMAT_VERSION`] or an earlier version.
    pub format_version: u32,
    /// Name of the satellite formation, such as `cloudct-10`.
    pub formation: String,
    /// The architecture of the network.
    pub architecture: Architecture,
    /// Directions of the Sun and the views, and pixel sizes.
    pub view_geometry: ViewGeometry,
    /// Altitude of the point at the centre of every image (km).
    pub target_altitude_km: f64,
    /// Wavelength of the images (um).
    pub wavelength_um: f64,
    /// Arrangement of the images as input channels of the first layer.
    pub image_layout: ImageLayout,
    /// Voxel size along x and y (km); one pixel of the output is one column of voxels.
    pub horizontal_spacing_km: [f64; 2],
    /// The altitudes of the output.
    pub levels: Levels,
    /// The outputs of the last layer, each with one channel for every level.
    #[serde(default = "extinction_alone")]
    pub outputs: Vec<NetworkOutput>,
    /// Input of the network = radiance (1/sr) x `input_scale`.
    pub input_scale: f64,
    /// Outputs (1/km) = output of the network x `output_scale`.
    pub output_scale: f64,
    /// The training data.
    pub training: Training,
    /// Scores by name; `epsilon` and `delta` on the validation set.
    pub scores: BTreeMap<String, f64>,
    /// Name and version of the program that wrote the file.
    pub program: String,
    /// The complete configuration of the training.
    pub configuration: serde_json::Value,
}

/// An output of the network for each voxel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum NetworkOutput {
    /// The extinction (1/km).
    Extinction,
    /// The expected absolute error of the extinction (1/km).
    Uncertainty,
}

impl NetworkOutput {
    /// The name of the output in a file.
    pub fn name(self) -> &'static str {
        match self {
            Self::Extinction => "extinction",
            Self::Uncertainty => "uncertainty",
        }
    }
}

fn extinction_alone() -> Vec<NetworkOutput> {
    vec![NetworkOutput::Extinction]
}

/// The altitudes of the output: channel `k` is the mean over
/// `bottom_km + k * spacing_km` to `bottom_km + (k + 1) * spacing_km`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Levels {
    /// Altitude of the bottom of the lowest level (km).
    pub bottom_km: f64,
    /// Number of levels.
    pub count: usize,
    /// Height of a level (km).
    pub spacing_km: f64,
}

/// The training data of weights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Training {
    /// Name of the data set.
    pub data: String,
    /// The SHA-256 of the manifest of the data set, which identifies its content.
    pub identity: String,
    /// Number of training samples.
    pub samples: u64,
    /// Seed of the random numbers of the training.
    pub seed: u64,
}

impl WeightsMetadata {
    /// Returns an error unless the values are in range and consistent with each other.
    ///
    /// # Errors
    /// An unknown format version; an angle, scale or spacing out of range; a list whose length
    /// differs from the number of views; numbers of channels or outputs that are inconsistent.
    pub fn check(&self) -> Result<()> {
        if !(1..=FORMAT_VERSION).contains(&self.format_version) {
            return Err(Error::mismatch(
                "format_version of the weights",
                format!("1 to {FORMAT_VERSION}"),
                self.format_version,
                "use the version of deepct that the weights were written for",
            ));
        }
        self.check_numbers()?;
        self.check_counts()?;
        self.check_layout()
    }

    fn check_numbers(&self) -> Result<()> {
        let positive = [
            ("input_scale", self.input_scale),
            ("output_scale", self.output_scale),
            ("wavelength_um", self.wavelength_um),
            ("horizontal_spacing_km", self.horizontal_spacing_km[0]),
            ("horizontal_spacing_km", self.horizontal_spacing_km[1]),
            ("levels.spacing_km", self.levels.spacing_km),
        ];
        let geometry = &self.view_geometry;
        let pixels = geometry.pixel_km.iter().map(|&size| ("view_geometry.pixel_km", size));
        let distances = geometry.camera_distance_km.iter().flatten();
        let distances = distances.map(|&distance| ("camera_distance_km", distance));
        for (name, value) in positive.into_iter().chain(pixels).chain(distances) {
            if !(value.is_finite() && value > 0.0) {
                return Err(Error::out_of_range(name, value, "positive and finite"));
            }
        }
        let azimuths = geometry.view_azimuth_deg.iter().map(|&a| ("view_azimuth_deg", a));
        let finite = [
            ("target_altitude_km", self.target_altitude_km),
            ("levels.bottom_km", self.levels.bottom_km),
            ("sun_azimuth_deg", geometry.sun_azimuth_deg),
        ];
        for (name, value) in finite.into_iter().chain(azimuths) {
            if !value.is_finite() {
                return Err(Error::out_of_range(name, value, "finite"));
            }
        }
        let views = geometry.view_zenith_deg.iter().map(|&zenith| ("view_zenith_deg", zenith));
        for (name, value) in views.chain([("sun_zenith_deg", geometry.sun_zenith_deg)]) {
            if !(0.0..90.0).contains(&value) {
                return Err(Error::out_of_range(name, value, "in [0, 90) degrees"));
            }
        }
        Ok(())
    }

    fn check_counts(&self) -> Result<()> {
        let channels = &self.architecture.channels;
        if channels.len() < 2 || channels.contains(&0) {
            let range = "at least two numbers, none of them 0";
            return Err(Error::out_of_range(
                "architecture.channels",
                format!("{channels:?}"),
                range,
            ));
        }
        if ![&OUTPUTS[..1], &OUTPUTS[..]].contains(&&self.outputs[..]) {
            let found = format!("{:?}", self.outputs);
            let range = "[\"extinction\"] or [\"extinction\", \"uncertainty\"]";
            return Err(Error::out_of_range("outputs", found, range));
        }
        let levels = channels[channels.len() - 1];
        let (views, geometry) = (self.views(), &self.view_geometry);
        for (what, expected, found) in [
            ("number of channels of the images", channels[0], self.input_channels()),
            ("length of view_geometry.view_azimuth_deg", views, geometry.view_azimuth_deg.len()),
            ("length of view_geometry.pixel_km", views, geometry.pixel_km.len()),
            (
                "levels.count by the number of outputs",
                levels,
                self.outputs.len() * self.levels.count,
            ),
        ] {
            if expected != found {
                let remedy = "make the metadata fit the first and last of architecture.channels";
                return Err(Error::mismatch(what, expected, found, remedy));
            }
        }
        Ok(())
    }

    /// Returns an error unless the weights are valid for images taken under these conditions.
    ///
    /// Zenith angles may differ by 0.1 degrees, and azimuths by as much as displaces the line of
    /// sight by 0.1 degrees; pixel sizes and the wavelength by 1 %; the altitude of the target by a
    /// tenth of a level; the distance of a camera, if the weights specify it, by 10 %.
    ///
    /// # Errors
    /// An [`Error::Mismatch`] with the first quantity that differs, its expected and its actual
    /// value.
    pub fn check_images(&self, taken: &ImagingGeometry) -> Result<()> {
        let ImagingGeometry { views: geometry, target_km: [.., altitude], wavelength_um, .. } =
            taken;
        let ours = &self.view_geometry;
        let (expected, found) = (ours.view_zenith_deg.len(), geometry.view_zenith_deg.len());
        if expected != found {
            return Err(self.differs("number of views".into(), expected, found));
        }
        let sun = |g: &ViewGeometry| (g.sun_zenith_deg, g.sun_azimuth_deg);
        self.check_direction("solar", sun(ours), sun(geometry))?;
        for view in 0..expected {
            let angles = |g: &ViewGeometry| (g.view_zenith_deg[view], g.view_azimuth_deg[view]);
            self.check_direction(&format!("view {view}:"), angles(ours), angles(geometry))?;
            let (expected, found) = (ours.pixel_km[view], geometry.pixel_km[view]);
            if !within(found / expected - 1.0, RELATIVE_TOLERANCE) {
                let what = format!("view {view}: pixel size at the target");
                return Err(self.differs(what, km(expected), km(found)));
            }
        }
        self.check_cameras(&geometry.camera_distance_km)?;
        let climb = altitude - self.target_altitude_km;
        if !within(climb, LEVEL_TOLERANCE * self.levels.spacing_km) {
            let (expected, found) = (km(self.target_altitude_km), km(*altitude));
            return Err(self.differs("altitude of the target".into(), expected, found));
        }
        if !within(wavelength_um / self.wavelength_um - 1.0, RELATIVE_TOLERANCE) {
            let um = |value: f64| format!("{value:.4} um");
            let (expected, found) = (um(self.wavelength_um), um(*wavelength_um));
            return Err(self.differs("wavelength".into(), expected, found));
        }
        Ok(())
    }

    /// The grid of the extinction of a network with these weights for images of `[rows, cols]`
    /// pixels with the point `target` (x and y, km) at their centre: one column of voxels for each
    /// pixel, with the levels of the metadata.
    ///
    /// # Errors
    /// A target that is not finite, an empty image, or one that is too large.
    pub fn grid(&self, target: [f64; 2], [rows, cols]: [usize; 2]) -> Result<Grid> {
        let ([dx, dy], levels) = (self.horizontal_spacing_km, self.levels);
        let west = target[0] - 0.5 * dx * cols as f64;
        let south = target[1] - 0.5 * dy * rows as f64;
        let origin = DVec3::new(west, south, levels.bottom_km);
        Grid::of_any_size(origin, DVec3::new(dx, dy, levels.spacing_km), [levels.count, rows, cols])
    }

    /// Compares the distances of the cameras, if the weights specify them.
    fn check_cameras(&self, theirs: &[Option<f64>]) -> Result<()> {
        for (view, &ours) in self.view_geometry.camera_distance_km.iter().enumerate() {
            let theirs = theirs.get(view).copied().flatten();
            let same = match (ours, theirs) {
                (Some(ours), Some(theirs)) => within(theirs / ours - 1.0, DISTANCE_TOLERANCE),
                (ours, theirs) => ours == theirs,
            };
            if !same {
                let text =
                    |at: Option<f64>| at.map_or("parallel rays".into(), |at| format!("{at:.0} km"));
                let what = format!("view {view}: distance of the camera");
                return Err(self.differs(what, text(ours), text(theirs)));
            }
        }
        Ok(())
    }

    /// Compares a zenith angle and an azimuth (degrees).
    fn check_direction(&self, whose: &str, ours: (f64, f64), theirs: (f64, f64)) -> Result<()> {
        let deg = |value: f64| format!("{value:.2} degrees");
        if !within(ours.0 - theirs.0, ANGLE_TOLERANCE_DEG) {
            return Err(self.differs(format!("{whose} zenith"), deg(ours.0), deg(theirs.0)));
        }
        // Near the zenith, a large change of azimuth is a small change of the line of sight.
        let turn = (theirs.1 - ours.1 + 180.0).rem_euclid(360.0) - 180.0;
        if !within(turn * ours.0.to_radians().sin(), ANGLE_TOLERANCE_DEG) {
            return Err(self.differs(format!("{whose} azimuth"), deg(ours.1), deg(theirs.1)));
        }
        Ok(())
    }

    fn differs(&self, what: String, expected: impl ToString, found: impl ToString) -> Error {
        let remedy = format!(
            "these weights are for the images of \"{}\": give such images, or weights trained \
             for these",
            self.formation
        );
        Error::mismatch(what, expected, found, remedy)
    }
}

/// Whether a difference is within a tolerance; false for NaN.
fn within(difference: f64, tolerance: f64) -> bool {
    difference.abs() <= tolerance
}

fn km(value: f64) -> String {
    format!("{value:.4} km")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::fixture::metadata;

    /// The imaging geometry of views with a target at an altitude (km), at a wavelength (um).
    fn taken(views: &ViewGeometry, altitude: f64, wavelength_um: f64) -> ImagingGeometry {
        ImagingGeometry {
            views: views.clone(),
            target_km: [0.0, 0.0, altitude],
            wavelength_um,
            solar_irradiance: 1.0,
            shifts: Vec::new(),
        }
    }

    #[test]
    fn the_number_that_differs_is_named() {
        let metadata = metadata(&[3, 4]);
        let right = metadata.view_geometry.clone();
        metadata.check_images(&taken(&right, 1.0, 0.672)).unwrap();
        type Change = fn(&mut ViewGeometry);
        let changes: [(Change, &str); 8] = [
            (|g| g.view_zenith_deg[2] += 0.2, "view 2: zenith: expected 6.00 degrees, found 6.20"),
            (|g| g.view_azimuth_deg[1] += 180.0, "view 1: azimuth: expected 10.00 degrees"),
            (|g| g.sun_zenith_deg = 40.0, "solar zenith: expected 30.00 degrees, found 40.00"),
            (|g| g.sun_azimuth_deg = 46.0, "solar azimuth"),
            (|g| g.pixel_km[0] = 0.1, "view 0: pixel size at the target: expected 0.0500 km"),
            (|g| g.view_zenith_deg.truncate(2), "number of views: expected 3, found 2"),
            (
                |g| g.camera_distance_km[1] = None,
                "view 1: distance of the camera: expected 600 km, found parallel rays",
            ),
            (
                |g| g.camera_distance_km[2] = Some(700.0),
                "view 2: distance of the camera: expected 600 km, found 700 km",
            ),
        ];
        for (change, message) in changes {
            let mut wrong = right.clone();
            change(&mut wrong);
            let error = metadata.check_images(&taken(&wrong, 1.0, 0.672)).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
        let altitude = metadata.check_images(&taken(&right, 1.2, 0.672)).unwrap_err().to_string();
        assert!(altitude.contains("altitude of the target: expected 1.0000 km, found 1.2000 km"));
        let wavelength =
            metadata.check_images(&taken(&right, 1.0, f64::NAN)).unwrap_err().to_string();
        assert!(wavelength.contains("wavelength: expected 0.6720 um"), "{wavelength}");
    }

    #[test]
    fn azimuths_are_compared_around_the_circle_and_by_what_they_move() {
        let metadata = metadata(&[3, 4]);
        let mut turned = metadata.view_geometry.clone();
        // View 0 looks straight down: its azimuth is arbitrary.
        turned.view_azimuth_deg[0] = 200.0;
        turned.view_azimuth_deg[1] += 360.0;
        turned.sun_azimuth_deg -= 360.0;
        metadata.check_images(&taken(&turned, 1.0, 0.672)).unwrap();
    }

    #[test]
    fn numbers_out_of_range_are_refused() {
        let changes: [fn(&mut WeightsMetadata); 9] = [
            |m| m.outputs = OUTPUTS.to_vec(),
            |m| m.outputs.clear(),
            |m| m.format_version = FORMAT_VERSION + 1,
            |m| m.input_scale = 0.0,
            |m| m.output_scale = f64::NAN,
            |m| m.levels.count = 5,
            |m| m.view_geometry.pixel_km = vec![0.05],
            |m| m.view_geometry.view_zenith_deg[0] = -3.0,
            |m| m.architecture.channels = vec![3],
        ];
        for change in changes {
            let mut wrong = metadata(&[3, 4]);
            wrong.check().unwrap();
            change(&mut wrong);
            assert!(wrong.check().is_err(), "{wrong:?}");
        }
    }
}
