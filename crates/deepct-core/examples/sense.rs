//! Noise of a CMV4000 sensor under uniform illumination: the standard deviation of simulated images
//! compared with the formula of the paper.
//!
//! `cargo run --release --example sense`

use deepct_core::Result;
use deepct_core::image::ViewStack;
use deepct_core::sensor::{Scale, Sensor, sense};
use ndarray::Array3;

fn main() -> Result<()> {
    let sensor = Sensor::CMV4000;
    println!("electrons   measured deviation   by the formula   signal to noise");
    for electrons in [135.0, 1350.0, 6750.0, 12_000.0] {
        let even = ViewStack::new(Array3::from_elem((1, 256, 256), electrons as f32))?;
        // A radiance of 1 corresponds to one electron here.
        let sensed = sense(&even, None, &sensor, Scale::ElectronsPerRadiance(1.0), 7)?;
        let square = |value: &f32| (f64::from(*value) - electrons).powi(2);
        let pixels = sensed.images.values.len() as f64;
        let measured = (sensed.images.values.iter().map(square).sum::<f64>() / pixels).sqrt();
        let expected = sensor.variance(electrons).sqrt();
        let ratio = electrons / measured;
        println!("{electrons:9.0}   {measured:18.2}   {expected:14.2}   {ratio:15.1}");
    }
    Ok(())
}
