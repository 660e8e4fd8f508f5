//! The step cloud of I3RC (Cahalan et al. 2005): a periodic field of 500 m, one half of optical
//! depth 2 and the other of optical depth 18, 250 m thick, with a Henyey-Greenstein phase function
//! of asymmetry parameter 0.85. The references are from a separate analogue Monte Carlo code.

use super::{Reference, Report, scene};
use crate::error::Result;
use crate::grid::{Grid, Volume};
use crate::math::DVec3;
use crate::scene::{Boundary, Scene};
use crate::transport::Share;
use ndarray::Array3;

const OPTICAL_DEPTHS: [f32; 2] = [2.0, 18.0];
const THICKNESS: f64 = 0.25;

/// Cosine of the solar zenith angle, single-scattering albedo; fractions reflected, transmitted and
/// absorbed; standard error.
const STEPS: [(f64, f64, [f64; 3], f64); 4] = [
    (1.0, 1.0, [0.32763, 0.67237, 0.0], 7e-5),
    (0.5, 1.0, [0.58070, 0.41930, 0.0], 8e-5),
    (1.0, 0.99, [0.26100, 0.59796, 0.14105], 10e-5),
    (0.5, 0.99, [0.47658, 0.32483, 0.19860], 9e-5),
];

/// Cosine of the solar zenith angle and mean reflectance of the two halves as independent columns.
const INDEPENDENT: [(f64, f64); 2] = [(1.0, 0.34019), (0.5, 0.49979)];

pub(super) fn run(mut report: Report) -> Result<()> {
    for (cosine, albedo, shares, error) in STEPS {
        let fluxes = report.fluxes(&cloud(&OPTICAL_DEPTHS, cosine, albedo)?, 0.1)?;
        let case = |what| format!("step, w {albedo}, mu0 {cosine}: {what}");
        let mut checks = vec![
            (case("reflected"), fluxes.reflected, Reference::new(shares[0], error)),
            (case("transmitted"), fluxes.transmitted, Reference::new(shares[1], error)),
        ];
        if albedo < 1.0 {
            checks.push((case("absorbed"), fluxes.absorbed, Reference::new(shares[2], error)));
        }
        report.compare(&checks);
    }
    for (cosine, reflected) in INDEPENDENT {
        let halves = [
            report.fluxes(&cloud(&OPTICAL_DEPTHS[..1], cosine, 1.0)?, 0.1)?.reflected,
            report.fluxes(&cloud(&OPTICAL_DEPTHS[1..], cosine, 1.0)?, 0.1)?.reflected,
        ];
        let both = Share {
            mean: 0.5 * (halves[0].mean + halves[1].mean),
            standard_error: 0.5 * halves[0].standard_error.hypot(halves[1].standard_error),
        };
        let case = format!("step, independent columns, mu0 {cosine}: reflected");
        report.compare(&[(case, both, Reference::new(reflected, 0.5e-5))]);
    }
    Ok(())
}

/// A periodic field of adjacent columns from west to east, each 250 m wide.
fn cloud(optical_depths: &[f32], cosine: f64, albedo: f64) -> Result<Scene> {
    let grid = Grid::new(DVec3::ZERO, DVec3::splat(THICKNESS), [1, 1, optical_depths.len()])?;
    let values =
        Array3::from_shape_fn(grid.shape, |(_, _, i)| optical_depths[i] / THICKNESS as f32);
    let scene = scene(Volume::new(grid, values)?, albedo, 0.85, cosine)?;
    Ok(scene.with_boundary(Boundary::Periodic))
}
