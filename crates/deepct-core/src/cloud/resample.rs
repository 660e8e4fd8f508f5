//! Resampling of droplets onto another grid.

use super::{Cloud, Microphysics};
use crate::error::Result;
use crate::grid::Grid;
use crate::grid::resample::{grid_edges, resample};
use ndarray::Array3;

/// Resamples droplets from cells with the given `edges` along z, y and x (km) onto `grid`. The
/// liquid water content and its ratio to the effective radius, which is proportional to the
/// extinction, are resampled; the new effective radius follows from the two. The effective
/// variance is weighted by the liquid water content.
///
/// # Errors
/// As [`resample`].
pub fn resample_droplets(
    droplets: &Microphysics,
    edges: [&[f64]; 3],
    grid: &Grid,
) -> Result<Cloud> {
    let Microphysics { liquid_water_content: water, effective_radius, effective_variance } =
        droplets;
    let area = ndarray::Zip::from(water)
        .and(effective_radius)
        .map_collect(|&water, &radius| if water > 0.0 { water / radius } else { 0.0 });
    let spread = ndarray::Zip::from(water)
        .and(effective_variance)
        .map_collect(|&water, &variance| water * variance);
    let [water, area, spread] = [water, &area, &spread].map(|field| resample(field, edges, grid));
    let (water, area, spread) = (water?, area?, spread?);
    let ratio = |above: &Array3<f32>, below: &Array3<f32>| {
        ndarray::Zip::from(above)
            .and(below)
            .map_collect(|&above, &below| if below > 0.0 { above / below } else { 0.0 })
    };
    let effective_radius = ratio(&water, &area);
    let effective_variance = ratio(&spread, &water);
    Cloud::from_microphysics(
        *grid,
        Microphysics { liquid_water_content: water, effective_radius, effective_variance },
    )
}

impl Cloud {
    /// The cloud on another grid; there is none outside its own. Its extinction, if it is given, is
    /// resampled like its water ([`crate::grid::resample`]).
    ///
    /// # Errors
    /// As [`resample_droplets`].
    pub fn resampled(&self, grid: &Grid) -> Result<Cloud> {
        let [z, y, x] = grid_edges(&self.grid);
        let edges = [z.as_slice(), &y, &x];
        let mut cloud = match &self.microphysics {
            Some(droplets) => resample_droplets(droplets, edges, grid)?,
            None => Cloud { grid: *grid, microphysics: None, extinction: None },
        };
        let extinction = self.extinction.as_ref();
        cloud.extinction = extinction.map(|values| resample(values, edges, grid)).transpose()?;
        Ok(cloud)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::resample::uniform_edges;
    use crate::math::DVec3;

    fn wavy(shape: [usize; 3]) -> Array3<f32> {
        Array3::from_shape_fn(shape, |(k, j, i)| ((k * 7 + j * 5 + i * 3) % 11) as f32)
    }

    #[test]
    fn droplets_keep_water_and_extinction() {
        let droplets = Microphysics {
            liquid_water_content: wavy([2, 4, 4]),
            effective_radius: wavy([2, 4, 4]).mapv(|value| 5.0 + value),
            effective_variance: Array3::from_elem((2, 4, 4), 0.1),
        };
        let edges = [uniform_edges(0.0, 1.0, 2), uniform_edges(0.0, 1.0, 4)];
        let grid = Grid::new(DVec3::ZERO, DVec3::new(2.0, 2.0, 1.0), [2, 2, 2]).unwrap();
        let cloud = resample_droplets(&droplets, [&edges[0], &edges[1], &edges[1]], &grid);
        let coarse = cloud.unwrap().microphysics.unwrap();
        let sum = |droplets: &Microphysics| -> (f32, f32) {
            let pairs = droplets.liquid_water_content.iter().zip(&droplets.effective_radius);
            pairs.fold((0.0, 0.0), |(water, area), (w, r)| {
                (water + w, area + if *w > 0.0 { w / r } else { 0.0 })
            })
        };
        let (before, after) = (sum(&droplets), sum(&coarse));
        assert!((4.0 * after.0 / before.0 - 1.0).abs() < 1e-5);
        assert!((4.0 * after.1 / before.1 - 1.0).abs() < 1e-5);
    }
}
