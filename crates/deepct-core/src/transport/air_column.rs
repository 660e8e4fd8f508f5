//! Molecular atmosphere prepared for ray tracing: optical depth as a function of altitude.

use crate::optics::PhaseFunction;
use crate::optics::air::Air;

/// Thickness (km) of a level, within which the extinction is taken as constant.
const LEVEL: f64 = 0.1;
/// Altitude (km) of the top of the molecular atmosphere.
const TOP: f64 = 86.0;

/// Horizontally uniform column of the molecular atmosphere above the surface; may be empty.
#[derive(Debug)]
pub(super) struct AirColumn {
    /// Altitude of the surface (km).
    bottom: f64,
    /// Optical depth from the surface to the floor of each level, and to the top.
    below: Vec<f64>,
    /// Phase function of molecular scattering.
    pub(super) phase_function: PhaseFunction,
}

impl AirColumn {
    /// Column above an altitude (km); empty if `air` is `None`.
    pub(super) fn new(air: Option<&Air>, bottom: f64) -> Self {
        let Some(air) = air else {
            return Self { bottom, below: vec![0.0; 2], phase_function: PhaseFunction::Isotropic };
        };
        let levels = ((TOP - bottom) / LEVEL).ceil().max(1.0) as usize;
        let mut below = vec![0.0];
        for level in 0..levels {
            let floor = bottom + LEVEL * level as f64;
            below.push(below[level] + air.optical_depth(floor, floor + LEVEL));
        }
        Self { bottom, below, phase_function: air.phase_function() }
    }

    /// Whether there is no molecular atmosphere.
    #[inline]
    pub(super) fn is_empty(&self) -> bool {
        self.total() == 0.0
    }

    /// Altitude (km) of the top of the molecular atmosphere.
    pub(super) fn top(&self) -> f64 {
        TOP
    }

    /// Optical depth of a path from one altitude (km) to another, in a direction with the upward
    /// component `rise`.
    #[inline]
    pub(super) fn optical_depth(&self, from: f64, to: f64, rise: f64) -> f64 {
        if self.is_empty() { 0.0 } else { (self.depth_below(to) - self.depth_below(from)) / rise }
    }

    /// Distance (km) at which the optical depth from an altitude reaches `depth`; `None` if the
    /// path leaves the atmosphere or meets the surface first.
    #[inline]
    pub(super) fn free_path(&self, from: f64, rise: f64, depth: f64) -> Option<f64> {
        if self.is_empty() {
            return None;
        }
        let start = self.depth_below(from);
        let target = start + rise * depth;
        if target <= 0.0 || target >= self.total() {
            return None;
        }
        let level = self.below.partition_point(|below| *below <= target) - 1;
        let here = self.below[level + 1] - self.below[level];
        if rise.abs() < 1e-9 {
            return Some(depth * LEVEL / here);
        }
        let part = (target - self.below[level]) / here;
        let altitude = self.bottom + LEVEL * (level as f64 + part);
        Some(((altitude - from) / rise).max(0.0))
    }

    #[inline]
    fn total(&self) -> f64 {
        self.below[self.below.len() - 1]
    }

    /// Optical depth between the surface and an altitude (km).
    #[inline]
    fn depth_below(&self, altitude: f64) -> f64 {
        let place = ((altitude - self.bottom) / LEVEL).clamp(0.0, (self.below.len() - 1) as f64);
        let level = (place as usize).min(self.below.len() - 2);
        let part = place - level as f64;
        self.below[level] + part * (self.below[level + 1] - self.below[level])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn column() -> (Air, AirColumn) {
        let air = Air::new(0.45).unwrap();
        (air, AirColumn::new(Some(&air), -0.3))
    }

    #[test]
    fn depths_are_those_of_the_air() {
        let (air, column) = column();
        for (from, to, rise) in [(0.0, 86.0, 0.5), (1.23, 4.56, 1.0), (700.0, -0.3, -0.7)] {
            let expected = air.optical_depth(from, to) / rise;
            let found = column.optical_depth(from, to, rise);
            assert!((found / expected - 1.0).abs() < 1e-4, "{found} {expected}");
        }
    }

    #[test]
    fn free_paths_end_where_the_depth_is_reached() {
        let (_, column) = column();
        for (from, rise, depth) in [(0.7, 0.8, 0.05), (12.0, -0.3, 0.4), (600.0, -1.0, 0.2)] {
            let distance = column.free_path(from, rise, depth).unwrap();
            let found = column.optical_depth(from, from + distance * rise, rise);
            assert!((found - depth).abs() < 1e-12, "{found} {depth}");
        }
        let level = column.free_path(1.0, 0.0, 0.1).unwrap();
        let nearly = column.free_path(1.0, 1e-6, 0.1).unwrap();
        assert!((level / nearly - 1.0).abs() < 1e-3);
        assert!(column.free_path(0.7, 0.8, 5.0).is_none());
        assert!(column.free_path(0.7, -0.8, 5.0).is_none());
        let none = AirColumn::new(None, 0.0);
        assert!(none.is_empty() && none.free_path(1.0, 0.5, 0.1).is_none());
        assert_eq!(none.optical_depth(0.0, 9.0, 1.0), 0.0);
    }
}
