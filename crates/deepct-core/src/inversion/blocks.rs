//! Grids of blocks of voxels, and interpolation of fields between them.

use crate::error::Result;
use crate::grid::{Grid, Mask, Volume};
use ndarray::{Array3, s};

/// The grid whose voxels are blocks of `block` x `block` x `block` voxels of `grid`. If `block`
/// does not divide the shape, the last blocks extend beyond the upper sides of `grid`.
///
/// # Errors
/// None if `block` is not 0.
pub(super) fn coarsen(grid: &Grid, block: usize) -> Result<Grid> {
    let shape = grid.shape.map(|count| count.div_ceil(block));
    Grid::new(grid.origin, grid.spacing * block as f64, shape)
}

/// Sums over the voxels of each block.
fn sums(values: &Array3<f32>, block: usize, shape: [usize; 3]) -> Array3<f64> {
    let mut sums = Array3::zeros(shape);
    for ((k, j, i), &value) in values.indexed_iter() {
        sums[[k / block, j / block, i / block]] += f64::from(value);
    }
    sums
}

/// The volume fraction of each block that is inside a mask.
pub(super) fn shares(mask: &Mask, block: usize, shape: [usize; 3]) -> Array3<f64> {
    let volume = (block * block * block) as f64;
    sums(&mask.values.mapv(|inside| f32::from(u8::from(inside))), block, shape) / volume
}

/// The mean of a volume over the voxels of each block that are inside the mask; 0 for a block
/// without such voxels.
///
/// # Errors
/// None if `block` is not 0.
pub(super) fn means(volume: &Volume, mask: &Mask, block: usize) -> Result<Volume> {
    let grid = coarsen(&volume.grid, block)?;
    let mut inside = volume.clone();
    mask.apply(&mut inside)?;
    let weights = shares(mask, block, grid.shape);
    let cells = (block * block * block) as f64;
    let mut means = sums(&inside.values, block, grid.shape);
    means.zip_mut_with(&weights, |sum, share| {
        *sum = if *share > 0.0 { *sum / (share * cells) } else { 0.0 };
    });
    Volume::new(grid, means.mapv(|mean| mean as f32))
}

/// Interpolates a field of blocks to the voxels of a finer grid: linearly between the centres of
/// the blocks that have a positive share of the mask.
///
/// # Errors
/// None for volumes on grids of this module.
pub(super) fn refine(coarse: &Volume, shares: &Array3<f64>, fine: &Grid) -> Result<Volume> {
    let block = (coarse.grid.spacing.x / fine.spacing.x).round() as usize;
    let mut weighted = shares.clone();
    weighted.zip_mut_with(&coarse.values, |share, value| *share *= f64::from(*value));
    let (mut values, mut weights) = (weighted, shares.clone());
    for axis in 0..3 {
        values = refine_axis(&values, axis, block, fine.shape[axis]);
        weights = refine_axis(&weights, axis, block, fine.shape[axis]);
    }
    values.zip_mut_with(&weights, |value, weight| {
        *value = if *weight > 0.0 { *value / weight } else { 0.0 };
    });
    Volume::new(*fine, values.mapv(|value| value as f32))
}

/// Interpolates linearly along one axis to voxels of 1 / `block` of the length.
fn refine_axis(values: &Array3<f64>, axis: usize, block: usize, count: usize) -> Array3<f64> {
    let axis = ndarray::Axis(axis);
    let mut shape = values.raw_dim();
    shape[axis.0] = count;
    let mut fine = Array3::zeros(shape);
    let last = values.len_of(axis) - 1;
    for (index, mut line) in fine.axis_iter_mut(axis).enumerate() {
        let at = ((index as f64 + 0.5) / block as f64 - 0.5).clamp(0.0, last as f64);
        let below = (at.floor() as usize).min(last);
        let above = (below + 1).min(last);
        let share = at - below as f64;
        let (low, high) = (values.index_axis(axis, below), values.index_axis(axis, above));
        line.assign(&(&low * (1.0 - share) + &high * share));
    }
    fine
}

/// The mean over each value and its neighbours within one voxel along every axis, of those that are
/// `counted`.
pub(super) fn smooth(values: &Array3<f64>, counted: &Array3<bool>) -> Array3<f64> {
    let [nz, ny, nx] = [0, 1, 2].map(|axis| values.shape()[axis]);
    let around = |at: usize, count: usize| at.saturating_sub(1)..(at + 2).min(count);
    Array3::from_shape_fn(values.raw_dim(), |(k, j, i)| {
        let window = s![around(k, nz), around(j, ny), around(i, nx)];
        let (mut sum, mut count) = (0.0, 0.0);
        for (value, counted) in values.slice(window).iter().zip(counted.slice(window)) {
            if *counted {
                sum += value;
                count += 1.0;
            }
        }
        if count > 0.0 { sum / count } else { 0.0 }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::DVec3;

    fn grid(shape: [usize; 3]) -> Grid {
        Grid::new(DVec3::new(0.1, 0.2, 0.5), DVec3::new(0.02, 0.03, 0.04), shape).unwrap()
    }

    #[test]
    fn blocks_keep_the_mean_of_what_is_inside() {
        let grid = grid([4, 5, 6]);
        let values = Array3::from_shape_fn(grid.shape, |(k, j, i)| (k + 2 * j + 3 * i) as f32);
        let volume = Volume::new(grid, values).unwrap();
        let inside = Array3::from_shape_fn(grid.shape, |(k, j, i)| (k + j + i) % 3 != 0);
        let mask = Mask::new(grid, inside).unwrap();
        let coarse = means(&volume, &mask, 2).unwrap();
        assert_eq!(coarse.grid.shape, [2, 3, 3]);
        let shares = shares(&mask, 2, coarse.grid.shape);
        let kept: f64 = coarse
            .values
            .iter()
            .zip(&shares)
            .map(|(mean, share)| f64::from(*mean) * share * 8.0)
            .sum();
        let pairs = volume.values.iter().zip(&mask.values);
        let expected: f64 = pairs.filter(|(_, inside)| **inside).map(|(v, _)| f64::from(*v)).sum();
        assert!((kept / expected - 1.0).abs() < 1e-6, "{kept} {expected}");
    }

    /// A linear field is reproduced, except within half a block of the sides.
    #[test]
    fn a_linear_field_is_refined_to_itself() {
        let grid = grid([8, 12, 16]);
        let point = |[k, j, i]: [usize; 3]| grid.voxel_center([k, j, i]);
        let linear = |p: DVec3| (3.0 + 5.0 * p.x + 7.0 * p.y + 2.0 * p.z) as f32;
        let values = Array3::from_shape_fn(grid.shape, |(k, j, i)| linear(point([k, j, i])));
        let volume = Volume::new(grid, values).unwrap();
        let mask = Mask::new(grid, Array3::from_elem(grid.shape, true)).unwrap();
        let coarse = means(&volume, &mask, 4).unwrap();
        let all = shares(&mask, 4, coarse.grid.shape);
        let fine = refine(&coarse, &all, &grid).unwrap();
        for ((k, j, i), value) in fine.values.indexed_iter() {
            if (2..6).contains(&k) && (2..10).contains(&j) && (2..14).contains(&i) {
                assert!((value - volume.values[[k, j, i]]).abs() < 1e-4, "{k} {j} {i}");
            }
        }
    }

    #[test]
    fn a_constant_stays_one_where_blocks_are_empty() {
        let grid = grid([6, 6, 6]);
        let inside = Array3::from_shape_fn(grid.shape, |(k, j, i)| k < 3 && j < 4 && i > 1);
        let mask = Mask::new(grid, inside).unwrap();
        let coarse = means(&Volume::constant(grid, 7.0), &mask, 3).unwrap();
        let shares = shares(&mask, 3, coarse.grid.shape);
        let fine = refine(&coarse, &shares, &grid).unwrap();
        for (value, inside) in fine.values.iter().zip(&mask.values) {
            assert!(!inside || (value - 7.0).abs() < 1e-5, "{value}");
        }
        let ones = Array3::from_elem(grid.shape, 1.0);
        let smoothed = smooth(&ones, &mask.values);
        assert!(smoothed.iter().zip(&mask.values).all(|(v, inside)| !inside || *v == 1.0));
    }
}
