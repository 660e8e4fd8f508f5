//! Comparison of both solvers with adding and doubling for conservative plane-parallel layers of one
//! column with periodic sides (Henyey-Greenstein, asymmetry parameter 0.85, Sun at 30 degrees).
//!
//! `thick_layers [PATHS]` prints the radiance at the nadir relative to that of
//! `crates/deepct-core/tests/fixtures/doubling.py`: of the discrete-ordinates solver with its default
//! settings, with the number of sweeps and the largest optical depth of a cell, and, if PATHS is
//! given, of the Monte Carlo solver with this number of photon paths.

use deepct_core::grid::{Grid, Volume};
use deepct_core::math::DVec3;
use deepct_core::optics::{Medium, PhaseFunction};
use deepct_core::scene::{Boundary, Scene, Sun, Surface, View};
use deepct_core::transport::{
    MonteCarloSettings, OrdinatesModel, OrdinatesSettings, Solver, render,
};
use std::f64::consts::PI;

type AnyError = Box<dyn std::error::Error>;

/// Number of voxels, optical depth of each, and the reflectance at the nadir.
const LAYERS: [(usize, f64, f64); 7] = [
    (32, 0.25, 0.346353),
    (32, 1.25, 0.827809),
    (32, 5.0, 1.016283),
    (4, 10.0, 0.827809),
    (4, 20.0, 0.946777),
    (32, 10.0, 1.054049),
    (4, 2500.0, 1.092838),
];
const VOXEL_KM: f64 = 0.05;
const SUN_ZENITH_DEG: f64 = 30.0;

fn main() -> Result<(), AnyError> {
    let paths: Option<u32> = std::env::args().nth(1).map(|text| text.parse()).transpose()?;
    println!("voxels  depth   total   ordinates  sweeps   cell  Monte Carlo");
    for (voxels, depth, expected) in LAYERS {
        let grid = Grid::new(DVec3::new(0.0, 0.0, 0.5), DVec3::splat(VOXEL_KM), [voxels, 1, 1])?;
        let extinction = Volume::constant(grid, (depth / VOXEL_KM) as f32);
        let medium = Medium::new(extinction.clone(), 1.0, PhaseFunction::henyey_greenstein(0.85)?)?;
        let scene = Scene::new(medium, Sun::from_degrees(SUN_ZENITH_DEG, 0.0)?, Surface::BLACK)?
            .with_boundary(Boundary::Periodic);
        let view = View::orthographic(DVec3::Z, grid.center(), VOXEL_KM, [1, 1])?;
        let flux = SUN_ZENITH_DEG.to_radians().cos();
        let error = |radiance: f32| 100.0 * (PI * f64::from(radiance) / flux / expected - 1.0);
        let mut model = OrdinatesModel::new(
            &scene,
            std::slice::from_ref(&view),
            None,
            &OrdinatesSettings::default(),
        )?;
        let found = error(model.images(&extinction)?.values[[0, 0, 0]]);
        let (sweeps, cell) = (model.sweeps(), model.thickest_cell());
        print!(
            "{voxels:6}  {depth:5}  {:6}  {found:+8.2} %  {sweeps:6}  {cell:5.1}",
            depth * voxels as f64
        );
        if let Some(samples_per_pixel) = paths {
            let settings = MonteCarloSettings { samples_per_pixel, ..Default::default() };
            let images = render(&scene, &[view], &Solver::MonteCarlo(settings), &())?;
            let noise = images.standard_error.map_or(0.0, |errors| errors.values[[0, 0, 0]]);
            let found = images.images.values[[0, 0, 0]];
            print!("  {:+.2} +- {:.2} %", error(found), 100.0 * noise / found);
        }
        println!();
    }
    Ok(())
}
