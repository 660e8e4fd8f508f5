//! Fields that are larger than the memory: they are computed tile by tile.
//!
//! Each tile is computed from the parts of the images that show it and the columns around it, and kept in
//! a file of its own, so that an interrupted run can be continued. At the end, the tiles are joined. The
//! tiles depend on the grid alone, and so do the bytes of the result.

use crate::global::Global;
use crate::progress::{Progress, stop_when_asked, stopped};
use deepct_core::grid::{Grid, Mask, Volume};
use deepct_core::io::{
    EstimateFile, ImagesFile, Provenance, configuration, read_estimate, read_mask, write_estimate,
};
use deepct_core::network::Estimate;
use deepct_core::scene::{Observation, Tile};
use deepct_core::{Error, Result, files};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// A field, and where it is written.
pub(crate) struct Field<'a> {
    pub(crate) file: ImagesFile,
    /// The path of the images.
    pub(crate) images: &'a Path,
    pub(crate) grid: Grid,
    pub(crate) tiles: Vec<Tile>,
    pub(crate) out: &'a Path,
    /// A tile that was computed by another configuration is computed again.
    pub(crate) provenance: Provenance,
}

/// Sums over all tiles, and the tile with the most extinction.
#[derive(Debug, Default)]
pub(crate) struct Total {
    /// Largest extinction (1/km).
    pub(crate) largest: f32,
    extinction: f64,
    uncertainty: f64,
    has_uncertainty: bool,
    /// Its number and the sum of its extinction.
    thickest: Option<(usize, f64)>,
}

impl Field<'_> {
    /// Computes each tile that does not exist yet, on the grid around it from the parts of the images
    /// that show it, and joins them. `compute` may set the estimate to zero outside of a mask.
    pub(crate) fn compute(
        &mut self,
        global: &Global,
        mut compute: impl FnMut(&Observation, &Tile) -> Result<Estimate>,
    ) -> Result<Total> {
        let folder = self.folder();
        std::fs::create_dir_all(&folder).map_err(Error::io(&folder))?;
        stop_when_asked();
        let progress = Progress::start(global, "tiles", self.tiles.len() as u64);
        for number in 0..self.tiles.len() {
            let path = self.path(number);
            if configuration(&path).as_deref() != Some(&self.provenance.configuration) {
                let estimate = self.tile(number, &mut compute);
                if stopped() {
                    note!("deepct: stopped early; repeat the command to continue");
                    return Err(Error::Interrupted);
                }
                write_estimate(&path, &estimate?, None, &self.provenance)?;
            }
            progress.advance(1);
        }
        drop(progress);
        let total = self.join()?;
        std::fs::remove_dir_all(&folder).map_err(Error::io(&folder))?;
        Ok(total)
    }

    /// The parts of the images that show the tile with the most extinction, and the tile.
    pub(crate) fn thickest(&mut self, total: &Total) -> Result<Option<(Observation, Tile)>> {
        let Some((number, _)) = total.thickest else { return Ok(None) };
        let tile = self.tiles[number].clone();
        Ok(self.seen(number)?.map(|observation| (observation, tile)))
    }

    /// A tile. Where no image shows it, there is no cloud.
    fn tile(
        &mut self,
        number: usize,
        compute: &mut impl FnMut(&Observation, &Tile) -> Result<Estimate>,
    ) -> Result<Estimate> {
        let observation = self.seen(number)?;
        let tile = &self.tiles[number];
        let Some(observation) = observation else {
            let own = self.grid.part(tile.rows.clone(), tile.cols.clone())?;
            return Ok(Volume::constant(own, 0.0).into());
        };
        let around = compute(&observation, tile).map_err(Error::in_file(self.images))?;
        let [rows, cols] = tile.inner(&self.grid);
        let inner = |volume: &Volume| volume.part(rows.clone(), cols.clone());
        let uncertainty = around.uncertainty.as_ref().map(inner).transpose()?;
        Ok(Estimate { uncertainty, ..inner(&around.extinction)?.into() })
    }

    /// The parts of the images that show a tile, unless there are none.
    fn seen(&mut self, number: usize) -> Result<Option<Observation>> {
        let part = |[rows, cols]: [Range<usize>; 2]| self.file.part(rows, cols);
        let pixels = self.tiles[number].pixels.clone();
        pixels.map(part).transpose().map_err(Error::in_file(self.images))
    }

    /// Join the tiles in one file.
    fn join(&mut self) -> Result<Total> {
        // A tile that no image shows has no uncertainty.
        let shown = self.tiles.iter().position(|tile| tile.pixels.is_some()).unwrap_or(0);
        let has_uncertainty = read_estimate(self.path(shown))?.uncertainty.is_some();
        let mut total = Total { has_uncertainty, ..Total::default() };
        let corner = self.file.part(0..1, 0..1)?;
        let Self { out, grid, provenance, .. } = self;
        let joined = EstimateFile::create(out, grid, has_uncertainty, Some(&corner), provenance)?;
        for (number, tile) in self.tiles.iter().enumerate() {
            let mut estimate = read_estimate(self.path(number))?;
            if has_uncertainty && estimate.uncertainty.is_none() {
                estimate.uncertainty = Some(Volume::constant(estimate.extinction.grid, 0.0));
            }
            joined.write([tile.rows.start, tile.cols.start], &estimate)?;
            total.add(number, &estimate);
        }
        joined.finish()?;
        Ok(total)
    }

    /// The folder of the tiles.
    fn folder(&self) -> PathBuf {
        let mut name = self.out.as_os_str().to_owned();
        name.push(".tiles");
        name.into()
    }

    /// The file of a tile.
    fn path(&self, number: usize) -> PathBuf {
        self.folder().join(format!("{number}.nc"))
    }
}

impl Total {
    /// The relative error that the network expects of the whole field.
    pub(crate) fn expected_relative_error(&self) -> Option<f64> {
        let is_known = self.has_uncertainty && self.extinction > 0.0;
        is_known.then(|| self.uncertainty / self.extinction)
    }

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

/// What identifies the tiles of a field besides the settings: the contents of the files from which they
/// are computed, and the grid. Of `files`, names of what is built in are left out.
///
/// # Errors
/// A file that cannot be read.
pub(crate) fn identity<'a>(
    files: impl IntoIterator<Item = &'a Path>,
    grid: &Grid,
) -> Result<Vec<String>> {
    let contents = files.into_iter().filter(|file| file.is_file()).map(files::sha256);
    let grid = std::iter::once(Ok(format!("{grid:?}")));
    contents.chain(grid).collect()
}

/// The mask in a file, which must be on the grid of the estimate.
pub(crate) fn given_mask(path: &Path, grid: &Grid) -> Result<Mask> {
    let mask = read_mask(path)?;
    if mask.grid.matches(grid) {
        return Ok(mask);
    }
    let remedy = "carve a mask on the grid of the estimate, or let the command carve it";
    let what = format!("{}: grid of the mask", path.display());
    Err(Error::mismatch(what, grid, mask.grid, remedy))
}

/// The part of the mask of a field in a tile and the columns around it.
pub(crate) fn part_of(mask: &Mask, tile: &Tile) -> Result<Mask> {
    let first = ((tile.around.origin - mask.grid.origin) / mask.grid.spacing).round();
    let [_, rows, cols] = tile.around.shape;
    let range = |first: f64, count: usize| first as usize..first as usize + count;
    mask.part(range(first.y, rows), range(first.x, cols))
}
