//! Which variable of a simulation is the liquid water of its clouds: by its CF `standard_name`, by a
//! customary name or by its `long_name`.

use super::ImportSettings;
use super::axes::{Layout, leaf};
use crate::error::{Error, Result};
use crate::io::netcdf::{Input, Variable};
use crate::io::plausible::Checks;
use crate::io::units::Unit;

/// Customary names of cloud liquid water, the first of which takes precedence.
const WATER_NAMES: [&str; 14] = [
    "lwc", "clwc", "ρqᶜˡ", "ql", "qc", "qcloud", "cldliq", "qcl", "rl", "rc", "ql_3d", "qᶜˡ", "qˡ",
    "qn",
];
/// Customary names of the extinction.
const EXTINCTION_NAMES: [&str; 4] = ["extinction", "ext", "beta", "component1_extinction"];

/// Names of the bins of a droplet spectrum without their numbers, which start at 01: those of the
/// spectral bin microphysics of WRF (Khain et al. 2004).
const BIN_NAMES: [&str; 2] = ["ff1i", "FF1I"];

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

/// The variables that describe the cloud.
pub(super) enum Field {
    /// Liquid water.
    Water(String),
    /// The liquid water of each bin of a droplet spectrum.
    Bins(Vec<String>),
    /// Extinction.
    Extinction(String),
}

impl Field {
    /// The first variable.
    pub(super) fn name(&self) -> &str {
        match self {
            Self::Water(name) | Self::Extinction(name) => name,
            Self::Bins(names) => &names[0],
        }
    }
}

/// The variables that describe the cloud: the bins of a spectrum, otherwise liquid water, otherwise
/// the extinction.
///
/// # Errors
/// Returns an error if none or several are found.
pub(super) fn find_field(
    input: &Input,
    settings: &ImportSettings,
    checks: &mut Checks,
) -> Result<Field> {
    let bins = find_bins(input, settings);
    if !bins.is_empty() {
        checks.note(format!("droplet spectrum: {} to {}", bins[0], bins[bins.len() - 1]));
        return Ok(Field::Bins(bins));
    }
    let is_extinction = |variable: &Variable| {
        let unit = variable.unit_text().as_deref().and_then(Unit::parse);
        let known = EXTINCTION_NAMES.contains(&leaf(&variable.name).to_lowercase().as_str());
        let per_length = Unit::parse("km-1").expect("a unit");
        unit.map_or(known, |unit| unit.factor_to(&per_length).is_some())
    };
    if let Some(name) = &settings.variable {
        let named = input.variable(name)?;
        if is_extinction(&named) {
            return Ok(Field::Extinction(named.name));
        }
    }
    let find_extinction = || {
        let names = input.names();
        let mut variables = names.iter().filter_map(|name| input.variable(name).ok());
        variables.find(|variable| {
            EXTINCTION_NAMES.contains(&leaf(&variable.name).to_lowercase().as_str())
                && is_extinction(variable)
                && Layout::of(input, variable).is_ok()
        })
    };
    match find_water(input, settings, checks) {
        Ok(water) => {
            if let (None, Some(extinction)) = (&settings.variable, find_extinction()) {
                checks.note(format!(
                    "left out: {0} (--variable {0} imports it in place of liquid water)",
                    extinction.name
                ));
            }
            Ok(Field::Water(water.name))
        }
        Err(problem) => {
            find_extinction().map(|variable| Field::Extinction(variable.name)).ok_or(problem)
        }
    }
}

/// The description of a variable: its `long_name`, or the attribute that some models write instead.
pub(super) fn description(variable: &Variable) -> String {
    let mut texts = ["long_name", "longname", "description"].iter();
    texts.find_map(|name| variable.text(name)).unwrap_or_default()
}

/// The unit of a liquid water variable without one, according to its name.
pub(super) fn assumed_unit(name: &str) -> Option<&'static str> {
    let name = leaf(name).to_lowercase();
    let per_volume = ["ρ", "rho"].iter().any(|prefix| name.starts_with(prefix));
    let per_mass = name.starts_with('q') || ["cldliq", "rl", "rc", "l"].contains(&name.as_str());
    if per_volume { Some("kg m-3") } else { per_mass.then_some("kg kg-1") }
}

/// The variable that contains cloud liquid water.
fn find_water<'a>(
    input: &'a Input,
    settings: &ImportSettings,
    checks: &mut Checks,
) -> Result<Variable<'a>> {
    let water = match &settings.variable {
        Some(name) => input.variable(name)?,
        None => identify_water(input, checks)?,
    };
    let described = description(&water);
    let words = described.to_lowercase();
    let with_ice = words.split(|letter: char| !letter.is_alphabetic()).any(|word| word == "ice");
    if with_ice || leaf(&water.name).eq_ignore_ascii_case("qn") {
        let described = described.trim();
        checks.warn(format!(
            "{} contains water and ice (\"{described}\"); all of it is read as liquid water",
            water.name
        ));
    }
    Ok(water)
}

fn identify_water<'a>(input: &'a Input, checks: &mut Checks) -> Result<Variable<'a>> {
    // A variable whose units are missing or not understood may be the one; the error says so.
    let possible = |variable: &Variable| {
        let unit = variable.unit_text().as_deref().and_then(Unit::parse);
        unit.is_none_or(|unit| is_density(&unit) || unit.is_mass_ratio())
            && !is_other_water(
                &variable.text("standard_name").unwrap_or_default(),
                &description(variable),
            )
    };
    let variables: Vec<_> = input
        .names()
        .iter()
        .filter_map(|name| input.variable(name).ok())
        .filter(|variable| possible(variable))
        .collect();
    let standard = |variable: &Variable| {
        variable.text("standard_name").is_some_and(|name| {
            name.contains("cloud_liquid_water")
                && !["effective_radius", "content", "path", "number", "area"]
                    .iter()
                    .any(|word| name.contains(word))
        })
    };
    let rank = |variable: &Variable| {
        WATER_NAMES.iter().position(|name| *name == leaf(&variable.name).to_lowercase())
    };
    let described = |variable: &Variable| {
        let described = description(variable).to_lowercase();
        ["liquid water", "cloud water"].iter().any(|words| described.contains(words))
            && !described.contains("path")
    };
    let mut fallback = None;
    let customary = |variable: &Variable| rank(variable).is_some();
    let methods: [&dyn Fn(&Variable) -> bool; 3] = [&standard, &customary, &described];
    for fits in methods {
        let found: Vec<_> = variables.iter().filter(|variable| fits(variable)).collect();
        // Profiles and sections do not have all axes.
        let mut fields: Vec<_> = found
            .iter()
            .filter(|variable| Layout::of(input, variable).is_ok())
            .map(|variable| (rank(variable).unwrap_or(usize::MAX), &variable.name))
            .collect();
        fields.sort();
        let names = || fields[1..].iter().map(|(_, name)| name.as_str()).collect::<Vec<_>>();
        match fields.as_slice() {
            [] => {}
            [(_, name)] => return input.variable(name),
            [(usize::MAX, name), ..] => {
                return Err(input.error(
                    name,
                    format!("may be the liquid water, but so may {}", names().join(", ")),
                    "choose with --variable",
                ));
            }
            [(_, name), ..] => {
                checks.warn(format!(
                    "the liquid water is read from {name}, not from {}; --variable chooses",
                    names().join(", ")
                ));
                return input.variable(name);
            }
        }
        fallback = fallback.or(found.first().filter(|found| found.shape.len() >= 3).copied());
    }
    match fallback {
        Some(variable) => input.variable(&variable.name),
        None => Err(unusable(input).unwrap_or_else(|| {
            input.error(
                "liquid water",
                "no variable is identified by its standard_name, name or long_name",
                &format!("specify it with --variable; the file has: {}", input.names().join(", ")),
            )
        })),
    }
}

/// An error about a variable that cannot be used, which may be the liquid water.
fn unusable(input: &Input) -> Option<Error> {
    let refused = input.names().iter().find_map(|name| input.variable(name).err());
    input.unreadable().or(refused)
}

/// Whether the CF `standard_name` or the `long_name` of a variable is that of another quantity than
/// the liquid water of clouds.
fn is_other_water(standard: &str, long: &str) -> bool {
    let words = |text: &str| -> Vec<String> {
        let letters = |letter: char| !letter.is_alphabetic();
        text.to_lowercase().split(letters).map(str::to_owned).collect()
    };
    let has = |words: &[String], any: &[&str]| any.iter().any(|one| words.iter().any(|w| w == one));
    let (standard_words, long_words) = (words(standard), words(long));
    let others = ["ice", "rain", "snow", "graupel", "hail", "vapor", "vapour", "condensed"];
    // A standard name may be followed by a modifier, such as standard_error.
    standard.trim().contains(' ')
        || has(&standard_words, &others)
        || has(&standard_words, &["tendency", "flux", "rate"])
        || has(&long_words, &["tendency", "perturbation"])
        || (has(&long_words, &others) && !has(&long_words, &["cloud", "liquid", "water"]))
        || (has(&long_words, &["rain", "snow", "graupel", "hail"]) && !has(&long_words, &["cloud"]))
        || (has(&long_words, &["ice"]) && !has(&long_words, &["liquid", "water"]))
}

/// Whether a unit is one of mass by volume.
pub(super) fn is_density(unit: &Unit) -> bool {
    Unit::parse("kg m-3").is_some_and(|density| unit.factor_to(&density).is_some())
}
