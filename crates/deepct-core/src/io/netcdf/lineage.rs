//! What a file keeps of the one from which it was made: the time of the field and the history.

use super::write::{Attribute::Text, Attributes, Output};
use super::{Input, Variable};
use crate::error::Result;
use std::path::Path;

/// Longest history that is kept (bytes).
const LONGEST: usize = 30_000;

/// The time of a field, and what was done to it before.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Lineage {
    /// The time of the field, if it is known.
    pub time: Option<Time>,
    /// One line for each command, the last one first, as NCO and CDO write it; empty if unknown.
    pub history: String,
}

/// A time as the file states it.
#[derive(Debug, Clone, PartialEq)]
pub struct Time {
    /// The number in `units`.
    pub value: f64,
    /// The units, such as "seconds since 2004-01-01"; empty if the file has none.
    pub units: String,
    /// The calendar; empty if the file has none.
    pub calendar: String,
}

impl Lineage {
    /// The same with the line of a command, such as "cloud import les.nc". It has no date, so that
    /// repeated runs write the same bytes.
    pub fn then(mut self, command: &str) -> Self {
        let line = format!("deepct {}: {}", env!("CARGO_PKG_VERSION"), command.replace('\n', " "));
        self.history = match self.history.trim_end() {
            "" => line,
            before => format!("{line}\n{before}"),
        };
        let end = (0..=LONGEST).rev().find(|end| self.history.is_char_boundary(*end));
        self.history.truncate(end.unwrap_or(0));
        self
    }
}

impl Time {
    /// The time in a coordinate at an index; `None` if it is no number.
    pub(crate) fn at(axis: &Variable, index: usize) -> Option<Self> {
        let range = match axis.shape[..] {
            [] => Vec::new(),
            [length] => {
                let index = index.min(length.checked_sub(1)?);
                std::iter::once(index..index + 1).collect()
            }
            _ => return None,
        };
        let values = axis.values_at::<f64>(&range, 1.0, f64::NAN).ok()?;
        let value = values.into_iter().next().filter(|value| value.is_finite())?;
        let text = |name: &str| axis.text(name).unwrap_or_default();
        let units = text("units");
        let (unit, since) = units.split_once(" since ").unwrap_or((&units, ""));
        if since.is_empty() || is_date(since) {
            return Some(Self { value, units, calendar: text("calendar") });
        }
        // Programs refuse a whole file with a date that does not exist, such as UCLA-LES's 2000-00-00.
        Some(Self { value, units: unit.to_owned(), calendar: String::new() })
    }
}

/// Whether the month and the day at the beginning of a text exist in some calendar.
fn is_date(text: &str) -> bool {
    let date = text.trim().trim_start_matches('-').split(['T', ' ']).next().unwrap_or_default();
    let mut numbers = date.splitn(3, '-').skip(1).map(|part| part.parse::<u32>().unwrap_or(0));
    let [month, day] = [numbers.next(), numbers.next()];
    month.is_none_or(|month| (1..=12).contains(&month))
        && day.is_none_or(|day| (1..=31).contains(&day))
}

/// Read the lineage of a file; that of a file of an unknown format is empty.
pub fn read_lineage(path: impl AsRef<Path>) -> Lineage {
    let Ok(input) = Input::open(path.as_ref()) else { return Lineage::default() };
    let time = input.variable("time").ok().filter(|time| time.shape.is_empty());
    let time = time.and_then(|time| Time::at(&time, 0));
    Lineage { time, history: input.text("history").unwrap_or_default() }
}

/// Write the lineage into a file that was begun.
pub(super) fn put_lineage(output: &Output, lineage: &Lineage) -> Result<()> {
    if !lineage.history.is_empty() {
        output.global(&[("history", Text(&lineage.history))])?;
    }
    let Some(Time { value, units, calendar }) = &lineage.time else { return Ok(()) };
    let attributes: Vec<_> = [
        ("units", Text(units)),
        ("calendar", Text(calendar)),
        ("long_name", Text("time of the field")),
        ("standard_name", Text(if units.contains("since") { "time" } else { "" })),
        ("axis", Text("T")),
    ]
    .into_iter()
    .filter(|attribute| !matches!(attribute.1, Text("")))
    .collect();
    let attributes: &Attributes = &attributes;
    output.scalar("time", *value, attributes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_that_do_not_exist_are_found() {
        for date in ["2004-12-31 00:00:00", "1-1-1", "1900-01-01T00:00Z", "-0044-03-15", "1970"] {
            assert!(is_date(date), "{date}");
        }
        for date in ["2000-00-00 0000", "2000-13-01", "2000-01-32", "2000-01-day"] {
            assert!(!is_date(date), "{date}");
        }
    }
}
