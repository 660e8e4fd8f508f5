//! Lists of views as specified by users: a preset formation or a TOML file.

use super::formation::distance_on_sphere;
use super::{Formation, View};
use crate::error::{Error, Result};
use crate::files;
use crate::image::ViewGeometry;
use crate::math::{DVec3, towards};
use serde::Deserialize;
use std::path::Path;

/// Format of a file of views, for messages and help texts.
pub const VIEW_FILE_HELP: &str = "\
A file of views contains either one [string_of_pearls] table or one [[view]] table per view:

    [string_of_pearls]           # satellites at equal distances on one orbit (spherical Earth)
    satellites = 32              # number of satellites
    arc_km = 100.0               # distance between neighbouring satellites along the orbit
    overhead = 16                # index of the satellite above the target, counted from 0
    altitude_km = 600.0          # altitude of the orbit above the target
    pixel_km = 0.05              # pixel size at the target at nadir
    track_azimuth_deg = 0.0      # optional: flight direction, clockwise from north

    [[view]]                     # a perspective camera
    view_zenith_deg = 26.0       # angle at the target between the zenith and the camera
    view_azimuth_deg = 90.0      # from the target towards the camera, clockwise from north
    altitude_km = 600.0          # altitude of the camera, as all altitudes above z = 0
    pixel_km = 0.05              # pixel size at z = 0 at nadir: altitude times pixel angle
                                 # (at the target for a camera below its target)

    [[view]]                     # an orthographic camera (parallel rays) has no altitude
    view_zenith_deg = 0.0
    view_azimuth_deg = 0.0
    pixel_km = 0.05              # pixel size in the horizontal plane
    looks_up = false             # optional: true for lines of sight that look up from this plane
                                 # (with a zenith angle above 90 degrees)

Optional keys before these tables: target_km = [x, y, z], the point at the centre of every
image (default: the centre of the cloud's grid), and image_size = [rows, cols] (default: that
of the grid).";

/// Altitude (km) above which there is no target.
const HIGHEST_TARGET: f64 = 100.0;

/// A list of cameras, from which [`ViewList::views`] creates the views of a target.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewList {
    target: Option<DVec3>,
    /// Altitude of the target (km), if the list does not specify its position.
    target_altitude: Option<f64>,
    image_size: Option<[usize; 2]>,
    cameras: Cameras,
}

#[derive(Debug, Clone, PartialEq)]
enum Cameras {
    Formation(Formation),
    Single(Vec<Camera>),
    /// The angles, pixel sizes and distances at the target.
    AtTarget(ViewGeometry),
}

/// The content of a file of views; see [`VIEW_FILE_HELP`].
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ViewFile {
    target_km: Option<[f64; 3]>,
    image_size: Option<[usize; 2]>,
    string_of_pearls: Option<StringOfPearls>,
    #[serde(default)]
    view: Vec<Camera>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct StringOfPearls {
    satellites: u16,
    arc_km: f64,
    overhead: u16,
    altitude_km: f64,
    pixel_km: f64,
    #[serde(default)]
    track_azimuth_deg: f64,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Camera {
    view_zenith_deg: f64,
    view_azimuth_deg: f64,
    altitude_km: Option<f64>,
    pixel_km: f64,
    #[serde(default)]
    looks_up: bool,
}

impl ViewList {
    /// The preset formation of the given name, otherwise the content of the file at this path.
    ///
    /// # Errors
    /// Returns an error if the name is neither a preset nor a file, if the file cannot be read, if
    /// a key is missing or unknown, or if a number is out of range.
    pub fn find(name: &str) -> Result<Self> {
        if let Some(formation) = Formation::preset(name) {
            let cameras = Cameras::Formation(formation);
            return Ok(Self::new(cameras));
        }
        let path = Path::new(name);
        if !path.exists() {
            let presets = Formation::PRESETS.join(", ");
            let range = format!("the name of a formation ({presets}) or a TOML file of views");
            return Err(Error::out_of_range("views", format!("\"{name}\""), range));
        }
        let text = files::read_text(path)?;
        let list = Self::parse(&text).map_err(|problem| {
            Error::file(path, "views", problem, "see `deepct render --help` for the file format")
        })?;
        // Numbers out of range are reported here, before the scene is read.
        list.views(list.any_target(), [1, 1]).map_err(Error::in_file(path))?;
        Ok(list)
    }

    /// A target above which all cameras are that look down, and below which those that look up, if
    /// there is one.
    fn any_target(&self) -> DVec3 {
        let Cameras::Single(cameras) = &self.cameras else { return DVec3::ZERO };
        let look_up = cameras.iter().filter(|camera| camera.view_zenith_deg > 90.0);
        let altitudes = look_up.filter_map(|camera| camera.altitude_km);
        let highest = altitudes.filter(|altitude| *altitude < HIGHEST_TARGET).fold(-1e-3, f64::max);
        DVec3::new(0.0, 0.0, highest + 1e-3)
    }

    fn parse(text: &str) -> std::result::Result<Self, String> {
        let file: ViewFile =
            toml::from_str(text).map_err(|problem| files::toml_problem(text, &problem))?;
        let cameras = match (file.string_of_pearls, file.view.is_empty()) {
            (Some(pearls), true) => Cameras::Formation(pearls.formation()?),
            (None, false) => Cameras::Single(file.view),
            (Some(_), false) => return Err("has both [string_of_pearls] and [[view]]".into()),
            (None, true) => return Err("has neither [string_of_pearls] nor [[view]]".into()),
        };
        let target = file.target_km.map(DVec3::from_array);
        Ok(Self { target, image_size: file.image_size, ..Self::new(cameras) })
    }

    fn new(cameras: Cameras) -> Self {
        Self { target: None, target_altitude: None, image_size: None, cameras }
    }

    /// The cameras of a geometry in numbers, as that of the training of a network.
    ///
    /// # Errors
    /// Returns an error if the geometry does not state the distances of the cameras.
    pub fn of_geometry(geometry: &ViewGeometry) -> Result<Self> {
        let (views, found) = (geometry.pixel_km.len(), geometry.camera_distance_km.len());
        if found != views {
            let remedy = "give the cameras by their formation or a file";
            return Err(Error::mismatch("number of camera distances", views, found, remedy));
        }
        Ok(Self::new(Cameras::AtTarget(geometry.clone())))
    }

    /// The same cameras, pointed at the altitude `altitude` (km) in the middle of the scene unless
    /// the list specifies the whole target.
    #[must_use]
    pub fn with_target_altitude(self, altitude: f64) -> Self {
        let target = self.target.map(|target| DVec3 { z: altitude, ..target });
        Self { target, target_altitude: Some(altitude), ..self }
    }

    /// The views of `target` (km) with images of `[rows, cols]` pixels. A target or image size
    /// specified in the list takes precedence.
    ///
    /// # Errors
    /// Returns an error if a number is out of range.
    pub fn views(&self, target: DVec3, image_size: [usize; 2]) -> Result<Vec<View>> {
        let altitude = self.target_altitude.unwrap_or(target.z);
        if !altitude.is_finite() || altitude.abs() > HIGHEST_TARGET {
            let range = format!("within {HIGHEST_TARGET} km of the sea level");
            return Err(Error::out_of_range("altitude of the target (km)", altitude, range));
        }
        let target = self.target.unwrap_or(DVec3 { z: altitude, ..target });
        let size = self.image_size.unwrap_or(image_size);
        match &self.cameras {
            Cameras::Formation(formation) => formation.views(target, size),
            Cameras::Single(cameras) => {
                cameras.iter().map(|camera| camera.view(target, size)).collect()
            }
            Cameras::AtTarget(geometry) => views_at_target(geometry, target, size),
        }
    }
}

/// The views of `target` (km) with the angles, pixel sizes and distances that they have there.
fn views_at_target(geometry: &ViewGeometry, target: DVec3, size: [usize; 2]) -> Result<Vec<View>> {
    let angles = geometry.view_zenith_deg.iter().zip(&geometry.view_azimuth_deg);
    let sizes = geometry.pixel_km.iter().zip(&geometry.camera_distance_km);
    angles
        .zip(sizes)
        .map(|((zenith, azimuth), (&pixel_km, distance))| {
            let towards = towards(zenith.to_radians(), azimuth.to_radians());
            match distance {
                None => View::orthographic(towards, target, pixel_km, size),
                Some(distance) => {
                    let position = target + *distance * towards;
                    View::perspective(position, target, pixel_km / distance, size)
                }
            }
        })
        .collect()
}

impl StringOfPearls {
    fn formation(&self) -> std::result::Result<Formation, String> {
        if self.overhead >= self.satellites {
            return Err(format!(
                "overhead is {}, but must be below the number of satellites, {}",
                self.overhead, self.satellites
            ));
        }
        let first = -i32::from(self.overhead);
        let last = first + i32::from(self.satellites) - 1;
        let formation = Formation::string_of_pearls(self.altitude_km, self.arc_km, first..=last)
            .map_err(|problem| problem.to_string())?;
        let track_azimuth = self.track_azimuth_deg.to_radians();
        Ok(Formation { track_azimuth, pixel_km: self.pixel_km, ..formation })
    }
}

impl Camera {
    fn view(&self, target: DVec3, size: [usize; 2]) -> Result<View> {
        let zenith = self.view_zenith_deg.to_radians();
        let azimuth = self.view_azimuth_deg.to_radians();
        let towards = towards(zenith, azimuth);
        let below = towards.z < 0.0;
        match self.altitude_km {
            None if below != self.looks_up => {
                let range = "below 90 degrees: the angle at the target between the zenith and the \
                             camera; above 90 degrees for a view that looks up (looks_up = true)";
                Err(Error::out_of_range("view_zenith_deg", self.view_zenith_deg, range))
            }
            None if below => View::looking_up(towards, target, self.pixel_km, size),
            None => View::orthographic(towards, target, self.pixel_km, size),
            Some(altitude) => {
                let side = if below { "below" } else { "above" };
                let is_there = if below { altitude < target.z } else { altitude > target.z };
                let distance = distance_on_sphere(zenith, target.z, altitude);
                if !(altitude.is_finite() && is_there && distance.is_finite()) {
                    let range = format!(
                        "finite and {side} the target at {} km for a view zenith angle of {} degrees",
                        target.z, self.view_zenith_deg
                    );
                    return Err(Error::out_of_range("altitude_km", altitude, range));
                }
                let position = target + distance * towards;
                let from_pixel = if below { distance } else { altitude };
                View::perspective(position, target, self.pixel_km / from_pixel, size)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Projection;
    use crate::scene::formation::EARTH_RADIUS_KM;

    const TARGET: DVec3 = DVec3::new(0.8, 0.8, 1.0);

    /// Part of the example in the help text; each of its two alternatives is a valid file.
    fn example(start: &str, end: &str) -> String {
        let (_, rest) = VIEW_FILE_HELP.split_once(start).unwrap();
        let (part, _) = rest.split_once(end).unwrap();
        format!("{start}{part}")
    }

    #[test]
    fn a_string_of_pearls_is_the_formation() {
        let list = ViewList::parse(&example("[string_of_pearls]  ", "[[view]]  ")).unwrap();
        let pearls = Formation::string_of_pearls(600.0, 100.0, -16..=15).unwrap();
        assert_eq!(list.views(TARGET, [32, 32]).unwrap(), pearls.views(TARGET, [32, 32]).unwrap());
    }

    /// Images of the cameras of a geometry have this geometry.
    #[test]
    fn a_geometry_gives_its_views() {
        let whole = example("[[view]]  ", "Optional");
        let views = ViewList::parse(&whole).unwrap().views(TARGET, [8, 9]).unwrap();
        let geometry = crate::scene::view_geometry(&crate::scene::Sun::default(), &views);
        let list = ViewList::of_geometry(&geometry).unwrap().with_target_altitude(0.7);
        let again = list.views(TARGET, [8, 9]).unwrap();
        assert!(again.iter().all(|view| view.target == DVec3 { z: 0.7, ..TARGET }));
        for (one, other) in views.iter().zip(&again) {
            assert!((one.zenith() - other.zenith()).abs() < 1e-9);
            assert!((one.azimuth() - other.azimuth()).abs() < 1e-9);
            assert!((one.pixel_km() / other.pixel_km() - 1.0).abs() < 1e-12);
            let distances = [one.distance_km(), other.distance_km()].map(|km| km.unwrap_or(0.0));
            assert!((distances[0] - distances[1]).abs() < 1e-9);
        }
        let near = ViewGeometry { camera_distance_km: Vec::new(), ..geometry };
        assert!(ViewList::of_geometry(&near).is_err());
        for altitude in [f64::NAN, 1e3] {
            assert!(list.clone().with_target_altitude(altitude).views(TARGET, [8, 9]).is_err());
        }
    }

    #[test]
    fn single_views_are_perspective_or_orthographic() {
        let list = ViewList::parse(&example("[[view]]  ", "Optional")).unwrap();
        let views = list.views(TARGET, [8, 9]).unwrap();
        let Projection::Perspective { position, pixel_tangent } = views[0].projection else {
            panic!("not a perspective view")
        };
        assert!((views[0].zenith().to_degrees() - 26.0).abs() < 1e-9);
        assert!((views[0].azimuth().to_degrees() - 90.0).abs() < 1e-9);
        assert!((pixel_tangent - 0.05 / 600.0).abs() < 1e-12);
        // The vertical of the camera is not that of the target.
        let from_middle = position + EARTH_RADIUS_KM * DVec3::Z - DVec3::new(0.8, 0.8, 0.0);
        assert!((from_middle.length() - EARTH_RADIUS_KM - 600.0).abs() < 1e-6);
        assert_eq!(views[1], View::orthographic(DVec3::Z, TARGET, 0.05, [8, 9]).unwrap());
    }

    /// A camera of an aircraft at 3 km sees a plate of 1 km at 1.1 km with pixels of 10 mrad.
    #[test]
    fn altitudes_are_above_the_sea() {
        let view = |altitude: f64, pixel: f64| {
            ViewList::parse(&format!(
                "[[view]]\nview_zenith_deg = 0.0\nview_azimuth_deg = 0.0\n\
                 altitude_km = {altitude:?}\npixel_km = {pixel:?}"
            ))
            .and_then(|list| list.views(TARGET, [120, 120]).map_err(|error| error.to_string()))
        };
        for (altitude, pixels) in [(3.0, 1.0 / 1.9 / 0.01), (20.0, 1.0 / 18.9 / 0.01)] {
            let view = view(altitude, 0.01 * altitude).unwrap().remove(0);
            let edge = |x: f64| view.project(DVec3::new(0.8 + x, 0.8, 1.1)).unwrap().1;
            assert!((edge(0.5) - edge(-0.5) - pixels).abs() < 1e-9);
        }
        assert!(view(0.9, 0.01).unwrap_err().contains("above the target at 1 km"));
    }

    #[test]
    fn views_look_up_on_purpose() {
        let read = |text: &str| {
            let view =
                format!("target_km = [0.0, 0.0, 1.0]\n[[view]]\nview_azimuth_deg = 30.0\n{text}");
            ViewList::parse(&view)
                .and_then(|list| list.views(TARGET, [8, 8]).map_err(|error| error.to_string()))
        };
        let up = read("view_zenith_deg = 140.0\npixel_km = 0.1\nlooks_up = true").unwrap();
        assert!(up[0].looks_up() && up[0].ray(4.0, 4.0).origin.z == 1.0);
        let near = read("view_zenith_deg = 140.0\npixel_km = 0.1\naltitude_km = 0.5").unwrap();
        let Projection::Perspective { position, .. } = near[0].projection else { panic!() };
        assert!((position.z - 0.5).abs() < 1e-3);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ground.toml");
        let camera = "[[view]]\nview_zenith_deg = 150.0\nview_azimuth_deg = 30.0\n\
                      altitude_km = 0.1\npixel_km = 0.05\n";
        std::fs::write(&path, camera).unwrap();
        let list = ViewList::find(path.to_str().unwrap()).unwrap();
        assert!(list.views(TARGET, [8, 8]).unwrap()[0].looks_up());
        for wrong in [
            "view_zenith_deg = 140.0\npixel_km = 0.1",
            "view_zenith_deg = 40.0\npixel_km = 0.1\nlooks_up = true",
            "view_zenith_deg = 40.0\npixel_km = 0.1\naltitude_km = 0.5",
            "view_zenith_deg = 140.0\npixel_km = 0.1\naltitude_km = 5.0",
        ] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_file_may_set_the_target_and_the_size() {
        let view = example("[[view]]  ", "Optional");
        let text = format!("target_km = [1.0, 2.0, 3.0]\nimage_size = [4, 5]\n{view}");
        let views = ViewList::parse(&text).unwrap().views(TARGET, [32, 32]).unwrap();
        assert_eq!(views[0].target, DVec3::new(1.0, 2.0, 3.0));
        assert_eq!((views[1].rows, views[1].cols), (4, 5));
    }

    #[test]
    fn wrong_files_are_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("views.toml");
        let pearls = example("[string_of_pearls]  ", "[[view]]  ");
        let view = example("[[view]]  ", "Optional");
        for wrong in [
            String::new(),
            format!("{pearls}{view}"),
            pearls.replace("arc_km", "arc"),
            pearls.replace("overhead = 16", "overhead = 32"),
            pearls.replace("arc_km = 100.0", "arc_km = 1000.0"),
            view.replace("view_zenith_deg = 26.0", "view_zenith_deg = 120.0"),
            view.replace("pixel_km = 0.05 ", "pixel_km = -1.0 "),
            view.replace("altitude_km = 600.0", "altitude_km = 0.0"),
            format!("image_size = [0, 4]\n{view}"),
        ] {
            std::fs::write(&path, &wrong).unwrap();
            let message = ViewList::find(path.to_str().unwrap()).unwrap_err().to_string();
            assert!(message.contains("views.toml"), "{message}\n{wrong}");
        }
        let message = ViewList::find("cloudct-11").unwrap_err().to_string();
        assert!(message.contains("cloudct-10"), "{message}");
    }
}
