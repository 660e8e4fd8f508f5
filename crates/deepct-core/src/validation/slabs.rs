//! Plane-parallel layers, represented by a periodic field of one column.

use super::{Reference, Report, scene, unit_grid};
use crate::error::Result;
use crate::grid::Volume;
use crate::math::{DVec3, Ray, towards};
use crate::scene::{Boundary, Scene, Surface};
use crate::transport::{MonteCarloSettings, Radiance, Share, radiances};
use std::f64::consts::PI;

/// The cosine of 30 degrees.
const COS_30: f64 = 0.866_025_403_784_438_6;
/// Half a unit of the fifth decimal digit.
const FIFTH_DIGIT: f64 = 0.5e-5;

/// Optical depth, single-scattering albedo, asymmetry parameter, cosine of the solar zenith angle;
/// reflectance and, if tabulated, transmittance. The first three rows are DISORT's published tests
/// (van de Hulst 1980; Garcia and Siewert 1985); the others were computed with discrete ordinates,
/// where 32 and 48 streams agree to five digits.
pub(super) const FLUXES: [(f64, f64, f64, f64, f64, Option<f64>); 22] = [
    (1.0, 1.0, 0.75, 1.0, 0.078742, Some(0.921258)),
    (8.0, 1.0, 0.75, 1.0, 0.506418, Some(0.493580)),
    (32.0, 1.0, 0.0, 0.1, 0.97845, Some(0.02155)),
    (1.0, 1.0, 0.0, 1.0, 0.34133, None),
    (1.0, 1.0, 0.0, COS_30, 0.37387, None),
    (1.0, 1.0, 0.0, 0.5, 0.49838, None),
    (8.0, 1.0, 0.0, 1.0, 0.82180, None),
    (8.0, 1.0, 0.0, COS_30, 0.83636, None),
    (8.0, 1.0, 0.0, 0.5, 0.87665, None),
    (1.0, 1.0, 0.85, 1.0, 0.04232, None),
    (1.0, 1.0, 0.85, COS_30, 0.05828, None),
    (1.0, 1.0, 0.85, 0.5, 0.16488, None),
    (8.0, 1.0, 0.85, 1.0, 0.35843, None),
    (8.0, 1.0, 0.85, COS_30, 0.40853, None),
    (8.0, 1.0, 0.85, 0.5, 0.55808, None),
    (16.0, 1.0, 0.85, 1.0, 0.55721, None),
    (16.0, 1.0, 0.85, COS_30, 0.59365, None),
    (16.0, 1.0, 0.85, 0.5, 0.69740, None),
    (32.0, 1.0, 0.85, 1.0, 0.72780, None),
    (32.0, 1.0, 0.85, COS_30, 0.75023, None),
    (32.0, 1.0, 0.85, 0.5, 0.81402, None),
    (16.0, 0.99, 0.85, 1.0, 0.41772, Some(0.30610)),
];

/// Cosine of the solar zenith angle and plane albedo of a semi-infinite, isotropically scattering
/// medium with single-scattering albedo 0.99: `1 - sqrt(1 - w) H(mu0)` (Chandrasekhar 1950).
pub(super) const SEMI_INFINITE: [(f64, f64); 3] = [(0.1, 0.87751), (0.5, 0.81514), (1.0, 0.75272)];

/// Cosine of the view zenith angle; upward radiance at the top and downward radiance at the bottom
/// of DISORT's test problem of optical depth 8, asymmetry parameter 0.75 and a beam of flux pi from
/// the zenith. The values were computed by adding and doubling with 64 points
/// (`tests/fixtures/doubling.py`); 32 and 96 points give the same digits. The values published with
/// DISORT, from 16 streams, differ from these by up to 1.3e-3 (relative): upward 0.493302,
/// 0.519598, 0.379740, downward 0.669581, 0.422350, 0.236362.
pub(super) const RADIANCES: [(f64, f64, f64); 3] =
    [(1.0, 0.492696, 0.670016), (0.5, 0.519705, 0.422354), (0.1, 0.379975, 0.236388)];

/// Cosine and Chandrasekhar's H function for conservative isotropic scattering.
const H: [(f64, f64); 3] = [(0.1, 1.24735), (0.5, 2.01278), (1.0, 2.90781)];

pub(super) fn run(mut report: Report) -> Result<()> {
    for (depth, albedo, g, cosine, reflected, transmitted) in FLUXES {
        let case = format!("tau {depth}, w {albedo}, g {g}, mu0 {cosine:.4}: ");
        let least = transmitted.map_or(reflected, |transmitted| reflected.min(transmitted));
        let fluxes = report.fluxes(&slab(depth, albedo, g, cosine)?, least)?;
        let digits = if depth == 32.0 || albedo < 1.0 { FIFTH_DIGIT } else { 1e-6 };
        let reference = |value| Reference::new(value, digits);
        let mut checks = vec![(case.clone() + "reflected", fluxes.reflected, reference(reflected))];
        if let Some(transmitted) = transmitted {
            checks.push((case + "transmitted", fluxes.transmitted, reference(transmitted)));
        }
        report.compare(&checks);
    }
    for (cosine, reflected) in SEMI_INFINITE {
        // Less than exp(-0.17 150) of the light penetrates beyond an optical depth of 150.
        let fluxes = report.fluxes(&slab(150.0, 0.99, 0.0, cosine)?, reflected)?;
        let case = format!("semi-infinite, w 0.99, isotropic, mu0 {cosine}: reflected");
        report.compare(&[(case, fluxes.reflected, Reference::new(reflected, FIFTH_DIGIT))]);
    }
    radiances_of_a_layer(&mut report)?;
    radiances_of_a_half_space(&mut report)
}

fn radiances_of_a_layer(report: &mut Report) -> Result<()> {
    let layer = slab(8.0, 1.0, 0.75, 1.0)?;
    for (cosine, up, down) in RADIANCES {
        let away = towards(cosine.acos(), 0.4);
        let found = along(
            report,
            &layer,
            &[
                Ray { origin: DVec3::new(0.3, 0.3, 1.0), direction: -away },
                Ray { origin: DVec3::new(0.3, 0.3, 0.0), direction: away },
            ],
        )?;
        let case = |way| format!("tau 8, g 0.75, mu0 1: pi times radiance {way} at mu {cosine}");
        report.compare(&[
            (case("up"), times(PI, found[0]), Reference::new(up, 1e-6)),
            (case("down"), times(PI, found[1]), Reference::new(down, 1e-6)),
        ]);
    }
    Ok(())
}

/// Compares radiances with `I = mu0 / (mu + mu0) H(mu) H(mu0) / (4 pi)` (Chandrasekhar 1950) for a
/// half-space. A layer above a white surface has the same reflection, because deep inside a
/// conservative half-space the radiance is isotropic and the net flux is zero, as it is above a
/// white surface.
fn radiances_of_a_half_space(report: &mut Report) -> Result<()> {
    let (solar_cosine, solar_h) = H[1];
    let mut half_space = slab(20.0, 1.0, 0.0, solar_cosine)?;
    half_space.surface = Surface::lambertian(1.0);
    for (cosine, h) in H {
        let direction = -towards(cosine.acos(), 0.4);
        let origin = DVec3::new(0.3, 0.3, 1.0);
        let found = along(report, &half_space, &[Ray { origin, direction }])?;
        let expected = solar_cosine / (cosine + solar_cosine) * h * solar_h / (4.0 * PI);
        let case = format!("semi-infinite, w 1, isotropic, mu0 0.5: radiance up at mu {cosine}");
        let reference = Reference::new(expected, 1e-5 * expected);
        report.compare(&[(case, times(1.0, found[0]), reference)]);
    }
    Ok(())
}

fn slab(optical_depth: f64, albedo: f64, asymmetry: f64, solar_cosine: f64) -> Result<Scene> {
    let extinction = Volume::constant(unit_grid(1)?, optical_depth as f32);
    Ok(scene(extinction, albedo, asymmetry, solar_cosine)?.with_boundary(Boundary::Periodic))
}

/// Radiances along rays. The samples of a ray are divided into blocks, so that all threads are
/// used.
pub(super) fn along(report: &Report, scene: &Scene, rays: &[Ray]) -> Result<Vec<Radiance>> {
    let blocks = 64;
    let many: Vec<Ray> = rays.iter().flat_map(|ray| std::iter::repeat_n(*ray, blocks)).collect();
    let samples_per_pixel = report.effort.samples / blocks as u32;
    let settings =
        MonteCarloSettings { samples_per_pixel, seed: report.effort.seed, ..Default::default() };
    let found = radiances(scene, &many, &settings)?;
    let count = blocks as f64;
    let pooled = |block: &[Radiance]| Radiance {
        mean: block.iter().map(|part| part.mean).sum::<f64>() / count,
        standard_error: block.iter().map(|part| part.standard_error.powi(2)).sum::<f64>().sqrt()
            / count,
    };
    Ok(found.chunks(blocks).map(pooled).collect())
}

pub(super) fn times(factor: f64, radiance: Radiance) -> Share {
    let Radiance { mean, standard_error } = radiance;
    Share { mean: factor * mean, standard_error: factor * standard_error }
}
