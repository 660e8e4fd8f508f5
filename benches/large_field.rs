//! Inference for a field that exceeds any cache compared with one of 256 x 256 pixels: alternating
//! measurements of the pixels per second of both, and the memory that the large field requires in
//! addition to its images and its extinction.
//!
//! `cargo run --release -p deepct-core --example large_field -- [WEIGHTS] [ROWS COLS]`

mod process_memory;

use deepct_core::network::{Network, Scratch};
use process_memory::{restart_peak, status};
use std::path::PathBuf;
use std::time::Instant;

type AnyError = Box<dyn std::error::Error>;

const TURNS: usize = 3;

/// A field on which the network is run repeatedly.
struct Field<'a> {
    network: &'a Network,
    size: [usize; 2],
    radiance: Vec<f32>,
    extinction: Vec<f32>,
    scratch: Scratch,
}

impl<'a> Field<'a> {
    fn new(network: &'a Network, size: [usize; 2]) -> Result<Self, AnyError> {
        let pixels = size[0] * size[1];
        let value = |index: usize| 0.1 * ((index * 7919 + index / 97 * 31) % 128) as f32 / 128.0;
        let radiance = (0..network.views() * pixels).map(value).collect();
        let mut extinction = vec![0.0; network.output_channels() * pixels];
        // Written once, so that the memory is allocated before the measurement.
        extinction.fill(1.0);
        let scratch = network.scratch([1, size[0], size[1]])?;
        Ok(Self { network, size, radiance, extinction, scratch })
    }

    /// Megapixels per second, averaged over `runs` runs.
    fn run(&mut self, runs: usize) -> Result<f64, AnyError> {
        let start = Instant::now();
        for _ in 0..runs {
            self.network.run(&self.radiance, &mut self.extinction, &mut self.scratch)?;
        }
        let pixels = (runs * self.size[0] * self.size[1]) as f64;
        Ok(pixels / start.elapsed().as_secs_f64() / 1e6)
    }
}

fn main() -> Result<(), AnyError> {
    let mut arguments = std::env::args().skip(1);
    let shipped =
        concat!(env!("CARGO_MANIFEST_DIR"), "/../../benches/weights/pearls-32.safetensors");
    let weights = arguments.next().map_or_else(|| PathBuf::from(shipped), PathBuf::from);
    let sides: Vec<usize> = arguments.map(|side| side.parse()).collect::<Result<_, _>>()?;
    let size = if let [rows, cols] = sides[..] { [rows, cols] } else { [2048, 2048] };
    let network = Network::new(&deepct_core::io::load_weights(weights)?)?;
    let mut small = Field::new(&network, [256, 256])?;
    small.run(1)?;
    // The peak is measured after images and extinction have been allocated.
    let mut large = Field::new(&network, size)?;
    let before = status("VmRSS:");
    let counted = restart_peak();
    large.run(1)?;
    for turn in 0..TURNS {
        let rates = [small.run(16)?, large.run(1)?];
        println!(
            "turn {turn}: 256 x 256 {:.2} Mpixel/s, {} x {} {:.2} Mpixel/s, ratio {:.3}",
            rates[0],
            size[0],
            size[1],
            rates[1],
            rates[1] / rates[0]
        );
    }
    println!("scratch {} MiB", large.scratch.bytes() >> 20);
    if counted && let (Some(before), Some(peak)) = (before, status("VmHWM:")) {
        println!("peak beyond images and extinction {} MiB", (peak - before) >> 20);
    }
    Ok(())
}
