//! Where lines of sight meet: a test of the geometry of images.

use crate::math::{DVec3, Ray};
use glam::DMat3;

/// Share of the information along the best known direction below which a point is not determined
/// along the least known one: rays that are parallel within about a degree.
const PARALLEL: f64 = 1e-4;

/// The point nearest to a number of lines of sight.
#[derive(Debug, Clone, PartialEq)]
pub struct Meeting {
    /// The point (km) for which the sum of the squared distances is least.
    pub point: DVec3,
    /// The distance of each line of sight from the point (km).
    pub distances: Vec<f64>,
}

impl Meeting {
    /// Where lines of sight meet; `None` for fewer than two, or if they are parallel.
    pub fn of(rays: &[Ray]) -> Option<Self> {
        // The squared distance of p from a ray through a along d is the length of N (p - a) squared,
        // where N = 1 - d d^T.
        let normal = |ray: &Ray| {
            let d = ray.direction.normalize();
            DMat3::IDENTITY - DMat3::from_cols(d * d.x, d * d.y, d * d.z)
        };
        let sum = rays.iter().fold(DMat3::ZERO, |sum, ray| sum + normal(ray));
        // The eigenvalues of the sum add up to twice the number of rays; the least one is small if the
        // rays are parallel, when the other two equal their number.
        let count = rays.len() as f64;
        if sum.determinant() <= PARALLEL * count.powi(3) {
            return None;
        }
        let right = rays.iter().fold(DVec3::ZERO, |sum, ray| sum + normal(ray) * ray.origin);
        let point = sum.inverse() * right;
        let distances = rays.iter().map(|ray| (normal(ray) * (point - ray.origin)).length());
        Some(Self { point, distances: distances.collect() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ray(origin: [f64; 3], direction: [f64; 3]) -> Ray {
        let direction = DVec3::from_array(direction).normalize();
        Ray { origin: DVec3::from_array(origin), direction }
    }

    #[test]
    fn rays_through_a_point_meet_there() {
        let point = DVec3::new(0.3, -0.7, 1.2);
        let towards = [[0.1, 0.2, 1.0], [-0.5, 0.3, 1.0], [0.0, -0.9, 1.0]];
        let rays = towards.map(|towards| {
            let towards = DVec3::from_array(towards).normalize();
            Ray { origin: point + 600.0 * towards, direction: -towards }
        });
        let meeting = Meeting::of(&rays).unwrap();
        assert!(meeting.point.distance(point) < 1e-9);
        assert!(meeting.distances.iter().all(|distance| *distance < 1e-9));
    }

    #[test]
    fn skew_rays_are_equally_far_from_the_middle() {
        let rays = [ray([5.0, 0.0, 0.0], [1.0, 0.0, 0.0]), ray([0.0, 7.0, 1.0], [0.0, 1.0, 0.0])];
        let meeting = Meeting::of(&rays).unwrap();
        assert!(meeting.point.distance(DVec3::new(0.0, 0.0, 0.5)) < 1e-12);
        assert!(meeting.distances.iter().all(|distance| (distance - 0.5).abs() < 1e-12));
    }

    #[test]
    fn parallel_rays_do_not_meet() {
        let rays = [ray([0.0; 3], [0.0, 0.0, -1.0]), ray([1.0, 0.0, 0.0], [0.0, 0.0, -1.0])];
        assert_eq!(Meeting::of(&rays), None);
        assert_eq!(Meeting::of(&rays[..1]), None);
        assert_eq!(Meeting::of(&[]), None);
    }
}
