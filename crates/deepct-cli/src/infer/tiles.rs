//! Fields that are larger than the memory: they are estimated tile by tile.
//!
//! Each tile is estimated from the parts of the images that show it and the columns around it that the
//! network reads, and kept in a file of its own, so that an interrupted run can be continued. At the end,
//! the tiles are joined. The tiles depend on the grid alone, and so do the bytes of the result.

use super::{Run, Summary, TILE, apply, given_mask, infer};
use crate::progress::{Progress, stopped};
use deepct_core::grid::{Grid, Mask, Volume};
use deepct_core::io::{
    EstimateFile, ImagesFile, Provenance, configuration, read_estimate, write_estimate,
};
use deepct_core::network::Estimate;
use deepct_core::scene::{Observation, Tile};
use deepct_core::{Error, Result, files};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Sums over all tiles, and the tile with the most extinction.
#[derive(Debug, Default)]
struct Total {
    largest: f32,
    extinction: f64,
    uncertainty: f64,
    has_uncertainty: bool,
    /// Its number and the sum of its extinction.
    thickest: Option<(usize, f64)>,
}

impl Run<'_> {
    /// Estimate the extinction tile by tile.
    pub(super) fn tiles(
        &self,
        mut file: ImagesFile,
        grid: &Grid,
        [images, out]: [&Path; 2],
    ) -> Result<Summary> {
        let folder = beside(out);
        std::fs::create_dir_all(&folder).map_err(Error::io(&folder))?;
        let provenance = self.provenance(images, Some(&files::sha256(images)?));
        let mask = self.args.mask.as_deref().map(|path| given_mask(path, grid)).transpose()?;
        let tiles = Tile::all(file.views(), grid, TILE, self.network.halo(grid))?;
        let progress = Progress::start(self.global, "tiles", tiles.len() as u64);
        for (number, tile) in tiles.iter().enumerate() {
            let path = path_of(&folder, number);
            if configuration(&path).as_deref() != Some(&provenance.configuration) {
                let estimate = self.tile(&mut file, grid, tile, mask.as_ref(), images)?;
                write_estimate(&path, &estimate, None, &provenance)?;
            }
            progress.advance(1);
            if stopped() {
                note!("deepct: stopped early; repeat the command to continue");
                return Err(Error::Interrupted);
            }
        }
        drop(progress);
        let total = join(&folder, out, grid, &tiles, &mut file, &provenance)?;
        if let Some((number, _)) = total.thickest {
            if let Some(observation) = seen(&mut file, &tiles[number], images)? {
                let estimate = infer(&self.network, &observation, &tiles[number].around)?;
                self.args.network.warn_of_unusual_images(&self.network, &observation, &estimate)?;
                self.args.network.warn_of_ends(&estimate);
            }
        }
        std::fs::remove_dir_all(&folder).map_err(Error::io(&folder))?;
        let is_known = total.has_uncertainty && total.extinction > 0.0;
        Ok(Summary {
            images: images.into(),
            out: out.into(),
            shape: grid.shape,
            altitudes_km: [grid.lower().z, grid.upper().z],
            largest: total.largest,
            expected_epsilon: is_known.then(|| total.uncertainty / total.extinction),
            rounding: None,
        })
    }

    /// The estimate of a tile. Where no image shows it, there is no cloud.
    fn tile(
        &self,
        file: &mut ImagesFile,
        grid: &Grid,
        tile: &Tile,
        mask: Option<&Mask>,
        images: &Path,
    ) -> Result<Estimate> {
        let (rows, cols) = (tile.rows.clone(), tile.cols.clone());
        let own = grid.part(rows.clone(), cols.clone())?;
        let Some(observation) = seen(file, tile, images)? else {
            return Ok(Estimate { extinction: Volume::constant(own, 0.0), uncertainty: None });
        };
        let estimate = infer(&self.network, &observation, &tile.around);
        let estimate = estimate.map_err(Error::in_file(images))?;
        let [inner_rows, inner_cols] = tile.inner(grid);
        let inner = |volume: &Volume| volume.part(inner_rows.clone(), inner_cols.clone());
        let mut estimate = Estimate {
            extinction: inner(&estimate.extinction)?,
            uncertainty: estimate.uncertainty.as_ref().map(inner).transpose()?,
        };
        let mask = match mask {
            Some(mask) => Some(mask.part(rows, cols)?),
            None => self.carved(images, &observation, &own)?,
        };
        mask.map_or(Ok(()), |mask| apply(&mask, &mut estimate))?;
        Ok(estimate)
    }
}

/// The parts of the images that have an influence on the estimate of a tile, unless there are none.
fn seen(file: &mut ImagesFile, tile: &Tile, images: &Path) -> Result<Option<Observation>> {
    let part = |[rows, cols]: [Range<usize>; 2]| file.part(rows, cols);
    tile.pixels.clone().map(part).transpose().map_err(Error::in_file(images))
}

/// Join the tiles in one file.
fn join(
    folder: &Path,
    out: &Path,
    grid: &Grid,
    tiles: &[Tile],
    file: &mut ImagesFile,
    provenance: &Provenance,
) -> Result<Total> {
    let mut total = Total::default();
    let first = read_estimate(path_of(folder, 0))?;
    total.has_uncertainty = first.uncertainty.is_some();
    let corner = file.part(0..1, 0..1)?;
    let joined = EstimateFile::create(out, grid, total.has_uncertainty, Some(&corner), provenance)?;
    for (number, tile) in tiles.iter().enumerate() {
        let estimate = read_estimate(path_of(folder, number))?;
        joined.write([tile.rows.start, tile.cols.start], &estimate)?;
        total.add(number, &estimate);
    }
    joined.finish()?;
    Ok(total)
}

impl Total {
    fn add(&mut self, number: usize, estimate: &Estimate) {
        let sum = |volume: &Volume| volume.values.iter().map(|&v| f64::from(v)).sum::<f64>();
        let extinction = sum(&estimate.extinction);
        self.extinction += extinction;
        self.uncertainty += estimate.uncertainty.as_ref().map_or(0.0, sum);
        self.largest = estimate.extinction.values.iter().copied().fold(self.largest, f32::max);
        if extinction > self.thickest.map_or(0.0, |(_, most)| most) {
            self.thickest = Some((number, extinction));
        }
    }
}

/// The folder of the tiles of an output.
fn beside(out: &Path) -> PathBuf {
    let mut name = out.as_os_str().to_owned();
    name.push(".tiles");
    name.into()
}

/// The file of a tile.
fn path_of(folder: &Path, number: usize) -> PathBuf {
    folder.join(format!("{number}.nc"))
}
