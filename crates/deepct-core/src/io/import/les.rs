//! Import of large-eddy simulations in netCDF-4. Names, units and axes are identified by CF
//! conventions, or by the customary names of common codes if a file does not follow them.

use super::axes::{Kind, Layout, Window, levels_within, pieces};
use super::water::{find_bins, find_water, is_density};
use super::{Crop, DROPLETS_PER_CM3, ImportSettings, edges_of, grid_over};
use crate::cloud::resample::resample_droplets;
use crate::cloud::{self, Cloud, EFFECTIVE_VARIANCE, Microphysics, Spectrum, doubling_radii};
use crate::error::{Error, Result};
use crate::grid::resample::{resample, uniform_edges};
use crate::io::netcdf::{Input, Variable, edge_and_spacing, kilometres};
use crate::io::plausible::Checks;
use crate::io::units::Unit;
use ndarray::{Array3, Zip};
use std::path::Path;

/// Customary names of the density of air, the first of which takes precedence.
const DENSITY_NAMES: [&str; 7] = ["rho", "density", "rhoref", "rhobf", "rho0", "dn0", "rho_ref"];
/// Words in the description of a density that is not that of air.
const OTHER_DENSITIES: [&str; 9] =
    ["water", "liquid", "ice", "rain", "snow", "droplet", "aerosol", "potential", "cloud"];
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

/// The radius of the first bin (um).
const FIRST_BIN: f64 = 2.0;

/// Negative liquid water contents of up to this magnitude (g/m3) result from advection and packing
/// and are set to zero.
const UNDERSHOOT: f32 = 1e-3;
/// Liquid water contents below this (g/m3) in voxels without droplets are set to zero.
const TRACE: f32 = 1e-3;

/// Represents liquid water that the file declares as missing.
const MISSING: f32 = f32::MIN;

/// The part of a simulation that is read.
struct Simulation<'a> {
    input: &'a Input,
    settings: &'a ImportSettings,
    layout: Layout,
    window: Window,
    checks: Checks<'a>,
}

/// Read one time of a simulation. Only the required part of the file is read. Returns the cloud
/// and warnings about it.
///
/// Liquid water is identified by its CF `standard_name`, by a customary name or by its
/// `long_name`, and its values are converted from the units of the file. A mixing ratio requires
/// the density of air, from the file or the settings. Effective radii are read from the file or
/// derived from the droplet number concentration of the file or the settings. If the file contains
/// a binned droplet spectrum, with the water of each bin in a separate variable, liquid water
/// content and effective radius are derived from it.
///
/// # Errors
/// Returns an error if the file is missing or damaged; if there is no liquid water or its units
/// are missing or not understood; if the axes cannot be identified; if the time or crop is outside
/// the file; if liquid water is negative, or missing inside of cloud; or if values are far beyond
/// those of clouds.
pub fn read_les(path: impl AsRef<Path>, settings: &ImportSettings) -> Result<(Cloud, Vec<String>)> {
    let path = path.as_ref();
    let input = Input::open(path)?.with_units(&settings.units)?;
    let mut checks = Checks::new(path, settings.allow_implausible);
    let bins = find_bins(&input, settings);
    let water = match bins.first() {
        Some(name) => input.variable(name)?,
        None => find_water(&input, settings, &mut checks)?,
    };
    let layout = Layout::of(&input, &water)?;
    let axis = |kind| input.variable(layout.name(kind));
    let (x, y, z) = (axis(Kind::X)?, axis(Kind::Y)?, axis(Kind::Z)?);
    let crop = Crop::of(settings, path, [y.shape[0], x.shape[0]])?;
    let ((x_edge, dx), (y_edge, dy)) = (edge_and_spacing(&x)?, edge_and_spacing(&y)?);
    let z_edges = edges_of(&kilometres(&z)?, path, &z.name)?;
    let x_edges = uniform_edges(x_edge + dx * crop.x0 as f64, dx, crop.nx);
    let y_edges = uniform_edges(y_edge + dy * crop.y0 as f64, dy, crop.ny);
    let grid = grid_over([&z_edges, &y_edges, &x_edges], settings, path)?;
    let height = z_edges[z_edges.len() - 1] - z_edges[0];
    let level = height / (z_edges.len() - 1) as f64;
    checks.lengths([dx, dy, level], [z_edges[0], z_edges[z_edges.len() - 1]])?;
    checks.grid(&grid)?;
    let window = Window {
        time: layout.check_time(&water, settings.time)?,
        levels: levels_within(&z_edges, &grid),
        rows: pieces(crop.y0, crop.ny, y.shape[0]),
        cols: pieces(crop.x0, crop.nx, x.shape[0]),
    };
    let z_edges = &z_edges[window.levels.start..=window.levels.end];
    let edges = [z_edges, y_edges.as_slice(), x_edges.as_slice()];
    let mut simulation = Simulation { input: &input, settings, layout, window, checks };
    let droplets = if bins.is_empty() {
        let mut content = simulation.concentration(&water)?;
        simulation.checks.traces(&water.name, &content)?;
        let Some(effective_radius) = simulation.effective_radius(&mut content)? else {
            let content = resample(&content, edges, &grid)?;
            let number = settings.droplets_per_cm3.unwrap_or(DROPLETS_PER_CM3);
            let droplets = Microphysics::from_droplet_number(content, number)?;
            simulation.checks.droplets(&droplets)?;
            let cloud = Cloud::from_microphysics(grid, droplets)?;
            return Ok((cloud, simulation.checks.into_warnings()));
        };
        let effective_variance = simulation.effective_variance(&content)?;
        Microphysics { liquid_water_content: content, effective_radius, effective_variance }
    } else {
        simulation.spectrum(&bins)?.microphysics()
    };
    simulation.checks.droplets(&droplets)?;
    let cloud = resample_droplets(&droplets, edges, &grid)?;
    Ok((cloud, simulation.checks.into_warnings()))
}

impl<'a> Simulation<'a> {
    /// The droplet spectrum in the window, from all bins.
    fn spectrum(&mut self, bins: &[String]) -> Result<Spectrum> {
        let mut spectrum: Option<Spectrum> = None;
        for (name, radius) in bins.iter().zip(doubling_radii(FIRST_BIN, bins.len())) {
            let content = self.concentration(&self.input.variable(name)?)?;
            spectrum
                .get_or_insert_with(|| Spectrum::empty(content.dim().into()))
                .add_water(radius, &content)?;
        }
        Ok(spectrum.unwrap_or_else(|| Spectrum::empty([0; 3])))
    }

    /// Liquid water content (g/m3) in the window, converted from the units of the file.
    fn concentration(&mut self, water: &Variable) -> Result<Array3<f32>> {
        let unit = water.unit_text().as_deref().and_then(Unit::parse);
        let ratio = unit.as_ref().is_some_and(Unit::is_mass_ratio);
        let (factor, density) = if ratio {
            let kilograms = water.factor_to("1")?;
            (1e3 * kilograms, Some(self.air_density(&water.name)?))
        } else {
            let factor = water.factor_to("g m-3").map_err(|_| {
                let expected = "a unit such as g m-3, kg m-3, kg kg-1 or g kg-1";
                water.wrong_unit(expected, "kg kg-1")
            });
            (factor?, None)
        };
        let layout = self.layout.of_other(water, "give it on the same axes")?;
        let mut values = layout.read(water, &self.window, factor, MISSING)?;
        if let Some(density) = density {
            let density = density.broadcast(values.raw_dim()).expect("read on the same axes");
            Zip::from(&mut values).and(density).for_each(|value, density| {
                *value = if *value == MISSING { MISSING } else { *value * density };
            });
        }
        for ((k, j, i), value) in values.indexed_iter_mut() {
            if *value == MISSING || (value.is_finite() && *value >= -UNDERSHOOT) {
                *value = if *value == MISSING { MISSING } else { value.max(0.0) };
                continue;
            }
            return Err(water.error(
                format!("is {value} g/m3 in the part that was read, at [z {k}, y {j}, x {i}]"),
                "liquid water must be finite, within the valid range of the file and not negative: \
                 choose another part of the file",
            ));
        }
        self.fill(water, &mut values)?;
        Ok(values)
    }

    /// Replace missing liquid water outside of cloud by zero.
    ///
    /// # Errors
    /// Returns an error if missing values are enclosed by liquid water.
    fn fill(&mut self, water: &Variable, values: &mut Array3<f32>) -> Result<()> {
        let shape = values.dim();
        let missing: Vec<_> = values
            .indexed_iter()
            .filter(|(_, value)| **value == MISSING)
            .map(|(voxel, _)| voxel)
            .collect();
        // From each missing voxel, walk through the missing ones that touch it. Those that were
        // reached are infinite until the end.
        for &first in &missing {
            if values[first] != MISSING {
                continue;
            }
            values[first] = f32::INFINITY;
            let (mut walk, mut outside) = (vec![first], false);
            while let Some(voxel) = walk.pop() {
                for neighbour in neighbours(voxel) {
                    let value = neighbour.and_then(|voxel| values.get_mut(voxel));
                    match (neighbour, value) {
                        (Some(neighbour), Some(value)) if *value == MISSING => {
                            *value = f32::INFINITY;
                            walk.push(neighbour);
                        }
                        (_, value) => outside |= value.is_none_or(|value| *value == 0.0),
                    }
                }
            }
            if !outside {
                let (k, j, i) = first;
                return Err(water.error(
                    format!("is missing at [z {k}, y {j}, x {i}], which is inside of cloud"),
                    "choose another part of the file, or fill the missing values",
                ));
            }
        }
        values.mapv_inplace(|value| if value.is_finite() { value } else { 0.0 });
        if !missing.is_empty() {
            let (count, all) = (missing.len(), shape.0 * shape.1 * shape.2);
            self.checks.warn(format!(
                "{} is missing in {count} of {all} voxels, which are read as free of cloud",
                water.name
            ));
        }
        Ok(())
    }

    /// The density of air (kg/m3), in a shape that can be broadcast to a field `[z, y, x]`.
    fn air_density(&mut self, water: &str) -> Result<Array3<f32>> {
        if let Some(density) = self.settings.air_density {
            let density = Array3::from_elem((1, 1, 1), density as f32);
            self.checks.air_density("--air-density", &density)?;
            return Ok(density);
        }
        let standard =
            |variable: &Variable| variable.text("standard_name").filter(|name| !name.is_empty());
        let mut found: Vec<_> = self
            .variables()
            .filter_map(|variable| {
                let customary =
                    DENSITY_NAMES.iter().position(|name| *name == variable.name.to_lowercase());
                match (standard(&variable).as_deref(), customary) {
                    (Some("air_density"), _) => Some((0, variable)),
                    (_, Some(rank)) => Some((1 + rank, variable)),
                    _ => None,
                }
            })
            .collect();
        found.sort_by_key(|(rank, _)| *rank);
        let mut reasons = String::new();
        for (_, density) in found {
            let described = density.text("long_name").unwrap_or_default().to_lowercase();
            let unit = density.unit_text();
            let reason = if standard(&density).is_some_and(|name| name != "air_density") {
                "its standard_name is another".to_owned()
            } else if OTHER_DENSITIES.iter().any(|word| described.contains(word)) {
                format!("its long_name is \"{described}\"")
            } else if !unit.as_deref().and_then(Unit::parse).as_ref().is_some_and(is_density) {
                let unit = unit.map_or("missing".into(), |unit| format!("\"{unit}\""));
                format!("its unit is {unit} (--units {}=\"kg m-3\" states it)", density.name)
            } else {
                let layout = self.layout.of_other(&density, "give --air-density (kg/m3)")?;
                let factor = density.factor_to("kg m-3")?;
                let values = layout.read(&density, &self.window, factor, f32::NAN)?;
                self.checks.air_density(&density.name, &values)?;
                return Ok(values);
            };
            reasons += &format!("; {} is not taken for it, because {reason}", density.name);
        }
        let problem = format!("is a mixing ratio, and the file has no density of air{reasons}");
        Err(self.input.error(water, problem, "give one with --air-density (kg/m3)"))
    }

    /// Effective radius (um), zero where there is no water, from the file: its effective radius, or
    /// otherwise its droplet number concentration. `None` if the file has neither, or if the
    /// settings specify the number. Traces of water without droplets are removed.
    fn effective_radius(&mut self, content: &mut Array3<f32>) -> Result<Option<Array3<f32>>> {
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
        let density = self.air_density(&variable.name)?;
        let density = density.broadcast(shape).expect("read on the same axes");
        Ok(self.on_field(variable, "kg-1", shape)? * density * 1e-6)
    }

    /// Effective variance of the file, or the default one.
    fn effective_variance(&self, content: &Array3<f32>) -> Result<Array3<f32>> {
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

    fn variables(&self) -> impl Iterator<Item = Variable<'a>> + use<'a> {
        let input = self.input;
        input.names().into_iter().filter_map(|name| input.variable(&name).ok())
    }

    /// The variable with a standard name, or otherwise with one of the customary names.
    fn find(&self, standard_name: &str, names: &[&str]) -> Option<Variable<'a>> {
        let standard = |variable: &Variable| {
            !standard_name.is_empty()
                && variable.text("standard_name").is_some_and(|name| name == standard_name)
        };
        let customary =
            |variable: &Variable| names.contains(&variable.name.to_lowercase().as_str());
        self.variables().find(standard).or_else(|| self.variables().find(customary))
    }

    /// The values of a variable in the window, converted to `unit`, on all voxels. Missing values
    /// are NaN.
    fn on_field(
        &self,
        variable: &Variable,
        unit: &str,
        shape: (usize, usize, usize),
    ) -> Result<Array3<f32>> {
        let layout = self.layout.of_other(variable, "give it on axes of the liquid water")?;
        let values = layout.read(variable, &self.window, variable.factor_to(unit)?, f32::NAN)?;
        Ok(values.broadcast(shape).expect("read on the same axes").to_owned())
    }
}

/// The voxels that share a side with a voxel; `None` below index 0.
fn neighbours((k, j, i): (usize, usize, usize)) -> [Option<(usize, usize, usize)>; 6] {
    let below = |index: usize| index.checked_sub(1);
    [
        below(k).map(|k| (k, j, i)),
        below(j).map(|j| (k, j, i)),
        below(i).map(|i| (k, j, i)),
        Some((k + 1, j, i)),
        Some((k, j + 1, i)),
        Some((k, j, i + 1)),
    ]
}
