//! Tests of fields against definitions, plain traversals, and periodic copies.

use super::*;
use crate::grid::Volume;
use crate::math::{Ray, towards};
use crate::optics::PhaseFunction;
use crate::traverse::walk;
use ndarray::Array3;

/// Two clumps in a mostly empty grid.
fn sparse() -> Medium {
    let spacing = DVec3::new(0.05, 0.04, 0.03);
    let grid = Grid::new(DVec3::new(-0.2, 0.3, 0.5), spacing, [17, 15, 19]).unwrap();
    let values = Array3::from_shape_fn(grid.shape, |(k, j, i)| {
        let lump = |z: i32, y: i32, x: i32| {
            (k as i32 - z).pow(2) + (j as i32 - y).pow(2) + (i as i32 - x).pow(2) < 6
        };
        let inside = lump(3, 4, 4) || lump(12, 9, 15);
        if inside { 1.0 + ((i * 7 + j * 3 + k) % 5) as f32 } else { 0.0 }
    });
    let extinction = Volume::new(grid, values).unwrap();
    Medium::new(extinction, 1.0, PhaseFunction::Isotropic).unwrap()
}

/// Rays across the whole grid, from outside and from inside.
fn rays(grid: &Grid) -> Vec<Ray> {
    let ray = |number: u32| {
        let angle = f64::from(number);
        let part = DVec3::new(0.618, 0.317, 0.733) * angle;
        let aim = grid.lower() + grid.extent() * (part - part.floor());
        let direction = towards(0.0041 * angle, 2.4 * angle);
        let back = if number.is_multiple_of(3) { 0.0 } else { 2.0 };
        Ray { origin: aim - back * direction, direction }
    };
    let axes = [DVec3::X, -DVec3::X, DVec3::Y, -DVec3::Y, DVec3::Z, -DVec3::Z];
    let along =
        axes.map(|axis| Ray { origin: grid.voxel_center([3, 4, 4]) - axis, direction: axis });
    (0..750).map(ray).chain(along).collect()
}

fn depth(field: &Field, ray: &Ray) -> f64 {
    field.optical_depth(field.local(ray.origin), &field.heading(ray.direction), f64::INFINITY)
}

/// Trilinear extinction at a point, by definition.
fn trilinear(medium: &Medium, point: DVec3, periodic: bool) -> f64 {
    let grid = &medium.extinction.grid;
    let [nz, ny, nx] = grid.shape.map(|n| n as i64);
    let place = (point - grid.lower()) / grid.spacing - 0.5;
    let base = place.floor();
    let mut sum = 0.0;
    for corner in 0..8 {
        let offset =
            DVec3::new(f64::from(corner & 1), f64::from(corner >> 1 & 1), f64::from(corner >> 2));
        let node = base + offset;
        let [mut i, mut j, k] = [node.x as i64, node.y as i64, node.z as i64];
        let weight = (DVec3::ONE - (place - node).abs()).max(DVec3::ZERO);
        if periodic {
            (i, j) = (i.rem_euclid(nx), j.rem_euclid(ny));
        }
        // Outside the outermost centres the extinction is zero, without a transition.
        let low = if periodic { place.z } else { place.min_element() };
        let high = DVec3::new(nx as f64, ny as f64, nz as f64) - 1.0 - place;
        let high = if periodic { high.z } else { high.min_element() };
        let known = (0..nx).contains(&i) && (0..ny).contains(&j) && (0..nz).contains(&k);
        if known && low >= 0.0 && high >= 0.0 {
            let value = medium.extinction.values[[k as usize, j as usize, i as usize]];
            sum += weight.x * weight.y * weight.z * f64::from(value);
        }
    }
    sum
}

#[test]
fn optical_depth_of_voxels_is_the_sum_over_a_plain_walk() {
    let medium = sparse();
    let grid = medium.extinction.grid;
    let field = Field::new(&medium, Boundary::Open);
    let mut met = 0;
    for ray in rays(&grid) {
        let expected: f64 = walk(&grid, &ray)
            .map(|step| (step.exit - step.enter) * f64::from(medium.extinction.values[step.voxel]))
            .sum();
        let found = depth(&field, &ray);
        assert!((found - expected).abs() < 1e-9, "{ray:?}: {found} {expected}");
        met += u32::from(expected > 0.0);
    }
    assert!(met > 50, "{met}");
}

#[test]
fn optical_depth_between_centres_is_the_integral() {
    for boundary in [Boundary::Open, Boundary::Periodic] {
        let medium = sparse().with_interpolation(Interpolation::Trilinear);
        let grid = medium.extinction.grid;
        let field = Field::new(&medium, boundary);
        for ray in rays(&grid).iter().step_by(11).filter(|ray| ray.direction.z.abs() > 0.3) {
            let steps = 8_000;
            let width = 6.0 / f64::from(steps);
            let expected: f64 = (0..steps)
                .map(|step| ray.at(width * (f64::from(step) + 0.5)))
                .map(|point| width * trilinear(&medium, point, boundary == Boundary::Periodic))
                .sum();
            let found = depth(&field, ray);
            assert!((found - expected).abs() < 1e-4, "{ray:?}: {found} {expected}");
        }
    }
}

#[test]
fn a_periodic_field_is_a_field_of_copies() {
    let medium = sparse();
    let grid = medium.extinction.grid;
    let field = Field::new(&medium, Boundary::Periodic);
    let [nz, ny, nx] = grid.shape;
    let copies = 9;
    let shift = grid.extent() * DVec3::new(1.0, 1.0, 0.0) * (copies / 2) as f64;
    let wide = Grid::new(grid.origin - shift, grid.spacing, [nz, copies * ny, copies * nx]);
    let values = Array3::from_shape_fn(wide.as_ref().unwrap().shape, |(k, j, i)| {
        medium.extinction.values[[k, j % ny, i % nx]]
    });
    let wide = Medium { extinction: Volume::new(wide.unwrap(), values).unwrap(), ..medium };
    let open = Field::new(&wide, Boundary::Open);
    for ray in rays(&grid).iter().filter(|ray| ray.direction.z.abs() > 0.3) {
        let (found, expected) = (depth(&field, ray), depth(&open, ray));
        assert!((found - expected).abs() < 1e-9, "{ray:?}: {found} {expected}");
    }
}

#[test]
fn a_free_path_ends_where_the_optical_depth_is_reached() {
    for interpolation in [Interpolation::Constant, Interpolation::Trilinear] {
        for boundary in [Boundary::Open, Boundary::Periodic] {
            let medium = sparse().with_interpolation(interpolation);
            let field = Field::new(&medium, boundary);
            for ray in rays(&medium.extinction.grid) {
                let total = depth(&field, &ray);
                let heading = field.heading(ray.direction);
                let origin = field.local(ray.origin);
                if ray.direction.z.abs() < 0.1 || total == 0.0 {
                    continue;
                }
                let target = 0.37 * total;
                let distance = field.free_path(origin, &heading, target).unwrap();
                let rest = Ray { origin: ray.at(distance), ..ray };
                assert!((total - depth(&field, &rest) - target).abs() < 1e-9, "{ray:?}");
                assert!(field.free_path(origin, &heading, 1.001 * total).is_none());
            }
        }
    }
}

#[test]
fn a_point_knows_its_voxel() {
    for interpolation in [Interpolation::Constant, Interpolation::Trilinear] {
        for boundary in [Boundary::Open, Boundary::Periodic] {
            let medium = sparse().with_interpolation(interpolation);
            let grid = medium.extinction.grid;
            let field = Field::new(&medium, boundary);
            for voxel in [[0, 0, 0], [3, 4, 5]] {
                let point = grid.voxel_center(voxel) + 0.4 * grid.spacing;
                assert_eq!(field.voxel(field.local(point)), voxel);
                let next = point + DVec3::new(grid.extent().x, -grid.extent().y, 0.0);
                if boundary == Boundary::Periodic {
                    assert_eq!(field.voxel(field.local(next)), voxel);
                }
            }
        }
    }
}

#[test]
fn an_empty_field_has_no_depth() {
    let grid = sparse().extinction.grid;
    let empty = Medium::new(Volume::constant(grid, 0.0), 1.0, PhaseFunction::Isotropic).unwrap();
    for boundary in [Boundary::Open, Boundary::Periodic] {
        let field = Field::new(&empty, boundary);
        let ray = Ray { origin: grid.center(), direction: towards(1.0, 1.0) };
        assert_eq!(depth(&field, &ray), 0.0);
    }
}
