//! The input of the first layer.

use std::ops::Range;

/// Images that the first layer reads row by row: either an array or values computed on demand.
/// Channels that are derived from a few images then never have to be in memory all at once.
pub trait Source: Sync {
    /// Write a row of an image: channel `c` of column `columns.start + i` is
    /// `pixels[i * pitch + c]`. All pixels are 0 on entry.
    ///
    /// The same row may be read several times and by several threads at once. If a source panics,
    /// the run panics. A source must not run another stack in the same thread pool.
    fn read(&self, row: &SourceRow, pixels: &mut [f32]);
}

/// Part of a row of an image and its memory layout.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SourceRow {
    /// Index of the image in the batch.
    pub image: usize,
    /// Row of the image.
    pub row: usize,
    /// Columns of the row.
    pub columns: Range<usize>,
    /// Distance from one pixel to the next, in floats.
    pub pitch: usize,
}

/// An array `[image, channel, row, col]`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Planes<'a> {
    pub(super) values: &'a [f32],
    pub(super) channels: usize,
    pub(super) rows: usize,
    pub(super) cols: usize,
    /// Factor by which every value is multiplied.
    pub(super) scale: f32,
}

impl Source for Planes<'_> {
    fn read(&self, row: &SourceRow, pixels: &mut [f32]) {
        let plane = self.rows * self.cols;
        let image = &self.values[row.image * self.channels * plane..][..self.channels * plane];
        for (channel, plane) in image.chunks_exact(plane).enumerate() {
            let seen = &plane[row.row * self.cols..][..self.cols][row.columns.clone()];
            let pixels = pixels[channel..].iter_mut().step_by(row.pitch);
            pixels.zip(seen).for_each(|(pixel, value)| *pixel = self.scale * value);
        }
    }
}
