//! The Monte Carlo solver: means over sampled photon paths.
//!
//! Backward path tracing (Marchuk et al. 1980): paths start in a pixel, are scattered at random,
//! and collect direct sunlight at each scattering (next-event estimation). Samples are drawn in
//! rounds, between which the solver may stop.

use super::path::Tracer;
use super::{BRIGHT, Progress, Rendering, Watch};
use crate::error::{Error, Result};
use crate::image::ViewStack;
use crate::math::Ray;
use crate::rng::{Purpose, RngExt, stream};
use crate::scene::{Scene, View};
use ndarray::Array3;
use rayon::prelude::*;

/// Number of rounds if the number of samples is given.
const ROUNDS: u32 = 32;
/// Smallest number of samples per pixel in a round.
const SMALLEST_ROUND: u32 = 16;
/// Largest number in a round without a noise to reach; a round that is stopped is lost.
const LARGEST_ROUND: u32 = 256;
/// Number of samples per pixel in the first round if a noise is given.
const FIRST_ROUND: u32 = 64;

/// Settings of the Monte Carlo solver.
#[derive(Debug, Clone, PartialEq)]
pub struct MonteCarloSettings {
    /// Number of photon paths per pixel, at least 2; the maximum number if `noise` is given.
    pub samples_per_pixel: u32,
    /// Stop as soon as [`Progress::noise`] does not exceed this value.
    pub noise: Option<f64>,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Number of scatterings after which a path continues in similar media with progressively lower
    /// extinction and weaker forward peaks: faster and less noisy, but biased. With 4, the view
    /// means of thick clouds are less than 0.4 % off. `None`, the default, is unbiased.
    pub similarity_after: Option<u32>,
}

impl Default for MonteCarloSettings {
    fn default() -> Self {
        Self { samples_per_pixel: 256, noise: None, seed: 1, similarity_after: None }
    }
}

impl MonteCarloSettings {
    fn check(&self) -> Result<()> {
        if self.samples_per_pixel < 2 {
            return Err(Error::out_of_range(
                "samples per pixel",
                self.samples_per_pixel,
                "at least 2, from which the standard error is estimated",
            ));
        }
        match self.noise {
            Some(noise) if !(noise > 0.0 && noise < 1.0) => Err(Error::out_of_range(
                "noise",
                noise,
                "above 0 and below 1, such as 0.01 for 1 %",
            )),
            _ => Ok(()),
        }
    }

    /// Number of samples per pixel to draw next; 0 if there are enough.
    fn next_round(&self, drawn: u32, noise: f64) -> u32 {
        let left = self.samples_per_pixel - drawn;
        let Some(wanted) = self.noise else {
            let round =
                self.samples_per_pixel.div_ceil(ROUNDS).clamp(SMALLEST_ROUND, LARGEST_ROUND);
            // A small remainder is merged into the last round.
            return if left < 2 * round { left } else { round };
        };
        if drawn == 0 {
            return left.min(FIRST_ROUND);
        }
        if noise <= wanted {
            return 0;
        }
        let missing = f64::from(drawn) * ((noise / wanted).powi(2) - 1.0);
        left.min((missing.ceil() as u32).clamp(SMALLEST_ROUND, drawn.max(SMALLEST_ROUND)))
    }
}

/// A radiance (1/sr for a Sun of unit irradiance) and its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Radiance {
    /// Mean of the samples.
    pub mean: f64,
    /// Standard error of the mean.
    pub standard_error: f64,
}

/// Sums of the samples and of their squares.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    count: u32,
    first: f64,
    second: f64,
}

impl Sums {
    fn draw(count: u32, mut sample: impl FnMut() -> f64) -> Self {
        let mut sums = Self { count, ..Self::default() };
        for _ in 0..count {
            let value = sample();
            sums.first += value;
            sums.second += value * value;
        }
        sums
    }

    fn add(&mut self, other: Self) {
        self.count += other.count;
        self.first += other.first;
        self.second += other.second;
    }

    fn mean(&self) -> f64 {
        self.first / f64::from(self.count.max(1))
    }

    fn radiance(&self, irradiance: f64) -> Radiance {
        let (count, mean) = (f64::from(self.count), self.mean());
        let variance = (self.second / count - mean * mean).max(0.0) / (count - 1.0);
        Radiance { mean: irradiance * mean, standard_error: irradiance * variance.sqrt() }
    }
}

/// Samples of all pixels so far.
struct Film {
    sums: Vec<Sums>,
    pixels_per_view: usize,
}

impl Film {
    /// Number of samples per pixel to draw next, the same for all pixels. A pixel that stops when
    /// its own samples agree would stop before rare bright samples occur, and be biased low.
    fn next_round(&self, settings: &MonteCarloSettings) -> u32 {
        settings.next_round(self.sums[0].count, self.noise())
    }

    /// See [`Progress::noise`].
    fn noise(&self) -> f64 {
        let (mut squares, mut count) = (0.0, 0.0);
        for view in self.sums.chunks(self.pixels_per_view) {
            let bright = BRIGHT * brightest(view);
            for sums in view.iter().filter(|sums| sums.first > 0.0 && sums.mean() >= bright) {
                let Radiance { mean, standard_error } = sums.radiance(1.0);
                squares += (standard_error / mean).powi(2);
                count += 1.0;
            }
        }
        if count > 0.0 { f64::sqrt(squares / count) } else { 0.0 }
    }

    /// Progress of the rendering.
    fn progress(&self, settings: &MonteCarloSettings) -> Progress {
        let (noise, samples_per_pixel) = (self.noise(), self.sums[0].count);
        let by_number = f64::from(samples_per_pixel) / f64::from(settings.samples_per_pixel);
        let by_noise = settings.noise.map_or(0.0, |wanted| (wanted / noise).powi(2).min(1.0));
        Progress { share: by_number.max(by_noise), samples_per_pixel, noise }
    }
}

/// Mean radiance of the brightest pixel.
fn brightest(sums: &[Sums]) -> f64 {
    sums.iter().map(Sums::mean).fold(0.0, f64::max)
}

/// Render the images of `scene`, in parallel over pixels.
pub(super) fn render(
    scene: &Scene,
    views: &[View],
    settings: &MonteCarloSettings,
    watch: &dyn Watch,
) -> Result<Rendering> {
    settings.check()?;
    let tracer = Tracer::new(scene, settings.similarity_after)?;
    let (rows, cols) = (views[0].rows, views[0].cols);
    let pixels_per_view = rows * cols;
    let mut film =
        Film { sums: vec![Sums::default(); views.len() * pixels_per_view], pixels_per_view };
    let (mut count, mut round, mut interrupted) = (film.next_round(settings), 0, false);
    while count > 0 && !interrupted {
        let draw = |pixel: usize| {
            if watch.interrupted() {
                return None;
            }
            let (view, within) = (pixel / pixels_per_view, pixel % pixels_per_view);
            let (row, col) = ((within / cols) as f64, (within % cols) as f64);
            let key = [view as u64, within as u64, round];
            let mut rng = stream(settings.seed, Purpose::Transport, &key);
            Some(Sums::draw(count, || {
                let [up, right] = [rng.random::<f64>(), rng.random::<f64>()];
                tracer.radiance(&views[view].ray(row + up, col + right), &mut rng)
            }))
        };
        // An interrupted round is discarded, because its pixels would differ in their uncertainty.
        let pixels = (0..film.sums.len()).into_par_iter();
        let Some(drawn) = pixels.map(draw).collect::<Option<Vec<_>>>() else {
            if round == 0 {
                return Err(Error::Interrupted);
            }
            interrupted = true;
            break;
        };
        film.sums.iter_mut().zip(drawn).for_each(|(sums, drawn)| sums.add(drawn));
        watch.reached(&film.progress(settings));
        count = film.next_round(settings);
        round += 1;
        interrupted = watch.interrupted() && count > 0;
    }
    let brightness = |pixel: usize| {
        let (view, row, col) = (pixel / (rows * cols), pixel / cols % rows, pixel % cols);
        scene.brightness(views[view].ray(row as f64 + 0.5, col as f64 + 0.5).direction)
    };
    let stack = |value: fn(Radiance) -> f64| {
        let pixels = film.sums.iter().enumerate();
        let values = pixels.map(|(n, sums)| value(sums.radiance(brightness(n))) as f32);
        let shape = (views.len(), rows, cols);
        ViewStack::new(Array3::from_shape_vec(shape, values.collect()).expect("matching shape"))
    };
    Ok(Rendering {
        images: stack(|radiance| radiance.mean)?,
        standard_error: Some(stack(|radiance| radiance.standard_error)?),
        samples_per_pixel: film.sums[0].count,
        interrupted,
        converged: true,
        estimated_error: None,
        thickest_cell: 0.0,
        noise: Some(film.noise()),
    })
}

/// Radiance along each ray, computed in parallel over rays.
pub(super) fn radiances(
    scene: &Scene,
    rays: &[Ray],
    settings: &MonteCarloSettings,
) -> Result<Vec<Radiance>> {
    settings.check()?;
    let tracer = Tracer::new(scene, settings.similarity_after)?;
    let count = settings.samples_per_pixel;
    let radiance = |(number, ray): (usize, &Ray)| {
        let mut rng = stream(settings.seed, Purpose::Transport, &[number as u64]);
        let sums = Sums::draw(count, || tracer.radiance(ray, &mut rng));
        sums.radiance(scene.brightness(ray.direction))
    };
    Ok(rays.par_iter().enumerate().map(radiance).collect())
}
