//! The radiance that parts cloud from clear sky.

use crate::error::{Error, Result};
use crate::image::ViewStack;

/// The radiance (1/sr) between clear sky over a dark surface and cloud, from the
/// histogram of all views: the split of the logarithm of radiance into two classes
/// that leaves the least variance within them (Otsu 1979, "A threshold selection
/// method from gray-level histograms").
///
/// # Errors
/// Images in which fewer than two different positive radiances occur.
pub fn cloud_threshold(images: &ViewStack) -> Result<f32> {
    const BINS: usize = 256;
    let logs: Vec<f64> = images
        .values
        .iter()
        .filter(|radiance| **radiance > 0.0)
        .map(|&radiance| f64::from(radiance).ln())
        .collect();
    let low = logs.iter().copied().fold(f64::INFINITY, f64::min);
    let high = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if low.partial_cmp(&high) != Some(std::cmp::Ordering::Less) {
        return Err(Error::out_of_range(
            "radiance",
            format!("{} everywhere", images.brightest()),
            "of at least two positive values where a threshold is to be found; give a threshold",
        ));
    }
    let width = (high - low) / BINS as f64;
    let mut histogram = [0.0_f64; BINS];
    for log in logs {
        histogram[(((log - low) / width) as usize).min(BINS - 1)] += 1.0;
    }
    Ok((low + otsu(&histogram) as f64 * width).exp() as f32)
}

/// The number of bins in the lower class of Otsu's split.
fn otsu(histogram: &[f64]) -> usize {
    let total: f64 = histogram.iter().sum();
    let moment: f64 = histogram.iter().enumerate().map(|(bin, count)| bin as f64 * count).sum();
    let (mut below, mut moment_below) = (0.0, 0.0);
    let mut best = (0.0, 1);
    for (bin, count) in histogram.iter().enumerate() {
        below += count;
        moment_below += bin as f64 * count;
        let above = total - below;
        if below > 0.0 && above > 0.0 {
            let difference = moment_below / below - (moment - moment_below) / above;
            let between = below * above * difference * difference;
            if between > best.0 {
                best = (between, bin + 1);
            }
        }
    }
    best.1
}
