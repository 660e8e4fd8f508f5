//! Tests of the tangent-linear model against the adjoint one and against finite differences.

use crate::grid::Volume;
use crate::image::ViewStack;
use crate::optics::Interpolation;
use crate::rng::{Purpose, RngExt, Stream, stream};
use crate::scene::Boundary;
use crate::transport::ordinates::OrdinatesModel;
use crate::transport::ordinates::tests::{cloud, grid, model};
use ndarray::Array3;

fn directions(rng: &mut Stream) -> Volume {
    let values = Array3::from_shape_simple_fn(grid().shape, || rng.random_range(-1.0..1.0));
    Volume::new(grid(), values).unwrap()
}

fn dot(one: &Array3<f32>, other: &Array3<f32>) -> f64 {
    one.iter().zip(other).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
}

fn norm(values: &Array3<f32>) -> f64 {
    dot(values, values).sqrt()
}

fn models(peak: f32) -> impl Iterator<Item = (String, OrdinatesModel)> {
    let both = [Interpolation::Constant, Interpolation::Trilinear];
    both.into_iter().flat_map(move |interpolation| {
        [Boundary::Open, Boundary::Periodic].into_iter().map(move |boundary| {
            let mut model = model(&cloud(peak), interpolation, boundary);
            model.images(&cloud(peak)).unwrap();
            (format!("{interpolation:?} {boundary:?} {peak}"), model)
        })
    })
}

/// `<J x, y> = <x, J' y>`.
#[test]
fn the_tangent_is_the_transpose_of_the_adjoint() {
    let mut rng = stream(11, Purpose::Validation, &[]);
    for peak in [0.1, 10.0, 150.0] {
        for (case, mut model) in models(peak) {
            let direction = directions(&mut rng);
            let images = model.directional_derivative(&direction).unwrap();
            let weights = Array3::from_shape_simple_fn(images.values.raw_dim(), || {
                rng.random_range(-1.0..1.0)
            });
            let gradient = model.gradient(&ViewStack::new(weights.clone()).unwrap()).unwrap();
            let forward = dot(&images.values, &weights);
            let backward = dot(&direction.values, &gradient.values);
            let size = norm(&images.values) * norm(&weights);
            assert!((forward - backward).abs() < 1e-5 * size, "{case}: {forward} {backward}");
        }
    }
}

/// Central differences of all pixels, in a direction that changes each voxel by up to `step` of its
/// extinction: more where the cloud is thin, since the images are in single precision. Both images
/// start from nothing: solutions that start from each other are closer than they should be.
#[test]
fn the_tangent_is_a_central_difference() {
    let mut rng = stream(12, Purpose::Validation, &[]);
    for (peak, step) in [(0.1, 0.5), (10.0, 0.03), (150.0, 0.01)] {
        for (case, mut model) in models(peak) {
            let extinction = cloud(peak);
            let mut direction = directions(&mut rng);
            direction.values *= &extinction.values;
            let expected = model.directional_derivative(&direction).unwrap();
            let mut moved = |step: f32| {
                let values = &extinction.values + &(step * &direction.values);
                model.forget();
                model.images(&Volume::new(grid(), values).unwrap()).unwrap().values
            };
            let difference = (moved(step) - moved(-step)) / (2.0 * step);
            let error = norm(&(&difference - &expected.values)) / norm(&expected.values);
            assert!(error < 1e-3, "{case}: {error}");
        }
    }
}

#[test]
fn nothing_has_no_effect() {
    for (_, mut model) in models(10.0) {
        let images = model.directional_derivative(&Volume::constant(grid(), 0.0)).unwrap();
        assert!(images.values.iter().all(|value| *value == 0.0));
        let gradient = model.gradient(&images).unwrap();
        assert!(gradient.values.iter().all(|value| *value == 0.0));
    }
}
