//! Expected contributions, which control the splitting and termination of photon paths.
//!
//! Strong forward scattering causes noise because few paths turn towards the Sun, and each of them
//! contributes much. At a collision that sunlight reaches, additional paths therefore branch off
//! towards the Sun, and Russian roulette depends on the expected contribution of a path rather than
//! on its throughput (Buras and Mayer 2011). The expected value of the radiance does not change.

use super::field::{Field, Heading};
use crate::math::DVec3;
use std::f64::consts::PI;

/// Radiance (1/sr) that is expected anywhere in a cloud, for a Sun of unit irradiance.
const DIFFUSE: f64 = 0.06;
/// Largest mean number of branches at one collision.
const MOST_BRANCHES: f64 = 2.0;

/// Optical depth of the medium towards the Sun, by cell.
#[derive(Debug)]
pub(super) struct Guide {
    sun_depths: Vec<f32>,
}

/// Expected sunlight at one collision.
#[derive(Debug, Clone, Copy)]
pub(super) struct Expectation {
    /// Fraction of the sunlight that arrives unscattered or nearly forward-scattered, over
    /// [`DIFFUSE`].
    sunlight: f64,
}

impl Guide {
    /// Compute the optical depth towards the Sun from the centre of each cell.
    pub(super) fn new(field: &Field, sun: &Heading) -> Self {
        Self { sun_depths: field.depths_from_cells(sun) }
    }

    /// Expected sunlight at a point in the coordinates of the field. Light scattered by small
    /// angles counts as direct: the fraction `g^2` of the extinction does not attenuate it (Joseph,
    /// Wiscombe and Weinman 1976).
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
    /// Expectation outside of the medium, from where the line to the Sun may cross a thin cloud
    /// edge.
    pub(super) const OUTSIDE: Self = Self { sunlight: 1.0 / DIFFUSE };

    /// Mean number of paths that branch off towards the Sun from a path that arrives in a direction
    /// of the given cosine to the Sun: the radiance scattered towards the Sun in two scatterings, a
    /// Henyey-Greenstein function of asymmetry parameter `g^2`, over the diffuse radiance.
    #[inline]
    pub(super) fn branches(self, asymmetry: f64, cosine: f64) -> f64 {
        let g = asymmetry * asymmetry;
        let base = 1.0 + g * g - 2.0 * g * cosine;
        let twice = 0.25 / PI * (1.0 - g * g) / (base * base.sqrt());
        (self.sunlight * twice).min(MOST_BRANCHES)
    }

    /// Expected contribution of a path relative to that of a path in diffuse light. `density` is
    /// that of scattering from the direction of the path towards the Sun.
    #[inline]
    pub(super) fn importance(self, density: f64) -> f64 {
        1.0 + self.sunlight * density
    }
}
