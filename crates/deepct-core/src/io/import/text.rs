//! Import of the text formats of pySHDOM and AT3D, which have one line per voxel with water.
//!
//! A pySHDOM file consists of a comment line, `nx ny nz`, then `dx dy z0 z1 ...` on one line, then
//! rows `i j k lwc reff [veff]`. An AT3D file consists of a comment line, `nx,ny,nz`, `dx,dy`,
//! `z0,z1,...`, a line of column names (`i,j,k,lwc,reff[,veff]` or `x,y,z,...`), then rows. Indices
//! start at 0, lengths are in km, liquid water contents in g/m3 and radii in um. The values are
//! given at `(i dx, j dy, z_k)`, which become the centres of voxels. Voxels that are not listed
//! contain no water.

use super::{Crop, ImportSettings, edges_of, grid_over};
use crate::cloud::resample::{resample_droplets, uniform_edges};
use crate::cloud::{Cloud, EFFECTIVE_VARIANCE, Microphysics};
use crate::error::{Error, Result};
use crate::grid::MAX_VOXELS;
use ndarray::{Array3, Axis};
use std::path::Path;
use std::str::FromStr;

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
    z: Vec<f64>,
    columns: Columns,
}

/// The positions of the values in a row, counted after the three indices.
#[derive(Clone, Copy)]
struct Columns {
    water: usize,
    radius: usize,
    variance: Option<usize>,
}

/// Read a text file in either format. Effective radii are those of the file unless the settings
/// specify a droplet number concentration.
///
/// # Errors
/// Returns an error if the file is missing or not in one of these formats, if a line is invalid
/// (the message states its number), or if values are negative or missing.
pub fn read_text(path: impl AsRef<Path>, settings: &ImportSettings) -> Result<Cloud> {
    let path = path.as_ref();
    let bytes = std::fs::read(path).map_err(Error::io(path))?;
    let text = String::from_utf8(bytes).map_err(|_| {
        let remedy = "`formats` lists the supported formats";
        Error::file(path, "file", "is neither HDF5 nor text", remedy)
    })?;
    let mut lines = Lines::new(path, &text);
    let header = lines.header()?;
    let droplets = lines.rows(&header)?;
    let crop = Crop::of(settings, path, [header.shape[1], header.shape[2]])?;
    let droplets = cropped(droplets, crop);
    let z = edges_of(&header.z, path, "altitudes")?;
    let axis =
        |step: f64, first: usize, count| uniform_edges(step * (first as f64 - 0.5), step, count);
    let (y, x) = (axis(header.dy, crop.y0, crop.ny), axis(header.dx, crop.x0, crop.nx));
    let grid = grid_over([&z, &y, &x], settings, path)?;
    let cloud = resample_droplets(&droplets, [&z, &y, &x], &grid)?;
    match (settings.droplets_per_cm3, cloud.microphysics) {
        (Some(number), Some(droplets)) => Cloud::from_microphysics(
            grid,
            Microphysics::from_droplet_number(droplets.liquid_water_content, number)?,
        ),
        (_, microphysics) => Ok(Cloud { microphysics, ..cloud }),
    }
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
        let remedy = "give a pySHDOM or AT3D text file; `formats` describes both";
        Error::file(self.path, format!("line {line}"), problem, remedy)
    }

    /// The fields of the next line that is not empty.
    fn cut(&mut self, what: &str) -> Result<(usize, Vec<&'a str>)> {
        let Some(&(number, line)) = self.lines.get(self.next) else {
            let last = self.lines.last().map_or(1, |(number, _)| *number);
            return Err(self.error(last, format!("is the last line, but {what} should follow")));
        };
        self.next += 1;
        Ok((number, fields(line).collect()))
    }

    fn numbers<T: FromStr>(&mut self, what: &str) -> Result<(usize, Vec<T>)> {
        let (line, fields) = self.cut(what)?;
        let numbers: Option<Vec<T>> = fields.iter().map(|field| field.parse().ok()).collect();
        numbers
            .map(|numbers| (line, numbers))
            .ok_or_else(|| self.error(line, format!("does not hold {what}")))
    }

    fn header(&mut self) -> Result<Header> {
        let (line, counts) = self.numbers::<usize>("the counts nx, ny, nz")?;
        let [nx, ny, nz] = counts[..] else {
            return Err(self.error(line, "does not hold three counts nx, ny, nz"));
        };
        let voxels = nx.checked_mul(ny).and_then(|columns| columns.checked_mul(nz));
        if !voxels.is_some_and(|count| (1..=MAX_VOXELS).contains(&count)) {
            return Err(self.error(line, format!("declares {nx} x {ny} x {nz} voxels")));
        }
        let (line, mut steps) = self.numbers::<f64>("the steps dx, dy")?;
        let mut columns = Columns { water: 0, radius: 1, variance: None };
        let z = if steps.len() == 2 {
            let z = self.numbers::<f64>("the altitudes")?.1;
            columns = self.column_names()?;
            z
        } else {
            steps.split_off(steps.len().min(2))
        };
        if z.len() != nz {
            let problem = format!("is followed by {} altitudes, not nz = {nz}", z.len());
            return Err(self.error(line, problem));
        }
        match steps[..] {
            [dx, dy] if dx > 0.0 && dy > 0.0 && dx.is_finite() && dy.is_finite() => {
                Ok(Header { shape: [nz, ny, nx], dx, dy, z, columns })
            }
            _ => Err(self.error(line, "does not hold two positive steps dx, dy (km)")),
        }
    }

    fn column_names(&mut self) -> Result<Columns> {
        let (line, names) = self.cut("the names of the columns")?;
        let place = |name: &str| names.iter().skip(3).position(|known| *known == name);
        match (place("lwc"), place("reff")) {
            (Some(water), Some(radius)) => Ok(Columns { water, radius, variance: place("veff") }),
            _ => {
                Err(self.error(line, "does not name the columns lwc and reff after three indices"))
            }
        }
    }

    fn rows(&mut self, header: &Header) -> Result<Microphysics> {
        let mut droplets = Microphysics {
            liquid_water_content: Array3::zeros(header.shape),
            effective_radius: Array3::zeros(header.shape),
            effective_variance: Array3::from_elem(header.shape, EFFECTIVE_VARIANCE),
        };
        let Columns { water, radius, mut variance } = header.columns;
        for &(line, text) in &self.lines[self.next..] {
            let mut fields = fields(text);
            let mut index =
                |limit: usize| fields.next()?.parse().ok().filter(|index: &usize| *index < limit);
            let [nz, ny, nx] = header.shape;
            let (Some(i), Some(j), Some(k)) = (index(nx), index(ny), index(nz)) else {
                let problem =
                    format!("does not start with indices below {nx}, {ny}, {nz} (from 0)");
                return Err(self.error(line, problem));
            };
            let values: Option<Vec<f32>> = fields.map(|field| field.parse().ok()).collect();
            let values = values.unwrap_or_default();
            // pySHDOM files have no column names: a sixth number is the effective variance.
            if variance.is_none() && values.len() == 3 {
                variance = Some(2);
            }
            let value = |place: usize| {
                let found = values.get(place).copied();
                found.filter(|value| value.is_finite() && *value >= 0.0)
            };
            let (Some(lwc), Some(reff), Some(veff)) =
                (value(water), value(radius), variance.map_or(Some(EFFECTIVE_VARIANCE), value))
            else {
                return Err(self.error(line, "lacks a number, or contains a negative one"));
            };
            if lwc > 0.0 && reff <= 0.0 {
                return Err(self.error(line, "contains water without an effective radius"));
            }
            droplets.liquid_water_content[[k, j, i]] = lwc;
            droplets.effective_radius[[k, j, i]] = reff;
            droplets.effective_variance[[k, j, i]] = veff;
        }
        Ok(droplets)
    }
}

/// The fields of a line, separated by commas, spaces or tabs.
fn fields(line: &str) -> impl Iterator<Item = &str> {
    line.split([',', ' ', '\t']).filter(|field| !field.is_empty())
}

fn cropped(droplets: Microphysics, crop: Crop) -> Microphysics {
    let columns = |values: Array3<f32>| {
        let (_, ny, nx) = values.dim();
        let rows: Vec<_> = (crop.y0..crop.y0 + crop.ny).map(|row| row % ny).collect();
        let cols: Vec<_> = (crop.x0..crop.x0 + crop.nx).map(|col| col % nx).collect();
        values.select(Axis(1), &rows).select(Axis(2), &cols)
    };
    Microphysics {
        liquid_water_content: columns(droplets.liquid_water_content),
        effective_radius: columns(droplets.effective_radius),
        effective_variance: columns(droplets.effective_variance),
    }
}
