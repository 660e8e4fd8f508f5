//! `deepct cloud`: generation and import of clouds.

use crate::config;
use crate::defaults;
use crate::global::Global;
use crate::outcome::Outcome;
use deepct_core::cloud::{
    Cloud, CumulusSettings, FieldSettings, IsolateSettings, LeftOut, cumulus, field,
    isolate_and_count,
};
use deepct_core::io::import::{
    AirDensity, Axes, Crop, ImportReport, ImportSettings, count_times, import_cloud,
};
use deepct_core::io::{Content, Lineage, Provenance, read_content, write_cloud};
use deepct_core::math::DVec3;
use deepct_core::optics::extinction;
use deepct_core::{Error, Result};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Generate a random cloud, or import one from another file
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, clap::Subcommand)]
enum Verb {
    Generate(GenerateArgs),
    Import(Box<ImportArgs>),
}

/// Generate a random cloud
///
/// `deepct config cloud-cumulus` and `deepct config cloud-field` print the settings.
#[derive(Debug, clap::Args)]
struct GenerateArgs {
    /// Kind of cloud: a single cumulus in the centre of its grid, or a periodic field of cumuli
    #[arg(long, value_enum, default_value_t = Kind::Cumulus)]
    kind: Kind,
    #[command(flatten)]
    settings: config::Settings,
    /// File of the cloud to write
    #[arg(long, value_name = "C.nc")]
    out: PathBuf,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Kind {
    Cumulus,
    Field,
}

/// Import a large-eddy simulation (netCDF), arrays of NumPy, MATLAB or a pickle, or a text file of
/// pySHDOM, AT3D, SHDOM or MYSTIC
///
/// Liquid water and axes are identified by CF conventions or by customary names; the command prints
/// from which variable it took each quantity, and what it assumed. The field is resampled onto the
/// requested grid: conservatively onto coarser voxels and from stretched levels, by linear
/// interpolation onto finer voxels.
#[derive(Debug, clap::Args)]
struct ImportArgs {
    /// File to read
    file: PathBuf,
    /// Index of the time step, counted from 0; several as "2:10", which ends before 10, or "all": the
    /// files have the name of --out, or that of FILE in the folder --out, and the number of the step,
    /// as C_0002.nc
    #[arg(long, default_value = "0", value_name = "I|FROM:TO|all", value_parser = times)]
    time: Times,
    /// Columns to read: index of the first one along x and y, and their number; the selection wraps
    /// around the sides of the domain
    #[arg(long, value_name = "X0,Y0,NX,NY", value_parser = crop)]
    crop: Option<Crop>,
    /// Droplet number concentration (1/cm3), from which effective radii are computed; by default
    /// the radii of the file are used, or 100 if it has none
    #[arg(long, value_name = "PER_CM3")]
    droplets: Option<f64>,
    /// Air density, for a mixing ratio: a number (kg/m3), or a profile in a file, such as
    /// "profiles.001.nc:rhobf" or "default.nc:default/rhoref"; by default that of the file, from its
    /// pressure and temperature, or that of the standard atmosphere
    #[arg(long, value_name = "KG_PER_M3|FILE:VARIABLE", value_parser = str::parse::<AirDensity>)]
    air_density: Option<AirDensity>,
    #[command(flatten)]
    selection: Selection,
    /// Voxel size along x, y, z (km), or "file" to keep that of the file
    #[arg(long, value_name = "DX,DY,DZ", default_value = "0.05,0.05,0.04", value_parser = spacing)]
    spacing: Spacing,
    /// Altitude of the bottom of the lowest level (km); by default that of the file
    #[arg(long, value_name = "KM")]
    base: Option<f64>,
    /// Number of levels; by default all levels up to the top of the file
    #[arg(long, value_name = "N")]
    levels: Option<usize>,
    /// The axes of the variables of a file that does not name them, such as one of NumPy or MATLAB, the
    /// slowest one first, which is the reverse of the order of MATLAB; their cells have the size
    /// --spacing
    #[arg(long, value_name = "z,y,x", value_parser = str::parse::<Axes>, requires = "spacing")]
    axes: Option<Axes>,
    /// Accept values far beyond those of clouds with a warning: liquid water above 20 g/m3,
    /// extinctions above 10000 1/km, effective radii outside 1 to 60 um, and densities of air
    /// outside 0.1 to 2 kg/m3
    #[arg(long)]
    allow_implausible: bool,
    /// Write every isolated cloud to a separate file in the folder --out, on a square with this
    /// many columns along each side
    #[arg(long, value_name = "COLUMNS")]
    isolate: Option<usize>,
    /// Omit isolated clouds whose largest liquid water path (g/m2) is less than this
    #[arg(long, value_name = "G_PER_M2", requires = "isolate",
          default_value_t = IsolateSettings::default().water_path)]
    min_water_path: f32,
    /// Omit isolated clouds of fewer columns than this
    #[arg(long, value_name = "COLUMNS", requires = "isolate",
          default_value_t = IsolateSettings::default().columns)]
    min_columns: usize,
    /// File to write; with --isolate, the folder to write to
    #[arg(long, value_name = "C.nc|DIR")]
    out: PathBuf,
}

/// What is read from a file of another program, where it is not identified by itself.
#[derive(Debug, Default, PartialEq, clap::Args)]
pub(crate) struct Selection {
    /// Name of the variable with the liquid water or the extinction, if it is not identified
    /// automatically; one in a group, a structure or a dictionary as "clouds/beta"
    #[arg(long, value_name = "NAME")]
    variable: Option<String>,
    /// Units of the values of a variable, in place of those in the file, such as "ql=kg kg-1"; may
    /// be given several times
    #[arg(long, value_name = "NAME=UNITS", value_parser = units)]
    units: Vec<(String, String)>,
}

/// A time step, or several up to the one before the end; up to the last one if `end` is `None`.
#[derive(Debug, Clone, Copy)]
enum Times {
    One(usize),
    Several { start: usize, end: Option<usize> },
}

/// A voxel size (km), or `None` for that of the file.
#[derive(Debug, Clone, Copy)]
struct Spacing(Option<DVec3>);

pub(crate) fn run(args: &Args, global: &Global) -> Result<Outcome> {
    match &args.verb {
        Verb::Generate(args) => generate(args, global),
        Verb::Import(args) => import(args, global),
    }
}

fn generate(args: &GenerateArgs, global: &Global) -> Result<Outcome> {
    let (cloud, configuration) = match args.kind {
        Kind::Cumulus => {
            let settings: CumulusSettings = args.settings.resolve(defaults::CUMULUS)?;
            (cumulus(&settings, global.seed)?, toml::to_string(&settings))
        }
        Kind::Field => {
            let settings: FieldSettings = args.settings.resolve(defaults::FIELD)?;
            (field(&settings, global.seed)?, toml::to_string(&settings))
        }
    };
    let provenance = Provenance {
        title: "Randomly generated cloud".into(),
        configuration: configuration.expect("plain numbers and text"),
        seed: global.seed,
        ..Provenance::default()
    };
    write(&args.out, &cloud, &provenance, global)
}

fn import(args: &ImportArgs, global: &Global) -> Result<Outcome> {
    let (start, end) = match args.time {
        Times::One(time) => return import_time(args, time, &args.out, global),
        Times::Several { start, end } => (start, end),
    };
    let count = count_times(&args.file, &args.settings(0))?;
    if start >= count || end.is_some_and(|end| end > count) {
        let problem = format!("has {count} times");
        let remedy = format!("choose --time within 0:{count}, or \"all\"");
        return Err(Error::file(&args.file, "time", problem, remedy));
    }
    let is_file = args.out.extension().is_some_and(|ending| ending == "nc");
    let (folder, name) = match (args.isolate, is_file) {
        (None, true) => (args.out.parent().unwrap_or(Path::new("")), args.out.file_stem()),
        _ => (args.out.as_path(), args.file.file_stem()),
    };
    if !is_file {
        std::fs::create_dir_all(folder).map_err(Error::io(folder))?;
    }
    for time in start..end.unwrap_or(count) {
        let name = format!("{}_{time:04}.nc", name.unwrap_or_default().to_string_lossy());
        let out = folder.join(name);
        if !global.quiet && args.isolate.is_none() {
            say!("{}", out.display());
        }
        import_time(args, time, &out, global)?;
    }
    Ok(Outcome::Success)
}

fn import_time(args: &ImportArgs, time: usize, out: &Path, global: &Global) -> Result<Outcome> {
    let (cloud, report) = import_cloud(&args.file, &args.settings(time))?;
    let name = args.file.file_name().unwrap_or_default().to_string_lossy();
    let lineage = report.lineage.clone().then(&format!("cloud import {name} --time {time}"));
    say_import(report, global);
    let provenance = Provenance {
        title: "Cloud imported from another file".into(),
        configuration: toml::to_string(&Resolved::of(args, time, &cloud)).expect("plain numbers"),
        seed: global.seed,
        lineage,
    };
    match args.isolate {
        None => write(out, &cloud, &provenance, global),
        Some(side) => write_isolated(args, side, time, &cloud, &provenance, global),
    }
}

impl ImportArgs {
    fn settings(&self, time: usize) -> ImportSettings {
        ImportSettings {
            time,
            crop: self.crop,
            droplets_per_cm3: self.droplets,
            air_density: self.air_density.clone(),
            variable: self.selection.variable.clone(),
            spacing: self.spacing.0,
            base: self.base,
            levels: self.levels,
            axes: self.axes,
            units: self.selection.units.iter().cloned().collect(),
            allow_implausible: self.allow_implausible,
        }
    }
}

/// Print from which variables the quantities were taken, what was assumed, and what may be wrong.
fn say_import(report: ImportReport, global: &Global) {
    for warning in report.warnings {
        note!("deepct: warning: {warning}");
    }
    if !global.quiet {
        for taken in report.taken {
            say!("{taken}");
        }
    }
}

impl Selection {
    /// The contents of a file of deepct; `None` for a file of another program, and for one from which
    /// something is selected.
    pub(crate) fn own_content(&self, path: &Path) -> Result<Option<Content>> {
        if *self == Self::default() { read_content(path) } else { Ok(None) }
    }

    /// Import a cloud of another program on the voxels of its file.
    /// Returns the cloud, its time and the history of the file.
    pub(crate) fn import_as_it_is(&self, path: &Path, global: &Global) -> Result<(Cloud, Lineage)> {
        let settings = ImportSettings {
            variable: self.variable.clone(),
            spacing: None,
            units: self.units.iter().cloned().collect(),
            ..ImportSettings::default()
        };
        let (cloud, report) = import_cloud(path, &settings)?;
        let lineage = report.lineage.clone();
        say_import(report, global);
        Ok((cloud, lineage))
    }
}

fn write_isolated(
    args: &ImportArgs,
    side: usize,
    time: usize,
    cloud: &Cloud,
    provenance: &Provenance,
    global: &Global,
) -> Result<Outcome> {
    let water_path = args.min_water_path;
    let columns = args.min_columns;
    let settings = IsolateSettings { side, water_path, columns, ..IsolateSettings::default() };
    let (clouds, left_out) =
        isolate_and_count(cloud, &settings).map_err(Error::in_file(&args.file))?;
    std::fs::create_dir_all(&args.out).map_err(Error::io(&args.out))?;
    for (number, isolated) in clouds.iter().enumerate() {
        let path = args.out.join(format!("cloud_{time:04}_{number:03}.nc"));
        write_cloud(&path, &isolated.cloud, provenance)?;
        if global.verbose > 0 && !global.quiet {
            let [row, col] = isolated.corner;
            say!(
                "{}: corner {col},{row}, {} columns, up to {:.0} g/m2",
                path.display(),
                isolated.columns,
                isolated.water_path
            );
        }
    }
    if !global.quiet {
        let plural = if clouds.len() == 1 { "" } else { "s" };
        say!("{} cloud{plural} in {}", clouds.len(), args.out.display());
        say_left_out(&left_out, &settings);
    }
    Ok(Outcome::Success)
}

/// Print how many clouds were left out, and why.
fn say_left_out(left_out: &LeftOut, settings: &IsolateSettings) {
    let LeftOut { small, thin, large } = *left_out;
    let IsolateSettings { side, margin, columns, water_path, .. } = *settings;
    let reasons = [
        (small, format!("of fewer than {columns} columns (--min-columns)")),
        (thin, format!("of less than {water_path} g/m2 (--min-water-path)")),
        (large, format!("wider than {} columns (--isolate)", side.saturating_sub(2 * margin))),
    ];
    let given = reasons.iter().filter(|(count, _)| *count > 0);
    let texts: Vec<_> = given.map(|(count, reason)| format!("{count} {reason}")).collect();
    if !texts.is_empty() {
        say!("{} left out: {}", small + thin + large, texts.join(", "));
    }
}

fn write(path: &Path, cloud: &Cloud, provenance: &Provenance, global: &Global) -> Result<Outcome> {
    write_cloud(path, cloud, provenance)?;
    if global.quiet {
        return Ok(Outcome::Success);
    }
    let extinction = extinction(cloud)?.values;
    let [nz, ny, nx] = cloud.grid.shape;
    let step = cloud.grid.spacing;
    let mut optical_depth = vec![0.0; ny * nx];
    for ((_, j, i), extinction) in extinction.indexed_iter() {
        optical_depth[j * nx + i] += f64::from(*extinction) * step.z;
    }
    let cloudy = optical_depth.iter().filter(|depth| **depth > 0.1).count();
    let [dx, dy, dz] = (1e3 * step).to_array();
    say!("voxels         {nx} x {ny} x {nz} of {dx:.0} x {dy:.0} x {dz:.0} m");
    say!("cloud cover    {:.3}", cloudy as f64 / optical_depth.len() as f64);
    say!("optical depth  at most {:.1}", optical_depth.iter().copied().fold(0.0, f64::max));
    say!("extinction     at most {:.1} km-1", extinction.iter().copied().fold(0.0, f32::max));
    Ok(Outcome::Success)
}

/// Parameters of the run, recorded in the output file.
#[derive(Debug, serde::Serialize)]
struct Resolved<'a> {
    file: &'a Path,
    time: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    crop: Option<[usize; 4]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    droplets_per_cm3: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    air_density: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    variable: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    isolate: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    axes: Option<String>,
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    allow_implausible: bool,
    shape: [usize; 3],
    spacing_km: [f64; 3],
    origin_km: [f64; 3],
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    units: BTreeMap<&'a str, &'a str>,
}

impl<'a> Resolved<'a> {
    fn of(args: &'a ImportArgs, time: usize, cloud: &Cloud) -> Self {
        let Selection { variable, units } = &args.selection;
        Self {
            file: &args.file,
            time,
            crop: args.crop.map(|crop| [crop.x0, crop.y0, crop.nx, crop.ny]),
            droplets_per_cm3: args.droplets,
            air_density: args.air_density.as_ref().map(AirDensity::to_string),
            variable: variable.as_deref(),
            isolate: args.isolate,
            axes: args.axes.map(|axes| axes.to_string()),
            allow_implausible: args.allow_implausible,
            shape: cloud.grid.shape,
            spacing_km: cloud.grid.spacing.to_array(),
            origin_km: cloud.grid.origin.to_array(),
            units: units.iter().map(|(name, unit)| (name.as_str(), unit.as_str())).collect(),
        }
    }
}

fn numbers<T: std::str::FromStr, const N: usize>(text: &str) -> Option<[T; N]> {
    let numbers: Option<Vec<T>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
    numbers?.try_into().ok()
}

fn crop(text: &str) -> std::result::Result<Crop, String> {
    match numbers(text) {
        Some([x0, y0, nx, ny]) => Ok(Crop { x0, y0, nx, ny }),
        None => Err("give four whole numbers: X0,Y0,NX,NY".into()),
    }
}

fn times(text: &str) -> std::result::Result<Times, String> {
    let several = |(start, end): (&str, &str)| {
        let number = |text: &str, default| match text.trim() {
            "" => Some(default),
            text => text.parse().ok().map(Some),
        };
        let (start, end) = (number(start, Some(0))??, number(end, None)?);
        end.is_none_or(|end| end > start).then_some(Times::Several { start, end })
    };
    let found = match text {
        "all" => Some(Times::Several { start: 0, end: None }),
        _ => text.parse().ok().map(Times::One).or_else(|| several(text.split_once(':')?)),
    };
    found.ok_or_else(|| "give an index from 0, a range such as 2:10, or \"all\"".into())
}

fn units(text: &str) -> std::result::Result<(String, String), String> {
    match text.split_once('=') {
        Some((name, unit)) if !name.trim().is_empty() && !unit.trim().is_empty() => {
            Ok((name.trim().into(), unit.trim().into()))
        }
        _ => Err("give the name of a variable and its units, such as \"ql=kg kg-1\"".into()),
    }
}

/// Sizes of voxels from this number on are those in metres.
const LEAST_METRES: f64 = 20.0;

fn spacing(text: &str) -> std::result::Result<Spacing, String> {
    if text == "file" {
        return Ok(Spacing(None));
    }
    match numbers::<f64, 3>(text) {
        Some(spacing) if spacing.iter().any(|size| *size >= LEAST_METRES) => {
            let [x, y, z] = spacing.map(|size| 1e-3 * size);
            Err(format!("the sizes are in km: give {x},{y},{z} for metres"))
        }
        Some(spacing) => Ok(Spacing(Some(DVec3::from_array(spacing)))),
        None => Err("give three numbers in km: DX,DY,DZ, or \"file\"".into()),
    }
}
