//! Comparison of the discrete-ordinates solver with the images of two other codes for a simulated
//! cloud.
//!
//! `ordinates FOLDER [ASYMMETRY [ZENITH_ANGLES [PATHS]]]` computes the five views of the cloud
//! in FOLDER (rico32_cloud.nc, rico32_views.nc) one after the other and prints a row for each view:
//! the view mean relative to those of Mitsuba and SHDOM, the mean absolute difference between the
//! pixels of deepct and SHDOM divided by the mean, the number of sweeps and the seconds. The first
//! row includes the solution of the radiation field.
//!
//! PATHS is a folder with a file VIEW.bin for each view, written by `render_timer FOLDER VIEW
//! ASYMMETRY SAMPLES never PATHS/VIEW.bin`. If it is given, the same comparison is made with Monte
//! Carlo, including the mean absolute difference that the Monte Carlo noise alone causes.

use deepct_core::io::{read_reference_view, read_volume};
use deepct_core::optics::{Interpolation, Medium, PhaseFunction};
use deepct_core::scene::{Scene, Sun, Surface};
use deepct_core::transport::{OrdinatesModel, OrdinatesSettings};
use std::path::Path;
use std::time::Instant;

type AnyError = Box<dyn std::error::Error>;

/// The radiances in the files are for a solar irradiance of 1 on a horizontal plane.
const SUN_ZENITH_DEG: f64 = 30.0;

fn main() -> Result<(), AnyError> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let folder = Path::new(arguments.first().ok_or("ordinates FOLDER [ASYMMETRY [ANGLES]]")?);
    let asymmetry: f64 = arguments.get(1).map_or(Ok(0.85), |text| text.parse())?;
    let zenith_angles = arguments.get(2).map_or(Ok(8), |text| text.parse())?;
    let paths = arguments.get(3).map(Path::new);
    let mark = if asymmetry == 0.0 { "g000" } else { "g085" };
    let extinction = read_volume(folder.join("rico32_cloud.nc"))?;
    let phase = PhaseFunction::henyey_greenstein(asymmetry)?;
    let medium =
        Medium::new(extinction.clone(), 1.0, phase)?.with_interpolation(Interpolation::Trilinear);
    let scene = Scene::new(medium, Sun::from_degrees(SUN_ZENITH_DEG, 225.0)?, Surface::BLACK)?;
    let settings = OrdinatesSettings { zenith_angles, ..Default::default() };
    let mut model: Option<OrdinatesModel> = None;
    println!(
        "view      mean      to Mitsuba  to SHDOM  pixels  to paths  pixels   noise  sweeps  seconds"
    );
    for name in ["nadir", "plus26", "minus26", "plus46", "minus46"] {
        let expected = read_reference_view(&folder.join("rico32_views.nc"), name, mark)?;
        let start = Instant::now();
        let mut solver = match model.take() {
            None => OrdinatesModel::new(&scene, &[expected.view], None, &settings)?,
            Some(mut solver) => {
                solver.look_from(&[expected.view])?;
                solver
            }
        };
        let images = solver.images(&extinction)?;
        let seconds = start.elapsed().as_secs_f64();
        let flux = SUN_ZENITH_DEG.to_radians().cos().recip();
        let found: Vec<f64> = images.values.iter().map(|value| flux * f64::from(*value)).collect();
        let (sum, sum_of) =
            (found.iter().sum::<f64>(), |values: &[f64]| values.iter().sum::<f64>());
        let apart: f64 = found.iter().zip(&expected.shdom).map(|(a, b)| (a - b).abs()).sum();
        let against_paths = match paths {
            Some(folder) => beside_paths(&folder.join(format!("{name}.bin")), &found, flux)?,
            None => format!("{:>8}  {:>6}  {:>6}", "", "", ""),
        };
        println!(
            "{name:<9} {:.6}  {:+9.2} %  {:+6.2} %  {:4.2} %  {against_paths}  {:6}  {seconds:7.2}",
            sum / found.len() as f64,
            100.0 * (sum / sum_of(&expected.mitsuba) - 1.0),
            100.0 * (sum / sum_of(&expected.shdom) - 1.0),
            100.0 * apart / sum_of(&expected.shdom),
            solver.sweeps(),
        );
        model = Some(solver);
    }
    Ok(())
}

/// Differences of the mean and of the pixels from Monte Carlo, and those due to noise (per cent).
fn beside_paths(file: &Path, found: &[f64], flux: f64) -> Result<String, AnyError> {
    let bytes = std::fs::read(file)?;
    let (numbers, _) = bytes.as_chunks::<8>();
    let numbers: Vec<f64> = numbers.iter().map(|n| flux * f64::from_le_bytes(*n)).collect();
    let (radiance, error) = numbers.split_at(found.len());
    let all: f64 = radiance.iter().sum();
    let apart: f64 = found.iter().zip(radiance).map(|(a, b)| (a - b).abs()).sum();
    // Mean absolute value of a normally distributed variable.
    let noise = (2.0 / std::f64::consts::PI).sqrt() * error.iter().sum::<f64>();
    let share = |sum: f64| 100.0 * sum / all;
    let mean = share(found.iter().sum::<f64>() - all);
    Ok(format!("{mean:+6.2} %  {:4.2} %  {:4.2} %", share(apart), share(noise)))
}
