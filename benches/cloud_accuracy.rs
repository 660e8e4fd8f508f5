//! Accuracy of the discrete-ordinates solver for clouds, with user-defined settings, relative to
//! the Monte Carlo solver.
//!
//! `cloud_accuracy FOLDER CACHE NOISE [ANGLES CELL_DEPTH MOST_PARTS RAYS TOLERANCE [CASE ...]]`
//! prints for each case of `deepct validate --suite clouds` the relative error of the cloud signal
//! of each view and the root mean square error of its bright pixels, in per cent, the number of
//! sweeps and the seconds. FOLDER contains the simulations; CACHE stores the Monte Carlo images,
//! whose relative noise in bright pixels is NOISE. Without settings, only the Monte Carlo images
//! are computed. If the environment variable VARIANT contains `noair` or `black`, the scenes have
//! no molecular atmosphere or a black surface.

use deepct_core::transport::{OrdinatesModel, OrdinatesSettings};
use deepct_core::validation::cloud_cases;
use std::path::Path;
use std::time::Instant;

type AnyError = Box<dyn std::error::Error>;

fn main() -> Result<(), AnyError> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, cache, noise, rest @ ..] = &arguments[..] else {
        return Err("cloud_accuracy FOLDER CACHE NOISE [ANGLES DEPTH PARTS RAYS TOLERANCE]".into());
    };
    let noise: f64 = noise.parse()?;
    let (mut worst, mut means) = (0.0_f64, Vec::new());
    for mut case in cloud_cases(Some(Path::new(folder)))? {
        if rest.len() > 5 && !rest[5..].iter().any(|name| case.name.contains(name)) {
            continue;
        }
        if let Ok(variant) = std::env::var("VARIANT") {
            if variant.contains("noair") {
                case.scene.air = None;
            }
            if variant.contains("black") {
                case.scene.surface = deepct_core::scene::Surface::BLACK;
            }
            case.name = format!("{} {variant}", case.name);
        }
        let began = Instant::now();
        let reference = case.reference(noise, 1, Some(Path::new(cache)))?;
        let sampled = began.elapsed().as_secs_f64();
        let shape = reference.images.shape();
        print!("{:24} {:5} voxels, {} x {}", case.name, case.voxels, shape[1], shape[2]);
        let [angles, depth, parts, rays, tolerance, ..] = rest else {
            println!(", {sampled:.1} s of Monte Carlo");
            continue;
        };
        let settings = OrdinatesSettings {
            zenith_angles: angles.parse()?,
            cell_depth: depth.parse()?,
            most_parts: parts.parse()?,
            rays_per_pixel: rays.parse()?,
            tolerance: tolerance.parse()?,
            ..Default::default()
        };
        let began = Instant::now();
        let mut model = OrdinatesModel::new(&case.scene, &case.views, None, &settings)?;
        let prepared = began.elapsed().as_secs_f64();
        let images = model.images(&case.scene.medium.extinction)?;
        let seconds = began.elapsed().as_secs_f64();
        let errors = case.errors(&images, &reference)?;
        println!(
            ", {} cells, {} sweeps, {prepared:.2} + {:.2} s",
            model.cells(),
            model.sweeps(),
            seconds - prepared
        );
        for (what, values) in [
            ("signal", errors.iter().map(|e| 100.0 * e.signal).collect::<Vec<_>>()),
            ("  noise", errors.iter().map(|e| 100.0 * e.signal_noise).collect()),
            ("beside", errors.iter().map(|e| 100.0 * e.beside).collect()),
            ("pixels", errors.iter().map(|e| 100.0 * e.pixels).collect()),
        ] {
            print!("  {what:8}");
            for value in &values {
                print!(" {value:6.2}");
            }
            println!();
        }
        worst = errors.iter().fold(worst, |worst, error| worst.max(error.signal.abs()));
        means.push(errors.iter().map(|error| error.pixels).sum::<f64>() / errors.len() as f64);
    }
    if !means.is_empty() {
        let mean = means.iter().sum::<f64>() / means.len() as f64;
        println!("worst signal {:.2} %, mean of pixels {:.2} %", 100.0 * worst, 100.0 * mean);
    }
    Ok(())
}
