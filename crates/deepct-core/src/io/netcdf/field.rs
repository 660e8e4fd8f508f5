//! Fields on a grid: clouds, volumes, estimates and masks.

use super::light::put_light;
use super::write::{Attribute::*, Attributes, Output};
use super::{Input, Provenance, Variable, edge_and_spacing};
use crate::cloud::{Cloud, EFFECTIVE_VARIANCE, Microphysics};
use crate::error::{Error, Result};
use crate::grid::{Grid, Mask, Volume};
use crate::io::plausible::{Checks, LARGEST_EXTINCTION};
use crate::math::DVec3;
use crate::network::Estimate;
use crate::optics::extinction;
use crate::scene::Observation;
use hdf5::Dataset;
use ndarray::{Array2, Array3, ArrayD};
use serde::Deserialize;
use std::path::Path;

/// The dimensions of a field.
pub(super) const AXES: [&str; 3] = ["z", "y", "x"];
/// The dimension of the lower and the upper face of a voxel.
const BOUNDS: &str = "bnds";

const LIQUID_WATER: &Attributes = &[
    ("units", Text("g m-3")),
    ("long_name", Text("liquid water content")),
    ("standard_name", Text("mass_concentration_of_cloud_liquid_water_in_air")),
];
const EFFECTIVE_RADIUS: &Attributes = &[
    ("units", Text("um")),
    ("long_name", Text("droplet effective radius")),
    ("standard_name", Text("effective_radius_of_cloud_liquid_water_particles")),
];
const VARIANCE: &Attributes =
    &[("units", Text("1")), ("long_name", Text("droplet effective variance"))];
const EXTINCTION: &Attributes = &[
    ("units", Text("km-1")),
    ("long_name", Text("volume extinction coefficient of cloud droplets")),
    ("standard_name", Text("volume_extinction_coefficient_in_air_due_to_cloud_particles")),
];
const UNCERTAINTY: &Attributes =
    &[("units", Text("km-1")), ("long_name", Text("expected absolute error of the extinction"))];
const MASK: &Attributes = &[
    ("long_name", Text("mask of the voxels in which the images permit cloud")),
    ("flag_values", Flags(&[0, 1])),
    ("flag_meanings", Text("outside inside")),
];

/// Write a cloud: `lwc` (g m-3), `reff` (um), `veff` and `extinction` (km-1), each if known, on
/// `(z, y, x)`.
///
/// # Errors
/// Returns an error if the file cannot be written.
pub fn write_cloud(path: impl AsRef<Path>, cloud: &Cloud, provenance: &Provenance) -> Result<()> {
    let mut output = Output::create(path.as_ref(), provenance)?;
    put_cloud(&mut output, cloud)?;
    output.finish()
}

/// Add a cloud to a file that is being written.
pub(super) fn put_cloud(output: &mut Output, cloud: &Cloud) -> Result<()> {
    write_axes(output, &cloud.grid)?;
    if let Some(droplets) = &cloud.microphysics {
        output.variable("lwc", &AXES, &droplets.liquid_water_content, LIQUID_WATER)?;
        output.variable("reff", &AXES, &droplets.effective_radius, EFFECTIVE_RADIUS)?;
        output.variable("veff", &AXES, &droplets.effective_variance, VARIANCE)?;
    }
    if let Some(extinction) = &cloud.extinction {
        output.variable("extinction", &AXES, extinction, EXTINCTION)?;
    }
    Ok(())
}

/// Read a cloud on `(z, y, x)`: `lwc` and `reff` (and `veff`, 0.1 if not given), or
/// `extinction`, or both. Values are converted from the units of the file.
///
/// # Errors
/// Returns an error if the file is missing, damaged or of another type, if a variable has no unit
/// or that of another quantity, if values are negative, missing, not finite or far beyond those of
/// clouds, or if coordinates are not uniform.
pub fn read_cloud(path: impl AsRef<Path>) -> Result<Cloud> {
    let path = path.as_ref();
    checked_cloud(path, &mut Checks::new(path, false))
}

/// Read a cloud as [`read_cloud`] does, but accept values that are far beyond those of clouds.
/// Returns the cloud and a warning about each kind of such values.
///
/// # Errors
/// As [`read_cloud`], except for such values.
pub fn read_implausible_cloud(path: impl AsRef<Path>) -> Result<(Cloud, Vec<String>)> {
    let path = path.as_ref();
    let mut checks = Checks::new(path, true);
    let cloud = checked_cloud(path, &mut checks)?;
    Ok((cloud, checks.into_warnings()))
}

fn checked_cloud(path: &Path, checks: &mut Checks) -> Result<Cloud> {
    let input = Input::open(path)?;
    let read = |name, unit| input.variable_on(name, &AXES)?.reals_3d_in::<f32>(unit);
    let (water, given) = (input.has("lwc"), input.has("extinction"));
    if !water && !given {
        if let Some(unreadable) = input.unreadable() {
            return Err(unreadable);
        }
        let names = input.names().join(", ");
        let remedy = format!(
            "the file has these variables: {names}; other formats are read by `cloud import`"
        );
        return Err(input.error("extinction, lwc", "both are missing", &remedy));
    }
    let field = input.variable_on(if water { "lwc" } else { "extinction" }, &AXES)?;
    let grid = grid_of(&field, &input)?;
    checks.grid(&grid)?;
    let mut cloud = Cloud { grid, microphysics: None, extinction: None };
    if water {
        let liquid_water_content = read("lwc", "g m-3")?;
        let mut effective_radius = read("reff", "um")?;
        let effective_variance = if input.has("veff") {
            read("veff", "1")?
        } else {
            Array3::from_elem(grid.shape, EFFECTIVE_VARIANCE)
        };
        if effective_radius.dim() == liquid_water_content.dim() {
            // Many programs write a missing radius where there is no water.
            effective_radius.zip_mut_with(&liquid_water_content, |radius, &water| {
                *radius = if water == 0.0 && radius.is_nan() { 0.0 } else { *radius };
            });
        }
        let droplets = Microphysics { liquid_water_content, effective_radius, effective_variance };
        cloud = Cloud::from_microphysics(grid, droplets).map_err(Error::in_file(path))?;
        cloud.microphysics.as_ref().map_or(Ok(()), |droplets| checks.droplets(droplets))?;
    }
    if given {
        let volume =
            Volume::new(grid, read("extinction", "km-1")?).map_err(Error::in_file(path))?;
        cloud.extinction = Cloud::from_extinction(volume).map_err(Error::in_file(path))?.extinction;
        let values = cloud.extinction.as_ref();
        values.map_or(Ok(()), |values| checks.extinction("extinction", values))?;
        // Exported clouds always have an extinction.
        if input.is_exported() == Some(true) && is_derived(&cloud)? {
            cloud.extinction = None;
        }
    }
    Ok(cloud)
}

/// Whether the extinction of a cloud is that of its droplets for an extinction efficiency of 2.
fn is_derived(cloud: &Cloud) -> Result<bool> {
    let droplets = Cloud { extinction: None, ..cloud.clone() };
    Ok(cloud.microphysics.is_some()
        && cloud.extinction.as_ref() == Some(&extinction(&droplets)?.values))
}

/// Write a volume as `extinction` (km-1) on `(z, y, x)`.
///
/// # Errors
/// Returns an error if an extinction is negative or not finite, or if the file cannot be written.
pub fn write_volume(
    path: impl AsRef<Path>,
    volume: &Volume,
    provenance: &Provenance,
) -> Result<()> {
    let mut output = Output::create(path.as_ref(), provenance)?;
    put_volume(&mut output, volume)?;
    output.finish()
}

/// Write the estimate of a network: `extinction` and, if available, `uncertainty` (km-1) and `reff`
/// (um; 0 where there is no extinction) on `(z, y, x)`, and the scene illumination of the images if it is known.
///
/// # Errors
/// Returns an error if an extinction is negative or not finite, or if the file cannot be written.
pub fn write_estimate(
    path: impl AsRef<Path>,
    estimate: &Estimate,
    observation: Option<&Observation>,
    provenance: &Provenance,
) -> Result<()> {
    let mut output = Output::create(path.as_ref(), provenance)?;
    put_volume(&mut output, &estimate.extinction)?;
    observation.map_or(Ok(()), |observation| put_light(&output, observation))?;
    if let Some(uncertainty) = &estimate.uncertainty {
        output.variable("uncertainty", &AXES, &uncertainty.values, UNCERTAINTY)?;
    }
    if let Some(radius) = &estimate.effective_radius {
        output.variable("reff", &AXES, &radius.values, EFFECTIVE_RADIUS)?;
    }
    output.finish()
}

/// Returns an error for values that the readers refuse; some networks may estimate such values.
fn check_extinction(volume: &Volume) -> Result<()> {
    volume.check_non_negative("extinction")?;
    match volume.values.iter().copied().find(|value| *value > LARGEST_EXTINCTION) {
        None => Ok(()),
        Some(most) => {
            let range = "at most 10000 km-1: the images may be in another unit, or contain the code of \
                         a missing value";
            Err(Error::out_of_range("extinction", format!("{most:e} km-1"), range))
        }
    }
}

/// A file of an estimate that is written tile by tile, for fields that are larger than the memory.
pub struct EstimateFile {
    output: Output,
    extinction: Dataset,
    uncertainty: Option<Dataset>,
}

impl EstimateFile {
    /// Create the file of an estimate on `grid`, as [`write_estimate`].
    ///
    /// # Errors
    /// Returns an error if the file cannot be written.
    pub fn create(
        path: impl AsRef<Path>,
        grid: &Grid,
        has_uncertainty: bool,
        observation: Option<&Observation>,
        provenance: &Provenance,
    ) -> Result<Self> {
        let mut output = Output::create(path.as_ref(), provenance)?;
        write_axes(&mut output, grid)?;
        let extinction = output.unwritten::<f32>("extinction", &AXES, &grid.shape, EXTINCTION)?;
        observation.map_or(Ok(()), |observation| put_light(&output, observation))?;
        let add = || output.unwritten::<f32>("uncertainty", &AXES, &grid.shape, UNCERTAINTY);
        let uncertainty = has_uncertainty.then(add).transpose()?;
        Ok(Self { output, extinction, uncertainty })
    }

    /// Write the estimate of a part of the grid that begins with the row and column `first`.
    ///
    /// # Errors
    /// Returns an error if an extinction is negative or not finite, or if the file cannot be written.
    pub fn write(&self, [row, col]: [usize; 2], estimate: &Estimate) -> Result<()> {
        check_extinction(&estimate.extinction)?;
        let first = [0, row, col];
        self.output.write_part(&self.extinction, first, &estimate.extinction.values)?;
        match (&self.uncertainty, &estimate.uncertainty) {
            (Some(dataset), Some(volume)) => self.output.write_part(dataset, first, &volume.values),
            _ => Ok(()),
        }
    }

    /// Close the file and give it its name.
    ///
    /// # Errors
    /// Returns an error if the file cannot be written.
    pub fn finish(self) -> Result<()> {
        let Self { output, extinction, uncertainty } = self;
        drop((extinction, uncertainty));
        output.finish()
    }
}

/// Add a volume to a file that is being written.
pub(super) fn put_volume(output: &mut Output, volume: &Volume) -> Result<()> {
    check_extinction(volume)?;
    write_axes(output, &volume.grid)?;
    output.variable("extinction", &AXES, &volume.values, EXTINCTION)
}

/// Read `extinction` (km-1) on `(z, y, x)`.
///
/// # Errors
/// As [`read_cloud`].
pub fn read_volume(path: impl AsRef<Path>) -> Result<Volume> {
    let path = path.as_ref();
    let input = Input::open(path)?;
    let variable = input.variable_on("extinction", &AXES)?;
    let values = variable.reals_3d_in("km-1")?;
    let volume = Volume::new(grid_of(&variable, &input)?, values)?;
    volume.check_non_negative("extinction").map_err(Error::in_file(path))?;
    let mut checks = Checks::new(path, false);
    checks.grid(&volume.grid)?;
    checks.extinction("extinction", &volume.values)?;
    Ok(volume)
}

/// Read an estimate that [`write_estimate`] wrote. A file without `uncertainty` or `reff` is accepted.
///
/// # Errors
/// As [`read_cloud`].
pub fn read_estimate(path: impl AsRef<Path>) -> Result<Estimate> {
    let path = path.as_ref();
    let extinction = read_volume(path)?;
    let input = Input::open(path)?;
    let read = |variable, unit, name| {
        if !input.has(variable) {
            return Ok(None);
        }
        let mut values = input.variable_on(variable, &AXES)?.reals_3d_in::<f32>(unit)?;
        if values.dim() == extinction.values.dim() {
            // A radius has no meaning where there is no extinction, and many programs write none.
            values.zip_mut_with(&extinction.values, |value, &extinction| {
                *value = if extinction == 0.0 && value.is_nan() { 0.0 } else { *value };
            });
        }
        let volume = Volume::new(extinction.grid, values).and_then(|volume| {
            volume.check_non_negative(name)?;
            Ok(volume)
        });
        volume.map(Some).map_err(Error::in_file(path))
    };
    let uncertainty = read("uncertainty", "km-1", "uncertainty")?;
    let effective_radius = read("reff", "um", "effective radius")?;
    Ok(Estimate { extinction, uncertainty, effective_radius })
}

/// Write a mask as `mask`, 1 inside and 0 outside, on `(z, y, x)`.
///
/// # Errors
/// Returns an error if the file cannot be written.
pub fn write_mask(path: impl AsRef<Path>, mask: &Mask, provenance: &Provenance) -> Result<()> {
    let mut output = Output::create(path.as_ref(), provenance)?;
    write_axes(&mut output, &mask.grid)?;
    put_mask(&output, mask)?;
    output.finish()
}

/// Add a mask to a file that already has its axes.
pub(super) fn put_mask(output: &Output, mask: &Mask) -> Result<()> {
    output.variable("mask", &AXES, &mask.values.mapv(i8::from), MASK)
}

/// Read `mask`, 1 inside and 0 outside, on `(z, y, x)`.
///
/// # Errors
/// As [`read_cloud`]; also returns an error if there are numbers other than 0 and 1.
pub fn read_mask(path: impl AsRef<Path>) -> Result<Mask> {
    let path = path.as_ref();
    let input = Input::open(path)?;
    let variable = input.variable_on("mask", &AXES)?;
    let values: ArrayD<bool> = variable.flags()?;
    let values = values.into_dimensionality().expect("three dimensions were checked");
    let grid = grid_of(&variable, &input)?;
    Checks::new(path, false).grid(&grid)?;
    Mask::new(grid, values)
}

/// The TOML representation of a grid.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct GridSettings {
    origin_km: [f64; 3],
    spacing_km: [f64; 3],
    shape: [usize; 3],
}

/// Read a grid from any file with coordinates `z`, `y`, `x`, or from a TOML file with
/// `origin_km = [x, y, z]`, `spacing_km = [x, y, z]` and `shape = [nz, ny, nx]`.
///
/// # Errors
/// Returns an error if the file is missing or damaged, if coordinates are not uniform, if a key is
/// unknown, or if a value is out of range.
pub fn read_grid(path: impl AsRef<Path>) -> Result<Grid> {
    let path = path.as_ref();
    if path.extension().is_some_and(|extension| extension == "toml") {
        let remedy = "give origin_km, spacing_km (x, y, z) and shape (nz, ny, nx)";
        let settings: GridSettings = crate::files::read_toml(path, "grid", remedy)?;
        let origin = DVec3::from_array(settings.origin_km);
        let spacing = DVec3::from_array(settings.spacing_km);
        let grid = Grid::new(origin, spacing, settings.shape).map_err(Error::in_file(path))?;
        Checks::new(path, false).grid(&grid)?;
        return Ok(grid);
    }
    let input = Input::open(path)?;
    let [z, y, x] = AXES.map(|name| input.variable_on(name, &[name]));
    let grid = grid_from_axes(&input, [z?, y?, x?])?;
    Checks::new(path, false).grid(&grid)?;
    Ok(grid)
}

/// Write the coordinates of voxel centres and, according to CF, their bounds. Spacing and lower edge
/// are recorded as attributes so that a grid can be read back exactly.
fn write_axes(output: &mut Output, grid: &Grid) -> Result<()> {
    let [x, y, z] = grid.axes();
    let axes = [
        ("z", "z_bnds", 2, z, "altitude of voxel centres", "altitude"),
        ("y", "y_bnds", 1, y, "northward distance of voxel centres", ""),
        ("x", "x_bnds", 0, x, "eastward distance of voxel centres", ""),
    ];
    for (name, bounds, axis, values, long_name, standard) in &axes {
        let letter = name.to_uppercase();
        let mut attributes = vec![
            ("units", Text("km")),
            ("long_name", Text(long_name)),
            ("axis", Text(&letter)),
            ("bounds", Text(bounds)),
            ("lower_edge", Number(grid.origin[*axis])),
            ("spacing", Number(grid.spacing[*axis])),
        ];
        if !standard.is_empty() {
            attributes.extend([("standard_name", Text(standard)), ("positive", Text("up"))]);
        }
        let spacing = grid.spacing[*axis];
        let values: Vec<f64> = values.iter().map(|&value| legible(value, spacing)).collect();
        output.dimension(name, &values, &attributes)?;
    }
    output.bare_dimension(BOUNDS, 2)?;
    for (name, bounds, axis, values, ..) in &axes {
        let (origin, spacing) = (grid.origin[*axis], grid.spacing[*axis]);
        let faces = Array2::from_shape_fn((values.len(), 2), |(index, side)| {
            legible(origin + spacing * (index + side) as f64, spacing)
        });
        // Their units and names are those of the coordinates.
        output.variable(bounds, &[name, BOUNDS], &faces, &[])?;
    }
    Ok(())
}

/// A coordinate (km) in the fewest decimals from which it is known to a millionth of the spacing, and
/// at least in nine: programs that select a range of altitudes would miss 0.66 km if it was written as
/// 0.6599999999999999.
fn legible(coordinate: f64, spacing: f64) -> f64 {
    let decimals = (6.0 - spacing.log10().floor()).max(9.0) as usize;
    // A number that is divided by a power of ten instead may have another last digit.
    format!("{coordinate:.decimals$}").parse::<f64>().expect("a number") + 0.0
}

/// The grid of a variable on `(z, y, x)`.
fn grid_of(variable: &Variable, input: &Input) -> Result<Grid> {
    let mut axes = Vec::new();
    for (name, &length) in AXES.into_iter().zip(&variable.shape) {
        let axis = input.variable_on(name, &[name])?;
        if axis.shape != [length] {
            return Err(axis.error(
                format!("has {:?} values for an axis of {length}", axis.shape),
                "write one coordinate per voxel",
            ));
        }
        axes.push(axis);
    }
    grid_from_axes(input, axes.try_into().unwrap_or_else(|_| unreachable!("three axes")))
}

fn grid_from_axes(input: &Input, axes: [Variable; 3]) -> Result<Grid> {
    let shape = axes.each_ref().map(|axis| axis.shape[0]);
    let [z, y, x] = axes.map(|axis| edge_and_spacing(input, &axis));
    let ((z, dz), (y, dy), (x, dx)) = (z?, y?, x?);
    Grid::new(DVec3::new(x, y, z), DVec3::new(dx, dy, dz), shape)
        .map_err(|problem| input.error("x, y, z", problem.to_string(), "write a grid in range"))
}
