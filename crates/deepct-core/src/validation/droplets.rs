//! Droplet optics: the layer of cloud C.1 of DISORT's tests, and a table of another code.

use super::slabs::{along, times};
use super::{Reference, Report, unit_grid};
use crate::error::Result;
use crate::grid::Volume;
use crate::math::{DVec3, Ray, towards};
use crate::optics::{DropletSettings, DropletTable, Medium};
use crate::scene::{Boundary, Scene, Sun, Surface};
use num_complex::Complex64;
use std::f64::consts::PI;
use std::path::Path;

/// Reflectance and transmittance of a layer of optical depth 64 without absorption for a Sun in the
/// zenith: DISORT's test after Garcia and Siewert (1985).
const LAYER: [f64; 2] = [0.84726, 0.15274];
/// Cosine of the view zenith angle and upward radiance at the top for a beam of flux pi.
const RADIANCES: [(f64, f64); 3] = [(1.0, 1.07196), (0.5, 0.772983), (0.1, 0.458927)];

pub(super) fn run(mut report: Report, reference: Option<&Path>) -> Result<()> {
    layer(&mut report)?;
    #[cfg(feature = "files")]
    if let Some(folder) = reference {
        table(&mut report, folder)?;
    }
    #[cfg(not(feature = "files"))]
    let _ = reference;
    Ok(())
}

/// A layer of Deirmendjian's (1969) cloud C.1, with n(r) proportional to r^6 exp(-1.5 r), which is
/// the gamma distribution of effective radius 6 um and effective variance 1/9. The wavelength is
/// 0.7 um and the refractive index 1.33.
fn layer(report: &mut Report) -> Result<()> {
    let settings = DropletSettings {
        refractive_index: Some(Complex64::new(1.33, 0.0)),
        effective_variance: 1.0 / 9.0,
        ..DropletSettings::water(0.7)
    };
    let table = DropletTable::mie(&settings, &[6.0])?;
    let phase_function = table.nodes()[0].phase_function.clone();
    let medium = Medium::new(Volume::constant(unit_grid(1)?, 64.0), 1.0, phase_function)?;
    let scene = Scene::new(medium, Sun::from_degrees(0.0, 90.0)?, Surface::BLACK)?
        .with_boundary(Boundary::Periodic);
    let fluxes = report.fluxes(&scene, LAYER[1])?;
    let case = |what: &str| format!("cloud C.1, tau 64, mu0 1: {what}");
    report.compare(&[
        (case("reflected"), fluxes.reflected, Reference::new(LAYER[0], 0.5e-5)),
        (case("transmitted"), fluxes.transmitted, Reference::new(LAYER[1], 0.5e-5)),
    ]);
    for (cosine, radiance) in RADIANCES {
        let direction = -towards(f64::acos(cosine), 0.4);
        let origin = DVec3::new(0.3, 0.3, 1.0);
        let found = along(report, &scene, &[Ray { origin, direction }])?;
        let case = case(&format!("pi times radiance up at mu {cosine}"));
        report.compare(&[(case, times(PI, found[0]), Reference::new(radiance, 1e-6))]);
    }
    Ok(())
}

/// Compares extinction, asymmetry parameter and single-scattering albedo with tables of AT3D.
#[cfg(feature = "files")]
fn table(report: &mut Report, folder: &Path) -> Result<()> {
    use crate::transport::Share;
    /// Required accuracy: relative for the extinction, absolute for the asymmetry parameter.
    const ACCURACY: f64 = 1e-3;
    let expected = crate::io::read_reference_droplets(&folder.join("mie_water_672nm.nc"))?;
    let radii: Vec<f64> = expected.iter().map(|row| row.effective_radius).collect();
    let table = DropletTable::mie(&DropletSettings::water(0.672), &radii)?;
    let exact = |mean| Share { mean, standard_error: 0.0 };
    for (found, expected) in table.nodes().iter().zip(&expected) {
        let within = |value: f64, systematic| Reference { value, standard_error: 0.0, systematic };
        let case = |what: &str| format!("droplets of {} um: {what}", expected.effective_radius);
        let extinction = expected.extinction_per_water;
        report.compare(&[
            (
                case("extinction per liquid water content"),
                exact(found.extinction_per_water),
                within(extinction, ACCURACY * extinction),
            ),
            (
                case("asymmetry"),
                exact(found.phase_function.asymmetry()),
                within(expected.asymmetry, ACCURACY),
            ),
            (
                case("single-scattering albedo"),
                exact(found.single_scattering_albedo),
                within(expected.single_scattering_albedo, 1e-5),
            ),
        ]);
    }
    Ok(())
}
