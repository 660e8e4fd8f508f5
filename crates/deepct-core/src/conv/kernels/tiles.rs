//! The output shared out among threads, a run of pixels at a time.

use std::marker::PhantomData;
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

/// How the output is cut.
#[derive(Debug, Clone)]
pub(crate) struct Cut {
    /// Length of a plane.
    pub(crate) plane_len: usize,
    /// The positions in each plane that are shared out.
    pub(crate) positions: Range<usize>,
    /// Number of positions in a tile; the last one may have fewer.
    pub(crate) tile: usize,
}

/// A queue of tiles: the same run of positions in every plane of the output. Each tile
/// is handed out once, to whichever thread asks next.
#[derive(Debug)]
pub(crate) struct Tiles<'a> {
    planes: *mut f32,
    channels: usize,
    cut: Cut,
    next: AtomicUsize,
    borrowed: PhantomData<&'a mut [f32]>,
}

// SAFETY: a shared queue only hands out tiles, and no two of them overlap.
#[allow(unsafe_code)]
unsafe impl Sync for Tiles<'_> {}

/// A run of positions in every plane, for one thread alone.
#[derive(Debug)]
pub(crate) struct Tile<'a> {
    /// Where the tile starts, counted from the first position shared out.
    pub(crate) first: usize,
    /// Number of positions.
    pub(crate) len: usize,
    start: *mut f32,
    plane_len: usize,
    channels: usize,
    borrowed: PhantomData<&'a mut [f32]>,
}

impl<'a> Tiles<'a> {
    /// Cut `planes`.
    ///
    /// # Panics
    /// When the positions are not inside of a plane, or a tile is empty.
    pub(crate) fn new(planes: &'a mut [f32], cut: Cut) -> Self {
        assert!(cut.tile > 0 && cut.positions.end <= cut.plane_len);
        let channels = planes.len() / cut.plane_len;
        let next = AtomicUsize::new(0);
        Self { planes: planes.as_mut_ptr(), channels, cut, next, borrowed: PhantomData }
    }

    /// The next tile, until there are none left.
    #[allow(unsafe_code)]
    pub(crate) fn next(&self) -> Option<Tile<'a>> {
        let Range { start, end } = self.cut.positions;
        let first = self.next.fetch_add(1, Ordering::Relaxed).checked_mul(self.cut.tile)?;
        let len = self.cut.tile.min((end - start).checked_sub(first).filter(|left| *left > 0)?);
        // SAFETY: `start + first` is below `end`, which is inside of the first plane.
        let start = unsafe { self.planes.add(start + first) };
        let Cut { plane_len, .. } = self.cut;
        Some(Tile { first, len, start, plane_len, channels: self.channels, borrowed: PhantomData })
    }
}

impl Tile<'_> {
    /// The tile's run of positions in the plane of `channel`.
    ///
    /// # Panics
    /// When there is no such channel.
    #[allow(unsafe_code)]
    pub(crate) fn row(&mut self, channel: usize) -> &mut [f32] {
        assert!(channel < self.channels);
        // SAFETY: the run lies in plane `channel` of the slice that the queue borrows
        // for as long as tiles live. No other tile has any of it, because the queue
        // counts up and tiles of different numbers do not overlap; no other row of this
        // tile is alive, because this borrows the tile.
        unsafe {
            std::slice::from_raw_parts_mut(self.start.add(channel * self.plane_len), self.len)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_position_is_handed_out_once() {
        let (plane_len, channels) = (50, 3);
        let mut planes = vec![0.0_f32; plane_len * channels];
        let cut = Cut { plane_len, positions: 4..45, tile: 6 };
        let tiles = Tiles::new(&mut planes, cut);
        rayon::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|_| {
                    while let Some(mut tile) = tiles.next() {
                        for channel in 0..channels {
                            tile.row(channel).iter_mut().for_each(|value| *value += 1.0);
                        }
                    }
                });
            }
        });
        assert!(tiles.next().is_none());
        for (at, value) in planes.iter().enumerate() {
            let inside = (4..45).contains(&(at % plane_len));
            assert_eq!(*value, f32::from(u8::from(inside)), "at {at}");
        }
    }
}
