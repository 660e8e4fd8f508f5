//! Simulates images of a thin cloud and reconstructs it by inversion, starting from a small uniform
//! extinction.
//!
//! `cargo run --release --example invert`

use deepct_core::Result;
use deepct_core::carve::{CarveSettings, carve};
use deepct_core::grid::{Grid, Volume};
use deepct_core::inversion::{InversionSettings, OrdinatesModels, Problem, Start, invert};
use deepct_core::math::DVec3;
use deepct_core::optics::{CLOUD_ASYMMETRY, Medium, PhaseFunction};
use deepct_core::scene::{Formation, Observation, Scene, Sun, Surface};
use deepct_core::transport::{MonteCarloSettings, OrdinatesSettings, Solver, render};

fn main() -> Result<()> {
    let grid = Grid::new(DVec3::new(0.0, 0.0, 0.7), DVec3::splat(0.1), [6, 12, 12])?;
    let mut cloud = Volume::constant(grid, 0.0);
    for ((k, j, i), extinction) in cloud.values.indexed_iter_mut() {
        let distance = grid.voxel_center([k, j, i]).distance(grid.center());
        *extinction = (20.0 * (1.0 - distance / 0.35)).max(0.0) as f32;
    }

    // Images by the Monte Carlo solver.
    let phase_function = PhaseFunction::henyey_greenstein(CLOUD_ASYMMETRY)?;
    let medium = Medium::new(cloud.clone(), 1.0, phase_function)?;
    let scene = Scene::new(medium, Sun::default(), Surface::BLACK)?;
    let views = Formation::cloudct_10().views(grid.center(), [24, 24])?;
    let settings = MonteCarloSettings { samples_per_pixel: 1024, ..Default::default() };
    let rendering = render(&scene, &views, &Solver::MonteCarlo(settings), &())?;
    let mut observation = Observation::new(scene.sun, views.clone(), rendering.images)?;
    observation.standard_error = rendering.standard_error;

    // Inversion with the deterministic solver and its derivatives.
    let mask = carve(&observation, &grid, &CarveSettings::default())?.mask;
    let problem =
        Problem { bands: std::slice::from_ref(&observation), mask: &mask, truth: Some(&cloud) };
    let mut models = OrdinatesModels::new(scene, views, OrdinatesSettings::default());
    let settings = InversionSettings { iterations: 15, coarse: vec![2], ..Default::default() };
    let found = invert(&problem, &mut models, &Start::Constant(0.01), &settings, &())?;
    println!("blocks  step   misfit  epsilon");
    for record in &found.history {
        let epsilon = record.relative_error.expect("the truth was given");
        println!(
            "{:6}  {:4}  {:7.2}  {epsilon:7.3}",
            record.block, record.iteration, record.misfit
        );
    }
    Ok(())
}
