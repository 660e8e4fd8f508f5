//! Results of other codes for validation: radiances, with one group per view, and the optical
//! properties of droplets.

use super::Input;
use crate::error::Result;
use crate::grid::{Grid, Volume};
use crate::math::DVec3;
use crate::scene::View;
use std::path::Path;

/// One view of a scene computed by two other codes. The rays are parallel; there is one value per
/// pixel, row by row from the south.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceView {
    /// The equivalent view in deepct.
    pub view: View,
    /// Radiance computed by Mitsuba (1/sr for a flux of 1 through a horizontal plane).
    pub mitsuba: Vec<f64>,
    /// Standard error of the radiance computed by Mitsuba.
    pub mitsuba_standard_error: Vec<f64>,
    /// Radiance computed by SHDOM (same unit).
    pub shdom: Vec<f64>,
}

/// Altitude of the plane in which the pixels are square (km).
const PIXEL_PLANE: f64 = 1.44;

/// Read the view `name` of the RICO cloud for the phase function that is denoted by `phase` in
/// the names of the variables.
///
/// # Errors
/// Returns an error if the file is missing or damaged, or does not contain the view.
pub fn read_reference_view(path: &Path, name: &str, phase: &str) -> Result<ReferenceView> {
    let input = Input::open(path)?;
    let values = |variable: &str| -> Result<Vec<f64>> {
        let values = input.variable(&format!("{name}/{variable}"))?.reals::<f64>()?;
        Ok(values.into_raw_vec_and_offset().0)
    };
    let (x, y) = (values("x")?, values("y")?);
    if x.len() < 2 || y.len() < 2 {
        return Err(input.error(name, "has less than two pixels", "give an image on (y, x)"));
    }
    let towards = input.group_numbers(name, "photon_direction")?;
    let [dx, dy, dz] = towards[..] else {
        let remedy = "give its components along x, y and z";
        return Err(input.error(name, "photon_direction is not a vector", remedy));
    };
    let middle = |axis: &[f64]| 0.5 * (axis[0] + axis[axis.len() - 1]);
    let pixel = (y[y.len() - 1] - y[0]) / (y.len() - 1) as f64;
    let target = DVec3::new(middle(&x), middle(&y), PIXEL_PLANE);
    let size = [y.len(), x.len()];
    let view = View::orthographic(DVec3::new(dx, dy, dz), target, pixel, size)?;
    let image = |variable: String| {
        let image = values(&variable)?;
        if image.len() == size[0] * size[1] {
            return Ok(image);
        }
        Err(input.error(&variable, "is not one value per pixel", "give an image on (y, x)"))
    };
    Ok(ReferenceView {
        view,
        mitsuba: image(format!("mitsuba_{phase}"))?,
        mitsuba_standard_error: image(format!("mitsuba_{phase}_se"))?,
        shdom: image(format!("shdom_{phase}"))?,
    })
}

/// The optical properties of droplets of one effective radius computed by another code.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReferenceDroplets {
    /// Effective radius (um).
    pub effective_radius: f64,
    /// Extinction per liquid water content (1/km per g/m3).
    pub extinction_per_water: f64,
    /// Single-scattering albedo.
    pub single_scattering_albedo: f64,
    /// Asymmetry parameter (mean cosine of the scattering angle).
    pub asymmetry: f64,
}

/// Read a table of droplet optical properties as a function of effective radius.
///
/// # Errors
/// Returns an error if the file is missing or damaged, or lacks one of the variables.
pub fn read_reference_droplets(path: &Path) -> Result<Vec<ReferenceDroplets>> {
    let input = Input::open(path)?;
    let radii = input.variable("reff")?.reals::<f64>()?.into_raw_vec_and_offset().0;
    let values = |name: &str| -> Result<Vec<f64>> {
        let values = input.variable(name)?.reals::<f64>()?.into_raw_vec_and_offset().0;
        if values.len() == radii.len() {
            return Ok(values);
        }
        Err(input.error(name, "is not one value per radius", "give it on (reff)"))
    };
    let extinction = values("extinction_per_lwc")?;
    let albedo = values("single_scattering_albedo")?;
    let asymmetry = values("asymmetry")?;
    Ok((0..radii.len())
        .map(|row| ReferenceDroplets {
            effective_radius: radii[row],
            extinction_per_water: extinction[row],
            single_scattering_albedo: albedo[row],
            asymmetry: asymmetry[row],
        })
        .collect())
}

/// Read the extinction of a cloud in the layout of AT3D: on (x, y, z), with an empty first level
/// far below the others.
///
/// # Errors
/// Returns an error if the file is missing or damaged, lacks `extinction`, or has too few levels.
pub fn read_reference_extinction(path: &Path) -> Result<Volume> {
    let input = Input::open(path)?;
    let axis = |name: &str| -> Result<Vec<f64>> {
        Ok(input.variable(name)?.reals::<f64>()?.into_raw_vec_and_offset().0)
    };
    let (x, y, z) = (axis("x")?, axis("y")?, axis("z")?);
    // AT3D does not write units; its extinction is in km-1.
    let values = input.variable("extinction")?.reals_3d::<f32>()?;
    if x.len() < 2 || y.len() < 2 || z.len() < 3 {
        return Err(input.error(
            "z",
            "has too few levels",
            "give x, y, z and an empty level below",
        ));
    }
    let spacing = DVec3::new(x[1] - x[0], y[1] - y[0], z[2] - z[1]);
    let corner = DVec3::new(x[0], y[0], z[1]) - 0.5 * spacing;
    let grid = Grid::new(corner, spacing, [z.len() - 1, y.len(), x.len()])?;
    let levels = values.slice(ndarray::s![.., .., 1..]).permuted_axes([2, 1, 0]);
    Volume::new(grid, levels.as_standard_layout().to_owned())
}
