//! The radiance that separates cloud from clear sky.

use crate::image::ViewStack;
use crate::scene::Observation;
use ndarray::{Array3, Axis};
use std::f64::consts::PI;

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

/// Apparent albedo of the clear sky, relative to a white surface under the Sun, from which on shaded
/// sides of clouds may be darker than it. That of the ocean and the air above it is below, except for
/// blue light.
const GREY_GROUND: f64 = 0.12;
/// Ratio of the brightest pixels to the background of such a surface below which clouds are taken to be
/// no brighter than it: a mask by brightness may then lose most of them.
const CONTRAST: f64 = 1.4;
/// Largest ratio of the backgrounds of two views that the light of the atmosphere explains.
const AIR_RISE: f64 = 4.0;
/// Share of the pixels that are brighter than those with which the background is compared.
const BRIGHTEST_SHARE: f64 = 0.01;

/// The radiances that separate cloud from clear sky.
#[derive(Debug, Clone, PartialEq)]
pub struct CloudThreshold {
    /// The threshold of each view (1/sr), above which a pixel shows cloud.
    pub by_view: Vec<f32>,
    /// The radiance (1/sr) below which a pixel of each view may show the shaded side of a cloud; it is
    /// negative infinity above a dark surface, which is darker than clouds.
    pub shaded_by_view: Vec<f32>,
    /// The ratio of the brightest pixels to the clear sky above a surface that may be brighter than
    /// shaded sides of clouds; `None` above a dark one.
    pub contrast: Option<f64>,
}

impl CloudThreshold {
    /// Whether the clear sky is so bright that clouds are not brighter.
    pub fn is_bright_ground(&self) -> bool {
        self.contrast.is_some_and(|contrast| contrast < CONTRAST)
    }
}

/// The radiances (1/sr) that separate clear sky over a dark surface from cloud, estimated from the
/// distribution of the pixels whose radiance is known ([`Observation::known`]).
///
/// The background of a view is the densest part of the darker half of its pixels, found as their
/// half-sample mode (Robertson and Cryer 1974): in slanted views, the atmosphere makes it brighter, by
/// at most a factor of four. Views that are brighter still are filled by clouds, and have the
/// background of the others. Views are aligned by their backgrounds. The background of all views is again the half-sample
/// mode, and its spread is the median absolute deviation on the narrower of its two sides, because
/// clouds broaden the upper side and their shadows the lower one. The threshold is three standard
/// deviations above the background, and at least a twentieth of it. If more than half of the
/// background has the same grey level, its spread is not known, and the threshold is three grey
/// levels above it. With the standard error of the images, it is at least three times that of the
/// background above it.
///
/// Methods that split the histogram into two classes (Otsu 1979) are unsuitable: over a dark ocean
/// surface, the two classes are the shadows and all other pixels. If the images contain no clear
/// sky, there is no background, and the threshold must be given explicitly.
///
/// The background is compared with a white surface under the Sun to find ground that is brighter than
/// shaded sides of clouds, where pixels below it by as much may show cloud as well, and ground that is
/// as bright as clouds.
pub fn cloud_threshold(observation: &Observation) -> CloudThreshold {
    let sun = &observation.light.sun;
    let white = sun.irradiance * sun.zenith.cos() / PI;
    let Observation { images, standard_error, .. } = observation;
    threshold(images, standard_error.as_ref(), &observation.known(), white)
}

/// As [`cloud_threshold`], with the radiance (1/sr) of a white surface.
fn threshold(
    images: &ViewStack,
    standard_error: Option<&ViewStack>,
    known: &Array3<bool>,
    white: f64,
) -> CloudThreshold {
    let views: Vec<Vec<[f64; 2]>> = (0..images.shape()[0])
        .map(|view| {
            let error = |place| standard_error.map_or(0.0, |errors| errors.image(view)[place]);
            let known = known.index_axis(Axis(0), view);
            let pixels = images.image(view);
            let pixels = pixels.indexed_iter().filter(|(place, _)| known[*place]);
            pixels.map(|(place, value)| [f64::from(*value), f64::from(error(place))]).collect()
        })
        .collect();
    let sorted = |pixels: &mut dyn Iterator<Item = f64>| {
        let mut values: Vec<f64> = pixels.collect();
        values.sort_by(f64::total_cmp);
        values
    };
    let mut grey_level = f64::INFINITY;
    let mut own: Vec<Option<f64>> = Vec::with_capacity(views.len());
    for pixels in &views {
        let values = sorted(&mut pixels.iter().map(|[value, _]| *value));
        grey_level = grey_level.min(smallest_step(&values));
        let darker = &values[..values.len().div_ceil(2)];
        own.push((!darker.is_empty()).then(|| half_sample_mode(darker)));
    }
    // A view that clouds fill has no background of its own.
    let darkest = own.iter().flatten().copied().fold(f64::INFINITY, f64::min).max(0.0);
    for background in &mut own {
        *background = background.filter(|own| *own <= AIR_RISE * darkest);
    }
    let known: Vec<f64> = own.iter().flatten().copied().collect();
    let mean = known.iter().sum::<f64>() / known.len().max(1) as f64;
    let offsets: Vec<f64> = own.iter().map(|own| own.map_or(0.0, |own| own - mean)).collect();
    let aligned: Vec<[f64; 2]> = views
        .iter()
        .zip(&own)
        .zip(&offsets)
        .filter(|((_, own), _)| own.is_some())
        .flat_map(|((pixels, _), offset)| {
            pixels.iter().map(move |[value, error]| [value - offset, *error])
        })
        .collect();
    let values = sorted(&mut aligned.iter().map(|[value, _]| *value));
    if values.is_empty() {
        return CloudThreshold {
            by_view: vec![0.0; views.len()],
            shaded_by_view: vec![f32::NEG_INFINITY; views.len()],
            contrast: None,
        };
    }
    let background = half_sample_mode(&values);
    let lower = values.partition_point(|&radiance| radiance <= background);
    let upper = values.partition_point(|&radiance| radiance < background);
    let (below, above) = (&values[..lower], &values[upper..]);
    let median = |side: &[f64]| side.get(side.len() / 2).map(|middle| (middle - background).abs());
    let narrower =
        [median(below), median(above)].into_iter().flatten().fold(f64::INFINITY, f64::min);
    let brightest = values[values.len() - 1];
    let rise = match narrower {
        // Images of very few grey levels are separated in the middle.
        0.0 => (LEVELS * grey_level).min(0.5 * (brightest - background)),
        _ => DEVIATIONS * DEVIATIONS_PER_MEDIAN * narrower,
    };
    let dark = aligned.iter().filter(|[value, _]| *value <= background);
    let noise = sorted(&mut dark.map(|[_, error]| *error));
    let noise = noise.get(noise.len() / 2).copied().unwrap_or(0.0);
    let rise = rise.max(LEAST_RISE * background.abs()).max(DEVIATIONS * noise);
    let bright = values[((1.0 - BRIGHTEST_SHARE) * (values.len() - 1) as f64) as usize];
    let is_grey = background > GREY_GROUND * white;
    let below = if is_grey { rise } else { f64::INFINITY };
    CloudThreshold {
        by_view: offsets.iter().map(|offset| (background + offset + rise) as f32).collect(),
        shaded_by_view: offsets.iter().map(|offset| (background + offset - below) as f32).collect(),
        contrast: is_grey.then(|| bright / background),
    }
}

/// The smallest difference between sorted values that are not equal: for quantised images, a grey
/// level. Infinite if all values are equal.
fn smallest_step(sorted: &[f64]) -> f64 {
    let steps = sorted.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0.0);
    steps.fold(f64::INFINITY, f64::min)
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

    /// The thresholds where a white surface has a radiance of 0.25/sr; pixels above 0.3/sr are
    /// saturated.
    fn of(images: &ViewStack, standard_error: Option<&ViewStack>) -> CloudThreshold {
        let known = images.values.mapv(|radiance| radiance < 0.3);
        super::threshold(images, standard_error, &known, 0.25)
    }

    fn threshold(images: &ViewStack, standard_error: Option<&ViewStack>) -> f64 {
        f64::from(of(images, standard_error).by_view[0])
    }

    #[test]
    fn the_threshold_is_three_deviations_above_the_background() {
        let found = threshold(&images(0.0005, 0, 0), None);
        assert!((found - 0.0153).abs() < 0.0002, "{found}");
    }

    /// Clouds and shadows on 25 to 40 % of the pixels broaden the distribution, but the threshold
    /// stays between the noise of the background and the thinnest cloud.
    #[test]
    fn clouds_and_their_shadows_do_not_hide_the_background() {
        for (shadows, clouds) in [(2000, 500), (500, 2000), (1700, 1700), (0, 4000), (4000, 0)] {
            let found = threshold(&images(0.0005, shadows, clouds), None);
            assert!((0.0148..0.0165).contains(&found), "{shadows} {clouds} {found}");
        }
    }

    #[test]
    fn without_noise_a_twentieth_above_the_background() {
        let found = threshold(&images(0.0, 1000, 1000), None);
        assert!((found / 0.0138 - 1.05).abs() < 1e-4, "{found}");
        let dark = ViewStack::new(Array3::zeros((2, 3, 4))).unwrap();
        assert_eq!(threshold(&dark, None), 0.0);
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
        let found = threshold(&images, None);
        let errors = ViewStack::new(images.values.mapv(|_| 0.002)).unwrap();
        assert!((threshold(&images, Some(&errors)) - 0.006).abs() < 1e-6);
        assert!((found / (3.0 * level) - 1.0).abs() < 1e-3, "{found}");
        let above =
            images.values.iter().skip(800).filter(|value| f64::from(**value) > found).count();
        assert!(above < 5, "{above}");
    }

    /// The light of the atmosphere in slanted views, and saturated pixels, which are left out.
    #[test]
    fn every_view_has_its_own_background() {
        let one = images(0.0005, 500, 2000).values;
        let far = one.mapv(|value| if value > 0.05 { 0.3 } else { value + 0.03 });
        let both = ndarray::concatenate(Axis(0), &[one.view(), far.view()]).unwrap();
        let found = of(&ViewStack::new(both).unwrap(), None);
        assert!((0.0148..0.0165).contains(&found.by_view[0]), "{found:?}");
        assert!((found.by_view[1] - found.by_view[0] - 0.03).abs() < 5e-4, "{found:?}");
        assert!(!found.is_bright_ground());
    }

    /// A view that clouds fill has the threshold of the others.
    #[test]
    fn an_overcast_view_has_no_background() {
        let one = images(0.0005, 500, 2000).values;
        let overcast = one.mapv(|value| 0.15 + value);
        let both = ndarray::concatenate(Axis(0), &[one.view(), overcast.view()]).unwrap();
        let found = of(&ViewStack::new(both).unwrap(), None);
        assert!((0.0148..0.0165).contains(&found.by_view[0]), "{found:?}");
        assert!((0.0148..0.0165).contains(&found.by_view[1]), "{found:?}");
    }

    /// Clouds above ground of an albedo of 0.8 are hardly brighter than it.
    #[test]
    fn ground_as_bright_as_clouds_is_recognised() {
        let bright = images(0.0005, 500, 2000).values.mapv(|value| 0.2 + 0.2 * value);
        let bright = ViewStack::new(bright).unwrap();
        assert!(of(&bright, None).is_bright_ground());
        assert!(!of(&images(0.0005, 500, 2000), None).is_bright_ground());
    }

    #[test]
    fn the_half_sample_mode_of_a_few_values() {
        assert_eq!(half_sample_mode(&[3.0]), 3.0);
        assert_eq!(half_sample_mode(&[1.0, 4.0]), 2.5);
        assert_eq!(half_sample_mode(&[0.0, 5.0, 5.1, 9.0, 20.0]), 5.05);
    }
}
