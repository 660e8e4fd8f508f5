//! Inversion of images of another code: the five views of the RICO cloud rendered by Mitsuba.
//!
//! `rico_inversion FOLDER [ASYMMETRY [constant|trilinear [AGREEMENT TYPICAL_GRADIENT
//! MODEL_ERROR LEAST_ERROR MISFIT]]]` inverts the views in FOLDER (rico32_cloud.nc,
//! rico32_views.nc), which lie in one plane with the Sun. The inversion starts from 0.01 /km inside
//! the mask carved from the images, and a row is printed for each step. The last five arguments are
//! settings of the carving and of the inversion.

use deepct_core::carve::{CarveSettings, carve};
use deepct_core::grid::Volume;
use deepct_core::image::ViewStack;
use deepct_core::inversion::{
    InversionSettings, OrdinatesModels, Problem, Record, Start, Watch, invert,
};
use deepct_core::io::{ReferenceView, read_reference_view, read_volume};
use deepct_core::math::DVec3;
use deepct_core::optics::{Interpolation, Medium, PhaseFunction};
use deepct_core::scene::{Observation, Scene, Sun, Surface, View};
use deepct_core::transport::OrdinatesSettings;
use ndarray::Array3;
use std::path::Path;

type AnyError = Box<dyn std::error::Error>;

/// The radiances in the files are for a solar irradiance of 1 on a horizontal plane.
const SUN_ZENITH_DEG: f64 = 30.0;

fn main() -> Result<(), AnyError> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let usage = "rico_inversion FOLDER [ASYMMETRY [constant|trilinear [AGREEMENT TYPICAL_GRADIENT \
                 MODEL_ERROR LEAST_ERROR MISFIT]]]";
    let folder = Path::new(arguments.first().ok_or(usage)?);
    let asymmetry: f64 = arguments.get(1).map_or(Ok(0.0), |text| text.parse())?;
    let interpolation = match arguments.get(2).map(String::as_str) {
        None | Some("constant") => Interpolation::Constant,
        Some("trilinear") => Interpolation::Trilinear,
        Some(_) => return Err(usage.into()),
    };
    let (mut carving, mut settings) = (CarveSettings::default(), InversionSettings::default());
    if let Some(numbers) = arguments.get(3..).filter(|numbers| !numbers.is_empty()) {
        let [agreement, gradient, model, least, misfit] = numbers else {
            return Err(usage.into());
        };
        carving.agreement = agreement.parse()?;
        settings.typical_gradient = gradient.parse()?;
        (settings.model_error, settings.least_error) = (model.parse()?, least.parse()?);
        settings.misfit = misfit.parse()?;
    }
    let truth = read_volume(folder.join("rico32_cloud.nc"))?;
    let phase = PhaseFunction::henyey_greenstein(asymmetry)?;
    let nothing = Volume::constant(truth.grid, 0.0);
    let medium = Medium::new(nothing, 1.0, phase)?.with_interpolation(interpolation);
    let scene = Scene::new(medium, Sun::from_degrees(SUN_ZENITH_DEG, 225.0)?, Surface::BLACK)?;
    let mark = if asymmetry == 0.0 { "g000" } else { "g085" };
    let file = folder.join("rico32_views.nc");
    let names = ["nadir", "plus26", "minus26", "plus46", "minus46"];
    let views: Vec<ReferenceView> = names
        .into_iter()
        .map(|name| read_reference_view(&file, name, mark))
        .collect::<Result<_, _>>()?;
    let observation = observe(&scene, &views)?;
    let mask = carve(&observation, &truth.grid, &carving)?.mask;
    println!("mask: {} of {} voxels", mask.count(), mask.grid.len());
    println!("blocks  step   misfit  epsilon    delta  seconds");
    let mut models =
        OrdinatesModels::new(scene, observation.views.clone(), OrdinatesSettings::default());
    let problem =
        Problem { bands: std::slice::from_ref(&observation), mask: &mask, truth: Some(&truth) };
    invert(&problem, &mut models, &Start::Constant(0.01), &settings, &Rows)?;
    Ok(())
}

/// The views as images of one size. The added pixels do not show the cloud and have radiance 0.
fn observe(scene: &Scene, views: &[ReferenceView]) -> Result<Observation, AnyError> {
    let cols = views.iter().map(|view| view.view.cols).max().ok_or("no views")?;
    let rows = views[0].view.rows;
    let (mut images, mut errors) =
        (Array3::zeros((views.len(), rows, cols)), Array3::zeros((views.len(), rows, cols)));
    let mut wide = Vec::new();
    let flux = SUN_ZENITH_DEG.to_radians().cos();
    for (number, ReferenceView { view, mitsuba, mitsuba_standard_error, .. }) in
        views.iter().enumerate()
    {
        for (pixel, value) in mitsuba.iter().enumerate() {
            let place = [number, pixel / view.cols, pixel % view.cols];
            images[place] = (flux * value) as f32;
            errors[place] = (flux * mitsuba_standard_error[pixel]) as f32;
        }
        let east = 0.5 * (cols - view.cols) as f64 * view.pixel_km();
        let target = view.target + DVec3::new(east, 0.0, 0.0);
        wide.push(View::orthographic(view.towards(), target, view.pixel_km(), [rows, cols])?);
    }
    let mut observation = Observation::new(scene.sun, wide, ViewStack::new(images)?)?;
    observation.standard_error = Some(ViewStack::new(errors)?);
    Ok(observation)
}

/// Prints one row for each step.
struct Rows;

impl Watch for Rows {
    fn reached(&self, record: &Record) {
        let (epsilon, delta) = (record.relative_error, record.mass_error);
        println!(
            "{:6}  {:4}  {:7.2}  {:7.3}  {:+7.3}  {:7.1}",
            record.block,
            record.iteration,
            record.misfit,
            epsilon.unwrap_or(f64::NAN),
            delta.unwrap_or(f64::NAN),
            record.seconds
        );
    }
}
