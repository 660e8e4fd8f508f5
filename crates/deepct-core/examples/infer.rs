//! From images to extinction by a built-in network, with the error that it expects.
//!
//! `cargo run --release --example infer`

use deepct_core::Result;
use deepct_core::carve::{CarveSettings, carve};
use deepct_core::cloud::{CumulusSettings, cumulus};
use deepct_core::io::load_weights;
use deepct_core::metrics::score;
use deepct_core::network::Network;
use deepct_core::scene::{Formation, Light, Observation};
use deepct_core::sensor::{Scale, Sensor, expose};
use deepct_core::transport::{OrdinatesSettings, Solver, render};

fn main() -> Result<()> {
    let cloud = cumulus(&CumulusSettings { width_km: Some(0.5), ..Default::default() }, 3)?;
    let light = Light::realistic();
    let scene = light.scene(&cloud)?;
    let views = Formation::cloudct_10().views(cloud.grid.center(), [32, 32])?;
    let solver = Solver::Ordinates(OrdinatesSettings::default());
    let images = render(&scene, &views, &solver, &())?.images;
    let clean = Observation::new(light, views, images)?;
    let noisy = expose(&clean, &Sensor::CMV4000, Scale::BrightestAtFullWell, 1)?.observation;

    let network = Network::new(&load_weights("cloudct-10")?)?;
    let mut estimate = network.estimate(&noisy.images, &noisy.imaging_geometry()?)?;
    let expected = estimate.expected_relative_error();
    carve(&noisy, &cloud.grid, &CarveSettings::default())?.mask.apply(&mut estimate.extinction)?;

    let scores = score(&scene.medium.extinction, &estimate.extinction)?;
    println!("relative error epsilon  {:.3}", scores.relative_error);
    println!("mass error delta       {:+.3}", scores.mass_error);
    if let Some(expected) = expected {
        println!("epsilon that the network expects, before carving  {expected:.3}");
    }
    Ok(())
}
