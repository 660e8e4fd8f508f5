//! AVX2 and FMA: 16 registers of 8 floats.

use super::for_block;
use crate::conv::im2col::{self, Panel};
use std::arch::x86_64::{
    __m256, _mm256_fmadd_ps, _mm256_loadu_ps, _mm256_set1_ps, _mm256_setzero_ps, _mm256_storeu_ps,
};

/// Vectors in a panel.
const VECTORS: usize = 2;
/// Pixels in a panel.
pub(super) const PIXELS: usize = 8 * VECTORS;
/// Output channels in a block: 12 registers hold sums, 2 columns, 2 weights.
pub(super) const CHANNELS: usize = 6;

/// As [`Kernel::gather`](super::Kernel::gather).
#[target_feature(enable = "avx2")]
pub(super) fn gather(panel: Panel<'_>, columns: &mut [f32]) {
    im2col::gather::<PIXELS>(panel, columns);
}

/// As [`Kernel::accumulate`](super::Kernel::accumulate).
#[target_feature(enable = "avx2,fma")]
pub(super) fn accumulate(columns: &[f32], weights: &[f32], sums: &mut [f32]) {
    for_block!(sums.len() / PIXELS, block(columns, weights, sums), 1 2 3 4 5 6);
}

#[target_feature(enable = "avx2,fma")]
fn block<const N: usize>(columns: &[f32], weights: &[f32], sums: &mut [f32]) {
    let (columns, _) = columns.as_chunks::<PIXELS>();
    let (weights, _) = weights.as_chunks::<N>();
    let (sums, _) = sums.as_chunks_mut::<PIXELS>();
    let mut held = [[_mm256_setzero_ps(); VECTORS]; N];
    for (held, sums) in held.iter_mut().zip(sums.iter()) {
        *held = load(sums);
    }
    for (column, weights) in columns.iter().zip(weights) {
        let column = load(column);
        for (held, weight) in held.iter_mut().zip(weights) {
            let weight = _mm256_set1_ps(*weight);
            for (sum, value) in held.iter_mut().zip(column) {
                *sum = _mm256_fmadd_ps(weight, value, *sum);
            }
        }
    }
    for (held, sums) in held.iter().zip(sums) {
        store(held, sums);
    }
}

#[allow(unsafe_code)]
#[target_feature(enable = "avx2")]
fn load(values: &[f32; PIXELS]) -> [__m256; VECTORS] {
    let (vectors, _) = values.as_chunks::<8>();
    // SAFETY: each of the vectors is 8 floats, and the load wants no alignment.
    std::array::from_fn(|index| unsafe { _mm256_loadu_ps(vectors[index].as_ptr()) })
}

#[allow(unsafe_code)]
#[target_feature(enable = "avx2")]
fn store(held: &[__m256; VECTORS], values: &mut [f32; PIXELS]) {
    let (vectors, _) = values.as_chunks_mut::<8>();
    for (vector, held) in vectors.iter_mut().zip(held) {
        // SAFETY: the target is 8 floats, and the store wants no alignment.
        unsafe { _mm256_storeu_ps(vector.as_mut_ptr(), *held) };
    }
}
