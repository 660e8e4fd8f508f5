//! The axes of the variables of a simulation, and the part of them that is read.

use crate::error::Result;
use crate::grid::Grid;
use crate::io::netcdf::{Input, Variable};
use crate::io::units::Unit;
use ndarray::{Array3, Axis, Slice};
use std::ops::Range;

/// The physical dimension of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Time,
    Z,
    Y,
    X,
    /// Another axis, of length one.
    Single,
}

/// Customary names of dimensions and of the coordinates of cell centres, without the group.
const CENTRES: [(Kind, &[&str]); 4] = [
    (Kind::Time, &["t", "time", "times", "record"]),
    (
        Kind::Z,
        &[
            "z",
            "zt",
            "zc",
            "zh",
            "zu",
            "zu_3d",
            "z_aac",
            "nk",
            "height",
            "altitude",
            "lev",
            "level",
            "bottom_top",
            "z-grid",
        ],
    ),
    (Kind::Y, &["y", "yt", "yc", "yh", "y_aca", "nj", "south_north", "y-grid"]),
    (Kind::X, &["x", "xt", "xc", "xh", "x_caa", "ni", "west_east", "x-grid"]),
];
/// Those of the faces between cells.
const FACES: [(Kind, &[&str]); 3] = [
    (
        Kind::Z,
        &[
            "zm",
            "zf",
            "zw",
            "zw_3d",
            "zi",
            "z_aaf",
            "zhalf",
            "z_half",
            "nkp1",
            "bottom_top_stag",
            "z-edges",
        ],
    ),
    (Kind::Y, &["ym", "yf", "yv", "y_afa", "njp1", "south_north_stag", "y-edges"]),
    (Kind::X, &["xm", "xf", "xu", "x_faa", "nip1", "west_east_stag", "x-edges"]),
];

/// The kinds and names of the axes of a variable, and which of them are read from their end.
pub(super) struct Layout {
    kinds: Vec<Kind>,
    names: Vec<String>,
    reversed: Vec<bool>,
}

/// The part of a file that is read: a time, levels, and columns in up to two pieces along each
/// horizontal axis. Indices count upwards, northwards and eastwards.
pub(super) struct Window {
    pub(super) time: usize,
    pub(super) levels: Range<usize>,
    pub(super) rows: Vec<Range<usize>>,
    pub(super) cols: Vec<Range<usize>>,
}

impl Layout {
    pub(super) fn of(input: &Input, variable: &Variable) -> Result<Self> {
        let mut layout = Self { kinds: Vec::new(), names: Vec::new(), reversed: Vec::new() };
        for (axis, &length) in variable.shape.iter().enumerate() {
            let name = variable.dimension(axis).unwrap_or_default().to_owned();
            let kind = match kind_of(input, &name) {
                Some(kind) => kind,
                None if length == 1 => Kind::Single,
                None if name.is_empty() => {
                    return Err(variable.error(
                        format!("has axes without names, of the lengths {:?}", variable.shape),
                        "state their order and the sizes of the cells (km) with --axes and --spacing \
                         of `cloud import`, such as --axes z,y,x --spacing 0.05,0.05,0.04",
                    ));
                }
                None => {
                    check_is_length(input, variable, &name)?;
                    return Err(variable.error(
                        format!("has an axis {axis} (\"{name}\") that is not time, z, y or x"),
                        "give its coordinate variable the attribute `axis`: T, Z, Y or X",
                    ));
                }
            };
            if let (Some(place), true) = (layout.place(kind), kind != Kind::Single) {
                return Err(two_axes(variable, kind, [&layout.names[place], &name]));
            }
            layout.push(kind, name, false);
        }
        match [Kind::Z, Kind::Y, Kind::X].iter().find(|kind| !layout.kinds.contains(kind)) {
            None => Ok(layout),
            Some(kind) => {
                Err(variable.error(format!("has no axis {kind:?}"), "give a 3D variable"))
            }
        }
    }

    fn push(&mut self, kind: Kind, name: String, reversed: bool) {
        self.kinds.push(kind);
        self.names.push(name);
        self.reversed.push(reversed);
    }

    fn place(&self, kind: Kind) -> Option<usize> {
        self.kinds.iter().position(|known| *known == kind)
    }

    /// The name of an axis; empty if there is no such axis.
    pub(super) fn name(&self, kind: Kind) -> &str {
        self.place(kind).map_or("", |place| self.names[place].as_str())
    }

    /// The length of a variable along an axis.
    pub(super) fn length(&self, variable: &Variable, kind: Kind) -> usize {
        self.place(kind).map_or(1, |place| variable.shape[place])
    }

    /// Read an axis from its end.
    pub(super) fn reverse(&mut self, kind: Kind) {
        if let Some(place) = self.place(kind) {
            self.reversed[place] = true;
        }
    }

    /// The names of the axes in their order.
    pub(super) fn text(&self) -> String {
        self.names.iter().map(|name| leaf(name)).collect::<Vec<_>>().join(", ")
    }

    pub(super) fn check_time(&self, variable: &Variable, time: usize) -> Result<usize> {
        let times = self.length(variable, Kind::Time);
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
        let mut layout = Self { kinds: Vec::new(), names: Vec::new(), reversed: Vec::new() };
        for (axis, &length) in variable.shape.iter().enumerate() {
            let name = variable.dimension(axis).unwrap_or_default();
            let named = |known: &String| known == name && !name.is_empty();
            match self.names.iter().position(named) {
                Some(place) => {
                    layout.push(self.kinds[place], name.to_owned(), self.reversed[place]);
                }
                None if length == 1 => layout.push(Kind::Single, name.to_owned(), false),
                None => {
                    let names = self.names.join(", ");
                    let problem =
                        format!("has the axis \"{name}\", but the liquid water has ({names})");
                    return Err(variable.error(problem, or_else));
                }
            }
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
                let time = window.time..window.time + 1;
                let ranges = [time, levels.clone(), rows.clone(), cols.clone(), 0..1];
                let piece = self.read_piece(variable, &ranges, factor, missing)?;
                let mut place = values.slice_axis_mut(Axis(1), Slice::from(row..row + rows.len()));
                place.slice_axis_mut(Axis(2), Slice::from(col..col + cols.len())).assign(&piece);
                col += cols.len();
            }
            row += rows.len();
        }
        Ok(values)
    }

    /// The values in the ranges along time, z, y, x and another axis.
    fn read_piece(
        &self,
        variable: &Variable,
        ranges: &[Range<usize>; 5],
        factor: f64,
        missing: f32,
    ) -> Result<Array3<f32>> {
        let stored: Vec<_> = (0..self.kinds.len())
            .map(|axis| {
                let range = ranges[self.kinds[axis] as usize].clone();
                let length = variable.shape[axis];
                let from_end = |index: usize| length.saturating_sub(index);
                if self.reversed[axis] { from_end(range.end)..from_end(range.start) } else { range }
            })
            .collect();
        let mut values = variable.values_at::<f32>(&stored, factor, f64::from(missing))?;
        let mut kinds = Vec::new();
        for (axis, &kind) in self.kinds.iter().enumerate() {
            if self.reversed[axis] {
                values.invert_axis(Axis(kinds.len()));
            }
            if matches!(kind, Kind::Time | Kind::Single) {
                values = values.index_axis_move(Axis(kinds.len()), 0);
            } else {
                kinds.push(kind);
            }
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

/// Returns an error if the coordinate `name` of a field is in the unit of another quantity than a length,
/// such as a pressure or a latitude.
pub(super) fn check_is_length(input: &Input, field: &Variable, name: &str) -> Result<()> {
    let text = input.variable(name).ok().and_then(|axis| axis.unit_text()).unwrap_or_default();
    // The units of latitudes and longitudes are degrees_north and degrees_east.
    let unit = Unit::parse(text.split('_').next().unwrap_or_default());
    let [length, number] = ["m", "1"].map(|text| Unit::parse(text).expect("a unit"));
    if unit.is_none_or(|unit| unit == number || unit.factor_to(&length).is_some()) {
        return Ok(());
    }
    let problem = format!("has the axis {name} in \"{text}\", which is no length");
    let remedy = format!(
        "interpolate the field to altitudes and distances in m; only if the unit is wrong, state it with \
         --units {name}=\"km\""
    );
    Err(field.error(problem, &remedy))
}

/// An error about two axes of one kind, one of which may be that of the faces.
fn two_axes(variable: &Variable, kind: Kind, names: [&str; 2]) -> crate::error::Error {
    let faces = names.into_iter().find(|name| are_faces(name));
    match faces {
        Some(faces) => variable.error(
            format!(
                "has the axes {} and {}, of which {faces} is that of the faces between cells, as if \
                 tiles of a model had been joined along it",
                names[0], names[1]
            ),
            "join them with xarray.open_mfdataset(..., data_vars=\"minimal\") or with `cdo collgrid`",
        ),
        None => variable.error(
            format!("has two axes that look like {kind:?}: {} and {}", names[0], names[1]),
            "give their coordinate variables the attribute `axis`: T, Z, Y or X",
        ),
    }
}

/// The last part of a name, after those of its groups.
pub(super) fn leaf(name: &str) -> &str {
    name.rsplit('/').next().unwrap_or(name)
}

/// Whether a dimension has a customary name of the faces between cells.
pub(super) fn are_faces(name: &str) -> bool {
    let name = leaf(name).to_lowercase();
    FACES.iter().any(|(_, names)| names.contains(&name.as_str()))
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
    let name = leaf(name).to_lowercase();
    let known = CENTRES.iter().chain(&FACES);
    known.into_iter().find(|(_, names)| names.contains(&name.as_str())).map(|(kind, _)| *kind)
}

/// The coordinate of a dimension: the variable of its name, or another one along it alone that has
/// the attribute `axis` or a customary name.
pub(super) fn coordinate<'a>(
    input: &'a Input,
    dimension: &str,
    kind: Kind,
) -> Option<Variable<'a>> {
    let of_one_axis = |variable: &Variable| variable.shape.len() == 1;
    // A coordinate may depend on the time.
    let of_times = |variable: &Variable| {
        variable.shape.len() == 2
            && variable.dimension(1) == Some(dimension)
            && variable.dimension(0).and_then(|time| kind_of(input, time)) == Some(Kind::Time)
    };
    let own = input.variable(dimension).ok();
    if let Some(own) = own.filter(|own| of_one_axis(own) || of_times(own)) {
        return Some(own);
    }
    let along: Vec<_> = input
        .names()
        .iter()
        .filter_map(|name| input.variable(name).ok())
        .filter(|variable| of_one_axis(variable) && variable.dimension(0) == Some(dimension))
        .filter(|variable| kind_of(input, &variable.name) == Some(kind))
        .collect();
    let has_axis = |variable: &&Variable| variable.text("axis").is_some();
    let found = along.iter().find(has_axis).or_else(|| along.first()).map(|found| &found.name);
    found.and_then(|name| input.variable(name).ok())
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
