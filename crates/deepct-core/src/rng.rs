//! Random number streams, each identified by its purpose.
//!
//! A run has one seed. A [`stream`] is identified by its [`Purpose`] and by the indices of the
//! object it is used for (view, pixel, ...), so a result does not depend on the number of threads
//! or on the order of computation.

use rand::SeedableRng;
pub use rand::{Rng, RngExt};

/// The generator of a stream: xoshiro256++ (Blackman and Vigna 2021).
pub type Stream = rand_xoshiro::Xoshiro256PlusPlus;

/// The purpose of a random stream. Its number enters the key, so that two purposes with the same
/// indices have independent streams.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Purpose {
    /// Cloud generation.
    Cloud = 1,
    /// Photon paths of the Monte Carlo solver.
    Transport = 2,
    /// Sensor noise.
    Sensor = 3,
    /// Selection of samples in a data set.
    Dataset = 4,
    /// Estimation of the sensitivity to each voxel in an inversion.
    Inversion = 5,
    /// Selection of test cases in a validation.
    Validation = 6,
    /// Seeds of the parts of a run.
    Seed = 7,
    /// Other noise and another prior, for the standard errors of an inversion.
    Members = 8,
}

/// The seed of the part `number` of a run with a seed. Sums would give part 1 of seed 2 and part 2
/// of seed 1 the same random numbers.
pub fn seed_of_part(seed: u64, number: u64) -> u64 {
    stream(seed, Purpose::Seed, &[number]).next_u64()
}

/// The random stream of `seed` for `purpose` and `indices`.
pub fn stream(seed: u64, purpose: Purpose, indices: &[u64]) -> Stream {
    let key = indices
        .iter()
        .fold(mix(seed ^ mix(purpose as u64)), |key, &index| mix(key ^ mix(index.wrapping_add(1))));
    Stream::seed_from_u64(key)
}

/// The finaliser of SplitMix64 (Steele, Lea and Flood 2014): changing one bit of the input changes
/// half of the bits of the output on average.
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
    fn parts_of_runs_have_seeds_of_their_own() {
        let seeds: Vec<u64> =
            (0..8).flat_map(|s| (0..8).map(move |n| seed_of_part(s, n))).collect();
        let different: std::collections::BTreeSet<u64> = seeds.iter().copied().collect();
        assert_eq!(different.len(), seeds.len());
    }

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
