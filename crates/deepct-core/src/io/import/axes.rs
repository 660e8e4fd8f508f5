//! The axes of the variables of a simulation, and the part of them that is read.

use crate::error::Result;
use crate::grid::Grid;
use crate::io::netcdf::{Input, Variable};
use ndarray::{Array3, Axis, Slice};
use std::ops::Range;

/// The physical dimension of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Time,
    Z,
    Y,
    X,
}

/// The kinds and names of the axes of a variable.
pub(super) struct Layout {
    kinds: Vec<Kind>,
    names: Vec<String>,
}

/// The part of a file that is read: a time, levels, and columns in up to two pieces along each
/// horizontal axis.
pub(super) struct Window {
    pub(super) time: usize,
    pub(super) levels: Range<usize>,
    pub(super) rows: Vec<Range<usize>>,
    pub(super) cols: Vec<Range<usize>>,
}

impl Layout {
    pub(super) fn of(input: &Input, variable: &Variable) -> Result<Self> {
        let mut layout = Self { kinds: Vec::new(), names: Vec::new() };
        for axis in 0..variable.shape.len() {
            let name = variable.dimension(axis).unwrap_or_default().to_owned();
            let Some(kind) = kind_of(input, &name) else {
                return Err(variable.error(
                    format!("has an axis {axis} (\"{name}\") that is not time, z, y or x"),
                    "give its coordinate variable the attribute `axis`: T, Z, Y or X",
                ));
            };
            if layout.kinds.contains(&kind) {
                return Err(variable.error(
                    format!("has two axes that look like {kind:?}"),
                    "give their coordinate variables the attribute `axis`: T, Z, Y or X",
                ));
            }
            layout.kinds.push(kind);
            layout.names.push(name);
        }
        match [Kind::Z, Kind::Y, Kind::X].iter().find(|kind| !layout.kinds.contains(kind)) {
            None => Ok(layout),
            Some(kind) => {
                Err(variable.error(format!("has no axis {kind:?}"), "give a 3D variable"))
            }
        }
    }

    fn place(&self, kind: Kind) -> Option<usize> {
        self.kinds.iter().position(|known| *known == kind)
    }

    /// The name of an axis; empty if there is no such axis.
    pub(super) fn name(&self, kind: Kind) -> &str {
        self.place(kind).map_or("", |place| self.names[place].as_str())
    }

    pub(super) fn check_time(&self, variable: &Variable, time: usize) -> Result<usize> {
        let times = self.place(Kind::Time).map_or(1, |place| variable.shape[place]);
        if time < times {
            return Ok(time);
        }
        if times == 0 {
            let problem = "has no times: the simulation has not written any";
            return Err(variable.error(problem, "give the file of a run that has"));
        }
        let problem = format!("has {times} times, but number {time} was requested");
        Err(variable.error(problem, &format!("choose --time from 0 to {}", times - 1)))
    }

    /// The axes of another variable, which must be among these, in any order.
    ///
    /// # Errors
    /// Returns an error, with the remedy `or_else`, if the variable has another axis.
    pub(super) fn of_other(&self, variable: &Variable, or_else: &str) -> Result<Self> {
        let mut layout = Self { kinds: Vec::new(), names: Vec::new() };
        for axis in 0..variable.shape.len() {
            let name = variable.dimension(axis).unwrap_or_default();
            let Some(place) = self.names.iter().position(|known| known == name) else {
                let names = self.names.join(", ");
                let problem =
                    format!("has the axis \"{name}\", but the liquid water has ({names})");
                return Err(variable.error(problem, or_else));
            };
            layout.kinds.push(self.kinds[place]);
            layout.names.push(name.to_owned());
        }
        Ok(layout)
    }

    /// The values of a variable in the window, `[z, y, x]`, multiplied by `factor`. An axis that
    /// the variable does not have gets a length of one. Values that the file declares as missing
    /// are replaced by `missing`.
    pub(super) fn read(
        &self,
        variable: &Variable,
        window: &Window,
        factor: f64,
        missing: f32,
    ) -> Result<Array3<f32>> {
        let along = |kind: Kind, pieces: &[Range<usize>]| match self.place(kind) {
            Some(_) => pieces.to_vec(),
            None => std::iter::once(0..1).collect(),
        };
        let count = |pieces: &[Range<usize>]| pieces.iter().map(ExactSizeIterator::len).sum();
        let (rows, cols) = (along(Kind::Y, &window.rows), along(Kind::X, &window.cols));
        let [levels] = &along(Kind::Z, std::slice::from_ref(&window.levels))[..] else {
            unreachable!("levels are read in one piece")
        };
        let mut values = Array3::zeros((levels.len(), count(&rows), count(&cols)));
        let mut row = 0;
        for rows in &rows {
            let mut col = 0;
            for cols in &cols {
                let ranges =
                    [window.time..window.time + 1, levels.clone(), rows.clone(), cols.clone()];
                let piece = self.read_piece(variable, &ranges, factor, missing)?;
                let mut place = values.slice_axis_mut(Axis(1), Slice::from(row..row + rows.len()));
                place.slice_axis_mut(Axis(2), Slice::from(col..col + cols.len())).assign(&piece);
                col += cols.len();
            }
            row += rows.len();
        }
        Ok(values)
    }

    /// The values in the ranges along time, z, y and x.
    fn read_piece(
        &self,
        variable: &Variable,
        ranges: &[Range<usize>; 4],
        factor: f64,
        missing: f32,
    ) -> Result<Array3<f32>> {
        let own: Vec<_> = self.kinds.iter().map(|kind| ranges[*kind as usize].clone()).collect();
        let mut values = variable.values_at::<f32>(&own, factor, f64::from(missing))?;
        let mut kinds = self.kinds.clone();
        if let Some(time) = self.place(Kind::Time) {
            values = values.index_axis_move(Axis(time), 0);
            kinds.remove(time);
        }
        for kind in [Kind::Z, Kind::Y, Kind::X] {
            if !kinds.contains(&kind) {
                values = values.insert_axis(Axis(kinds.len()));
                kinds.push(kind);
            }
        }
        let order: Vec<_> = [Kind::Z, Kind::Y, Kind::X]
            .iter()
            .filter_map(|kind| kinds.iter().position(|known| known == kind))
            .collect();
        let values = values.permuted_axes(order).as_standard_layout().to_owned();
        Ok(values.into_dimensionality().expect("time, z, y and x were distinguished"))
    }
}

/// The kind of a dimension according to the attribute `axis` or the standard name of its
/// coordinate variable, or according to the name of the dimension.
pub(super) fn kind_of(input: &Input, name: &str) -> Option<Kind> {
    let coordinate = input.variable(name).ok();
    let text = |attribute| coordinate.as_ref().and_then(|axis| axis.text(attribute));
    match text("axis").as_deref() {
        Some("T" | "t") => return Some(Kind::Time),
        Some("Z" | "z") => return Some(Kind::Z),
        Some("Y" | "y") => return Some(Kind::Y),
        Some("X" | "x") => return Some(Kind::X),
        _ => {}
    }
    match text("standard_name").as_deref() {
        Some("time") => return Some(Kind::Time),
        Some("altitude" | "height") => return Some(Kind::Z),
        Some("projection_y_coordinate") => return Some(Kind::Y),
        Some("projection_x_coordinate") => return Some(Kind::X),
        _ => {}
    }
    match name.to_lowercase().as_str() {
        "t" | "time" | "times" => Some(Kind::Time),
        "z" | "zt" | "zc" | "zh" | "height" | "altitude" | "lev" | "level" | "bottom_top" => {
            Some(Kind::Z)
        }
        "y" | "yt" | "yc" | "south_north" => Some(Kind::Y),
        "x" | "xt" | "xc" | "west_east" => Some(Kind::X),
        _ => None,
    }
}

/// The levels of a file that the grid requires: those that it overlaps, and one more on either
/// side for interpolation.
pub(super) fn levels_within(z_edges: &[f64], grid: &Grid) -> Range<usize> {
    let count = z_edges.len() - 1;
    let first = z_edges.partition_point(|edge| *edge <= grid.lower().z).saturating_sub(2);
    let last = z_edges.partition_point(|edge| *edge < grid.upper().z) + 1;
    first.min(count - 1)..last.clamp(1, count)
}

/// The ranges of `0..length` that `count` cells from `start` on cover, wrapping at most once.
pub(super) fn pieces(start: usize, count: usize, length: usize) -> Vec<Range<usize>> {
    let end = start + count;
    let both = [start..end.min(length), 0..end.saturating_sub(length)];
    both.into_iter().filter(|piece| !piece.is_empty()).collect()
}
