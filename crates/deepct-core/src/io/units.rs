//! Units of variables, in the spellings of the UDUNITS library and of common programs.
//!
//! A unit is a product of powers: `kg m-3`, `kg.m**-3`, `kg/m^3`, `kilogram / meter ** 3`, and of
//! numbers: `1e-5 kg/kg`, `0.001 g kg-1`.

/// Number of base units: metre, kilogram, second, kelvin, radian. The radian is one of them so that
/// a radiance (sr-1) is distinguished from a plain number.
const BASES: usize = 5;

/// Largest power in a unit; larger numbers are not powers.
const LARGEST_POWER: i32 = 9;

/// A unit: a multiple of a product of base units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Unit {
    /// The power of each base unit.
    powers: [i32; BASES],
    /// The base units that the text names, including those that cancel, as in kg/kg.
    named: [bool; BASES],
    /// The multiple is `scale * 10^exponent`; powers of ten are kept apart so that they are exact.
    scale: f64,
    exponent: i32,
    /// Whether the text contains a number other than 1.
    has_number: bool,
}

/// A symbol or name: its base units, its scale and its power of ten.
type Entry = (&'static str, [i32; BASES], f64, i32);

const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// Symbols, which are case-sensitive and may have a prefix.
const SYMBOLS: [Entry; 9] = [
    ("m", [1, 0, 0, 0, 0], 1.0, 0),
    ("g", [0, 1, 0, 0, 0], 1.0, -3),
    ("s", [0, 0, 1, 0, 0], 1.0, 0),
    ("K", [0, 0, 0, 1, 0], 1.0, 0),
    ("Pa", [-1, 1, -2, 0, 0], 1.0, 0),
    ("J", [2, 1, -2, 0, 0], 1.0, 0),
    ("W", [2, 1, -3, 0, 0], 1.0, 0),
    ("rad", [0, 0, 0, 0, 1], 1.0, 0),
    ("sr", [0, 0, 0, 0, 2], 1.0, 0),
];

/// Symbols that have no prefix.
const FIXED: [Entry; 12] = [
    ("%", [0; BASES], 1.0, -2),
    ("mb", [-1, 1, -2, 0, 0], 1.0, 2),
    ("mbar", [-1, 1, -2, 0, 0], 1.0, 2),
    ("mkm", [1, 0, 0, 0, 0], 1.0, -6),
    ("°", [0, 0, 0, 0, 1], DEGREE, 0),
    ("deg", [0, 0, 0, 0, 1], DEGREE, 0),
    ("degK", [0, 0, 0, 1, 0], 1.0, 0),
    ("min", [0, 0, 1, 0, 0], 60.0, 0),
    ("h", [0, 0, 1, 0, 0], 3600.0, 0),
    ("hr", [0, 0, 1, 0, 0], 3600.0, 0),
    ("d", [0, 0, 1, 0, 0], 86400.0, 0),
    ("l", [3, 0, 0, 0, 0], 1.0, -3),
];

/// Names, which may have a prefix, a capital letter and a plural s.
const NAMES: [Entry; 16] = [
    ("metre", [1, 0, 0, 0, 0], 1.0, 0),
    ("meter", [1, 0, 0, 0, 0], 1.0, 0),
    ("micron", [1, 0, 0, 0, 0], 1.0, -6),
    ("gram", [0, 1, 0, 0, 0], 1.0, -3),
    ("gramme", [0, 1, 0, 0, 0], 1.0, -3),
    ("second", [0, 0, 1, 0, 0], 1.0, 0),
    ("minute", [0, 0, 1, 0, 0], 60.0, 0),
    ("hour", [0, 0, 1, 0, 0], 3600.0, 0),
    ("day", [0, 0, 1, 0, 0], 86400.0, 0),
    ("kelvin", [0, 0, 0, 1, 0], 1.0, 0),
    ("pascal", [-1, 1, -2, 0, 0], 1.0, 0),
    ("bar", [-1, 1, -2, 0, 0], 1.0, 5),
    ("percent", [0; BASES], 1.0, -2),
    ("degree", [0, 0, 0, 0, 1], DEGREE, 0),
    ("radian", [0, 0, 0, 0, 1], 1.0, 0),
    ("steradian", [0, 0, 0, 0, 2], 1.0, 0),
];

/// Prefixes of symbols, and of names.
const PREFIXES: [(&str, &str, i32); 10] = [
    ("n", "nano", -9),
    ("u", "micro", -6),
    ("\u{b5}", "micro", -6),
    ("m", "milli", -3),
    ("c", "centi", -2),
    ("d", "deci", -1),
    ("h", "hecto", 2),
    ("k", "kilo", 3),
    ("M", "mega", 6),
    ("G", "giga", 9),
];

/// The factor that converts a number in one unit to one in another; `None` if they are units of
/// different quantities, or if one is not understood.
pub fn unit_factor(from: &str, to: &str) -> Option<f64> {
    Unit::parse(from)?.factor_to(&Unit::parse(to)?)
}

impl Unit {
    /// The unit of a plain number.
    const ONE: Self = Self {
        powers: [0; BASES],
        named: [false; BASES],
        scale: 1.0,
        exponent: 0,
        has_number: false,
    };

    /// The unit with this text; `None` if it is not understood.
    pub(crate) fn parse(text: &str) -> Option<Self> {
        let text = plain(text);
        let mut parser = Parser { rest: &text };
        let unit = parser.product()?;
        parser.rest.is_empty().then_some(unit)
    }

    /// The factor that converts a number in this unit to one in another unit; `None` if they are
    /// units of different quantities.
    pub(crate) fn factor_to(&self, other: &Self) -> Option<f64> {
        if self.powers != other.powers {
            return None;
        }
        let ten = |power: i32| 10_f64.powi(power);
        let exponent = self.exponent - other.exponent;
        let scale = self.scale / other.scale;
        Some(if exponent < 0 { scale / ten(-exponent) } else { scale * ten(exponent) })
    }

    /// Whether the text contains a number other than 1, by which the values are to be multiplied. Some
    /// programs write one and values that are already multiplied by it.
    pub(crate) fn has_number(&self) -> bool {
        self.has_number
    }

    /// Whether this may be the unit of a ratio of masses: of a plain number, or mass per mass.
    pub(crate) fn is_mass_ratio(&self) -> bool {
        let [length, _, time, temperature, angle] = self.named;
        self.powers == [0; BASES] && !(length || time || temperature || angle)
    }

    fn times(self, other: Self, power: i32) -> Option<Self> {
        let mut product = self;
        for base in 0..BASES {
            product.powers[base] += power * other.powers[base];
            product.named[base] |= other.named[base];
        }
        product.scale *= other.scale.powi(power);
        product.exponent += power * other.exponent;
        product.has_number |= other.has_number;
        let extreme = |value: i32| value.abs() > 100;
        let is_number = product.scale > 0.0 && product.scale.is_finite();
        let is_extreme = product.powers.into_iter().any(extreme) || extreme(product.exponent);
        (is_number && !is_extreme).then_some(product)
    }

    fn of((_, powers, scale, exponent): Entry, prefix: i32) -> Self {
        let named = powers.map(|power| power != 0);
        Self { powers, named, scale, exponent: exponent + prefix, has_number: false }
    }

    /// The unit of a symbol or name.
    fn named(word: &str) -> Option<Self> {
        let find =
            |table: &[Entry], name: &str| table.iter().copied().find(|(known, ..)| *known == name);
        if let Some(entry) = find(&FIXED, word).or_else(|| find(&SYMBOLS, word)) {
            return Some(Self::of(entry, 0));
        }
        for (prefix, _, power) in PREFIXES {
            let entry = word.strip_prefix(prefix).and_then(|symbol| find(&SYMBOLS, symbol));
            if let Some(entry) = entry {
                return Some(Self::of(entry, power));
            }
        }
        let word = word.to_lowercase();
        let long = |word: &str| {
            let singular = word.strip_suffix('s').unwrap_or(word);
            find(&NAMES, word).or_else(|| find(&NAMES, singular))
        };
        if let Some(entry) = long(&word) {
            return Some(Self::of(entry, 0));
        }
        PREFIXES.into_iter().find_map(|(_, prefix, power)| {
            let entry = word.strip_prefix(prefix).and_then(long)?;
            Some(Self::of(entry, power))
        })
    }
}

/// The text with one spelling of each sign: superscripts become powers, `**` becomes `^`, products
/// are written with `.`, and quotients with `/`.
fn plain(text: &str) -> String {
    let mut plain = String::with_capacity(text.len());
    let mut raised = false;
    for letter in text.trim().chars() {
        let superscript = "⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺".chars().position(|known| known == letter);
        if superscript.is_some() && !raised {
            plain.push('^');
        }
        raised = superscript.is_some();
        match (superscript, letter) {
            (Some(position), _) => plain.push(b"0123456789-+"[position].into()),
            (_, '\u{3bc}') => plain.push('\u{b5}'),
            (_, '\u{2212}') => plain.push('-'),
            (_, '·' | '⋅' | '×') => plain.push('.'),
            (_, '{' | '}') => {}
            (_, letter) => plain.push(letter),
        }
    }
    plain.replace("**", "^").replace('*', ".").replace(" per ", "/")
}

/// Reads a unit from left to right.
struct Parser<'a> {
    rest: &'a str,
}

impl Parser<'_> {
    fn skip_spaces(&mut self) {
        self.rest = self.rest.trim_start();
    }

    fn take(&mut self, sign: char) -> bool {
        let rest = self.rest.strip_prefix(sign);
        self.rest = rest.unwrap_or(self.rest);
        rest.is_some()
    }

    /// Factors, of which `/` divides by the next one only. A number is the first one or a divisor, because
    /// that in `m-3.5` is not one.
    fn product(&mut self) -> Option<Unit> {
        let mut product = Unit::ONE;
        let mut sign = 1;
        let mut may_be_number = true;
        loop {
            let (factor, power) = self.factor(may_be_number)?;
            product = product.times(factor, sign * power)?;
            self.skip_spaces();
            sign = 1;
            may_be_number = false;
            if self.take('/') {
                sign = -1;
                may_be_number = true;
            } else if !self.take('.') && (self.rest.is_empty() || self.rest.starts_with(')')) {
                return Some(product);
            }
            self.skip_spaces();
        }
    }

    /// A unit and its power.
    fn factor(&mut self, may_be_number: bool) -> Option<(Unit, i32)> {
        self.skip_spaces();
        let unit = if self.take('(') {
            let unit = self.product()?;
            self.take(')').then_some(unit)?
        } else if may_be_number && self.rest.starts_with(|letter: char| letter.is_ascii_digit()) {
            let scale = self.number()?;
            Unit { scale, has_number: scale != 1.0, ..Unit::ONE }
        } else {
            let word = |letter: char| letter.is_alphabetic() || "%°_".contains(letter);
            let end = self.rest.find(|letter| !word(letter)).unwrap_or(self.rest.len());
            let (name, rest) = self.rest.split_at(end);
            self.rest = rest;
            Unit::named(name)?
        };
        let after = self.rest.trim_start();
        if let Some(power) = after.strip_prefix('^') {
            self.rest = power.trim_start();
            let bracket = self.take('(');
            let power = self.power()?;
            return (!bracket || self.take(')')).then_some((unit, power));
        }
        match self.rest.chars().next() {
            Some('0'..='9' | '-' | '+') => Some((unit, self.power()?)),
            _ => Some((unit, 1)),
        }
    }

    /// A positive number, such as 1e-5 or 0.001. The e of an exponent is followed by digits.
    fn number(&mut self) -> Option<f64> {
        let digits = |text: &str| text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
        let mut end = digits(self.rest);
        if let Some(fraction) = self.rest[end..].strip_prefix('.') {
            // Otherwise the point is a sign of multiplication.
            let count = digits(fraction);
            let is_exponent = fraction.starts_with(['e', 'E']);
            end += if count > 0 || is_exponent { 1 + count } else { 0 };
        }
        if let Some(exponent) = self.rest[end..].strip_prefix(['e', 'E']) {
            let unsigned = exponent.strip_prefix(['-', '+']).unwrap_or(exponent);
            let count = digits(unsigned);
            end += if count > 0 { 1 + exponent.len() - unsigned.len() + count } else { 0 };
        }
        let (number, rest) = self.rest.split_at(end);
        self.rest = rest;
        number.parse().ok().filter(|number| *number > 0.0 && f64::is_finite(*number))
    }

    fn power(&mut self) -> Option<i32> {
        let digits = self.rest.trim_start_matches(['-', '+']);
        let end = digits.find(|letter: char| !letter.is_ascii_digit()).unwrap_or(digits.len());
        let end = self.rest.len() - digits.len() + end;
        let (number, rest) = self.rest.split_at(end);
        self.rest = rest;
        let power: i32 = number.parse().ok()?;
        (power.abs() <= LARGEST_POWER && !rest.starts_with(char::is_alphabetic)).then_some(power)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Spellings, the unit to which they are converted, and the factor.
    const SPELLINGS: [(&str, &str, f64); 88] = [
        ("kg m-3", "g m-3", 1e3),
        ("kg m^-3", "g m-3", 1e3),
        ("kg m**-3", "g m-3", 1e3),
        ("kg m**(-3)", "g m-3", 1e3),
        ("kg m^{-3}", "g m-3", 1e3),
        ("kg m⁻³", "g m-3", 1e3),
        ("kg/m3", "g m-3", 1e3),
        ("kg/m^3", "g m-3", 1e3),
        ("kg/m**3", "g m-3", 1e3),
        ("kg/m³", "g m-3", 1e3),
        ("kg / m3", "g m-3", 1e3),
        ("kg.m-3", "g m-3", 1e3),
        ("kg*m-3", "g m-3", 1e3),
        ("kg*m^-3", "g m-3", 1e3),
        ("kg·m-3", "g m-3", 1e3),
        ("m-3 kg", "g m-3", 1e3),
        ("m-3.kg", "g m-3", 1e3),
        ("kilogram / meter ** 3", "g m-3", 1e3),
        ("kilograms per m3", "g m-3", 1e3),
        ("kg/(m^3)", "g m-3", 1e3),
        ("kg (m^3)^-1", "g m-3", 1e3),
        ("kg/m/m/m", "g m-3", 1e3),
        ("  kg m-3   ", "g m-3", 1e3),
        ("g m-3", "g m-3", 1.0),
        ("gram/meter^3", "g m-3", 1.0),
        ("g.m-3", "g m-3", 1.0),
        ("g/m+3", "g m-3", 1.0),
        ("mg m-3", "g m-3", 1e-3),
        ("mg/m^3", "g m-3", 1e-3),
        ("ug m-3", "g m-3", 1e-6),
        ("µg m-3", "g m-3", 1e-6),
        ("g cm-3", "g m-3", 1e6),
        ("g/l", "kg m-3", 1.0),
        ("kg dm-3", "kg m-3", 1e3),
        ("kg kg-1", "1", 1.0),
        ("kg/kg", "1", 1.0),
        ("kg kg**-1", "1", 1.0),
        ("kg.kg-1", "1", 1.0),
        ("g/kg", "1", 1e-3),
        ("g kg-1", "1", 1e-3),
        ("g/kg      ", "1", 1e-3),
        ("mg/kg", "1", 1e-6),
        ("gram/kilogram", "1", 1e-3),
        ("1", "1", 1.0),
        ("%", "1", 1e-2),
        ("percent", "1", 1e-2),
        ("um", "um", 1.0),
        ("\u{b5}m", "um", 1.0),
        ("\u{3bc}m", "um", 1.0),
        ("mkm", "um", 1.0),
        ("micron", "um", 1.0),
        ("microns", "um", 1.0),
        ("Micron", "um", 1.0),
        ("micrometer", "um", 1.0),
        ("micrometers", "um", 1.0),
        ("micrometre", "um", 1.0),
        ("micrometres", "um", 1.0),
        ("m", "um", 1e6),
        ("mm", "um", 1e3),
        ("nm", "um", 1e-3),
        ("cm", "m", 1e-2),
        ("km", "m", 1e3),
        ("Kilometers", "m", 1e3),
        ("metres", "km", 1e-3),
        ("m-1", "km-1", 1e3),
        ("1/m", "km-1", 1e3),
        ("1 / km", "km-1", 1.0),
        ("Mm-1", "km-1", 1e-3),
        ("mb", "Pa", 1e2),
        ("hPa", "Pa", 1e2),
        ("millibars", "Pa", 1e2),
        ("kg m-1 s-2", "pascal", 1.0),
        ("degK", "kelvin", 1.0),
        ("degrees", "deg", 1.0),
        ("mW m-2 sr-1 nm-1", "W m-2 sr-1 um-1", 1.0),
        ("kg m-3 s-1", "g/m3/h", 3.6e6),
        ("1e-5kg/kg", "1", 1e-5),
        ("1e-5 kg kg-1", "1", 1e-5),
        ("1E-05.kg/kg", "1", 1e-5),
        ("10^-5 kg/kg", "1", 1e-5),
        ("10-5 kg/kg", "1", 1e-5),
        ("0.001 g/kg", "1", 1e-6),
        ("1.E-5 kg/kg", "1", 1e-5),
        ("1.kg m-3", "g m-3", 1e3),
        ("1000 kg m-3", "g m-3", 1e6),
        ("10 um", "um", 10.0),
        ("1m", "m", 1.0),
        ("kg/(1000 m3)", "g m-3", 1.0),
    ];

    /// Texts that are not units, or whose meaning is not certain.
    const WRONG: [&str; 25] = [
        "",
        " ",
        "kgm-3",
        "gm-3",
        "KG M-3",
        "kg m -3",
        "kg m-",
        "kg m--3",
        "kg/",
        "/kg",
        "kg//m3",
        "kg m-3)",
        "(kg m-3",
        "0 kg m-3",
        "1e kg m-3",
        "1e999 kg m-3",
        "-1 kg m-3",
        "1 e",
        "furlong",
        "kg m-99",
        "kg m-3.5",
        "m-3kg",
        "none",
        "-",
        "seconds since 2000-01-01",
    ];

    #[test]
    fn spellings_are_understood_and_their_factors_are_exact() {
        for (text, other, factor) in SPELLINGS {
            let unit = Unit::parse(text).unwrap_or_else(|| panic!("{text:?} is not understood"));
            let found = unit.factor_to(&Unit::parse(other).unwrap());
            let found = found.unwrap_or_else(|| panic!("{text:?} is not a unit like {other}"));
            let hours = text.ends_with("s-1") && other.ends_with("/h");
            let has_number = unit.has_number();
            let tolerance = if hours || has_number { 1e-12 * factor } else { 0.0 };
            assert!((found - factor).abs() <= tolerance, "{text:?}: {found} {other}, not {factor}");
        }
    }

    #[test]
    fn other_texts_are_not_units() {
        for text in WRONG {
            assert_eq!(Unit::parse(text), None, "{text:?}");
        }
    }

    #[test]
    fn units_of_different_quantities_are_not_converted() {
        for (one, other) in [
            ("kg m-3", "kg kg-1"),
            ("kg m-3 s-1", "kg m-3"),
            ("m", "m-1"),
            ("Pa", "kg m-3"),
            ("1", "sr-1"),
            ("degree", "K"),
            ("W m-2 sr-1 um-1", "sr-1"),
        ] {
            let [one, other] = [one, other].map(|text| Unit::parse(text).unwrap());
            assert_eq!(one.factor_to(&other), None);
        }
    }

    #[test]
    fn a_ratio_of_volumes_is_not_one_of_masses() {
        for text in ["1", "%", "kg/kg", "g kg-1"] {
            assert!(Unit::parse(text).unwrap().is_mass_ratio(), "{text}");
        }
        for text in ["m3 m-3", "cm3/m3", "s s-1", "kg m-3", "rad"] {
            assert!(!Unit::parse(text).unwrap().is_mass_ratio(), "{text}");
        }
    }
}
