//! Which variable of a simulation is the liquid water of its clouds: by its CF `standard_name`, by a
//! customary name or by its `long_name`.

use super::ImportSettings;
use super::axes::Layout;
use crate::error::Result;
use crate::io::netcdf::{Input, Variable};
use crate::io::plausible::Checks;
use crate::io::units::Unit;

/// Customary names of cloud liquid water, the first of which takes precedence.
const WATER_NAMES: [&str; 11] =
    ["lwc", "clwc", "ql", "qc", "qcloud", "cldliq", "qcl", "rl", "rc", "ql_3d", "qn"];

/// Names of the bins of a droplet spectrum without their numbers, which start at 01: those of the
/// spectral bin microphysics of WRF (Khain et al. 2004).
const BIN_NAMES: [&str; 2] = ["ff1i", "FF1I"];

/// The names of the bins of a droplet spectrum, in order. The list is empty if the file has none,
/// or if the settings specify a variable or a droplet number concentration.
pub(super) fn find_bins(input: &Input, settings: &ImportSettings) -> Vec<String> {
    if settings.variable.is_some() || settings.droplets_per_cm3.is_some() {
        return Vec::new();
    }
    let names = input.names();
    let bins = |prefix: &str| -> Vec<String> {
        (1..).map(|bin| format!("{prefix}{bin:02}")).take_while(|bin| names.contains(bin)).collect()
    };
    BIN_NAMES.into_iter().map(bins).find(|bins| !bins.is_empty()).unwrap_or_default()
}

/// The variable that contains cloud liquid water.
pub(super) fn find_water<'a>(
    input: &'a Input,
    settings: &ImportSettings,
    checks: &mut Checks,
) -> Result<Variable<'a>> {
    let water = match &settings.variable {
        Some(name) => input.variable(name)?,
        None => identify_water(input, checks)?,
    };
    let described = water.text("long_name").unwrap_or_default();
    let words = described.to_lowercase();
    let with_ice = words.split(|letter: char| !letter.is_alphabetic()).any(|word| word == "ice");
    if with_ice || water.name.eq_ignore_ascii_case("qn") {
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
                &variable.text("long_name").unwrap_or_default(),
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
        WATER_NAMES.iter().position(|name| *name == variable.name.to_lowercase())
    };
    let described = |variable: &Variable| {
        let described = variable.text("long_name").unwrap_or_default().to_lowercase();
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
        None => Err(input.error(
            "liquid water",
            "no variable is identified by its standard_name, name or long_name",
            &format!("specify it with --variable; the file has: {}", input.names().join(", ")),
        )),
    }
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
