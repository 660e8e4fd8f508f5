//! Isolation of single clouds from a periodic field.
//!
//! A cloud is a set of cloudy columns that share sides, also across the periodic boundaries.
//! Columns are joined instead of voxels because water above or below in the same column projects
//! onto the same pixels, and a complete column preserves the optical depth of the simulation.

use super::{Cloud, Microphysics};
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::math::DVec3;
use ndarray::{Array2, Array3, Axis, s};

/// Criteria for the clouds to isolate, and the size of the domain around each.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IsolateSettings {
    /// Columns along each side of the square around a cloud.
    pub side: usize,
    /// Minimum number of cloud-free columns between the cloud and each side of the square.
    pub margin: usize,
    /// A column is cloudy if the liquid water content of any of its voxels exceeds this (g/m3).
    pub threshold: f32,
    /// Minimum number of columns of a cloud.
    pub columns: usize,
    /// Minimum of the largest liquid water path of a cloud (g/m2).
    pub water_path: f32,
}

impl Default for IsolateSettings {
    /// Squares of 32 columns; clouds of ten columns or more whose liquid water path reaches
    /// 20 g/m2 (an optical depth of about 5).
    fn default() -> Self {
        Self { side: 32, margin: 1, threshold: 0.01, columns: 10, water_path: 20.0 }
    }
}

/// A square cut out of a field, which contains a single cloud ([`isolate`]) or all clouds within
/// the square ([`tile`](super::tile)).
#[derive(Debug, Clone, PartialEq)]
pub struct Piece {
    /// The cloud or clouds, on a subset of the field's grid.
    pub cloud: Cloud,
    /// Row and column of the south-west corner in the field. The periodic continuation counts
    /// too, so the values may be negative or beyond the field.
    pub corner: [i64; 2],
    /// Number of cloudy columns.
    pub columns: usize,
    /// The largest liquid water path of a column (g/m2).
    pub water_path: f32,
}

/// The numbers of clouds of a field that [`isolate`] leaves out.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LeftOut {
    /// Those of fewer columns than [`IsolateSettings::columns`].
    pub small: usize,
    /// Those whose liquid water path is below [`IsolateSettings::water_path`].
    pub thin: usize,
    /// Those that do not fit into the square.
    pub large: usize,
}

/// Statistics of the columns of a field, by row and column.
pub(super) struct Overview {
    /// Largest liquid water content of a voxel in the column (g/m3).
    pub(super) highest: Array2<f32>,
    /// Liquid water path (g/m2).
    pub(super) path: Array2<f32>,
}

impl Overview {
    /// # Errors
    /// Returns an error if the field has no droplets.
    pub(super) fn of(field: &Cloud) -> Result<Self> {
        let Some(droplets) = &field.microphysics else {
            return Err(Error::out_of_range("cloud field", "given by extinction", "with droplets"));
        };
        let water = &droplets.liquid_water_content;
        Ok(Self {
            highest: water.fold_axis(Axis(0), 0.0_f32, |most, water| most.max(*water)),
            path: water.sum_axis(Axis(0)) * (1e3 * field.grid.spacing.z) as f32,
        })
    }

    /// Maps a row and column of the periodic continuation to those inside the field.
    pub(super) fn wrap(&self, [row, col]: [i64; 2]) -> (usize, usize) {
        let (rows, cols) = self.path.dim();
        (row.rem_euclid(rows as i64) as usize, col.rem_euclid(cols as i64) as usize)
    }
}

/// The clouds of a periodic field that are large enough and fit into a square with its margin,
/// ordered by their first column from south to north and west to east.
///
/// # Errors
/// Returns an error if the field has no droplets, or if the side leaves no room between the
/// margins or exceeds the field.
pub fn isolate(field: &Cloud, settings: &IsolateSettings) -> Result<Vec<Piece>> {
    isolate_and_count(field, settings).map(|(pieces, _)| pieces)
}

/// As [`isolate`]; also returns how many clouds are left out, and why.
///
/// # Errors
/// As [`isolate`].
pub fn isolate_and_count(
    field: &Cloud,
    settings: &IsolateSettings,
) -> Result<(Vec<Piece>, LeftOut)> {
    let overview = Overview::of(field)?;
    let [_, rows, cols] = field.grid.shape;
    let fits = settings.side > 2 * settings.margin && settings.side <= rows.min(cols);
    if !fits {
        return Err(Error::out_of_range(
            "side of an isolated cloud",
            settings.side,
            format!("above two margins of {} and within {rows} x {cols}", settings.margin),
        ));
    }
    let highest = &overview.highest;
    let mut taken = Array2::from_elem((rows, cols), false);
    let (mut isolated, mut left_out) = (Vec::new(), LeftOut::default());
    for start in ndarray::indices((rows, cols)) {
        if taken[start] || highest[start] <= settings.threshold {
            continue;
        }
        let patch = flood(start, &mut taken, |at| highest[at] > settings.threshold);
        let path = |at: &[i64; 2]| overview.path[overview.wrap(*at)];
        let water_path = patch.iter().map(path).fold(0.0, f32::max);
        if patch.len() < settings.columns {
            left_out.small += 1;
        } else if water_path < settings.water_path {
            left_out.thin += 1;
        } else if let Some(corner) = corner(&patch, settings) {
            let cloud = cut(field, &overview, &patch, corner, settings.side)?;
            isolated.push(Piece { cloud, corner, columns: patch.len(), water_path });
        } else {
            left_out.large += 1;
        }
    }
    Ok((isolated, left_out))
}

/// The cloudy columns connected to `start`, in unwrapped coordinates. A patch that connects to
/// itself across the periodic boundaries has the extent of the whole domain.
fn flood(
    start: (usize, usize),
    taken: &mut Array2<bool>,
    cloudy: impl Fn((usize, usize)) -> bool,
) -> Vec<[i64; 2]> {
    let (rows, cols) = taken.dim();
    let mut patch = vec![[start.0 as i64, start.1 as i64]];
    taken[start] = true;
    let mut next = 0;
    while let Some(&[row, col]) = patch.get(next) {
        next += 1;
        for [row, col] in [[row - 1, col], [row + 1, col], [row, col - 1], [row, col + 1]] {
            let at = (row.rem_euclid(rows as i64) as usize, col.rem_euclid(cols as i64) as usize);
            if !taken[at] && cloudy(at) {
                taken[at] = true;
                patch.push([row, col]);
            }
        }
    }
    patch
}

/// The south-west corner of the square centred on the bounding box of the patch, or `None` if the
/// patch does not fit between the margins.
fn corner(patch: &[[i64; 2]], settings: &IsolateSettings) -> Option<[i64; 2]> {
    let mut corner = [0; 2];
    for axis in 0..2 {
        let low = patch.iter().map(|at| at[axis]).min()?;
        let high = patch.iter().map(|at| at[axis]).max()?;
        let length = high - low + 1;
        if length > (settings.side - 2 * settings.margin) as i64 {
            return None;
        }
        corner[axis] = low - (settings.side as i64 - length) / 2;
    }
    Some(corner)
}

/// The columns of `patch` on a square of `side` columns; all other columns of it are cloud-free.
pub(super) fn cut(
    field: &Cloud,
    overview: &Overview,
    patch: &[[i64; 2]],
    corner: [i64; 2],
    side: usize,
) -> Result<Cloud> {
    let levels = field.grid.shape[0];
    let spacing = field.grid.spacing;
    let offset = DVec3::new(corner[1] as f64, corner[0] as f64, 0.0);
    let grid = Grid::new(field.grid.origin + offset * spacing, spacing, [levels, side, side])?;
    let columns = |values: &Array3<f32>| {
        let mut cut = Array3::zeros(grid.shape);
        for &[row, col] in patch {
            let inside = [(row - corner[0]) as usize, (col - corner[1]) as usize];
            let (row, col) = overview.wrap([row, col]);
            cut.slice_mut(s![.., inside[0], inside[1]]).assign(&values.slice(s![.., row, col]));
        }
        cut
    };
    let droplets = field.microphysics.as_ref().map(|droplets| Microphysics {
        liquid_water_content: columns(&droplets.liquid_water_content),
        effective_radius: columns(&droplets.effective_radius),
        effective_variance: columns(&droplets.effective_variance),
    });
    Ok(Cloud { grid, microphysics: droplets, extinction: field.extinction.as_ref().map(columns) })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A field of 20 x 20 columns with water in one level of the given columns.
    fn field(columns: &[(usize, usize)]) -> Cloud {
        let grid = Grid::new(DVec3::ZERO, DVec3::new(0.05, 0.05, 0.04), [3, 20, 20]).unwrap();
        let mut water = Array3::zeros(grid.shape);
        for (order, &(row, col)) in columns.iter().enumerate() {
            water[[1, row, col]] = 1.0 + order as f32;
        }
        let droplets = Microphysics::from_droplet_number(water, 100.0).unwrap();
        Cloud::from_microphysics(grid, droplets).unwrap()
    }

    fn settings(side: usize) -> IsolateSettings {
        IsolateSettings { side, columns: 1, ..IsolateSettings::default() }
    }

    fn water(isolated: &Piece) -> &Array3<f32> {
        &isolated.cloud.microphysics.as_ref().unwrap().liquid_water_content
    }

    #[test]
    fn a_cloud_across_the_corner_is_one() {
        let field = field(&[(0, 0), (19, 0), (0, 19), (19, 19), (8, 8)]);
        let clouds = isolate(&field, &settings(6)).unwrap();
        assert_eq!(clouds.len(), 2);
        assert_eq!((clouds[0].columns, clouds[0].corner), (4, [-3, -3]));
        let origin = DVec3::new(-0.15, -0.15, 0.0);
        assert!(clouds[0].cloud.grid.origin.distance(origin) < 1e-12);
        let found: Vec<_> = [(2, 2), (2, 3), (3, 2), (3, 3)]
            .map(|(row, col)| water(&clouds[0])[[1, row, col]])
            .into();
        assert_eq!(found, [4.0, 2.0, 3.0, 1.0]);
        assert_eq!(water(&clouds[0]).sum(), 10.0);
    }

    #[test]
    fn the_water_of_a_neighbour_is_removed() {
        // The two clouds touch only at a corner, and each lies within the square of the other.
        let clouds = isolate(&field(&[(5, 5), (6, 6)]), &settings(8)).unwrap();
        assert_eq!(clouds.len(), 2);
        assert_eq!((water(&clouds[0]).sum(), water(&clouds[1]).sum()), (1.0, 2.0));
    }

    #[test]
    fn clouds_that_are_left_out_are_counted() {
        let mut columns = vec![(7, 2), (10, 2), (10, 3), (13, 2), (13, 3), (13, 4)];
        columns.extend((0..9).map(|col| (3, col)));
        // 1, 2, 3 and 9 columns; the water grows by 40 g/m2 from column to column.
        let criteria = IsolateSettings { columns: 2, water_path: 200.0, ..settings(8) };
        let (clouds, left_out) = isolate_and_count(&field(&columns), &criteria).unwrap();
        assert_eq!(clouds.len(), 1);
        assert_eq!(left_out, LeftOut { small: 1, thin: 1, large: 1 });
    }

    #[test]
    fn large_small_and_thin_clouds_are_left_out() {
        let row: Vec<_> = (0..5).map(|col| (3, col)).collect();
        assert_eq!(isolate(&field(&row), &settings(7)).unwrap().len(), 1);
        assert!(isolate(&field(&row), &settings(6)).unwrap().is_empty());
        let endless: Vec<_> = (0..20).map(|col| (3, col)).collect();
        assert!(isolate(&field(&endless), &settings(20)).unwrap().is_empty());
        let few = IsolateSettings { columns: 6, ..settings(7) };
        assert!(isolate(&field(&row), &few).unwrap().is_empty());
        // The column with the most water has 5 g/m3 over 40 m.
        let thin = IsolateSettings { water_path: 200.1, ..settings(7) };
        assert!(isolate(&field(&row), &thin).unwrap().is_empty());
        assert!(isolate(&field(&row), &settings(21)).is_err());
        assert!(isolate(&field(&row), &settings(2)).is_err());
    }
}
