//! Change of the radiance with the extinction: the derivative of [`super`] in one direction.
//!
//! The transport operator `A`, the scattering `S` and the radiance `I` of an ordinate satisfy
//! `A I = S I + q`. Their changes satisfy `A dI = S dI + (dS I + dq - dA I)`. The radiance itself is
//! not stored, only its moments, so that one more sweep computes it before the change is swept.

use super::{Field, Moments, Origin, Radiance, SweepBuffers, Transport};
use crate::transport::ordinates::quadrature::Octant;
use crate::transport::ordinates::sweep::{Faces, Visit, sweep};
use pulp::Simd;

/// Changes of the extinction and of the sources.
#[derive(Debug, Clone, Copy)]
pub(in super::super) struct Change<'a> {
    /// Mean and slopes of the extinction of each active cell, including the forward peak.
    pub(in super::super) unscaled: &'a [[f32; 4]],
    /// The same without the forward peak.
    pub(in super::super) scaled: &'a [[f32; 4]],
    /// As in [`Origin`].
    pub(in super::super) own: &'a [f32],
    pub(in super::super) outside: &'a [Faces],
}

impl Transport<'_> {
    /// Change of the radiance before it is scattered: what a sweep of the solution `field` gives
    /// changes by it if the field itself remains.
    pub(in super::super) fn unscattered_change(
        &self,
        field: &Field,
        origin: Origin,
        change: Change,
    ) -> Field {
        let mut source = vec![0.0; field.moments.len()];
        self.source(field, origin, &mut source);
        let mut buffers = SweepBuffers::new(field.moments.len());
        let own = Origin { own: change.own, ..Origin::default() };
        Transport { unscaled: change.unscaled, ..*self }.source(field, own, &mut buffers.source);
        let march = |octants: &[(usize, &Octant)],
                     ways: &mut [(&Octant, Faces)],
                     changed: &[f32],
                     moments: &mut Moments| {
            let swept = |(number, octant): &(usize, &Octant)| {
                let size = self.lattice().len() * 4 * octant.ordinates;
                let mut radiance = Radiance { values: vec![0.0; size] };
                let faces = self.incoming(field, origin.outside, *number, octant);
                sweep(self.medium(), &mut [(octant, faces)], &source, &mut radiance);
                (octant.signs, radiance.values)
            };
            let radiances = octants.iter().map(swept).collect();
            let mut visit = Attenuated { radiances, change: change.scaled, moments };
            sweep(self.medium(), ways, changed, &mut visit);
        };
        let outside = Origin { outside: change.outside, ..Origin::default() };
        self.sweep_by(&mut buffers, outside, &self.dark(), &march)
    }
}

/// Adds the change of the attenuation of the given radiance to the source, and the moments of the
/// radiance that results.
struct Attenuated<'a> {
    /// Radiance by octant, which its signs identify: `[slot][4][ordinate]`.
    radiances: Vec<([f32; 3], Vec<f32>)>,
    /// Change of the mean and slopes of the extinction.
    change: &'a [[f32; 4]],
    moments: &'a mut Moments,
}

impl Visit for Attenuated<'_> {
    #[inline(always)]
    fn source(&mut self, octant: &Octant, slot: usize, source: &mut [f32]) {
        let own = self.radiances.iter().find(|(signs, _)| *signs == octant.signs);
        let (_, radiances) = own.expect("one radiance for each octant");
        let radiance = &radiances[slot * source.len()..][..source.len()];
        let change = self.change[slot];
        let n = octant.ordinates;
        for ordinate in 0..n {
            let at = |m: usize| radiance[m * n + ordinate];
            source[ordinate] -= (0..4).map(|m| change[m] * at(m)).sum::<f32>();
            for m in 1..4 {
                source[m * n + ordinate] -= change[0] * at(m) + change[m] * at(0);
            }
        }
    }

    #[inline(always)]
    fn cell<S: Simd>(&mut self, simd: S, octant: &Octant, slot: usize, radiance: &[f32]) {
        self.moments.cell(simd, octant, slot, radiance);
    }
}
