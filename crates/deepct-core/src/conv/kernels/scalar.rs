//! Portable: plain Rust that the compiler turns into whatever vectors the target has.

use super::for_block;
use crate::conv::im2col::{self, Panel};

/// Pixels in a panel: two vectors of four floats.
pub(super) const PIXELS: usize = 8;
/// Output channels in a block: with the pixels, 8 of 16 vectors hold sums.
pub(super) const CHANNELS: usize = 4;

/// As [`Kernel::gather`](super::Kernel::gather).
pub(super) fn gather(panel: Panel<'_>, columns: &mut [f32]) {
    im2col::gather::<PIXELS>(panel, columns);
}

/// As [`Kernel::accumulate`](super::Kernel::accumulate).
pub(super) fn accumulate(columns: &[f32], weights: &[f32], sums: &mut [f32]) {
    for_block!(sums.len() / PIXELS, block(columns, weights, sums), 1 2 3 4);
}

/// A product and a sum are rounded each: a fused operation is a slow function call on
/// targets without the instruction.
fn block<const N: usize>(columns: &[f32], weights: &[f32], sums: &mut [f32]) {
    let (columns, _) = columns.as_chunks::<PIXELS>();
    let (weights, _) = weights.as_chunks::<N>();
    let mut held = [[0.0_f32; PIXELS]; N];
    for (column, weights) in columns.iter().zip(weights) {
        for (held, weight) in held.iter_mut().zip(weights) {
            for (sum, value) in held.iter_mut().zip(column) {
                *sum += weight * value;
            }
        }
    }
    for (sum, held) in sums.iter_mut().zip(held.as_flattened()) {
        *sum += held;
    }
}
