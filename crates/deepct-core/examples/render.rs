//! A cumulus in the light that the built-in networks were trained in, seen by both solvers.
//!
//! `cargo run --release --example render`

use deepct_core::Result;
use deepct_core::cloud::{CumulusSettings, cumulus};
use deepct_core::scene::{Formation, Light};
use deepct_core::transport::{MonteCarloSettings, OrdinatesSettings, Solver, render};

fn main() -> Result<()> {
    let settings = CumulusSettings { width_km: Some(0.4), ..Default::default() };
    let cloud = cumulus(&settings, 3)?;
    // Droplets after Mie theory, molecular atmosphere, dark ocean.
    let scene = Light::realistic().scene(&cloud)?;
    let views = Formation::cloudct_10().views(cloud.grid.center(), [32, 32])?;

    let paths = MonteCarloSettings { samples_per_pixel: 256, ..Default::default() };
    let noisy = render(&scene, &views, &Solver::MonteCarlo(paths), &())?;
    let ordinates = OrdinatesSettings { estimate_error: true, ..Default::default() };
    let smooth = render(&scene, &views, &Solver::Ordinates(ordinates), &())?;

    println!("view  mean radiance (sr-1): Monte Carlo  discrete ordinates");
    for view in 0..views.len() {
        let mean = |images: &deepct_core::image::ViewStack| {
            f64::from(images.image(view).mean().unwrap_or_default())
        };
        println!("{view:4}  {:34.5}  {:18.5}", mean(&noisy.images), mean(&smooth.images));
    }
    if let Some(error) = smooth.estimated_error {
        println!("estimated error of the bright pixels: {:.1} %", 100.0 * error);
    }
    Ok(())
}
