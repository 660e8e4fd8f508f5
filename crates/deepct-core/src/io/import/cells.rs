//! The cells of a simulation along its axes: their faces from CF bounds, from the axis of the faces
//! that the model writes beside that of the centres, from geopotential heights, or from the centres.

use super::axes::{Kind, Layout, are_faces, check_is_length, coordinate, kind_of, leaf};
use crate::error::Result;
use crate::grid::resample;
use crate::io::netcdf::{
    Input, Variable, bounds, coordinates, coordinates_at, edge_and_spacing, first_and_spacing,
};
use crate::io::plausible::Checks;
use ndarray::{Array2, ArrayD, Axis};

/// Acceleration of gravity by which WRF divides geopotentials (m s-2).
const GRAVITY: f64 = 9.81;
/// Numbers without units are metres if their steps are at least this, and kilometres otherwise.
const METRES: f64 = 1.0;
/// Largest difference between the heights of a level above the columns, relative to its thickness, that
/// is not mentioned.
const SLOPE: f64 = 0.05;

/// The cells along an axis in ascending order.
pub(super) struct Cells {
    /// Their faces (km), one more than cells.
    pub(super) faces: Vec<f64>,
    /// Whether the file has them in descending order.
    pub(super) descends: bool,
    /// The number of cells at the start of the axis that lie below the ground. They are not in `faces`.
    pub(super) below: usize,
}

impl Cells {
    /// The number of cells.
    pub(super) fn count(&self) -> usize {
        self.faces.len() - 1
    }

    /// The mean size of a cell (km).
    pub(super) fn step(&self) -> f64 {
        (self.faces[self.count()] - self.faces[0]) / self.count() as f64
    }

    /// Cells of one size (km) from `start` (km) on.
    pub(super) fn uniform(start: f64, size: f64, count: usize) -> Self {
        Self::ascending(resample::uniform_edges(start, size, count))
    }

    fn ascending(mut faces: Vec<f64>) -> Self {
        let descends = faces.first() > faces.last();
        if descends {
            faces.reverse();
        }
        Self { faces, descends, below: 0 }
    }
}

/// The cells along x or y. A single one without bounds has the given `size` (km); `None` if that is
/// unknown.
///
/// # Errors
/// Returns an error if the axis has no coordinate, or one that is not uniform or not a length.
pub(super) fn horizontal(
    input: &Input,
    layout: &Layout,
    water: &Variable,
    kind: Kind,
    size: Option<f64>,
    checks: &mut Checks,
) -> Result<Option<Cells>> {
    let (name, count) = (layout.name(kind), layout.length(water, kind));
    let Some(axis) = coordinate(input, name, kind) else {
        if let Some(cells) = edges_alone(input, water, kind, count)? {
            return Ok(Some(cells));
        }
        return steps_of_wrf(input, water, kind, name, count, checks).map(Some);
    };
    check_count(&axis, count)?;
    if let Some(cells) = of_own_layout(input, &axis)? {
        return Ok(Some(cells));
    }
    check_is_length(input, water, &axis.name)?;
    let values = coordinates(&axis)?;
    let kilometre = length_unit(&axis, &values, checks)?;
    let faces = match (bounds(input, &axis, &values)?, values.len()) {
        (Some(faces), _) => {
            first_and_spacing(&axis, &faces)?;
            faces
        }
        (None, 1) => return Ok(single(&axis, kilometre * values[0], size, checks)),
        (None, count) => {
            let (first, spacing) = first_and_spacing(&axis, &values)?;
            resample::uniform_edges(first - 0.5 * spacing, spacing, count)
        }
    };
    check_steps(&axis, &faces)?;
    let cells = Cells::ascending(faces.into_iter().map(|face| kilometre * face).collect());
    if cells.descends {
        checks.note(format!("{}: descends, and is read from its end", axis.name));
    }
    Ok(Some(cells))
}

/// The levels, without those below the ground. A single one without bounds has the given `size` (km);
/// `None` if that is unknown.
///
/// # Errors
/// As [`horizontal`], but the levels need not be uniform; also returns an error if all of them are
/// below the ground.
pub(super) fn vertical(
    input: &Input,
    layout: &Layout,
    water: &Variable,
    time: usize,
    size: Option<f64>,
    checks: &mut Checks,
) -> Result<Option<Cells>> {
    let (name, count) = (layout.name(Kind::Z), layout.length(water, Kind::Z));
    let Some(axis) = coordinate(input, name, Kind::Z) else {
        if let Some(cells) = edges_alone(input, water, Kind::Z, count)? {
            return above_ground(water, cells, checks).map(Some);
        }
        let Some(faces) = heights_of_wrf(input, time, count, checks)? else {
            return Err(water.error(
                format!("has an axis \"{name}\" without altitudes"),
                "add a variable of this name with the altitudes of the levels and their units",
            ));
        };
        return above_ground(water, Cells::ascending(faces), checks).map(Some);
    };
    check_count(&axis, count)?;
    if let Some(cells) = of_own_layout(input, &axis)? {
        return above_ground(water, cells, checks).map(Some);
    }
    check_is_length(input, water, &axis.name)?;
    let values = coordinates_at(&axis, time)?;
    let kilometre = length_unit(&axis, &values, checks)?;
    let given = match bounds(input, &axis, &values)? {
        Some(faces) => {
            checks.note(format!("levels: bounds of {}", axis.name));
            Some(faces.into_iter().map(|face| kilometre * face).collect())
        }
        None => None,
    };
    let mut centres: Vec<_> = values.iter().map(|value| kilometre * value).collect();
    let descends = centres.first() > centres.last();
    if descends {
        centres.reverse();
        checks.note(format!("{}: descends, and is read from its end", axis.name));
    }
    if !centres.is_sorted_by(|a, b| a < b) {
        return Err(axis
            .error("neither ascends nor descends", "write the altitudes of the levels in order"));
    }
    let faces: Vec<f64> = match given {
        Some(faces) => faces,
        None => match between_faces(input, &axis, &centres, kilometre) {
            Some((name, faces)) => {
                checks.note(format!("levels: {} between the faces {name}", axis.name));
                faces
            }
            None if count == 1 => return Ok(single(&axis, centres[0], size, checks)),
            None => around_centres(&axis, &centres, checks)?,
        },
    };
    let cells = Cells { descends, ..Cells::ascending(faces) };
    above_ground(water, cells, checks).map(Some)
}

/// A single cell of the assumed size (km) around its centre; `None` if there is none.
fn single(axis: &Variable, centre: f64, size: Option<f64>, checks: &mut Checks) -> Option<Cells> {
    let size = size?;
    checks.warn(format!(
        "{} has a single value without bounds; its cell is taken to be {:.0} m wide",
        axis.name,
        1e3 * size
    ));
    Some(Cells::ascending(vec![centre - 0.5 * size, centre + 0.5 * size]))
}

/// The cells of a coordinate with the attributes of deepct's own layout.
fn of_own_layout(input: &Input, axis: &Variable) -> Result<Option<Cells>> {
    if axis.shape.len() != 1
        || axis.number("lower_edge").is_none()
        || axis.number("spacing").is_none()
    {
        return Ok(None);
    }
    let (edge, spacing) = edge_and_spacing(input, axis)?;
    Ok(Some(Cells::uniform(edge, spacing, axis.shape[0])))
}

fn check_count(axis: &Variable, count: usize) -> Result<()> {
    if axis.shape.last() == Some(&count) {
        return Ok(());
    }
    let problem = format!("has {:?} values for an axis of {count}", axis.shape);
    Err(axis.error(problem, "write one coordinate per cell"))
}

fn check_steps(axis: &Variable, faces: &[f64]) -> Result<()> {
    if faces[0] != faces[1] {
        return Ok(());
    }
    Err(axis.error("has the same value everywhere", "write the coordinates of the cells"))
}

/// The factor that converts the values of a coordinate to km. Without units it follows from the size
/// of the steps.
fn length_unit(axis: &Variable, values: &[f64], checks: &mut Checks) -> Result<f64> {
    let step = values.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(f64::NAN, f64::min);
    if axis.unit_text().is_some() || step.is_nan() {
        return axis.factor_to("km");
    }
    let (unit, factor) = if step >= METRES { ("m", 1e-3) } else { ("km", 1.0) };
    checks.warn(format!(
        "{} has no units; its steps of {} are taken to be in {unit} (--units {}=m states them)",
        axis.name,
        (1e6 * step).round() / 1e6,
        axis.name
    ));
    Ok(factor)
}

/// The cells of an axis that has faces, but no centres, as in the files of the I3RC model.
fn edges_alone(input: &Input, water: &Variable, kind: Kind, count: usize) -> Result<Option<Cells>> {
    let are_edges = |variable: &Variable, kind| {
        variable.shape.len() == 1
            && are_faces(&variable.name)
            && kind_of(input, &variable.name) == Some(kind)
    };
    let names = input.names();
    let find = |kind| {
        let mut variables = names.iter().filter_map(|name| input.variable(name).ok());
        variables.find(|variable| are_edges(variable, kind))
    };
    let Some(edges) = find(kind).filter(|edges| edges.shape == [count + 1]) else {
        return Ok(None);
    };
    if edges.unit_text().is_none() {
        let axes = [Kind::X, Kind::Y, Kind::Z].map(find);
        let mut options: Vec<_> =
            axes.iter().flatten().map(|axis| format!("--units {}=m", axis.name)).collect();
        if water.unit_text().is_none() {
            options.push(format!("--units {}=m-1", water.name));
        }
        let remedy = format!("state the units of its numbers, such as {}", options.join(" "));
        let problem = "has no units, and files of this model are in m or in km";
        return Err(edges.error(problem, &remedy));
    }
    let kilometre = edges.factor_to("km")?;
    let values = coordinates(&edges)?;
    if kind != Kind::Z {
        first_and_spacing(&edges, &values)?;
    }
    let cells = Cells::ascending(values.into_iter().map(|face| kilometre * face).collect());
    if !cells.faces.is_sorted_by(|a, b| a < b) {
        let problem = "neither ascends nor descends";
        return Err(edges.error(problem, "write the faces of the cells in order"));
    }
    Ok(Some(cells))
}

/// The cells along x or y in files of WRF, which have the attributes DX and DY in place of
/// coordinates.
fn steps_of_wrf(
    input: &Input,
    water: &Variable,
    kind: Kind,
    name: &str,
    count: usize,
    checks: &mut Checks,
) -> Result<Cells> {
    let attribute = if kind == Kind::X { "DX" } else { "DY" };
    match input.number(attribute) {
        Some(metres) if metres > 0.0 && metres.is_finite() => {
            checks.note(format!("{}: {attribute} = {metres} m, from 0", leaf(name)));
            Ok(Cells::uniform(0.0, 1e-3 * metres, count))
        }
        _ => Err(water.error(
            format!("has an axis \"{name}\" without coordinates"),
            &format!(
                "add a variable {} with the coordinates of the cells and their units",
                if name.is_empty() { "for it" } else { name }
            ),
        )),
    }
}

/// The heights of the faces of the levels (km) in files of WRF: the mean geopotential of the columns
/// divided by the acceleration of gravity.
fn heights_of_wrf(
    input: &Input,
    time: usize,
    count: usize,
    checks: &mut Checks,
) -> Result<Option<Vec<f64>>> {
    if !input.has("PH") || !input.has("PHB") {
        return Ok(None);
    }
    let columns = |name: &str| -> Result<Array2<f64>> {
        let variable = input.variable(name)?;
        let layout = Layout::of(input, &variable)?;
        let time = layout.check_time(&variable, time)?;
        let ranges: Vec<_> = variable.shape.iter().map(|&length| 0..length).collect();
        let mut own = ranges.clone();
        let faces = format!("{} levels of faces", count + 1);
        let [first, levels, ..] = own.as_mut_slice() else {
            return Err(variable.error(format!("does not have {faces}"), "give it on all axes"));
        };
        *first = time..time + 1;
        if ranges.len() != 4
            || layout.name(Kind::Z) != variable.dimension(1).unwrap_or_default()
            || levels.len() != count + 1
        {
            return Err(variable.error(
                format!("has shape {:?}, not {faces}", variable.shape),
                "write it on (Time, bottom_top_stag, south_north, west_east)",
            ));
        }
        let factor = variable.factor_to("m2 s-2")?;
        let values: ArrayD<f64> = variable.values_at(&own, factor, f64::NAN)?;
        let columns = values.len() / (count + 1);
        Ok(values.into_shape_with_order((count + 1, columns)).expect("the shape was checked"))
    };
    let heights = (columns("PH")? + columns("PHB")?) * (1e-3 / GRAVITY);
    let faces: Vec<_> = heights.mean_axis(Axis(1)).expect("there are columns").to_vec();
    if !faces.is_sorted_by(|a, b| a < b) {
        let problem = "does not ascend, or is missing";
        return Err(input.error("PH, PHB", problem, "give the geopotential of each level"));
    }
    checks.note("levels: (PH + PHB) / 9.81, the mean of the columns");
    let thinnest = faces.windows(2).map(|pair| pair[1] - pair[0]).fold(f64::INFINITY, f64::min);
    let spread = heights.outer_iter().map(|level| {
        let (low, high) = level
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), &v| (a.min(v), b.max(v)));
        high - low
    });
    let spread = spread.fold(0.0, f64::max);
    if spread > SLOPE * thinnest {
        checks.warn(format!(
            "the heights of the levels differ by up to {:.0} m between the columns; their mean is used",
            1e3 * spread
        ));
    }
    Ok(Some(faces))
}

/// The faces (km) between which the ascending `centres` lie, according to another vertical axis of
/// the file: all of them, the lower ones, or the upper ones.
fn between_faces(
    input: &Input,
    axis: &Variable,
    centres: &[f64],
    kilometre: f64,
) -> Option<(String, Vec<f64>)> {
    let count = centres.len();
    let candidates = input.names().into_iter().filter_map(|name| {
        let variable = input.variable(&name).ok()?;
        let vertical = variable.shape.len() == 1
            && name != axis.name
            && kind_of(input, &name) == Some(Kind::Z)
            && [count, count + 1].contains(&variable.shape[0]);
        let factor = match variable.unit_text() {
            _ if !vertical => return None,
            Some(_) => variable.factor_to("km").ok()?,
            None => kilometre,
        };
        let mut faces: Vec<_> =
            coordinates(&variable).ok()?.into_iter().map(|value| factor * value).collect();
        if faces.first() > faces.last() {
            faces.reverse();
        }
        Some((name, faces))
    });
    let lies = |centre: f64, low: f64, high: f64| low <= centre && centre <= high && low < high;
    let enclosed = |faces: &[f64]| {
        centres.iter().zip(faces.windows(2)).all(|(centre, face)| lies(*centre, face[0], face[1]))
    };
    let mut found: Vec<(String, Vec<f64>)> = candidates
        .filter_map(|(name, faces)| {
            if faces.len() == count + 1 {
                return enclosed(&faces).then_some((name, faces));
            }
            // The outermost face lies opposite to the one on the other side of its centre.
            let last = count - 1;
            let mut lower = faces.clone();
            lower.push(2.0 * centres[last] - faces[last]);
            let mut upper = vec![2.0 * centres[0] - faces[0]];
            upper.extend(faces);
            // A level on the ground has no lower half.
            let from = usize::from(upper[0] == upper[1]);
            let above = centres.iter().zip(upper.windows(2)).skip(from);
            let fits = above.clone().all(|(c, face)| lies(*c, face[0], face[1]) && *c < face[1]);
            match enclosed(&lower) && centres.iter().zip(&lower).skip(1).all(|(c, f)| f < c) {
                true => Some((name, lower)),
                false => (fits && above.len() > 0).then_some((name, upper)),
            }
        })
        .collect();
    // The complete ones take precedence, then those in the group of the centres.
    let group = |name: &str| name.len() - leaf(name).len();
    found.sort_by_key(|(name, faces)| (faces.len() != count + 1, group(name) != group(&axis.name)));
    found.into_iter().next()
}

/// The faces (km) around ascending centres without any others: uniform ones, or halfway between the
/// centres.
fn around_centres(axis: &Variable, centres: &[f64], checks: &mut Checks) -> Result<Vec<f64>> {
    // The lowest level of some models is on the ground, half a cell below the first centre.
    if let [first, second, third, ..] = *centres {
        let half = (third - second) - 2.0 * (second - first);
        if first == 0.0 && half.abs() <= 1e-3 * (third - second) {
            let mut faces = vec![0.0];
            faces.extend(around_centres(axis, &centres[1..], checks)?);
            faces[1] = 0.0;
            return Ok(faces);
        }
    }
    if let Ok((first, spacing)) = first_and_spacing(axis, centres) {
        return Ok(resample::uniform_edges(first - 0.5 * spacing, spacing, centres.len()));
    }
    let mut faces = resample::edges(centres)?;
    let name = &axis.name;
    if centres[0] > 0.0 && faces[0] < 0.0 {
        faces[0] = 0.0;
        checks.note(format!(
            "levels: {name}, assumed: the lowest from the ground, the others halfway"
        ));
    } else {
        checks.note(format!("levels: {name}, assumed: faces halfway between the centres"));
    }
    Ok(faces)
}

/// The cells without those below the ground at altitude 0.
fn above_ground(water: &Variable, mut cells: Cells, checks: &mut Checks) -> Result<Cells> {
    let below = cells.faces[1..].iter().take_while(|face| **face <= 1e-9).count();
    if below == cells.count() {
        let problem = "has no level above the ground (altitude 0)";
        return Err(water.error(problem, "write altitudes above the ground, with positive numbers"));
    }
    if below > 0 {
        let levels = if below == 1 { "the lowest level" } else { "the lowest levels" };
        checks.note(format!("left out: {levels}, below the ground (number: {below})"));
        cells.faces.drain(..below);
        cells.below = below;
    }
    if cells.faces[0] < 0.0 {
        checks.warn(format!(
            "the lowest level reaches down to {:.4} km, below the ground; a grid from --base 0 on leaves \
             that part out",
            cells.faces[0]
        ));
    }
    Ok(cells)
}
