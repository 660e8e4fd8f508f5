//! Timing of the Monte Carlo solver for `mitsuba.py`, which starts this program for each view.
//!
//! `render_timer FOLDER VIEW ASYMMETRY SAMPLES SIMILARITY_AFTER OUTPUT` renders a view of
//! the cloud in FOLDER (rico32_cloud.nc, rico32_views.nc) with the Sun of these views.
//! SIMILARITY_AFTER is a number or "never". OUTPUT contains the radiance of all pixels, followed by
//! the standard error of all pixels, as raw doubles. The wall-clock seconds of the rendering and
//! the numbers of rows and columns are printed as a JSON array.

use deepct_core::io::{read_reference_view, read_volume};
use deepct_core::optics::{Interpolation, Medium, PhaseFunction};
use deepct_core::scene::{Scene, Sun, Surface};
use deepct_core::transport::{MonteCarloSettings, Solver, render};
use std::path::Path;
use std::time::Instant;

type AnyError = Box<dyn std::error::Error>;

fn main() -> Result<(), AnyError> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, view, asymmetry, samples, similarity_after, output] = arguments.as_slice() else {
        return Err("render_timer FOLDER VIEW ASYMMETRY SAMPLES SIMILARITY_AFTER OUTPUT".into());
    };
    let folder = Path::new(folder);
    let phase = PhaseFunction::henyey_greenstein(asymmetry.parse()?)?;
    let medium = Medium::new(read_volume(folder.join("rico32_cloud.nc"))?, 1.0, phase)?
        .with_interpolation(Interpolation::Trilinear);
    let scene = Scene::new(medium, Sun::from_degrees(30.0, 225.0)?, Surface::BLACK)?;
    let view = read_reference_view(&folder.join("rico32_views.nc"), view, "g000")?.view;
    let solver = Solver::MonteCarlo(MonteCarloSettings {
        samples_per_pixel: samples.parse()?,
        similarity_after: similarity_after.parse().ok(),
        ..Default::default()
    });
    let start = Instant::now();
    let rendering = render(&scene, std::slice::from_ref(&view), &solver, &())?;
    let seconds = start.elapsed().as_secs_f64();
    let values = rendering
        .images
        .values
        .iter()
        .chain(&rendering.standard_error.as_ref().expect("photon paths").values);
    let bytes: Vec<u8> = values.flat_map(|value| f64::from(*value).to_le_bytes()).collect();
    std::fs::write(output, bytes)?;
    println!("[{seconds}, {}, {}]", view.rows, view.cols);
    Ok(())
}
