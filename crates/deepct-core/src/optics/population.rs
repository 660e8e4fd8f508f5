//! The optics of droplet populations: Mie scattering averaged over the size distribution.

use super::mie::{LANES, SimilarSpheres};
use super::water::water_refractive_index;
use super::{DropletOptics, DropletTable, PhaseFunction};
use crate::error::{Error, Result};
use num_complex::Complex64;
use rayon::prelude::*;
use std::f64::consts::PI;

/// The shape of the droplet size distribution.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum SizeDistribution {
    /// Gamma distribution `r^((1 - 3 b) / b) exp(-r / (a b))` with effective radius a and effective
    /// variance b: Hansen and Travis (1974), equation 2.56.
    #[default]
    Gamma,
    /// Lognormal distribution: Hansen and Travis (1974), equation 2.60.
    Lognormal,
}

/// Settings of a [`DropletTable`]: wavelength, refractive index and size distribution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DropletSettings {
    /// Wavelength (um), from 0.2 to 4.
    pub wavelength: f64,
    /// Refractive index; `None` for that of liquid water.
    pub refractive_index: Option<Complex64>,
    /// Shape of the droplet size distribution.
    pub distribution: SizeDistribution,
    /// Effective variance (dimensionless), above 0 and at most 0.4.
    pub effective_variance: f64,
}

impl DropletSettings {
    /// Water droplets with a gamma distribution of effective variance 0.1 at a wavelength (um).
    pub fn water(wavelength: f64) -> Self {
        Self {
            wavelength,
            refractive_index: None,
            distribution: SizeDistribution::Gamma,
            effective_variance: f64::from(crate::cloud::EFFECTIVE_VARIANCE),
        }
    }
}

/// Step of the size parameter relative to the size parameter, for small droplets.
const RELATIVE_STEP: f64 = 0.001;
/// Step of the size parameter for large droplets: a fraction of the period with which the intensity
/// at a fixed angle oscillates with size.
const LARGEST_STEP: f64 = 0.3;
/// Angle (degrees) from the backward direction within which intensities are averaged over sizes in each
/// step: that of a single size is up to 5 % off there, and below 0.7 % elsewhere.
const GLORY: f64 = 5.0;
/// Droplets whose contribution to the forward peak is below this fraction of the largest one are
/// neglected.
const NEGLIGIBLE: f64 = 1e-6;

impl SizeDistribution {
    /// The logarithm of the number density at a radius (um), up to a constant.
    fn log_density(self, radius: f64, effective_radius: f64, effective_variance: f64) -> f64 {
        let (a, b) = (effective_radius, effective_variance);
        match self {
            Self::Gamma => (1.0 - 3.0 * b) / b * radius.ln() - radius / (a * b),
            Self::Lognormal => {
                // sigma^2 = ln(1 + b), r_g = a (1 + b)^(-5/2).
                let square = b.ln_1p();
                let middle = a.ln() - 2.5 * square;
                -radius.ln() - (radius.ln() - middle).powi(2) / (2.0 * square)
            }
        }
    }

    /// The range of radii (um) that contribute to the forward peak, in which droplets are weighted
    /// by the fourth power of the radius.
    fn range(self, effective_radius: f64, effective_variance: f64) -> [f64; 2] {
        let weight = |radius: f64| {
            self.log_density(radius, effective_radius, effective_variance) + 4.0 * radius.ln()
        };
        let radii: Vec<f64> =
            (-600..=600).map(|i| effective_radius * (f64::from(i) * 0.01).exp()).collect();
        let largest = radii.iter().map(|r| weight(*r)).fold(f64::NEG_INFINITY, f64::max);
        let matters = |radius: &&f64| weight(**radius) > largest + NEGLIGIBLE.ln();
        let end = |found: Option<&f64>| found.copied().unwrap_or(effective_radius);
        [end(radii.iter().find(matters)), end(radii.iter().rev().find(matters))]
    }
}

impl DropletTable {
    /// The table of water droplets at a wavelength (um) with effective radii from 1 to 25 um and an
    /// effective variance of 0.1.
    ///
    /// # Errors
    /// Returns an error if the wavelength is outside 0.2 to 4 um.
    pub fn water(wavelength: f64) -> Result<Self> {
        Self::of(&DropletSettings::water(wavelength))
    }

    /// The table of droplets with effective radii from 1 to 25 um.
    ///
    /// # Errors
    /// Returns an error if a setting is out of range.
    pub fn of(settings: &DropletSettings) -> Result<Self> {
        Self::mie(settings, &default_radii())
    }

    /// The table of droplets with the given ascending effective radii (um). The Mie calculation of
    /// single spheres is shared by all effective radii.
    ///
    /// # Errors
    /// Returns an error if a setting or a radius is out of range.
    pub fn mie(settings: &DropletSettings, effective_radii: &[f64]) -> Result<Self> {
        let variance = settings.effective_variance;
        if !(variance > 0.0 && variance <= 0.4) {
            let range = "above 0 and at most 0.4";
            return Err(Error::out_of_range("effective variance", variance, range));
        }
        if let Some(radius) = effective_radii.iter().find(|radius| !(0.1..=50.0).contains(*radius))
        {
            return Err(Error::out_of_range("effective radius", radius, "from 0.1 to 50 um"));
        }
        let index = match settings.refractive_index {
            Some(index) => index,
            None => water_refractive_index(settings.wavelength)?,
        };
        let spheres = Spheres::new(settings, index, effective_radii);
        let nodes = effective_radii.par_iter().map(|radius| spheres.population(settings, *radius));
        Self::new(nodes.collect::<Result<_>>()?)
    }
}

/// The smallest and the largest effective radius (um) of [`DropletTable::of`].
pub const TABLE_RADII: [f64; 2] = [1.0, 25.0];

/// Effective radii (um) of [`TABLE_RADII`], each about a twelfth larger than the previous one.
pub(super) fn default_radii() -> Vec<f64> {
    let [least, most] = TABLE_RADII;
    let count = 40;
    (0..=count).map(|i| least * (most / least).powf(f64::from(i) / f64::from(count))).collect()
}

/// Mie scattering by spheres of all sizes that occur in a set of populations.
struct Spheres {
    cosines: Vec<f64>,
    /// Radius and width of the interval that it represents in an integral (um).
    radii: Vec<[f64; 2]>,
    /// Extinction and scattering cross-sections (um2) for each radius.
    sections: Vec<[f64; 2]>,
    /// Differential scattering cross-section (um2/sr) for each radius and cosine.
    intensities: Vec<Vec<f64>>,
}

impl Spheres {
    fn new(settings: &DropletSettings, index: Complex64, effective_radii: &[f64]) -> Self {
        let ranges = effective_radii
            .iter()
            .map(|radius| settings.distribution.range(*radius, settings.effective_variance));
        let [least, most] = ranges.fold([f64::INFINITY, 0.0], |all, one| {
            [f64::min(all[0], one[0]), f64::max(all[1], one[1])]
        });
        let wavenumber = 2.0 * PI / settings.wavelength;
        let mut radii = Vec::new();
        let mut x = (wavenumber * least).max(0.02);
        while x < wavenumber * most {
            let step = 1.0 / (1.0 / (RELATIVE_STEP * x) + 1.0 / LARGEST_STEP);
            radii.push([(x + 0.5 * step) / wavenumber, step / wavenumber]);
            x += step;
        }
        let cosines = cosines();
        // The cosines are symmetric about 0, so only those from 0 on are needed.
        let forward = &cosines[cosines.len() / 2..];
        let axial = forward.partition_point(|cosine| *cosine < GLORY.to_radians().cos());
        let scattered: Vec<_> = radii
            .par_iter()
            .rev()
            .map(|[radius, width]| {
                // The cross-sections and the glory have resonances that are much narrower than the step.
                let within: [f64; LANES] = std::array::from_fn(|part| {
                    let offset = (part as f64 + 0.5) / LANES as f64 - 0.5;
                    radius + offset * width
                });
                let spheres = SimilarSpheres::new(within.map(|radius| wavenumber * radius), index);
                let [forward, backward] = spheres.intensities(forward, axial);
                let backward = backward.iter().rev().take(forward.len() - 1);
                let intensities = backward.chain(&forward);
                let scale = (wavenumber * wavenumber).recip();
                let intensities = intensities.map(|value| value * scale).collect();
                let mut sections = [0.0; 2];
                for (within, efficiencies) in within.iter().zip(spheres.efficiencies) {
                    let area = PI * within * within / LANES as f64;
                    sections[0] += area * efficiencies[0];
                    sections[1] += area * efficiencies[1];
                }
                (sections, intensities)
            })
            .collect();
        let (sections, intensities) = scattered.into_iter().rev().unzip();
        Self { cosines, radii, sections, intensities }
    }

    /// The optics of droplets of one effective radius (um).
    fn population(
        &self,
        settings: &DropletSettings,
        effective_radius: f64,
    ) -> Result<DropletOptics> {
        let variance = settings.effective_variance;
        let log_density =
            |radius: f64| settings.distribution.log_density(radius, effective_radius, variance);
        let [least, most] = settings.distribution.range(effective_radius, variance);
        // The normalisation is arbitrary; this one prevents overflow of the exponential.
        let reference = log_density(effective_radius);
        let (mut volume, mut extinction, mut scattering) = (0.0, 0.0, 0.0);
        let mut intensities = vec![0.0; self.cosines.len()];
        for (number, [radius, width]) in self.radii.iter().enumerate() {
            if !(least..=most).contains(radius) {
                continue;
            }
            let droplets = (log_density(*radius) - reference).exp() * width;
            let [extinguished, scattered] = self.sections[number];
            volume += droplets * 4.0 / 3.0 * PI * radius.powi(3);
            extinction += droplets * extinguished;
            scattering += droplets * scattered;
            for (sum, value) in intensities.iter_mut().zip(&self.intensities[number]) {
                *sum += droplets * value;
            }
        }
        Ok(DropletOptics {
            effective_radius,
            // 1 g/m3 of water occupies 1e-6 of the volume, and 1 per um equals 1e9 per km.
            extinction_per_water: 1e3 * extinction / volume,
            single_scattering_albedo: (scattering / extinction).min(1.0),
            phase_function: PhaseFunction::tabulated(self.cosines.clone(), intensities)?,
        })
    }
}

/// Cosines from -1 to 1 at which phase functions are tabulated. The angles are 0.02 degrees apart
/// near the forward and backward directions and up to half a degree apart in between.
pub(super) fn cosines() -> Vec<f64> {
    let mut angles = vec![0.0_f64];
    let mut angle = 0.0_f64;
    while angle < 90.0 {
        angle += (0.02 + 0.03 * angle).min(0.5);
        angles.push(angle.min(90.0));
    }
    let backward = angles.iter().map(|angle| -angle.to_radians().cos());
    let forward = angles.iter().rev().skip(1).map(|angle| angle.to_radians().cos());
    let mut cosines: Vec<f64> = backward.chain(forward).collect();
    // The computed cosine of 90 degrees is not exactly zero.
    cosines[angles.len() - 1] = 0.0;
    cosines
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, RngExt, stream};

    /// Computes the moments of the distributions by a sum with small steps.
    #[test]
    fn distributions_have_their_effective_radius_and_variance() {
        for distribution in [SizeDistribution::Gamma, SizeDistribution::Lognormal] {
            for (a, b) in [(8.0, 0.05), (12.0, 0.2)] {
                let moment = |weight: &dyn Fn(f64) -> f64| -> f64 {
                    let step = 0.002;
                    let radii = (1..200_000).map(|i| step * f64::from(i));
                    let density = |r| distribution.log_density(r, a, b).exp();
                    radii.map(|r| step * density(r) * r * r * weight(r)).sum()
                };
                let area = moment(&|_| 1.0);
                let radius = moment(&|r| r) / area;
                let variance = moment(&|r| (r - radius).powi(2)) / (area * radius * radius);
                assert!((radius / a - 1.0).abs() < 1e-5, "{distribution:?}: {radius}, not {a}");
                assert!((variance / b - 1.0).abs() < 1e-3, "{distribution:?}: {variance}, not {b}");
            }
        }
    }

    /// Effective radius, extinction per liquid water content, single-scattering albedo, asymmetry
    /// parameter and 4 pi times the phase function in the forward direction, computed with the
    /// crate scatrs 0.3.0 (`ensemble::compute_batch`, tolerance 1e-4, n = 1.331 + 2.13e-8 i,
    /// 0.672 um, gamma distribution of effective variance 0.1).
    const INDEPENDENT: [(f64, f64, f64, f64, f64); 3] = [
        (5.0, 324.89890, 0.99999798, 0.843766, 1288.79),
        (10.0, 157.72277, 0.99999615, 0.861148, 5012.86),
        (20.0, 77.41801, 0.99999254, 0.871553, 19730.12),
    ];

    #[test]
    fn populations_are_those_of_another_code() {
        let index = Some(Complex64::new(1.331, 2.13e-8));
        let settings = DropletSettings { refractive_index: index, ..DropletSettings::water(0.672) };
        let radii = INDEPENDENT.map(|row| row.0);
        let table = DropletTable::mie(&settings, &radii).unwrap();
        for (node, expected) in table.nodes().iter().zip(INDEPENDENT) {
            let (_, extinction, albedo, asymmetry, forward) = expected;
            assert!((node.extinction_per_water / extinction - 1.0).abs() < 1e-4, "{expected:?}");
            assert!((node.single_scattering_albedo - albedo).abs() < 1e-6, "{expected:?}");
            let phase = &node.phase_function;
            assert!((phase.asymmetry() - asymmetry).abs() < 2e-4, "{expected:?}");
            assert!((4.0 * PI * phase.density(1.0) / forward - 1.0).abs() < 1e-3, "{expected:?}");
        }
        // The phase function is enhanced in the cloudbow, near 142 degrees.
        let phase = &table.nodes()[2].phase_function;
        let at = |angle: f64| phase.density(angle.to_radians().cos());
        assert!(at(142.0) > 2.0 * at(120.0) && at(142.0) > 1.5 * at(160.0));
    }

    /// Wavelength, refractive index, effective radius and 100 times the phase function at 180, 179, 178
    /// and 170 degrees: sums over the series of Bohren and Huffman (1983) in NumPy, for a gamma
    /// distribution of effective variance 0.1 and size parameters 0.01 apart. Half as many differ
    /// by up to 0.6 %.
    const GLORIES: [(f64, Complex64, f64, [f64; 4]); 9] = [
        (0.672, Complex64::new(1.331, 2.13e-8), 4.0, [5.09839, 4.05611, 3.00715, 1.90511]),
        (0.672, Complex64::new(1.331, 2.13e-8), 10.0, [5.3136, 2.87503, 3.63118, 1.03325]),
        (0.672, Complex64::new(1.331, 2.13e-8), 20.0, [5.72724, 2.87727, 1.4614, 0.713667]),
        (0.446, Complex64::new(1.337, 1e-9), 4.0, [5.19501, 3.47182, 3.66954, 1.50848]),
        (0.446, Complex64::new(1.337, 1e-9), 10.0, [5.28155, 3.44871, 2.37895, 0.887572]),
        (0.446, Complex64::new(1.337, 1e-9), 20.0, [5.89803, 1.94673, 1.05474, 0.652184]),
        (2.13, Complex64::new(1.294, 4e-4), 4.0, [2.42015, 2.33102, 2.09661, 2.38311]),
        (2.13, Complex64::new(1.294, 4e-4), 10.0, [4.78317, 4.17024, 3.04325, 1.81531]),
        (2.13, Complex64::new(1.294, 4e-4), 20.0, [3.95625, 2.40678, 1.85947, 0.814005]),
    ];

    #[test]
    fn the_glory_is_that_of_fine_steps() {
        for (wavelength, index, radius, expected) in GLORIES {
            let refractive_index = Some(index);
            let settings =
                DropletSettings { refractive_index, ..DropletSettings::water(wavelength) };
            let table = DropletTable::mie(&settings, &[radius]).unwrap();
            for (angle, expected) in [180.0_f64, 179.0, 178.0, 170.0].into_iter().zip(expected) {
                let found =
                    100.0 * table.nodes()[0].phase_function.density(angle.to_radians().cos());
                let place =
                    format!("{wavelength} um, {radius} um, {angle}: {found}, not {expected}");
                assert!((found / expected - 1.0).abs() < 8e-3, "{place}");
            }
        }
    }

    /// Chi-square test of 400,000 samples in 60 bins of the scattering angle, which are narrow in
    /// the forward peak. With 59 degrees of freedom, a chi-square of 98.3 is exceeded with a
    /// probability of 1 in 1000.
    #[test]
    fn samples_of_a_real_peak_follow_its_density() {
        let table = DropletTable::mie(&DropletSettings::water(0.672), &[10.0]).unwrap();
        let phase = &table.nodes()[0].phase_function;
        let (bins, samples, parts) = (60_usize, 400_000, 20_000);
        let edge = |bin: usize| PI * (bin as f64 / bins as f64).powi(3);
        let mut counts = vec![0_u32; bins];
        let mut rng = stream(11, Purpose::Transport, &[]);
        for _ in 0..samples {
            let angle = phase.sample(rng.random()).acos();
            let bin = ((angle / PI).cbrt() * bins as f64) as usize;
            counts[bin.min(bins - 1)] += 1;
        }
        let mut total = 0.0;
        // The innermost bins, in which less than one sample is expected, are merged.
        let first = 6;
        let expected = |from: f64, to: f64| -> f64 {
            let step = (to - from) / f64::from(parts);
            let angles = (0..parts).map(|i| from + step * (f64::from(i) + 0.5));
            let density = angles.map(|t| 2.0 * PI * t.sin() * phase.density(t.cos()) * step);
            f64::from(samples) * density.sum::<f64>()
        };
        let inner: u32 = counts[..first].iter().sum();
        let inner = (f64::from(inner), expected(0.0, edge(first)));
        let outer = (first..bins).map(|b| (f64::from(counts[b]), expected(edge(b), edge(b + 1))));
        for (found, expected) in outer.chain([inner]) {
            assert!(expected > 5.0);
            total += (found - expected).powi(2) / expected;
        }
        assert!(total < 98.3, "chi-square {total}");
    }

    #[test]
    fn wrong_droplets_are_refused() {
        let settings = DropletSettings::water(0.672);
        let broad = DropletSettings { effective_variance: 0.5, ..settings };
        assert!(DropletTable::mie(&broad, &[10.0]).is_err());
        assert!(DropletTable::mie(&DropletSettings::water(9.0), &[10.0]).is_err());
        assert!(DropletTable::mie(&settings, &[500.0]).is_err());
        assert!(DropletTable::mie(&settings, &[10.0, 5.0]).is_err());
    }
}
