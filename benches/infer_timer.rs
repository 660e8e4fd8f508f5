//! Timing of the network for `compare.py`, which starts this program once for each network and size
//! and requests runs when it is the turn of deepct.
//!
//! `infer_timer WEIGHTS INPUT BATCH ROWS COLS OUTPUT`: INPUT contains the radiance
//! `[cloud, view, row, col]` and OUTPUT the extinction `[cloud, level, row, col]` as raw 32-bit
//! floats. The program writes OUTPUT once. It then reads a number from each line of standard input,
//! runs the network this number of times and prints the milliseconds of each run as a JSON array.
//!
//! DEEPCT_KERNEL, DEEPCT_ALGORITHM and DEEPCT_PRECISION select the kernel, algorithm and precision
//! (see `conv::Settings`).

use deepct_core::conv::{Algorithm, Kernel, Precision, Settings};
use deepct_core::network::Network;
use std::io::BufRead;
use std::time::Instant;

type AnyError = Box<dyn std::error::Error>;

fn main() -> Result<(), AnyError> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [weights, input, batch, rows, cols, output] = arguments.as_slice() else {
        return Err("infer_timer WEIGHTS INPUT BATCH ROWS COLS OUTPUT".into());
    };
    let network = Network::with_settings(&deepct_core::io::load_weights(weights)?, settings()?)?;
    let [batch, rows, cols] = [batch.parse()?, rows.parse()?, cols.parse()?];
    let bytes = std::fs::read(input)?;
    let (floats, _) = bytes.as_chunks::<4>();
    let values: Vec<f32> = floats.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
    let mut result = vec![0.0; batch * network.output_channels() * rows * cols];
    let mut scratch = network.scratch([batch, rows, cols])?;
    network.run(&values, &mut result, &mut scratch)?;
    let bytes: Vec<u8> = result.iter().flat_map(|value: &f32| value.to_le_bytes()).collect();
    std::fs::write(output, bytes)?;
    for line in std::io::stdin().lock().lines() {
        let mut milliseconds = Vec::new();
        for _ in 0..line?.trim().parse()? {
            let start = Instant::now();
            network.run(&values, &mut result, &mut scratch)?;
            milliseconds.push(start.elapsed().as_secs_f64() * 1e3);
        }
        println!("{}", serde_json::to_string(&milliseconds)?);
    }
    Ok(())
}

fn settings() -> Result<Settings, AnyError> {
    let mut settings = Settings::default();
    if let Some(name) = chosen("DEEPCT_KERNEL") {
        settings.kernel = Kernel::from_name(&name)?;
    }
    if let Some(name) = chosen("DEEPCT_ALGORITHM") {
        settings.algorithm = Some(Algorithm::from_name(&name)?);
    }
    if let Some(name) = chosen("DEEPCT_PRECISION") {
        settings.precision = Precision::from_name(&name)?;
    }
    Ok(settings)
}

fn chosen(variable: &str) -> Option<String> {
    std::env::var(variable).ok().filter(|name| name != "auto")
}
