//! Tests of inversions of an absorbing cloud whose images are known.

use super::*;
use crate::image::ViewStack;
use crate::inversion::blocks::smooth;
use crate::inversion::{Fields, ForwardModel, OrdinatesModels, Radius, Variable};
use crate::math::{DVec3, towards};
use crate::optics::{DropletSettings, DropletTable};
use crate::rng::{Purpose, RngExt, stream};
use crate::scene::{ExtinctionModel, Light, Observation, PhaseModel, Sun, View};
use crate::transport::{Derivatives, OrdinatesModel, OrdinatesSettings};
use crate::traverse::walk;
use std::cell::{Cell, RefCell};
use std::slice::from_ref;

// The forward model has a known solution: parallel light, absorbed by the extinction in front of a
// bright background.

/// `1 - exp(-optical depth)` along the centre of each pixel.
struct Absorption {
    views: Vec<View>,
}

impl Models for Absorption {
    fn model(&mut self, domain: &Domain) -> Result<Box<dyn ForwardModel + '_>> {
        Ok(Box::new(self.on(domain.mask.grid)))
    }
}

impl Absorption {
    fn on(&self, grid: Grid) -> OnGrid<'_> {
        OnGrid { views: &self.views, extinction: Volume::constant(grid, 0.0) }
    }
}

struct OnGrid<'a> {
    views: &'a [View],
    extinction: Volume,
}

impl OnGrid<'_> {
    fn of(&mut self, extinction: &Volume) -> ViewStack {
        let fields = Fields { extinction: extinction.clone(), effective_radius: None };
        self.images(&fields).unwrap().remove(0)
    }

    fn optical_depth(&self, [view, row, col]: [usize; 3]) -> f64 {
        let ray = self.views[view].ray(row as f64 + 0.5, col as f64 + 0.5);
        walk(&self.extinction.grid, &ray)
            .map(|step| f64::from(self.extinction.values[step.voxel]) * (step.exit - step.enter))
            .sum()
    }
}

impl ForwardModel for OnGrid<'_> {
    fn images(&mut self, fields: &Fields) -> Result<Vec<ViewStack>> {
        self.extinction = fields.extinction.clone();
        let shape = (self.views.len(), self.views[0].rows, self.views[0].cols);
        let images = ViewStack::new(Array3::from_shape_fn(shape, |(view, row, col)| {
            1.0 - (-self.optical_depth([view, row, col])).exp() as f32
        }));
        images.map(|images| vec![images])
    }

    fn derivatives(&mut self, weights: &[ViewStack]) -> Result<Derivatives> {
        let [weights] = weights else { panic!("one band") };
        let mut gradient = Volume::constant(self.extinction.grid, 0.0);
        for ((view, row, col), weight) in weights.values.indexed_iter() {
            let passed = (-self.optical_depth([view, row, col])).exp();
            let ray = self.views[view].ray(row as f64 + 0.5, col as f64 + 0.5);
            for step in walk(&gradient.grid.clone(), &ray) {
                let derivative = f64::from(*weight) * passed * (step.exit - step.enter);
                gradient.values[step.voxel] += derivative as f32;
            }
        }
        let effective_radius = Volume::constant(gradient.grid, 0.0);
        Ok(Derivatives { extinction: gradient, effective_radius })
    }
}

/// A smooth cloud, an observation of its absorption in seven views, and the forward model.
fn observe() -> (Volume, Observation, Absorption) {
    let grid = Grid::new(DVec3::new(0.0, 0.0, 0.5), DVec3::splat(0.05), [8, 10, 12]).unwrap();
    let value = |(k, j, i)| {
        let from_center = grid.voxel_center([k, j, i]) - grid.center();
        (6.0 * (1.0 - from_center.length_squared() / 0.04)).max(0.0) as f32
    };
    let truth = Volume::new(grid, Array3::from_shape_fn(grid.shape, value)).unwrap();
    let directions = [(0.0, 0.0), (50.0, 0.0), (50.0, 180.0), (65.0, 90.0), (65.0, 270.0)];
    let directions = directions.into_iter().chain([(35.0, 45.0), (35.0, 225.0)]);
    let views: Vec<View> = directions
        .map(|(zenith, azimuth): (f64, f64)| {
            let towards = towards(zenith.to_radians(), azimuth.to_radians());
            View::orthographic(towards, grid.center(), 0.025, [40, 40]).unwrap()
        })
        .collect();
    let models = Absorption { views: views.clone() };
    let images = models.on(truth.grid).of(&truth);
    (truth, Observation::new(Sun::default(), views, images).unwrap(), models)
}

fn settings() -> InversionSettings {
    InversionSettings {
        iterations: 100,
        coarse: vec![2],
        model_error: 0.0,
        least_error: 1e-3,
        coarse_error: 0.0,
        relative_noise: 1e-3,
        typical_gradient: 0.0,
        change: 0.0,
        ..Default::default()
    }
}

/// The voxels of the cloud and their neighbours.
fn mask(truth: &Volume) -> Mask {
    let counted = Array3::from_elem(truth.grid.shape, true);
    let spread = smooth(&truth.values.mapv(f64::from), &counted);
    Mask::new(truth.grid, spread.mapv(|value| value > 0.0)).unwrap()
}

/// Stores the checkpoints and stops after a number of iterations.
struct Keeper {
    stop_after: usize,
    reached: Cell<usize>,
    kept: RefCell<Vec<Checkpoint>>,
}

impl Keeper {
    fn new(stop_after: usize) -> Self {
        Self { stop_after, reached: Cell::new(0), kept: RefCell::default() }
    }
}

impl Watch for Keeper {
    fn reached(&self, _: &Record) {
        self.reached.set(self.reached.get() + 1);
    }

    fn keep(&self, checkpoint: &Checkpoint) -> Result<()> {
        self.kept.borrow_mut().push(checkpoint.clone());
        Ok(())
    }

    fn interrupted(&self) -> bool {
        self.reached.get() > self.stop_after
    }
}

#[test]
fn a_cloud_that_absorbs_is_found_from_next_to_nothing() {
    let (truth, observation, mut models) = observe();
    let mask = mask(&truth);
    let problem = Problem { bands: from_ref(&observation), mask: &mask, truth: Some(&truth) };
    for variable in [Variable::Linear, Variable::Logarithmic] {
        let settings = InversionSettings { variable, misfit: 0.1, ..settings() };
        let start = Start::Constant(0.01);
        let found = invert(&problem, &mut models, &start, &settings, &()).unwrap();
        let errors: Vec<f64> =
            found.history.iter().filter_map(|record| record.relative_error).collect();
        let (first, last) = (errors[0], errors[errors.len() - 1]);
        assert!(found.ending == Ending::Noise, "{:?}", found.history.last());
        assert!(first > 0.3 && last < 0.04, "{variable:?}: {first} to {last}");
        let outside = found.extinction.values.iter().zip(&mask.values);
        assert!(outside.clone().all(|(value, inside)| *value >= 0.0 && (*inside || *value == 0.0)));
    }
}

#[test]
fn the_search_finds_the_constant_that_fits_best() {
    let (truth, mut observation, mut models) = observe();
    let mask = mask(&truth);
    let inside = mask.values.mapv(|inside| if inside { 3.7 } else { 0.0 });
    let constant = Volume::new(truth.grid, inside).unwrap();
    observation.images = models.on(truth.grid).of(&constant);
    let problem = Problem { bands: from_ref(&observation), mask: &mask, truth: None };
    let settings = InversionSettings { iterations: 0, coarse: vec![], ..settings() };
    for start in [Start::Search, Start::Constant(0.01), Start::Constant(90.0)] {
        let found = invert(&problem, &mut models, &start, &settings, &()).unwrap();
        let value = found.extinction.values.iter().copied().fold(0.0, f32::max);
        assert!((value / 3.7 - 1.0).abs() < 0.1, "{start:?}: {value}");
    }
}

#[test]
fn an_inversion_goes_on_where_it_was_stopped() {
    let (truth, observation, mut models) = observe();
    let mask = mask(&truth);
    let problem = Problem { bands: from_ref(&observation), mask: &mask, truth: Some(&truth) };
    let settings = InversionSettings { iterations: 9, coarse_iterations: 5, ..settings() };
    let start = Start::Constant(1.0);
    let whole = invert(&problem, &mut models, &start, &settings, &()).unwrap();
    for stop_after in [0, 3, 6, 11] {
        let keeper = Keeper::new(stop_after);
        let part = invert(&problem, &mut models, &start, &settings, &keeper).unwrap();
        assert!(part.ending == Ending::Interrupted && part.history.len() == stop_after + 1);
        let checkpoint = keeper.kept.borrow().last().unwrap().clone();
        let rest = resume(&problem, &mut models, (&start, checkpoint), &settings, &()).unwrap();
        assert_eq!(rest.extinction, whole.extinction);
        assert_eq!(rest.ending, whole.ending);
        let without_times = |history: &[Record]| -> Vec<Record> {
            history.iter().map(|record| Record { seconds: 0.0, ..*record }).collect()
        };
        assert_eq!(without_times(&rest.history), without_times(&whole.history));
    }
}

/// The solver starts each solution from the previous one, which a checkpoint does not contain: a
/// resumed inversion has the same bits because the model forgets it where a checkpoint is kept.
#[test]
fn an_inversion_by_discrete_ordinates_goes_on_with_the_same_bits() {
    let grid = Grid::new(DVec3::new(0.0, 0.0, 0.6), DVec3::splat(0.1), [3, 4, 4]).unwrap();
    let values = Array3::from_shape_fn(grid.shape, |(k, j, i)| (5 + 7 * k + 3 * j + 2 * i) as f32);
    let truth = Volume::new(grid, values).unwrap();
    let light = Light::default();
    let scene = light.scene_of(truth.clone()).unwrap();
    let views = [(0.0, 0.0), (0.7, 1.0), (0.9, 4.0)].map(|(zenith, azimuth)| {
        View::orthographic(towards(zenith, azimuth), grid.center(), 0.1, [8, 8]).unwrap()
    });
    let solver = OrdinatesSettings { zenith_angles: 4, ..Default::default() };
    let images = OrdinatesModel::new(&scene, &views, None, &solver).unwrap().images(&truth);
    let observation = Observation::new(light, views.to_vec(), images.unwrap()).unwrap();
    let mask = Mask::new(grid, Array3::from_elem(grid.shape, true)).unwrap();
    let problem = Problem { bands: from_ref(&observation), mask: &mask, truth: None };
    let settings = InversionSettings { iterations: 8, coarse_iterations: 7, ..settings() };
    let models = || OrdinatesModels::new(scene.clone(), views.to_vec(), solver);
    let whole = invert(&problem, &mut models(), &Start::Search, &settings, &()).unwrap();
    for stop_after in [0, 6, 10, 17, 24] {
        let keeper = Keeper::new(stop_after);
        invert(&problem, &mut models(), &Start::Search, &settings, &keeper).unwrap();
        let checkpoint = keeper.kept.borrow().last().unwrap().clone();
        let from = (&Start::Search, checkpoint);
        let rest = resume(&problem, &mut models(), from, &settings, &()).unwrap();
        assert_eq!(rest.extinction, whole.extinction, "{stop_after}");
    }
}

/// A cloud of droplets that grow from its base, and its images in visible light and at 2.13 um, by the
/// solver that inverts them, with 1 % of noise.
fn microphysics() -> (Volume, Volume, [Observation; 2]) {
    let grid = Grid::new(DVec3::new(0.0, 0.0, 0.6), DVec3::splat(0.05), [6, 7, 7]).unwrap();
    let inside = |k: usize, j: usize, i: usize| {
        let at = (grid.voxel_center([k, j, i]) - grid.center()) / grid.extent();
        at.length() < 0.45
    };
    let extinction = Array3::from_shape_fn(grid.shape, |(k, j, i)| {
        if inside(k, j, i) { 10.0 + 6.0 * k as f32 + ((2 * j + i) % 3) as f32 } else { 0.0 }
    });
    let extinction = Volume::new(grid, extinction).unwrap();
    let radius = |k: usize| 14.0 * ((grid.voxel_center([k, 0, 0]).z - 0.6) / 0.3).cbrt() as f32;
    let radii = Array3::from_shape_fn(grid.shape, |(k, ..)| radius(k));
    let radii = Volume::new(grid, radii).unwrap();
    let views: Vec<View> = (0..6)
        .map(|number| {
            let (zenith, azimuth) = ([0.0, 0.5, 0.9][number % 3], 1.0 + 2.1 * number as f64);
            View::orthographic(towards(zenith, azimuth), grid.center(), 0.05, [12, 12]).unwrap()
        })
        .collect();
    let mut random = stream(3, Purpose::Validation, &[]);
    let light = |wavelength: f64| {
        let mut light = Light { wavelength, ..Light::default() };
        light.optics.phase = PhaseModel::Mie;
        light.optics.extinction = ExtinctionModel::Mie;
        light
    };
    let droplets = light(0.672).droplets_of(&extinction, &radii).unwrap();
    let mut observe = |wavelength: f64| {
        let table = DropletTable::shared(&DropletSettings::water(wavelength), 0.0, None).unwrap();
        let per_water =
            |radius: &f32| table.mixture(f64::from(*radius)).extinction_per_water as f32;
        let own = &droplets.liquid_water_content * &radii.values.map(per_water);
        let own = Volume::new(grid, own).unwrap();
        let light = light(wavelength);
        let scene = light.scene_of_any_droplets(own.clone()).unwrap();
        let mut model = OrdinatesModel::new(&scene, &views, None, &solver()).unwrap();
        let mut images = model.images_of_droplets(&own, &radii).unwrap();
        let error = images.values.mapv(|radiance| 0.01 * radiance + 1e-4);
        images.values.zip_mut_with(&error, |radiance, error| {
            // Uniform in a range of this standard deviation.
            *radiance += error * 3.0_f32.sqrt() * random.random_range(-1.0_f32..1.0);
        });
        let observation = Observation::new(light, views.clone(), images).unwrap();
        observation.with_standard_error(error).unwrap()
    };
    let bands = [observe(0.672), observe(2.13)];
    (extinction, radii, bands)
}

fn solver() -> OrdinatesSettings {
    OrdinatesSettings { zenith_angles: 4, ..Default::default() }
}

/// The error of the extinction, and the extinction-weighted mean absolute error of the effective radius
/// (um), of an inversion of some bands.
fn retrieved(
    (truth, radii): (&Volume, &Volume),
    bands: &[Observation],
    settings: &InversionSettings,
) -> (f64, f64) {
    let mask = Mask::new(truth.grid, truth.values.mapv(|value| value > 0.0)).unwrap();
    let problem = Problem { bands, mask: &mask, truth: Some(truth) };
    let mut models = OrdinatesModels::of(bands, &truth.grid, settings.radius, solver()).unwrap();
    let found = invert(&problem, &mut models, &Start::Search, settings, &()).unwrap();
    let epsilon = metrics::relative_error(truth, &found.extinction).unwrap();
    let Some(radius) = found.effective_radius else { return (epsilon, 0.0) };
    let errors = (&radius.values - &radii.values).mapv(f32::abs) * &truth.values;
    (epsilon, f64::from(errors.sum() / truth.values.sum()))
}

fn droplet_settings(radius: Radius) -> InversionSettings {
    InversionSettings { radius, coarse: vec![2], change: 1e-3, ..InversionSettings::default() }
}

/// Two bands determine the profile of the effective radius of this adiabatic cloud, also as a field; one
/// radius of the whole cloud is at best as wrong as the best constant. The extinction is as right as
/// from the visible band with the mean radius given.
#[test]
fn two_bands_determine_the_effective_radius() {
    let (extinction, radii, bands) = microphysics();
    let truth = (&extinction, &radii);
    let (_, uniform) = retrieved(truth, &bands, &droplet_settings(Radius::Uniform));
    let (epsilon, adiabatic) = retrieved(truth, &bands, &droplet_settings(Radius::Adiabatic));
    // The prior knows that the profile is nearly right.
    let near = InversionSettings {
        radius_error: 0.15,
        radius_gradient: 1.5,
        ..droplet_settings(Radius::Field)
    };
    let (other, field) = retrieved(truth, &bands, &near);
    let mut visible = bands[0].clone();
    let weighted = (&radii.values * &extinction.values).sum() / extinction.values.sum();
    visible.light.optics.effective_radius = Some(f64::from(weighted));
    let (given, _) = retrieved(truth, from_ref(&visible), &droplet_settings(Radius::Given));
    let found = format!("{uniform} um; {adiabatic} um, {epsilon}; {field} um, {other}; {given}");
    assert!(adiabatic < 0.2 && epsilon < 1.1 * given, "{found}");
    assert!(field < 0.4 && other < 1.1 * given, "{found}");
    assert!(uniform < 2.5 && uniform > 3.0 * adiabatic, "{found}");
}

/// Before any step, the effective radius is that of the start if it has one, and otherwise that which the
/// prior expects.
#[test]
fn an_inversion_begins_at_the_effective_radius_of_its_start() {
    let (extinction, radii, bands) = microphysics();
    let inside = extinction.values.mapv(|value| value > 0.0);
    let mask = Mask::new(extinction.grid, inside.clone()).unwrap();
    let problem = Problem { bands: &bands, mask: &mask, truth: None };
    let settings =
        InversionSettings { iterations: 0, corrections: 1, ..droplet_settings(Radius::Field) };
    let first = |effective_radius: Option<Volume>| {
        let start = Estimate { effective_radius, ..extinction.clone().into() };
        let mut models =
            OrdinatesModels::of(&bands, &extinction.grid, settings.radius, solver()).unwrap();
        let found = invert(&problem, &mut models, &start.into(), &settings, &()).unwrap();
        found.effective_radius.unwrap().values
    };
    let (given, expected) = (first(Some(radii.clone())), first(None));
    let pairs = given.iter().zip(&expected).zip(&radii.values).zip(&inside);
    let (mut near, mut other) = (0.0_f32, 0.0_f32);
    for (((given, expected), radius), _) in pairs.filter(|(_, inside)| **inside) {
        near = near.max((given / radius - 1.0).abs());
        other = other.max((expected / radius - 1.0).abs());
    }
    assert!(near < 1e-3 && other > 0.1, "{near} {other}");
}

/// One camera 3 % too bright spoils the extinction unless its gain is unknown.
#[test]
fn a_gain_that_is_wrong_is_found() {
    let (extinction, radii, [visible, _]) = microphysics();
    let (truth, mut wrong) = ((&extinction, &radii), visible.clone());
    wrong.light.optics.effective_radius = Some(11.0);
    let right = wrong.clone();
    wrong.images.values.index_axis_mut(ndarray::Axis(0), 2).mapv_inplace(|value| 1.03 * value);
    let settings = |camera_gain_error| InversionSettings {
        camera_gain_error,
        model_error: 0.001,
        ..droplet_settings(Radius::Given)
    };
    let error = |observation: &Observation, gain_error: f64| {
        retrieved(truth, from_ref(observation), &settings(gain_error)).0
    };
    let (known, ignored, found) = (error(&right, 0.0), error(&wrong, 0.0), error(&wrong, 0.02));
    assert!(found < 1.05 * known, "{known} {ignored} {found}");
    assert!(ignored > found, "{known} {ignored} {found}");
}

/// One camera that points a quarter of a pixel to the north spoils the extinction unless its direction is
/// unknown. Its image is computed with the pixels where they are.
#[test]
fn a_camera_that_points_elsewhere_is_found() {
    let (extinction, _, [mut visible, _]) = microphysics();
    visible.light.optics.effective_radius = Some(11.0);
    let scene = visible.light.scene_of(extinction.clone()).unwrap();
    let observed = |moved: f64| {
        let mut views = visible.views.clone();
        let target = extinction.grid.center() + DVec3::new(0.0, moved * 0.05, 0.0);
        views[3] = View::orthographic(views[3].towards(), target, 0.05, [12, 12]).unwrap();
        let mut model = OrdinatesModel::new(&scene, &views, None, &solver()).unwrap();
        let images = model.images(&extinction).unwrap();
        let error = images.values.mapv(|radiance| 0.002 * radiance + 1e-4);
        let seen = Observation::new(visible.light.clone(), visible.views.clone(), images).unwrap();
        seen.with_standard_error(error).unwrap()
    };
    let settings = |pointing_error| InversionSettings {
        pointing_error,
        model_error: 0.001,
        ..droplet_settings(Radius::Given)
    };
    let mask = Mask::new(extinction.grid, extinction.values.mapv(|value| value > 0.0)).unwrap();
    let solve = |moved: f64, pointing_error: f64| {
        let (observation, settings) = (observed(moved), settings(pointing_error));
        let bands = from_ref(&observation);
        let mut models =
            OrdinatesModels::of(bands, &extinction.grid, Radius::Given, solver()).unwrap();
        let problem = Problem { bands, mask: &mask, truth: Some(&extinction) };
        let found = invert(&problem, &mut models, &Start::Search, &settings, &()).unwrap();
        (metrics::relative_error(&extinction, &found.extinction).unwrap(), found.calibrations)
    };
    let ((known, _), (ignored, nominal), (found, cameras)) =
        (solve(0.0, 0.0), solve(0.25, 0.0), solve(0.25, 0.2));
    assert_eq!(nominal, [[Calibration::NOMINAL; 6]]);
    // If all cameras point elsewhere by the same distance, the cloud is elsewhere.
    let others: Vec<_> = (0..6).filter(|n| *n != 3).map(|n| cameras[0][n].offset).collect();
    let mean = |axis: usize| others.iter().map(|offset| offset[axis]).sum::<f64>() / 5.0;
    let offset = [0, 1].map(|axis| cameras[0][3].offset[axis] - mean(axis));
    assert!((offset[0] - 0.25).abs() < 0.05 && offset[1].abs() < 0.05, "{offset:?}");
    assert!(found < 0.3 * ignored, "{known} {ignored} {found}");
}

/// Each pixel sees one voxel, whose start has an uncertainty of its own: the precision of the result is
/// the sum of those of the start and of the radiance.
#[test]
fn standard_errors_are_those_of_independent_voxels() {
    let grid = Grid::new(DVec3::ZERO, DVec3::splat(0.1), [1, 4, 4]).unwrap();
    let truth = Volume::constant(grid, 3.0);
    let view = View::orthographic(DVec3::Z, grid.center(), 0.1, [4, 4]).unwrap();
    let mut models = Absorption { views: vec![view.clone()] };
    let images = models.on(grid).of(&truth);
    let noise = 0.02;
    let seen = Observation::new(Sun::default(), vec![view], images).unwrap();
    let seen = seen.with_standard_error(Array3::from_elem((1, 4, 4), noise)).unwrap();
    let mask = Mask::new(grid, Array3::from_elem(grid.shape, true)).unwrap();
    let problem = Problem { bands: from_ref(&seen), mask: &mask, truth: None };
    let uncertainty = |voxel: (usize, usize, usize)| [0.05, 0.2, 0.5, 1.0][voxel.1];
    let uncertainty = Volume::new(grid, Array3::from_shape_fn(grid.shape, uncertainty)).unwrap();
    let start = Estimate { uncertainty: Some(uncertainty.clone()), ..truth.clone().into() };
    let members = 400;
    let settings = InversionSettings {
        members,
        start_error: 1.0,
        least_error: 0.0,
        change: 1e-6,
        ..settings()
    };
    let found = invert(&problem, &mut models, &start.into(), &settings, &()).unwrap();
    let errors = found.standard_errors.unwrap();
    assert!(errors.effective_radius.is_none() && errors.liquid_water_content.is_none());
    // A radiance of 1 - exp(-0.3) changes by 0.1 exp(-0.3) per 1/km.
    let radiance = noise as f64 / (0.1 * (-0.3_f64).exp());
    for row in 0..4 {
        let variances: f64 =
            (0..4).map(|col| f64::from(errors.extinction.values[[0, row, col]]).powi(2)).sum();
        let start = f64::from(uncertainty.values[[0, row, 0]]);
        // Smaller uncertainties of a start are raised.
        let start = start.max(LEAST_UNCERTAINTY);
        let expected = (start.powi(-2) + radiance.powi(-2)).sqrt().recip();
        let found = (variances / 4.0).sqrt();
        let statistical = (8.0 * members as f64).sqrt().recip();
        assert!((found / expected - 1.0).abs() < 4.0 * statistical, "{row}: {found} {expected}");
    }
}

/// Models whose images are 10 % too dark, with a correction near the solution.
struct TooDark(Absorption);

impl Models for TooDark {
    fn are_corrected(&self) -> bool {
        true
    }

    fn model(&mut self, domain: &Domain) -> Result<Box<dyn ForwardModel + '_>> {
        let mut model = self.0.on(domain.mask.grid);
        let right = model.images(domain.expected)?.remove(0);
        let defect = if domain.near { 0.1 * right.values } else { 0.0 * right.values };
        Ok(Box::new(Dimmed { model, defect }))
    }
}

struct Dimmed<'a> {
    model: OnGrid<'a>,
    defect: Array3<f32>,
}

impl ForwardModel for Dimmed<'_> {
    fn images(&mut self, fields: &Fields) -> Result<Vec<ViewStack>> {
        let images = self.model.images(fields)?.remove(0);
        Ok(vec![ViewStack::new(0.9 * images.values + &self.defect)?])
    }

    fn derivatives(&mut self, weights: &[ViewStack]) -> Result<Derivatives> {
        self.model.derivatives(&[ViewStack::new(0.9 * &weights[0].values)?])
    }
}

/// With each correction, the images of the solution approach those of the accurate model.
#[test]
fn corrections_end_at_the_answer_of_the_accurate_model() {
    let (truth, observation, models) = observe();
    let mut models = TooDark(models);
    let mask = mask(&truth);
    let problem = Problem { bands: from_ref(&observation), mask: &mask, truth: Some(&truth) };
    let mut found = |corrections| {
        let settings = InversionSettings { corrections, misfit: 1e-4, ..settings() };
        invert(&problem, &mut models, &Start::Constant(1.0), &settings, &()).unwrap()
    };
    let (one, three) = (found(1), found(3));
    let stages: Vec<_> = three.history.iter().map(|record| (record.stage, record.block)).collect();
    let mut seen = stages.clone();
    seen.dedup();
    assert_eq!(seen, [(0, 2), (1, 1), (2, 1), (3, 1), (4, 1)]);
    let far = three.history.iter().rev().find(|record| record.stage == 1).unwrap();
    let errors = [far.relative_error.unwrap()].into_iter();
    let errors = errors
        .chain([&one, &three].map(|found| found.history.last().unwrap().relative_error.unwrap()));
    let errors: Vec<f64> = errors.collect();
    assert!(errors[0] > 0.08 && errors[1] < 0.5 * errors[0], "{errors:?}");
    assert!(errors[2] < 0.5 * errors[1], "{errors:?}");
}

/// Images that are darker after every second time that the model forgot earlier evaluations, like those
/// of an iterative solver that has not converged.
struct Forgetful<'a> {
    model: OnGrid<'a>,
    forgotten: usize,
}

impl Models for Forgetful<'_> {
    fn model(&mut self, domain: &Domain) -> Result<Box<dyn ForwardModel + '_>> {
        let model =
            OnGrid { views: self.model.views, extinction: Volume::constant(domain.mask.grid, 0.0) };
        Ok(Box::new(Forgetful { model, forgotten: 0 }))
    }
}

impl Forgetful<'_> {
    fn share(&self) -> f32 {
        if self.forgotten.is_multiple_of(2) { 0.97 } else { 1.0 }
    }
}

impl ForwardModel for Forgetful<'_> {
    fn images(&mut self, fields: &Fields) -> Result<Vec<ViewStack>> {
        let images = self.model.images(fields)?.remove(0);
        Ok(vec![ViewStack::new(self.share() * images.values)?])
    }

    fn derivatives(&mut self, weights: &[ViewStack]) -> Result<Derivatives> {
        self.model.derivatives(&[ViewStack::new(self.share() * &weights[0].values)?])
    }

    fn forget(&mut self) {
        self.forgotten += 1;
    }
}

/// The values before and after the model has begun anew are not compared.
#[test]
fn an_inversion_continues_where_the_model_begins_anew() {
    let (truth, observation, models) = observe();
    let mask = mask(&truth);
    let problem = Problem { bands: from_ref(&observation), mask: &mask, truth: Some(&truth) };
    let mut models = Forgetful { model: models.on(truth.grid), forgotten: 0 };
    let settings = InversionSettings { iterations: 2 * KEPT + 5, coarse: vec![], ..settings() };
    let found = invert(&problem, &mut models, &Start::Constant(1.0), &settings, &()).unwrap();
    let last = found.history.last().unwrap();
    assert_eq!((found.ending, last.iteration), (Ending::Iterations, 2 * KEPT + 5));
}

/// A model that requests a stop at one of its evaluations.
struct Stopping<'a> {
    model: OnGrid<'a>,
    left: &'a Cell<usize>,
}

struct Stoppable {
    model: Absorption,
    left: Cell<usize>,
}

impl Models for Stoppable {
    fn model(&mut self, domain: &Domain) -> Result<Box<dyn ForwardModel + '_>> {
        Ok(Box::new(Stopping { model: self.model.on(domain.mask.grid), left: &self.left }))
    }
}

impl ForwardModel for Stopping<'_> {
    fn images(&mut self, fields: &Fields) -> Result<Vec<ViewStack>> {
        let Some(left) = self.left.get().checked_sub(1) else { return Err(Error::Interrupted) };
        self.left.set(left);
        self.model.images(fields)
    }

    fn derivatives(&mut self, weights: &[ViewStack]) -> Result<Derivatives> {
        self.model.derivatives(weights)
    }
}

/// Wherever an inversion is stopped, also between its stages and in its members, it gives the result so far.
#[test]
fn an_inversion_that_is_stopped_anywhere_has_a_result() {
    let (truth, observation, models) = observe();
    let mut models = Stoppable { model: models, left: Cell::new(usize::MAX) };
    let mask = mask(&truth);
    let problem = Problem { bands: from_ref(&observation), mask: &mask, truth: None };
    let settings = InversionSettings {
        iterations: 2,
        coarse_iterations: 2,
        pointing_error: 0.1,
        camera_gain_error: 0.01,
        members: 2,
        ..settings()
    };
    let mut solve =
        || invert(&problem, &mut models, &Start::Constant(1.0), &settings, &()).unwrap();
    assert!(solve().standard_errors.is_some());
    let evaluations = usize::MAX - models.left.get();
    assert!(evaluations > 15, "{evaluations}");
    for stopped_after in 0..evaluations {
        models.left.set(stopped_after);
        let start = Start::Constant(1.0);
        let found = invert(&problem, &mut models, &start, &settings, &()).unwrap();
        assert_eq!(found.ending, Ending::Interrupted, "{stopped_after} of {evaluations}");
        assert!(found.standard_errors.is_none());
    }
}

/// A rough start is not smoothed if the images contain almost no information.
#[test]
fn a_start_is_what_the_prior_expects() {
    let (truth, observation, mut models) = observe();
    let mask = mask(&truth);
    let problem = Problem { bands: from_ref(&observation), mask: &mask, truth: None };
    let settings = InversionSettings {
        relative_noise: 1e3,
        least_error: 1e3,
        typical_gradient: 1.0,
        misfit: 0.0,
        iterations: 5,
        coarse: vec![],
        scale_start: false,
        ..settings()
    };
    let rough = |(k, j, i): (usize, usize, usize)| ((k + j + i) % 3) as f32;
    let mut rough =
        Volume::new(truth.grid, Array3::from_shape_fn(truth.grid.shape, rough)).unwrap();
    mask.apply(&mut rough).unwrap();
    let start = Start::from(Estimate::from(rough.clone()));
    let found = invert(&problem, &mut models, &start, &settings, &()).unwrap().extinction;
    let change = metrics::relative_error(&rough, &found).unwrap();
    assert!(change < 0.01, "{change}");
}

#[test]
fn what_does_not_fit_is_refused() {
    let (truth, observation, mut models) = observe();
    let mask = mask(&truth);
    let problem = Problem { bands: from_ref(&observation), mask: &mask, truth: None };
    let mut run = |problem: &Problem, start: Start, settings: &InversionSettings| {
        invert(problem, &mut models, &start, settings, &()).unwrap_err().to_string()
    };
    let wrong = InversionSettings { model_error: -1.0, ..settings() };
    assert!(run(&problem, Start::Search, &wrong).contains("model_error"));
    assert!(run(&problem, Start::Constant(0.0), &settings()).contains("start"));
    let mut moved = truth.clone();
    moved.grid.origin.x += 1.0;
    let error = run(&problem, Estimate::from(moved.clone()).into(), &settings());
    assert!(error.contains("grid of the start"), "{error}");
    let other = Problem { truth: Some(&moved), ..problem };
    assert!(run(&other, Start::Search, &settings()).contains("grid of the truth"));
    let nothing = Mask::new(truth.grid, Array3::from_elem(truth.grid.shape, false)).unwrap();
    let empty = Problem { mask: &nothing, ..problem };
    assert!(run(&empty, Start::Search, &settings()).contains("mask"));
}
