//! Limits of the values of clouds. A value beyond them is almost always in another unit than its
//! file states, or it is the code of a missing value.

use crate::cloud::Microphysics;
use crate::error::{Error, Result};
use crate::grid::Grid;
use ndarray::Array3;
use std::path::Path;

/// Largest plausible extinction (km-1); that of the densest clouds is a few hundred.
pub(crate) const LARGEST_EXTINCTION: f32 = 1e4;
/// Largest plausible liquid water content (g/m3); that of the densest clouds is about 5.
const LARGEST_WATER: f32 = 20.0;
/// Smallest plausible maximum of the liquid water content of a cloud (g/m3), and that below which it is
/// told: five thousandths of a field in kg that is read in g.
const LEAST_WATER: f32 = 1e-3;
const LITTLE_WATER: f32 = 5e-3;
/// Range of plausible effective radii (um).
const RADII: [f32; 2] = [1.0, 60.0];
/// Droplets smaller than that are plausible in traces of water, up to this number per cm3.
const LARGEST_NUMBER: f64 = 1e4;
/// Range of plausible densities of air (kg/m3).
const DENSITIES: [f32; 2] = [0.1, 2.0];
/// Range of plausible sizes of voxels along x, y and z (km).
const SIZES: [f64; 2] = [5e-4, 20.0];
/// Range of plausible altitudes of a grid (km).
const ALTITUDES: [f64; 2] = [-12.0, 60.0];
/// Largest plausible effective variance.
const LARGEST_VARIANCE: f32 = 1.0;
/// Larger numbers are codes of missing values.
const CODE: f32 = 1e15;

/// The checks of the values of one file, and what has to be said about them.
pub(crate) struct Checks<'a> {
    path: &'a Path,
    /// Whether an implausible value is a warning instead of an error.
    allow: bool,
    warnings: Vec<String>,
    /// Where each quantity was found, and what was assumed.
    notes: Vec<String>,
}

impl<'a> Checks<'a> {
    pub(crate) fn new(path: &'a Path, allow: bool) -> Self {
        Self { path, allow, warnings: Vec::new(), notes: Vec::new() }
    }

    pub(crate) fn warn(&mut self, warning: impl Into<String>) {
        self.warnings.push(format!("{}: {}", self.path.display(), warning.into()));
    }

    pub(crate) fn note(&mut self, note: impl Into<String>) {
        self.notes.push(note.into());
    }

    pub(crate) fn into_warnings(self) -> Vec<String> {
        self.warnings
    }

    /// The notes and the warnings.
    pub(crate) fn into_notes_and_warnings(self) -> (Vec<String>, Vec<String>) {
        (self.notes, self.warnings)
    }

    /// Check the size of the voxels and the altitudes of a grid.
    ///
    /// # Errors
    /// As [`Checks::lengths`].
    pub(crate) fn grid(&mut self, grid: &Grid) -> Result<()> {
        self.lengths(grid.spacing.to_array(), [grid.lower().z, grid.upper().z])
    }

    /// Check sizes of cells along x, y, z and the lowest and highest altitude (km).
    ///
    /// # Errors
    /// Returns an error if one of them is implausible.
    pub(crate) fn lengths(&mut self, sizes: [f64; 3], altitudes: [f64; 2]) -> Result<()> {
        for (what, values, range) in
            [("has cells of", &sizes[..], SIZES), ("reaches an altitude of", &altitudes, ALTITUDES)]
        {
            let [low, high] = range;
            let plausible = |value: f64| (low..=high).contains(&value);
            let Some(&value) = values.iter().find(|value| !plausible(**value)) else { continue };
            let likely = match () {
                () if plausible(1e-3 * value) => "the numbers may be in m",
                () if plausible(1e3 * value) => "the numbers may be in km, but stated to be in m",
                () => "the unit may be wrong",
            };
            let problem = format!("{what} {value} km, which is not from {low} to {high} km");
            return self.refuse("grid", problem, likely.to_owned());
        }
        Ok(())
    }

    /// Check the extinction, or its uncertainty (km-1).
    ///
    /// # Errors
    /// Returns an error if a value is implausible.
    pub(crate) fn extinction(&mut self, name: &str, values: &Array3<f32>) -> Result<()> {
        match values.indexed_iter().find(|(_, value)| **value > LARGEST_EXTINCTION) {
            None => Ok(()),
            Some((voxel, &value)) => self.refuse(
                name,
                format!("is {value} km-1 at {}, more than {LARGEST_EXTINCTION}", text(voxel)),
                likely(value, &[(1e-3, "the numbers may be in Mm-1")], [1e-3, LARGEST_EXTINCTION]),
            ),
        }
    }

    /// Check liquid water contents and effective radii.
    ///
    /// # Errors
    /// Returns an error if a value is implausible.
    pub(crate) fn droplets(&mut self, droplets: &Microphysics) -> Result<()> {
        let Microphysics { liquid_water_content, effective_radius, effective_variance } = droplets;
        for (voxel, &water) in liquid_water_content.indexed_iter() {
            let radius = effective_radius[voxel];
            let at = || text(voxel);
            if water > LARGEST_WATER {
                return self.refuse(
                    "liquid water content",
                    format!("is {water} g m-3 at {}, more than {LARGEST_WATER}", at()),
                    likely(
                        water,
                        &[
                            (1e-3, "the numbers may be in g instead of kg, or in mg instead of g"),
                            (1e-6, "the numbers may be in mg instead of kg, or in ug instead of g"),
                        ],
                        [0.0, LARGEST_WATER],
                    ),
                );
            }
            let traces = || number(water, radius) <= LARGEST_NUMBER;
            if water > 0.0 && (radius > RADII[1] || (radius < RADII[0] && !traces())) {
                return self.refuse(
                    "effective radius",
                    format!("is {radius} um at {}, not from {} to {}", at(), RADII[0], RADII[1]),
                    likely(
                        radius,
                        &[
                            (1e6, "the numbers may be in m"),
                            (1e3, "the numbers may be in mm"),
                            (1e-3, "the numbers may be in nm"),
                        ],
                        RADII,
                    ),
                );
            }
            let variance = effective_variance[voxel];
            if water > 0.0 && variance > LARGEST_VARIANCE {
                return self.refuse(
                    "effective variance",
                    format!("is {variance} at {}, more than {LARGEST_VARIANCE}", at()),
                    "the column may hold another quantity".into(),
                );
            }
            let extinction = 1500.0 * water / radius;
            if water > 0.0 && extinction > LARGEST_EXTINCTION {
                return self.refuse(
                    "liquid water content and effective radius",
                    format!("are {water} g m-3 and {radius} um at {}: {extinction} km-1", at()),
                    "the unit of one of them may be wrong".into(),
                );
            }
        }
        Ok(())
    }

    /// Check that a field that contains liquid water (g/m3) has more than traces of it somewhere: the
    /// files of some models state g/kg, but contain kg/kg. `likely` is the reason otherwise.
    ///
    /// # Errors
    /// Returns an error if the largest value is implausibly small.
    pub(crate) fn traces(
        &mut self,
        name: &str,
        values: &Array3<f32>,
        likely: String,
    ) -> Result<()> {
        let most = values.iter().copied().fold(0.0, f32::max);
        if most == 0.0 || most >= LITTLE_WATER {
            return Ok(());
        }
        if most >= LEAST_WATER {
            self.warn(format!("{name} is at most {most} g m-3, little for a cloud; {likely}"));
            return Ok(());
        }
        let problem = format!("is at most {most} g m-3, too little for a cloud");
        self.refuse(name, problem, likely)
    }

    /// Check densities of air (kg/m3) of the variable or setting `name`.
    ///
    /// # Errors
    /// Returns an error if a value is implausible.
    pub(crate) fn air_density(&mut self, name: &str, values: &Array3<f32>) -> Result<()> {
        let plausible = |value: f32| (DENSITIES[0]..=DENSITIES[1]).contains(&value);
        match values.indexed_iter().find(|(_, value)| !plausible(**value)) {
            None => Ok(()),
            Some((voxel, &value)) => self.refuse(
                name,
                format!(
                    "is {value} kg m-3 at {}, but the density of air is from {} to {}",
                    text(voxel),
                    DENSITIES[0],
                    DENSITIES[1]
                ),
                likely(value, &[(1e-3, "the numbers may be in g m-3")], DENSITIES)
                    + ": give --air-density",
            ),
        }
    }

    fn refuse(&mut self, field: &str, problem: String, likely: String) -> Result<()> {
        if self.allow {
            self.warn(format!("{field}: {problem}; {likely}"));
            return Ok(());
        }
        let remedy = format!(
            "{likely}; correct the file, state its units with `cloud import --units`, or accept the \
             value with --allow-implausible of `cloud import` and `render`"
        );
        Err(Error::file(self.path, field, problem, remedy))
    }
}

/// The number of droplets (per cm3) of this radius (um) that contain this much water (g/m3).
fn number(water: f32, radius: f32) -> f64 {
    let radius = 1e-6 * f64::from(radius);
    f64::from(water) / (4.0 / 3.0 * std::f64::consts::PI * 1e6 * radius.powi(3)) * 1e-6
}

/// The likely reason why `value` is implausible: the first text whose factor makes it plausible.
fn likely(value: f32, reasons: &[(f32, &str)], [least, most]: [f32; 2]) -> String {
    if !value.is_finite() || value.abs() > CODE {
        return "it may represent a missing value".into();
    }
    let fits = |(factor, _): &&(f32, &str)| (least..=most).contains(&(value * factor));
    let reason = reasons.iter().find(fits);
    reason.map_or_else(|| "its unit may be wrong".into(), |(_, text)| (*text).to_owned())
}

fn text((k, j, i): (usize, usize, usize)) -> String {
    format!("voxel [z {k}, y {j}, x {i}]")
}
