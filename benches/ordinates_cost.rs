//! Computing time and memory of the discrete-ordinates solver, and its errors for optically thick
//! cells.
//!
//! `ordinates_cost [SIDE ...]` prints
//! - the seconds for the images and for a gradient of a cumulus with 1 and with 32 views;
//! - the seconds and peak memory for cloud fields of SIDE x SIDE columns (default: 64, 128, 256);
//! - the errors of the reflectances of layers for several optical depths of a cell.

mod process_memory;

use deepct_core::cloud::{CumulusSettings, cumulus};
use deepct_core::grid::{Grid, Volume};
use deepct_core::image::ViewStack;
use deepct_core::math::{DVec3, towards};
use deepct_core::optics::{Medium, PhaseFunction, extinction};
use deepct_core::scene::{Boundary, Scene, Sun, Surface, View};
use deepct_core::transport::{OrdinatesModel, OrdinatesSettings};
use ndarray::Array3;
use process_memory::{restart_peak, status};
use std::f64::consts::PI;
use std::time::Instant;

type AnyError = Box<dyn std::error::Error>;

fn main() -> Result<(), AnyError> {
    let sides: Vec<usize> =
        std::env::args().skip(1).map(|side| side.parse()).collect::<Result<_, _>>()?;
    one_cloud()?;
    println!("\ncolumns    voxels  with cloud  sweeps  seconds  us/voxel   GiB  bytes/voxel");
    for side in if sides.is_empty() { vec![64, 128, 256] } else { sides } {
        field(side)?;
    }
    layers()
}

fn scene(extinction: Volume, asymmetry: f64, sun_zenith_deg: f64) -> Result<Scene, AnyError> {
    let phase = PhaseFunction::henyey_greenstein(asymmetry)?;
    let medium = Medium::new(extinction, 1.0, phase)?;
    Ok(Scene::new(medium, Sun::from_degrees(sun_zenith_deg, 225.0)?, Surface::BLACK)?)
}

/// Views of `side` x `side` pixels around a cloud, with zenith angles from 0 to 45 degrees.
fn views(grid: &Grid, count: usize, side: usize) -> Result<Vec<View>, AnyError> {
    let pixel = grid.extent().x / side as f64;
    let view = |number: usize| {
        let zenith = 0.25 * PI * number as f64 / count as f64;
        let towards = towards(zenith, 2.4 * number as f64);
        View::orthographic(towards, grid.center(), pixel, [side, side])
    };
    Ok((0..count).map(view).collect::<Result<_, _>>()?)
}

fn one_cloud() -> Result<(), AnyError> {
    println!("a cumulus of 32 x 32 x 32 voxels, HG 0.85");
    println!("views  images (s)  images again (s)  gradient (s)  gradient over images");
    let extinction = extinction(&cumulus(&CumulusSettings::default(), 3)?)?;
    let scene = scene(extinction.clone(), 0.85, 30.0)?;
    for count in [1, 32] {
        let views = views(&extinction.grid, count, 32)?;
        let mut seconds = [f64::INFINITY; 3];
        for _ in 0..2 {
            let start = Instant::now();
            let settings = OrdinatesSettings::default();
            let mut model = OrdinatesModel::new(&scene, &views, None, &settings)?;
            let images = model.images(&extinction)?;
            keep_least(&mut seconds[0], start);
            let start = Instant::now();
            model.images(&extinction)?;
            keep_least(&mut seconds[1], start);
            // The weights have both signs, as those of a misfit.
            let mean = images.values.mean().unwrap_or(0.0);
            let weights = ViewStack::new(images.values.map(|value| value - mean))?;
            let start = Instant::now();
            model.gradient(&weights)?;
            keep_least(&mut seconds[2], start);
        }
        let [first, again, gradient] = seconds;
        println!("{count:5} {first:11.3} {again:17.3} {gradient:13.3} {:21.2}", gradient / first);
    }
    Ok(())
}

fn keep_least(least: &mut f64, start: Instant) {
    *least = least.min(start.elapsed().as_secs_f64());
}

/// A periodic field in which a cloud of 32 x 32 columns is repeated.
fn field(side: usize) -> Result<(), AnyError> {
    let grid = Grid::new(DVec3::ZERO, DVec3::new(0.05, 0.05, 0.04), [12, side, side])?;
    let extinction = Array3::from_shape_fn(grid.shape, |(k, j, i)| {
        let part =
            |index: usize, count: usize| 2.0 * ((index % count) as f32 + 0.5) / count as f32 - 1.0;
        let squares = [part(k, 12), part(j, 32), part(i, 32)].map(|x| x * x);
        60.0 * (1.0 - 1.5 * squares.iter().sum::<f32>()).max(0.0)
    });
    let with_cloud = extinction.iter().filter(|value| **value > 0.0).count();
    let extinction = Volume::new(grid, extinction)?;
    let scene = scene(extinction.clone(), 0.85, 30.0)?.with_boundary(Boundary::Periodic);
    let views = views(&grid, 1, side)?;
    // The peak memory is measured from here on.
    let counted = restart_peak();
    let start = Instant::now();
    let mut model = OrdinatesModel::new(&scene, &views, None, &OrdinatesSettings::default())?;
    model.images(&extinction)?;
    let seconds = start.elapsed().as_secs_f64();
    let peak = if counted { status("VmHWM:") } else { None };
    let bytes = peak.map_or(f64::NAN, |bytes| bytes as f64);
    let voxels = grid.len() as f64;
    println!(
        "{:>7} {:9} {with_cloud:11} {:7} {seconds:8.2} {:9.2} {:5.2} {:12.0}",
        format!("{side}^2"),
        grid.len(),
        model.sweeps(),
        1e6 * seconds / voxels,
        bytes / 1024.0_f64.powi(3),
        bytes / voxels,
    );
    Ok(())
}

/// Asymmetry parameter, optical depth, solar zenith angle (degrees) and reflectance without
/// absorption. The reflectances are from a discrete-ordinates solution whose results for 32 and 48
/// streams agree to five digits.
const LAYERS: [(f64, f64, f64, f64); 8] = [
    (0.0, 8.0, 0.0, 0.82180),
    (0.0, 8.0, 60.0, 0.87665),
    (0.85, 1.0, 0.0, 0.04232),
    (0.85, 1.0, 60.0, 0.16488),
    (0.85, 8.0, 0.0, 0.35843),
    (0.85, 8.0, 60.0, 0.55808),
    (0.85, 16.0, 0.0, 0.55721),
    (0.85, 16.0, 60.0, 0.69740),
];
/// Optical depths of the cells.
const CELLS: [f64; 5] = [0.25, 0.5, 1.0, 2.0, 4.0];

/// Print the reflectance errors of layers whose cells are not subdivided.
fn layers() -> Result<(), AnyError> {
    println!("\nreflectance of layers, error by optical depth of a cell");
    println!("g      depth Sun   {}", CELLS.map(|cell| format!("{cell:>9}")).concat());
    for (asymmetry, depth, sun_zenith_deg, expected) in LAYERS {
        let errors = CELLS.map(|cell| {
            // A layer that is thinner than the given depth consists of one cell.
            let cells = (depth / cell).max(1.0) as usize;
            let found = reflectance(asymmetry, depth, sun_zenith_deg, cells);
            found.map(|found| format!("{:+7.2} %", 100.0 * (found / expected - 1.0)))
        });
        let errors: Vec<String> = errors.into_iter().collect::<Result<_, _>>()?;
        println!("{asymmetry:<6} {depth:<5} {sun_zenith_deg:<5} {}", errors.concat());
    }
    Ok(())
}

fn reflectance(
    asymmetry: f64,
    depth: f64,
    sun_zenith_deg: f64,
    cells: usize,
) -> Result<f64, AnyError> {
    // The column is so wide that horizontal transport is negligible.
    let spacing = DVec3::new(10.0, 10.0, 1.0 / cells as f64);
    let grid = Grid::new(DVec3::ZERO, spacing, [cells, 1, 1])?;
    let extinction = Volume::constant(grid, depth as f32);
    let scene =
        scene(extinction.clone(), asymmetry, sun_zenith_deg)?.with_boundary(Boundary::Periodic);
    // Directions at the centres of bins that contribute equally to the hemispheric flux.
    let (zeniths, azimuths) = (40, 16);
    let view = |number: usize| {
        let share = ((number / azimuths) as f64 + 0.5) / zeniths as f64;
        let azimuth = 2.0 * PI * ((number % azimuths) as f64 + 0.5) / azimuths as f64;
        let target = DVec3::new(5.0, 5.0, 1.0);
        View::orthographic(towards(share.sqrt().acos(), azimuth), target, 1e-3, [1, 1])
    };
    let views: Vec<View> = (0..zeniths * azimuths).map(view).collect::<Result<_, _>>()?;
    let settings = OrdinatesSettings { cell_depth: 1e3, ..Default::default() };
    let images = OrdinatesModel::new(&scene, &views, None, &settings)?.images(&extinction)?;
    let mean = f64::from(images.values.mean().unwrap_or(0.0));
    Ok(PI * mean / sun_zenith_deg.to_radians().cos())
}
