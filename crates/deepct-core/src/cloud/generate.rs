//! Generator of synthetic shallow cumuli that resemble those of a large-eddy simulation.
//!
//! A cumulus consists of several adjacent turrets: columns with a flat base and a rounded top
//! that lean with the wind and whose outline is displaced by turbulence. The liquid water content
//! increases with altitude as in an adiabatically rising parcel and is reduced by mixing. The
//! reduction increases with height above cloud base and towards the cloud edge.

use super::turbulence::turbulence;
use super::{Cloud, Microphysics};
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::math::DVec3;
use crate::rng::{Purpose, RngExt, Stream, stream};
use ndarray::parallel::prelude::*;
use ndarray::{Array3, ArrayView2, Axis};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Settings of a single cumulus in the centre of its grid.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CumulusSettings {
    /// Number of voxels along z, y, x.
    pub shape: [usize; 3],
    /// Voxel size along x, y, z (km).
    pub spacing_km: [f64; 3],
    /// The grid's south-west-bottom corner x, y, z (km).
    pub origin_km: [f64; 3],
    /// Altitude of cloud base (km).
    pub base_km: f64,
    /// Width of the cloud (km); drawn at random between 0.5 and 1.1 km if not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub width_km: Option<f64>,
    /// Depth of the cloud from base to top (km); drawn at random in proportion to the width if
    /// not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth_km: Option<f64>,
    /// Droplet number concentration (per cm3).
    pub droplets_per_cm3: f64,
    /// Liquid water content near the base of the core as a fraction of the adiabatic value, in
    /// (0, 1].
    pub adiabatic_fraction: f64,
    /// Displacement of the outline by turbulence as a fraction of a turret's radius, in `[0, 1]`.
    pub turbulence: f64,
}

/// Settings of a field of cumuli on a periodic domain.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FieldSettings {
    /// Number of voxels along z, y, x.
    pub shape: [usize; 3],
    /// Voxel size along x, y, z (km).
    pub spacing_km: [f64; 3],
    /// The grid's south-west-bottom corner x, y, z (km).
    pub origin_km: [f64; 3],
    /// Altitude of cloud base (km).
    pub base_km: f64,
    /// Cloud cover: the fraction of columns with cloud, in (0, 0.5].
    pub cover: f64,
    /// Width of the smallest and the largest clouds (km).
    pub widths_km: [f64; 2],
    /// Exponent of the power law of the number density of cloud widths.
    pub size_exponent: f64,
    /// Droplet number concentration (per cm3).
    pub droplets_per_cm3: f64,
    /// Liquid water content near the base of a core as a fraction of the adiabatic value, in
    /// (0, 1].
    pub adiabatic_fraction: f64,
    /// Displacement of the outline by turbulence as a fraction of a turret's radius, in `[0, 1]`.
    pub turbulence: f64,
}

impl Default for CumulusSettings {
    /// A maritime trade cumulus on 32 x 32 columns of 50 m and 32 levels of 40 m.
    fn default() -> Self {
        Self {
            shape: [32, 32, 32],
            spacing_km: [0.05, 0.05, 0.04],
            origin_km: [0.0, 0.0, 0.48],
            base_km: 0.56,
            width_km: None,
            depth_km: None,
            droplets_per_cm3: 100.0,
            adiabatic_fraction: 0.9,
            turbulence: 0.3,
        }
    }
}

impl Default for FieldSettings {
    /// A domain of 6.4 km x 6.4 km with the cover and the sizes of trade cumuli. The exponent is
    /// that of clouds below 1 km in Landsat images (Cahalan and Joseph 1989).
    fn default() -> Self {
        let cumulus = CumulusSettings::default();
        Self {
            shape: [36, 128, 128],
            spacing_km: cumulus.spacing_km,
            origin_km: cumulus.origin_km,
            base_km: cumulus.base_km,
            cover: 0.17,
            widths_km: [0.1, 1.0],
            size_exponent: -1.7,
            droplets_per_cm3: cumulus.droplets_per_cm3,
            adiabatic_fraction: cumulus.adiabatic_fraction,
            turbulence: cumulus.turbulence,
        }
    }
}

/// Parameters shared by all clouds of one grid.
struct CloudParameters<'a> {
    grid: Grid,
    turbulence: &'a Array3<f32>,
    /// The largest value of the turbulence field.
    strongest: f64,
    base: f64,
    adiabatic_fraction: f64,
    displacement: f64,
    /// Whether the domain is horizontally periodic.
    periodic: bool,
}

/// A turret: position, radius and height (km), and its displacement to the east and north per km
/// of height.
struct Turret {
    x: f64,
    y: f64,
    radius: f64,
    height: f64,
    lean: [f64; 2],
}

/// Generates a single cumulus. The result depends only on the settings and the seed, not on the
/// number of threads.
///
/// # Errors
/// Returns an error if a setting is out of range or if the cloud would extend beyond its grid.
pub fn cumulus(settings: &CumulusSettings, seed: u64) -> Result<Cloud> {
    let grid = grid(settings.shape, settings.spacing_km, settings.origin_km)?;
    check_share("adiabatic_fraction", settings.adiabatic_fraction, 1.0)?;
    check_turbulence(settings.turbulence)?;
    check_base(&grid, settings.base_km)?;
    let mut rng = stream(seed, Purpose::Cloud, &[0]);
    let widest = 0.85 * grid.extent().x.min(grid.extent().y);
    let drawn: f64 = rng.random_range(0.5..1.1);
    let width = settings.width_km.unwrap_or(drawn.min(widest));
    // One cloud-free level must remain above the cloud top.
    let tallest = grid.upper().z - settings.base_km - grid.spacing.z;
    let drawn = width * rng.random_range(0.8..1.5);
    let depth = settings.depth_km.unwrap_or(drawn.min(tallest));
    check_length("width_km", width, widest)?;
    check_length("depth_km", depth, tallest)?;
    let turbulence = turbulence(&grid, 0.5 * width, DAMPED * grid.spacing.max_element(), seed);
    let parameters = CloudParameters {
        grid,
        strongest: strongest(&turbulence),
        turbulence: &turbulence,
        base: settings.base_km,
        adiabatic_fraction: settings.adiabatic_fraction,
        displacement: settings.turbulence,
        periodic: false,
    };
    let mut water = Array3::zeros(grid.shape);
    let center = grid.center();
    parameters.add(&mut water, &turrets(&mut rng, [center.x, center.y], width, depth));
    let droplets = Microphysics::from_droplet_number(water, settings.droplets_per_cm3)?;
    Cloud::from_microphysics(grid, droplets)
}

/// Generates a periodic field of cumuli. Clouds are added until the prescribed cloud cover is
/// reached.
///
/// # Errors
/// Returns an error if a setting is out of range.
pub fn field(settings: &FieldSettings, seed: u64) -> Result<Cloud> {
    let grid = grid(settings.shape, settings.spacing_km, settings.origin_km)?;
    check_share("adiabatic_fraction", settings.adiabatic_fraction, 1.0)?;
    check_share("cover", settings.cover, 0.5)?;
    check_turbulence(settings.turbulence)?;
    check_base(&grid, settings.base_km)?;
    let [narrowest, widest] = settings.widths_km;
    check_length("widths_km", widest, 0.85 * grid.extent().x.min(grid.extent().y))?;
    check_length("widths_km", narrowest, widest)?;
    let turbulence = turbulence(&grid, 0.5 * widest, DAMPED * grid.spacing.max_element(), seed);
    let parameters = CloudParameters {
        grid,
        strongest: strongest(&turbulence),
        turbulence: &turbulence,
        base: settings.base_km,
        adiabatic_fraction: settings.adiabatic_fraction,
        displacement: settings.turbulence,
        periodic: true,
    };
    let tallest = grid.upper().z - settings.base_km - grid.spacing.z;
    let mut water = Array3::zeros(grid.shape);
    let columns = (grid.shape[1] * grid.shape[2]) as f64;
    // The number of clouds is bounded because with some settings, such as a domain that ends just
    // above cloud base, no cloud holds water.
    let mut covered = 0;
    for number in 0..(50.0 * columns) as u64 {
        if covered as f64 / columns >= settings.cover {
            break;
        }
        let mut rng = stream(seed, Purpose::Cloud, &[number]);
        let width = power_law(&mut rng, settings.widths_km, settings.size_exponent);
        let depth = (width * rng.random_range(0.8..1.5)).min(tallest);
        let place = grid.lower() + grid.extent() * DVec3::new(rng.random(), rng.random(), 0.0);
        covered += parameters.add(&mut water, &turrets(&mut rng, [place.x, place.y], width, depth));
    }
    let droplets = Microphysics::from_droplet_number(water, settings.droplets_per_cm3)?;
    Cloud::from_microphysics(grid, droplets)
}

/// The adiabatic liquid water content (g/m3) at `height` km above cloud base in the trade-wind
/// atmosphere of BOMEX (Siebesma et al. 2003), interpolated linearly between values computed at
/// 100, 250, 500 and 1000 m.
pub fn adiabatic_liquid_water(height: f64) -> f64 {
    const TABLE: [(f64, f64); 5] =
        [(0.0, 0.0), (0.1, 0.26), (0.25, 0.62), (0.5, 1.20), (1.0, 2.26)];
    let above = TABLE.iter().position(|(known, _)| height <= *known).unwrap_or(4).max(1);
    let ((h0, w0), (h1, w1)) = (TABLE[above - 1], TABLE[above]);
    (w0 + (height - h0) / (h1 - h0) * (w1 - w0)).max(0.0)
}

impl CloudParameters<'_> {
    /// Adds the liquid water content of a cloud. Where another cloud already has more water, its
    /// value is retained. Returns the number of columns that had no water before.
    fn add(&self, water: &mut Array3<f32>, turrets: &[Turret]) -> usize {
        let grid = &self.grid;
        let is_near =
            |axis: usize, at: DVec3| turrets.iter().any(|turret| turret.is_near(self, axis, at));
        let columns: Vec<usize> =
            (0..grid.shape[2]).filter(|i| is_near(0, grid.voxel_center([0, 0, *i]))).collect();
        let rows = water.axis_iter_mut(Axis(1)).into_par_iter().enumerate();
        rows.map(|(j, mut row)| {
            if !is_near(1, grid.voxel_center([0, j, 0])) {
                return 0;
            }
            let before = covered(&row.view(), &columns);
            for (k, mut line) in row.axis_iter_mut(Axis(0)).enumerate() {
                let start = grid.voxel_center([k, j, 0]);
                let height = start.z - self.base;
                if height <= 0.0 {
                    continue;
                }
                let near: Vec<_> =
                    turrets.iter().filter(|turret| turret.reaches(self, start.y, height)).collect();
                if near.is_empty() {
                    continue;
                }
                let core = self.adiabatic_fraction
                    * (-height / ENTRAINMENT).exp()
                    * adiabatic_liquid_water(height);
                for &i in &columns {
                    let water = &mut line[i];
                    let at = start + DVec3::X * (grid.spacing.x * i as f64);
                    let depths = near.iter().map(|turret| turret.depth(self, at, height));
                    let depth = depths.fold(f64::NEG_INFINITY, f64::max)
                        + self.displacement * f64::from(self.turbulence[[k, j, i]]);
                    let depth = depth.min(self.clearance(at) / FADING);
                    if depth > 0.0 {
                        *water = water.max((core * dilution(depth)) as f32);
                    }
                }
            }
            covered(&row.view(), &columns) - before
        })
        .sum()
    }

    /// Distance (km) of a point from the voxels that must remain cloud-free: the topmost level
    /// and, unless the field is periodic, the outermost columns.
    fn clearance(&self, at: DVec3) -> f64 {
        let (lower, upper, voxel) = (self.grid.lower(), self.grid.upper(), self.grid.spacing);
        let top = upper.z - voxel.z - at.z;
        if self.periodic {
            return top;
        }
        let sides = (at - lower - voxel).min(upper - voxel - at);
        top.min(sides.x).min(sides.y)
    }
}

/// The number of `columns` of a row `[z, x]` that contain water.
fn covered(row: &ArrayView2<f32>, columns: &[usize]) -> usize {
    let is_covered = |i: &&usize| row.column(**i).iter().any(|water| *water > 0.0);
    columns.iter().filter(is_covered).count()
}

/// The wavelength (in voxels) at which the power is damped to 1/e.
const DAMPED: f64 = 4.0;

/// The distance (km) from a side or the top of the grid within which a cloud is tapered.
const FADING: f64 = 0.2;

/// The scale height (km) with which entrainment reduces the adiabatic fraction of a core.
const ENTRAINMENT: f64 = 1.5;

/// Liquid water content relative to that of the core, as a function of the depth inside the
/// outline in units of the turret's radius. Lateral mixing reduces it to a third near the edge.
fn dilution(depth: f64) -> f64 {
    0.15 + 0.85 * (1.0 - (-depth / 0.5).exp())
}

impl Turret {
    /// Signed distance (km) of a coordinate from the turret's axis at a given height, to the
    /// nearest periodic image. `axis` is 0 for x and 1 for y.
    fn offset(&self, parameters: &CloudParameters, axis: usize, at: f64, height: f64) -> f64 {
        let period = parameters.grid.extent()[axis];
        let distance = at - [self.x, self.y][axis] - self.lean[axis] * height;
        distance - period * (distance / period).round()
    }

    /// Whether the turret, at its largest displacement, can intersect a row.
    fn reaches(&self, parameters: &CloudParameters, y: f64, height: f64) -> bool {
        self.offset(parameters, 1, y, height).abs() < self.reach(parameters)
    }

    /// Whether the turret, at its largest displacement, can have the same x (`axis` 0) or y (1) as a
    /// point, at any height.
    fn is_near(&self, parameters: &CloudParameters, axis: usize, at: DVec3) -> bool {
        let grid = &parameters.grid;
        let heights = [grid.lower().z, grid.upper().z].map(|z| (z - parameters.base).abs());
        let drift = self.lean[axis].abs() * heights[0].max(heights[1]);
        self.offset(parameters, axis, at[axis], 0.0).abs() < self.reach(parameters) + drift
    }

    /// The largest distance (km) of its outline from its axis.
    fn reach(&self, parameters: &CloudParameters) -> f64 {
        (1.0 + parameters.displacement * parameters.strongest) * self.radius
    }

    /// Depth of a point inside the turret in units of its radius; negative outside. The turret
    /// widens up to 0.6 of its height and is rounded above.
    fn depth(&self, parameters: &CloudParameters, at: DVec3, height: f64) -> f64 {
        let east = self.offset(parameters, 0, at.x, height);
        let north = self.offset(parameters, 1, at.y, height);
        let rise = height / self.height;
        let bulge = 0.6;
        let outline = if rise < bulge {
            0.8 + 0.2 * rise / bulge
        } else {
            let round = (rise - bulge) / (1.0 - bulge);
            // Above the top the outline becomes negative, so that the depth continues to decrease.
            if round < 1.0 { (1.0 - round * round).sqrt() } else { 2.0 * (1.0 - round) }
        };
        outline - east.hypot(north) / self.radius
    }
}

/// The turrets of a cloud of the given width and depth (km) around a point: a main turret
/// surrounded by lower ones.
fn turrets(rng: &mut Stream, [x, y]: [f64; 2], width: f64, depth: f64) -> Vec<Turret> {
    let radius = 0.5 * width;
    let wind = [rng.random_range(-0.3..0.3), rng.random_range(-0.3..0.3)];
    // The main turret is centred on the point at half its height, not at its base.
    let foot = |at: f64, axis: usize| at - 0.5 * depth * wind[axis];
    let main =
        Turret { x: foot(x, 0), y: foot(y, 1), radius: 0.45 * radius, height: depth, lean: wind };
    let count = rng.random_range(3..7);
    let turn = rng.random_range(0.0..TAU);
    let around = (0..count).map(|number| {
        let angle = turn + TAU * f64::from(number) / f64::from(count) + rng.random_range(-0.5..0.5);
        let size = radius * rng.random_range(0.25..0.5);
        let distance = (radius - size) * rng.random_range(0.6..1.0);
        Turret {
            x: x + distance * angle.sin(),
            y: y + distance * angle.cos(),
            radius: size,
            height: depth * rng.random_range(0.2..0.7),
            lean: wind.map(|wind| wind + rng.random_range(-0.2..0.2)),
        }
    });
    std::iter::once(main).chain(around).collect()
}

fn strongest(turbulence: &Array3<f32>) -> f64 {
    f64::from(turbulence.iter().copied().fold(0.0, f32::max))
}

/// Draws a number between two limits from a power-law density.
fn power_law(rng: &mut Stream, [low, high]: [f64; 2], exponent: f64) -> f64 {
    let uniform: f64 = rng.random();
    let power = exponent + 1.0;
    if power.abs() < 1e-9 {
        return low * (high / low).powf(uniform);
    }
    (low.powf(power) + uniform * (high.powf(power) - low.powf(power))).powf(power.recip())
}

fn grid(shape: [usize; 3], spacing: [f64; 3], origin: [f64; 3]) -> Result<Grid> {
    Grid::new(DVec3::from_array(origin), DVec3::from_array(spacing), shape)
}

fn check_share(name: &'static str, value: f64, most: f64) -> Result<()> {
    if value > 0.0 && value <= most {
        return Ok(());
    }
    Err(Error::out_of_range(name, value, format!("above 0 and at most {most}")))
}

fn check_length(name: &'static str, value: f64, most: f64) -> Result<()> {
    if value > 0.0 && value <= most {
        return Ok(());
    }
    let range = format!("above 0 and at most {most:.3} km, which fits into the grid");
    Err(Error::out_of_range(name, value, range))
}

fn check_turbulence(value: f64) -> Result<()> {
    if (0.0..=1.0).contains(&value) {
        return Ok(());
    }
    Err(Error::out_of_range("turbulence", value, "between 0 and 1"))
}

fn check_base(grid: &Grid, base: f64) -> Result<()> {
    let top = grid.upper().z - 2.0 * grid.spacing.z;
    if base >= grid.lower().z && base <= top {
        return Ok(());
    }
    let range = format!("between {} and {top} km, within the grid", grid.lower().z);
    Err(Error::out_of_range("base_km", base, range))
}

#[cfg(test)]
mod tests;
