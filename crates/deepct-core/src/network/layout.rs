//! How images lie before the first layer.

use super::WeightsMetadata;
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// How the images become the channels of the first layer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum ImageLayout {
    /// As the cameras took them: channel `view`, pixel `[row, col]` of every view is one
    /// input pixel.
    Camera,
    /// Laid on horizontal planes.
    Planes(Planes),
}

/// Horizontal planes that the network lays the images on, so that one input pixel is one
/// column of voxels in every channel (the plane sweep of Collins 1996).
///
/// Each image is resampled once, bilinearly, on the plane of the target. On a plane at
/// another altitude it lies as far off as a cloud there seems to be, to the nearest voxel.
/// Beyond its edge an image goes on as it is there: around a cloud is clear sky, and that is
/// no darker where a frame ends.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Planes {
    /// The altitudes of the planes (km). Channel `plane * views + view` of the first layer
    /// is the image of `view` on that plane.
    pub altitudes_km: Vec<f64>,
}

/// The largest parallax between a plane and the target (voxels): a field of it would be as
/// wide as any that fits into memory.
const MAX_PARALLAX: f64 = 4096.0;

impl WeightsMetadata {
    /// Number of views.
    pub fn views(&self) -> usize {
        self.view_geometry.view_zenith_deg.len()
    }

    /// Number of channels that the images become.
    pub fn input_channels(&self) -> usize {
        match &self.image_layout {
            ImageLayout::Camera => self.views(),
            ImageLayout::Planes(planes) => self.views() * planes.altitudes_km.len(),
        }
    }

    /// What a view shows on its pixel of the target's plane `[row, col]` (voxels) off the one
    /// where it shows what is at `altitude_km`: how far a cloud at that altitude seems to be
    /// off to the north and to the east. Half a voxel is rounded down, so that the last bit
    /// of a tangent decides nothing.
    pub(super) fn parallax(&self, view: usize, altitude_km: f64) -> [f64; 2] {
        let geometry = &self.view_geometry;
        let [dx, dy] = self.horizontal_spacing_km;
        let climb = altitude_km - self.target_altitude_km;
        let shift = -climb * geometry.view_zenith_deg[view].to_radians().tan();
        let (sine, cosine) = geometry.view_azimuth_deg[view].to_radians().sin_cos();
        [shift * cosine / dy, shift * sine / dx].map(|voxels| (voxels - 1e-6).round())
    }

    /// An error unless planes have all that they need.
    pub(super) fn check_layout(&self) -> Result<()> {
        let ImageLayout::Planes(planes) = &self.image_layout else { return Ok(()) };
        if planes.altitudes_km.is_empty() {
            return Err(Error::out_of_range("image_layout.planes.altitudes_km", "[]", "not empty"));
        }
        let (expected, found) = (self.views(), self.view_geometry.camera_distance_km.len());
        if expected != found {
            let what = "length of view_geometry.camera_distance_km";
            let remedy = "give the distance of each camera, or null for parallel rays: images \
                          cannot be laid on planes without";
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
        let planes = Planes { altitudes_km: vec![0.8, 1.2] };
        let mut metadata = metadata(&[3, 4]);
        metadata.image_layout = ImageLayout::Planes(planes);
        metadata.architecture.channels[0] = 6;
        metadata
    }

    /// The layout of a file in JSON, as files of version 1 have it and as planes are told.
    #[test]
    fn layouts_are_a_word_or_an_object() {
        let read = |text: &str| serde_json::from_str::<ImageLayout>(text);
        assert_eq!(read("\"camera\"").unwrap(), ImageLayout::Camera);
        let text = r#"{"planes":{"altitudes_km":[0.8,1.2]}}"#;
        assert_eq!(read(text).unwrap(), on_planes().image_layout);
        assert_eq!(serde_json::to_string(&on_planes().image_layout).unwrap(), text);
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
        metadata.image_layout = ImageLayout::Planes(Planes { altitudes_km: altitudes_km.into() });
    }

    /// Half a voxel is rounded down, however its tangent was rounded.
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
