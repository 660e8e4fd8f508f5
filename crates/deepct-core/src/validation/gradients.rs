//! Derivatives by the discrete-ordinates solver, compared with its own central differences and with
//! the derivatives of other codes.

use super::{Reference, Report};
use crate::error::Result;
use crate::grid::{Grid, Volume};
use crate::image::ViewStack;
use crate::math::{DVec3, towards};
use crate::optics::{Interpolation, Medium, PhaseFunction};
use crate::rng::{Purpose, RngExt, stream};
use crate::scene::{Scene, Sun, Surface, View};
use crate::transport::{OrdinatesModel, OrdinatesSettings, Share};
use ndarray::Array3;
use std::path::Path;

/// Accepted relative difference between a derivative and the central difference.
const ACCURACY: f64 = 0.02;
/// Number of single voxels, and of random directions that change all voxels, in which each
/// derivative is tested.
const VOXELS: usize = 8;
const DIRECTIONS: usize = 4;
/// The larger of the two steps of a central difference: for a single voxel as an optical depth
/// across it, and for a direction relative to the extinction. The steps are large compared with the
/// rounding errors of single precision.
const DEPTH_STEP: f64 = 0.5;
const RELATIVE_STEP: f32 = 0.1;
/// Voxels are tested if their derivative exceeds this fraction of the root mean square of all.
const SLOPE: f32 = 0.25;
/// The tolerance of the solver.
const TOLERANCE: f64 = 3e-7;
/// The measured images are those of the cloud with its extinction multiplied by this factor, so
/// that the gradient of the misfit does not vanish at the cloud.
const MEASURED: f32 = 0.7;
/// The zenith angle of the Sun (degrees).
const SUN_ZENITH_DEG: f64 = 30.0;

pub(super) fn run(mut report: Report, reference: Option<&Path>) -> Result<()> {
    super::photon_gradients::run(&mut report)?;
    let thorough = report.effort.relative_error.is_some();
    let zenith_angles = if thorough { 8 } else { 4 };
    let blob = Case { name: "blob", cloud: blob()?, pixel_km: 0.05, zenith_angles };
    blob.compare(&mut report)?;
    #[cfg(feature = "files")]
    if let Some(folder) = reference {
        let cloud = crate::io::read_volume(folder.join("rico32_cloud.nc"))?;
        let case = Case { name: "rico", cloud, pixel_km: 0.02, zenith_angles };
        case.compare(&mut report)?;
        scale_of_a_cumulus(&mut report, folder)?;
    }
    #[cfg(not(feature = "files"))]
    let _ = reference;
    Ok(())
}

/// An inhomogeneous cloud whose extinction tends to increase towards its centre.
fn blob() -> Result<Volume> {
    let grid = Grid::new(DVec3::new(0.0, 0.0, 0.6), DVec3::new(0.05, 0.05, 0.04), [8, 9, 10])?;
    let values = Array3::from_shape_fn(grid.shape, |(k, j, i)| {
        let at = 2.0 * (grid.voxel_center([k, j, i]) - grid.center()) / grid.extent();
        let inside = (1.0 - at.length_squared()).max(0.0) as f32;
        inside * (50.0 + 15.0 * ((7 * k + 3 * j + 5 * i) % 5) as f32)
    });
    Volume::new(grid, values)
}

/// A cloud with three views of it.
struct Case {
    name: &'static str,
    cloud: Volume,
    pixel_km: f64,
    zenith_angles: usize,
}

impl Case {
    fn model(&self) -> Result<OrdinatesModel> {
        let phase = PhaseFunction::henyey_greenstein(0.85)?;
        let medium = Medium::new(self.cloud.clone(), 1.0, phase)?
            .with_interpolation(Interpolation::Trilinear);
        let sun = Sun::from_degrees(SUN_ZENITH_DEG, 225.0)?;
        let scene = Scene::new(medium, sun, Surface::BLACK)?;
        let grid = &self.cloud.grid;
        let side = (grid.extent().x.max(grid.extent().y) / self.pixel_km).ceil() as usize + 6;
        let views: Vec<View> = [(0.0_f64, 0.0), (26.0, 45.0), (46.0, 225.0)]
            .into_iter()
            .map(|(zenith, azimuth): (f64, f64)| {
                let towards = towards(zenith.to_radians(), azimuth.to_radians());
                View::orthographic(towards, grid.center(), self.pixel_km, [side, side])
            })
            .collect::<Result<_>>()?;
        let settings = OrdinatesSettings {
            zenith_angles: self.zenith_angles,
            tolerance: TOLERANCE,
            rays_per_pixel: 1,
            ..Default::default()
        };
        OrdinatesModel::new(&scene, &views, None, &settings)
    }

    /// Compares the derivatives of the misfit in single voxels and in random directions.
    fn compare(&self, report: &mut Report) -> Result<()> {
        let measured = self.model()?.images(&scaled(&self.cloud, MEASURED))?;
        let misfit = Misfit { case: self, measured };
        let constant = |value: f32| {
            let filled = |old: &f32| if *old > 0.0 { value } else { 0.0 };
            Volume { values: self.cloud.values.map(filled), ..self.cloud.clone() }
        };
        for (level, extinction) in [
            ("0.1 /km", constant(0.1)),
            ("10 /km", constant(10.0)),
            ("half the cloud", scaled(&self.cloud, 0.5)),
            ("the cloud", self.cloud.clone()),
        ] {
            let gradient = misfit.gradient(&extinction)?;
            let seed = report.effort.seed;
            for (what, direction) in directions(&extinction, &gradient, seed) {
                let along = &gradient.values * &direction;
                let derivative: f64 = along.iter().map(|value| f64::from(*value)).sum();
                let difference = misfit.extrapolated(&extinction, &direction)?;
                let case = format!("{}, {level}: {what}, ratio to difference", self.name);
                let one = Reference { systematic: ACCURACY, ..Reference::new(1.0, 0.0) };
                report.compare(&[(case, exact(derivative / difference), one)]);
            }
        }
        Ok(())
    }
}

/// Steps in single voxels and in random directions that change all voxels. Voxels that darken some
/// pixels as much as they brighten others are excluded: their derivative is close to zero, and a
/// relative accuracy cannot be required.
fn directions(extinction: &Volume, gradient: &Volume, seed: u64) -> Vec<(String, Array3<f32>)> {
    let mut random = stream(seed, Purpose::Validation, &[]);
    let pairs = extinction.values.indexed_iter().zip(&gradient.values);
    let cloudy: Vec<_> = pairs.filter(|((_, value), _)| **value > 0.0).collect();
    let squares: f32 = cloudy.iter().map(|(_, slope)| *slope * *slope).sum();
    let least = SLOPE * (squares / cloudy.len() as f32).sqrt();
    let sloping: Vec<_> = cloudy.iter().filter(|(_, slope)| slope.abs() > least).collect();
    let step = (DEPTH_STEP / extinction.grid.spacing.z) as f32;
    let mut directions = Vec::new();
    for _ in 0..VOXELS {
        let ((voxel, value), _) = sloping[random.random_range(0..sloping.len())];
        let mut direction = Array3::zeros(extinction.values.raw_dim());
        direction[*voxel] = step.min(**value);
        let (k, j, i) = voxel;
        directions.push((format!("voxel {k} {j} {i}"), direction));
    }
    for number in 1..=DIRECTIONS {
        let relative = |value: &f32| RELATIVE_STEP * value * random.random_range(-1.0_f32..1.0);
        directions.push((format!("direction {number}"), extinction.values.map(relative)));
    }
    directions
}

/// Half the sum of squared differences from the measured images. Each solution starts from zero
/// radiance: if it started from a previous solution, the iteration would stop before the change of
/// a single voxel has taken effect.
struct Misfit<'a> {
    case: &'a Case,
    measured: ViewStack,
}

impl Misfit<'_> {
    fn gradient(&self, extinction: &Volume) -> Result<Volume> {
        let mut model = self.case.model()?;
        let images = model.images(extinction)?;
        model.gradient(&ViewStack::new(images.values - &self.measured.values)?)
    }

    /// The Richardson (1911) extrapolation of the differences for this step and for half of it,
    /// which removes the error that grows with the cube of the step.
    fn extrapolated(&self, extinction: &Volume, step: &Array3<f32>) -> Result<f64> {
        let whole = self.difference(extinction, step)?;
        let half = self.difference(extinction, &(0.5 * step))?;
        Ok((8.0 * half - whole) / 3.0)
    }

    /// Half the difference of the misfits one step forwards and one step backwards. It is computed
    /// as a product with the difference of the images, which avoids cancellation.
    fn difference(&self, extinction: &Volume, step: &Array3<f32>) -> Result<f64> {
        let moved = |sign: f32| Volume {
            values: &extinction.values + &(sign * step),
            ..extinction.clone()
        };
        let forwards = self.case.model()?.images(&moved(1.0))?;
        let backwards = self.case.model()?.images(&moved(-1.0))?;
        let pixels = forwards.values.iter().zip(&backwards.values).zip(&self.measured.values);
        let product = |((forwards, backwards), measured): ((&f32, &f32), &f32)| {
            let [forwards, backwards, measured] = [*forwards, *backwards, *measured].map(f64::from);
            0.5 * (forwards - backwards) * (0.5 * (forwards + backwards) - measured)
        };
        Ok(pixels.map(product).sum())
    }
}

fn scaled(extinction: &Volume, factor: f32) -> Volume {
    Volume { values: factor * &extinction.values, ..extinction.clone() }
}

fn exact(mean: f64) -> Share {
    Share { mean, standard_error: 0.0 }
}

/// Asymmetry parameter, and the derivative of the mean radiance of the nadir view with respect to
/// the logarithm of a scaling factor of the extinction: by Mitsuba, its standard error, and by
/// SHDOM on a refined grid.
#[cfg(feature = "files")]
const SCALE: [(f64, f64, f64, f64); 2] =
    [(0.0, 0.0139, 0.0005, 0.0147), (0.85, 0.0093, 0.0009, 0.0106)];

#[cfg(feature = "files")]
fn scale_of_a_cumulus(report: &mut Report, folder: &Path) -> Result<()> {
    let extinction = crate::io::read_volume(folder.join("rico32_cloud.nc"))?;
    let view =
        crate::io::read_reference_view(&folder.join("rico32_views.nc"), "nadir", "g000")?.view;
    for (asymmetry, mitsuba, standard_error, shdom) in SCALE {
        let phase = PhaseFunction::henyey_greenstein(asymmetry)?;
        let medium = Medium::new(extinction.clone(), 1.0, phase)?
            .with_interpolation(Interpolation::Trilinear);
        let sun = Sun::from_degrees(SUN_ZENITH_DEG, 225.0)?;
        let scene = Scene::new(medium, sun, Surface::BLACK)?;
        let mut model = OrdinatesModel::new(
            &scene,
            std::slice::from_ref(&view),
            None,
            &OrdinatesSettings::default(),
        )?;
        let images = model.images(&extinction)?;
        // The reference radiances are for a flux of 1 through a horizontal plane.
        let flux = SUN_ZENITH_DEG.to_radians().cos();
        let weight = 1.0 / (flux * images.values.len() as f64);
        let weights = ViewStack::new(Array3::from_elem(images.values.raw_dim(), weight as f32))?;
        let along = &model.gradient(&weights)?.values * &extinction.values;
        let derivative = exact(along.iter().map(|value| f64::from(*value)).sum());
        let case = |code| format!("rico, g {asymmetry}: d(nadir mean)/d(log extinction), {code}");
        // SHDOM provides no error; the tolerance covers the difference between the two codes.
        let apart = Reference { systematic: 3.0 * standard_error, ..Reference::new(shdom, 0.0) };
        report.compare(&[
            (case("Mitsuba"), derivative, Reference::new(mitsuba, standard_error)),
            (case("SHDOM"), derivative, apart),
        ]);
    }
    Ok(())
}
