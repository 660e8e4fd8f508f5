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
/// had neither planes nor camera distances; version 2 had no outputs other than the extinction; version
/// 3 had one band and no effective radius. Version 4 is that of general weights.
pub const FORMAT_VERSION: u32 = 5;

/// Largest accepted difference of a direction of view or of the Sun from that of the weights
/// (degrees).
const ANGLE_TOLERANCE_DEG: f64 = 0.1;
/// Largest accepted relative difference of the pixel size and of the wavelength.
const RELATIVE_TOLERANCE: f64 = 0.01;
/// Largest accepted difference of the altitude of the target, in levels.
const LEVEL_TOLERANCE: f64 = 0.1;
/// Largest accepted distance between the targets of two bands, in voxels.
const POSITION_TOLERANCE: f64 = 0.02;
/// Largest accepted relative difference of the distance of a camera. It displaces the edges of a
/// field of 6 km by 1/50 of a pixel.
const DISTANCE_TOLERANCE: f64 = 0.1;

/// The possible outputs of the last layer, in this order; the first one is mandatory.
const OUTPUTS: [NetworkOutput; 3] =
    [NetworkOutput::Extinction, NetworkOutput::Uncertainty, NetworkOutput::EffectiveRadius];

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
    /// Wavelength of the images of each band (um), in the order of the input channels. All bands have
    /// the same views. In a file, a number for one band and a list for several.
    #[serde(rename = "wavelength_um", with = "one_or_several")]
    pub wavelengths_um: Vec<f64>,
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
    /// Effective radius (um) = output of the network x `effective_radius_scale`, limited to
    /// [`TABLE_RADII`](crate::optics::TABLE_RADII); given if it is an output.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub effective_radius_scale: Option<f64>,
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
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum NetworkOutput {
    /// The extinction (1/km).
    Extinction,
    /// The expected absolute error of the extinction (1/km).
    Uncertainty,
    /// The effective radius of the droplets (um), which has no meaning where there is no extinction.
    EffectiveRadius,
}

impl NetworkOutput {
    /// The name of the output in a file.
    pub fn name(self) -> &'static str {
        match self {
            Self::Extinction => "extinction",
            Self::Uncertainty => "uncertainty",
            Self::EffectiveRadius => "effective_radius",
        }
    }
}

/// A list of numbers that is stored as a number if it has one element.
mod one_or_several {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    #[derive(Deserialize)]
    #[serde(untagged, expecting = "a number or a list of numbers")]
    enum OneOrSeveral {
        One(f64),
        Several(Vec<f64>),
    }

    pub(super) fn serialize<S: Serializer>(values: &[f64], to: S) -> Result<S::Ok, S::Error> {
        match values {
            [value] => value.serialize(to),
            _ => values.serialize(to),
        }
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<f64>, D::Error> {
        Ok(match OneOrSeveral::deserialize(from)? {
            OneOrSeveral::One(value) => vec![value],
            OneOrSeveral::Several(values) => values,
        })
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
            ("horizontal_spacing_km", self.horizontal_spacing_km[0]),
            ("horizontal_spacing_km", self.horizontal_spacing_km[1]),
            ("levels.spacing_km", self.levels.spacing_km),
        ];
        let geometry = &self.view_geometry;
        let pixels = geometry.pixel_km.iter().map(|&size| ("view_geometry.pixel_km", size));
        let distances = geometry.camera_distance_km.iter().flatten();
        let distances = distances.map(|&distance| ("camera_distance_km", distance));
        let wavelengths = self.wavelengths_um.iter().map(|&value| ("wavelength_um", value));
        let radius = self.effective_radius_scale.iter().map(|&s| ("effective_radius_scale", s));
        let lists = pixels.chain(distances).chain(wavelengths).chain(radius);
        for (name, value) in positive.into_iter().chain(lists) {
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
        let known: Vec<_> = OUTPUTS.into_iter().filter(|one| self.outputs.contains(one)).collect();
        if known != self.outputs || self.outputs.first() != Some(&NetworkOutput::Extinction) {
            let found = format!("{:?}", self.outputs);
            let range = "\"extinction\", then \"uncertainty\", \"effective_radius\" or both";
            return Err(Error::out_of_range("outputs", found, range));
        }
        let is_scaled = self.effective_radius_scale.is_some();
        if is_scaled != self.outputs.contains(&NetworkOutput::EffectiveRadius) {
            let found = if is_scaled { "given" } else { "missing" };
            let range = "given if \"effective_radius\" is an output, and only then";
            return Err(Error::out_of_range("effective_radius_scale", found, range));
        }
        let repeated = |(number, wavelength)| self.wavelengths_um[..number].contains(wavelength);
        if self.bands() == 0 || self.wavelengths_um.iter().enumerate().any(repeated) {
            let found = format!("{:?}", self.wavelengths_um);
            return Err(Error::out_of_range("wavelength_um", found, "one of each band"));
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

    /// Returns an error unless the weights are valid for images of bands taken under these conditions.
    ///
    /// Zenith angles may differ by 0.1 degrees, and azimuths by as much as displaces the line of
    /// sight by 0.1 degrees; pixel sizes and the wavelengths by 1 %; the altitude of the target by a
    /// tenth of a level; the distance of a camera, if the weights specify it, by 10 %. The targets of
    /// all bands must be the same.
    ///
    /// # Errors
    /// An [`Error::Mismatch`] with the first quantity that differs, its expected and its actual
    /// value.
    pub fn check_images<'a>(
        &self,
        bands: impl IntoIterator<Item = &'a ImagingGeometry>,
    ) -> Result<()> {
        let bands: Vec<_> = bands.into_iter().collect();
        self.check_bands(bands.iter().map(|taken| taken.wavelength_um))?;
        bands.iter().try_for_each(|taken| self.check_band(taken))?;
        let [x, y, _] = bands.first().map_or([0.0; 3], |taken| taken.target_km);
        let most = POSITION_TOLERANCE * self.horizontal_spacing_km[0];
        let elsewhere = |taken: &&&ImagingGeometry| {
            !(within(taken.target_km[0] - x, most) && within(taken.target_km[1] - y, most))
        };
        match bands.iter().find(elsewhere) {
            None => Ok(()),
            Some(&&ImagingGeometry { target_km: [east, north, _], .. }) => {
                let place = |x: f64, y: f64| format!("x {x:.4}, y {y:.4} km");
                Err(Error::mismatch(
                    "target of a band",
                    place(x, y),
                    place(east, north),
                    "give images of the same scene in each band",
                ))
            }
        }
    }

    /// Compares the number of bands and their wavelengths (um) with those of the weights.
    pub(super) fn check_bands(&self, wavelengths: impl Iterator<Item = f64>) -> Result<()> {
        let found: Vec<f64> = wavelengths.collect();
        if found.len() != self.bands() {
            let in_bands = |all: &[f64]| format!("{} ({})", all.len(), micrometres(all));
            let (expected, found) = (in_bands(&self.wavelengths_um), in_bands(&found));
            return Err(self.differs("number of bands".into(), expected, found));
        }
        for (number, (&expected, found)) in self.wavelengths_um.iter().zip(found).enumerate() {
            if !within(found / expected - 1.0, RELATIVE_TOLERANCE) {
                let um = |value: f64| format!("{value:.4} um");
                let what = match self.bands() {
                    1 => "wavelength".into(),
                    _ => format!("wavelength of band {number}"),
                };
                return Err(self.differs(what, um(expected), um(found)));
            }
        }
        Ok(())
    }

    /// Compares the cameras and the Sun of a band.
    fn check_band(&self, taken: &ImagingGeometry) -> Result<()> {
        let ImagingGeometry { views: geometry, target_km: [.., altitude], .. } = taken;
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
        let bands = match self.bands() {
            1 => String::new(),
            _ => format!(" at {}, in this order", micrometres(&self.wavelengths_um)),
        };
        let remedy = format!(
            "these weights are for the images of \"{}\"{bands}: give such images, or weights \
             trained for these",
            self.formation
        );
        Error::mismatch(what, expected, found, remedy)
    }
}

/// Wavelengths (um) as text.
fn micrometres(wavelengths: &[f64]) -> String {
    let numbers: Vec<_> = wavelengths.iter().map(|wavelength| wavelength.to_string()).collect();
    format!("{} um", numbers.join(" and "))
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
        metadata.check_images([&taken(&right, 1.0, 0.672)]).unwrap();
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
            let error =
                metadata.check_images([&taken(&wrong, 1.0, 0.672)]).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
        let altitude = metadata.check_images([&taken(&right, 1.2, 0.672)]).unwrap_err().to_string();
        assert!(altitude.contains("altitude of the target: expected 1.0000 km, found 1.2000 km"));
        let wavelength =
            metadata.check_images([&taken(&right, 1.0, f64::NAN)]).unwrap_err().to_string();
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
        metadata.check_images([&taken(&turned, 1.0, 0.672)]).unwrap();
    }

    /// The wavelength is a number in files of one band, as in those of earlier versions.
    #[test]
    fn wavelengths_are_a_number_or_a_list() {
        let mut metadata = metadata(&[3, 4]);
        let json = |metadata: &WeightsMetadata| serde_json::to_value(metadata).unwrap();
        assert_eq!(json(&metadata)["wavelength_um"], 0.672);
        assert_eq!(json(&metadata).get("effective_radius_scale"), None);
        metadata.wavelengths_um.push(2.13);
        assert_eq!(json(&metadata)["wavelength_um"], serde_json::json!([0.672, 2.13]));
        let again: WeightsMetadata = serde_json::from_value(json(&metadata)).unwrap();
        assert_eq!(again, metadata);
    }

    #[test]
    fn bands_and_outputs_that_contradict_the_rest_are_refused() {
        let two = || {
            let mut metadata = metadata(&[3, 4]);
            metadata.architecture.channels = vec![6, 4];
            metadata.wavelengths_um = vec![0.672, 2.13];
            metadata.outputs.push(NetworkOutput::EffectiveRadius);
            metadata.effective_radius_scale = Some(10.0);
            metadata.levels.count = 2;
            metadata
        };
        two().check().unwrap();
        type Change = fn(&mut WeightsMetadata);
        let changes: [(Change, &str); 7] = [
            (|m| m.wavelengths_um.clear(), "wavelength_um"),
            (|m| m.wavelengths_um[1] = 0.672, "wavelength_um"),
            (|m| m.wavelengths_um[1] = -1.0, "wavelength_um"),
            (|m| m.wavelengths_um.truncate(1), "number of channels of the images"),
            (|m| m.effective_radius_scale = None, "effective_radius_scale is missing"),
            (|m| m.effective_radius_scale = Some(0.0), "effective_radius_scale"),
            (|m| m.outputs.reverse(), "outputs"),
        ];
        for (change, message) in changes {
            let mut wrong = two();
            change(&mut wrong);
            let error = wrong.check().unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
    }

    #[test]
    fn bands_of_another_scene_are_refused() {
        let mut metadata = metadata(&[6, 4]);
        metadata.view_geometry = self::metadata(&[3, 4]).view_geometry;
        metadata.wavelengths_um = vec![0.672, 2.13];
        let visible = taken(&metadata.view_geometry, 1.0, 0.672);
        let infrared = taken(&metadata.view_geometry, 1.0, 2.13);
        metadata.check_images([&visible, &infrared]).unwrap();
        let elsewhere = ImagingGeometry { target_km: [0.1, 0.0, 1.0], ..infrared };
        let error = metadata.check_images([&visible, &elsewhere]).unwrap_err().to_string();
        assert!(error.contains("target of a band: expected x 0.0000"), "{error}");
    }

    #[test]
    fn numbers_out_of_range_are_refused() {
        let changes: [fn(&mut WeightsMetadata); 9] = [
            |m| m.outputs = OUTPUTS[..2].to_vec(),
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
