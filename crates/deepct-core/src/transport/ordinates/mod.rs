//! The discrete-ordinates solver, on discontinuous finite elements.
//!
//! It computes radiance without noise, and its exact derivatives. Unscattered sunlight is followed
//! along rays ([`beam`]). The light that it scatters is transported from cell to cell in discrete
//! directions ([`sweep`]) and scattered again until transport and scattering are consistent
//! ([`diffuse`]). The camera integrates along its own rays ([`camera`]).
//!
//! The derivative is that of the discretised computation, not of the continuous equation: all steps
//! are run backwards, each with its transpose. The transfer equations of a direction are the
//! transpose of those of the opposite one, so the adjoint radiance comes from the same solver
//! (Martin, Cairns and Bal 2014 for the continuous equation).

mod beam;
mod broadened;
mod camera;
mod derivative;
mod diffuse;
mod lattice;
mod optics;
mod quadrature;
mod settings;
mod sky;
mod surface_points;
mod surroundings;
mod sweep;
mod tangent;

pub use derivative::Derivatives;
pub use settings::OrdinatesSettings;

use super::{Progress, Watch, check_scene, check_sizes, warnings};
use crate::error::{Error, Result};
use crate::grid::{Mask, Volume};
use crate::image::ViewStack;
use crate::math::DVec3;
use crate::memory;
use crate::optics::{Medium, Scattering};
use crate::scene::{Boundary, Scene, View};
use crate::stop::Stop;
use beam::{Rays, cubature};
use camera::{Camera, Tile, tiles};
use diffuse::{Field, Origin, Transport};
use lattice::Lattice;
use ndarray::Array3;
use optics::{Functions, Optics};
use quadrature::{Octant, Quadrature, first_harmonics};
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};
use surroundings::{OnSurface, Surroundings};
use sweep::Faces;

/// Approximate share of the work of a rendering that the solution takes.
const SOLVED: f64 = 0.6;

/// Images of one scene by given views for any extinction, and their derivatives. Each solution
/// starts from the previous one.
#[derive(Debug)]
pub struct OrdinatesModel {
    scene: Scene,
    views: Vec<View>,
    tiles: Vec<Tile>,
    /// Pixels that are computed; all of them if `None`.
    pixels: Option<Array3<bool>>,
    settings: OrdinatesSettings,
    lattice: Lattice,
    optics: Optics,
    /// The phase functions that may occur in the optics.
    functions: Functions,
    surroundings: Surroundings,
    /// Optical depth of the molecular atmosphere towards the Sun, by cell.
    air_depths: Vec<f32>,
    quadrature: Quadrature,
    /// Points of a cell at which sunlight is evaluated, with their weights.
    cubature: Vec<(DVec3, f64)>,
    thickest_cell: f64,
    state: Option<State>,
    adjoint: Option<Field>,
    sweeps: usize,
    converged: bool,
    stop: Stop,
}

/// A solution for one extinction.
#[derive(Debug)]
struct State {
    extinction: Vec<f32>,
    unscaled: Vec<[f32; 4]>,
    scaled: Vec<[f32; 4]>,
    sun_depths: Vec<[f32; 8]>,
    /// Mean and slopes of the sunlight removed from the beam in each cell.
    stopped: Vec<[f32; 4]>,
    /// Share of the direct sunlight that the cloud blocks, by point of the surface.
    shade: Vec<f32>,
    /// Radiance that enters through the faces from outside, by octant.
    outside: Vec<Faces>,
    /// Source of light scattered once, without the forward peak: `[slot][4][harmonic]`.
    first: Vec<f32>,
    field: Field,
}

impl State {
    fn on_surface(&self) -> OnSurface<'_> {
        OnSurface { shade: &self.shade, irradiance: &self.field.irradiance }
    }
}

impl OrdinatesModel {
    /// Model of the images of `scene` for `views`. The medium of the scene specifies the grid and
    /// the scattering; its extinction and effective radii may be replaced. Empty voxels remain empty, unless `mask`
    /// marks them as voxels that may contain cloud.
    ///
    /// # Errors
    /// Fails if there is no view, if the views differ in size, if a pixel looks close to the Sun, if
    /// a setting is out of range, if a trilinear medium has only one voxel along an axis, or if the
    /// mask is on another grid.
    pub fn new(
        scene: &Scene,
        views: &[View],
        mask: Option<&Mask>,
        settings: &OrdinatesSettings,
    ) -> Result<Self> {
        check_scene(scene)?;
        check_sizes(views)?;
        check_aureole(views, scene.sun.towards())?;
        settings.check()?;
        let medium = &scene.medium;
        let grid = &medium.extinction.grid;
        let extinction = standard(&medium.extinction.values);
        let mask = match mask {
            Some(mask) => {
                grid.check_same("the mask", &mask.grid)?;
                Some(mask.values.as_standard_layout().to_owned())
            }
            None => None,
        };
        let mask = mask.as_ref().and_then(|mask| mask.as_slice());
        let prepared = |voxel: usize| {
            let own = extinction[voxel];
            let active = own > 0.0 || mask.is_some_and(|mask| mask[voxel]);
            active.then(|| settings.largest_extinction.map_or(own, |most| own.max(most as f32)))
        };
        let quadrature = Quadrature::new(settings.zenith_angles);
        let scaling = optics::delta_m_scaling(&medium.scattering, quadrature.degrees);
        let parts = |extinction: f32| parts(scaling * f64::from(extinction), scene, settings);
        let lattice = Lattice::new(grid, medium.interpolation, scene.boundary, prepared, parts);
        memory::check(
            "memory for the radiance in the cells of the discrete-ordinates solver (the Monte Carlo \
             solver, and a lower accuracy, need less)",
            lattice.len() as f64,
            bytes_of_cell(&quadrature),
        )?;
        let rise = lattice.grid.spacing.z / scene.sun.towards().z;
        let thickest = lattice.active().iter().map(|active| {
            let [.., parts] = lattice.parts_along(active.parts);
            scaling * f64::from(active.prepared) * rise / parts as f64
        });
        let cubature = cubature(thickest.fold(0.0, f64::max));
        let depths = lattice.active().iter().map(|active| {
            scaling * f64::from(active.prepared) * lattice.longest_side(active.parts)
        });
        let thickest_cell = depths.fold(0.0, f64::max);
        let functions = Functions::new(&medium.scattering, &quadrature);
        let optics = Optics::new(&medium.scattering, grid, &lattice, &quadrature, &functions);
        let surroundings = Surroundings::new(scene, &lattice, &quadrature)?;
        let middle = |slot| lattice.point(slot, DVec3::splat(0.5)).z;
        let air_depths =
            (0..lattice.len()).map(|slot| surroundings.sun_depth(middle(slot)) as f32).collect();
        Ok(Self {
            scene: scene.clone(),
            views: views.to_vec(),
            tiles: all_tiles(views),
            pixels: None,
            settings: *settings,
            surroundings,
            air_depths,
            lattice,
            optics,
            functions,
            quadrature,
            cubature,
            thickest_cell,
            state: None,
            adjoint: None,
            sweeps: 0,
            converged: true,
            stop: Stop::default(),
        })
    }

    /// Ends a computation that is running, with [`Error::Interrupted`], when `stop` is requested.
    pub fn stop_by(&mut self, stop: Stop) {
        self.stop = stop;
    }

    /// Forgets the solutions from which the next ones would start, so that these depend on their own
    /// inputs only.
    pub fn forget(&mut self) {
        (self.state, self.adjoint) = (None, None);
    }

    /// Forgets the adjoint solution from which that of the next [`Self::gradient`] would start.
    pub fn forget_adjoint(&mut self) {
        self.adjoint = None;
    }

    fn check_stop(&self) -> Result<()> {
        if self.stop.is_requested() { Err(Error::Interrupted) } else { Ok(()) }
    }

    /// Replace the views, and compute all of their pixels.
    ///
    /// # Errors
    /// Fails if there is no view, if the views differ in size, or if a pixel looks close to the Sun.
    pub fn look_from(&mut self, views: &[View]) -> Result<()> {
        check_sizes(views)?;
        check_aureole(views, self.scene.sun.towards())?;
        self.views = views.to_vec();
        self.tiles = all_tiles(views);
        self.pixels = None;
        self.adjoint = None;
        Ok(())
    }

    /// Compute only the given pixels `[view, row, col]` from now on; all others are set to 0.
    ///
    /// # Errors
    /// Fails if `pixels` does not have the shape of the images.
    pub fn look_at(&mut self, pixels: &Array3<bool>) -> Result<()> {
        let [rows, cols] = [self.views[0].rows, self.views[0].cols];
        let expected = [self.views.len(), rows, cols];
        if pixels.shape() != expected {
            return Err(Error::mismatch(
                "shape [view, row, col] of the pixels",
                format!("{expected:?}"),
                format!("{:?}", pixels.shape()),
                "give one value for each pixel of the images",
            ));
        }
        self.pixels = Some(pixels.clone());
        Ok(())
    }

    /// Number of cells.
    pub fn cells(&self) -> usize {
        self.lattice.len()
    }

    /// Approximate memory (bytes) that a computation needs at most.
    pub fn bytes(&self) -> f64 {
        self.lattice.len() as f64 * bytes_of_cell(&self.quadrature)
    }

    /// Reasons why the last images may be wrong, as sentences.
    pub fn warnings(&self) -> Vec<String> {
        let scaled = self.state.iter().flat_map(|state| state.scaled.iter().enumerate());
        let depths = scaled.map(|(slot, [mean, ..])| {
            let active = &self.lattice.active()[self.lattice.owner(slot)];
            f64::from(*mean) * self.lattice.longest_side(active.parts)
        });
        warnings(self.converged, depths.fold(0.0, f64::max))
    }

    /// The largest optical depth of a cell along an axis, without the forward peak of scattering
    /// (delta-M scaled).
    pub fn thickest_cell(&self) -> f64 {
        self.thickest_cell
    }

    /// Whether the last solution reached the tolerance of the settings.
    pub fn converged(&self) -> bool {
        self.converged
    }

    /// Number of sweeps of the last solution.
    pub fn sweeps(&self) -> usize {
        self.sweeps
    }

    /// Radiance (1/sr for a Sun of unit irradiance) for an extinction (1/km), averaged over the
    /// area of each pixel. The effective radii are those of the last [`Self::images_of_droplets`],
    /// or of the scene.
    ///
    /// # Errors
    /// Fails if the extinction is on another grid, negative or not finite.
    pub fn images(&mut self, extinction: &Volume) -> Result<ViewStack> {
        self.watched(extinction, &())
    }

    /// [`Self::images`] for an extinction (1/km) and an effective radius (um) of each voxel, which
    /// replaces that of the scene from now on.
    ///
    /// # Errors
    /// Fails if the scattering of the scene does not depend on the effective radius, if one of both
    /// is on another grid, negative or not finite, or if the effective radius of a voxel with
    /// extinction is beyond the table of the droplet optics.
    pub fn images_of_droplets(
        &mut self,
        extinction: &Volume,
        effective_radius: &Volume,
    ) -> Result<ViewStack> {
        let medium = &self.scene.medium;
        let grid = medium.extinction.grid;
        let Scattering::Droplets { effective_radius: before, table } = &medium.scattering else {
            return Err(Error::out_of_range(
                "scattering of the scene",
                "uniform",
                "that of droplets, if effective radii are given",
            ));
        };
        grid.check_same("the extinction", &extinction.grid)?;
        grid.check_same("the effective radius", &effective_radius.grid)?;
        effective_radius.check_non_negative("effective radius")?;
        if *before != effective_radius.values {
            let radii = effective_radius.values.clone();
            let Medium { scattering, .. } =
                Medium::of_droplets(extinction.clone(), radii, table.clone())?;
            self.optics =
                Optics::new(&scattering, &grid, &self.lattice, &self.quadrature, &self.functions);
            self.scene.medium.scattering = scattering;
        }
        self.images(extinction)
    }

    /// [`Self::images`] with a progress callback, which may stop the computation.
    pub(super) fn watched(&mut self, extinction: &Volume, watch: &dyn Watch) -> Result<ViewStack> {
        let grid = &self.scene.medium.extinction.grid;
        grid.check_same("the extinction", &extinction.grid)?;
        extinction.check_non_negative("extinction")?;
        self.solve(standard(&extinction.values), watch);
        let check_stop =
            || if watch.interrupted() { Err(Error::Interrupted) } else { self.check_stop() };
        check_stop()?;
        let state = self.state.as_ref().expect("solved above");
        let camera = self.camera(state);
        let [rows, cols] = [self.views[0].rows, self.views[0].cols];
        let mut images = Array3::zeros((self.views.len(), rows, cols));
        let done = AtomicUsize::new(0);
        let seen = |tile: &Tile| -> Vec<([usize; 2], f64)> {
            let view = &self.views[tile.view];
            let prepared = camera.prepare(tile, view);
            let radiance = |pixel: [usize; 2]| {
                (pixel, self.brightness(view, pixel) * camera.radiance(view, pixel, &prepared))
            };
            let pixels = if check_stop().is_ok() { self.looked_at(tile) } else { Vec::new() };
            let values = pixels.into_par_iter().map(radiance).collect();
            let done = done.fetch_add(1, Ordering::Relaxed) + 1;
            let share = done as f64 / self.tiles.len() as f64;
            watch.reached(&progress(SOLVED + (1.0 - SOLVED) * share));
            values
        };
        let values: Vec<_> = self.tiles.par_iter().map(seen).collect();
        check_stop()?;
        for (tile, values) in self.tiles.iter().zip(values) {
            for ([row, col], value) in values {
                images[[tile.view, row, col]] = value as f32;
            }
        }
        ViewStack::new(images)
    }

    /// Derivative of the sum of `weights` times the images with respect to the extinction of each
    /// voxel (km), at the extinction of the last [`Self::images`]; zero where the model is empty.
    ///
    /// # Errors
    /// As [`Self::derivatives`].
    pub fn gradient(&mut self, weights: &ViewStack) -> Result<Volume> {
        Ok(self.derivatives(weights)?.extinction)
    }

    /// Derivatives of the sum of `weights` times the images with respect to the extinction and the
    /// effective radius of each voxel, at those of the last images.
    ///
    /// # Errors
    /// Fails if the weights do not have the shape of the images, or if no images have been
    /// computed.
    pub fn derivatives(&mut self, weights: &ViewStack) -> Result<Derivatives> {
        let [rows, cols] = [self.views[0].rows, self.views[0].cols];
        let expected = [self.views.len(), rows, cols];
        if weights.shape() != expected {
            return Err(Error::mismatch(
                "shape [view, row, col] of the weights",
                format!("{expected:?}"),
                format!("{:?}", weights.shape()),
                "give a weight for each pixel of the images",
            ));
        }
        let Some(state) = self.state.as_ref() else {
            return Err(Error::out_of_range("images", "missing", "computed before the gradient"));
        };
        let (derivatives, adjoint) = self.differentiate(state, weights)?;
        self.check_stop()?;
        self.adjoint = Some(adjoint);
        Ok(derivatives)
    }

    /// The factor of the radiance of a pixel.
    fn brightness(&self, view: &View, [row, col]: [usize; 2]) -> f64 {
        let line_of_sight = view.ray(row as f64 + 0.5, col as f64 + 0.5).direction;
        self.scene.brightness(line_of_sight)
    }

    /// Pixels of a tile that are computed.
    fn looked_at(&self, tile: &Tile) -> Vec<[usize; 2]> {
        let counts = |[row, col]: &[usize; 2]| {
            self.pixels.as_ref().is_none_or(|pixels| pixels[[tile.view, *row, *col]])
        };
        tile.pixels().filter(counts).collect()
    }

    /// Mean and slopes of the extinction of each active cell, with and without the forward peak.
    fn coefficients(&self, extinction: &[f32]) -> (Vec<[f32; 4]>, Vec<[f32; 4]>) {
        let both = |slot: usize| {
            let unscaled = self.lattice.coefficients(extinction, slot);
            let scaling = self.optics.delta_m_scaling(self.lattice.owner(slot));
            (unscaled, unscaled.map(|value| scaling * value))
        };
        (0..self.lattice.len()).map(both).unzip()
    }

    fn rays<'a>(&'a self, extinction: &'a [f32]) -> Rays<'a> {
        let Self { lattice, optics, cubature, .. } = self;
        Rays { lattice, optics, extinction, cubature }
    }

    fn camera<'a>(&'a self, state: &'a State) -> Camera<'a> {
        Camera {
            rays: self.rays(&state.extinction),
            sun: self.scene.sun.towards(),
            sun_depths: &state.sun_depths,
            air_depths: &self.air_depths,
            surroundings: &self.surroundings,
            on_surface: state.on_surface(),
            moments: &state.field.moments,
            count: self.quadrature.harmonics,
            rays_per_pixel: self.settings.rays_per_pixel,
        }
    }

    fn transport<'a>(
        &'a self,
        rays: Rays<'a>,
        unscaled: &'a [[f32; 4]],
        scaled: &'a [[f32; 4]],
    ) -> Transport<'a> {
        let Self { quadrature, surroundings, .. } = self;
        Transport { rays, quadrature, surroundings, unscaled, scaled }
    }

    /// Direct sunlight that one slot scatters into each harmonic, over the sunlight that it removes
    /// from the beam.
    fn turned_sunlight(&self) -> impl Fn(usize) -> Vec<f32> + Sync {
        let sun = first_harmonics(-self.scene.sun.towards(), self.quadrature.harmonics);
        move |slot| {
            let by = self.optics.scattered(self.lattice.owner(slot)).iter();
            by.zip(&sun).map(|(scattered, harmonic)| scattered * harmonic).collect()
        }
    }

    /// Source of light scattered once, `[slot][4][harmonic]`, from the sunlight removed from the
    /// beam.
    fn first(&self, stopped: &[[f32; 4]]) -> Vec<f32> {
        let turned = self.turned_sunlight();
        let mut source = Vec::with_capacity(stopped.len() * 4 * self.quadrature.harmonics);
        for (slot, stopped) in stopped.iter().enumerate() {
            let turned = turned(slot);
            source.extend(stopped.iter().flat_map(|s| turned.iter().map(move |f| s * f)));
        }
        source
    }

    fn solve(&mut self, extinction: Vec<f32>, watch: &dyn Watch) {
        let rays = self.rays(&extinction);
        let (unscaled, scaled) = self.coefficients(&extinction);
        let surroundings = &self.surroundings;
        let air = |altitude| surroundings.sun_depth(altitude);
        let sun_depths = rays.sun_depths(self.scene.sun.towards(), air);
        let shade = surroundings.shade(&rays);
        let blurred: Vec<f32> =
            surroundings.blurred(&shade).into_iter().map(|shade| shade as f32).collect();
        let incoming = |octant: &Octant| surroundings.incoming(&self.lattice, octant, &blurred);
        let outside = match surroundings.is_dark() {
            true => Vec::new(),
            false => self.quadrature.octants.par_iter().map(incoming).collect(),
        };
        let beam = rays.stopped(&sun_depths);
        let first = self.first(&beam);
        let transport = self.transport(rays, &unscaled, &scaled);
        let start =
            self.state.as_ref().map_or_else(|| transport.dark(), |state| state.field.clone());
        let OrdinatesSettings { tolerance, most_sweeps, .. } = self.settings;
        let irradiance = surroundings.start();
        let origin = Origin { own: &first, outside: &outside, irradiance, ..Origin::default() };
        // Each sweep reduces the change by about the same factor.
        let go_on = |change: f64| {
            let share = change.min(1.0).ln() / tolerance.ln();
            watch.reached(&progress(SOLVED * share.clamp(0.0, 1.0)));
            !watch.interrupted() && !self.stop.is_requested()
        };
        let (field, sweeps) = transport.solve(origin, start, tolerance, most_sweeps, &go_on);
        let stopped = watch.interrupted();
        (self.sweeps, self.converged) = (sweeps, sweeps < most_sweeps && !stopped);
        self.state = Some(State {
            extinction,
            unscaled,
            scaled,
            sun_depths,
            stopped: beam,
            shade,
            outside,
            first,
            field,
        });
    }
}

/// Memory (bytes) that a cell needs at most.
fn bytes_of_cell(quadrature: &Quadrature) -> f64 {
    (diffuse::MOST_FIELDS * 4 * quadrature.harmonics * size_of::<f32>()) as f64
}

/// Progress of a solver without photon paths.
fn progress(share: f64) -> Progress {
    Progress { share, samples_per_pixel: 0, noise: 0.0 }
}

/// Angle from the Sun (degrees) up to which the light that droplets scatter forward, of which the
/// solver does not resolve the peak, makes images wrong: by up to 8 % for the Henyey-Greenstein phase
/// function, by more than a factor of two for droplets.
const AUREOLE_DEG: f64 = 12.0;

/// Refuse views with pixels that look close to the Sun.
fn check_aureole(views: &[View], sun: DVec3) -> Result<()> {
    for (number, view) in views.iter().enumerate() {
        let [rows, cols] = [view.rows, view.cols];
        let at = |row: usize, col: usize| view.ray(row as f64, col as f64).direction;
        let axis = -view.towards();
        let corners = [at(0, 0), at(0, cols), at(rows, 0), at(rows, cols)];
        let wide = corners.iter().map(|ray| ray.angle_between(axis)).fold(0.0, f64::max);
        if (axis.angle_between(sun) - wide).to_degrees() >= AUREOLE_DEG {
            continue;
        }
        for (row, col) in (0..=rows).flat_map(|row| (0..=cols).map(move |col| (row, col))) {
            let angle = at(row, col).angle_between(sun).to_degrees();
            if angle < AUREOLE_DEG {
                return Err(Error::out_of_range(
                    "angle between a line of sight and the Sun",
                    format!("{angle:.1} degrees (view {number}, row {row}, col {col})"),
                    format!(
                        "at least {AUREOLE_DEG} degrees for discrete ordinates, which do not resolve \
                         the aureole: use the Monte Carlo solver"
                    ),
                ));
            }
        }
    }
    Ok(())
}

fn all_tiles(views: &[View]) -> Vec<Tile> {
    views.iter().enumerate().flat_map(|(number, view)| tiles(number, view)).collect()
}

/// Number of cells into which a voxel of a delta-M scaled extinction (1/km) is split along an axis.
/// Axes with a single voxel between periodic sides do not count, since nothing varies along them.
fn parts(extinction: f64, scene: &Scene, settings: &OrdinatesSettings) -> usize {
    let grid = &scene.medium.extinction.grid;
    let alone = |index: usize| scene.boundary == Boundary::Periodic && grid.shape[index] == 1;
    let longest = [(0, alone(2)), (1, alone(1)), (2, false)]
        .into_iter()
        .filter(|(_, alone)| !alone)
        .map(|(axis, _)| grid.spacing[axis])
        .fold(0.0, f64::max);
    let parts = (extinction * longest / settings.cell_depth).ceil();
    parts.clamp(1.0, settings.most_parts as f64) as usize
}

fn standard(values: &Array3<f32>) -> Vec<f32> {
    values.as_standard_layout().iter().copied().collect()
}

#[cfg(test)]
mod parts;
#[cfg(test)]
mod tests;
