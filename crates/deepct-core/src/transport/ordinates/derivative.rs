//! Derivative of the images: the steps of a solution in reverse order.

use super::beam::{PARTS, add_all};
use super::camera::{Derivative, Tile};
use super::diffuse::{Field, Origin, reverse};
use super::quadrature::Octant;
use super::sweep::Faces;
use super::{OrdinatesModel, OrdinatesSettings, State};
use crate::image::ViewStack;
use rayon::prelude::*;

impl OrdinatesModel {
    /// The derivative by voxel, and the adjoint radiance.
    pub(super) fn differentiate(&self, state: &State, weights: &ViewStack) -> (Vec<f64>, Field) {
        let rays = self.rays(&state.extinction);
        let transport = self.transport(rays, &state.unscaled, &state.scaled);
        let count = self.quadrature.harmonics;
        let (mut derivative, mut by_moments) = self.seen(state, weights);

        // Adjoint radiance of light that propagates backwards from the cameras. The equations hold
        // per unit volume, so the transposed source is divided by the relative volume of the cell.
        reverse(&mut by_moments, count);
        for (slot, values) in by_moments.chunks_exact_mut(4 * count).enumerate() {
            let by_volume = 1.0 / self.lattice.share(slot);
            values.iter_mut().for_each(|value| *value *= by_volume);
        }
        let start = self.adjoint.clone().unwrap_or_else(|| transport.dark());
        let OrdinatesSettings { tolerance, most_sweeps, .. } = self.settings;
        let thrown = self.thrown_on_surface(&derivative.on_surface.irradiance);
        let backward = Origin { own: &by_moments, outside: &thrown, ..Origin::default() };
        let (adjoint, _) = transport
            .solve(backward, start, tolerance, most_sweeps, &|_| !self.stop.is_requested());

        // Derivative with respect to the attenuation of light, from the forward and the adjoint
        // radiance.
        let forward = Origin { own: &state.first, outside: &state.outside, ..Origin::default() };
        let (by_scaled, mut leaving) =
            transport.by_extinction([(&state.field, forward), (&adjoint, backward)]);
        if !state.shade.is_empty() {
            let spread = |(octant, leaving): (&Octant, &mut Faces)| {
                let mut sums = vec![0.0; state.shade.len()];
                self.surroundings.spread_incoming(&self.lattice, octant, leaving, &mut sums);
                sums
            };
            let octants = self.quadrature.octants.par_iter().zip(&mut leaving);
            let parts: Vec<_> = octants.map(spread).collect();
            let mut sum = vec![0.0; state.shade.len()];
            add_all(&mut sum, &parts);
            add_all(&mut derivative.on_surface.shade, &[self.surroundings.blurred(&sum)]);
        }

        // Derivative with respect to multiple and single scattering.
        let mut reversed = adjoint.moments.clone();
        reverse(&mut reversed, count);
        let turned = self.turned_sunlight();
        let mut by_stopped = vec![[0.0; 4]; self.lattice.len()];
        for (slot, by_scaled) in by_scaled.iter().enumerate() {
            let row = |m: usize| (slot * 4 + m) * count..(slot * 4 + m + 1) * count;
            let (number, share) = (self.lattice.owner(slot), self.lattice.share(slot));
            let by = self.optics.scattered(number);
            let product = |a: usize, b: usize| -> f32 {
                let pairs = reversed[row(a)].iter().zip(&state.field.moments[row(b)]);
                pairs.zip(by).map(|((a, b), by)| a * b * by).sum()
            };
            let mut values = by_scaled.map(|value| self.optics.delta_m_scaling(number) * value);
            values[0] += (0..4).map(|m| product(m, m)).sum::<f32>();
            (1..4).for_each(|m| values[m] += product(0, m) + product(m, 0));
            let values = values.map(|value| share * value);
            self.lattice.spread_coefficients(&mut derivative.extinction, slot, values);
            let turned = turned(slot);
            for (m, sum) in by_stopped[slot].iter_mut().enumerate() {
                let pairs = reversed[row(m)].iter().zip(&turned);
                *sum = share * pairs.map(|(a, b)| a * b).sum::<f32>();
            }
        }
        let Derivative { extinction, sun_depths, on_surface, .. } = &mut derivative;
        self.surroundings.spread_shade(&rays, &state.shade, &on_surface.shade, extinction);
        rays.spread_stopped(&state.sun_depths, &by_stopped, extinction, sun_depths);
        rays.spread_sun_depths(self.scene.sun.towards(), sun_depths, extinction);
        (derivative.extinction, adjoint)
    }

    /// Adjoint radiance that enters through the faces, by octant, because the cameras see the light
    /// of the cloud on the surface.
    fn thrown_on_surface(&self, by_irradiance: &[f64]) -> Vec<Faces> {
        if by_irradiance.is_empty() {
            return Vec::new();
        }
        let irradiance = self.surroundings.as_irradiance(&self.lattice, by_irradiance);
        let thrown = |octant: &Octant| {
            let mut faces = Faces::dark(&self.lattice, octant);
            self.surroundings.add_reflected(&self.lattice, octant, &irradiance, &mut faces);
            faces
        };
        self.quadrature.octants.par_iter().map(thrown).collect()
    }

    /// Derivative of the radiances seen by the cameras at fixed diffuse radiance, and derivative
    /// with respect to the moments of this radiance.
    fn seen(&self, state: &State, weights: &ViewStack) -> (Derivative, Vec<f32>) {
        let camera = self.camera(state);
        let (slots, count) = (self.lattice.len(), self.quadrature.harmonics);
        let irradiance = self.scene.sun.irradiance;
        let nothing = || Derivative::new(state.extinction.len(), slots, state.on_surface());
        let mut parts: Vec<_> = (0..PARTS).map(|_| nothing()).collect();
        let mut by_moments = vec![0.0; slots * 4 * count];
        for pieces in self.weighted(weights).chunks(PARTS) {
            parts.par_iter_mut().zip(pieces).for_each(|(part, (tile, pixels))| {
                let view = &self.views[tile.view];
                let prepared = camera.prepare(tile, view);
                part.scattered.fill([0.0; 4]);
                for [row, col] in pixels {
                    let weight = irradiance * f64::from(weights.values[[tile.view, *row, *col]]);
                    camera.differentiate(view, [*row, *col], weight, &prepared, part);
                }
            });
            let harmonics: Vec<_> = pieces
                .iter()
                .map(|(tile, _)| camera.harmonics(tile, &self.views[tile.view]))
                .collect();
            let cells = by_moments.par_chunks_mut(count).enumerate();
            cells.for_each(|(row, into)| {
                let (slot, m) = (row / 4, row % 4);
                let by = self.optics.scattered(self.lattice.owner(slot));
                for (part, harmonics) in parts.iter().zip(&harmonics) {
                    let scattered = part.scattered[slot][m];
                    for ((sum, y), s) in into.iter_mut().zip(harmonics).zip(by) {
                        *sum += scattered * y * s;
                    }
                }
            });
        }
        let mut sum = nothing();
        for part in &parts {
            add_all(&mut sum.extinction, std::slice::from_ref(&part.extinction));
            let (into, part_of) = (&mut sum.on_surface, &part.on_surface);
            add_all(&mut into.shade, std::slice::from_ref(&part_of.shade));
            add_all(&mut into.irradiance, std::slice::from_ref(&part_of.irradiance));
            add_rows(&mut sum.sun_depths, &part.sun_depths);
        }
        (sum, by_moments)
    }

    /// Pixels with a weight, in pieces of tiles: in an inversion the many pixels beside the cloud
    /// have none. If there are few tiles, they are divided so that all parts have work.
    fn weighted(&self, weights: &ViewStack) -> Vec<(&Tile, Vec<[usize; 2]>)> {
        let cuts = (4 * PARTS).div_ceil(self.tiles.len().max(1));
        let mut pieces = Vec::new();
        for tile in &self.tiles {
            let weighted = |[row, col]: &[usize; 2]| weights.values[[tile.view, *row, *col]] != 0.0;
            let pixels: Vec<_> = tile.pixels().filter(weighted).collect();
            let size = pixels.len().div_ceil(cuts).max(1);
            pieces.extend(pixels.chunks(size).map(|pixels| (tile, pixels.to_vec())));
        }
        pieces
    }
}

/// Add `rows` to `into`.
fn add_rows<const N: usize>(into: &mut [[f32; N]], rows: &[[f32; N]]) {
    let pairs = into.as_flattened_mut().iter_mut().zip(rows.as_flattened());
    pairs.for_each(|(sum, value)| *sum += value);
}
