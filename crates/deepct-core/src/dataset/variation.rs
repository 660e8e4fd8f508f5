//! Random variation of simulated clouds: other cloud bases, orientations, tilts and water contents.

use crate::error::{Error, Result};
use crate::math::DVec3;
use crate::rng::{Rng, RngExt};
use ndarray::{Array3, ArrayView2, ArrayView3, Axis};
use serde::{Deserialize, Serialize};

/// Ranges of the random variation of the clouds of a source before they are rendered. The values
/// for each cloud are drawn uniformly. Displacements are limited so that no part of a cloud leaves
/// the grid.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Variation {
    /// Maximum number of levels by which a cloud is raised or lowered.
    pub levels: usize,
    /// Maximum tilt: horizontal displacement per height (km per km) in a random direction, similar
    /// to the effect of wind shear.
    pub lean: f64,
    /// Minimum factor by which the liquid water content is multiplied; 1 leaves it unchanged.
    /// Smaller factors represent clouds that evaporate.
    pub least_water: f32,
    /// Whether a cloud is rotated about the vertical by a random multiple of 90 degrees and
    /// randomly mirrored, which gives eight orientations in the same scene illumination.
    pub turned: bool,
}

impl Default for Variation {
    /// No variation.
    fn default() -> Self {
        Self { levels: 0, lean: 0.0, least_water: 1.0, turned: false }
    }
}

impl Variation {
    /// Check that the values are in range.
    ///
    /// # Errors
    /// Returns an error if the tilt is negative or not finite, or if the water factor is not
    /// positive or exceeds 1.
    pub(super) fn check(&self) -> Result<()> {
        if !(self.lean >= 0.0 && self.lean.is_finite()) {
            return Err(Error::out_of_range("variation.lean", self.lean, "0 or more"));
        }
        if !(self.least_water > 0.0 && self.least_water <= 1.0) {
            let rule = "above 0 and at most 1";
            return Err(Error::out_of_range("variation.least_water", self.least_water, rule));
        }
        Ok(())
    }

    /// Draw a random variation of the liquid water `[z, y, x]` of a cloud, in voxels of size
    /// `spacing` (km), with the same number of columns along y and x.
    pub(super) fn draw(
        &self,
        water: &Array3<f32>,
        spacing: DVec3,
        rng: &mut impl Rng,
    ) -> Array3<f32> {
        let most = self.levels as i64;
        let raise = rng.random_range(-most..=most);
        let azimuth = std::f64::consts::TAU * rng.random::<f64>();
        let lean = self.lean * rng.random::<f64>();
        let kept = 1.0 - (1.0 - self.least_water) * rng.random::<f32>();
        let way = if self.turned { rng.random_range(0..8) } else { 0 };
        let water = stand(water, way);

        let wet = |k: usize| water.index_axis(Axis(0), k).iter().any(|water| *water > 0.0);
        let levels = water.len_of(Axis(0));
        let Some(base) = (0..levels).find(|k| wet(*k)) else { return water.to_owned() };
        let top = (base..levels).rev().find(|k| wet(*k)).unwrap_or(base);
        let raise = raise.clamp(-(base as i64), (levels - 1 - top) as i64);
        let mut result = Array3::zeros(water.raw_dim());
        for k in base..=top {
            let height = (k as f64 - 0.5 * (base + top) as f64) * spacing.z;
            let drift = [azimuth.cos() / spacing.y, azimuth.sin() / spacing.x]
                .map(|voxels| (lean * height * voxels).round() as i64);
            let level = water.index_axis(Axis(0), k);
            let drift = within(level, drift);
            let mut place = result.index_axis_mut(Axis(0), (k as i64 + raise) as usize);
            for ((row, col), water) in level.indexed_iter().filter(|(_, water)| **water > 0.0) {
                let at = [row, col].map(|line| line as i64);
                let [row, col] = [0, 1].map(|axis| (at[axis] + drift[axis]) as usize);
                place[[row, col]] = kept * water;
            }
        }
        result
    }
}

/// The cloud `[z, y, x]` in one of the eight symmetries of the square; 0 is the identity.
fn stand(water: &Array3<f32>, way: usize) -> ArrayView3<'_, f32> {
    let mut water = water.view();
    if way & 1 != 0 {
        water.swap_axes(1, 2);
    }
    if way & 2 != 0 {
        water.invert_axis(Axis(1));
    }
    if way & 4 != 0 {
        water.invert_axis(Axis(2));
    }
    water
}

/// Limit a horizontal displacement (rows, columns) of a level such that at least one clear line
/// remains on each side, if there was one.
fn within(level: ArrayView2<f32>, drift: [i64; 2]) -> [i64; 2] {
    [0, 1].map(|axis| {
        let lines = level.len_of(Axis(axis));
        let wet = |line: &usize| level.index_axis(Axis(axis), *line).iter().any(|w| *w > 0.0);
        let Some(first) = (0..lines).find(wet) else { return 0 };
        let last = (first..lines).rev().find(wet).unwrap_or(first);
        let before = (first as i64 - 1).max(0);
        let after = (lines as i64 - 2 - last as i64).max(0);
        drift[axis].clamp(-before, after)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, stream};
    use ndarray::s;

    const SPACING: DVec3 = DVec3::new(0.05, 0.05, 0.04);

    /// A tower of 2 x 2 columns and five levels with a different water content in each voxel.
    fn tower() -> Array3<f32> {
        Array3::from_shape_fn([12, 20, 20], |(k, j, i)| {
            let inside = (3..8).contains(&k) && (9..11).contains(&j) && (9..11).contains(&i);
            if inside { 0.1 + 0.01 * (k * 4 + (j - 9) * 2 + (i - 9)) as f32 } else { 0.0 }
        })
    }

    fn draws(variation: Variation, water: &Array3<f32>) -> Vec<Array3<f32>> {
        let mut rng = stream(3, Purpose::Dataset, &[]);
        (0..60).map(|_| variation.draw(water, SPACING, &mut rng)).collect()
    }

    fn sum(water: &Array3<f32>) -> f64 {
        water.iter().map(|water| f64::from(*water)).sum()
    }

    /// The centre of mass of the water of a level, (row, column).
    fn middle(water: &Array3<f32>, k: usize) -> [f64; 2] {
        let level = water.index_axis(Axis(0), k);
        let total: f64 = level.iter().map(|water| f64::from(*water)).sum();
        let moment = |axis: usize| {
            let terms = level
                .indexed_iter()
                .map(|((row, col), water)| f64::from(*water) * [row, col][axis] as f64);
            terms.sum::<f64>() / total
        };
        [moment(0), moment(1)]
    }

    #[test]
    fn levels_move_as_far_as_there_is_room_and_nothing_else_changes() {
        let variation = Variation { levels: 6, ..Variation::default() };
        let bases: Vec<usize> = draws(variation, &tower())
            .iter()
            .map(|cloud| {
                let wet = |k: &usize| cloud.index_axis(Axis(0), *k).iter().any(|w| *w > 0.0);
                let base = (0..12).find(wet).unwrap();
                assert_eq!(
                    cloud.slice(s![base..base + 5, .., ..]),
                    tower().slice(s![3..8, .., ..])
                );
                base
            })
            .collect();
        // Three levels are free below and four above.
        assert_eq!(bases.iter().min(), Some(&0));
        assert_eq!(bases.iter().max(), Some(&7));
    }

    #[test]
    fn a_cloud_leans_evenly_and_keeps_its_water() {
        let variation = Variation { lean: 1.5, ..Variation::default() };
        let mut farthest: f64 = 0.0;
        for cloud in draws(variation, &tower()) {
            assert!((sum(&cloud) / sum(&tower()) - 1.0).abs() < 1e-6);
            let [low, mid, high] = [3, 5, 7].map(|k| middle(&cloud, k));
            let still = middle(&tower(), 5);
            assert!((mid[0] - still[0]).abs() < 1e-6 && (mid[1] - still[1]).abs() < 1e-6);
            for axis in 0..2 {
                // The centres of mass of the levels of the tower itself differ by up to a
                // hundredth of a voxel.
                assert!((high[axis] + low[axis] - 2.0 * mid[axis]).abs() < 0.01);
            }
            let lean = (high[0] - low[0]).hypot(high[1] - low[1]) * 0.05 / (4.0 * 0.04);
            // The displacement of each level is rounded to whole voxels.
            assert!(lean < 1.5 + 0.05 * 2.0_f64.sqrt() / 0.16, "{lean}");
            farthest = farthest.max(lean);
        }
        assert!(farthest > 1.2, "{farthest}");
    }

    #[test]
    fn water_stays_inside_and_a_share_of_it_is_kept() {
        let variation = Variation { levels: 3, lean: 50.0, least_water: 0.4, turned: true };
        let shares: Vec<f64> =
            draws(variation, &tower()).iter().map(|cloud| sum(cloud) / sum(&tower())).collect();
        assert!(shares.iter().all(|share| (0.4..=1.0 + 1e-6).contains(share)), "{shares:?}");
        let mean = shares.iter().sum::<f64>() / 60.0;
        assert!((mean - 0.7).abs() < 4.0 * 0.6 / (12.0_f64.sqrt() * 60.0_f64.sqrt()), "{mean}");
    }

    #[test]
    fn a_cloud_stands_in_eight_ways_each_as_often() {
        let variation = Variation { turned: true, ..Variation::default() };
        let mut ways: Vec<(Array3<f32>, usize)> = Vec::new();
        for cloud in draws(variation, &tower()) {
            // The values of every level are only permuted.
            for k in 0..12 {
                let sorted = |cloud: &Array3<f32>| {
                    let mut level =
                        cloud.index_axis(Axis(0), k).iter().copied().collect::<Vec<_>>();
                    level.sort_by(f32::total_cmp);
                    level
                };
                assert_eq!(sorted(&cloud), sorted(&tower()));
            }
            match ways.iter_mut().find(|(way, _)| *way == cloud) {
                Some((_, count)) => *count += 1,
                None => ways.push((cloud, 1)),
            }
        }
        assert_eq!(ways.len(), 8);
        // Each of the eight orientations is expected 7.5 times in 60 draws; the bounds are four
        // standard deviations of the binomial distribution.
        assert!(ways.iter().all(|(_, count)| (1..18).contains(count)));
        assert!(ways.iter().any(|(way, _)| *way == tower()));
        let turned = Array3::from_shape_fn([12, 20, 20], |(k, j, i)| tower()[[k, i, 19 - j]]);
        assert!(ways.iter().any(|(way, _)| *way == turned));
    }

    #[test]
    fn numbers_out_of_range_are_refused() {
        let whole = Variation { levels: 1, lean: 0.2, ..Variation::default() };
        assert!(whole.check().is_ok());
        assert!(Variation { lean: -1.0, ..whole }.check().is_err());
        assert!(Variation { least_water: 0.0, ..whole }.check().is_err());
    }
}
