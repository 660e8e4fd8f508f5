//! Regular grids and fields on them.

pub mod resample;

use crate::error::{Error, Result};
use crate::math::DVec3;
use crate::memory;
use ndarray::{Array3, s};
use std::ops::Range;

/// The largest number of voxels of a grid: it protects against files whose header declares more
/// memory than a computer has.
pub const MAX_VOXELS: usize = 1 << 31;

/// A regular grid of voxels. Voxel `[k, j, i]` (z, y, x) spans
/// `origin + (i, j, k) * spacing` to `origin + (i + 1, j + 1, k + 1) * spacing`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// The south-west-bottom corner of voxel `[0, 0, 0]` (km).
    pub origin: DVec3,
    /// Voxel size along x, y, z (km).
    pub spacing: DVec3,
    /// Number of voxels along z, y, x: the shape of an array on this grid.
    pub shape: [usize; 3],
}

impl std::fmt::Display for Grid {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { origin, spacing, shape } = self;
        let [x, y, z] = spacing.to_array();
        let [west, south, bottom] = origin.to_array();
        write!(formatter, "{shape:?} voxels [z, y, x] of {x:.6} x {y:.6} x {z:.6} km from ")?;
        write!(formatter, "x {west:.6}, y {south:.6}, z {bottom:.6} km")
    }
}

impl Grid {
    /// Creates a grid from its corner (km), voxel size (km) and shape `[nz, ny, nx]`.
    ///
    /// # Errors
    /// As [`Grid::of_any_size`]; more than [`MAX_VOXELS`] voxels, or more than fit in memory.
    pub fn new(origin: DVec3, spacing: DVec3, shape: [usize; 3]) -> Result<Self> {
        let grid = Self::of_any_size(origin, spacing, shape)?;
        grid.check_memory()?;
        Ok(grid)
    }

    /// As [`Grid::new`], for fields that are computed in parts and never in memory as a whole.
    ///
    /// # Errors
    /// A spacing that is not positive and finite, an origin that is not finite, an empty axis, or more
    /// voxels than can be counted.
    pub fn of_any_size(origin: DVec3, spacing: DVec3, shape: [usize; 3]) -> Result<Self> {
        if !origin.is_finite() {
            return Err(Error::out_of_range("grid origin", origin, "finite (km)"));
        }
        if !(spacing.is_finite() && spacing.min_element() > 0.0) {
            return Err(Error::out_of_range("grid spacing", spacing, "positive and finite (km)"));
        }
        let voxels = shape.iter().try_fold(1_usize, |product, &n| product.checked_mul(n));
        if voxels.is_none_or(|n| n == 0) {
            return Err(wrong_shape(shape));
        }
        Ok(Self { origin, spacing, shape })
    }

    /// Returns an error if fields on this grid are larger than the memory.
    ///
    /// # Errors
    /// More than [`MAX_VOXELS`] voxels, or more than fit in memory.
    pub fn check_memory(&self) -> Result<()> {
        if self.len() > MAX_VOXELS {
            return Err(wrong_shape(self.shape));
        }
        // A volume of the extinction and some more of the same size.
        memory::check("memory for the grid", self.len() as f64, 16.0)
    }

    /// The part of the grid that consists of some of its rows and columns.
    ///
    /// # Errors
    /// A range that is empty or not in the grid.
    pub fn part(&self, rows: Range<usize>, cols: Range<usize>) -> Result<Self> {
        let [levels, all_rows, all_cols] = self.shape;
        let inside = |range: &Range<usize>, all| !range.is_empty() && range.end <= all;
        if !inside(&rows, all_rows) || !inside(&cols, all_cols) {
            let range = format!("within {all_rows} rows and {all_cols} columns, and not empty");
            return Err(Error::out_of_range(
                "part of a grid",
                format!("{rows:?}, {cols:?}"),
                range,
            ));
        }
        let offset = DVec3::new(cols.start as f64, rows.start as f64, 0.0);
        let shape = [levels, rows.len(), cols.len()];
        Ok(Self { origin: self.origin + offset * self.spacing, shape, ..*self })
    }

    /// Divides the grid into tiles of at most `side` rows and columns, from the south-west; each is
    /// given by its rows and columns.
    pub fn tiles(&self, side: usize) -> Vec<[Range<usize>; 2]> {
        let [_, rows, cols] = self.shape;
        let side = side.max(1);
        let pieces =
            |all: usize| (0..all.div_ceil(side)).map(move |n| n * side..((n + 1) * side).min(all));
        pieces(rows).flat_map(|rows| pieces(cols).map(move |cols| [rows.clone(), cols])).collect()
    }

    /// The south-west-bottom corner of the grid (km).
    pub fn lower(&self) -> DVec3 {
        self.origin
    }

    /// The north-east-top corner of the grid (km).
    pub fn upper(&self) -> DVec3 {
        self.origin + self.extent()
    }

    /// The size of the grid along x, y, z (km).
    pub fn extent(&self) -> DVec3 {
        let [nz, ny, nx] = self.shape;
        self.spacing * DVec3::new(nx as f64, ny as f64, nz as f64)
    }

    /// The centre of the grid (km).
    pub fn center(&self) -> DVec3 {
        self.origin + 0.5 * self.extent()
    }

    /// The centre of voxel `[k, j, i]` (km).
    pub fn voxel_center(&self, [k, j, i]: [usize; 3]) -> DVec3 {
        self.origin + self.spacing * (DVec3::new(i as f64, j as f64, k as f64) + 0.5)
    }

    /// The indices `[k, j, i]` of the voxel that contains a point (km); a point on the upper side of the
    /// grid is in the last one.
    ///
    /// # Errors
    /// A point outside the grid.
    pub fn voxel(&self, point: DVec3) -> Result<[usize; 3]> {
        let (lower, upper) = (self.lower(), self.upper());
        if !(point.cmpge(lower).all() && point.cmple(upper).all()) {
            let range = format!("in the grid, from {lower} to {upper} km");
            return Err(Error::out_of_range("point (x, y, z)", format!("{point} km"), range));
        }
        let at = (point - lower) / self.spacing;
        let [levels, rows, cols] = self.shape;
        let index = |place: f64, count: usize| (place as usize).min(count - 1);
        Ok([index(at.z, levels), index(at.y, rows), index(at.x, cols)])
    }

    /// Number of voxels.
    pub fn len(&self) -> usize {
        self.shape.iter().product()
    }

    /// Always false, because a grid has at least one voxel.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Coordinates of the voxel centres along x, y, z (km).
    pub fn axes(&self) -> [Vec<f64>; 3] {
        let [nz, ny, nx] = self.shape;
        let axis = |origin: f64, step: f64, n: usize| {
            (0..n).map(|index| origin + step * (index as f64 + 0.5)).collect()
        };
        [
            axis(self.origin.x, self.spacing.x, nx),
            axis(self.origin.y, self.spacing.y, ny),
            axis(self.origin.z, self.spacing.z, nz),
        ]
    }

    /// Whether two grids agree: their shapes are equal, and their corners differ along each axis by
    /// at most a thousandth of a voxel. This tolerance admits coordinates in single precision.
    pub fn matches(&self, other: &Grid) -> bool {
        let tolerance = self.spacing * 1e-3;
        let near = |one: DVec3, other: DVec3| (one - other).abs().cmple(tolerance).all();
        self.shape == other.shape
            && near(self.lower(), other.lower())
            && near(self.upper(), other.upper())
    }

    /// Returns an error unless `other` matches this grid.
    pub(crate) fn check_same(&self, what: &str, other: &Grid) -> Result<()> {
        self.check_shape(what, &other.shape)?;
        if self.matches(other) {
            return Ok(());
        }
        let text = |grid: &Grid| format!("from {} to {} km", grid.lower(), grid.upper());
        Err(Error::mismatch(
            format!("grid of {what}"),
            text(self),
            text(other),
            "give both on one grid",
        ))
    }

    /// Returns an error unless `shape` is the shape of this grid.
    pub(crate) fn check_shape(&self, what: &str, shape: &[usize]) -> Result<()> {
        if shape == self.shape {
            return Ok(());
        }
        Err(Error::mismatch(
            format!("shape [z, y, x] of {what}"),
            format!("{:?}", self.shape),
            format!("{shape:?}"),
            "give an array on the grid's own shape",
        ))
    }
}

fn wrong_shape(shape: [usize; 3]) -> Error {
    let range = format!("at least 1 along every axis and at most {MAX_VOXELS} voxels in all");
    Error::out_of_range("grid shape", format!("{shape:?}"), range)
}

/// A scalar field on a [`Grid`]: cell averages at cell centres, array `[z, y, x]`.
#[derive(Debug, Clone, PartialEq)]
pub struct Volume {
    /// The grid of the voxels.
    pub grid: Grid,
    /// The value of each voxel, shape `grid.shape`.
    pub values: Array3<f32>,
}

impl Volume {
    /// Creates a volume from its values.
    ///
    /// # Errors
    /// A shape of `values` other than `grid.shape`.
    pub fn new(grid: Grid, values: Array3<f32>) -> Result<Self> {
        grid.check_shape("the volume", values.shape())?;
        Ok(Self { grid, values })
    }

    /// Creates a volume with the same value in every voxel.
    pub fn constant(grid: Grid, value: f32) -> Self {
        Self { grid, values: Array3::from_elem(grid.shape, value) }
    }

    /// Some rows and columns of the volume.
    ///
    /// # Errors
    /// As [`Grid::part`].
    pub fn part(&self, rows: Range<usize>, cols: Range<usize>) -> Result<Self> {
        let grid = self.grid.part(rows.clone(), cols.clone())?;
        Ok(Self { grid, values: self.values.slice(s![.., rows, cols]).to_owned() })
    }

    /// Returns an error unless every value is finite and not negative.
    ///
    /// # Errors
    /// An [`Error::OutOfRange`] that names `quantity`, the first invalid voxel and its value.
    pub fn check_non_negative(&self, quantity: &'static str) -> Result<()> {
        match self.values.indexed_iter().find(|(_, value)| !(value.is_finite() && **value >= 0.0)) {
            None => Ok(()),
            Some(((k, j, i), value)) => Err(Error::out_of_range(
                quantity,
                format!("{value} at voxel [z {k}, y {j}, x {i}]"),
                "finite and not negative",
            )),
        }
    }
}

/// A boolean for every voxel of a [`Grid`], array `[z, y, x]`.
#[derive(Debug, Clone, PartialEq)]
pub struct Mask {
    /// The grid of the voxels.
    pub grid: Grid,
    /// Whether each voxel is inside the mask, shape `grid.shape`.
    pub values: Array3<bool>,
}

impl Mask {
    /// Creates a mask from its values.
    ///
    /// # Errors
    /// A shape of `values` other than `grid.shape`.
    pub fn new(grid: Grid, values: Array3<bool>) -> Result<Self> {
        grid.check_shape("the mask", values.shape())?;
        Ok(Self { grid, values })
    }

    /// Number of voxels inside the mask.
    pub fn count(&self) -> usize {
        self.values.iter().filter(|inside| **inside).count()
    }

    /// Some rows and columns of the mask.
    ///
    /// # Errors
    /// As [`Grid::part`].
    pub fn part(&self, rows: Range<usize>, cols: Range<usize>) -> Result<Self> {
        let grid = self.grid.part(rows.clone(), cols.clone())?;
        Ok(Self { grid, values: self.values.slice(s![.., rows, cols]).to_owned() })
    }

    /// Sets `volume` to zero outside the mask.
    ///
    /// # Errors
    /// A volume that is not on the grid of the mask.
    pub fn apply(&self, volume: &mut Volume) -> Result<()> {
        self.grid.check_same("the volume under the mask", &volume.grid)?;
        ndarray::Zip::from(&mut volume.values).and(&self.values).for_each(|value, inside| {
            if !inside {
                *value = 0.0;
            }
        });
        Ok(())
    }
}
