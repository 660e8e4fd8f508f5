//! A field too large for any cache, beside one of 256 x 256: the pixels a second of both in
//! turns, and the memory that the larger one takes beyond its images and its extinction.
//!
//! `cargo run --release -p deepct-core --example large_field -- [WEIGHTS] [ROWS COLS]`

use deepct_core::network::Network;
use std::path::PathBuf;
use std::time::Instant;

type AnyError = Box<dyn std::error::Error>;

const TURNS: usize = 3;

/// A field that the network runs on again and again.
struct Field<'a> {
    network: &'a Network,
    size: [usize; 2],
    radiance: Vec<f32>,
    extinction: Vec<f32>,
}

impl<'a> Field<'a> {
    fn new(network: &'a Network, size: [usize; 2]) -> Self {
        let pixels = size[0] * size[1];
        let value = |index: usize| 0.1 * ((index * 7919 + index / 97 * 31) % 128) as f32 / 128.0;
        let radiance = (0..network.views() * pixels).map(value).collect();
        let mut extinction = vec![0.0; network.levels() * pixels];
        // Written once, so that the memory is there before anything is measured.
        extinction.fill(1.0);
        Self { network, size, radiance, extinction }
    }

    /// Megapixels a second of `runs` runs, scratch included, and bytes of scratch.
    fn run(&mut self, runs: usize) -> Result<(f64, usize), AnyError> {
        let start = Instant::now();
        let [rows, cols] = self.size;
        let mut scratch = self.network.scratch([1, rows, cols])?;
        for _ in 0..runs {
            self.network.run(&self.radiance, &mut self.extinction, &mut scratch)?;
        }
        let seconds = start.elapsed().as_secs_f64();
        Ok(((runs * rows * cols) as f64 / seconds / 1e6, scratch.bytes()))
    }
}

fn main() -> Result<(), AnyError> {
    let mut arguments = std::env::args().skip(1);
    let shipped =
        concat!(env!("CARGO_MANIFEST_DIR"), "/../../benches/weights/pearls-32.safetensors");
    let weights = arguments.next().map_or_else(|| PathBuf::from(shipped), PathBuf::from);
    let sides: Vec<usize> = arguments.map(|side| side.parse()).collect::<Result<_, _>>()?;
    let large = if let [rows, cols] = sides[..] { [rows, cols] } else { [2048, 2048] };
    let network = Network::new(&deepct_core::io::load_weights(weights)?)?;
    let mut fields = [Field::new(&network, [256, 256]), Field::new(&network, large)];
    fields[0].run(1)?;
    let before = status("VmRSS:");
    // The peak is counted from here on.
    let counted = std::fs::write("/proc/self/clear_refs", "5").is_ok();
    for turn in 0..TURNS {
        let (small, _) = fields[0].run(8)?;
        let (rate, scratch) = fields[1].run(1)?;
        println!(
            "turn {turn}: 256 x 256 {small:.2} Mpixel/s, {} x {} {rate:.2} Mpixel/s, ratio {:.3}; \
             scratch {} MiB",
            large[0],
            large[1],
            rate / small,
            scratch >> 20
        );
    }
    if counted && let (Some(before), Some(peak)) = (before, status("VmHWM:")) {
        println!("peak beyond images and extinction {} MiB", (peak - before) >> 10);
    }
    Ok(())
}

/// A line of what Linux tells of this process, in KiB.
fn status(name: &str) -> Option<usize> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    line.split_whitespace().next()?.parse().ok()
}
