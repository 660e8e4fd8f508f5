//! Derivative of the images: the steps of a solution in reverse order.

use super::beam::{PARTS, Rays, add_all};
use super::camera::{Derivative, Tile};
use super::diffuse::{Field, Origin, reverse};
use super::quadrature::{Octant, first_harmonics};
use super::sweep::Faces;
use super::{OrdinatesModel, OrdinatesSettings, State};
use crate::error::Result;
use crate::grid::Volume;
use crate::image::ViewStack;
use ndarray::Array3;
use rayon::prelude::*;

/// Derivatives of a weighted sum of the images.
#[derive(Debug, Clone, PartialEq)]
pub struct Derivatives {
    /// With respect to the extinction of each voxel (km), at a constant effective radius.
    pub extinction: Volume,
    /// With respect to the effective radius of each voxel (1/um), at a constant extinction; zero if
    /// the scattering does not depend on it. At a node of the table of droplet optics, between which
    /// these are interpolated, it is the derivative towards larger radii.
    pub effective_radius: Volume,
}

/// Derivative with respect to the medium.
#[derive(Debug)]
pub(super) struct ByMedium {
    /// With respect to the extinction of each voxel.
    pub(super) extinction: Vec<f64>,
    /// With respect to the delta-M scaling factor, and to the optical depth of the forward peak over
    /// the scaled one, by row of [`Optics`](super::optics::Optics).
    pub(super) scaling: Vec<f64>,
    pub(super) by_peak: Vec<f64>,
    /// With respect to the share of the extinction that each phase function scatters, in single
    /// scattering.
    pub(super) shares: Vec<f64>,
}

impl ByMedium {
    /// A derivative of zero.
    pub(super) fn new(rays: &Rays) -> Self {
        let rows = rays.optics.rows();
        Self {
            extinction: vec![0.0; rays.extinction.len()],
            scaling: vec![0.0; rows],
            by_peak: vec![0.0; rows],
            shares: vec![0.0; rays.optics.pairs()],
        }
    }

    pub(super) fn add(&mut self, other: &Self) {
        for (into, values) in [
            (&mut self.extinction, &other.extinction),
            (&mut self.scaling, &other.scaling),
            (&mut self.by_peak, &other.by_peak),
            (&mut self.shares, &other.shares),
        ] {
            into.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
        }
    }
}

impl OrdinatesModel {
    /// The derivatives by voxel, and the adjoint radiance.
    ///
    /// # Errors
    /// None for the weights of images of the model.
    pub(super) fn differentiate(
        &self,
        state: &State,
        weights: &ViewStack,
    ) -> Result<(Derivatives, Field)> {
        let rays = self.rays(&state.extinction);
        let transport = self.transport(rays, &state.unscaled, &state.scaled);
        let count = self.quadrature.harmonics;
        let (mut derivative, mut by_moments, mut by_scattered) = self.seen(state, weights);

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
        let sun = first_harmonics(-self.scene.sun.towards(), count);
        let mut by_stopped = vec![[0.0; 4]; self.lattice.len()];
        let Derivative { medium, sun_depths, on_surface, .. } = &mut derivative;
        for (slot, by_scaled) in by_scaled.iter().enumerate() {
            let (number, share) = (self.lattice.owner(slot), self.lattice.share(slot));
            let (by, row) = (self.optics.scattered(number), self.optics.row(number));
            let four = |moments| -> [&[f32]; 4] {
                let all: &[f32] = moments;
                std::array::from_fn(|m| &all[(slot * 4 + m) * count..][..count])
            };
            let (back, light) = (four(&reversed), four(&state.field.moments));
            let (unscaled, stopped) = (state.unscaled[slot], state.stopped[slot]);
            let mut values = by_scaled.map(|value| self.optics.delta_m_scaling(number) * value);
            let into = &mut by_scattered[row * count..][..count];
            for (h, into) in into.iter_mut().enumerate() {
                // Product of the adjoint radiance and the light scattered per unit of each
                // coefficient of the extinction.
                let mut products = [(0..4).map(|m| back[m][h] * light[m][h]).sum::<f32>(); 4];
                (1..4).for_each(|m| {
                    products[m] = back[0][h] * light[m][h] + back[m][h] * light[0][h];
                });
                let mut scattered = 0.0;
                for m in 0..4 {
                    values[m] += by[h] * products[m];
                    by_stopped[slot][m] += share * back[m][h] * by[h] * sun[h];
                    scattered += unscaled[m] * products[m] + stopped[m] * back[m][h] * sun[h];
                }
                *into += share * scattered;
            }
            let values = values.map(|value| share * value);
            self.lattice.spread_coefficients(&mut medium.extinction, slot, values);
            let by_scaling = by_scaled.iter().zip(unscaled).map(|(a, b)| share * a * b);
            medium.scaling[row] += f64::from(by_scaling.sum::<f32>());
        }
        self.surroundings.spread_shade(&rays, &state.shade, &on_surface.shade, medium);
        let extinction = &mut medium.extinction;
        rays.spread_stopped(&state.sun_depths, &by_stopped, extinction, sun_depths);
        rays.spread_sun_depths(self.scene.sun.towards(), sun_depths, medium);
        let (grid, scattering) = (self.scene.medium.extinction.grid, &self.scene.medium.scattering);
        let by_radius = self.optics.by_effective_radius(
            scattering,
            &grid,
            &self.lattice,
            medium,
            &by_scattered,
        );
        let volume = |by_voxel: &[f64]| {
            let values = by_voxel.iter().map(|value| *value as f32).collect();
            Volume::new(grid, Array3::from_shape_vec(grid.shape, values).expect("matching shape"))
        };
        let derivatives = Derivatives {
            extinction: volume(&medium.extinction)?,
            effective_radius: volume(&by_radius)?,
        };
        Ok((derivatives, adjoint))
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

    /// Derivative of the radiances seen by the cameras at fixed diffuse radiance, and derivatives
    /// with respect to the moments of this radiance, `[slot][4][harmonic]`, and to the scattered
    /// light over extinction, `[row][harmonic]`.
    fn seen(&self, state: &State, weights: &ViewStack) -> (Derivative, Vec<f32>, Vec<f32>) {
        let camera = self.camera(state);
        let (slots, count) = (self.lattice.len(), self.quadrature.harmonics);
        let nothing = || Derivative::new(&camera.rays, state.on_surface());
        let mut parts: Vec<_> = (0..PARTS).map(|_| nothing()).collect();
        let mut by_moments = vec![0.0; slots * 4 * count];
        for pieces in self.weighted(weights).chunks(PARTS) {
            parts.par_iter_mut().zip(pieces).for_each(|(part, (tile, pixels))| {
                let view = &self.views[tile.view];
                let prepared = camera.prepare(tile, view);
                part.scattered.fill([0.0; 4]);
                for [row, col] in pixels {
                    let weight = f64::from(weights.values[[tile.view, *row, *col]]);
                    let weight = self.brightness(view, [*row, *col]) * weight;
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
                for (part, harmonics) in parts.iter().zip(&harmonics) {
                    let scattered = part.scattered[slot][m];
                    into.iter_mut().zip(harmonics).for_each(|(sum, y)| *sum += scattered * y);
                }
            });
        }
        // So far, the derivative with respect to the moments of the light scattered per extinction.
        let mut by_scattered = vec![0.0; self.optics.rows() * count];
        for (number, by_moments) in by_moments.chunks_exact_mut(count).enumerate() {
            let voxel = self.lattice.owner(number / 4);
            let into = &mut by_scattered[self.optics.row(voxel) * count..][..count];
            let moments = &state.field.moments[number * count..][..count];
            let optics = self.optics.scattered(voxel).iter();
            for (h, (by_moment, scattered)) in by_moments.iter_mut().zip(optics).enumerate() {
                into[h] += *by_moment * moments[h];
                *by_moment *= scattered;
            }
        }
        let mut sum = nothing();
        for part in &parts {
            sum.medium.add(&part.medium);
            let (into, part_of) = (&mut sum.on_surface, &part.on_surface);
            add_all(&mut into.shade, std::slice::from_ref(&part_of.shade));
            add_all(&mut into.irradiance, std::slice::from_ref(&part_of.irradiance));
            add_rows(&mut sum.sun_depths, &part.sun_depths);
        }
        (sum, by_moments, by_scattered)
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
