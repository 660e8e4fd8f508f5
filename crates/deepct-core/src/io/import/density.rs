//! The density of air, which converts a mixing ratio to liquid water content: from the settings, from a
//! variable of the file, from pressure and temperature, or that of the standard atmosphere.

use super::AirDensity;
use super::axes::{Kind, coordinate, leaf};
use super::les::Simulation;
use super::water::{description, is_density};
use crate::error::Result;
use crate::io::netcdf::{Input, Variable, coordinates};
use crate::io::units::Unit;
use ndarray::{Array3, Zip};
use std::ops::RangeInclusive;
use std::path::Path;

/// Customary names of the density of air, the first of which takes precedence.
const DENSITY_NAMES: [&str; 7] = ["rho", "density", "rhoref", "rhobf", "rho0", "dn0", "rho_ref"];
/// Words in the description of a density that is not that of air.
const OTHER_DENSITIES: [&str; 9] =
    ["water", "liquid", "ice", "rain", "snow", "droplet", "aerosol", "potential", "cloud"];
/// Customary name of the specific volume of air, which WRF writes.
const VOLUME_NAME: &str = "alt";

/// Specific gas constants of dry air and of water vapour (J kg-1 K-1), specific heat of dry air
/// (J kg-1 K-1) and reference pressure (Pa), as in CM1.
const DRY_AIR: f32 = 287.04;
const VAPOUR: f32 = 461.5;
const HEAT: f32 = 1005.7;
const REFERENCE: f32 = 1e5;

/// A quantity of the state of the air.
struct Quantity {
    names: &'static [&'static str],
    standard: &'static [&'static str],
    unit: &'static str,
    plausible: RangeInclusive<f32>,
}

const PRESSURE: Quantity = Quantity {
    names: &["p", "prs", "pres", "pressure", "air_pressure", "pp"],
    standard: &["air_pressure"],
    unit: "Pa",
    plausible: 5e3..=1.2e5,
};
const TEMPERATURE: Quantity = Quantity {
    names: &["t", "ta", "tabs", "temp", "temperature", "tk", "air_temperature"],
    standard: &["air_temperature"],
    unit: "K",
    plausible: 150.0..=350.0,
};
const POTENTIAL: Quantity = Quantity {
    names: &["th", "theta", "potential_temperature", "pt"],
    standard: &["air_potential_temperature"],
    unit: "K",
    plausible: 200.0..=800.0,
};
const HUMIDITY: Quantity = Quantity {
    names: &["qv", "qvapor", "hus", "rv"],
    standard: &["humidity_mixing_ratio", "specific_humidity"],
    unit: "1",
    plausible: -1e-4..=0.1,
};

impl<'a> Simulation<'a> {
    /// The density of air (kg/m3), in a shape that can be broadcast to a field `[z, y, x]`, by which
    /// a quantity per mass of air is multiplied.
    pub(super) fn air_density(&mut self, quantity: &Variable) -> Result<Array3<f32>> {
        if self.air_density.is_none() {
            self.air_density = Some(self.find_air_density(quantity)?);
        }
        Ok(self.air_density.clone().expect("it was found"))
    }

    fn find_air_density(&mut self, quantity: &Variable) -> Result<Array3<f32>> {
        match &self.settings.air_density {
            Some(AirDensity::Constant(density)) => {
                let density = Array3::from_elem((1, 1, 1), *density as f32);
                self.checks.air_density("--air-density", &density)?;
                self.checks.note("density of air: --air-density");
                return Ok(density);
            }
            Some(AirDensity::Profile { file, variable }) => return self.of_file(file, variable),
            None => {}
        }
        let mut reasons = String::new();
        for density in self.densities() {
            let standard = density.text("standard_name").filter(|name| !name.is_empty());
            let described = description(&density).to_lowercase();
            let unit = density.unit_text();
            let reason = if standard.is_some_and(|name| name != "air_density") {
                "its standard_name is another".to_owned()
            } else if OTHER_DENSITIES.iter().any(|word| described.contains(word)) {
                format!("its long_name is \"{described}\"")
            } else if !unit.as_deref().and_then(Unit::parse).as_ref().is_some_and(is_density) {
                let unit = unit.map_or("missing".into(), |unit| format!("\"{unit}\""));
                let problem = format!(
                    "is per mass of air, and {} may be the density of air, but its unit is {unit}",
                    density.name
                );
                let remedy = format!(
                    "state it with --units {}=\"kg m-3\", or give another density with --air-density",
                    density.name
                );
                return Err(quantity.error(problem, &remedy));
            } else {
                let values = self.profile_or_field(&density, "kg m-3")?;
                self.checks.air_density(&density.name, &values)?;
                self.checks.note(format!("density of air: {}", density.name));
                return Ok(values);
            };
            reasons += &format!("; {} is not taken for it, because {reason}", density.name);
        }
        if let Some(density) = self.of_specific_volume()? {
            return Ok(density);
        }
        if let Some(density) = self.of_state(quantity)? {
            self.checks.air_density("density from pressure and temperature", &density)?;
            return Ok(density);
        }
        let levels = &self.altitudes;
        let density = Array3::from_shape_fn((levels.len(), 1, 1), |(k, ..)| standard(levels[k]));
        self.checks.air_density("standard atmosphere", &density)?;
        let ends = [0, levels.len() - 1].map(|k| density[[k, 0, 0]]);
        self.checks.warn(format!(
            "{} is per mass of air, and the file has no density of air{reasons}; that of the standard \
             atmosphere is used, {:.3} to {:.3} kg/m3 from the lowest to the highest level read \
             (--air-density gives another, as a number or as FILE:VARIABLE)",
            quantity.name, ends[0], ends[1]
        ));
        self.checks.note("density of air: assumed, standard atmosphere");
        Ok(density)
    }

    /// The variables that may be the density of air.
    fn densities(&self) -> Vec<Variable<'a>> {
        let mut found: Vec<_> = self
            .variables()
            .filter_map(|variable| {
                let name = leaf(&variable.name).to_lowercase();
                let customary = DENSITY_NAMES.iter().position(|known| *known == name);
                match (variable.text("standard_name").as_deref(), customary) {
                    (Some("air_density"), _) => Some((0, variable)),
                    (_, Some(rank)) => Some((1 + rank, variable)),
                    _ => None,
                }
            })
            .collect();
        found.sort_by_key(|(rank, _)| *rank);
        found.into_iter().map(|(_, variable)| variable).collect()
    }

    /// The inverse of the specific volume of the air.
    fn of_specific_volume(&mut self) -> Result<Option<Array3<f32>>> {
        let volume = self.variables().find(|variable| {
            let unit = variable.unit_text().as_deref().and_then(Unit::parse);
            leaf(&variable.name).to_lowercase() == VOLUME_NAME
                && unit.is_some_and(|unit| Unit::parse("m3 kg-1").as_ref() == Some(&unit))
        });
        let Some(volume) = volume else { return Ok(None) };
        let density = self.profile_or_field(&volume, "m3 kg-1")?.mapv(f32::recip);
        self.checks.air_density(&volume.name, &density)?;
        self.checks.note(format!("density of air: 1 / {}", volume.name));
        Ok(Some(density))
    }

    /// The density from pressure, temperature and humidity, if the file has the first two: that of dry
    /// air for a quantity per mass of dry air, and of all air for a specific content and in files of SAM.
    fn of_state(&mut self, quantity: &Variable) -> Result<Option<Array3<f32>>> {
        let Some((pressure_name, pressure)) = self.quantity(&PRESSURE, "PB", 0.0)? else {
            return Ok(None);
        };
        let (temperature_name, temperature) = match self.quantity(&TEMPERATURE, "", 0.0)? {
            Some(found) => found,
            None => {
                // WRF writes the potential temperature minus 300 K.
                let offset = if self.input.has("PB") { 300.0 } else { 0.0 };
                let found = match self.quantity(&POTENTIAL, "", 0.0)? {
                    None if offset > 0.0 => {
                        let names = Quantity { names: &["t"], ..POTENTIAL };
                        self.quantity(&names, "", offset)?
                    }
                    found => found,
                };
                let Some((name, potential)) = found else { return Ok(None) };
                let exner = pressure.mapv(|p| (p / REFERENCE).powf(DRY_AIR / HEAT));
                (name, potential * exner)
            }
        };
        let humidity = self.quantity(&HUMIDITY, "", 0.0)?;
        let described = description(quantity).to_lowercase();
        let standard = quantity.text("standard_name").unwrap_or_default();
        // SAM, whose name of the temperature this is, computes water paths with the density of all air.
        let of_sam = leaf(&temperature_name).eq_ignore_ascii_case("tabs");
        let of_all_air =
            of_sam || described.contains("specific") || standard.starts_with("mass_fraction");
        let mut density = pressure / (temperature * DRY_AIR);
        let mut names = format!("{pressure_name}, {temperature_name}");
        if let Some((name, humidity)) = humidity {
            let ratio = VAPOUR / DRY_AIR;
            let share = if of_all_air { ratio - 1.0 } else { ratio };
            Zip::from(&mut density)
                .and(&humidity)
                .for_each(|density, humidity| *density /= 1.0 + share * humidity);
            names += &format!(", {name}");
        }
        let air = if of_all_air { "all air" } else { "dry air" };
        self.checks.note(format!("density of air: from {names} ({air})"));
        Ok(Some(density))
    }

    /// A quantity of the state of the air on all voxels, plus that of the variable `base` and an
    /// `offset`; `None` if the file does not have it, or if its values are those of another.
    fn quantity(
        &self,
        quantity: &Quantity,
        base: &str,
        offset: f32,
    ) -> Result<Option<(String, Array3<f32>)>> {
        let unit = Unit::parse(quantity.unit).expect("a unit");
        let has_unit = |variable: &Variable| {
            let own = variable.unit_text().as_deref().and_then(Unit::parse);
            own.is_some_and(|own| own.factor_to(&unit).is_some())
        };
        let standard = |variable: &Variable| {
            let name = variable.text("standard_name");
            name.is_some_and(|name| quantity.standard.contains(&name.as_str()))
        };
        let customary = |variable: &Variable| {
            quantity.names.contains(&leaf(&variable.name).to_lowercase().as_str())
        };
        let rank = |variable: &Variable| (!standard(variable), variable.name.clone());
        let mut found: Vec<_> = self
            .variables()
            .filter(|variable| has_unit(variable) && (standard(variable) || customary(variable)))
            .collect();
        found.sort_by_key(rank);
        let shape = self.shape();
        for variable in found {
            // A variable on other axes is not the one.
            let Ok(values) = self.profile_or_field(&variable, quantity.unit) else { continue };
            let Some(values) = values.broadcast(shape) else { continue };
            let mut values = values.to_owned() + offset;
            let mut name = variable.name.clone();
            if !base.is_empty() && self.input.has(base) {
                let variable = self.input.variable(base)?;
                values = values + self.on_field(&variable, quantity.unit, shape)?;
                name = format!("{name} + {base}");
            }
            if values.iter().all(|value| quantity.plausible.contains(value)) {
                return Ok(Some((name, values)));
            }
        }
        Ok(None)
    }

    /// The number of levels, rows and columns that are read.
    fn shape(&self) -> (usize, usize, usize) {
        let count =
            |pieces: &[std::ops::Range<usize>]| pieces.iter().map(|piece| piece.len()).sum();
        (self.window.levels.len(), count(&self.window.rows), count(&self.window.cols))
    }

    /// The values of a variable on some of the axes of the liquid water, or of a profile on another
    /// vertical axis, interpolated to the centres of the levels.
    fn profile_or_field(&self, variable: &Variable, unit: &str) -> Result<Array3<f32>> {
        match self.layout.of_other(variable, "give --air-density (kg/m3)") {
            Ok(layout) => layout.read(variable, &self.window, variable.factor_to(unit)?, f32::NAN),
            Err(problem) => {
                let profile = Profile::of(self.input, variable, unit).map_err(|_| problem)?;
                profile.at(variable, &self.altitudes)
            }
        }
    }

    /// The density of a profile in another file.
    fn of_file(&mut self, file: &Path, name: &str) -> Result<Array3<f32>> {
        let input = Input::open(file)?;
        let variable = input.variable(name)?;
        let profile = Profile::of(&input, &variable, "kg m-3")?;
        let values = profile.at(&variable, &self.altitudes)?;
        self.checks.air_density(&format!("{}:{name}", file.display()), &values)?;
        self.checks.note(format!("density of air: {}:{name}", file.display()));
        Ok(values)
    }
}

/// A quantity by altitude.
struct Profile {
    /// Ascending altitudes (km).
    altitudes: Vec<f64>,
    values: Vec<f64>,
}

impl Profile {
    /// The profile in a variable on a vertical axis and, optionally, on times at which it is the same.
    fn of(input: &Input, variable: &Variable, unit: &str) -> Result<Self> {
        let levels = |axis: usize| -> Option<Vec<f64>> {
            let axis = coordinate(input, variable.dimension(axis)?, Kind::Z)?;
            let factor = axis.factor_to("km").ok()?;
            Some(coordinates(&axis).ok()?.into_iter().map(|value| factor * value).collect())
        };
        let long = (0..variable.shape.len()).filter(|axis| variable.shape[*axis] > 1);
        let is_profile = |axis: &usize| levels(*axis).is_some();
        let vertical: Vec<_> = long.clone().filter(is_profile).collect();
        let ([axis], true) = (&vertical[..], long.count() <= 2) else {
            return Err(variable.error(
                format!("has shape {:?} and is not a profile on altitudes", variable.shape),
                "give a variable on one vertical axis whose coordinate has a unit of length",
            ));
        };
        let mut altitudes = levels(*axis).unwrap_or_default();
        let values = variable.reals_in::<f64>(unit)?;
        let mut times = values.lanes(ndarray::Axis(*axis)).into_iter();
        let mut values = times.next().map(|lane| lane.to_vec()).unwrap_or_default();
        let changes = |lane: ndarray::ArrayView1<f64>| {
            lane.iter().zip(&values).any(|(a, b)| (a - b).abs() > 1e-3 * b.abs())
        };
        if times.any(changes) {
            let problem = "differs between its times";
            return Err(variable.error(problem, "give a file with one of them"));
        }
        if altitudes.first() > altitudes.last() {
            altitudes.reverse();
            values.reverse();
        }
        if altitudes.len() != values.len() || !altitudes.is_sorted_by(|a, b| a < b) {
            let problem = "is on altitudes that do not ascend";
            return Err(variable.error(problem, "write the altitudes in order"));
        }
        Ok(Self { altitudes, values })
    }

    /// The values at the altitudes (km), linear in between, as `[z, 1, 1]`.
    fn at(&self, variable: &Variable, altitudes: &[f64]) -> Result<Array3<f32>> {
        let last = self.altitudes.len() - 1;
        let step = (self.altitudes[last] - self.altitudes[0]) / last.max(1) as f64;
        let (low, high) = (self.altitudes[0] - step, self.altitudes[last] + step);
        if let Some(beyond) = altitudes.iter().find(|z| !(low..=high).contains(*z)) {
            let problem = format!(
                "reaches from {} to {} km, but the cloud is needed at {beyond} km",
                self.altitudes[0], self.altitudes[last]
            );
            return Err(variable.error(problem, "give the profile of the whole simulation"));
        }
        let value = |z: f64| {
            let above = self.altitudes.partition_point(|known| *known <= z).clamp(1, last);
            let (a, b) = (self.altitudes[above - 1], self.altitudes[above]);
            let share = ((z - a) / (b - a)).clamp(0.0, 1.0);
            ((1.0 - share) * self.values[above - 1] + share * self.values[above]) as f32
        };
        Ok(Array3::from_shape_fn((altitudes.len(), 1, 1), |(k, ..)| value(altitudes[k])))
    }
}

/// The density (kg/m3) of the US Standard Atmosphere, 1976, at an altitude (km) of up to 20 km.
fn standard(altitude: f64) -> f32 {
    /// Radius of the Earth (km) by which altitudes become geopotential altitudes.
    const EARTH: f64 = 6356.766;
    let altitude = EARTH * altitude / (EARTH + altitude);
    let troposphere = |z: f64| {
        let temperature = 288.15 - 6.5 * z;
        (1.225 * (temperature / 288.15).powf(4.255_88), temperature)
    };
    let (density, temperature) = troposphere(altitude.min(11.0));
    let above = (altitude - 11.0).max(0.0);
    // Above 11 km, the temperature is constant, and the scale height is R T / g.
    (density * (-above * 9.806_65 / (0.287_053 * temperature)).exp()) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values of the tables of the US Standard Atmosphere, 1976.
    #[test]
    fn the_standard_atmosphere_has_the_densities_of_its_table() {
        for (altitude, density) in [(0.0, 1.225), (2.0, 1.0066), (5.0, 0.73643), (15.0, 0.19476)] {
            let found = standard(altitude);
            assert!((found - density).abs() < 1e-3 * density, "{altitude} km: {found}");
        }
    }
}
