//! Tests of the parts of the solver: transposes by dot products, and analytic radiances.

use super::beam::{spread_sun_depth, sun_depth};
use super::derivative::ByMedium;
use super::tests::{bare, cloud, grid, model};
use super::*;
use crate::math::towards;
use crate::optics::Interpolation;
use crate::rng::{Purpose, RngExt, Stream, stream};
use crate::scene::View;
use std::f64::consts::PI;

fn numbers(rng: &mut Stream, count: usize) -> Vec<f64> {
    (0..count).map(|_| rng.random_range(-1.0..1.0)).collect()
}

fn dot(one: &[f64], other: &[f64]) -> f64 {
    one.iter().zip(other).map(|(a, b)| a * b).sum()
}

/// The two sides of `<J v, w> = <v, J' w>` agree up to the rounding of single precision.
fn assert_transposed(what: &str, one: f64, other: f64) {
    assert!((one - other).abs() <= 2e-5 * one.abs().max(other.abs()), "{what}: {one} {other}");
}

/// Solved models of a cloud whose voxels are divided into cells, for both interpolations and kinds of
/// sides.
fn models() -> impl Iterator<Item = (OrdinatesModel, Stream)> {
    let extinction = cloud(60.0);
    let both = [Interpolation::Constant, Interpolation::Trilinear];
    both.into_iter().flat_map(move |interpolation| {
        let extinction = extinction.clone();
        [Boundary::Open, Boundary::Periodic].into_iter().map(move |boundary| {
            let mut model = model(&extinction, interpolation, boundary);
            model.images(&extinction).unwrap();
            (model, stream(7, Purpose::Validation, &[]))
        })
    })
}

fn random_points(model: &OrdinatesModel, rng: &mut Stream) -> Vec<(usize, DVec3, f64)> {
    let point = |_| {
        let slot = rng.random_range(0..model.lattice.len());
        let at = DVec3::new(rng.random(), rng.random(), rng.random());
        (slot, at, rng.random_range(-1.0..1.0))
    };
    (0..200).map(point).collect()
}

#[test]
fn values_and_coefficients_of_cells_have_their_transposes() {
    for (model, mut rng) in models() {
        let lattice = &model.lattice;
        let count = grid().shape.iter().product();
        let direction = numbers(&mut rng, count);
        let voxels: Vec<f32> = direction.iter().map(|value| *value as f32).collect();
        let direction: Vec<f64> = voxels.iter().map(|value| f64::from(*value)).collect();
        let points = random_points(&model, &mut rng);
        let (mut forward, mut spread) = (0.0, vec![0.0; count]);
        for (slot, at, weight) in &points {
            forward += weight * lattice.value(&voxels, *slot, *at);
            lattice.spread(&mut spread, *slot, *at, *weight);
        }
        assert_transposed("value", forward, dot(&spread, &direction));
        let (mut forward, mut spread) = (0.0, vec![0.0; count]);
        for (slot, at, weight) in &points {
            let weights = [*weight, at.x, at.y, -at.z].map(|value| value as f32);
            let found = lattice.coefficients(&voxels, *slot);
            forward += found.iter().zip(weights).map(|(a, b)| f64::from(a * b)).sum::<f64>();
            lattice.spread_coefficients(&mut spread, *slot, weights);
        }
        assert_transposed("coefficients", forward, dot(&spread, &direction));
    }
}

/// Optical depths are linear in the extinction, so that their derivative is the operator itself.
#[test]
fn depths_towards_the_sun_have_their_transpose() {
    for (model, mut rng) in models() {
        let sun = model.scene.sun.towards();
        let extinction = &model.state.as_ref().unwrap().extinction;
        let rays = model.rays(extinction);
        let depths = rays.sun_depths(sun, |_| 0.0);
        let weights: Vec<[f32; 8]> =
            depths.iter().map(|_| std::array::from_fn(|_| rng.random_range(-1.0..1.0))).collect();
        let pairs = depths.as_flattened().iter().zip(weights.as_flattened());
        let forward: f64 = pairs.map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
        let mut spread = ByMedium::new(&rays);
        rays.spread_sun_depths(sun, &weights, &mut spread);
        let voxels: Vec<f64> = extinction.iter().map(|value| f64::from(*value)).collect();
        assert_transposed("depths", forward, dot(&spread.extinction, &voxels));
        // They are also linear in the delta-M scaling factor, the same in all voxels.
        let scaling = f64::from(rays.optics.delta_m_scaling(0));
        assert_transposed("scaling", forward, scaling * spread.scaling[0]);
    }
}

/// The depth in a cell is linear between its eight points and never negative; its transpose is that of
/// the interpolation where it is positive.
#[test]
fn depths_in_a_cell_are_interpolated_and_not_negative() {
    let depths = [0.1, 0.4, 0.2, 0.9, 0.3, 0.5, 0.7, 1.1];
    let low = [0.0, 10.0, 0.0, 10.0, 0.0, 10.0, 0.0, 10.0];
    assert_eq!(sun_depth(&low, DVec3::new(0.05, 0.5, 0.5)), 0.0);
    for at in [DVec3::new(0.3, 0.6, 0.2), DVec3::new(0.95, 0.1, 0.7)] {
        let mut spread = [0.0; 8];
        spread_sun_depth(&mut spread, &depths, at, 2.0);
        let pairs = spread.iter().zip(depths);
        let sum: f64 = pairs.map(|(a, b)| f64::from(*a) * f64::from(b)).sum();
        assert!((sum - 2.0 * sun_depth(&depths, at)).abs() < 1e-6);
    }
}

/// The sunlight removed from the beam, against central differences by extinction and by depth.
#[test]
fn stopped_sunlight_has_its_derivative() {
    for (model, mut rng) in models() {
        let State { extinction, sun_depths, .. } = model.state.as_ref().unwrap();
        let moves: Vec<f32> = extinction.iter().map(|value| 0.01 * value).collect();
        let shifts: Vec<[f32; 8]> = sun_depths
            .iter()
            .map(|_| std::array::from_fn(|_| rng.random_range(0.0..0.01)))
            .collect();
        let weights: Vec<[f32; 4]> = sun_depths
            .iter()
            .map(|_| std::array::from_fn(|_| rng.random_range(0.0..1.0)))
            .collect();
        let value = |sign: f32| -> f64 {
            let moved: Vec<f32> =
                extinction.iter().zip(&moves).map(|(value, step)| value + sign * step).collect();
            let mut depths = sun_depths.clone();
            let pairs = depths.as_flattened_mut().iter_mut().zip(shifts.as_flattened());
            pairs.for_each(|(depth, shift)| *depth += sign * shift);
            let stopped = model.rays(&moved).stopped(&depths);
            let pairs = stopped.as_flattened().iter().zip(weights.as_flattened());
            pairs.map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
        };
        let difference = 0.5 * (value(1.0) - value(-1.0));
        let mut by_voxel = vec![0.0; extinction.len()];
        let mut by_depth = vec![[0.0; 8]; sun_depths.len()];
        model.rays(extinction).spread_stopped(sun_depths, &weights, &mut by_voxel, &mut by_depth);
        let first: f64 = by_voxel.iter().zip(&moves).map(|(a, b)| a * f64::from(*b)).sum();
        let pairs = by_depth.as_flattened().iter().zip(shifts.as_flattened());
        let second: f64 = pairs.map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
        let derivative = first + second;
        assert!((derivative / difference - 1.0).abs() < 1e-3, "{derivative} {difference}");
    }
}

/// The shadow of the cloud on the surface and the light of the cloud that the surface reflects, through
/// the faces of the grid and back.
#[test]
fn the_surface_has_its_transposes() {
    for (model, mut rng) in models() {
        let (lattice, surroundings) = (&model.lattice, &model.surroundings);
        let state = model.state.as_ref().unwrap();
        let spacing = lattice.grid.spacing;
        let mut compared = 0;
        for octant in &model.quadrature.octants {
            // Adjoint radiance at the faces through which the octant's light enters.
            let mut leaving = Faces::dark(lattice, octant);
            for values in [&mut leaving.x, &mut leaving.y, &mut leaving.z] {
                values.iter_mut().for_each(|value| *value = rng.random_range(0.0..1.0));
            }
            // Streaming through the faces, weighted by the adjoint radiance.
            let inner = |faces: &Faces| -> f64 {
                let sides =
                    [(&faces.x, &leaving.x), (&faces.y, &leaving.y), (&faces.z, &leaving.z)];
                let mut sum = 0.0;
                for (axis, (values, adjoint)) in sides.into_iter().enumerate() {
                    let rows = values.chunks_exact(3 * octant.ordinates);
                    for (row, other) in rows.zip(adjoint.chunks_exact(3 * octant.ordinates)) {
                        let directions = octant.cosines[axis].iter().zip(&octant.weights);
                        for ((value, adjoint), (cosine, weight)) in
                            row.iter().zip(other).zip(directions)
                        {
                            let streaming = f64::from(cosine * weight) / spacing[axis];
                            sum += streaming * f64::from(*value) * f64::from(*adjoint);
                        }
                    }
                }
                sum
            };
            let shade: Vec<f32> = state.shade.iter().map(|_| rng.random_range(0.0..1.0)).collect();
            let none = vec![0.0; shade.len()];
            let difference = inner(&surroundings.incoming(lattice, octant, &shade))
                - inner(&surroundings.incoming(lattice, octant, &none));
            let mut spread = vec![0.0; shade.len()];
            surroundings.spread_incoming(lattice, octant, &mut leaving.clone(), &mut spread);
            let shade: Vec<f64> = shade.iter().map(|value| f64::from(*value)).collect();
            // A difference of two sums in single precision; no light comes up through downward faces.
            let found = dot(&spread, &shade);
            assert!((found - difference).abs() <= 1e-4 * difference.abs(), "{found} {difference}");
            compared += usize::from(difference != 0.0);

            let irradiance: Vec<f32> =
                state.field.irradiance.iter().map(|_| rng.random_range(0.0..1.0)).collect();
            let mut reflected = Faces::dark(lattice, octant);
            surroundings.add_reflected(lattice, octant, &irradiance, &mut reflected);
            let mut sums = vec![0.0; irradiance.len()];
            surroundings.add_irradiance(lattice, octant, &mut leaving.clone(), &mut sums);
            let unit = surroundings.as_irradiance(lattice, &vec![1.0; irradiance.len()])[0];
            let irradiance: Vec<f64> = irradiance.iter().map(|value| f64::from(*value)).collect();
            let found = dot(&sums, &irradiance);
            assert_transposed("reflected", f64::from(unit) * inner(&reflected), found);
        }
        assert!(compared >= 1, "no octant sees the shadow");
    }
}

/// A block of constant extinction with isotropic diffuse radiance `J` and no direct sunlight emits
/// `J (1 - exp(-depth))` towards any camera.
#[test]
fn a_uniform_source_is_seen_through_its_own_depth() {
    let extinction = Volume::constant(grid(), 25.0);
    let scene = bare(&extinction, 0.0);
    for (zenith, tolerance) in [(0.0, 2e-4), (0.6, 2e-3)] {
        let target = grid().center();
        let view = View::orthographic(towards(zenith, 0.4), target, 0.02, [1, 1]).unwrap();
        let mut model = OrdinatesModel::new(
            &scene,
            std::slice::from_ref(&view),
            None,
            &OrdinatesSettings::default(),
        )
        .unwrap();
        model.images(&extinction).unwrap();
        let mut state = model.state.take().unwrap();
        state.sun_depths.iter_mut().for_each(|depths| *depths = [100.0; 8]);
        state.field.moments.fill(0.0);
        let radiance = 0.3;
        for moments in state.field.moments.chunks_exact_mut(4 * model.quadrature.harmonics) {
            moments[0] = (radiance * (4.0 * PI).sqrt()) as f32;
        }
        let camera = model.camera(&state);
        let prepared = camera.prepare(&model.tiles[0], &view);
        let found = camera.radiance(&view, [0, 0], &prepared);
        let depth = 25.0 * grid().extent().z / zenith.cos();
        let expected = radiance * -(-depth).exp_m1();
        assert!((found / expected - 1.0).abs() < tolerance, "{zenith}: {found} {expected}");
    }
}
