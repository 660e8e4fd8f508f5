//! Import of large-eddy simulations in netCDF. Names, units and axes are identified by CF
//! conventions, or by the customary names of common codes if a file does not follow them.

use super::axes::{Kind, Layout, Window, coordinate, leaf, levels_within, pieces};
use super::cells::{self, Cells};
use super::water::{Field, assumed_unit, find_field};
use super::{Axes, Crop, DROPLETS_PER_CM3, ImportReport, ImportSettings, grid_over};
use crate::cloud::resample::resample_droplets;
use crate::cloud::{Cloud, Microphysics, Spectrum, doubling_radii};
use crate::error::Result;
use crate::grid::resample::{resample, uniform_edges};
use crate::grid::{Grid, Volume};
use crate::io::arrays::is_array_file;
use crate::io::netcdf::{Input, Lineage, Time, Variable, is_netcdf};
use crate::io::plausible::Checks;
use crate::io::units::Unit;
use ndarray::{Array3, Axis, Zip};
use std::collections::BTreeMap;
use std::path::Path;

/// The radius of the first bin (um).
const FIRST_BIN: f64 = 2.0;

/// Negative liquid water contents of up to this magnitude (g/m3) result from advection and packing
/// and are set to zero.
const UNDERSHOOT: f32 = 1e-3;
/// Liquid water contents below this (g/m3) are not mentioned if they are cut off.
const TRACE: f32 = 1e-3;
/// Represents liquid water that the file declares as missing.
const MISSING: f32 = f32::MIN;
/// The liquid water content in data sets of AT3D.
const AT3D_WATER: &str = "density";
/// Ratio of the thickest to the thinnest level from which levels are stretched.
const STRETCHED: f64 = 1.01;
/// Largest mixing ratio (g/kg) of clouds: larger ones are not in the unit that is assumed.
const LARGEST_RATIO: f32 = 50.0;

/// The part of a simulation that is read.
pub(super) struct Simulation<'a> {
    pub(super) input: &'a Input,
    pub(super) settings: &'a ImportSettings,
    pub(super) layout: Layout,
    pub(super) window: Window,
    /// Whether the lowest level of the file is read.
    pub(super) from_ground: bool,
    /// The altitudes of the centres of the levels that are read (km).
    pub(super) altitudes: Vec<f64>,
    pub(super) checks: Checks<'a>,
    /// The density of air by which quantities per mass of air were multiplied.
    pub(super) air_density: Option<Array3<f32>>,
}

/// Read one time of a simulation. Only the required part of the file is read. Returns the cloud
/// and a report about it.
///
/// Liquid water is identified by its CF `standard_name`, by a customary name or by its
/// `long_name`, and its values are converted from the units of the file. A mixing ratio requires
/// the density of air, from the settings or the file: a density, or pressure and temperature;
/// otherwise that of the standard atmosphere is assumed. Effective radii are read from the file or
/// derived from the droplet number concentration of the file or the settings. If the file contains
/// a binned droplet spectrum, with the water of each bin in a separate variable, liquid water
/// content and effective radius are derived from it. A file without liquid water may contain the
/// extinction instead.
///
/// # Errors
/// Returns an error if the file is missing or damaged; if there is no liquid water or its units
/// are missing or not understood; if the axes cannot be identified; if the time or crop is outside
/// the file; if liquid water is negative, or missing inside of cloud; or if values are far beyond
/// those of clouds.
pub fn read_les(
    path: impl AsRef<Path>,
    settings: &ImportSettings,
) -> Result<(Cloud, ImportReport)> {
    let path = path.as_ref();
    let input = Input::open(path)?.with_axes(settings.axes.map(Axes::names));
    let mut checks = Checks::new(path, settings.allow_implausible);
    let known = units_of_at3d(&input, &mut checks);
    let water = known.contains_key(AT3D_WATER).then(|| AT3D_WATER.to_owned());
    let settings = &ImportSettings {
        units: known.into_iter().chain(settings.units.clone()).collect(),
        variable: settings.variable.clone().or(water),
        ..settings.clone()
    };
    let input = input.with_units(&settings.units)?;
    if let Some(assumption) = input.assumption().filter(|_| settings.units.is_empty()) {
        checks.warn(assumption);
    }
    let field = find_field(&input, settings, &mut checks)?;
    let variable = input.variable(field.name())?;
    if settings.axes.is_some() && !variable.has_stated_axes {
        let problem = "has named axes, or not three, so that --axes has no effect";
        return Err(variable.error(problem, "omit --axes"));
    }
    let mut layout = Layout::of(&input, &variable)?;
    let time = layout.check_time(&variable, settings.time)?;
    let [z, y, x] = cells_of(&input, &layout, &variable, time, settings, &mut checks)?;
    for (kind, cells) in [(Kind::Z, &z), (Kind::Y, &y), (Kind::X, &x)] {
        if cells.descends {
            layout.reverse(kind);
        }
    }
    let crop = Crop::of(settings, path, [y.count(), x.count()])?;
    let cropped = |cells: &Cells, first: usize, count: usize| {
        let step = cells.step();
        uniform_edges(cells.faces[0] + step * first as f64, step, count)
    };
    let (x_edges, y_edges) = (cropped(&x, crop.x0, crop.nx), cropped(&y, crop.y0, crop.ny));
    let (bottom, top) = (z.faces[0], z.faces[z.count()]);
    let grid = grid_over([&z.faces, &y_edges, &x_edges], settings, path)?;
    checks.lengths([x.step(), y.step(), z.step()], [bottom, top])?;
    checks.grid(&grid)?;
    let levels = levels_within(&z.faces, &grid);
    let z_edges = &z.faces[levels.start..=levels.end];
    if settings.spacing.is_none() {
        warn_of_stretching(z_edges, &grid, &mut checks);
    }
    let window = Window {
        time,
        levels: z.below + levels.start..z.below + levels.end,
        rows: pieces(crop.y0, crop.ny, y.count()),
        cols: pieces(crop.x0, crop.nx, x.count()),
    };
    let altitudes = z_edges.windows(2).map(|face| 0.5 * (face[0] + face[1])).collect();
    let from_ground = levels.start == 0;
    let mut simulation = Simulation {
        input: &input,
        settings,
        layout,
        window,
        from_ground,
        altitudes,
        checks,
        air_density: None,
    };
    simulation.check_below(&variable, z.below)?;
    let cloud = simulation.cloud(&field, [z_edges, &y_edges, &x_edges], grid)?;
    let lineage = simulation.lineage(&variable);
    let (taken, warnings) = simulation.checks.into_notes_and_warnings();
    Ok((cloud, ImportReport { taken, warnings, lineage }))
}

/// The number of times in a file of a simulation: 1 for a field without times, and for a text file.
///
/// # Errors
/// As [`read_les`], for the variable that describes the cloud.
pub fn count_times(path: impl AsRef<Path>, settings: &ImportSettings) -> Result<usize> {
    let path = path.as_ref();
    if !is_array_file(path) && !is_netcdf(path) {
        return Ok(1);
    }
    let input = Input::open(path)?.with_axes(settings.axes.map(Axes::names));
    let field = find_field(&input, settings, &mut Checks::new(path, true))?;
    let variable = input.variable(field.name())?;
    Ok(Layout::of(&input, &variable)?.length(&variable, Kind::Time))
}

/// The units of the variables of a data set of AT3D, which states none; empty for other files. AT3D
/// documents them: its grid is in km, as are the steps `delx` and `dely` that every one has.
fn units_of_at3d(input: &Input, checks: &mut Checks) -> BTreeMap<String, String> {
    const UNITS: [(&str, &str); 6] = [
        (AT3D_WATER, "g m-3"),
        ("reff", "um"),
        ("extinction", "km-1"),
        ("x", "km"),
        ("y", "km"),
        ("z", "km"),
    ];
    if !["delx", "dely", "x", "y", "z"].into_iter().all(|name| input.has(name)) {
        return BTreeMap::new();
    }
    let bare = UNITS.into_iter().filter(|(name, _)| {
        let variable = input.has(name).then(|| input.variable(name).ok()).flatten();
        variable.is_some_and(|variable| variable.unit_text().is_none())
    });
    let units: BTreeMap<_, _> =
        bare.map(|(name, unit)| (name.to_owned(), unit.to_owned())).collect();
    if !units.is_empty() {
        let texts: Vec<_> = units.iter().map(|(name, unit)| format!("{name} in {unit}")).collect();
        checks.warn(format!(
            "is a data set of AT3D without units, and is read in those of AT3D: {} (--units states others)",
            texts.join(", ")
        ));
    }
    units
}

/// Warn if the voxels of a file cannot be kept because its levels, with these faces (km), differ in
/// thickness.
fn warn_of_stretching(faces: &[f64], grid: &Grid, checks: &mut Checks) {
    let within = |faces: &&[f64]| {
        let inside = faces[1].min(grid.upper().z) - faces[0].max(grid.lower().z);
        inside > 1e-3 * grid.spacing.z
    };
    let thickness = faces.windows(2).filter(within).map(|faces| faces[1] - faces[0]);
    let [least, most] = thickness
        .fold([f64::INFINITY, 0.0], |[least, most], size| [size.min(least), size.max(most)]);
    if most > STRETCHED * least {
        checks.warn(format!(
            "its levels are {:.0} to {:.0} m thick, and are averaged to {:.0} m, their mean; --spacing \
             DX,DY,DZ gives another size, --base and --levels select a part",
            1e3 * least,
            1e3 * most,
            1e3 * grid.spacing.z
        ));
    }
}

/// The cells of the variable along z, y and x. The size of a single cell without bounds is that of
/// the other horizontal axis, or of the settings.
fn cells_of(
    input: &Input,
    layout: &Layout,
    variable: &Variable,
    time: usize,
    settings: &ImportSettings,
    checks: &mut Checks,
) -> Result<[Cells; 3]> {
    let spacing = |axis: usize| settings.spacing.map(|spacing| spacing[axis]);
    let lacks = |kind| {
        let axis = coordinate(input, layout.name(kind), kind);
        axis.is_none_or(|axis| axis.shape != [layout.length(variable, kind)])
    };
    if settings.axes.is_some() && [Kind::X, Kind::Y, Kind::Z].into_iter().any(lacks) {
        return stated_cells(layout, variable, settings, checks);
    }
    let x = cells::horizontal(input, layout, variable, Kind::X, None, checks)?;
    let width = x.as_ref().map(Cells::step).or(spacing(1));
    let y = cells::horizontal(input, layout, variable, Kind::Y, width, checks)?;
    let x = match x {
        Some(x) => Some(x),
        None => {
            let width = y.as_ref().map(Cells::step).or(spacing(0));
            cells::horizontal(input, layout, variable, Kind::X, width, checks)?
        }
    };
    let z = cells::vertical(input, layout, variable, time, spacing(2), checks)?;
    let required = |cells: Option<Cells>, name: &str| {
        let remedy = "add the CF attribute `bounds`, or give its size with --spacing DX,DY,DZ (km)";
        cells.ok_or_else(|| variable.error(format!("has a single cell along {name}"), remedy))
    };
    Ok([required(z, "z")?, required(y, "y")?, required(x, "x")?])
}

/// The cells along z, y and x of a file without coordinates, of the size in the settings.
fn stated_cells(
    layout: &Layout,
    variable: &Variable,
    settings: &ImportSettings,
    checks: &mut Checks,
) -> Result<[Cells; 3]> {
    let Some(spacing) = settings.spacing else {
        let remedy = "give the sizes of its cells (km) with --spacing DX,DY,DZ";
        return Err(variable.error("has axes without coordinates", remedy));
    };
    let bottom = settings.base.unwrap_or(0.0);
    let [dx, dy, dz] = (1e3 * spacing).to_array();
    checks.note(format!(
        "axes: {}, of cells of {dx:.0} x {dy:.0} x {dz:.0} m from the altitude {bottom} km, as stated",
        layout.text()
    ));
    let cells = |kind, start, size| Cells::uniform(start, size, layout.length(variable, kind));
    Ok([
        cells(Kind::Z, bottom, spacing.z),
        cells(Kind::Y, 0.0, spacing.y),
        cells(Kind::X, 0.0, spacing.x),
    ])
}

impl<'a> Simulation<'a> {
    /// The cloud of the field, whose cells have the given edges, on `grid`.
    fn cloud(&mut self, field: &Field, edges: [&[f64]; 3], grid: Grid) -> Result<Cloud> {
        let droplets = match field {
            Field::Extinction(name) => {
                let extinction = self.extinction(&self.input.variable(name)?)?;
                let volume = Volume::new(grid, resample(&extinction, edges, &grid)?)?;
                return Cloud::from_extinction(volume);
            }
            Field::Bins(bins) => self.spectrum(bins)?.microphysics(),
            Field::Water(name) => {
                let water = self.input.variable(name)?;
                let mut content = self.concentration(&water)?;
                self.checks.traces(name, &content, likely_unit(&water))?;
                self.note_what_is_cut(&content, edges[0], &grid);
                let Some(effective_radius) = self.effective_radius(&mut content)? else {
                    let content = resample(&content, edges, &grid)?;
                    let number = self.settings.droplets_per_cm3.unwrap_or(DROPLETS_PER_CM3);
                    self.checks.note(match self.settings.droplets_per_cm3 {
                        Some(number) => {
                            format!("effective radii: {number} droplets per cm3, as given")
                        }
                        None => format!("effective radii: assumed, {number} droplets per cm3"),
                    });
                    let droplets = Microphysics::from_droplet_number(content, number)?;
                    self.checks.droplets(&droplets)?;
                    return Cloud::from_microphysics(grid, droplets);
                };
                let effective_variance = self.effective_variance(&content)?;
                Microphysics { liquid_water_content: content, effective_radius, effective_variance }
            }
        };
        self.checks.droplets(&droplets)?;
        resample_droplets(&droplets, edges, &grid)
    }

    /// The time that was read, and the history of the file.
    fn lineage(&self, variable: &Variable) -> Lineage {
        let name = self.layout.name(Kind::Time);
        let along = coordinate(self.input, name, Kind::Time).filter(|_| !name.is_empty());
        // Many programs keep the time of a field that they select as a scalar.
        let alone = || self.input.variable("time").ok().filter(|time| time.shape.is_empty());
        let time = match self.layout.length(variable, Kind::Time) {
            0 => None,
            _ => along.or_else(alone).and_then(|axis| Time::at(&axis, self.window.time)),
        };
        Lineage { time, history: self.input.text("history").unwrap_or_default() }
    }

    /// Note that no water was read, or that there is some in the levels next to the grid.
    fn note_what_is_cut(&mut self, content: &Array3<f32>, z_edges: &[f64], grid: &Grid) {
        if content.iter().all(|water| *water == 0.0) {
            self.checks.note("liquid water: none in the part that was read");
            return;
        }
        let wet: Vec<_> = content
            .outer_iter()
            .zip(z_edges.windows(2))
            .filter(|(level, _)| level.iter().any(|water| *water > TRACE))
            .map(|(_, faces)| (faces[0], faces[1]))
            .collect();
        let [bottom, top] = [grid.lower().z, grid.upper().z];
        let slack = 1e-3 * grid.spacing.z;
        if wet.iter().any(|(low, _)| *low < bottom - slack) {
            self.checks
                .note(format!("left out: liquid water below the grid, under {bottom:.3} km"));
        }
        if wet.iter().any(|(_, high)| *high > top + slack) {
            self.checks.note(format!("left out: liquid water above the grid, over {top:.3} km"));
        }
    }

    /// Returns an error if there is liquid water in more than one level below the ground; a single one
    /// may be that of the boundary condition.
    fn check_below(&mut self, water: &Variable, below: usize) -> Result<()> {
        if below < 2 {
            return Ok(());
        }
        let window = Window {
            levels: 0..below,
            time: self.window.time,
            rows: self.window.rows.clone(),
            cols: self.window.cols.clone(),
        };
        let values = self.layout.read(water, &window, 1.0, 0.0)?;
        if values.iter().all(|value| *value <= 0.0 || value.is_nan()) {
            return Ok(());
        }
        let problem = format!("has liquid water in the {below} levels below altitude 0");
        Err(water.error(problem, "write altitudes that are positive above the ground"))
    }

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
        let stated = water.unit_text();
        let unit = match &stated {
            Some(text) => Unit::parse(text),
            None => assumed_unit(&water.name).and_then(Unit::parse),
        };
        let wrong = || {
            let expected = "a unit such as g m-3, kg m-3, kg kg-1 or g kg-1";
            // "lwc" is the liquid water content of air, names with "q" are mixing ratios.
            let is_content = leaf(&water.name).to_lowercase().contains("lwc");
            water.wrong_unit(expected, if is_content { "g m-3" } else { "kg kg-1" })
        };
        let unit = unit.ok_or_else(wrong)?;
        let ratio = unit.is_mass_ratio();
        let target = Unit::parse(if ratio { "g kg-1" } else { "g m-3" }).expect("a unit");
        let factor = unit.factor_to(&target).ok_or_else(wrong)?;
        let layout = self.layout.of_other(water, "give it on the same axes")?;
        let mut values = layout.read(water, &self.window, factor, MISSING)?;
        if let Some(stated) = stated.as_ref().filter(|_| unit.has_number()) {
            let plain = if ratio { "kg kg-1" } else { "kg m-3" };
            self.checks.warn(format!(
                "the numbers of {name} are multiplied by the one in its units \"{stated}\"; \
                 --units {name}=\"{plain}\" states the units of numbers that already are",
                name = water.name
            ));
        }
        let said = self.unit_of_model(water, stated.as_deref(), ratio, &mut values)?;
        if ratio {
            let density = self.air_density(water)?;
            let density = density.broadcast(values.raw_dim()).expect("read on the same axes");
            Zip::from(&mut values).and(density).for_each(|value, density| {
                // The density may be missing where there is no air.
                let absent = *value == MISSING || *value == 0.0;
                *value = if absent { *value } else { *value * density };
            });
        }
        self.checks.note(format!(
            "liquid water: {}({}) in {said}, time {}",
            water.name,
            self.layout.text(),
            self.window.time
        ));
        self.without_undershoot(water, &mut values, "g/m3")?;
        self.fill(water, &mut values)?;
        Ok(values)
    }

    /// Extinction (1/km) in the window.
    fn extinction(&mut self, variable: &Variable) -> Result<Array3<f32>> {
        let factor = variable.factor_to("km-1")?;
        let mut values = self.layout.read(variable, &self.window, factor, MISSING)?;
        self.without_undershoot(variable, &mut values, "1/km")?;
        self.fill(variable, &mut values)?;
        self.checks.extinction(&variable.name, &values)?;
        let unit = variable.unit_text().unwrap_or_default();
        self.checks.note(format!("extinction: {} in {unit}", variable.name));
        Ok(values)
    }

    /// The unit of the liquid water in words. The unit of a variable without one is assumed, and the
    /// one that a model writes by mistake is corrected.
    fn unit_of_model(
        &mut self,
        water: &Variable,
        stated: Option<&str>,
        ratio: bool,
        values: &mut Array3<f32>,
    ) -> Result<String> {
        let most = values.iter().copied().fold(0.0, f32::max);
        let name = &water.name;
        let Some(stated) = stated else {
            let unit = if ratio { "kg kg-1" } else { "kg m-3" };
            if most > LARGEST_RATIO {
                let problem = format!("has no units, and numbers of up to {}", 1e-3 * most);
                let remedy = format!("state the units, such as --units {name}=\"g kg-1\"");
                return Err(water.error(problem, &remedy));
            }
            self.checks.warn(format!(
                "{name} has no units, and is taken to be in {unit} (--units {name}=\"...\" states them)"
            ));
            return Ok(format!("{unit}, assumed"));
        };
        let model = ["Source", "source"].iter().find_map(|name| self.input.text(name));
        let is_ucla = model.is_some_and(|model| {
            let model = model.to_uppercase().replace('-', "");
            model.contains("UCLALES")
        });
        let grams = Unit::parse("g kg-1");
        let in_grams = ratio && Unit::parse(stated).is_some() && Unit::parse(stated) == grams;
        // One thousandth of the largest mixing ratio is a cloud that nobody simulates.
        let given = self.settings.units.contains_key(name);
        if is_ucla && in_grams && !given && most < 1e-3 * LARGEST_RATIO {
            values.mapv_inplace(|value| if value == MISSING { MISSING } else { 1e3 * value });
            self.checks.warn(format!(
                "{name} states {stated}, but UCLA-LES writes kg/kg into its 3-D files, and its numbers \
                 are at most {most}; they are read as kg kg-1 (--units {name}=\"g kg-1\" keeps g/kg)"
            ));
            return Ok("kg kg-1, corrected".into());
        }
        Ok(stated.to_owned())
    }

    /// Set small negative values to zero.
    ///
    /// # Errors
    /// Returns an error if a value is negative or not finite.
    fn without_undershoot(
        &self,
        variable: &Variable,
        values: &mut Array3<f32>,
        unit: &str,
    ) -> Result<()> {
        for ((k, j, i), value) in values.indexed_iter_mut() {
            if *value == MISSING || (value.is_finite() && *value >= -UNDERSHOOT) {
                *value = if *value == MISSING { MISSING } else { value.max(0.0) };
                continue;
            }
            return Err(variable.error(
                format!("is {value} {unit} in the part that was read, at [z {k}, y {j}, x {i}]"),
                "it must be finite and not negative: choose another part of the file",
            ));
        }
        Ok(())
    }

    /// Replace missing liquid water outside of cloud by zero.
    ///
    /// # Errors
    /// Returns an error if missing values are enclosed by liquid water.
    fn fill(&mut self, water: &Variable, values: &mut Array3<f32>) -> Result<()> {
        let shape = values.dim();
        let ground = self.below_terrain(values);
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
        if ground > 0 {
            self.checks.warn(format!(
                "{} is missing in {ground} voxels at the bottom of their columns, which are taken to be \
                 below the ground, without cloud",
                water.name
            ));
        }
        if !missing.is_empty() {
            let (count, all) = (missing.len(), shape.0 * shape.1 * shape.2);
            self.checks.warn(format!(
                "{} is missing in {count} of {all} voxels, which are read as free of cloud",
                water.name
            ));
        }
        Ok(())
    }

    /// Set missing values to zero in all levels from the bottom of a column up to the first one with a
    /// value: they are below the terrain. Returns their number.
    fn below_terrain(&self, values: &mut Array3<f32>) -> usize {
        let mut count = 0;
        // Without the lowest level of the file, it is unknown what is below.
        if !self.from_ground {
            return count;
        }
        for mut column in values.lanes_mut(Axis(0)) {
            // A column without any value is a hole of the file.
            if column.iter().all(|value| *value == MISSING) {
                continue;
            }
            for value in column.iter_mut().take_while(|value| **value == MISSING) {
                *value = 0.0;
                count += 1;
            }
        }
        count
    }

    pub(super) fn variables(&self) -> impl Iterator<Item = Variable<'a>> + use<'a> {
        let input = self.input;
        input.names().into_iter().filter_map(|name| input.variable(&name).ok())
    }

    /// The variable with a standard name, or otherwise with one of the customary names.
    pub(super) fn find(&self, standard_name: &str, names: &[&str]) -> Option<Variable<'a>> {
        let standard = |variable: &Variable| {
            !standard_name.is_empty()
                && variable.text("standard_name").is_some_and(|name| name == standard_name)
        };
        let customary =
            |variable: &Variable| names.contains(&leaf(&variable.name).to_lowercase().as_str());
        self.variables().find(standard).or_else(|| self.variables().find(customary))
    }

    /// The values of a variable in the window, converted to `unit`, on all voxels. Missing values
    /// are NaN.
    pub(super) fn on_field(
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

/// Why the numbers of liquid water may be too small.
fn likely_unit(water: &Variable) -> String {
    let stated = water.unit_text().unwrap_or_default();
    match Unit::parse(&stated) {
        Some(unit) if unit.has_number() => format!(
            "the numbers may already be multiplied by the one in their units \"{stated}\", which \
             --units {}=\"kg kg-1\" states",
            water.name
        ),
        _ => "the numbers may be in kg instead of g".into(),
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
