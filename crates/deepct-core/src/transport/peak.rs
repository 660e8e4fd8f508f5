//! Stepwise truncation of the forward peak of a phase function.
//!
//! Light scattered by a small angle continues almost as if it had not been scattered. After several
//! scatterings a path is spread over so many directions that the difference is negligible: a
//! fraction of the collisions can be omitted, the extinction reduced accordingly, and the peak of
//! the phase function truncated (Potter 1970). The fraction may grow with the number of scatterings
//! (Iwabuchi 2006).

use crate::error::Result;
use crate::optics::{Collision, DropletOptics, DropletTable, PhaseFunction, Scattering};
use std::f64::consts::PI;
use std::sync::Arc;

/// Fraction of all collisions omitted in each truncated stage, in order. The last stage applies to
/// all further scatterings.
const LEFT_OUT: [f64; 3] = [0.3, 0.4, 0.5];
/// Number of angles at which a phase function is sampled; they are densest near the peak.
const ANGLES: usize = 1500;
/// Largest angle (radians) within which the peak is sought.
const WIDEST: f64 = 1.2;

/// A medium from which a fraction of the collisions that hardly deflect light is omitted.
#[derive(Debug, Clone)]
pub(super) struct Stage {
    /// Extinction relative to that of the original medium.
    pub(super) extinction: f64,
    /// Scattering by the remaining collisions.
    pub(super) scattering: Scattering,
    /// Mean cosine of the scattering angle; the smallest one over all droplet sizes.
    pub(super) asymmetry: f64,
    /// A phase function that represents the forward peak of the medium.
    peak: PhaseFunction,
}

impl Stage {
    fn new(extinction: f64, scattering: Scattering) -> Self {
        let (asymmetry, peak) = match &scattering {
            Scattering::Uniform { phase_function, .. } => {
                (phase_function.asymmetry(), phase_function.clone())
            }
            Scattering::Droplets { table, .. } => {
                let phases = || table.nodes().iter().map(|node| &node.phase_function);
                let least = phases().map(PhaseFunction::asymmetry).fold(f64::INFINITY, f64::min);
                (least, phases().nth(table.nodes().len() / 2).expect("a table entry").clone())
            }
        };
        Self { extinction, scattering, asymmetry: asymmetry.max(0.0), peak }
    }

    /// A collision with the representative phase function, independent of position.
    pub(super) fn anywhere(&self) -> Collision<'_> {
        let phase_functions = [&self.peak; 2];
        Collision { single_scattering_albedo: 1.0, phase_functions, share: 0.0 }
    }
}

/// The original medium, followed by its truncated stages; no such stages without a forward peak.
pub(super) fn stages(scattering: &Scattering) -> Result<Vec<Stage>> {
    let mut stages = vec![Stage::new(1.0, scattering.clone())];
    for left_out in LEFT_OUT {
        if let Some(scattering) = without_peak(scattering, left_out)? {
            stages.push(Stage::new(1.0 - left_out, scattering));
        }
    }
    Ok(stages)
}

/// Scattering that remains if the fraction `left_out` of all collisions is omitted; `None` if a
/// peak is too weak for that. The fraction is the same for all droplet sizes, because one factor
/// scales the extinction of all voxels.
fn without_peak(scattering: &Scattering, left_out: f64) -> Result<Option<Scattering>> {
    match scattering {
        Scattering::Uniform { single_scattering_albedo: albedo, phase_function } => {
            let Some(phase) = cut(phase_function, left_out / albedo)? else {
                return Ok(None);
            };
            Scattering::uniform(rest(*albedo, left_out), phase).map(Some)
        }
        Scattering::Droplets { effective_radius, table } => {
            let mut nodes = Vec::new();
            for node in table.nodes() {
                let albedo = node.single_scattering_albedo;
                let Some(phase_function) = cut(&node.phase_function, left_out / albedo)? else {
                    return Ok(None);
                };
                nodes.push(DropletOptics {
                    extinction_per_water: (1.0 - left_out) * node.extinction_per_water,
                    single_scattering_albedo: rest(albedo, left_out),
                    phase_function,
                    ..*node
                });
            }
            let table = Arc::new(DropletTable::new(nodes)?);
            let effective_radius = effective_radius.clone();
            Ok(Some(Scattering::Droplets { effective_radius, table }))
        }
    }
}

/// Single-scattering albedo of the remaining collisions.
fn rest(albedo: f64, left_out: f64) -> f64 {
    ((albedo - left_out) / (1.0 - left_out)).clamp(0.0, 1.0)
}

/// Phase function without the share `peak` of its light. Within a certain angle of the forward
/// direction it becomes linear in the cosine, continuous with the remaining function at that angle.
/// The angle is chosen such that this linear part and the removed peak, taken as exactly forward,
/// together have the original mean cosine. `None` if there is no such angle.
fn cut(phase: &PhaseFunction, peak: f64) -> Result<Option<PhaseFunction>> {
    let angle = |number: usize| PI * (number as f64 / ANGLES as f64).powi(2);
    let mut cosines = vec![1.0];
    let mut densities = vec![phase.density(1.0)];
    // Integrals over the forward cap of the density, and of the density times 1 - cosine.
    let (mut light, mut bent) = (0.0, 0.0);
    for number in 1..ANGLES {
        let theta = angle(number);
        if theta > WIDEST {
            return Ok(None);
        }
        let (cosine, density) = (theta.cos(), phase.density(theta.cos()));
        let (before, above) = (cosines[number - 1], densities[number - 1]);
        let width = 2.0 * PI * (before - cosine);
        light += 0.5 * width * (density + above);
        bent += 0.5 * width * (density * (1.0 - cosine) + above * (1.0 - before));
        cosines.push(cosine);
        densities.push(density);
        // A linear function from `top` to `density` over the cap with the same integral
        // of the density times 1 - cosine.
        let depth = 1.0 - cosine;
        let top = 6.0 * bent / (2.0 * PI * depth * depth) - 2.0 * density;
        let hill = PI * depth * (top + density);
        if light - hill >= peak {
            let top = ((light - peak) / (PI * depth) - density).max(0.0);
            return hilled(phase, cosine, top).map(Some);
        }
    }
    Ok(None)
}

/// Phase function that equals `phase` up to the cosine `foot` and is linear from there to `top` at
/// a cosine of 1.
fn hilled(phase: &PhaseFunction, foot: f64, top: f64) -> Result<PhaseFunction> {
    let first = foot.acos();
    let steps = 200;
    let mut cosines: Vec<f64> = (0..=steps)
        .map(|step| PI - (PI - first) * (1.0 - (1.0 - f64::from(step) / f64::from(steps)).powi(2)))
        .map(f64::cos)
        .collect();
    (cosines[0], cosines[steps as usize]) = (-1.0, foot);
    let mut densities: Vec<f64> = cosines.iter().map(|cosine| phase.density(*cosine)).collect();
    cosines.push(1.0);
    densities.push(top);
    PhaseFunction::tabulated(cosines, densities)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean of a Legendre polynomial over a phase function, by the midpoint rule.
    fn moment(phase: &PhaseFunction, polynomial: fn(f64) -> f64) -> f64 {
        let count = 1_000_000;
        let width = 2.0 / f64::from(count);
        (0..count)
            .map(|number| -1.0 + width * (f64::from(number) + 0.5))
            .map(|cosine| 2.0 * PI * width * phase.density(cosine) * polynomial(cosine))
            .sum()
    }

    /// The exactly forward peak and the remaining phase function together have the first two
    /// moments of the original.
    #[test]
    fn what_is_left_and_the_peak_turn_light_as_much_as_the_whole() {
        let greenstein = PhaseFunction::henyey_greenstein(0.85).unwrap();
        for left_out in LEFT_OUT {
            let rest = cut(&greenstein, left_out).unwrap().unwrap();
            for (polynomial, expected, tolerance) in [
                ((|c| c) as fn(f64) -> f64, 0.85, 3e-4),
                (|c| 1.5 * c * c - 0.5, 0.85 * 0.85, 4e-3),
            ] {
                let found = left_out + (1.0 - left_out) * moment(&rest, polynomial);
                assert!((found - expected).abs() < tolerance, "{left_out}: {found} {expected}");
            }
        }
    }

    /// Sideways and backwards, the light scattered per path length is unchanged.
    #[test]
    fn far_from_the_peak_scattering_is_the_same() {
        let whole = PhaseFunction::henyey_greenstein(0.85).unwrap();
        let scattering = Scattering::uniform(0.9, whole.clone()).unwrap();
        let stages = stages(&scattering).unwrap();
        assert_eq!(stages.len(), 1 + LEFT_OUT.len());
        for stage in &stages {
            let collision = stage.scattering.at([0; 3]);
            let scattered = stage.extinction * collision.single_scattering_albedo;
            assert!((stage.extinction - scattered - 0.1).abs() < 1e-12, "absorption is unchanged");
            for cosine in [-0.9, -0.2, 0.3] {
                let found = scattered * collision.density(cosine);
                let expected = 0.9 * whole.density(cosine);
                assert!((found / expected - 1.0).abs() < 2e-3, "{cosine}: {found} {expected}");
            }
        }
    }

    #[test]
    fn scattering_without_a_peak_has_no_stages() {
        for phase in [PhaseFunction::Isotropic, PhaseFunction::henyey_greenstein(0.3).unwrap()] {
            let scattering = Scattering::uniform(1.0, phase).unwrap();
            assert_eq!(stages(&scattering).unwrap().len(), 1);
        }
    }
}
