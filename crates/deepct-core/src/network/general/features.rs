//! The numbers by which general weights know the geometry. `weights_tools/general.py` computes the
//! same.

use crate::error::{Error, Result};
use crate::image::ViewGeometry;
use crate::math::{DVec3, towards};

/// Number of features of a view.
pub(super) const VIEW_FEATURES: usize = 18;
/// Number of features of the scene.
pub(super) const SCENE_FEATURES: usize = 9;

/// Limit of the tangents of the zenith angle along x and along y in the features.
const LARGEST_TANGENT: f64 = 4.0;

/// Lower limit of the size of a pixel (voxels) in the features: much smaller pixels are averaged
/// over a voxel, and a training has none.
const FINEST_PIXEL: f64 = 0.9;

/// The features of a geometry; most have a range of about -1 to 1.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Features {
    /// The features of each view.
    pub(super) views: Vec<[f64; VIEW_FEATURES]>,
    /// The features of the scene: the direction of the Sun; means, squares and the product of the
    /// tangents of the views; the number of views.
    pub(super) scene: [f64; SCENE_FEATURES],
}

impl Features {
    /// The features for voxels of `voxel_km` (horizontally).
    pub(super) fn new(geometry: &ViewGeometry, voxel_km: f64) -> Result<Self> {
        let count = geometry.view_zenith_deg.len();
        for (name, found) in [
            ("number of view azimuths", geometry.view_azimuth_deg.len()),
            ("number of pixel sizes", geometry.pixel_km.len()),
        ] {
            if found != count || count == 0 {
                return Err(Error::mismatch(name, count, found, "give one for each view"));
            }
        }
        let views = geometry.view_zenith_deg.iter().map(|&angle| ("view zenith angle", angle));
        for (name, angle) in views.chain([("solar zenith angle", geometry.sun_zenith_deg)]) {
            if !(0.0..90.0).contains(&angle) {
                return Err(Error::out_of_range(name, angle, "in [0, 90) degrees"));
            }
        }
        let direction =
            |zenith: f64, azimuth: f64| towards(zenith.to_radians(), azimuth.to_radians());
        let sun = direction(geometry.sun_zenith_deg, geometry.sun_azimuth_deg);
        let angles = geometry.view_zenith_deg.iter().zip(&geometry.view_azimuth_deg);
        let directions: Vec<DVec3> =
            angles.map(|(&zenith, &azimuth)| direction(zenith, azimuth)).collect();
        let tangents: Vec<[f64; 2]> = directions.iter().map(|&to| halved_tangents(to)).collect();
        let mean = |of: fn(&[f64; 2]) -> f64| tangents.iter().map(of).sum::<f64>() / count as f64;
        let scene = [
            1.5 * sun.x,
            1.5 * sun.y,
            2.0 * sun.z - 1.4,
            mean(|q| q[0]),
            mean(|q| q[1]),
            mean(|q| q[0] * q[0]),
            mean(|q| q[1] * q[1]),
            mean(|q| q[0] * q[1]),
            (count as f64).ln() - 2.3,
        ];
        let of_view = |(view, &to): (usize, &DVec3)| {
            let cosine = to.dot(sun);
            let [qx, qy] = tangents[view];
            let mut features = [
                1.5 * to.x,
                1.5 * to.y,
                qx,
                qy,
                2.0 * to.z - 1.5,
                1.5 * sun.x,
                1.5 * sun.y,
                2.0 * sun.z,
                cosine,
                2.0 * cosine * cosine - 1.0,
                (to + sun).normalize().z,
                (geometry.pixel_km[view] / voxel_km).max(FINEST_PIXEL) - 1.0,
                0.0,
                0.0,
                0.0,
                0.0,
                0.0,
                0.0,
            ];
            features[VIEW_FEATURES - 6..].copy_from_slice(&scene[3..]);
            features
        };
        Ok(Self { views: directions.iter().enumerate().map(of_view).collect(), scene })
    }
}

/// Half the tangents along x and y of a direction.
fn halved_tangents(to: DVec3) -> [f64; 2] {
    [to.x, to.y].map(|part| (part / to.z).clamp(-LARGEST_TANGENT, LARGEST_TANGENT) / 2.0)
}
