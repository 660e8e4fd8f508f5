//! Phase functions: the probability density of the direction of scattering.
//!
//! Phase functions are normalised to an integral of 1 over the sphere. Their argument is the cosine
//! of the angle between the directions of propagation before and after scattering, so the forward
//! direction is +1.

use crate::error::{Error, Result};
use std::f64::consts::PI;
use std::sync::Arc;

/// A phase function (1/sr) that can be evaluated and sampled.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum PhaseFunction {
    /// Isotropic scattering.
    Isotropic,
    /// Henyey and Greenstein (1941), with an asymmetry parameter in (-1, 1).
    HenyeyGreenstein {
        /// Asymmetry parameter, the mean cosine of the scattering angle.
        asymmetry: f64,
    },
    /// Scattering by molecules (Chandrasekhar 1950, section 49):
    /// `a 3 (1 + cos^2) / (16 pi) + (1 - a) / (4 pi)` with `a = (2 - 2 d) / (2 + d)`, where `d` is
    /// the depolarisation factor of light scattered at a right angle.
    Rayleigh {
        /// Depolarisation factor for unpolarised light, in `[0, 1)`: 0 for isotropic molecules,
        /// 0.028 for air.
        depolarisation: f64,
    },
    /// Tabulated values, piecewise linear in the cosine.
    Tabulated(Arc<PhaseTable>),
}

/// A phase function tabulated by the cosine of the scattering angle, with its cumulative
/// distribution.
#[derive(Debug, Clone, PartialEq)]
pub struct PhaseTable {
    cosines: Vec<f64>,
    densities: Vec<f64>,
    cumulative: Vec<f64>,
    by_cosine: Guide,
    by_cumulative: Guide,
}

/// A guide table that speeds up the search in an ascending list (Chen and Asau 1974): the range of
/// values is divided into buckets, for each of which the indices of its entries are stored.
#[derive(Debug, Clone, PartialEq)]
struct Guide {
    /// Number of entries before each bucket, followed by the number of all entries.
    starts: Vec<u32>,
}

impl Guide {
    const BUCKETS: usize = 1024;

    /// The guide to `entries`. `bucket` must be a non-decreasing function.
    fn new(entries: &[f64], bucket: fn(f64) -> usize) -> Self {
        let before = |number| entries.partition_point(|entry| bucket(*entry) < number) as u32;
        Self { starts: (0..=Self::BUCKETS).map(before).collect() }
    }

    /// The index of the last entry that is not above `value`, at most that of the last but one.
    #[inline]
    fn find(&self, entries: &[f64], bucket: usize, value: f64) -> usize {
        let [low, high] = [bucket, bucket + 1].map(|number| self.starts[number] as usize);
        let above = low + entries[low..high].partition_point(|entry| *entry <= value);
        above.saturating_sub(1).min(entries.len() - 2)
    }

    /// The bucket of a number in `[0, 1]`.
    #[inline]
    fn bucket(position: f64) -> usize {
        ((position * Self::BUCKETS as f64) as usize).min(Self::BUCKETS - 1)
    }

    /// The bucket of a cosine. The buckets are narrow near the forward and backward directions,
    /// where tables have most of their entries.
    #[inline]
    fn cosine_bucket(cosine: f64) -> usize {
        let root = (1.0 - cosine.abs()).max(0.0).sqrt();
        Self::bucket(0.5 * if cosine < 0.0 { root } else { 2.0 - root })
    }
}

/// Smallest asymmetry parameter of scattering that is not treated as isotropic.
const NEARLY_ISOTROPIC: f64 = 1e-6;

impl PhaseFunction {
    /// A Henyey-Greenstein phase function, isotropic for an asymmetry parameter below 1e-6.
    ///
    /// # Errors
    /// Returns an error if the asymmetry parameter is outside (-1, 1).
    pub fn henyey_greenstein(asymmetry: f64) -> Result<Self> {
        if asymmetry.is_nan() || asymmetry.abs() >= 1.0 {
            return Err(Error::out_of_range("asymmetry", asymmetry, "between -1 and 1"));
        }
        // The inversion of the cumulative distribution divides by the asymmetry parameter.
        let isotropic = asymmetry.abs() < NEARLY_ISOTROPIC;
        Ok(if isotropic { Self::Isotropic } else { Self::HenyeyGreenstein { asymmetry } })
    }

    /// The phase function of molecules with the given depolarisation factor.
    ///
    /// # Errors
    /// Returns an error if the factor is outside `[0, 1)`.
    pub fn rayleigh(depolarisation: f64) -> Result<Self> {
        if !(0.0..1.0).contains(&depolarisation) {
            return Err(Error::out_of_range("depolarisation", depolarisation, "in [0, 1)"));
        }
        Ok(Self::Rayleigh { depolarisation })
    }

    /// A phase function from its values at ascending cosines from -1 to 1, in arbitrary units: the
    /// values are normalised to an integral of 1 over the sphere.
    ///
    /// # Errors
    /// Returns an error if there are fewer than two values, if the numbers of cosines and values
    /// differ, if the cosines do not ascend from -1 to 1, if a value is negative or not finite, or
    /// if all values are zero.
    pub fn tabulated(cosines: Vec<f64>, values: Vec<f64>) -> Result<Self> {
        PhaseTable::new(cosines, values).map(|table| Self::Tabulated(Arc::new(table)))
    }

    /// The phase function (1/sr) at the given cosine of the scattering angle.
    #[inline]
    pub fn density(&self, cosine: f64) -> f64 {
        match self {
            Self::Isotropic => 0.25 / PI,
            Self::HenyeyGreenstein { asymmetry: g } => {
                let base = (1.0 + g * g - 2.0 * g * cosine).max(0.0);
                0.25 / PI * (1.0 - g * g) / (base * base.sqrt())
            }
            Self::Rayleigh { depolarisation } => {
                let dipole = dipole_share(*depolarisation);
                let rest = 1.0 - dipole;
                (0.75 * dipole * (1.0 + cosine * cosine) + rest) / (4.0 * PI)
            }
            Self::Tabulated(table) => table.density(cosine),
        }
    }

    /// Samples the cosine of the scattering angle from a number uniform in `[0, 1)` by inversion of
    /// the cumulative distribution.
    #[inline]
    pub fn sample(&self, uniform: f64) -> f64 {
        match self {
            Self::Isotropic => 2.0 * uniform - 1.0,
            Self::HenyeyGreenstein { asymmetry: g } => {
                let s = (1.0 - g * g) / (1.0 - g + 2.0 * g * uniform);
                ((1.0 + g * g - s * s) / (2.0 * g)).clamp(-1.0, 1.0)
            }
            Self::Rayleigh { depolarisation } => {
                // The number selects the dipole or the isotropic part and is then rescaled to
                // [0, 1).
                let dipole = dipole_share(*depolarisation);
                if uniform >= dipole {
                    return 2.0 * (uniform - dipole) / (1.0 - dipole) - 1.0;
                }
                // The root of c^3 + 3 c + 4 - 8 u = 0 (Frisvad 2011).
                let u = 4.0 * uniform / dipole - 2.0;
                let a = (u + (u * u + 1.0).sqrt()).cbrt();
                (a - 1.0 / a).clamp(-1.0, 1.0)
            }
            Self::Tabulated(table) => table.sample(uniform),
        }
    }

    /// The asymmetry parameter, the mean cosine of the scattering angle.
    pub fn asymmetry(&self) -> f64 {
        match self {
            Self::Isotropic | Self::Rayleigh { .. } => 0.0,
            Self::HenyeyGreenstein { asymmetry } => *asymmetry,
            Self::Tabulated(table) => table.asymmetry(),
        }
    }
}

/// The fraction of molecular scattering with the phase function of a dipole; the remainder is
/// isotropic.
#[inline]
fn dipole_share(depolarisation: f64) -> f64 {
    2.0 * (1.0 - depolarisation) / (2.0 + depolarisation)
}

impl PhaseTable {
    fn new(cosines: Vec<f64>, mut densities: Vec<f64>) -> Result<Self> {
        let invalid = |problem: &str| {
            Err(Error::out_of_range(
                "phase function table",
                problem,
                "two or more values, finite and not negative, at cosines ascending from -1 to 1",
            ))
        };
        if cosines.len() != densities.len() || cosines.len() < 2 {
            return invalid("of mismatched or too small size");
        }
        if cosines[0] != -1.0 || cosines[cosines.len() - 1] != 1.0 {
            return invalid("not from -1 to 1");
        }
        if !cosines.is_sorted_by(|a, b| a < b) {
            return invalid("not ascending");
        }
        if !densities.iter().all(|value| value.is_finite() && *value >= 0.0) {
            return invalid("negative or not finite");
        }
        let mut cumulative = vec![0.0];
        for (c, p) in cosines.windows(2).zip(densities.windows(2)) {
            let last = cumulative[cumulative.len() - 1];
            cumulative.push(last + PI * (c[1] - c[0]) * (p[0] + p[1]));
        }
        let total = cumulative[cumulative.len() - 1];
        if total <= 0.0 {
            return invalid("zero everywhere");
        }
        densities.iter_mut().for_each(|value| *value /= total);
        cumulative.iter_mut().for_each(|value| *value /= total);
        let by_cosine = Guide::new(&cosines, Guide::cosine_bucket);
        let by_cumulative = Guide::new(&cumulative, Guide::bucket);
        Ok(Self { cosines, densities, cumulative, by_cosine, by_cumulative })
    }

    fn density(&self, cosine: f64) -> f64 {
        let i = self.by_cosine.find(&self.cosines, Guide::cosine_bucket(cosine), cosine);
        let fraction = (cosine - self.cosines[i]) / (self.cosines[i + 1] - self.cosines[i]);
        self.densities[i] + fraction * (self.densities[i + 1] - self.densities[i])
    }

    fn sample(&self, uniform: f64) -> f64 {
        let i = self.by_cumulative.find(&self.cumulative, Guide::bucket(uniform), uniform);
        let width = self.cosines[i + 1] - self.cosines[i];
        // The density in the interval is p0 + slope x, so its integral is quadratic in x. This form
        // of the root is numerically stable for any slope.
        let rest = (uniform - self.cumulative[i]) / (2.0 * PI);
        let p0 = self.densities[i];
        let slope = (self.densities[i + 1] - p0) / width;
        let root = (p0 * p0 + 2.0 * slope * rest).max(0.0).sqrt();
        let x = if p0 + root > 0.0 { 2.0 * rest / (p0 + root) } else { 0.0 };
        self.cosines[i] + x.clamp(0.0, width)
    }

    fn asymmetry(&self) -> f64 {
        // The integral of a piecewise linear density times the cosine is exact.
        let pairs = self.cosines.windows(2).zip(self.densities.windows(2));
        let sum: f64 = pairs
            .map(|(c, p)| {
                let (a, b) = (c[0], c[1]);
                (b - a) * (p[0] * (2.0 * a + b) + p[1] * (a + 2.0 * b)) / 6.0
            })
            .sum();
        2.0 * PI * sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, RngExt, stream};

    fn kinds() -> Vec<PhaseFunction> {
        let cosines: Vec<f64> = (0..=2000).map(|i| -1.0 + f64::from(i) / 1000.0).collect();
        let greenstein = PhaseFunction::henyey_greenstein(0.85).unwrap();
        let values = cosines.iter().map(|c| 7.0 * greenstein.density(*c)).collect();
        vec![
            PhaseFunction::Isotropic,
            PhaseFunction::rayleigh(0.0).unwrap(),
            PhaseFunction::rayleigh(0.0279).unwrap(),
            PhaseFunction::rayleigh(0.5).unwrap(),
            PhaseFunction::henyey_greenstein(-0.4).unwrap(),
            greenstein,
            PhaseFunction::tabulated(cosines, values).unwrap(),
            PhaseFunction::tabulated(vec![-1.0, 0.2, 1.0], vec![0.0, 3.0, 0.0]).unwrap(),
        ]
    }

    /// The integral of `density * cosine^power` over the sphere by the midpoint rule.
    fn moment(phase: &PhaseFunction, power: i32) -> f64 {
        let n = 2_000_000;
        let width = 2.0 / f64::from(n);
        (0..n)
            .map(|i| -1.0 + width * (f64::from(i) + 0.5))
            .map(|c| 2.0 * PI * width * phase.density(c) * c.powi(power))
            .sum()
    }

    #[test]
    fn integral_is_one_and_mean_cosine_is_the_asymmetry() {
        for phase in kinds() {
            assert!((moment(&phase, 0) - 1.0).abs() < 1e-6, "{phase:?}");
            assert!((moment(&phase, 1) - phase.asymmetry()).abs() < 1e-6, "{phase:?}");
        }
    }

    /// Chi-square test of 400,000 samples in 50 bins of equal width in the cosine. With 49 degrees
    /// of freedom, a chi-square of 85.4 is exceeded with a probability of 1 in 1000.
    #[test]
    fn samplers_follow_their_densities() {
        for (number, phase) in kinds().into_iter().enumerate() {
            let mut rng = stream(7, Purpose::Transport, &[number as u64]);
            let (bins, samples) = (50, 400_000);
            let mut counts = vec![0_u32; bins];
            for _ in 0..samples {
                let position = 0.5 * (phase.sample(rng.random()) + 1.0) * bins as f64;
                counts[(position as usize).min(bins - 1)] += 1;
            }
            let chi_square: f64 = (0..bins)
                .map(|bin| {
                    let expected: f64 = (0..2000)
                        .map(|i| {
                            let within = (f64::from(i) + 0.5) / 2000.0;
                            let c = -1.0 + 2.0 * (bin as f64 + within) / bins as f64;
                            f64::from(samples) * 2.0 * PI * phase.density(c) * 2.0
                                / bins as f64
                                / 2000.0
                        })
                        .sum();
                    (f64::from(counts[bin]) - expected).powi(2) / expected
                })
                .sum();
            assert!(chi_square < 85.4, "{phase:?}: chi-square {chi_square}");
        }
    }

    #[test]
    fn a_guide_finds_what_a_plain_search_finds() {
        let mut cosines: Vec<f64> =
            (0..=900).map(|i| -(PI * f64::from(i) / 900.0).cos().powi(3)).collect();
        cosines.dedup();
        let last = cosines.len() - 2;
        let guide = Guide::new(&cosines, Guide::cosine_bucket);
        let mut rng = stream(9, Purpose::Transport, &[]);
        let between = (0..20_000).map(|_| 2.0 * rng.random::<f64>() - 1.0);
        for value in cosines.clone().into_iter().chain(between).chain([-1.0 - 1e-15, 1.0 + 1e-15]) {
            let found = guide.find(&cosines, Guide::cosine_bucket(value), value);
            let plain = cosines.partition_point(|c| *c <= value).saturating_sub(1).min(last);
            assert_eq!(found, plain, "{value}");
        }
    }

    #[test]
    fn wrong_tables_are_refused() {
        assert!(PhaseFunction::henyey_greenstein(1.0).is_err());
        assert!(PhaseFunction::henyey_greenstein(f64::NAN).is_err());
        for (cosines, values) in [
            (vec![-1.0], vec![1.0]),
            (vec![-1.0, 0.5], vec![1.0, 1.0]),
            (vec![-1.0, 0.0, 0.0, 1.0], vec![1.0; 4]),
            (vec![-1.0, 1.0], vec![1.0, f64::NAN]),
            (vec![-1.0, 1.0], vec![0.0, 0.0]),
        ] {
            assert!(PhaseFunction::tabulated(cosines, values).is_err());
        }
    }
}
