//! The forward peak of a phase function, taken away step by step.
//!
//! Light that is scattered by a small angle goes on nearly as if it had not been
//! scattered. After some scatterings a path is spread over so many directions that the
//! difference no longer shows: a share of the collisions may be left out, extinction
//! lowered by as much, and the peak of the phase function cut off (Potter 1970). Light
//! that has scattered more often bears more of it (Iwabuchi 2006).

use crate::error::Result;
use crate::optics::{Collision, DropletOptics, DropletTable, PhaseFunction, Scattering};
use std::f64::consts::PI;
use std::sync::Arc;

/// Shares of all collisions left out: in the first stage without the peak, the second
/// and so on. The last one lasts.
const LEFT_OUT: [f64; 3] = [0.3, 0.4, 0.5];
/// Angles at which a phase function is looked at; they lie closest near the peak.
const ANGLES: usize = 1500;
/// The peak is sought within this angle (radians).
const WIDEST: f64 = 1.2;

/// A medium that is like another one but for collisions that hardly turn light.
#[derive(Debug, Clone)]
pub(super) struct Stage {
    /// Extinction over that of the medium.
    pub(super) extinction: f64,
    /// What the collisions that are left do.
    pub(super) scattering: Scattering,
    /// Mean cosine of the scattering angle; the least one of droplets of all sizes.
    pub(super) asymmetry: f64,
    /// A phase function with the peak of those of the medium.
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
                (least, phases().nth(table.nodes().len() / 2).expect("a node").clone())
            }
        };
        Self { extinction, scattering, asymmetry: asymmetry.max(0.0), peak }
    }

    /// A collision somewhere in the medium.
    pub(super) fn anywhere(&self) -> Collision<'_> {
        let phase_functions = [&self.peak; 2];
        Collision { single_scattering_albedo: 1.0, phase_functions, share: 0.0 }
    }
}

/// The medium itself, and the stages that follow on it: none where there is no peak.
pub(super) fn stages(scattering: &Scattering) -> Result<Vec<Stage>> {
    let mut stages = vec![Stage::new(1.0, scattering.clone())];
    for left_out in LEFT_OUT {
        if let Some(scattering) = without_peak(scattering, left_out)? {
            stages.push(Stage::new(1.0 - left_out, scattering));
        }
    }
    Ok(stages)
}

/// The scattering that is left when the share `left_out` of all collisions is not
/// counted; `None` when a peak is too low for that. The share is the same for all
/// droplets, as one factor scales the extinction of all voxels.
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

/// The albedo of the collisions that are left.
fn rest(albedo: f64, left_out: f64) -> f64 {
    ((albedo - left_out) / (1.0 - left_out)).clamp(0.0, 1.0)
}

/// A phase function without the share `peak` of its light. Within some angle of the
/// forward direction it becomes a hill, linear in the cosine and level with the rest at
/// its foot; the angle is the one at which hill and peak together, the peak straight
/// on, have the mean cosine that was there before. `None` when there is no such angle.
fn cut(phase: &PhaseFunction, peak: f64) -> Result<Option<PhaseFunction>> {
    let angle = |number: usize| PI * (number as f64 / ANGLES as f64).powi(2);
    let mut cosines = vec![1.0];
    let mut densities = vec![phase.density(1.0)];
    // Integrals over the cap of the density, and of the density times 1 - cosine.
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
        // A hill from `top` to `density` over the cap bends as much light.
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

/// A phase function up to a cosine, and from there a line to `top` at 1.
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

    /// The peak, straight on, and the rest have the first two moments of the whole.
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

    /// Sideways and backwards nothing changes but that fewer collisions count.
    #[test]
    fn far_from_the_peak_scattering_is_the_same() {
        let whole = PhaseFunction::henyey_greenstein(0.85).unwrap();
        let scattering = Scattering::uniform(0.9, whole.clone()).unwrap();
        let stages = stages(&scattering).unwrap();
        assert_eq!(stages.len(), 1 + LEFT_OUT.len());
        for stage in &stages {
            let collision = stage.scattering.at([0; 3]);
            let scattered = stage.extinction * collision.single_scattering_albedo;
            assert!((stage.extinction - scattered - 0.1).abs() < 1e-12, "absorption stays");
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
