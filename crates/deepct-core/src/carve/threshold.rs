//! The radiance that separates cloud from clear sky.

use crate::image::ViewStack;

/// Height of the threshold above the background in standard deviations.
const DEVIATIONS: f64 = 3.0;
/// Smallest height of the threshold above the background, relative to the background: the light
/// that clouds scatter onto adjacent clear pixels is less than this.
const LEAST_RISE: f64 = 0.05;
/// Height of the threshold above the background in grey levels, where most of the background has
/// the same one: its noise is then at most about one grey level.
const LEVELS: f64 = 3.0;
/// Standard deviation of a normal distribution divided by its median absolute deviation.
const DEVIATIONS_PER_MEDIAN: f64 = 1.482_6;

/// The radiance (1/sr) that separates clear sky over a dark surface from cloud, estimated from the
/// distribution of all pixels of all views.
///
/// The background is the densest part of the distribution, found as its half-sample mode (Robertson
/// and Cryer 1974). Its spread is the median absolute deviation on the narrower of its two sides,
/// because clouds broaden the upper side and their shadows the lower one. The threshold is three
/// standard deviations above the background, and at least a twentieth of it. If more than half of
/// the background has the same grey level, its spread is not known, and the threshold is three grey
/// levels above it. With the `standard_error` of the images (1/sr), it is at least three times that
/// of the background above it: sensors cut off the noise of dark pixels at zero.
///
/// Methods that split the histogram into two classes (Otsu 1979) are unsuitable: over a dark ocean
/// surface, the two classes are the shadows and all other pixels. If the images contain no clear
/// sky, there is no background, and the threshold must be given explicitly.
pub fn cloud_threshold(images: &ViewStack, standard_error: Option<&ViewStack>) -> f32 {
    let mut sorted: Vec<f64> = images.values.iter().map(|&radiance| f64::from(radiance)).collect();
    sorted.sort_by(f64::total_cmp);
    let background = half_sample_mode(&sorted);
    let lower = sorted.partition_point(|&radiance| radiance <= background);
    let upper = sorted.partition_point(|&radiance| radiance < background);
    let (below, above) = (&sorted[..lower], &sorted[upper..]);
    let median = |side: &[f64]| side.get(side.len() / 2).map(|middle| (middle - background).abs());
    let narrower =
        [median(below), median(above)].into_iter().flatten().fold(f64::INFINITY, f64::min);
    let brightest = sorted.last().copied().unwrap_or(background);
    let rise = match narrower {
        // Images of very few grey levels are separated in the middle.
        0.0 => (LEVELS * grey_level(&sorted)).min(0.5 * (brightest - background)),
        _ => DEVIATIONS * DEVIATIONS_PER_MEDIAN * narrower,
    };
    let noise = standard_error.map_or(0.0, |errors| {
        let pixels = images.values.iter().zip(&errors.values);
        let dark = pixels.filter(|(radiance, _)| f64::from(**radiance) <= background);
        let mut noise: Vec<f64> = dark.map(|(_, error)| f64::from(*error)).collect();
        noise.sort_by(f64::total_cmp);
        noise.get(noise.len() / 2).copied().unwrap_or(0.0)
    });
    let rise = rise.max(LEAST_RISE * background.abs()).max(DEVIATIONS * noise);
    (background + rise) as f32
}

/// The smallest difference between sorted values that are not equal: for quantised images, a grey
/// level. Zero if all values are equal.
fn grey_level(sorted: &[f64]) -> f64 {
    let steps = sorted.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0.0);
    steps.reduce(f64::min).unwrap_or(0.0)
}

/// The half-sample mode of sorted values: the half of the values that lie closest together is
/// selected repeatedly. There must be at least one value.
fn half_sample_mode(sorted: &[f64]) -> f64 {
    let mut values = sorted;
    while values.len() > 2 {
        let half = values.len().div_ceil(2);
        let range = |start: usize| values[start + half - 1] - values[start];
        let densest =
            (0..=values.len() - half).min_by(|&a, &b| range(a).total_cmp(&range(b))).unwrap_or(0);
        values = &values[densest..densest + half];
    }
    values.iter().sum::<f64>() / values.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, stream};
    use ndarray::Array3;
    use rand_distr::{Distribution, Normal};

    /// Pixels around a background of 0.0138, pixels in shadow and cloudy pixels.
    fn images(deviation: f64, shadows: usize, clouds: usize) -> ViewStack {
        let noise = Normal::new(0.0138, deviation).unwrap();
        let mut random = stream(1, Purpose::Sensor, &[deviation.to_bits()]);
        let values = (0..10_000).map(|number| match number {
            number if number < shadows => 0.002 + 0.01 * number as f64 / shadows as f64,
            number if number < shadows + clouds => {
                0.02 + 0.2 * (number - shadows) as f64 / clouds as f64
            }
            _ => noise.sample(&mut random),
        });
        let values = values.map(|value| value as f32).collect();
        ViewStack::new(Array3::from_shape_vec((1, 100, 100), values).unwrap()).unwrap()
    }

    #[test]
    fn the_threshold_is_three_deviations_above_the_background() {
        let threshold = f64::from(cloud_threshold(&images(0.0005, 0, 0), None));
        assert!((threshold - 0.0153).abs() < 0.0002, "{threshold}");
    }

    /// Clouds and shadows on 25 to 40 % of the pixels broaden the distribution, but the threshold
    /// stays between the noise of the background and the thinnest cloud.
    #[test]
    fn clouds_and_their_shadows_do_not_hide_the_background() {
        for (shadows, clouds) in [(2000, 500), (500, 2000), (1700, 1700), (0, 4000), (4000, 0)] {
            let threshold = f64::from(cloud_threshold(&images(0.0005, shadows, clouds), None));
            assert!((0.0148..0.0165).contains(&threshold), "{shadows} {clouds} {threshold}");
        }
    }

    #[test]
    fn without_noise_a_twentieth_above_the_background() {
        let threshold = f64::from(cloud_threshold(&images(0.0, 1000, 1000), None));
        assert!((threshold / 0.0138 - 1.05).abs() < 1e-4, "{threshold}");
        let dark = ViewStack::new(Array3::zeros((2, 3, 4))).unwrap();
        assert_eq!(cloud_threshold(&dark, None), 0.0);
    }

    /// Images of a dark scene by a sensor whose noise is below one grey level.
    #[test]
    fn a_background_of_one_grey_level_has_the_noise_of_the_quantisation() {
        let (level, noise) = (0.001, Normal::new(0.0, 0.6e-3).unwrap());
        let mut random = stream(2, Purpose::Sensor, &[]);
        let radiance = |number: usize| if number < 800 { 0.01 + 1e-4 * number as f64 } else { 0.0 };
        let values: Vec<f32> = (0..10_000)
            .map(|number| radiance(number) + noise.sample(&mut random))
            .map(|radiance| (level * (radiance / level).round()) as f32)
            .collect();
        let images =
            ViewStack::new(Array3::from_shape_vec((1, 100, 100), values).unwrap()).unwrap();
        let threshold = cloud_threshold(&images, None);
        let errors = ViewStack::new(images.values.mapv(|_| 0.002)).unwrap();
        assert!((cloud_threshold(&images, Some(&errors)) - 0.006).abs() < 1e-6);
        assert!((f64::from(threshold) / (3.0 * level) - 1.0).abs() < 1e-3, "{threshold}");
        let above = images.values.iter().skip(800).filter(|value| **value > threshold).count();
        assert!(above < 5, "{above}");
    }

    #[test]
    fn the_half_sample_mode_of_a_few_values() {
        assert_eq!(half_sample_mode(&[3.0]), 3.0);
        assert_eq!(half_sample_mode(&[1.0, 4.0]), 2.5);
        assert_eq!(half_sample_mode(&[0.0, 5.0, 5.1, 9.0, 20.0]), 5.05);
    }
}
