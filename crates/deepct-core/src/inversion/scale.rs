//! The factor that scales a uniform start to the images.

use super::objective::Objective;
use super::variables::Unknowns;
use crate::error::Result;

/// The first step in the logarithm of the factor.
const FIRST_STRIDE: f64 = 1.4;
/// Maximum number of images that the search computes.
const MOST_IMAGES: usize = 16;
/// Approximate accuracy of the logarithm of the factor.
const ENOUGH: f64 = 0.1;

/// Multiplies an extinction by the factor whose images are closest to the measured ones. All pixels
/// have equal weights: weighted by their standard errors, a start far from the solution would be
/// thinned until the dim edges of the cloud fit, because their errors are small.
///
/// The search takes increasing steps in the logarithm of the factor as long as the difference
/// decreases; then parabolas narrow the interval around the minimum.
pub(super) fn scale(objective: &mut Objective, unknowns: &mut Unknowns) -> Result<()> {
    let value = |logarithm: f64| -> Result<f64> {
        let mut scaled = unknowns.clone();
        scaled.extinction.values *= logarithm.exp() as f32;
        let x = objective.variables.of(&scaled);
        objective.difference(&x)
    };
    let best = lowest(value)?;
    unknowns.extinction.values *= best.exp() as f32;
    Ok(())
}

/// Approximate position of the minimum of a function of one variable, searched from 0.
fn lowest(mut function: impl FnMut(f64) -> Result<f64>) -> Result<f64> {
    let mut at = |x: f64| function(x).map(|value| (x, value));
    let (mut low, mut middle) = (at(0.0)?, at(FIRST_STRIDE)?);
    if middle.1 >= low.1 {
        std::mem::swap(&mut low, &mut middle);
    }
    let mut asked = 3;
    let mut high = at(middle.0 + 1.5 * (middle.0 - low.0))?;
    while high.1 < middle.1 && asked < MOST_IMAGES {
        (low, middle) = (middle, high);
        high = at(middle.0 + 1.5 * (middle.0 - low.0))?;
        asked += 1;
    }
    while (high.0 - low.0).abs() > 2.0 * ENOUGH && asked < MOST_IMAGES {
        let next = at(between(low, middle, high))?;
        asked += 1;
        let above = (next.0 - middle.0) * (high.0 - low.0) > 0.0;
        match (next.1 < middle.1, above) {
            (true, true) => (low, middle) = (middle, next),
            (true, false) => (high, middle) = (middle, next),
            (false, true) => high = next,
            (false, false) => low = next,
        }
    }
    Ok(if middle.1 <= high.1 { middle.0 } else { high.0 })
}

/// The next position to evaluate: the minimum of the parabola through three points. If it is
/// outside the interval, or too close to the middle point to give new information, a point in the
/// wider part of the interval is used instead.
fn between((a, fa): (f64, f64), (b, fb): (f64, f64), (c, fc): (f64, f64)) -> f64 {
    let (left, right) = ((b - a) * (fb - fc), (b - c) * (fb - fa));
    let vertex = b - 0.5 * ((b - a) * left - (b - c) * right) / (left - right);
    let wider = if (c - b).abs() > (b - a).abs() { c } else { a };
    let inside = vertex > a.min(c) && vertex < a.max(c);
    if !inside || (vertex - b).abs() < 0.1 * (wider - b).abs() {
        return b + 0.3 * (wider - b);
    }
    vertex
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A function that is nearly linear on both sides of its minimum, as a substitute for the
    /// misfit of a cloud that is too thin or too thick.
    #[test]
    fn the_lowest_place_is_found_from_afar() {
        for place in [-9.0_f64, -2.0, 0.0, 0.7, 5.0, 9.0] {
            let mut asked = 0;
            let found = lowest(|x| {
                asked += 1;
                Ok((1.0 + (-(x - place)).exp()).ln() + 0.2 * (1.0 + (x - place).exp()).ln())
            });
            // The derivative is zero where exp(place - x) is 1/5.
            let expected = place + 5.0_f64.ln();
            let found = found.unwrap();
            assert!((found - expected).abs() < 2.0 * ENOUGH, "{found} {expected}");
            assert!(asked <= MOST_IMAGES, "{asked}");
        }
    }
}
