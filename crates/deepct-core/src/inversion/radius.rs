//! Variables of the effective radius: a vertical profile, and deviations from it.

use super::Radius;
use crate::error::Result;
use crate::grid::{Grid, Mask, Volume};
use crate::optics::TABLE_RADII;
use ndarray::Array3;

/// Unit of the variables of the logarithm of a radius, and of that of the altitude of the cloud base
/// (km). As for the extinction, a change by 1 is small.
pub(super) const LOGARITHM: f64 = 0.05;
const ALTITUDE: f64 = 0.02;
/// Radius (um) at the reference altitude that the prior expects, with a standard error of a factor of
/// 1.65; it is also the start.
const EXPECTED: f64 = 10.0;
/// Standard error of both variables of the profile in the prior: 0.5 in the logarithm of the radius,
/// and 0.2 km in the altitude of the base.
pub(super) const PROFILE_ERROR: f64 = 10.0;
/// Height of the reference altitude, and largest height of the base, above the bottom of the mask,
/// relative to the height of its top.
const REFERENCE: f64 = 0.6;
const HIGHEST_BASE: f64 = 0.45;
/// Largest distance of the base below the bottom of the mask (km).
const DEEPEST_BASE: f64 = 1.0;
/// Height above the base at which a profile ends, relative to that of a voxel: the radius is constant
/// below.
const LEAST_HEIGHT: f64 = 0.25;

/// A profile of the effective radius with altitude, for the variables of the optimiser.
///
/// The first variable is the logarithm of the radius at a reference altitude. The second one, if there
/// is one, is the altitude of the cloud base, above which the volume of a droplet increases linearly,
/// as in an adiabatic cloud with a constant number of droplets.
#[derive(Debug, Clone, Copy)]
pub(super) struct Profile {
    kind: Radius,
    /// Altitudes of the bottom of the mask and of the reference (km).
    bottom: f64,
    reference: f64,
    height: f64,
    /// Height above the base below which the radius is constant (km).
    least: f64,
}

/// The effective radius at an altitude, and its derivatives.
#[derive(Debug, Clone, Copy)]
pub(super) struct RadiusAt {
    /// The effective radius (um).
    pub(super) radius: f64,
    /// Derivatives with respect to the variables of the profile, and to that of the deviation.
    pub(super) by_profile: [f64; 2],
    pub(super) by_deviation: f64,
}

/// The radius of a voxel, as the logarithm of its ratio to the expected one.
struct KnownRadius {
    voxel: [usize; 3],
    altitude: f64,
    logarithm: f64,
    /// The extinction.
    weight: f64,
}

impl Profile {
    /// The profile of a cloud inside a mask.
    pub(super) fn new(kind: Radius, mask: &Mask) -> Self {
        let inside = mask.values.indexed_iter().filter(|(_, inside)| **inside);
        let levels = inside.map(|((level, ..), _)| level);
        let [first, last] = levels
            .fold([usize::MAX, 0], |[first, last], level| [first.min(level), last.max(level)]);
        let face = |level: usize| mask.grid.origin.z + level as f64 * mask.grid.spacing.z;
        let bottom = face(first.min(last));
        let height = face(last + 1) - bottom;
        let reference = bottom + REFERENCE * height;
        Self { kind, bottom, reference, height, least: LEAST_HEIGHT * mask.grid.spacing.z }
    }

    /// Number of variables of the profile.
    pub(super) fn len(&self) -> usize {
        match self.kind {
            Radius::Given => 0,
            Radius::Uniform => 1,
            Radius::Adiabatic | Radius::Field => 2,
        }
    }

    /// Whether the radius of each voxel may deviate from the profile.
    pub(super) fn has_deviations(&self) -> bool {
        self.kind == Radius::Field
    }

    /// The same profile without deviations.
    pub(super) fn alone(self) -> Self {
        match self.kind {
            Radius::Field => Self { kind: Radius::Adiabatic, ..self },
            _ => self,
        }
    }

    /// Lower and upper bound of each variable.
    pub(super) fn bounds(&self) -> Vec<[f64; 2]> {
        let radius = TABLE_RADII.map(|radius| (radius / EXPECTED).ln() / LOGARITHM);
        let base = [-DEEPEST_BASE, HIGHEST_BASE * self.height].map(|height| height / ALTITUDE);
        [radius, base].into_iter().take(self.len()).collect()
    }

    /// Bounds of a deviation: a factor of 2.
    pub(super) fn deviation_bounds() -> [f64; 2] {
        [-2_f64.ln(), 2_f64.ln()].map(|logarithm| logarithm / LOGARITHM)
    }

    /// The effective radius (um) of each voxel of a grid, for the variables of the profile and of the
    /// deviations; `None` if it is given.
    ///
    /// # Errors
    /// None for deviations on the grid.
    pub(super) fn volume(
        &self,
        grid: &Grid,
        profile: &[f64],
        deviations: &Array3<f64>,
    ) -> Result<Option<Volume>> {
        if self.kind == Radius::Given {
            return Ok(None);
        }
        let radius = |((k, j, i), deviation): ((usize, usize, usize), &f64)| {
            self.at(grid.voxel_center([k, j, i]).z, profile, *deviation).radius as f32
        };
        let radii = deviations.indexed_iter().map(radius).collect();
        let radii = Array3::from_shape_vec(deviations.raw_dim(), radii).expect("the same shape");
        Volume::new(*grid, radii).map(Some)
    }

    /// The effective radius at an altitude (km) for the variables of the profile and a deviation.
    pub(super) fn at(&self, altitude: f64, profile: &[f64], deviation: f64) -> RadiusAt {
        let (shape, by_base) =
            profile.get(1).map_or((0.0, 0.0), |base| self.shape(altitude, *base));
        let radius = EXPECTED * (LOGARITHM * (profile[0] + deviation) + shape).exp();
        let [least, most] = TABLE_RADII;
        let slope = if (least..=most).contains(&radius) { radius } else { 0.0 };
        RadiusAt {
            radius: radius.clamp(least, most),
            by_profile: [slope * LOGARITHM, slope * by_base],
            by_deviation: slope * LOGARITHM,
        }
    }

    /// The logarithm of the ratio of the radius at an altitude (km) to that at the reference, for the
    /// variable of the altitude of the base, and its derivative.
    fn shape(&self, altitude: f64, base: f64) -> (f64, f64) {
        let base = self.bottom + ALTITUDE * base;
        let above = |altitude: f64| (altitude - base).max(0.0) + self.least;
        let slope = |at: f64| if at > base { above(at).recip() } else { 0.0 };
        let by_base = ALTITUDE * (slope(self.reference) - slope(altitude)) / 3.0;
        ((above(altitude) / above(self.reference)).ln() / 3.0, by_base)
    }

    /// The variables of the profile that is nearest to given radii (um) in the mean square of the
    /// logarithm, weighted by the extinction, and the deviations of the radii from it. Voxels without
    /// extinction or radius do not deviate.
    pub(super) fn nearest(&self, radius: &Volume, extinction: &Volume) -> (Vec<f64>, Array3<f64>) {
        let mut deviations = Array3::zeros(radius.values.raw_dim());
        let pairs = radius.values.indexed_iter().zip(&extinction.values);
        let known: Vec<KnownRadius> = pairs
            .filter(|((_, radius), extinction)| **radius > 0.0 && **extinction > 0.0)
            .map(|(((k, j, i), &value), &extinction)| KnownRadius {
                voxel: [k, j, i],
                altitude: radius.grid.voxel_center([k, j, i]).z,
                logarithm: (f64::from(value) / EXPECTED).ln(),
                weight: f64::from(extinction),
            })
            .collect();
        let bounds = self.bounds();
        let (Some(&[least, most]), false) = (bounds.first(), known.is_empty()) else {
            return (vec![0.0; self.len()], deviations);
        };
        let total: f64 = known.iter().map(|one| one.weight).sum();
        // The mean square for a base and the best logarithm, which is the mean of the differences.
        let fit = |base: Option<f64>| {
            let above = |one: &KnownRadius| base.map_or(0.0, |b| self.shape(one.altitude, b).0);
            let differences: Vec<f64> =
                known.iter().map(|one| one.logarithm - above(one)).collect();
            let pairs = || known.iter().zip(&differences);
            let mean = pairs().map(|(one, value)| one.weight * value).sum::<f64>() / total;
            let square = |(one, value): (&KnownRadius, &f64)| one.weight * (value - mean).powi(2);
            (pairs().map(square).sum::<f64>(), base, mean, differences)
        };
        let bases: Vec<Option<f64>> = match bounds.get(1) {
            None => vec![None],
            Some([lowest, highest]) => {
                (lowest.ceil() as i64..=highest.floor() as i64).map(|n| Some(n as f64)).collect()
            }
        };
        let fits = bases.into_iter().map(fit);
        let Some((_, base, mean, differences)) = fits.min_by(|a, b| a.0.total_cmp(&b.0)) else {
            return (vec![0.0; self.len()], deviations);
        };
        let first = (mean / LOGARITHM).clamp(least, most);
        if self.has_deviations() {
            let [least, most] = Self::deviation_bounds();
            for (one, difference) in known.iter().zip(differences) {
                deviations[one.voxel] = (difference / LOGARITHM - first).clamp(least, most);
            }
        }
        (std::iter::once(first).chain(base).collect(), deviations)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::DVec3;

    fn profile(kind: Radius) -> Profile {
        let grid = Grid::new(DVec3::new(0.0, 0.0, 0.5), DVec3::splat(0.05), [12, 1, 1]).unwrap();
        let inside = Array3::from_shape_fn(grid.shape, |(level, ..)| level >= 2);
        Profile::new(kind, &Mask::new(grid, inside).unwrap())
    }

    /// From 40 m above the base to eight times this height, the radius doubles.
    #[test]
    fn the_volume_of_a_droplet_increases_with_height() {
        let adiabatic = Profile { least: 0.0, ..profile(Radius::Adiabatic) };
        let base = 0.62;
        let variables = [2.0, (base - 0.6) / ALTITUDE];
        let at = |height: f64| adiabatic.at(base + height, &variables, 0.0).radius;
        assert!((at(0.32) / at(0.04) - 2.0).abs() < 1e-12);
        let reference = adiabatic.at(0.6 + 0.6 * 0.5, &variables, 0.0).radius;
        assert!((reference - 10.0 * 0.1_f64.exp()).abs() < 1e-12);
        let uniform = profile(Radius::Uniform);
        assert_eq!(uniform.at(0.6, &[0.0], 0.0).radius, uniform.at(1.1, &[0.0], 0.0).radius);
    }

    /// Radii of a profile and of a profile with deviations are found again, wherever there is extinction;
    /// a uniform radius is the weighted geometric mean.
    #[test]
    fn the_nearest_profile_is_that_of_the_radii() {
        let grid = Grid::new(DVec3::new(0.0, 0.0, 0.5), DVec3::splat(0.05), [12, 1, 2]).unwrap();
        let is_cloudy = |k: usize, i: usize| k >= 2 && !(k + i).is_multiple_of(3);
        let extinction = Array3::from_shape_fn(grid.shape, |(k, _, i)| {
            if is_cloudy(k, i) { (1 + k + i) as f32 } else { 0.0 }
        });
        let extinction = Volume::new(grid, extinction).unwrap();
        let mut expected = Array3::zeros(grid.shape);
        for kind in [Radius::Uniform, Radius::Adiabatic, Radius::Field] {
            let profile = profile(kind);
            let variables = &[3.5, -4.0][..profile.len()];
            let radii = profile.volume(&grid, variables, &expected).unwrap().unwrap();
            let (found, deviations) = profile.nearest(&radii, &extinction);
            assert_eq!(found.len(), variables.len());
            for (found, variable) in found.iter().zip(variables) {
                assert!((found - variable).abs() < 1e-4, "{kind:?}: {found} {variable}");
            }
            assert!(deviations.iter().all(|deviation| deviation.abs() < 1e-4));
        }
        // Deviations are what the profile leaves, so that the radii are the same.
        let profile = profile(Radius::Field);
        expected[[5, 0, 1]] = 3.0;
        let radii = profile.volume(&grid, &[3.5, -4.0], &expected).unwrap().unwrap();
        let (found, deviations) = profile.nearest(&radii, &extinction);
        let again = profile.volume(&grid, &found, &deviations).unwrap().unwrap();
        for (((k, _, i), again), radius) in again.values.indexed_iter().zip(&radii.values) {
            assert!(!is_cloudy(k, i) || (again / radius - 1.0).abs() < 1e-5);
        }
        let nothing = profile.nearest(&radii, &Volume::constant(grid, 0.0));
        assert_eq!(nothing, (vec![0.0; 2], Array3::zeros(grid.shape)));
    }

    #[test]
    fn radii_have_their_derivatives() {
        for kind in [Radius::Uniform, Radius::Adiabatic, Radius::Field] {
            let profile = profile(kind);
            for altitude in [0.625, 0.8, 1.07] {
                let x = [1.5, 2.7, -2.0];
                let at = |x: [f64; 3]| profile.at(altitude, &x[..profile.len()], x[2]);
                let found = at(x);
                let slopes = [found.by_profile[0], found.by_profile[1], found.by_deviation];
                for (n, slope) in slopes.into_iter().enumerate() {
                    let moved = |step: f64| {
                        let mut x = x;
                        x[n] += step;
                        at(x).radius
                    };
                    let difference = (moved(1e-5) - moved(-1e-5)) / 2e-5;
                    assert!((slope - difference).abs() < 1e-6, "{kind:?}: {slope} {difference}");
                }
            }
        }
        let large = profile(Radius::Uniform).at(0.8, &[30.0], 0.0);
        assert_eq!((large.radius, large.by_deviation), (25.0, 0.0));
    }
}
