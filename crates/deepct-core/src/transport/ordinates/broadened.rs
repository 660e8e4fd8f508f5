//! Single scattering of light that the forward peak deflects before or afterwards.
//!
//! The transport treats the forward peak as no collision, but light that the peak deflects by one
//! or two degrees no longer shows the sharp features of single scattering, in particular the glory.
//! In the small-angle approximation each Legendre moment of the radiance decays independently
//! (Goudsmit and Saunderson 1940): where the peak, of normalised moments `p_l`, has acted over the
//! optical depth `s`, moment `l` of the phase function is multiplied by `exp(-s (1 - p_l))`. The
//! peak is the part of the phase function above a constant plateau around the forward direction,
//! whose width is chosen such that the peak contains the truncated fraction.

use crate::optics::PhaseFunction;
use std::f64::consts::PI;

/// Number of optical depths of the peak for which a phase function is tabulated: see [`depth`].
pub(super) const LEVELS: usize = 9;
/// Maximum number of Legendre moments: the features of droplets of 25 um in red light require 500.
const MOST_MOMENTS: usize = 768;
/// Terms below this value (1/sr) at the end of a series are omitted.
const NEGLIGIBLE: f64 = 1e-5;

/// Number of angles at which the forward peak is sampled, and the largest one (radians).
const ANGLES: usize = 600;
const WIDEST: f64 = 1.2;

/// Effect of the forward peak on the single scattering of one phase function.
#[derive(Debug)]
pub(super) struct Broadened {
    /// For each Legendre moment: `(2 l + 1) / (4 pi)` times the moment, and `1 - p_l`.
    terms: Vec<(f64, f64)>,
}

impl Broadened {
    /// Prepare a phase function whose Legendre moment number `first` is the share of the forward
    /// peak. Also returns its moments up to that one.
    pub(super) fn new(phase_function: &PhaseFunction, first: usize) -> (Self, Vec<f64>) {
        let moments = phase_function.legendre_moments(MOST_MOMENTS.max(first + 1));
        let peak = peak_moments(phase_function, moments[first], moments.len());
        let mut terms: Vec<(f64, f64)> = moments
            .iter()
            .zip(peak)
            .enumerate()
            .map(|(l, (moment, peak))| ((2 * l + 1) as f64 / (4.0 * PI) * moment, 1.0 - peak))
            .collect();
        let last = terms.iter().rposition(|(term, _)| term.abs() > NEGLIGIBLE);
        terms.truncate(last.map_or(0, |last| last + 1));
        (Self { terms }, moments[..=first].to_vec())
    }

    /// Change of the phase function (1/sr) at a cosine, for each level.
    pub(super) fn change(&self, cosine: f64) -> [f64; LEVELS] {
        let mut change = [0.0; LEVELS];
        let (mut before, mut now, mut l) = (0.0, 1.0, 0.0);
        for (term, damping) in &self.terms {
            for (level, change) in change.iter_mut().enumerate() {
                *change += term * now * (-depth(level) * damping).exp_m1();
            }
            (before, now) = (now, ((2.0 * l + 1.0) * cosine * now - l * before) / (l + 1.0));
            l += 1.0;
        }
        change
    }
}

/// Legendre moments of the forward peak of a phase function, over the first of them; all 1 if there
/// is no peak of that share.
fn peak_moments(phase_function: &PhaseFunction, share: f64, count: usize) -> Vec<f64> {
    let angle = |number: usize| WIDEST * (number as f64 / ANGLES as f64).powi(2);
    let cosines: Vec<f64> = (0..=ANGLES).map(|number| angle(number).cos()).collect();
    let densities: Vec<f64> =
        cosines.iter().map(|cosine| phase_function.density(*cosine)).collect();
    let mut light = 0.0;
    let foot = (1..=ANGLES).find(|&number| {
        let width = cosines[number - 1] - cosines[number];
        light += PI * width * (densities[number - 1] + densities[number]);
        light - 2.0 * PI * (1.0 - cosines[number]) * densities[number] >= share
    });
    let Some(foot) = foot.filter(|_| share > 0.0) else { return vec![1.0; count] };
    let mut moments = vec![0.0; count];
    for number in 0..foot {
        let middle = 0.5 * (cosines[number] + cosines[number + 1]);
        let density = 0.5 * (densities[number] + densities[number + 1]);
        let weight = (cosines[number] - cosines[number + 1]) * (density - densities[foot]);
        let (mut before, mut now, mut l) = (0.0, 1.0, 0.0);
        for moment in &mut moments {
            *moment += weight * now;
            (before, now) = (now, ((2.0 * l + 1.0) * middle * now - l * before) / (l + 1.0));
            l += 1.0;
        }
    }
    let all = moments[0];
    moments.iter_mut().for_each(|moment| *moment /= all);
    moments
}

/// Optical depth of a level: 0, 1/7, 1/3, 3/5, 1, 5/3, 3, 7, and 100 in place of infinity.
fn depth(level: usize) -> f64 {
    let part = level as f64 / (LEVELS - 1) as f64;
    if level + 1 < LEVELS { part / (1.0 - part) } else { 100.0 }
}

/// Level below an optical depth, fraction of the distance to the next level, and the derivative of
/// this position with respect to the optical depth.
#[inline]
pub(super) fn place(depth: f64) -> (usize, f64, f64) {
    let steps = (LEVELS - 1) as f64;
    let place = (steps * depth / (1.0 + depth)).max(0.0);
    let level = (place as usize).min(LEVELS - 2);
    (level, place - level as f64, steps / ((1.0 + depth) * (1.0 + depth)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// There is no change where the peak has not acted, and no light is lost where it has: the mean
    /// over all angles remains. The Henyey-Greenstein function, which is smooth at backward angles,
    /// hardly changes there; a narrow glory is broadened.
    #[test]
    fn the_peak_spreads_what_is_narrow() {
        let greenstein = PhaseFunction::henyey_greenstein(0.85).unwrap();
        let (broadened, moments) = Broadened::new(&greenstein, 7);
        assert_eq!(moments.len(), 8);
        for cosine in [-1.0_f64, -0.7, 0.3] {
            let change = broadened.change(cosine);
            assert_eq!(change[0], 0.0);
            let relative = change[4] / greenstein.density(cosine);
            assert!(relative.abs() < 0.15, "{cosine}: {relative}");
        }
        let angles: Vec<f64> = (0..=4000).map(|i| PI * f64::from(i) / 4000.0).collect();
        let glory = |angle: f64| 0.3 * (-((PI - angle) / 0.02).powi(2)).exp();
        let values = |glory: &dyn Fn(f64) -> f64| -> Vec<f64> {
            angles.iter().rev().map(|a| greenstein.density(a.cos()) + glory(*a)).collect()
        };
        let mut cosines: Vec<f64> = angles.iter().rev().map(|angle| angle.cos()).collect();
        (cosines[0], cosines[4000]) = (-1.0, 1.0);
        let phase = PhaseFunction::tabulated(cosines, values(&glory)).unwrap();
        let change = Broadened::new(&phase, 7).0.change(-1.0);
        assert!(change[LEVELS - 2] < change[4] && change[4] < change[2] && change[2] < -0.02);
    }

    #[test]
    fn depths_have_their_places() {
        let (level, part, slope) = place(1.0);
        assert!(level == 4 && part.abs() < 1e-12 && (slope - 2.0).abs() < 1e-12);
        let (level, part, _) = place(1e9);
        assert!(level == LEVELS - 2 && part <= 1.0 + 1e-6);
    }
}
