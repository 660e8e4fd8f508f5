//! Derivatives by the discrete-ordinates solver, compared with differences of Monte Carlo images.
//!
//! The derivative is that of the radiance of a view, summed over its pixels, with respect to a
//! scaling factor of the extinction of the cloud or of its upper half. The Monte Carlo images for
//! both factors use the same random numbers, which cancels much of their noise; their standard
//! error is computed as if they were independent.

use super::{Reference, Report, cloud_cases};
use crate::error::Result;
use crate::image::ViewStack;
use crate::scene::Scene;
use crate::transport::{
    MonteCarloSettings, OrdinatesModel, OrdinatesSettings, Share, Solver, render,
};
use ndarray::Array3;

/// Accepted relative difference between the two derivatives.
const ACCURACY: f64 = 0.05;
/// The extinction is scaled by 1 plus and minus this.
const STEP: f32 = 0.1;
/// Photon paths per pixel in a short and in a long run.
const PATHS: [u32; 2] = [2000, 10_000];

pub(super) fn run(report: &mut Report) -> Result<()> {
    let long = report.effort.relative_error.is_some();
    // A cloud of droplets in the molecular atmosphere above the ocean surface, and a cloud with a
    // Henyey-Greenstein phase function above a black surface.
    let count = if long { 2 } else { 1 };
    for number in [0, 2].into_iter().take(count) {
        let case = &cloud_cases(None)?[number];
        let extinction = &case.scene.medium.extinction;
        let settings = OrdinatesSettings::default();
        let mut model = OrdinatesModel::new(&case.scene, &case.views, None, &settings)?;
        let images = model.images(extinction)?;
        let parts = [("cloud", whole(extinction)), ("upper half", upper_half(extinction))];
        for (what, part) in parts.into_iter().take(count) {
            let direction = &extinction.values * &part;
            let scaled = |factor: f32| -> Result<(ViewStack, ViewStack)> {
                let mut scene: Scene = case.scene.clone();
                scene.medium.extinction.values =
                    &extinction.values + &(&direction * (factor - 1.0));
                let settings = MonteCarloSettings {
                    samples_per_pixel: PATHS[usize::from(long)],
                    seed: report.effort.seed,
                    ..MonteCarloSettings::default()
                };
                let rendering = render(&scene, &case.views, &Solver::MonteCarlo(settings), &())?;
                let error = rendering.standard_error.expect("of the Monte Carlo solver");
                Ok((rendering.images, error))
            };
            let (more, less) = (scaled(1.0 + STEP)?, scaled(1.0 - STEP)?);
            let mut views: Vec<Option<usize>> = vec![None];
            if long {
                views.extend((0..case.views.len()).map(Some));
            }
            for view in views {
                let seen = |values: &Array3<f32>, power: i32| -> f64 {
                    let all = values.outer_iter().enumerate();
                    all.filter(|(number, _)| view.is_none_or(|view| view == *number))
                        .flat_map(|(_, image)| image.to_owned())
                        .map(|value| f64::from(value).powi(power))
                        .sum()
                };
                let step = 2.0 * f64::from(STEP);
                let difference = (seen(&more.0.values, 1) - seen(&less.0.values, 1)) / step;
                let variance = seen(&more.1.values, 2) + seen(&less.1.values, 2);
                let weights = Array3::from_shape_fn(images.values.raw_dim(), |(number, ..)| {
                    f32::from(u8::from(view.is_none_or(|view| view == number)))
                });
                let gradient = model.gradient(&ViewStack::new(weights)?)?;
                let products = gradient.values.iter().zip(&direction);
                let derivative: f64 = products.map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
                let name = view.map_or("all views".to_owned(), |view| format!("view {view}"));
                let case = format!("{}: scale of the {what}, {name}, over Monte Carlo", case.name);
                let standard_error = variance.sqrt() / step / difference.abs();
                let ratio = Share { mean: derivative / difference, standard_error };
                let one = Reference { systematic: ACCURACY, ..Reference::new(1.0, 0.0) };
                report.compare(&[(case, ratio, one)]);
            }
        }
    }
    Ok(())
}

fn whole(extinction: &crate::grid::Volume) -> Array3<f32> {
    Array3::from_elem(extinction.values.raw_dim(), 1.0)
}

/// Weights of 1 in the upper half of the cloudy levels and 0 elsewhere.
fn upper_half(extinction: &crate::grid::Volume) -> Array3<f32> {
    let cloudy = |(level, values): (usize, ndarray::ArrayView2<f32>)| {
        values.iter().any(|value| *value > 0.0).then_some(level)
    };
    let levels: Vec<usize> =
        extinction.values.outer_iter().enumerate().filter_map(cloudy).collect();
    let middle = levels.get(levels.len() / 2).copied().unwrap_or(0);
    Array3::from_shape_fn(extinction.values.raw_dim(), |(level, ..)| {
        f32::from(u8::from(level >= middle))
    })
}
