//! Isolated cubes and a sphere, compared with a separate analogue Monte Carlo code.

use super::{Reference, Report, scene, unit_grid};
use crate::error::Result;
use crate::grid::Volume;
use crate::math::DVec3;
use crate::transport::Share;
use ndarray::{Array3, Axis};
use std::f64::consts::PI;

/// Optical depth, asymmetry parameter, cosine of the solar zenith angle; fractions reflected,
/// transmitted and lost through the sides; standard errors of the first two fractions.
type Cube = (f64, f64, f64, [f64; 3], [f64; 2]);

const CUBES: [Cube; 5] = [
    (2.0, 0.85, 1.0, [0.02021, 0.62861, 0.35118], [2e-5, 8e-5]),
    (10.0, 0.85, 1.0, [0.10995, 0.16584, 0.72421], [5e-5, 6e-5]),
    (10.0, 0.85, 0.5, [0.18521, 0.04221, 0.77258], [9e-5, 5e-5]),
    (50.0, 0.85, 1.0, [0.40621, 0.01939, 0.57440], [16e-5, 4e-5]),
    (10.0, 0.0, 1.0, [0.51023, 0.01543, 0.47434], [11e-5, 3e-5]),
];

/// Voxels along the diameter of the sphere, and the discretisation error of its flux fractions,
/// which change by less than this between 40 and 160 voxels.
const SPHERE_VOXELS: usize = 80;
const SPHERE_VOXEL_ERROR: f64 = 5e-4;

pub(super) fn run(mut report: Report) -> Result<()> {
    for (depth, g, cosine, shares, errors) in CUBES {
        let extinction = Volume::constant(unit_grid(5)?, depth as f32);
        let fluxes =
            report.fluxes(&scene(extinction, 1.0, g, cosine)?, shares[0].min(shares[1]))?;
        let case = |what| format!("cube, tau {depth}, g {g}, mu0 {cosine}: {what}");
        let errors = [errors[0], errors[1], errors[0].hypot(errors[1])];
        let reference = |share: usize| Reference::new(shares[share], errors[share]);
        report.compare(&[
            (case("reflected"), fluxes.reflected, reference(0)),
            (case("transmitted"), fluxes.transmitted, reference(1)),
            (case("sides"), fluxes.sides, reference(2)),
        ]);
    }
    sphere(&mut report)
}

/// A sphere of optical diameter 10 inscribed in a cubic domain. Light that enters the top face
/// beside the sphere leaves unscattered through the bottom.
fn sphere(report: &mut Report) -> Result<()> {
    let scene = scene(sphere_of_voxels()?, 1.0, 0.85, 1.0)?;
    let fluxes = report.fluxes(&scene, 0.02)?;
    // Relative to the light incident on the sphere, whose cross-section is pi / 4 of the domain's.
    let area = PI / 4.0;
    let upward = Share {
        mean: fluxes.upward.mean / area,
        standard_error: fluxes.upward.standard_error / area,
    };
    let expected = Reference { systematic: SPHERE_VOXEL_ERROR, ..Reference::new(0.24474, 1e-4) };
    let direct = Reference::new(transmittance_of_columns(&scene.medium.extinction), 0.0);
    report.compare(&[
        ("sphere, tau 10, g 0.85: upward".into(), upward, expected),
        ("sphere and surroundings: unscattered".into(), fluxes.unscattered, direct),
    ]);
    Ok(())
}

/// The mean over all columns of the vertical direct transmittance.
fn transmittance_of_columns(extinction: &Volume) -> f64 {
    let depths = extinction.values.mapv(f64::from).sum_axis(Axis(0)) * extinction.grid.spacing.z;
    depths.mapv(|depth| (-depth).exp()).mean().unwrap_or(1.0)
}

/// The extinction of the sphere. Voxels cut by its surface are weighted by the fraction inside,
/// evaluated at 8^3 points.
fn sphere_of_voxels() -> Result<Volume> {
    let grid = unit_grid(SPHERE_VOXELS)?;
    let parts = 8;
    let offsets: Vec<f64> = (0..parts).map(|p| (p as f64 + 0.5) / parts as f64 - 0.5).collect();
    let inside = |voxel: [usize; 3]| {
        let center = grid.voxel_center(voxel) - grid.center();
        let margin = center.length() - 0.5;
        if margin.abs() > grid.spacing.length() {
            return if margin < 0.0 { 1.0 } else { 0.0 };
        }
        let mut count = 0_usize;
        for z in &offsets {
            for y in &offsets {
                for x in &offsets {
                    let point = center + grid.spacing * DVec3::new(*x, *y, *z);
                    count += usize::from(point.length() < 0.5);
                }
            }
        }
        count as f64 / (parts * parts * parts) as f64
    };
    let values = Array3::from_shape_fn(grid.shape, |(k, j, i)| 10.0 * inside([k, j, i]) as f32);
    Volume::new(grid, values)
}
