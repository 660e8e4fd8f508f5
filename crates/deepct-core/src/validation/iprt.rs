//! The cube cloud of the International Polarized Radiative Transfer project, phase B, case C2
//! (Emde et al. 2018). The reference is the intensity published for the polarised GPU Monte Carlo code
//! SMART-G, which agrees with MYSTIC to 0.5 % in every pixel: of the light that arrives at the surface
//! in cases 1 to 4, and of that at the top of the domain in cases 5 to 9.

use super::{Reference, Report};
use crate::error::Result;
use crate::grid::{Grid, Volume};
use crate::math::{DVec3, towards};
use crate::optics::{DropletTable, Medium};
use crate::scene::{Boundary, Scene, Sun, Surface, View};
use crate::transport::{MonteCarloSettings, Share, Solver, render};
use ndarray::Array3;
use std::sync::Arc;

/// A case: its number, solar zenith angle, view zenith angle and view azimuth minus solar azimuth
/// (degrees), which are those of the direction towards the camera, and the mean intensity.
type Case = (usize, f64, f64, f64, f64);
const CASES: [Case; 9] = [
    (1, 20.0, 140.0, 0.0, 0.003275),
    (2, 20.0, 140.0, 60.0, 0.004203),
    (3, 20.0, 140.0, 120.0, 0.006524),
    (4, 20.0, 140.0, 180.0, 0.008527),
    (5, 40.0, 0.0, 0.0, 0.049392),
    (6, 40.0, 40.0, 0.0, 0.052328),
    (7, 40.0, 40.0, 60.0, 0.049915),
    (8, 40.0, 40.0, 120.0, 0.049162),
    (9, 40.0, 40.0, 180.0, 0.049208),
];
/// Accepted relative difference in addition to the noise.
const ACCURACY: f64 = 2e-3;
/// Columns along each side of the domain of 7 km.
const COLUMNS: usize = 7;

pub(super) fn run(mut report: Report) -> Result<()> {
    let grid = Grid::new(DVec3::ZERO, DVec3::ONE, [5, COLUMNS, COLUMNS])?;
    let mut extinction = Volume::constant(grid, 0.0);
    extinction.values[[2, 3, 3]] = 10.0;
    let radii = Array3::from_elem(grid.shape, 10.0);
    let medium = Medium::of_droplets(extinction, radii, Arc::new(DropletTable::water(0.8)?))?;
    // The azimuth of the Sun is normal to a face of the cube.
    let azimuth = 90_f64;
    for (number, sun_zenith, zenith, from_sun, expected) in CASES {
        let sun = Sun::from_degrees(sun_zenith, azimuth)?;
        let scene = Scene::new(medium.clone(), sun, Surface::lambertian(0.2))?
            .with_boundary(Boundary::Periodic);
        let direction = towards(zenith.to_radians(), (azimuth + from_sun).to_radians());
        let at = |altitude| DVec3::new(3.5, 3.5, altitude);
        let view = if zenith < 90.0 {
            View::orthographic(direction, at(5.0), 1.0, [COLUMNS; 2])?
        } else {
            View::looking_up(direction, at(0.0), 1.0, [COLUMNS; 2])?
        };
        let settings = MonteCarloSettings {
            samples_per_pixel: report.effort.samples / (COLUMNS * COLUMNS) as u32,
            seed: report.effort.seed,
            ..Default::default()
        };
        let found = render(&scene, &[view], &Solver::MonteCarlo(settings), &())?;
        let count = found.images.values.len() as f64;
        let sum: f64 = found.images.values.iter().map(|value| f64::from(*value)).sum();
        let errors = found.standard_error.iter().flat_map(|error| error.values.iter());
        let variance: f64 = errors.map(|error| f64::from(error * error)).sum();
        let mean = Share { mean: sum / count, standard_error: variance.sqrt() / count };
        let systematic = ACCURACY * expected;
        let reference = Reference { value: expected, standard_error: 5e-7, systematic };
        let case = format!("C2, case {number}: mean intensity");
        report.compare(&[(case, mean, reference)]);
    }
    Ok(())
}
