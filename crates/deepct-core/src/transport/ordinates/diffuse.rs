//! Diffuse radiance: sweeps through all octants until scattering and transport agree.

mod tangent;

pub(super) use tangent::Change;

use super::beam::Rays;
use super::lattice::Lattice;
use super::quadrature::{Octant, Quadrature, degrees};
use super::surroundings::Surroundings;
use super::sweep::{Faces, Medium, Visit, add_moments, sweep};
use crate::scene::Boundary;
use pulp::Simd;
use rayon::prelude::*;

/// Number of octants whose moments are added in one array, those that differ only in x; the others
/// have their own arrays, on other threads.
const TOGETHER: usize = 2;
/// Number of arrays of moments that a sweep adds.
const ARRAYS: usize = 8 / TOGETHER;
/// Number of directions that the iteration stores before it restarts.
const RESTART: usize = 8;
/// Largest number of arrays of moments at the same time: the directions, the arrays of a sweep, the
/// source of the direct sunlight, the solution and those from which it follows.
pub(super) const MOST_FIELDS: usize = RESTART + ARRAYS + 7;
/// Largest error of a solution relative to the change of a sweep at which the iteration ends: see
/// [`Transport::solve`].
const ERROR_BY_CHANGE: f64 = 10.0;
/// Largest factor by which the required change decreases at a time.
const STRICTER: f64 = 0.1;
/// Number of elements of a long array that are processed at a time.
const PIECE: usize = 4096;

/// Diffuse radiance: its moments in the active cells, the radiance that enters through periodic
/// sides, and the irradiance of the surface.
#[derive(Debug, Clone)]
pub(super) struct Field {
    /// `[slot][4][harmonic]`.
    pub(super) moments: Vec<f32>,
    /// By octant; empty between open sides.
    sides: Vec<Faces>,
    /// Irradiance of the surface by the cloud; empty if the surface does not reflect it.
    pub(super) irradiance: Vec<f32>,
}

/// The linear problem: transport in a medium without its forward peak.
#[derive(Debug, Clone, Copy)]
pub(super) struct Transport<'a> {
    pub(super) rays: Rays<'a>,
    pub(super) quadrature: &'a Quadrature,
    pub(super) surroundings: &'a Surroundings,
    /// Mean and slopes of the extinction of each active cell, including the forward peak.
    pub(super) unscaled: &'a [[f32; 4]],
    /// The same without the forward peak.
    pub(super) scaled: &'a [[f32; 4]],
}

/// Sources of radiance other than scattering.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Origin<'a> {
    /// The source in the cells, `[slot][4][harmonic]`.
    pub(super) own: &'a [f32],
    /// Radiance that enters through the faces from outside, by octant; empty if there is none.
    pub(super) outside: &'a [Faces],
    /// Additional irradiance of the surface; empty if there is none.
    pub(super) irradiance: &'a [f32],
    /// Radiance that results from a sweep in addition, such as that of sources by ordinate.
    pub(super) swept: Option<&'a Field>,
}

/// Large arrays that every sweep requires, reused from one sweep to the next.
struct SweepBuffers {
    /// `[slot][4][harmonic]`.
    source: Vec<f32>,
    /// For octants that are swept on different threads.
    parts: Vec<Moments>,
}

impl SweepBuffers {
    fn new(length: usize) -> Self {
        let parts = (0..ARRAYS).map(|_| Moments { values: vec![0.0; length] }).collect();
        Self { source: vec![0.0; length], parts }
    }
}

/// Adds the moments of the radiance of a source in some octants, which are given with their numbers,
/// to the array of these; their [`Faces`] are those of [`sweep`].
type March<'a> =
    dyn Fn(&[(usize, &Octant)], &mut [(&Octant, Faces)], &[f32], &mut Moments) + Sync + 'a;

impl Transport<'_> {
    fn lattice(&self) -> &Lattice {
        self.rays.lattice
    }

    fn medium(&self) -> Medium<'_> {
        Medium { lattice: self.lattice(), extinction: self.scaled }
    }

    /// Zero radiance.
    pub(super) fn dark(&self) -> Field {
        let octants = &self.quadrature.octants;
        let sides = match self.lattice().boundary {
            Boundary::Open => Vec::new(),
            Boundary::Periodic => octants
                .iter()
                .map(|octant| only_sides(Faces::dark(self.lattice(), octant)))
                .collect(),
        };
        Field {
            moments: vec![0.0; self.lattice().len() * 4 * self.quadrature.harmonics],
            sides,
            irradiance: vec![0.0; self.surroundings.lit_points()],
        }
    }

    /// Faces of an octant with the radiance that enters through them.
    fn incoming(&self, field: &Field, outside: &[Faces], number: usize, octant: &Octant) -> Faces {
        let outside = outside.get(number).cloned();
        let outside = outside.unwrap_or_else(|| Faces::dark(self.lattice(), octant));
        let mut faces = match field.sides.get(number) {
            None => outside,
            Some(sides) => Faces { z: outside.z, ..sides.clone() },
        };
        self.surroundings.add_reflected(self.lattice(), octant, &field.irradiance, &mut faces);
        faces
    }

    /// Light scattered from moments of radiance: a source by cell.
    fn scatter(&self, moments: &[f32], source: &mut [f32]) {
        let count = self.quadrature.harmonics;
        let cells = source.par_chunks_mut(4 * count).zip(moments.par_chunks(4 * count));
        cells.enumerate().for_each(|(slot, (source, moments))| {
            let by = self.rays.optics.scattered(self.lattice().owner(slot));
            let [mean, x, y, z] = self.unscaled[slot];
            let row = |m: usize| &moments[m * count..][..count];
            for (axis, slope) in [x, y, z].into_iter().enumerate() {
                let into = &mut source[(axis + 1) * count..][..count];
                for (h, value) in into.iter_mut().enumerate() {
                    *value = by[h] * (mean * row(axis + 1)[h] + slope * row(0)[h]);
                }
            }
            for (h, value) in source[..count].iter_mut().enumerate() {
                *value = by[h] * (mean * row(0)[h] + x * row(1)[h] + y * row(2)[h] + z * row(3)[h]);
            }
        });
    }

    /// Radiance of the source in the buffers and of the light in `field` that enters through the
    /// sides and from the surface. The sides and the irradiance of the result enter in the next
    /// sweep.
    fn sweep(&self, buffers: &mut SweepBuffers, origin: Origin, field: &Field) -> Field {
        self.sweep_by(buffers, origin, field, &|_, ways, source, moments| {
            sweep(self.medium(), ways, source, moments);
        })
    }

    /// The same with another operation in place of [`sweep`] for the octants of one array.
    fn sweep_by(
        &self,
        buffers: &mut SweepBuffers,
        origin: Origin,
        field: &Field,
        march: &March,
    ) -> Field {
        let octants: Vec<(usize, &Octant)> = self.quadrature.octants.iter().enumerate().collect();
        let SweepBuffers { source, parts } = buffers;
        let together = |(octants, moments): (&[(usize, &Octant)], &mut Moments)| {
            moments.values.fill(0.0);
            let mut sides = Vec::new();
            let mut irradiance = vec![0.0; field.irradiance.len()];
            let mut ways = Vec::new();
            for (number, octant) in octants {
                ways.push((*octant, self.incoming(field, origin.outside, *number, octant)));
            }
            march(octants, &mut ways, source, moments);
            for ((number, _), (_, mut faces)) in octants.iter().zip(ways) {
                let opposite = &self.quadrature.octants[7 - number];
                let lattice = self.lattice();
                self.surroundings.add_irradiance(lattice, opposite, &mut faces, &mut irradiance);
                if !field.sides.is_empty() {
                    sides.push(only_sides(faces));
                }
            }
            (sides, irradiance)
        };
        let ways = octants.par_chunks(TOGETHER).zip(parts.par_iter_mut());
        let mut whole = Field {
            moments: vec![0.0; source.len()],
            sides: Vec::new(),
            irradiance: origin.irradiance.to_vec(),
        };
        whole.irradiance.resize(field.irradiance.len(), 0.0);
        for (sides, irradiance) in ways.map(together).collect::<Vec<_>>() {
            whole.sides.extend(sides);
            let pairs = whole.irradiance.iter_mut().zip(irradiance);
            pairs.for_each(|(sum, value)| *sum += value as f32);
        }
        let pieces = whole.moments.par_chunks_mut(PIECE).enumerate();
        pieces.for_each(|(number, sums)| {
            let [a, b, c, d]: [&[f32]; ARRAYS] =
                std::array::from_fn(|part| &parts[part].values[number * PIECE..][..sums.len()]);
            // Written before it is read: reading a page newly provided by the kernel takes longer.
            for (n, sum) in sums.iter_mut().enumerate() {
                *sum = (a[n] + b[n]) + (c[n] + d[n]);
            }
        });
        whole
    }

    /// Sum of the scattered light and the source of the origin.
    fn source(&self, field: &Field, origin: Origin, source: &mut [f32]) {
        self.scatter(&field.moments, source);
        source.par_iter_mut().zip(origin.own).for_each(|(sum, value)| *sum += value);
    }

    /// Radiance of an origin after all orders of scattering, from a first guess, and the number of
    /// sweeps: by the generalised minimal residual method (Saad and Schultz 1986) until the change
    /// of a sweep is less than `tolerance` times the radiance, or until `go_on`, which receives
    /// this relative change after each sweep, returns `false`.
    ///
    /// Where light is scattered very often, a sweep changes the radiance much less than it is
    /// wrong. The error is estimated from the last correction, as if the next ones would decrease
    /// by the same factor as the change has, and must be less than [`ERROR_BY_CHANGE`] times
    /// `tolerance`.
    pub(super) fn solve(
        &self,
        origin: Origin,
        mut field: Field,
        tolerance: f64,
        most_sweeps: usize,
        go_on: &dyn Fn(f64) -> bool,
    ) -> (Field, usize) {
        let mut buffers = SweepBuffers::new(field.moments.len());
        let (mut sweeps, mut required) = (0, tolerance);
        // The change of a sweep before the last correction, and the size of the correction.
        let mut before: Option<(f64, f64)> = None;
        loop {
            self.source(&field, origin, &mut buffers.source);
            let mut next = self.sweep(&mut buffers, origin, &field);
            if let Some(swept) = origin.swept {
                next.add(1.0, swept);
            }
            sweeps += 1;
            let mut change = next.clone();
            change.add(-1.0, &field);
            let (size, whole) = (change.norm(), next.norm());
            let go_on = |size: f64| go_on(size / whole);
            if sweeps >= most_sweeps || !go_on(size) {
                return (next, sweeps);
            }
            if size <= required * whole {
                let factor = before.map_or(0.0, |(earlier, _)| (size / earlier).min(0.99));
                let error = before.map_or(0.0, |(_, step)| step * factor / (1.0 - factor));
                let allowed = ERROR_BY_CHANGE * tolerance * whole;
                if error <= allowed {
                    return (next, sweeps);
                }
                required *= (allowed / error).max(STRICTER);
            }
            let (count, step) =
                self.correct(&mut buffers, &mut field, change, required * whole, &go_on);
            sweeps += count;
            before = Some((size, step));
        }
    }

    /// Add to a field the combination of up to [`RESTART`] directions that minimises its change in
    /// a sweep. Returns the number of sweeps that this takes, and the size of the combination.
    fn correct(
        &self,
        buffers: &mut SweepBuffers,
        field: &mut Field,
        mut change: Field,
        wanted: f64,
        go_on: &dyn Fn(f64) -> bool,
    ) -> (usize, f64) {
        let size = change.norm();
        change.scale(1.0 / size);
        let mut directions = vec![change];
        // Columns of the triangular matrix, the rotations that produced it, and the residual.
        let (mut columns, mut rotations) = (Vec::<Vec<f64>>::new(), Vec::<(f64, f64)>::new());
        let mut left = vec![size];
        for number in 0..RESTART {
            let direction = &directions[number];
            self.scatter(&direction.moments, &mut buffers.source);
            let mut image = self.sweep(buffers, Origin::default(), direction);
            image.combine(-1.0, 1.0, direction);
            let mut column: Vec<f64> = directions.iter().map(|other| image.dot(other)).collect();
            image.take_away(&column, &directions);
            let norm = image.norm();
            for (row, (cosine, sine)) in rotations.iter().enumerate() {
                let (a, b) = (column[row], column[row + 1]);
                (column[row], column[row + 1]) = (cosine * a + sine * b, cosine * b - sine * a);
            }
            let length = column[number].hypot(norm);
            let (cosine, sine) = (column[number] / length, norm / length);
            column[number] = length;
            let rest = left[number];
            left[number] = cosine * rest;
            left.push(-sine * rest);
            columns.push(column);
            rotations.push((cosine, sine));
            let size = left[number + 1].abs();
            if size <= wanted || norm == 0.0 || !go_on(size) {
                break;
            }
            image.scale(1.0 / norm);
            directions.push(image);
        }
        let mut weights = vec![0.0; columns.len()];
        for row in (0..columns.len()).rev() {
            let known: f64 = (row + 1..columns.len()).map(|c| columns[c][row] * weights[c]).sum();
            weights[row] = (left[row] - known) / columns[row][row];
        }
        for (weight, direction) in weights.iter().zip(&directions) {
            field.add(*weight, direction);
        }
        // The directions are orthonormal.
        (columns.len(), weights.iter().map(|weight| weight * weight).sum::<f64>().sqrt())
    }

    /// Derivative of a quantity with respect to the mean and slopes of the delta-M scaled
    /// extinction, from the radiance, the adjoint radiance and their origins. Also returns the
    /// adjoint radiance that leaves through the faces at which the light of each octant enters.
    pub(super) fn by_extinction(
        &self,
        [(forward, origin), (adjoint, adjoint_origin)]: [(&Field, Origin); 2],
    ) -> (Vec<[f32; 4]>, Vec<Faces>) {
        let slots = self.lattice().len();
        let octants: Vec<(usize, &Octant)> = self.quadrature.octants.iter().enumerate().collect();
        let sources = [(forward, origin), (adjoint, adjoint_origin)].map(|(field, origin)| {
            let mut source = vec![0.0; field.moments.len()];
            self.source(field, origin, &mut source);
            source
        });
        let together = |octants: &[(usize, &Octant)]| {
            let mut products = vec![[0.0; 4]; slots];
            let mut leaving = Vec::new();
            for (number, octant) in octants {
                let mut radiance = Radiance { values: vec![0.0; slots * 4 * octant.ordinates] };
                let faces = self.incoming(forward, origin.outside, *number, octant);
                sweep(self.medium(), &mut [(octant, faces)], &sources[0], &mut radiance);
                let opposite = 7 - number;
                let other = &self.quadrature.octants[opposite];
                let faces = self.incoming(adjoint, adjoint_origin.outside, opposite, other);
                let mut visit = Products { radiance: &radiance.values, sums: &mut products };
                let mut way = [(other, faces)];
                sweep(self.medium(), &mut way, &sources[1], &mut visit);
                leaving.extend(way.map(|(_, faces)| faces));
            }
            (products, leaving)
        };
        let parts: Vec<_> = octants.par_chunks(TOGETHER).map(together).collect();
        let mut sums = vec![[0.0; 4]; slots];
        let mut leaving = Vec::new();
        for (products, faces) in parts {
            for (sum, part) in sums.iter_mut().zip(products) {
                (0..4).for_each(|m| sum[m] -= part[m]);
            }
            leaving.extend(faces);
        }
        (sums, leaving)
    }
}

/// Keep only the sides: only light that leaves through them re-enters.
fn only_sides(faces: Faces) -> Faces {
    Faces { z: Vec::new(), ..faces }
}

/// Change the sign of the harmonics of odd degree, which gives the moments of the radiance with all
/// directions reversed.
pub(super) fn reverse(moments: &mut [f32], harmonics: usize) {
    let odd: Vec<bool> = degrees(harmonics).map(|degree| degree % 2 == 1).collect();
    for row in moments.chunks_exact_mut(harmonics) {
        for (value, odd) in row.iter_mut().zip(&odd) {
            if *odd {
                *value = -*value;
            }
        }
    }
}

impl Field {
    fn parts(&self) -> impl Iterator<Item = &[f32]> {
        let sides = self.sides.iter().flat_map(|faces| [&faces.x[..], &faces.y[..]]);
        [&self.moments[..], &self.irradiance].into_iter().chain(sides)
    }

    fn parts_mut(&mut self) -> impl Iterator<Item = &mut [f32]> {
        let sides = self.sides.iter_mut().flat_map(|faces| [&mut faces.x[..], &mut faces.y[..]]);
        [&mut self.moments[..], &mut self.irradiance].into_iter().chain(sides)
    }

    fn dot(&self, other: &Self) -> f64 {
        /// Number of products that are summed in single precision.
        const RUN: usize = 256;
        let run =
            |(a, b): (&[f32], &[f32])| f64::from(a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>());
        self.parts()
            .zip(other.parts())
            .map(|(a, b)| a.par_chunks(RUN).zip(b.par_chunks(RUN)).map(run).collect::<Vec<_>>())
            .map(|runs| runs.iter().sum::<f64>())
            .sum()
    }

    fn norm(&self) -> f64 {
        self.dot(self).sqrt()
    }

    /// Add `factor * other`.
    fn add(&mut self, factor: f64, other: &Self) {
        self.combine(1.0, factor, other);
    }

    /// Set `self = own * self + factor * other`.
    fn combine(&mut self, own: f64, factor: f64, other: &Self) {
        let (own, factor) = (own as f32, factor as f32);
        for (into, values) in self.parts_mut().zip(other.parts()) {
            into.par_iter_mut().zip(values).for_each(|(v, o)| *v = own * *v + factor * o);
        }
    }

    /// Subtract `times[i] * fields[i]` for all `i`, in pieces that stay in the cache.
    fn take_away(&mut self, times: &[f64], fields: &[Self]) {
        let mut others: Vec<_> = fields.iter().map(Self::parts).collect();
        for part in self.parts_mut() {
            let others: Vec<&[f32]> =
                others.iter_mut().map(|parts| parts.next().expect("equal layouts")).collect();
            part.par_chunks_mut(PIECE).enumerate().for_each(|(number, into)| {
                for (values, times) in others.iter().zip(times) {
                    let values = &values[number * PIECE..][..into.len()];
                    into.iter_mut().zip(values).for_each(|(v, o)| *v -= *times as f32 * o);
                }
            });
        }
    }

    fn scale(&mut self, factor: f64) {
        let factor = factor as f32;
        self.parts_mut().for_each(|part| part.par_iter_mut().for_each(|value| *value *= factor));
    }
}

/// Sum of moments over the ordinates, `[slot][4][harmonic]`.
struct Moments {
    values: Vec<f32>,
}

impl Visit for Moments {
    #[inline(always)]
    fn cell<S: Simd>(&mut self, simd: S, octant: &Octant, slot: usize, radiance: &[f32]) {
        let size = 4 * octant.to_moments.len() / octant.ordinates;
        add_moments(simd, octant, radiance, &mut self.values[slot * size..][..size]);
    }
}

/// Stores the radiance, `[slot][4][ordinate]`.
struct Radiance {
    values: Vec<f32>,
}

impl Visit for Radiance {
    #[inline(always)]
    fn cell<S: Simd>(&mut self, _: S, _: &Octant, slot: usize, radiance: &[f32]) {
        self.values[slot * radiance.len()..][..radiance.len()].copy_from_slice(radiance);
    }
}

/// Multiplies the radiance with that of the opposite octant, for the derivative with respect to the
/// mean and slopes of the extinction.
struct Products<'a> {
    radiance: &'a [f32],
    sums: &'a mut [[f32; 4]],
}

impl Visit for Products<'_> {
    #[inline(always)]
    fn cell<S: Simd>(&mut self, _: S, octant: &Octant, slot: usize, radiance: &[f32]) {
        let other = &self.radiance[slot * radiance.len()..][..radiance.len()];
        let n = octant.ordinates;
        let weights = &octant.weights[..n];
        let weighted = |a: usize, b: usize| -> f32 {
            let (a, b) = (&radiance[a * n..][..n], &other[b * n..][..n]);
            weights.iter().zip(a).zip(b).map(|((w, a), b)| w * a * b).sum()
        };
        let sums = &mut self.sums[slot];
        sums[0] += (0..4).map(|m| weighted(m, m)).sum::<f32>();
        (1..4).for_each(|m| sums[m] += weighted(0, m) + weighted(m, 0));
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{cloud, model};
    use super::*;
    use crate::optics::Interpolation;
    use crate::rng::{Purpose, RngExt, stream};
    use std::f64::consts::PI;

    /// What the cells emit is absorbed in them or leaves through the faces of the grid.
    #[test]
    fn a_sweep_conserves_energy() {
        let extinction = cloud(60.0);
        let mut model = model(&extinction, Interpolation::Trilinear, Boundary::Open);
        model.images(&extinction).unwrap();
        let state = model.state.as_ref().unwrap();
        let (lattice, count) = (&model.lattice, model.quadrature.harmonics);
        let mut rng = stream(3, Purpose::Validation, &[]);
        let source: Vec<f32> =
            state.field.moments.iter().map(|_| rng.random_range(-1.0..1.0)).collect();
        let medium = Medium { lattice, extinction: &state.scaled };
        let mut moments = Moments { values: vec![0.0; source.len()] };
        let mut leaving = 0.0;
        for octant in &model.quadrature.octants {
            let mut way = [(octant, Faces::dark(lattice, octant))];
            sweep(medium, &mut way, &source, &mut moments);
            let [(_, faces)] = way;
            for (axis, values) in [&faces.x, &faces.y, &faces.z].into_iter().enumerate() {
                for face in values.chunks_exact(3 * octant.ordinates) {
                    let cosines = octant.cosines[axis].iter().zip(&octant.weights);
                    for (radiance, (cosine, weight)) in face.iter().zip(cosines) {
                        let flux = radiance * weight * cosine;
                        leaving += f64::from(flux) / lattice.grid.spacing[axis];
                    }
                }
            }
        }
        // The integral over all directions of the harmonic of degree 0.
        let solid_angle = (4.0 * PI).sqrt();
        let (mut emitted, mut absorbed, mut size) = (0.0, 0.0, 0.0);
        for slot in 0..lattice.len() {
            let at = |m: usize| (slot * 4 + m) * count;
            let share = solid_angle * f64::from(lattice.share(slot));
            emitted += share * f64::from(source[at(0)]);
            size += share * f64::from(source[at(0)].abs());
            absorbed += share
                * (0..4)
                    .map(|m| f64::from(state.scaled[slot][m] * moments.values[at(m)]))
                    .sum::<f64>();
        }
        let balance = emitted - absorbed - leaving;
        assert!(absorbed.abs() > 1e-3 * size && leaving.abs() > 1e-3 * size);
        assert!(balance.abs() < 1e-5 * size, "{emitted} {absorbed} {leaving}");
    }

    /// The sweeps of all octants are the transpose of those of the opposite directions.
    #[test]
    fn a_sweep_has_its_transpose() {
        let extinction = cloud(60.0);
        for interpolation in [Interpolation::Constant, Interpolation::Trilinear] {
            let mut model = model(&extinction, interpolation, Boundary::Open);
            model.images(&extinction).unwrap();
            let state = model.state.as_ref().unwrap();
            let (lattice, count) = (&model.lattice, model.quadrature.harmonics);
            let mut rng = stream(4, Purpose::Validation, &[]);
            let mut draw = || -> Vec<f32> {
                state.field.moments.iter().map(|_| rng.random_range(-1.0..1.0)).collect()
            };
            let swept = |source: &[f32]| {
                let medium = Medium { lattice, extinction: &state.scaled };
                let mut moments = Moments { values: vec![0.0; source.len()] };
                for octant in &model.quadrature.octants {
                    let mut way = [(octant, Faces::dark(lattice, octant))];
                    sweep(medium, &mut way, source, &mut moments);
                }
                moments.values
            };
            let dot = |one: &[f32], other: &[f32]| -> f64 {
                let pairs = one.chunks_exact(4 * count).zip(other.chunks_exact(4 * count));
                pairs
                    .enumerate()
                    .map(|(slot, (a, b))| {
                        let pairs = a.iter().zip(b);
                        let sum: f64 = pairs.map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
                        f64::from(lattice.share(slot)) * sum
                    })
                    .sum()
            };
            let (source, mut weights) = (draw(), draw());
            let forward = dot(&swept(&source), &weights);
            reverse(&mut weights, count);
            let mut back = swept(&weights);
            reverse(&mut back, count);
            let backward = dot(&back, &source);
            let error = (forward - backward).abs();
            assert!(error < 2e-5 * forward.abs(), "{interpolation:?}: {forward} {backward}");
        }
    }
}
