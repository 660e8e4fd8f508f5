//! Import of the text formats of pySHDOM, AT3D, SHDOM and MYSTIC, which have one line per voxel with
//! water.
//!
//! A pySHDOM file consists of a comment line, `nx ny nz`, then `dx dy z0 z1 ...` on one line, then
//! rows `i j k lwc reff [veff]`. An AT3D file consists of a comment line, `nx,ny,nz`, `dx,dy`,
//! `z0,z1,...`, a line of column names (`i,j,k,lwc,reff[,veff]` or `x,y,z,...`), then rows. The
//! names may be in any order and in capitals; columns with other names are ignored. Indices start
//! at 0, lengths are in km, liquid water contents in g/m3 and radii in um. The values are given at
//! `(i dx, j dy, z_k)`, which become the centres of voxels. Voxels that are not listed contain no
//! water.
//!
//! A file of SHDOM begins with the title `2 parameter LWC file`, then `nx ny nz`, `dx dy`, the
//! altitudes, the temperatures, and rows `i j k lwc reff` whose indices start at 1. With nz altitudes
//! these are the centres of the levels; with nz + 1, as in the files of the I3RC model, their faces.
//!
//! A file of MYSTIC (libRadtran) begins with `nx ny nz flag` and `dx dy z0 z1 ...` with the nz + 1 faces
//! of the levels. The rows, whose indices start at 1, are `i j k extinction asymmetry albedo` for the
//! flag 1, `i j k extinction reff` for 2 and `i j k lwc reff` for 3, with the extinction in 1/km.
//!
//! Property files of SHDOM have the extinction in 1/km on `nx ny nz`, `dx dy z1 z2 ...`, in rows whose
//! indices start at 1. Those of the type `E` state the temperatures, then albedo and phase function, and
//! have rows `i j k extinction`. Those of the type `T` state a number of phase functions and each of
//! them, and have rows `i j k temperature extinction albedo number`. Those without a type have rows
//! `i j k temperature extinction albedo n chi1 ... chin`. A phase function is the number of its
//! coefficients and the coefficients.

use super::{Crop, ImportReport, ImportSettings, edges_of, grid_over};
use crate::cloud::resample::resample_droplets;
use crate::cloud::{Cloud, EFFECTIVE_VARIANCE, Microphysics};
use crate::error::{Error, Result};
use crate::files;
use crate::grid::resample::{resample, uniform_edges};
use crate::grid::{MAX_VOXELS, Volume};
use crate::io::plausible::Checks;
use crate::memory;
use ndarray::{Array3, Axis};
use std::collections::BTreeMap;
use std::path::Path;

/// The lines of a file with their numbers, from 1.
struct Lines<'a> {
    path: &'a Path,
    lines: Vec<(usize, &'a str)>,
    next: usize,
}

/// The header of a file.
struct Header {
    shape: [usize; 3],
    dx: f64,
    dy: f64,
    /// The altitudes of the centres of the levels, or of their faces.
    z: Vec<f64>,
    columns: Columns,
    /// The index of the first voxel along each axis.
    first: usize,
    format: Format,
}

/// The formats, as far as their rows differ.
#[derive(Clone, Copy, PartialEq)]
enum Format {
    Particles,
    Mystic,
    /// Optical properties of SHDOM.
    Properties,
}

/// The positions of the values in a row, and the number of its fields.
#[derive(Clone, Copy)]
struct Columns {
    /// The indices along x, y, z.
    indices: [usize; 3],
    amount: usize,
    /// What the amount is.
    of: Amount,
    radius: Option<usize>,
    variance: Option<usize>,
    count: usize,
    /// The column with the number of columns that follow it, which is the last of the `count`.
    more: Option<usize>,
}

/// What a row states of the droplets.
#[derive(Clone, Copy, PartialEq)]
enum Amount {
    /// Liquid water content (g/m3).
    Water,
    /// Extinction (1/km).
    Extinction,
}

/// Largest liquid water content (g/m3) that is not taken for an extinction in a column that may contain
/// either.
const LARGEST_WATER: f32 = 5.0;
/// Extinction (1/km) of 1 g/m3 of droplets with an effective radius of 1 um and an extinction efficiency
/// of 2.
const EXTINCTION_PER_WATER: f32 = 1500.0;

/// Read a text file in either format. Effective radii are those of the file unless the settings
/// specify a droplet number concentration. Returns the cloud and a
/// report about it.
///
/// # Errors
/// Returns an error if the file is missing or not in one of these formats, if a line is invalid
/// (the message states its number), or if values are negative, missing or far beyond those of
/// clouds.
pub fn read_text(
    path: impl AsRef<Path>,
    settings: &ImportSettings,
) -> Result<(Cloud, ImportReport)> {
    let path = path.as_ref();
    if let Some(name) = settings.units.keys().next() {
        let problem = "has no named unit: text files are in km, g/m3 and um";
        return Err(Error::file(path, name, problem, "omit --units"));
    }
    let bytes = files::read(path, memory::limit() / 8)?;
    let text = String::from_utf8(bytes).map_err(|_| {
        let remedy = "`formats` lists the supported formats";
        Error::file(path, "file", "is neither HDF5 nor text", remedy)
    })?;
    let mut checks = Checks::new(path, settings.allow_implausible);
    // Spreadsheets write a byte-order mark.
    let mut lines = Lines::new(path, text.trim_start_matches('\u{feff}'));
    let header = lines.header()?;
    let [amount, effective_radius, effective_variance] = lines.rows(&header, &mut checks)?;
    let crop = Crop::of(settings, path, [header.shape[1], header.shape[2]])?;
    let faces = header.z.len() > header.shape[0];
    let z = if faces { header.z.clone() } else { edges_of(&header.z, path, "altitudes")? };
    let axis = |step: f64, first: usize, count| {
        let centre = if faces { 0.0 } else { 0.5 };
        uniform_edges(step * (first as f64 - centre), step, count)
    };
    checks.note(match (faces, header.first) {
        (true, _) => "levels: between the altitudes of the file (nz + 1)",
        (false, 1) => "levels: around the altitudes of the file (nz)",
        (false, _) => "levels: around the altitudes of the file",
    });
    let (y, x) = (axis(header.dy, crop.y0, crop.ny), axis(header.dx, crop.x0, crop.nx));
    let level = (z[z.len() - 1] - z[0]) / (z.len() - 1) as f64;
    checks.lengths([header.dx, header.dy, level], [z[0], z[z.len() - 1]])?;
    let grid = grid_over([&z, &y, &x], settings, path)?;
    checks.grid(&grid)?;
    let cloud = match (header.columns.of, header.columns.radius) {
        (Amount::Extinction, None) => {
            checks.extinction("extinction", &amount)?;
            checks.note("extinction: of the file; its phase functions and albedo are not read");
            if header.format == Format::Properties {
                let least = amount.iter().copied().fold(f32::INFINITY, f32::min);
                checks.warn(format!(
                    "the extinction of a property file of SHDOM contains that of the air if propgen added \
                     Rayleigh scattering; the least value is {least} km-1 (the file of particles from which \
                     it was made has none of the air)"
                ));
            }
            let extinction = resample(&columns(&amount, crop), [&z, &y, &x], &grid)?;
            Cloud::from_extinction(Volume::new(grid, extinction)?)?
        }
        (of, _) => {
            let mut liquid_water_content = amount;
            if of == Amount::Extinction {
                checks.note("liquid water: from extinction and radius, for an efficiency of 2");
                liquid_water_content.zip_mut_with(&effective_radius, |v, radius| {
                    *v *= radius / EXTINCTION_PER_WATER
                });
            }
            let droplets =
                Microphysics { liquid_water_content, effective_radius, effective_variance };
            checks.droplets(&droplets)?;
            let droplets = Microphysics {
                liquid_water_content: columns(&droplets.liquid_water_content, crop),
                effective_radius: columns(&droplets.effective_radius, crop),
                effective_variance: columns(&droplets.effective_variance, crop),
            };
            resample_droplets(&droplets, [&z, &y, &x], &grid)?
        }
    };
    let cloud = match (settings.droplets_per_cm3, cloud.microphysics) {
        (Some(number), Some(droplets)) => Cloud::from_microphysics(
            grid,
            Microphysics::from_droplet_number(droplets.liquid_water_content, number)?,
        )?,
        (_, microphysics) => Cloud { microphysics, ..cloud },
    };
    let (taken, warnings) = checks.into_notes_and_warnings();
    Ok((cloud, ImportReport { taken, warnings, ..ImportReport::default() }))
}

impl<'a> Lines<'a> {
    fn new(path: &'a Path, text: &'a str) -> Self {
        let lines = text
            .lines()
            .enumerate()
            .map(|(index, line)| (index + 1, line.split('#').next().unwrap_or("").trim()))
            .filter(|(_, line)| !line.is_empty())
            .collect();
        Self { path, lines, next: 0 }
    }

    fn error(&self, line: usize, problem: impl Into<String>) -> Error {
        let remedy = "give a text file of pySHDOM, AT3D, SHDOM or MYSTIC; `formats` describes them";
        Error::file(self.path, format!("line {line}"), problem, remedy)
    }

    /// The fields of the next line that is not empty.
    fn cut(&mut self, what: &str) -> Result<(usize, Vec<&'a str>)> {
        let Some(&(number, line)) = self.lines.get(self.next) else {
            let last = self.lines.last().map_or(1, |(number, _)| *number);
            return Err(self.error(last, format!("is the last line, but {what} should follow")));
        };
        self.next += 1;
        Ok((number, fields(line)))
    }

    fn numbers(&mut self, what: &str) -> Result<(usize, Vec<f64>)> {
        let (line, fields) = self.cut(what)?;
        let numbers: Option<Vec<f64>> = fields.iter().map(|field| number(field)).collect();
        numbers
            .map(|numbers| (line, numbers))
            .ok_or_else(|| self.error(line, format!("does not hold {what}")))
    }

    fn header(&mut self) -> Result<Header> {
        let what = "the counts nx, ny, nz";
        let title = self.lines.first().map_or("", |(_, line)| *line).to_lowercase();
        let of_shdom = title.split_whitespace().eq(["2", "parameter", "lwc", "file"]);
        let properties = property_type(&title);
        if properties == Some('p') {
            let problem = "is that of a polarized property file of SHDOM, which is not read";
            let remedy =
                "give the file of particles from which it was made (\"2 parameter LWC file\")";
            return Err(Error::file(self.path, "line 1", problem, remedy));
        }
        // The first line is a comment, with or without the sign of one.
        let words = |fields: &[&str]| fields.iter().any(|field| number(field).is_none());
        if self.lines.len() > 1 && words(&self.cut(what)?.1) {
            self.next = 1;
        } else {
            self.next = 0;
        }
        let (line, counts) = self.numbers(what)?;
        let counts: Option<Vec<usize>> = counts.into_iter().map(whole).collect();
        let (nx, ny, nz, flag) = match counts.as_deref() {
            Some([nx, ny, nz]) => (*nx, *ny, *nz, None),
            Some([nx, ny, nz, flag @ 1..=3]) => (*nx, *ny, *nz, Some(*flag)),
            _ => {
                let problem = "does not hold three counts nx, ny, nz, or also a flag from 1 to 3";
                return Err(self.error(line, problem));
            }
        };
        let has_faces = of_shdom || flag.is_some() || properties.is_some();
        let voxels = nx.checked_mul(ny).and_then(|columns| columns.checked_mul(nz));
        if !voxels.is_some_and(|count| (1..=MAX_VOXELS).contains(&count)) {
            return Err(self.error(line, format!("declares {nx} x {ny} x {nz} voxels")));
        }
        memory::check("memory for the grid", voxels.unwrap_or(0) as f64, 32.0)
            .map_err(Error::in_file(self.path))?;
        let (line, mut steps) = self.numbers("the steps dx, dy")?;
        let ((line_of_z, z), names_required) = if steps.len() == 2 && properties.is_none() {
            (self.numbers("the altitudes")?, true)
        } else {
            ((line, steps.split_off(steps.len().min(2))), false)
        };
        if !(flag.is_none() && z.len() == nz || has_faces && z.len() == nz + 1) {
            let expected = match (flag, of_shdom) {
                (Some(_), _) => format!("nz + 1 = {}", nz + 1),
                (None, true) => format!("nz = {nz} or nz + 1"),
                (None, false) if properties.is_some() => format!("nz = {nz} or nz + 1"),
                (None, false) => format!("nz = {nz}"),
            };
            let problem = format!("has {} altitudes, not {expected}", z.len());
            return Err(self.error(line_of_z, problem));
        }
        if z.len() > nz && !z.is_sorted_by(|a, b| a < b) {
            return Err(self.error(line_of_z, "has altitudes that do not ascend"));
        }
        if of_shdom {
            let (line, temperatures) = self.numbers("the temperatures")?;
            if temperatures.len() != z.len() {
                let problem = format!("has {} temperatures, not {}", temperatures.len(), z.len());
                return Err(self.error(line, problem));
            }
        }
        let (columns, format) = match (flag, properties) {
            (Some(flag), _) => (Columns::of_mystic(flag), Format::Mystic),
            (None, Some(kind)) => {
                if kind == 'e' {
                    self.list(z.len(), "the temperatures")?;
                    self.phase_function(1)?;
                } else {
                    let count = self.list(1, "the number of phase functions")?[0];
                    let count = whole(count).ok_or_else(|| {
                        self.error(line_of_z + 1, "is no number of phase functions")
                    })?;
                    for _ in 0..count {
                        self.phase_function(0)?;
                    }
                }
                (Columns::of_properties(kind == 'e'), Format::Properties)
            }
            (None, None) if !of_shdom && !names_required && self.has_properties() => {
                (Columns::of_all_properties(), Format::Properties)
            }
            (None, None) => (self.columns(names_required && !of_shdom)?, Format::Particles),
        };
        let first = usize::from(has_faces || format == Format::Properties);
        match steps[..] {
            [dx, dy] if dx > 0.0 && dy > 0.0 && dx.is_finite() && dy.is_finite() => {
                Ok(Header { shape: [nz, ny, nx], dx, dy, z, columns, first, format })
            }
            _ => Err(self.error(line, "does not hold two positive steps dx, dy (km)")),
        }
    }

    /// So many numbers, which may continue on further lines, as Fortran reads them: what follows on the
    /// last line is passed over.
    fn list(&mut self, count: usize, what: &str) -> Result<Vec<f64>> {
        let mut numbers = Vec::new();
        while numbers.len() < count {
            numbers.extend(self.numbers(what)?.1);
        }
        Ok(numbers)
    }

    /// Pass over a phase function, whose number of coefficients follows `before` other numbers.
    fn phase_function(&mut self, before: usize) -> Result<()> {
        let what = "a phase function";
        let (line, mut numbers) = self.numbers(what)?;
        while numbers.len() <= before {
            numbers.extend(self.numbers(what)?.1);
        }
        let count = whole(numbers[before]).filter(|count| *count <= MAX_VOXELS);
        let count = count
            .ok_or_else(|| self.error(line, "does not begin with a number of coefficients"))?;
        let left = (before + 1 + count).saturating_sub(numbers.len());
        self.list(left, what).map(|_| ())
    }

    /// Whether the next line is a row of a property file of SHDOM without a type: a temperature,
    /// extinction, albedo and a phase function with the number of its coefficients.
    fn has_properties(&self) -> bool {
        let Some((_, line)) = self.lines.get(self.next) else { return false };
        let row: Option<Vec<f64>> = fields(line).into_iter().map(number).collect();
        row.is_some_and(|row| row.len() >= 7 && whole(row[6]) == Some(row.len() - 7))
    }

    /// The columns by their names, or, if the next line is a row of numbers, by their customary
    /// order.
    fn columns(&mut self, names_required: bool) -> Result<Columns> {
        let (line, names) = self.cut("the names of the columns or a row")?;
        let named = names[0].starts_with(char::is_alphabetic);
        if !named && !names_required {
            self.next -= 1;
            let columns = Columns {
                indices: [0, 1, 2],
                amount: 3,
                of: Amount::Water,
                radius: Some(4),
                variance: (names.len() == 6).then_some(5),
                count: names.len(),
                more: None,
            };
            return match names.len() {
                5 | 6 => Ok(columns),
                other => Err(self.error(
                    line,
                    format!("lacks a number or has too many: a row i j k lwc reff [veff] has 5 or 6, not {other}"),
                )),
            };
        }
        let names: Vec<_> = names.iter().map(|name| name.to_lowercase()).collect();
        let place = |wanted: &[&str]| -> Option<usize> {
            let mut places = names.iter().enumerate();
            let found = places.find(|(_, name)| wanted.contains(&name.as_str()))?.0;
            places.all(|(_, name)| !wanted.contains(&name.as_str())).then_some(found)
        };
        let indices = [["x", "i"], ["y", "j"], ["z", "k"]].map(|wanted| place(&wanted));
        match (indices, place(&["lwc"]), place(&["reff"])) {
            ([Some(x), Some(y), Some(z)], Some(water), Some(radius)) => Ok(Columns {
                indices: [x, y, z],
                amount: water,
                of: Amount::Water,
                radius: Some(radius),
                variance: place(&["veff"]),
                count: names.len(),
                more: None,
            }),
            _ => Err(self.error(
                line,
                "does not name the columns x, y, z (or i, j, k), lwc and reff, each once",
            )),
        }
    }

    /// The amount, the effective radius (um) and the effective variance of each voxel.
    fn rows(&mut self, header: &Header, checks: &mut Checks) -> Result<[Array3<f32>; 3]> {
        let [mut amounts, mut radii] = [(); 2].map(|()| Array3::zeros(header.shape));
        let mut variances = Array3::from_elem(header.shape, EFFECTIVE_VARIANCE);
        let columns = header.columns;
        let mut lines_of = BTreeMap::new();
        let mut from_zero = false;
        for &(line, text) in &self.lines[self.next..] {
            let fields = fields(text);
            let more = columns.more.and_then(|place| whole(number(fields.get(place)?)?));
            let count = columns.count.saturating_add(more.unwrap_or(0));
            if fields.len() != count {
                let problem = format!("has {} fields, not {count}", fields.len());
                let problem = if fields.len() < count {
                    format!("lacks a number: it {problem}")
                } else {
                    problem
                };
                return Err(self.error(line, problem));
            }
            let [k, j, i] = self.voxel(line, &fields, header, from_zero)?;
            from_zero |= k == 0 || j == 0 || i == 0;
            let value = |place: usize| {
                let found = number(fields[place]).map(|value| value as f32);
                found.filter(|value| value.is_finite() && *value >= 0.0)
            };
            let variance = columns.variance.map_or(Some(EFFECTIVE_VARIANCE), value);
            let radius = columns.radius.map_or(Some(0.0), value);
            let (Some(amount), Some(reff), Some(veff)) = (value(columns.amount), radius, variance)
            else {
                return Err(self.error(line, "lacks a number, or contains a negative one"));
            };
            if header.format == Format::Mystic
                && columns.of == Amount::Water
                && amount > LARGEST_WATER
            {
                let problem = format!("has {amount} g/m3 of water, according to the flag 3");
                let remedy =
                    "if the column is the extinction (1/km), write the flag 2 into the first line";
                return Err(Error::file(self.path, format!("line {line}"), problem, remedy));
            }
            if amount > 0.0 && columns.radius.is_some() && reff <= 0.0 {
                return Err(self.error(line, "contains water without an effective radius"));
            }
            if let Some(other) = lines_of.insert([k, j, i], line) {
                return Err(self.error(line, format!("repeats the voxel of line {other}")));
            }
            amounts[[k, j, i]] = amount;
            radii[[k, j, i]] = reff;
            variances[[k, j, i]] = veff;
        }
        if header.first == 0 && !from_zero && !lines_of.is_empty() {
            checks.warn(
                "no index is 0, as if the indices started at 1; they are read as starting at 0, and \
                 the cloud is one voxel off if they do not",
            );
        }
        Ok([amounts, radii, variances])
    }

    /// The indices `[z, y, x]` of a row.
    fn voxel(
        &self,
        line: usize,
        fields: &[&str],
        header: &Header,
        from_zero: bool,
    ) -> Result<[usize; 3]> {
        let [nz, ny, nx] = header.shape;
        let index = |place: usize| {
            let index = number(fields[header.columns.indices[place]]).and_then(whole);
            index.and_then(|index| index.checked_sub(header.first))
        };
        let (Some(i), Some(j), Some(k)) = (index(0), index(1), index(2)) else {
            return Err(self.error(line, "does not have whole, non-negative indices"));
        };
        if i < nx && j < ny && k < nz {
            return Ok([k, j, i]);
        }
        let one_based =
            header.first == 0 && !from_zero && i.min(j).min(k) > 0 && i <= nx && j <= ny && k <= nz;
        let hint = if one_based { "; they seem to start at 1: subtract 1 from each" } else { "" };
        let problem = match header.first {
            0 => format!("does not start with indices below {nx}, {ny}, {nz} (from 0){hint}"),
            _ => format!("does not start with indices of at most {nx}, {ny}, {nz} (from 1)"),
        };
        Err(self.error(line, problem))
    }
}

impl Columns {
    /// Those of a file of MYSTIC with a flag: extinction, asymmetry and albedo (1), extinction and radius
    /// (2), or liquid water and radius (3).
    fn of_mystic(flag: usize) -> Self {
        Self {
            indices: [0, 1, 2],
            amount: 3,
            of: if flag == 3 { Amount::Water } else { Amount::Extinction },
            radius: (flag > 1).then_some(4),
            variance: None,
            count: if flag == 1 { 6 } else { 5 },
            more: None,
        }
    }

    /// Those of a property file of SHDOM: with the extinction only, or with temperature, extinction,
    /// albedo and the number of a phase function.
    fn of_properties(extinction_only: bool) -> Self {
        Self {
            indices: [0, 1, 2],
            amount: if extinction_only { 3 } else { 4 },
            of: Amount::Extinction,
            radius: None,
            variance: None,
            count: if extinction_only { 4 } else { 7 },
            more: None,
        }
    }

    /// Those of a property file of SHDOM in which every row has its phase function.
    fn of_all_properties() -> Self {
        Self { more: Some(6), ..Self::of_properties(false) }
    }
}

/// The type of a property file of SHDOM, according to its first line, of which only the first letter
/// counts.
fn property_type(title: &str) -> Option<char> {
    let types = ["t", "p", "e", "tabulated phase", "polarized tabulated", "extinction only"];
    let is_type =
        types[..3].contains(&title) || types[3..].iter().any(|start| title.starts_with(start));
    title.chars().next().filter(|_| is_type)
}

/// The fields of a line: between commas if it has any, otherwise between spaces or tabs.
fn fields(line: &str) -> Vec<&str> {
    match line.contains(',') {
        true => line.split(',').map(str::trim).collect(),
        false => line.split_whitespace().collect(),
    }
}

/// The number in a field. The exponent may follow the letter D, as in Fortran.
fn number(field: &str) -> Option<f64> {
    field.parse().ok().or_else(|| field.replace(['d', 'D'], "e").parse().ok())
}

/// A count or index, which may be written as 3.0.
fn whole(number: f64) -> Option<usize> {
    let fits = number.fract() == 0.0 && (0.0..9e15).contains(&number);
    fits.then_some(number as usize)
}

/// The columns of a field in the crop.
fn columns(values: &Array3<f32>, crop: Crop) -> Array3<f32> {
    let (_, ny, nx) = values.dim();
    let rows: Vec<_> = (crop.y0..crop.y0 + crop.ny).map(|row| row % ny).collect();
    let cols: Vec<_> = (crop.x0..crop.x0 + crop.nx).map(|col| col % nx).collect();
    values.select(Axis(1), &rows).select(Axis(2), &cols)
}
