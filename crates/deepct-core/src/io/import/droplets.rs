//! Effective radii and variances of the droplets of a simulation.

use super::les::Simulation;
use crate::cloud::{self, EFFECTIVE_VARIANCE};
use crate::error::{Error, Result};
use crate::io::netcdf::Variable;
use crate::io::units::Unit;
use ndarray::{Array3, Zip};

/// Customary names of the effective radius.
const RADIUS_NAMES: [&str; 11] = [
    "reff",
    "re",
    "rel",
    "effective_radius",
    "re_cloud",
    "r_eff",
    "effr",
    "reffc",
    "effc",
    "effcl",
    "cloud_effective_radius",
];
/// Customary names of the effective variance.
const VARIANCE_NAMES: [&str; 2] = ["veff", "effective_variance"];
/// Customary names of the droplet number concentration.
const NUMBER_NAMES: [&str; 6] = ["nc", "cdnc", "nd", "qnc", "qncloud", "ndrop"];

/// Liquid water contents below this (g/m3) in voxels without droplets are set to zero.
const TRACE: f32 = 1e-3;

impl Simulation<'_> {
    /// Effective radius (um), zero where there is no water, from the file: its effective radius, or
    /// otherwise its droplet number concentration. `None` if the file has neither, or if the
    /// settings specify the number. Traces of water without droplets are removed.
    pub(super) fn effective_radius(
        &mut self,
        content: &mut Array3<f32>,
    ) -> Result<Option<Array3<f32>>> {
        if self.settings.droplets_per_cm3.is_some() {
            return Ok(None);
        }
        let or_else = |error| match error {
            Error::File { path, field, problem, remedy } => {
                let remedy = format!("{remedy}; or give the number of droplets with --droplets");
                Error::File { path, field, problem, remedy }
            }
            other => other,
        };
        let radius = "effective_radius_of_cloud_liquid_water_particles";
        let number = "number_concentration_of_cloud_liquid_water_particles_in_air";
        let (variable, mut radii) = if let Some(variable) = self.find(radius, &RADIUS_NAMES) {
            let radii = self.on_field(&variable, "um", content.dim()).map_err(or_else)?;
            (variable, radii)
        } else if let Some(variable) = self.find(number, &NUMBER_NAMES) {
            let numbers = self.droplet_number(&variable, content.dim()).map_err(or_else)?;
            let radii = Zip::from(&numbers).and(&*content).map_collect(|&number, &water| {
                if number > 0.0 { cloud::effective_radius(water, f64::from(number)) } else { 0.0 }
            });
            self.checks.warn(format!(
                "effective radii are computed from the droplet number concentration {}; --droplets \
                 specifies another",
                variable.name
            ));
            (variable, radii)
        } else {
            return Ok(None);
        };
        self.checks.note(format!("effective radii: {}", variable.name));
        let mut traces = 0;
        for (voxel, radius) in radii.indexed_iter_mut() {
            let water = &mut content[voxel];
            if *water > 0.0 && !(radius.is_finite() && *radius > 0.0) {
                if *water >= TRACE {
                    let (k, j, i) = voxel;
                    return Err(or_else(variable.error(
                        format!(
                            "gives an effective radius of {radius} um at [z {k}, y {j}, x {i}], where \
                             there is {water} g/m3 of water"
                        ),
                        "it must be positive where there is water",
                    )));
                }
                traces += 1;
                *water = 0.0;
            }
            if *water == 0.0 {
                *radius = 0.0;
            }
        }
        if traces > 0 {
            self.checks.warn(format!(
                "{traces} voxels with less than {TRACE} g/m3 of water have no droplets according to \
                 {}; their water is removed",
                variable.name
            ));
        }
        Ok(Some(radii))
    }

    /// Droplet number concentration (per cm3) of a variable per volume or per mass of air.
    fn droplet_number(
        &mut self,
        variable: &Variable,
        shape: (usize, usize, usize),
    ) -> Result<Array3<f32>> {
        let unit = variable.unit_text().as_deref().and_then(Unit::parse);
        let per_mass = Unit::parse("kg-1").expect("a unit");
        if unit.is_none_or(|unit| unit.factor_to(&per_mass).is_none()) {
            return self.on_field(variable, "cm-3", shape);
        }
        let density = self.air_density(variable)?;
        let density = density.broadcast(shape).expect("read on the same axes");
        Ok(self.on_field(variable, "kg-1", shape)? * density * 1e-6)
    }

    /// Effective variance of the file, or the default one.
    pub(super) fn effective_variance(&self, content: &Array3<f32>) -> Result<Array3<f32>> {
        let Some(variable) = self.find("", &VARIANCE_NAMES) else {
            return Ok(Array3::from_elem(content.raw_dim(), EFFECTIVE_VARIANCE));
        };
        let mut variance = self.on_field(&variable, "1", content.dim())?;
        for (voxel, variance) in variance.indexed_iter_mut() {
            let water = content[voxel];
            if water > 0.0 && !(variance.is_finite() && *variance >= 0.0) {
                let (k, j, i) = voxel;
                return Err(variable.error(
                    format!("is {variance} at [z {k}, y {j}, x {i}], where there is water"),
                    "it must be finite and not negative where there is water",
                ));
            }
            *variance = if water > 0.0 { *variance } else { 0.0 };
        }
        Ok(variance)
    }
}
