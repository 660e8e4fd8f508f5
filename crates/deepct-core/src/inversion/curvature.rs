//! Approximate Hessian of the misfit, computed before the first iteration.

use super::Measurement;
use super::variables::Variables;
use crate::grid::Volume;
use crate::scene::View;
use crate::traverse::walk;
use std::collections::BTreeMap;

/// Square root of the smallest admissible diagonal element relative to the mean one. Smaller
/// elements are raised to this minimum, so that voxels that no pixel observes well do not change
/// excessively.
const LEAST_SENSITIVITY: f64 = 0.1;

/// Factor `share` of the two terms of the Hessian: the coupling of voxels along lines of sight, and
/// the diagonal of independent voxels. With such a small factor the prior dominates;
/// docs/notes/deterministic_solver.md compares other values.
const SHARE: f64 = 0.03;

/// Positions of the four rays through a pixel, as fractions of its sides.
const RAYS: [[f64; 2]; 4] = [[0.25, 0.25], [0.25, 0.75], [0.75, 0.25], [0.75, 0.75]];

/// Approximate Hessian of half the misfit. A pixel is assumed to observe each voxel on its lines of
/// sight with a weight that is the path length through the voxel, attenuated by the extinction in
/// front of it.
///
/// `share * (G P^T P G + D)` for the extinction: `P` contains these path lengths, one row for each
/// pixel; the diagonal matrix of gains `G` makes the diagonal of `G P^T P G` equal to the estimated
/// diagonal `D`. For the deviations of the effective radius it is `share * D`, and for its profile `D`, which is known
/// exactly: with a smaller factor, the profile moves too far in the first steps.
#[derive(Debug, Clone)]
pub(super) struct Curvature {
    /// The variables that each pixel observes, with the path length (km) over the standard error.
    lines_of_sight: Vec<Vec<(u32, f64)>>,
    gains: Vec<f64>,
    diagonal: Vec<f64>,
}

impl Curvature {
    /// Creates the Hessian from its estimated diagonal at an extinction, for the measurements and views
    /// of the bands.
    pub(super) fn new(
        bands: &[(&Measurement, &[View])],
        extinction: &Volume,
        variables: &Variables,
        mut diagonal: Vec<f64>,
    ) -> Self {
        let count = diagonal.len();
        for voxels in [variables.of_extinction(), variables.of_deviations()] {
            let values = &mut diagonal[voxels];
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            values.iter_mut().for_each(|d| *d = d.max(LEAST_SENSITIVITY.powi(2) * mean));
        }
        diagonal[variables.of_profile()].iter_mut().for_each(|d| *d /= SHARE);
        let numbers = variables.numbers();
        let line_of_sight = |view: &View, row: usize, col: usize, weight: f64| {
            let mut paths = BTreeMap::new();
            for [down, right] in RAYS {
                let ray = view.ray(row as f64 + down, col as f64 + right);
                let mut transmittance = weight / RAYS.len() as f64;
                for step in walk(&extinction.grid, &ray) {
                    let path = step.exit - step.enter;
                    if let Some(number) = numbers[step.voxel] {
                        *paths.entry(number).or_insert(0.0) += transmittance * path;
                    }
                    transmittance *= (-path * f64::from(extinction.values[step.voxel])).exp();
                }
            }
            paths.into_iter().collect()
        };
        let lines_of_sight: Vec<Vec<(u32, f64)>> = bands
            .iter()
            .flat_map(|(measurement, views)| measurement.weights().map(|at| (*views, at)))
            .map(|(views, ([view, row, col], weight))| {
                line_of_sight(&views[view], row, col, weight)
            })
            .collect();
        let mut squares = vec![0.0; count];
        for (number, path) in lines_of_sight.iter().flatten() {
            squares[*number as usize] += path * path;
        }
        // Voxels that no line of sight crosses have only a diagonal element.
        let gain = |(d, square): (&f64, f64)| if square > 0.0 { (d / square).sqrt() } else { 0.0 };
        let gains = diagonal.iter().zip(squares).map(gain).collect();
        Self { lines_of_sight, gains, diagonal }
    }

    /// The diagonal of the matrix.
    pub(super) fn diagonal(&self) -> Vec<f64> {
        self.diagonal.iter().map(|d| 2.0 * SHARE * d).collect()
    }

    /// The product of the matrix with a vector.
    pub(super) fn times(&self, vector: &[f64]) -> Vec<f64> {
        let gained: Vec<f64> = vector.iter().zip(&self.gains).map(|(v, g)| v * g).collect();
        let mut seen = vec![0.0; vector.len()];
        for line_of_sight in &self.lines_of_sight {
            let sum: f64 =
                line_of_sight.iter().map(|(number, path)| path * gained[*number as usize]).sum();
            for (number, path) in line_of_sight {
                seen[*number as usize] += path * sum;
            }
        }
        let own = self.diagonal.iter().zip(vector).map(|(d, v)| d * v);
        let seen = seen.iter().zip(&self.gains).map(|(seen, gain)| seen * gain);
        seen.zip(own).map(|(seen, own)| SHARE * (seen + own)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::radius::Profile;
    use super::super::{InversionSettings, Radius, Variable};
    use super::*;
    use crate::grid::{Grid, Mask};
    use crate::image::ViewStack;
    use crate::math::DVec3;
    use crate::scene::{Observation, Sun};

    /// A pixel observes from above two voxels of 0.5 km, of which the upper one has an optical
    /// depth of ln(2). Calculated by hand, the row of path lengths is (0.25, 0.5) km over the
    /// standard error.
    #[test]
    fn a_pixel_above_two_voxels_by_hand() {
        let corner = DVec3::new(-0.25, -0.25, 0.0);
        let grid = Grid::new(corner, DVec3::splat(0.5), [2, 1, 1]).unwrap();
        let view = View::orthographic(DVec3::Z, DVec3::new(0.0, 0.0, 0.5), 0.2, [1, 1]).unwrap();
        let seen = ViewStack::new(ndarray::array![[[1.0]]]).unwrap();
        let observation = Observation::new(Sun::default(), vec![view], seen).unwrap();
        let settings = InversionSettings { variable: Variable::Linear, ..Default::default() };
        let measurement = Measurement::new(&observation, &settings).unwrap();
        let mask = Mask::new(grid, ndarray::array![[[true]], [[true]]]).unwrap();
        let profile = Profile::new(Radius::Given, &mask);
        let shares = ndarray::array![[[1.0]], [[1.0]]];
        let variables = Variables::new(grid, &shares, &settings, profile);
        let upper = 2.0 * std::f32::consts::LN_2;
        let extinction = Volume::new(grid, ndarray::array![[[3.0]], [[upper]]]).unwrap();
        let diagonal = vec![4.0, 9.0];
        let bands = [(&measurement, &observation.views[..])];
        let curvature = Curvature::new(&bands, &extinction, &variables, diagonal);
        let [(lower, short), (higher, long)] = curvature.lines_of_sight[0][..] else {
            panic!("two voxels")
        };
        assert_eq!((lower, higher), (0, 1));
        assert!((long / short - 2.0).abs() < 1e-6, "{short} {long}");
        // One pixel observes both voxels: the matrix is the outer product of the square roots of
        // the diagonal.
        for (vector, expected) in [([1.0, 0.0], [4.0, 6.0]), ([0.0, 1.0], [6.0, 9.0])] {
            let product = curvature.times(&vector);
            for i in 0..2 {
                let own = [4.0, 9.0][i] * vector[i];
                assert!((product[i] / SHARE - own - expected[i]).abs() < 1e-6, "{product:?}");
            }
        }
        assert_eq!(curvature.diagonal(), [8.0 * SHARE, 18.0 * SHARE]);
    }
}
