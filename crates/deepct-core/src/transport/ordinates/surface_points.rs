//! Points of the surface at which the cloud's shadow and its light are evaluated.

use crate::math::DVec3;

/// A regular lattice of points on the surface, infinite between periodic sides.
#[derive(Debug)]
pub(super) struct SurfacePoints {
    origin: DVec3,
    spacing: DVec3,
    rows: usize,
    cols: usize,
    periodic: bool,
}

impl SurfacePoints {
    /// Points that cover a rectangle, with approximately the spacing `wanted` along x and y; the
    /// rectangle is the period of a periodic lattice.
    pub(super) fn new(lower: DVec3, upper: DVec3, wanted: DVec3, periodic: bool) -> Self {
        let steps = ((upper - lower) / wanted).round().max(DVec3::ONE);
        let spacing = DVec3 { z: 0.0, ..(upper - lower) / steps };
        let count = |steps: f64| (steps as usize).saturating_add(usize::from(!periodic));
        Self { origin: lower, spacing, rows: count(steps.y), cols: count(steps.x), periodic }
    }

    /// Number of points, which may be too large for [`Self::len`].
    pub(super) fn count(&self) -> f64 {
        self.rows as f64 * self.cols as f64
    }

    /// Number of points.
    pub(super) fn len(&self) -> usize {
        self.rows * self.cols
    }

    /// Surface area per point (km2).
    pub(super) fn area(&self) -> f64 {
        self.spacing.x * self.spacing.y
    }

    /// Position of a point (km).
    pub(super) fn point(&self, number: usize) -> DVec3 {
        let (row, col) = (number / self.cols, number % self.cols);
        self.origin + self.spacing * DVec3::new(col as f64, row as f64, 0.0)
    }

    /// The four points around a position, and their weights, which are zero beyond the lattice.
    #[inline]
    pub(super) fn around(&self, place: DVec3) -> [(usize, f64); 4] {
        let along = |axis: usize, count: usize| {
            let x = (place[axis] - self.origin[axis]) / self.spacing[axis];
            let (first, part) = (x.floor(), x - x.floor());
            [(first, 1.0 - part), (first + 1.0, part)].map(|(index, weight)| {
                let count = count as f64;
                if self.periodic {
                    (index.rem_euclid(count) as usize, weight)
                } else if (0.0..count).contains(&index) {
                    (index as usize, weight)
                } else {
                    (0, 0.0)
                }
            })
        };
        let (cols, rows) = (along(0, self.cols), along(1, self.rows));
        [(0, 0), (0, 1), (1, 0), (1, 1)]
            .map(|(row, col)| (rows[row].0 * self.cols + cols[col].0, rows[row].1 * cols[col].1))
    }

    /// Interpolate a quantity given at the points; zero beyond the lattice.
    #[inline]
    pub(super) fn interpolate(&self, values: &[f32], place: DVec3) -> f64 {
        self.around(place).map(|(point, weight)| weight * f64::from(values[point])).iter().sum()
    }

    /// Average the values along both axes with weights of 1/4, 1/2 and 1/4; values beyond the
    /// lattice are zero.
    pub(super) fn blurred<T: Copy + Into<f64>>(&self, values: &[T]) -> Vec<f64> {
        let mut blurred: Vec<f64> = values.iter().map(|value| (*value).into()).collect();
        for (count, stride) in [(self.cols, 1), (self.rows, self.cols)] {
            let before = blurred.clone();
            for (point, value) in blurred.iter_mut().enumerate() {
                let place = (point / stride % count) as i64;
                let neighbour = |step: i64| {
                    let next = place + step;
                    let wrapped = next.rem_euclid(count as i64);
                    let inside = self.periodic || next == wrapped;
                    let other = point as i64 + (wrapped - place) * stride as i64;
                    if inside { before[other as usize] } else { 0.0 }
                };
                *value = 0.5 * before[point] + 0.25 * (neighbour(-1) + neighbour(1));
            }
        }
        blurred
    }

    /// The transpose of [`SurfacePoints::interpolate`].
    #[inline]
    pub(super) fn spread(&self, into: &mut [f64], place: DVec3, value: f64) {
        for (point, weight) in self.around(place) {
            into[point] += weight * value;
        }
    }
}

/// The four points around a position and their weights, stored for repeated use.
#[derive(Debug, Clone, Copy)]
pub(super) struct Corners {
    points: [u32; 4],
    weights: [f32; 4],
}

impl Corners {
    pub(super) fn new(points: &SurfacePoints, place: DVec3) -> Self {
        let around = points.around(place);
        Self {
            points: around.map(|(point, _)| point as u32),
            weights: around.map(|(_, weight)| weight as f32),
        }
    }

    /// Interpolate a quantity given at the points.
    #[inline]
    pub(super) fn interpolate(&self, values: &[f32]) -> f32 {
        self.points.iter().zip(self.weights).map(|(i, w)| w * values[*i as usize]).sum()
    }

    /// The transpose of [`Corners::interpolate`].
    #[inline]
    pub(super) fn spread(&self, into: &mut [f64], value: f64) {
        for (point, weight) in self.points.iter().zip(self.weights) {
            into[*point as usize] += value * f64::from(weight);
        }
    }
}
