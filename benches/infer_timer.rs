//! A program that times the network for another one: `compare.py` starts it once for
//! each network and size and asks for a run whenever it is this side's turn.
//!
//! `infer_timer WEIGHTS INPUT ROWS COLS OUTPUT`: INPUT and OUTPUT are raw floats,
//! `[channel, row, col]`, before and after the scales of the weights. OUTPUT is written
//! once; then each line read from standard input that holds a number runs the network
//! that often and is answered by the milliseconds of each run, as a JSON array.

use deepct_core::network::Network;
use std::io::BufRead;
use std::time::Instant;

type AnyError = Box<dyn std::error::Error>;

fn main() -> Result<(), AnyError> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [weights, input, rows, cols, output] = arguments.as_slice() else {
        return Err("infer_timer WEIGHTS INPUT ROWS COLS OUTPUT".into());
    };
    let network = Network::new(&deepct_core::io::load_weights(weights)?)?;
    let size = [rows.parse()?, cols.parse()?];
    let bytes = std::fs::read(input)?;
    let (floats, _) = bytes.as_chunks::<4>();
    let values: Vec<f32> = floats.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
    let mut result = vec![0.0; network.levels() * size[0] * size[1]];
    let mut scratch = vec![0.0; network.scratch_len(size)];
    network.run(&values, size, &mut result, &mut scratch)?;
    let bytes: Vec<u8> = result.iter().flat_map(|value: &f32| value.to_le_bytes()).collect();
    std::fs::write(output, bytes)?;
    for line in std::io::stdin().lock().lines() {
        let mut milliseconds = Vec::new();
        for _ in 0..line?.trim().parse()? {
            let start = Instant::now();
            network.run(&values, size, &mut result, &mut scratch)?;
            milliseconds.push(start.elapsed().as_secs_f64() * 1e3);
        }
        println!("{}", serde_json::to_string(&milliseconds)?);
    }
    Ok(())
}
