//! Scores of an estimate against the truth.
//!
//! Every function takes the truth first. Sums are accumulated in f64. The estimate may be any
//! finite field; the truth is an extinction field and must not be zero everywhere, because every
//! score is relative to it.

use crate::error::{Error, Result};
use crate::grid::{Grid, Mask, Volume};
use ndarray::{ArrayView2, Axis};
use serde::Serialize;

/// Scores of one estimate against the truth.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Scores {
    /// Relative error epsilon; see [`relative_error`].
    pub relative_error: f64,
    /// Relative error of the total extinction delta; see [`mass_error`].
    pub mass_error: f64,
    /// Root mean square difference over all voxels (1/km).
    pub root_mean_square_error: f64,
    /// Pearson correlation coefficient over all voxels; `None` if one of the two fields is
    /// constant.
    pub correlation: Option<f64>,
    /// Scores of each horizontal level, from the lowest to the highest.
    pub profile: Vec<LevelScore>,
}

/// Scores of one horizontal level.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LevelScore {
    /// Altitude of the voxel centres (km).
    pub altitude: f64,
    /// Mean extinction of the truth (1/km).
    pub truth: f64,
    /// Mean extinction of the estimate (1/km).
    pub estimate: f64,
    /// Relative error of the level; `None` if the truth is zero in the whole level.
    pub relative_error: Option<f64>,
}

/// Scores of a mask against the true cloud.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct MaskScores {
    /// Share of the total extinction that is outside the mask, which no reconstruction inside the
    /// mask can recover.
    pub extinction_missed: f64,
    /// Share of the empty voxels that are inside the mask.
    pub false_positive: f64,
    /// Share of the cloudy voxels that are outside the mask.
    pub false_negative: f64,
    /// Share of all voxels that are inside the mask.
    pub kept: f64,
}

/// The paper's relative error (Sde-Chen et al. 2021, section 5):
/// `epsilon = ||truth - estimate||_1 / ||truth||_1`.
///
/// # Errors
/// Volumes on different grids, a value that is not finite, a truth that is zero everywhere.
pub fn relative_error(truth: &Volume, estimate: &Volume) -> Result<f64> {
    check(truth, estimate)?;
    let difference: f64 =
        pairs(truth, estimate).map(|(truth, estimate)| (truth - estimate).abs()).sum();
    Ok(difference / norm(truth))
}

/// The paper's relative error of the total mass (Sde-Chen et al. 2021, section 5), positive if the
/// estimate contains too little extinction: `delta = (||truth||_1 - ||estimate||_1) / ||truth||_1`.
///
/// # Errors
/// As [`relative_error`].
pub fn mass_error(truth: &Volume, estimate: &Volume) -> Result<f64> {
    check(truth, estimate)?;
    let total = norm(truth);
    Ok((total - norm(estimate)) / total)
}

/// All scores of an estimate.
///
/// # Errors
/// As [`relative_error`].
pub fn score(truth: &Volume, estimate: &Volume) -> Result<Scores> {
    let relative_error = relative_error(truth, estimate)?;
    let square: f64 = pairs(truth, estimate).map(|(a, b)| (a - b) * (a - b)).sum();
    Ok(Scores {
        relative_error,
        mass_error: mass_error(truth, estimate)?,
        root_mean_square_error: (square / truth.grid.len() as f64).sqrt(),
        correlation: correlation(pairs(truth, estimate)),
        profile: profile(truth, estimate),
    })
}

/// Scores of `mask` against the cloud `truth`, in which every voxel with a positive extinction is
/// cloudy.
///
/// # Errors
/// A mask on another grid, a truth with a negative or non-finite value or without a positive one.
pub fn score_mask(truth: &Volume, mask: &Mask) -> Result<MaskScores> {
    check_grids(&truth.grid, &mask.grid)?;
    check_truth(truth)?;
    let (mut missed, mut cloudy, mut cloudy_outside, mut empty_inside) = (0.0, 0_usize, 0, 0);
    for (&value, &inside) in truth.values.iter().zip(&mask.values) {
        cloudy += usize::from(value > 0.0);
        match (value > 0.0, inside) {
            (true, false) => {
                missed += f64::from(value);
                cloudy_outside += 1;
            }
            (false, true) => empty_inside += 1,
            _ => {}
        }
    }
    let voxels = truth.grid.len();
    Ok(MaskScores {
        extinction_missed: missed / norm(truth),
        false_positive: share(empty_inside, voxels - cloudy),
        false_negative: share(cloudy_outside, cloudy),
        kept: share(mask.count(), voxels),
    })
}

/// `part / whole`, and 0 if `whole` is 0.
fn share(part: usize, whole: usize) -> f64 {
    if whole == 0 { 0.0 } else { part as f64 / whole as f64 }
}

fn pairs(truth: &Volume, estimate: &Volume) -> impl Iterator<Item = (f64, f64)> + Clone {
    truth.values.iter().zip(&estimate.values).map(|(&a, &b)| (f64::from(a), f64::from(b)))
}

/// The sum of absolute values.
fn norm(volume: &Volume) -> f64 {
    volume.values.iter().map(|value| f64::from(value.abs())).sum()
}

/// Pearson correlation coefficient of pairs of numbers, from sums of deviations from the mean; `None` if
/// one of both does not vary.
pub(crate) fn correlation(pairs: impl Iterator<Item = (f64, f64)> + Clone) -> Option<f64> {
    let (mut count, mut sum_a, mut sum_b) = (0.0, 0.0, 0.0);
    for (a, b) in pairs.clone() {
        count += 1.0;
        sum_a += a;
        sum_b += b;
    }
    let (mean_a, mean_b) = (sum_a / count, sum_b / count);
    let (mut aa, mut ab, mut bb) = (0.0, 0.0, 0.0);
    for (a, b) in pairs {
        let (a, b) = (a - mean_a, b - mean_b);
        aa += a * a;
        ab += a * b;
        bb += b * b;
    }
    // Numbers are treated as constant if their spread does not exceed rounding errors.
    let varies = |spread: f64, mean: f64| spread > count * (1e-12 * mean).powi(2);
    (varies(aa, mean_a) && varies(bb, mean_b)).then(|| ab / (aa * bb).sqrt())
}

fn profile(truth: &Volume, estimate: &Volume) -> Vec<LevelScore> {
    let [_, _, altitudes] = truth.grid.axes();
    let levels = truth.values.axis_iter(Axis(0)).zip(estimate.values.axis_iter(Axis(0)));
    altitudes
        .into_iter()
        .zip(levels)
        .map(|(altitude, (truth, estimate))| level_score(altitude, truth, estimate))
        .collect()
}

fn level_score(
    altitude: f64,
    truth: ArrayView2<'_, f32>,
    estimate: ArrayView2<'_, f32>,
) -> LevelScore {
    let (mut sum, mut sum_estimate, mut difference) = (0.0, 0.0, 0.0);
    for (&a, &b) in truth.iter().zip(estimate) {
        let (a, b) = (f64::from(a), f64::from(b));
        sum += a;
        sum_estimate += b;
        difference += (a - b).abs();
    }
    let count = truth.len() as f64;
    LevelScore {
        altitude,
        truth: sum / count,
        estimate: sum_estimate / count,
        relative_error: (sum > 0.0).then(|| difference / sum),
    }
}

fn check(truth: &Volume, estimate: &Volume) -> Result<()> {
    check_grids(&truth.grid, &estimate.grid)?;
    check_truth(truth)?;
    match estimate.values.indexed_iter().find(|(_, value)| !value.is_finite()) {
        None => Ok(()),
        Some(((k, j, i), value)) => Err(Error::out_of_range(
            "estimate",
            format!("{value} at voxel [z {k}, y {j}, x {i}]"),
            "finite",
        )),
    }
}

/// Returns an error unless `truth` can be compared with: finite, not negative, and positive in at
/// least one voxel.
///
/// # Errors
/// An [`Error::OutOfRange`] that names the invalid value.
pub fn check_truth(truth: &Volume) -> Result<()> {
    truth.check_non_negative("true extinction")?;
    if norm(truth) == 0.0 {
        return Err(Error::out_of_range(
            "true extinction",
            "0 everywhere",
            "positive somewhere: scores are relative to its sum",
        ));
    }
    Ok(())
}

fn check_grids(truth: &Grid, estimate: &Grid) -> Result<()> {
    if truth.matches(estimate) {
        return Ok(());
    }
    Err(Error::mismatch(
        "grids of truth and estimate",
        truth,
        estimate,
        "bring both to one grid first, with `deepct regrid` or `Volume::resampled`",
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::DVec3;
    use ndarray::{Array3, array};

    fn volume(values: Array3<f32>) -> Volume {
        let shape = [values.shape()[0], values.shape()[1], values.shape()[2]];
        Volume::new(Grid::new(DVec3::ZERO, DVec3::splat(0.5), shape).unwrap(), values).unwrap()
    }

    fn close(a: f64, b: f64) -> bool {
        (a - b).abs() < 1e-12
    }

    /// Calculated by hand: |1| + |2| + |1| + 0 of 10, masses 10 and 10 - 1 - 2 + 1.
    #[test]
    fn scores_of_four_voxels() {
        let truth = volume(array![[[1.0, 3.0]], [[0.0, 6.0]]]);
        let estimate = volume(array![[[0.0, 1.0]], [[1.0, 6.0]]]);
        let scores = score(&truth, &estimate).unwrap();
        assert!(close(scores.relative_error, 0.4));
        assert!(close(scores.mass_error, 0.2));
        assert!(close(scores.root_mean_square_error, 1.5_f64.sqrt()));
        // Deviations from the mean: (-1.5, 0.5, -2.5, 3.5) and (-2, -1, -1, 4).
        assert!(close(scores.correlation.unwrap(), 19.0 / (21.0_f64 * 22.0).sqrt()));
        let [low, high] = scores.profile[..] else { panic!("two levels") };
        assert!(close(low.altitude, 0.25) && close(high.altitude, 0.75));
        assert!(close(low.truth, 2.0) && close(low.estimate, 0.5));
        assert!(close(low.relative_error.unwrap(), 0.75));
        assert!(close(high.relative_error.unwrap(), 1.0 / 6.0));
    }

    #[test]
    fn nothing_is_wrong_by_all_of_the_truth_and_twice_the_truth_by_minus_all() {
        let truth = volume(array![[[0.0, 3.0], [4.0, 0.5]]]);
        let scores = score(&truth, &Volume::constant(truth.grid, 0.0)).unwrap();
        assert!(close(scores.relative_error, 1.0) && close(scores.mass_error, 1.0));
        assert_eq!(scores.correlation, None);
        let twice = volume(&truth.values * 2.0);
        let scores = score(&truth, &twice).unwrap();
        assert!(close(scores.relative_error, 1.0) && close(scores.mass_error, -1.0));
        assert!(close(scores.correlation.unwrap(), 1.0));
    }

    #[test]
    fn sums_do_not_lose_small_voxels() {
        let mut values = Array3::from_elem((64, 64, 64), 1e-4_f32);
        values[[0, 0, 0]] = 1e6;
        let truth = volume(values.clone());
        values.map_inplace(|value| *value *= 2.0);
        values[[0, 0, 0]] = 1e6;
        let small = f64::from(1e-4_f32) * (64.0_f64.powi(3) - 1.0);
        let expected = small / (1e6 + small);
        let found = relative_error(&truth, &volume(values)).unwrap();
        assert!((found / expected - 1.0).abs() < 1e-9, "{found} {expected}");
    }

    #[test]
    fn a_mask_of_half_a_cloud() {
        let truth = volume(array![[[0.0, 3.0, 1.0, 0.0]]]);
        let mask = Mask::new(truth.grid, array![[[true, true, false, false]]]).unwrap();
        let scores = score_mask(&truth, &mask).unwrap();
        assert!(close(scores.extinction_missed, 0.25) && close(scores.kept, 0.5));
        assert!(close(scores.false_positive, 0.5) && close(scores.false_negative, 0.5));
    }

    #[test]
    fn what_cannot_be_compared_is_refused() {
        let truth = volume(array![[[1.0, 2.0]]]);
        let mut moved = truth.clone();
        moved.grid.origin.x = 0.1;
        for wrong in [moved, volume(array![[[1.0, 2.0, 3.0]]]), volume(array![[[1.0, f32::NAN]]])] {
            assert!(score(&truth, &wrong).is_err(), "{wrong:?}");
        }
        assert!(score(&Volume::constant(truth.grid, 0.0), &truth).is_err());
        assert!(score(&volume(array![[[-1.0, 2.0]]]), &truth).is_err());
    }
}
