//! What the numbers stored in a file mean: packing, missing values and valid ranges, according to the
//! netCDF and CF conventions.

use super::Variable;
use super::container::Kind;
use crate::error::Result;

/// The value that the netCDF library assigns to real numbers that were never written.
const UNWRITTEN: f64 = 9.969_209_968_386_869e36;

/// How the stored numbers of a variable represent its values, according to the attributes of the
/// netCDF and CF conventions.
pub(super) struct Coding {
    /// The factor and the term of `value = stored * scale + offset`, if the values are packed.
    pub(super) packing: Option<(f64, f64)>,
    /// The number of stored integers, if negative ones represent large unsigned ones.
    wrap: Option<f64>,
    /// Stored numbers that represent a missing value.
    missing: Vec<f64>,
    /// Unpacked numbers that represent a missing value, and the tolerance of their comparison.
    unpacked_missing: (Vec<f64>, f64),
    /// The range of valid numbers, and whether it refers to unpacked ones.
    valid: (f64, f64, bool),
}

impl Coding {
    /// The coding that the attributes of a variable of the type `kind` declare.
    ///
    /// # Errors
    /// Returns an error if the values are packed by anything but finite numbers, or scaled by zero.
    pub(super) fn of(variable: &Variable, kind: &Kind) -> Result<Self> {
        let scale = variable.finite("scale_factor")?;
        let offset = variable.finite("add_offset")?;
        if scale == Some(0.0) {
            let remedy = "correct the attribute, by which the stored numbers are multiplied";
            return Err(variable.error("has the attribute `scale_factor` = 0", remedy));
        }
        let packed = scale.is_some() || offset.is_some();
        let packing = packed.then(|| (scale.unwrap_or(1.0), offset.unwrap_or(0.0)));
        // Attributes may have another type than the values, so they are rounded to that type.
        let single = matches!(kind, Kind::Float(4));
        let round = |number: f64| if single { f64::from(number as f32) } else { number };
        let numbers =
            |name: &str| -> Vec<f64> { variable.numbers(name).into_iter().map(round).collect() };
        let bits = match kind {
            Kind::Signed(size) | Kind::Unsigned(size) => Some(8 * (*size as i32)),
            _ => None,
        };
        let signed = matches!(kind, Kind::Signed(_));
        let whole = |number: f64| bits.is_none() || number.fract() == 0.0;
        let fill = numbers("_FillValue");
        let mut missing = [fill.clone(), numbers("missing_value")].concat();
        match bits {
            None => missing.push(round(UNWRITTEN)),
            // Bytes have no default, and other integers only if the file states no fill value.
            Some(bits) if bits > 8 && fill.is_empty() => missing.push(match signed {
                true => 1.0 - f64::from(bits - 1).exp2(),
                false => f64::from(bits).exp2() - 1.0,
            }),
            Some(_) => {}
        }
        let unpacked = missing.iter().copied().filter(|number| !whole(*number)).collect();
        let range = match numbers("valid_range").as_slice() {
            [least, most] => vec![*least, *most],
            _ => Vec::new(),
        };
        let bound = |name: &str, index: usize| {
            numbers(name).first().copied().or_else(|| range.get(index).copied())
        };
        let wrap = bits
            .filter(|_| signed && variable.text("_Unsigned").as_deref() == Some("true"))
            .map(|bits| f64::from(bits).exp2());
        let wrapped =
            |number: f64| wrap.filter(|_| number < 0.0).map_or(number, |all| number + all);
        let least = bound("valid_min", 0).map_or(f64::NEG_INFINITY, wrapped);
        let most = bound("valid_max", 1).map_or(f64::INFINITY, wrapped);
        let of_unpacked = packed
            && bits.is_some()
            && ["valid_range", "valid_min", "valid_max"].iter().any(|name| variable.is_real(name));
        Ok(Self {
            packing,
            wrap,
            missing,
            unpacked_missing: (unpacked, 0.5 * scale.unwrap_or(0.0).abs()),
            valid: (least, most, of_unpacked),
        })
    }

    /// The value that a stored number represents; `None` for a missing value, which one outside the valid
    /// range is as well.
    pub(super) fn decode(&self, stored: f64) -> Option<f64> {
        let is = |declared: &f64| *declared == stored || (declared.is_nan() && stored.is_nan());
        if self.missing.iter().any(is) {
            return None;
        }
        let stored = self.wrap.filter(|_| stored < 0.0).map_or(stored, |wrap| stored + wrap);
        let value = self.packing.map_or(stored, |(scale, offset)| stored * scale + offset);
        let (declared, tolerance) = &self.unpacked_missing;
        if declared.iter().any(|declared| (declared - value).abs() <= *tolerance) {
            return None;
        }
        let (least, most, unpacked) = self.valid;
        let checked = if unpacked { value } else { stored };
        (!(checked < least || checked > most)).then_some(value)
    }
}
