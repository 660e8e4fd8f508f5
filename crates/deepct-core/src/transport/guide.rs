//! Where light is to be expected: how paths are split and ended.
//!
//! Strong forward scattering makes noise because few paths turn to the Sun where it
//! shines, and those few bring much. So at a collision that the Sun reaches new paths
//! branch off in its direction, and a path lives on by what it may still bring and not
//! by what it carries (Buras and Mayer 2011). None of this changes the expected value.

use super::field::{Field, Heading};
use crate::math::DVec3;
use std::f64::consts::PI;

/// Radiance (1/sr) that is to be expected from anywhere in a cloud, for a Sun of unit
/// irradiance.
const DIFFUSE: f64 = 0.06;
/// Most branches of one collision.
const MOST_BRANCHES: f64 = 2.0;

/// The optical depth of the medium on the way to the Sun, by cell.
#[derive(Debug)]
pub(super) struct Guide {
    sun_depths: Vec<f32>,
}

/// What the guide says of one collision.
#[derive(Debug, Clone, Copy)]
pub(super) struct Expectation {
    /// Share of the sunlight that comes here nearly straight on, over [`DIFFUSE`].
    sunlight: f64,
}

impl Guide {
    /// Look at the Sun from the middle of each cell.
    pub(super) fn new(field: &Field, sun: &Heading) -> Self {
        Self { sun_depths: field.depths_from_cells(sun) }
    }

    /// What to expect at a point of the field's coordinates. Light that was scattered
    /// by small angles counts as sunlight: the share `g^2` of the extinction does not
    /// weaken it (Joseph, Wiscombe and Weinman 1976).
    #[inline]
    pub(super) fn expect(
        &self,
        field: &Field,
        at: DVec3,
        extinction: f64,
        asymmetry: f64,
    ) -> Expectation {
        let depth = f64::from(self.sun_depths[field.cell_at(at)]);
        let weakening = extinction * (1.0 - asymmetry * asymmetry);
        Expectation { sunlight: (-weakening * depth).exp() / DIFFUSE }
    }
}

impl Expectation {
    /// Outside of the medium, of which the way to the Sun may pass a thin edge.
    pub(super) const OUTSIDE: Self = Self { sunlight: 1.0 / DIFFUSE };

    /// Mean number of paths that branch off towards the Sun from one that came in a
    /// direction of the given cosine to it: what two scatterings bring to the Sun, a
    /// Henyey-Greenstein function of asymmetry `g^2`, over the diffuse light.
    #[inline]
    pub(super) fn branches(self, asymmetry: f64, cosine: f64) -> f64 {
        let g = asymmetry * asymmetry;
        let base = 1.0 + g * g - 2.0 * g * cosine;
        let twice = 0.25 / PI * (1.0 - g * g) / (base * base.sqrt());
        (self.sunlight * twice).min(MOST_BRANCHES)
    }

    /// What a path may bring, over what one in diffuse light may: `density` is that of
    /// scattering from its direction into the Sun's.
    #[inline]
    pub(super) fn importance(self, density: f64) -> f64 {
        1.0 + self.sunlight * density
    }
}
