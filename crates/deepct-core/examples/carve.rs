//! Carves a spherical cloud from ten noisy images, with several values of the agreement.
//!
//! `cargo run --release --example carve`

use deepct_core::Result;
use deepct_core::carve::{CarveSettings, carve};
use deepct_core::grid::{Grid, Volume};
use deepct_core::math::DVec3;
use deepct_core::metrics::score_mask;
use deepct_core::optics::{CLOUD_ASYMMETRY, Medium, PhaseFunction};
use deepct_core::scene::{Formation, Observation, Scene, Sun, Surface};
use deepct_core::sensor::{Scale, Sensor, sense};
use deepct_core::transport::{MonteCarloSettings, Solver, render};

fn main() -> Result<()> {
    let grid = Grid::new(DVec3::new(0.0, 0.0, 0.5), DVec3::new(0.05, 0.05, 0.04), [24, 32, 32])?;
    let mut cloud = Volume::constant(grid, 0.0);
    for ((k, j, i), extinction) in cloud.values.indexed_iter_mut() {
        if grid.voxel_center([k, j, i]).distance(grid.center()) < 0.3 {
            *extinction = 30.0;
        }
    }

    let phase_function = PhaseFunction::henyey_greenstein(CLOUD_ASYMMETRY)?;
    let medium = Medium::new(cloud.clone(), 1.0, phase_function)?;
    let scene = Scene::new(medium, Sun::default(), Surface::OCEAN)?;
    let views = Formation::cloudct_10().views(grid.center(), [32, 32])?;
    let settings = MonteCarloSettings { samples_per_pixel: 32, ..Default::default() };
    let rendering = render(&scene, &views, &Solver::MonteCarlo(settings), &())?;
    let sensed = sense(&rendering.images, None, &Sensor::CMV4000, Scale::BrightestAtFullWell, 1)?;
    let observation = Observation::new(scene.sun, views, sensed.images)?;

    println!("agreement  threshold   kept  extinction missed  false positive");
    for agreement in [0.6, 0.7, 0.8, 0.9, 1.0] {
        let settings = CarveSettings { agreement, ..Default::default() };
        let carved = carve(&observation, &grid, &settings)?;
        let scores = score_mask(&cloud, &carved.mask)?;
        println!(
            "{agreement:9.1}  {:9.4}  {:5.3}  {:17.4}  {:14.3}",
            carved.thresholds[0], scores.kept, scores.extinction_missed, scores.false_positive
        );
    }
    Ok(())
}
