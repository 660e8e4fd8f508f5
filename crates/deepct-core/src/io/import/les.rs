//! Import of large-eddy simulations in netCDF-4. Names, units and axes are identified by CF
//! conventions, or by the customary names of common codes if a file does not follow them.

use super::axes::{Kind, Layout, Window, kind_of, levels_within, pieces};
use super::{Crop, DROPLETS_PER_CM3, ImportSettings, edges_of, grid_over};
use crate::cloud::resample::{resample, resample_droplets, uniform_edges};
use crate::cloud::{
    Cloud, EFFECTIVE_VARIANCE, LARGEST_RADIUS, Microphysics, Spectrum, doubling_radii,
};
use crate::error::Result;
use crate::io::netcdf::{Input, Variable, edge_and_spacing, kilometres};
use ndarray::Array3;
use std::path::Path;

/// Customary names of cloud liquid water.
const WATER_NAMES: [&str; 11] =
    ["lwc", "clwc", "ql", "qc", "qn", "qcloud", "cldliq", "qcl", "rl", "rc", "ql_3d"];
/// Customary names of the density of air.
const DENSITY_NAMES: [&str; 7] = ["rho", "density", "rhoref", "rhobf", "rho0", "dn0", "rho_ref"];
/// Customary names of the effective radius.
const RADIUS_NAMES: [&str; 4] = ["reff", "re", "rel", "effective_radius"];

/// Names of the bins of a droplet spectrum without their numbers, which start at 01: those of the
/// spectral bin microphysics of WRF (Khain et al. 2004).
const BIN_NAMES: [&str; 2] = ["ff1i", "FF1I"];
/// The radius of the first bin (um).
const FIRST_BIN: f64 = 2.0;

/// Negative liquid water contents of up to this magnitude (g/m3) result from advection and packing
/// and are set to zero.
const UNDERSHOOT: f32 = 1e-3;

/// Read one time of a simulation. Only the required part of the file is read.
///
/// Liquid water is identified by its CF `standard_name`, by a customary name or by its
/// `long_name`. A mixing ratio requires the density of air, from the file or the settings.
/// Effective radii are read from the file or derived from the droplet number concentration. If
/// the file contains a binned droplet spectrum, with the water of each bin in a separate variable,
/// liquid water content and effective radius are derived from it.
///
/// # Errors
/// Returns an error if the file is missing or damaged; if there is no liquid water or its units
/// are not supported; if the axes cannot be identified; if the time or crop is outside the file;
/// or if liquid water is negative or missing.
pub fn read_les(path: impl AsRef<Path>, settings: &ImportSettings) -> Result<Cloud> {
    let path = path.as_ref();
    let input = Input::open(path)?;
    let bins = find_bins(&input, settings);
    let water = match bins.first() {
        Some(name) => input.variable(name)?,
        None => find_water(&input, settings)?,
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
    let window = Window {
        time: layout.check_time(&water, settings.time)?,
        levels: levels_within(&z_edges, &grid),
        rows: pieces(crop.y0, crop.ny, y.shape[0]),
        cols: pieces(crop.x0, crop.nx, x.shape[0]),
    };
    let z_edges = &z_edges[window.levels.start..=window.levels.end];
    let edges = [z_edges, y_edges.as_slice(), x_edges.as_slice()];
    if !bins.is_empty() {
        let droplets = spectrum(&input, &bins, &layout, &window, settings)?.microphysics();
        return resample_droplets(&droplets, edges, &grid);
    }
    let content = concentration(&input, &water, &layout, &window, settings)?;
    let radius = match settings.droplets_per_cm3 {
        None => effective_radius(&input, &water, &layout, &window)?,
        Some(_) => None,
    };
    let Some(mut effective_radius) = radius else {
        let content = resample(&content, edges, &grid)?;
        let number = settings.droplets_per_cm3.unwrap_or(DROPLETS_PER_CM3);
        let droplets = Microphysics::from_droplet_number(content, number)?;
        return Cloud::from_microphysics(grid, droplets);
    };
    effective_radius.zip_mut_with(&content, |radius, &water| {
        *radius = if water > 0.0 { radius.min(LARGEST_RADIUS) } else { 0.0 };
    });
    let effective_variance = Array3::from_elem(content.raw_dim(), EFFECTIVE_VARIANCE);
    let droplets =
        Microphysics { liquid_water_content: content, effective_radius, effective_variance };
    resample_droplets(&droplets, edges, &grid)
}

/// The names of the bins of a droplet spectrum, in order. The list is empty if the file has none,
/// or if the settings specify a variable or a droplet number concentration.
fn find_bins(input: &Input, settings: &ImportSettings) -> Vec<String> {
    if settings.variable.is_some() || settings.droplets_per_cm3.is_some() {
        return Vec::new();
    }
    let names = input.names();
    let bins = |prefix: &str| -> Vec<String> {
        (1..).map(|bin| format!("{prefix}{bin:02}")).take_while(|bin| names.contains(bin)).collect()
    };
    BIN_NAMES.into_iter().map(bins).find(|bins| !bins.is_empty()).unwrap_or_default()
}

/// The droplet spectrum in the window, from all bins.
fn spectrum(
    input: &Input,
    bins: &[String],
    layout: &Layout,
    window: &Window,
    settings: &ImportSettings,
) -> Result<Spectrum> {
    let mut spectrum: Option<Spectrum> = None;
    for (name, radius) in bins.iter().zip(doubling_radii(FIRST_BIN, bins.len())) {
        let bin = input.variable(name)?;
        let content = concentration(input, &bin, layout, window, settings)?;
        spectrum
            .get_or_insert_with(|| Spectrum::empty(content.dim().into()))
            .add_water(radius, &content)?;
    }
    Ok(spectrum.unwrap_or_else(|| Spectrum::empty([0; 3])))
}

/// The variable that contains cloud liquid water.
fn find_water<'a>(input: &'a Input, settings: &ImportSettings) -> Result<Variable<'a>> {
    if let Some(name) = &settings.variable {
        return input.variable(name);
    }
    let variables: Vec<_> =
        input.names().iter().filter_map(|name| input.variable(name).ok()).collect();
    let standard = |variable: &Variable| {
        variable.text("standard_name").is_some_and(|name| {
            name.contains("cloud_liquid_water")
                && !name.contains("effective_radius")
                && !name.contains("content")
                && !name.contains("path")
        })
    };
    let customary = |variable: &Variable| {
        variable.shape.len() >= 3 && WATER_NAMES.contains(&variable.name.to_lowercase().as_str())
    };
    let described = |variable: &Variable| {
        let described = variable.text("long_name").unwrap_or_default().to_lowercase();
        variable.shape.len() >= 3
            && ["liquid water", "cloud water"].iter().any(|words| described.contains(words))
            && !described.contains("path")
    };
    let find = |fits: &dyn Fn(&Variable) -> bool| variables.iter().find(|variable| fits(variable));
    match find(&standard).or_else(|| find(&customary)).or_else(|| find(&described)) {
        Some(variable) => input.variable(&variable.name),
        None => Err(input.error(
            "liquid water",
            "no variable is identified by its standard_name, name or long_name",
            &format!("specify it with --variable; the file has: {}", input.names().join(", ")),
        )),
    }
}

/// Liquid water content (g/m3) in the window, converted from the units of the file.
fn concentration(
    input: &Input,
    water: &Variable,
    layout: &Layout,
    window: &Window,
    settings: &ImportSettings,
) -> Result<Array3<f32>> {
    let units = water.text("units").unwrap_or_default();
    let mut values = layout.read(water, window)?;
    match units.replace(['*', '^', ' '], "").replace("**", "").as_str() {
        "gm-3" | "g/m3" => {}
        "kgm-3" | "kg/m3" => values *= 1e3,
        unit @ ("kgkg-1" | "kg/kg" | "gkg-1" | "g/kg" | "1" | "") => {
            let factor = if matches!(unit, "gkg-1" | "g/kg") { 1.0 } else { 1e3 };
            values *= &air_density(input, water, window, settings)?;
            values *= factor;
        }
        _ => {
            return Err(water.error(
                format!("has units \"{units}\""),
                "give it in g m-3, kg m-3, kg kg-1 or g kg-1",
            ));
        }
    }
    for ((k, j, i), value) in values.indexed_iter_mut() {
        if !(value.is_finite() && *value >= -UNDERSHOOT) {
            return Err(water.error(
                format!("is {value} g/m3 in the part that was read, at [z {k}, y {j}, x {i}]"),
                "liquid water must be finite and not negative: choose another part of the file",
            ));
        }
        *value = value.max(0.0);
    }
    Ok(values)
}

/// The density of air (kg/m3), in a shape that can be broadcast to a field `[z, y, x]`.
fn air_density(
    input: &Input,
    water: &Variable,
    window: &Window,
    settings: &ImportSettings,
) -> Result<Array3<f32>> {
    if let Some(density) = settings.air_density {
        return Ok(Array3::from_elem((1, 1, 1), density as f32));
    }
    let is_density = |name: &&String| {
        DENSITY_NAMES.contains(&name.to_lowercase().as_str())
            || input.variable(name).ok().and_then(|found| found.text("standard_name")).as_deref()
                == Some("air_density")
    };
    let names = input.names();
    let Some(name) = names.iter().find(is_density) else {
        return Err(water.error(
            "is a mixing ratio, and the file has no density of air",
            "give one with --air-density (kg/m3)",
        ));
    };
    let density = input.variable(name)?;
    let kinds: Vec<_> = (0..density.shape.len())
        .map(|axis| density.dimension(axis).and_then(|name| kind_of(input, name)))
        .collect();
    if kinds.len() >= 3 {
        return Layout::of(input, &density)?.read(&density, window);
    }
    let ranges = match kinds.as_slice() {
        [Some(Kind::Z)] => vec![window.levels.clone()],
        [Some(Kind::Time), Some(Kind::Z)] => {
            vec![window.time..window.time + 1, window.levels.clone()]
        }
        _ => return Err(density.error("is not a profile or a field", "give --air-density")),
    };
    if ranges.iter().zip(&density.shape).any(|(range, &length)| range.end > length) {
        return Err(density.error("has fewer values than the water", "give --air-density"));
    }
    let profile = density.reals_at::<f32>(&ranges)?.into_raw_vec_and_offset().0;
    let levels = profile.len();
    Ok(Array3::from_shape_vec((levels, 1, 1), profile).expect("one value per level"))
}

/// Effective radius (um) from the file, if it has one with the shape of the liquid water.
fn effective_radius(
    input: &Input,
    water: &Variable,
    layout: &Layout,
    window: &Window,
) -> Result<Option<Array3<f32>>> {
    let names = input.names();
    let Some(name) = names.iter().find(|name| RADIUS_NAMES.contains(&name.to_lowercase().as_str()))
    else {
        return Ok(None);
    };
    let radius = input.variable(name)?;
    if radius.shape != water.shape {
        return Ok(None);
    }
    let factor = match radius.text("units").as_deref() {
        Some("um" | "micrometer" | "micrometre" | "micron" | "microns") => 1.0,
        Some("m") => 1e6,
        found => {
            return Err(radius.error(
                format!("has units {found:?}"),
                "give it in um or m, or give the number of droplets with --droplets",
            ));
        }
    };
    Ok(Some(layout.read(&radius, window)? * factor))
}
