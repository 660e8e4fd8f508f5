//! Random streams keyed by what they are for.
//!
//! One seed per run; a [`stream`] is named by its [`Purpose`] and by the numbers of
//! the thing it serves (view, pixel, ...), so a result does not depend on the number
//! of threads or on the order of work.

use rand::SeedableRng;
pub use rand::{Rng, RngExt};

/// The generator of a stream: xoshiro256++ (Blackman and Vigna 2021).
pub type Stream = rand_xoshiro::Xoshiro256PlusPlus;

/// What a random stream is for. The number enters the key, so two purposes with the
/// same indices are independent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Purpose {
    /// Cloud generation.
    Cloud = 1,
    /// Light paths.
    Transport = 2,
    /// Sensor noise.
    Sensor = 3,
    /// The choice of samples in a data set.
    Dataset = 4,
    /// The sensitivity to each voxel in an inversion.
    Inversion = 5,
    /// What a validation looks at.
    Validation = 6,
}

/// The stream of `seed` for `purpose` and `indices`.
pub fn stream(seed: u64, purpose: Purpose, indices: &[u64]) -> Stream {
    let key = indices
        .iter()
        .fold(mix(seed ^ mix(purpose as u64)), |key, &index| mix(key ^ mix(index.wrapping_add(1))));
    Stream::seed_from_u64(key)
}

/// The finaliser of SplitMix64 (Steele, Lea and Flood 2014): one bit changed in the
/// input changes half the bits of the output.
fn mix(value: u64) -> u64 {
    let mut z = value.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_differ_by_every_part_of_their_key() {
        let first = |seed, purpose, indices: &[u64]| stream(seed, purpose, indices).next_u64();
        let reference = first(1, Purpose::Transport, &[2, 3]);
        assert_eq!(reference, first(1, Purpose::Transport, &[2, 3]));
        for other in [
            first(2, Purpose::Transport, &[2, 3]),
            first(1, Purpose::Sensor, &[2, 3]),
            first(1, Purpose::Transport, &[3, 2]),
            first(1, Purpose::Transport, &[2]),
        ] {
            assert_ne!(reference, other);
        }
    }
}
