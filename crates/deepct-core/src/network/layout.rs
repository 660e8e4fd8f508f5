//! Arrangement of the images as input channels of the first layer.

use super::WeightsMetadata;
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// Arrangement of the images as input channels of the first layer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum ImageLayout {
    /// As recorded by the cameras: channel `band * views + view` is the image of that view in that
    /// band, and the pixel `[row, col]` of that image is the input pixel `[row, col]`.
    Camera,
    /// Resampled onto horizontal planes.
    Planes(Planes),
}

/// Horizontal planes onto which the network resamples the images, so that one input pixel is one
/// column of voxels in every channel (the plane sweep of Collins 1996).
///
/// Each image is resampled once, bilinearly, onto the plane of the target. For a plane at another
/// altitude, the result is shifted by the parallax of that plane, rounded to whole voxels. Beyond
/// its edge, an image is continued with its edge values, because the clear sky around a cloud does
/// not become darker at the edge of a frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Planes {
    /// Altitudes of the planes (km). Channel `(plane * bands + band) * views + view` of the first layer
    /// is the image of `view` in that band on that plane.
    pub altitudes_km: Vec<f64>,
    /// Whether there are two more channels for each plane, after those of the views: first the
    /// minimum over the views on each plane, then the maximum on each plane. A voxel is clear where
    /// any view shows clear sky, which a sum over the views does not express.
    #[serde(default, skip_serializing_if = "is_false")]
    pub extremes: bool,
}

fn is_false(value: &bool) -> bool {
    !value
}

/// The largest parallax between a plane and the target (voxels), comparable to the width of the
/// largest fields that fit into memory.
const MAX_PARALLAX: f64 = 4096.0;

impl WeightsMetadata {
    /// Number of views.
    pub fn views(&self) -> usize {
        self.view_geometry.view_zenith_deg.len()
    }

    /// Number of bands.
    pub fn bands(&self) -> usize {
        self.wavelengths_um.len()
    }

    /// Number of images: the views of each band.
    pub fn images(&self) -> usize {
        self.bands() * self.views()
    }

    /// Number of input channels of the first layer.
    pub fn input_channels(&self) -> usize {
        match &self.image_layout {
            ImageLayout::Camera => self.images(),
            ImageLayout::Planes(Planes { altitudes_km, extremes }) => {
                (self.images() + 2 * usize::from(*extremes)) * altitudes_km.len()
            }
        }
    }

    /// The parallax of `view` at `altitude_km`: the displacement `[row, col]` (voxels to the north
    /// and to the east) with which an object at that altitude appears on the plane of the target.
    /// Half a voxel is rounded down, so that the result does not depend on the last bit of a
    /// tangent.
    pub(super) fn parallax(&self, view: usize, altitude_km: f64) -> [f64; 2] {
        let geometry = &self.view_geometry;
        let [dx, dy] = self.horizontal_spacing_km;
        let climb = altitude_km - self.target_altitude_km;
        let shift = -climb * geometry.view_zenith_deg[view].to_radians().tan();
        let (sine, cosine) = geometry.view_azimuth_deg[view].to_radians().sin_cos();
        [shift * cosine / dy, shift * sine / dx].map(|voxels| (voxels - 1e-6).round())
    }

    /// Returns an error unless the planes and the geometry allow the images to be resampled.
    pub(super) fn check_layout(&self) -> Result<()> {
        let ImageLayout::Planes(planes) = &self.image_layout else { return Ok(()) };
        if planes.altitudes_km.is_empty() {
            return Err(Error::out_of_range("image_layout.planes.altitudes_km", "[]", "not empty"));
        }
        if planes.extremes && self.bands() > 1 {
            let range = "false for several bands";
            return Err(Error::out_of_range("image_layout.planes.extremes", "true", range));
        }
        let (expected, found) = (self.views(), self.view_geometry.camera_distance_km.len());
        if expected != found {
            let what = "length of view_geometry.camera_distance_km";
            let remedy = "give the distance of each camera, or null for parallel rays: it is \
                          needed to resample the images onto planes";
            return Err(Error::mismatch(what, expected, found, remedy));
        }
        for &altitude in &planes.altitudes_km {
            let parallaxes = (0..self.views()).flat_map(|view| self.parallax(view, altitude));
            let largest = parallaxes.fold(0.0, |largest: f64, voxels| largest.max(voxels.abs()));
            if !(altitude.is_finite() && largest <= MAX_PARALLAX) {
                let range = format!("close to the target: a parallax of {MAX_PARALLAX} voxels");
                return Err(Error::out_of_range("altitude of a plane", altitude, range));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::fixture::metadata;

    fn on_planes() -> WeightsMetadata {
        let planes = Planes { altitudes_km: vec![0.8, 1.2], extremes: false };
        let mut metadata = metadata(&[3, 4]);
        metadata.image_layout = ImageLayout::Planes(planes);
        metadata.architecture.channels[0] = 6;
        metadata
    }

    /// The layout in the JSON of a file: a string in files of version 1, an object for planes.
    #[test]
    fn layouts_are_a_word_or_an_object() {
        let read = |text: &str| serde_json::from_str::<ImageLayout>(text);
        assert_eq!(read("\"camera\"").unwrap(), ImageLayout::Camera);
        let text = r#"{"planes":{"altitudes_km":[0.8,1.2]}}"#;
        assert_eq!(read(text).unwrap(), on_planes().image_layout);
        assert_eq!(serde_json::to_string(&on_planes().image_layout).unwrap(), text);
        let with = r#"{"planes":{"altitudes_km":[0.8,1.2],"extremes":true}}"#;
        assert!(matches!(read(with).unwrap(), ImageLayout::Planes(Planes { extremes: true, .. })));
        assert!(read("\"planes\"").is_err());
        assert!(read(r#"{"planes":{"altitudes_km":[0.8],"spacing_km":0.4}}"#).is_err());
    }

    #[test]
    fn planes_that_lack_something_are_refused() {
        type Change = fn(&mut WeightsMetadata);
        let changes: [(Change, &str); 5] = [
            (|m| m.architecture.channels[0] = 3, "number of channels of the images"),
            (|m| m.view_geometry.camera_distance_km.clear(), "camera_distance_km: expected 3"),
            (|m| m.view_geometry.camera_distance_km[1] = Some(-1.0), "camera_distance_km is -1"),
            (|m| set(m, &[0.8, f64::NAN]), "altitude of a plane is NaN"),
            (|m| set(m, &[0.8, 1e6]), "altitude of a plane is 1000000"),
        ];
        on_planes().check().unwrap();
        for (change, message) in changes {
            let mut wrong = on_planes();
            change(&mut wrong);
            let error = wrong.check().unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
        let mut none = on_planes();
        set(&mut none, &[]);
        assert!(none.check_layout().unwrap_err().to_string().contains("altitudes_km"));
    }

    fn set(metadata: &mut WeightsMetadata, altitudes_km: &[f64]) {
        let planes = Planes { altitudes_km: altitudes_km.into(), extremes: false };
        metadata.image_layout = ImageLayout::Planes(planes);
    }

    /// Half a voxel is rounded down independently of rounding errors of the tangent.
    #[test]
    fn a_cloud_above_the_target_is_seen_away_from_the_camera() {
        let mut metadata = on_planes();
        let geometry = &mut metadata.view_geometry;
        (geometry.view_zenith_deg[0], geometry.view_azimuth_deg[0]) = (45.0, 180.0);
        for (altitude, rows) in [(1.0, 0.0), (1.1, 2.0), (1.125, 2.0), (0.875, -3.0)] {
            assert_eq!(metadata.parallax(0, altitude), [rows, 0.0], "{altitude}");
        }
    }
}
