//! A cumulus from a large-eddy simulation of the RICO campaign, compared with Mitsuba (Monte Carlo)
//! and SHDOM (spherical harmonics and discrete ordinates).

use super::{Reference, Report};
use crate::error::{Error, Result};
use crate::io::{ReferenceView, read_reference_view, read_volume};
use crate::optics::{Interpolation, Medium, PhaseFunction};
use crate::scene::{Scene, Sun, Surface};
use crate::transport::{MonteCarloSettings, Rendering, Share, Solver, render};
use std::path::Path;

/// The views, given by the names of their groups in the file.
const VIEWS: [&str; 5] = ["nadir", "plus26", "minus26", "plus46", "minus46"];

/// Asymmetry parameter, its label in the names of the variables, and the relative difference
/// between the view means of the two codes, which is also the accepted systematic difference.
const PHASES: [(f64, &str, f64); 2] = [(0.0, "g000", 0.007), (0.85, "g085", 0.015)];

/// Pixels enter the chi-square if their radiance is at least this fraction of that of the brightest
/// pixel. In darker pixels so few of Mitsuba's samples hit the cloud that its standard errors are
/// unreliable and often zero.
const LIT: f64 = 0.02;

/// Solar zenith angle (degrees). The reference radiances are for a flux of 1 through a horizontal
/// plane.
const SUN_ZENITH_DEG: f64 = 30.0;

pub(super) fn run(mut report: Report, reference: Option<&Path>) -> Result<()> {
    let Some(folder) = reference else {
        return Err(Error::out_of_range(
            "reference folder of the suite rico",
            "not given",
            "one with rico32_cloud.nc and rico32_views.nc",
        ));
    };
    let extinction = read_volume(folder.join("rico32_cloud.nc"))?;
    // The number of pixels per view is up to 3108.
    let samples_per_pixel = (report.effort.samples / 400).max(2);
    for (asymmetry, mark, apart) in PHASES {
        let phase = PhaseFunction::henyey_greenstein(asymmetry)?;
        let medium = Medium::new(extinction.clone(), 1.0, phase)?
            .with_interpolation(Interpolation::Trilinear);
        // In the reference files sunlight propagates towards the north-east.
        let sun = Sun::from_degrees(SUN_ZENITH_DEG, 225.0)?;
        let scene = Scene::new(medium, sun, Surface::BLACK)?;
        for name in VIEWS {
            let expected = read_reference_view(&folder.join("rico32_views.nc"), name, mark)?;
            let seed = report.effort.seed;
            let settings = MonteCarloSettings { samples_per_pixel, seed, ..Default::default() };
            let view = expected.view.clone();
            let found = render(&scene, &[view], &Solver::MonteCarlo(settings), &())?;
            compare(
                &mut report,
                &format!("{name}, g {asymmetry}"),
                &found,
                &expected,
                (asymmetry == 0.0, apart),
            );
        }
    }
    Ok(())
}

/// Compares view means with both codes, and single pixels with Mitsuba by their chi-square.
fn compare(
    report: &mut Report,
    case: &str,
    found: &Rendering,
    expected: &ReferenceView,
    (isotropic, apart): (bool, f64),
) {
    let flux = 1.0 / SUN_ZENITH_DEG.to_radians().cos();
    let scaled = |values: &ndarray::Array3<f32>| -> Vec<f64> {
        values.iter().map(|value| flux * f64::from(*value)).collect()
    };
    let errors = found.standard_error.as_ref().expect("photon paths have noise");
    let (radiance, error) = (scaled(&found.images.values), scaled(&errors.values));
    let mean = mean_of(&radiance, &error);
    let mitsuba = mean_of(&expected.mitsuba, &expected.mitsuba_standard_error);
    let shdom = mean_of(&expected.shdom, &[]);
    let reference = |share: Share| Reference {
        value: share.mean,
        standard_error: share.standard_error,
        systematic: apart * share.mean,
    };
    let mut checks = vec![
        (format!("{case}: view mean against Mitsuba"), mean, reference(mitsuba)),
        (format!("{case}: view mean against SHDOM"), mean, reference(shdom)),
    ];
    // With forward scattering few samples carry most of the radiance, and Mitsuba's standard errors
    // are far too small in pixels that lack such samples.
    if isotropic {
        let (chi_square, pixels) = chi_square(&radiance, &error, expected);
        let one = Reference {
            value: 1.0,
            // The standard errors are themselves estimates.
            systematic: 0.1,
            standard_error: (2.0 / pixels).sqrt(),
        };
        checks.push((format!("{case}: chi-square per pixel against Mitsuba"), chi_square, one));
    }
    report.compare(&checks);
}

fn mean_of(values: &[f64], errors: &[f64]) -> Share {
    let count = values.len() as f64;
    Share {
        mean: values.iter().sum::<f64>() / count,
        standard_error: errors.iter().map(|error| error * error).sum::<f64>().sqrt() / count,
    }
}

/// The chi-square per pixel over the sufficiently bright pixels, and their number.
fn chi_square(radiance: &[f64], error: &[f64], expected: &ReferenceView) -> (Share, f64) {
    let (mut sum, mut count) = (0.0, 0.0);
    let least = LIT * radiance.iter().copied().fold(0.0, f64::max);
    for (pixel, value) in radiance.iter().enumerate().filter(|(_, value)| **value >= least) {
        let variance = error[pixel].powi(2) + expected.mitsuba_standard_error[pixel].powi(2);
        if variance > 0.0 {
            sum += (value - expected.mitsuba[pixel]).powi(2) / variance;
            count += 1.0;
        }
    }
    (Share { mean: sum / count, standard_error: 0.0 }, count)
}
