//! Metadata of general weights.

use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::image::ImagingGeometry;
use crate::math::towards;
use crate::network::{NetworkOutput, Training};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The version of the metadata of general weights.
const GENERAL_FORMAT_VERSION: u32 = 4;

/// Views in directions that differ by no more than this (radians) are the same view.
const SAME_DIRECTION: f64 = 0.005;

/// Relative tolerance of voxel sizes.
const SPACING_TOLERANCE: f64 = 1e-3;

/// Metadata of general weights: architecture, units, the range of the training and the origin.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GeneralMetadata {
    /// 4.
    pub format_version: u32,
    /// `"general"`; it distinguishes these weights from those for one formation.
    pub network: String,
    /// Numbers of layers and channels.
    pub architecture: GeneralArchitecture,
    /// The levels of the output.
    pub levels: GeneralLevels,
    /// Horizontal voxel size (km) for which `output_scale` is stated. For other voxels, lengths are
    /// multiplied and extinctions divided by one factor.
    pub voxel_km: f64,
    /// Wavelength of the training images (um).
    pub wavelength_um: f64,
    /// The outputs of the last layer, each with one channel for every level.
    pub outputs: Vec<NetworkOutput>,
    /// Input of the network = radiance (1/sr) x `input_scale`.
    pub input_scale: f64,
    /// Outputs (1/km) = output of the network x `output_scale`, for voxels of `voxel_km`.
    pub output_scale: f64,
    /// The geometries for which the network was trained.
    pub ranges: Ranges,
    /// Albedo of the surface that the network knows. The radiance of another surface is estimated
    /// from the images and replaced by that of this one. Absent: images are used as they are.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub surface_albedo: Option<f64>,
    /// Pairs of the relative error (epsilon) that the network expects and the one that was found
    /// for such clouds, ascending. The uncertainty of an estimate is multiplied by the ratio of the
    /// two, interpolated linearly. Empty: the uncertainty is used as it is.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub calibration: Vec<[f64; 2]>,
    /// The lowest and the highest value of statistics of the training images, by name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub typical: BTreeMap<String, [f64; 2]>,
    /// The training data.
    pub training: Training,
    /// Scores by name.
    pub scores: BTreeMap<String, f64>,
    /// Name and version of the program that wrote the file.
    pub program: String,
    /// The complete configuration of the training.
    pub configuration: serde_json::Value,
}

/// The architecture of a general network.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GeneralArchitecture {
    /// Number of weighted sums over the views that the first layer reads on each plane.
    pub virtual_views: usize,
    /// Number of horizontal planes, at the centres of equal parts of the vertical range.
    pub planes: usize,
    /// Whether the first layer also reads the minimum and the maximum over the views.
    pub extremes: bool,
    /// Number of channels between the layers.
    pub width: usize,
    /// Number of convolutions.
    pub layers: usize,
    /// Whether a ReLU follows the last layer.
    pub last_relu: bool,
}

impl GeneralArchitecture {
    /// Number of input and output channels of each layer, without those of the last one.
    fn inputs(&self) -> usize {
        self.planes * (self.virtual_views + 2 * usize::from(self.extremes))
    }
}

/// The levels of the output, relative to the horizontal size of a voxel.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GeneralLevels {
    /// Number of levels.
    pub count: usize,
    /// Height of a level over the horizontal size of a voxel.
    pub height: f64,
}

/// The lowest and the highest value for which a network was trained.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ranges {
    /// Number of views.
    pub views: [f64; 2],
    /// Zenith angle of a view (degrees).
    pub view_zenith_deg: [f64; 2],
    /// Zenith angle of the Sun (degrees).
    pub sun_zenith_deg: [f64; 2],
    /// Pixel size at the target over the horizontal size of a voxel.
    pub pixel_per_voxel: [f64; 2],
    /// Horizontal size of a voxel (km).
    pub voxel_km: [f64; 2],
    /// Wavelength (um).
    pub wavelength_um: [f64; 2],
}

impl GeneralMetadata {
    /// Returns an error unless the values are in range and consistent with each other.
    ///
    /// # Errors
    /// An unknown format version; a number out of range; outputs that are inconsistent.
    pub fn check(&self) -> Result<()> {
        if self.format_version != GENERAL_FORMAT_VERSION {
            return Err(Error::mismatch(
                "format_version of the weights",
                GENERAL_FORMAT_VERSION,
                self.format_version,
                "use the version of deepct that the weights were written for",
            ));
        }
        let GeneralArchitecture { virtual_views, planes, width, layers, .. } = self.architecture;
        for (name, value, least) in [
            ("architecture.virtual_views", virtual_views, 1),
            ("architecture.planes", planes, 1),
            ("architecture.width", width, 1),
            ("architecture.layers", layers, 2),
            ("levels.count", self.levels.count, 1),
        ] {
            if !(least..=1 << 16).contains(&value) {
                return Err(Error::out_of_range(name, value, format!("at least {least}")));
            }
        }
        let fits = |[low, high]: [f64; 2]| low.is_finite() && high.is_finite() && low <= high;
        let Ranges { views, view_zenith_deg, sun_zenith_deg, pixel_per_voxel, voxel_km, .. } =
            &self.ranges;
        for (name, range) in [
            ("ranges.views", *views),
            ("ranges.view_zenith_deg", *view_zenith_deg),
            ("ranges.sun_zenith_deg", *sun_zenith_deg),
            ("ranges.pixel_per_voxel", *pixel_per_voxel),
            ("ranges.voxel_km", *voxel_km),
            ("ranges.wavelength_um", self.ranges.wavelength_um),
        ] {
            if !fits(range) {
                return Err(Error::out_of_range(
                    name,
                    format!("{range:?}"),
                    "two ascending numbers",
                ));
            }
        }
        for (name, value) in [
            ("levels.height", self.levels.height),
            ("voxel_km", self.voxel_km),
            ("wavelength_um", self.wavelength_um),
            ("input_scale", self.input_scale),
            ("output_scale", self.output_scale),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return Err(Error::out_of_range(name, value, "positive and finite"));
            }
        }
        if let Some(albedo) = self.surface_albedo
            && !(0.0..=1.0).contains(&albedo)
        {
            return Err(Error::out_of_range("surface_albedo", albedo, "from 0 to 1"));
        }
        let known = [NetworkOutput::Extinction, NetworkOutput::Uncertainty];
        if !(self.outputs == known || self.outputs == known[..1]) {
            let found = format!("{:?}", self.outputs);
            let range = "[\"extinction\"] or [\"extinction\", \"uncertainty\"]";
            return Err(Error::out_of_range("outputs", found, range));
        }
        let ascending = |pairs: &[[f64; 2]]| pairs.is_sorted_by(|a, b| a[0] < b[0]);
        let positive = self.calibration.iter().flatten().all(|x| x.is_finite() && *x > 0.0);
        if !(positive && ascending(&self.calibration)) {
            let found = format!("{:?}", self.calibration);
            return Err(Error::out_of_range("calibration", found, "ascending and positive"));
        }
        Ok(())
    }

    /// Number of input and output channels of each layer.
    pub(crate) fn layer_channels(&self) -> Vec<(usize, usize)> {
        let GeneralArchitecture { width, layers, .. } = self.architecture;
        let mut channels = vec![self.architecture.inputs()];
        channels.extend(std::iter::repeat_n(width, layers - 1));
        channels.push(self.outputs.len() * self.levels.count);
        channels.windows(2).map(|pair| (pair[0], pair[1])).collect()
    }

    /// Returns an error unless a grid has the levels and the proportions of these weights.
    pub(super) fn check_levels(&self, grid: &Grid) -> Result<()> {
        let near = |a: f64, b: f64| (a / b - 1.0).abs() <= SPACING_TOLERANCE;
        let spacing = grid.spacing;
        let fits = grid.shape[0] == self.levels.count
            && near(spacing.y, spacing.x)
            && near(spacing.z, self.levels.height * spacing.x);
        match fits {
            true => Ok(()),
            false => Err(Error::mismatch(
                "voxels and levels",
                format!("{} levels of {} voxels", self.levels.count, self.levels.height),
                format!("{} levels, voxels of {} km", grid.shape[0], spacing),
                "use a grid made by GeneralWeights::grid",
            )),
        }
    }

    /// Returns an error if the network was not trained for a geometry with voxels of `voxel_km`.
    ///
    /// # Errors
    /// An [`Error::OutOfRange`] that names the first number outside the range, and the range.
    pub fn check_range(&self, geometry: &ImagingGeometry, voxel_km: f64) -> Result<()> {
        let Ranges {
            views,
            view_zenith_deg,
            sun_zenith_deg,
            pixel_per_voxel,
            voxel_km: sizes,
            wavelength_um,
        } = &self.ranges;
        let outside = |name: &'static str, value: String, [low, high]: [f64; 2], unit: &str| {
            let range = format!(
                "{low} to {high}{unit}, the range of the training of the network (the option \
                 --force overrides this check)"
            );
            Error::out_of_range(name, value, range)
        };
        let within = |value: f64, [low, high]: [f64; 2]| (low..=high).contains(&value);
        let theirs = &geometry.views;
        let count = theirs.view_zenith_deg.len();
        if !within(count as f64, *views) {
            return Err(outside("number of views", count.to_string(), *views, ""));
        }
        let directions: Vec<_> = theirs
            .view_zenith_deg
            .iter()
            .zip(&theirs.view_azimuth_deg)
            .map(|(zenith, azimuth)| towards(zenith.to_radians(), azimuth.to_radians()))
            .collect();
        let is_new = |view: &usize| {
            let to = directions[*view];
            directions[..*view].iter().all(|other| other.angle_between(to) > SAME_DIRECTION)
        };
        let different = (0..count).filter(is_new).count();
        if (different as f64) < views[0] {
            return Err(outside("number of different views", different.to_string(), *views, ""));
        }
        let sun = theirs.sun_zenith_deg;
        if !within(sun, *sun_zenith_deg) {
            let name = "solar zenith angle";
            return Err(outside(name, format!("{sun:.2}"), *sun_zenith_deg, " degrees"));
        }
        for (view, &zenith) in theirs.view_zenith_deg.iter().enumerate() {
            if !within(zenith, *view_zenith_deg) {
                let value = format!("{zenith:.2} (view {view})");
                return Err(outside("view zenith angle", value, *view_zenith_deg, " degrees"));
            }
        }
        if !within(voxel_km, *sizes) {
            let name = "horizontal voxel size";
            return Err(outside(name, format!("{voxel_km:.4}"), *sizes, " km"));
        }
        for (view, &pixel) in theirs.pixel_km.iter().enumerate() {
            if !within(pixel / voxel_km, *pixel_per_voxel) {
                let name = "pixel size at the target over that of a voxel";
                let value = format!("{:.3} (view {view})", pixel / voxel_km);
                return Err(outside(name, value, *pixel_per_voxel, ""));
            }
        }
        if !within(geometry.wavelength_um, *wavelength_um) {
            let value = format!("{}", geometry.wavelength_um);
            return Err(outside("wavelength", value, *wavelength_um, " um"));
        }
        Ok(())
    }
}
