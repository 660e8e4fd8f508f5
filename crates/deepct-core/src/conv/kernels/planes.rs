//! Planes of an output shared out among threads, some rows at a time.

use std::marker::PhantomData;
use std::sync::atomic::{AtomicBool, Ordering};

/// An array `[channel, row, col]` whose bands of rows are handed out once each.
#[derive(Debug)]
pub(crate) struct SharedPlanes<'a> {
    values: *mut f32,
    channels: usize,
    plane_len: usize,
    band_len: usize,
    taken: &'a [AtomicBool],
    borrowed: PhantomData<&'a mut [f32]>,
}

// SAFETY: a shared array only hands out bands, and no band twice.
#[allow(unsafe_code)]
unsafe impl Sync for SharedPlanes<'_> {}

/// A band of rows in every plane, for one thread alone.
#[derive(Debug)]
pub(crate) struct PlaneBand<'a> {
    start: *mut f32,
    len: usize,
    channels: usize,
    plane_len: usize,
    borrowed: PhantomData<&'a mut [f32]>,
}

impl<'a> SharedPlanes<'a> {
    /// Share `values`, planes of `plane_len` each, in bands of `band_len`; `taken` has a
    /// flag for each band, all down.
    pub(crate) fn new(
        values: &'a mut [f32],
        plane_len: usize,
        band_len: usize,
        taken: &'a [AtomicBool],
    ) -> Self {
        let channels = values.len() / plane_len;
        let values = values.as_mut_ptr();
        Self { values, channels, plane_len, band_len, taken, borrowed: PhantomData }
    }

    /// Band `band`, unless somebody has it or there is none.
    #[allow(unsafe_code)]
    pub(crate) fn take(&self, band: usize) -> Option<PlaneBand<'a>> {
        let start = band.checked_mul(self.band_len).filter(|start| *start < self.plane_len)?;
        if self.taken.get(band)?.swap(true, Ordering::Relaxed) {
            return None;
        }
        let Self { channels, plane_len, .. } = *self;
        let len = self.band_len.min(plane_len - start);
        // SAFETY: `start` is inside of the first plane.
        let start = unsafe { self.values.add(start) };
        Some(PlaneBand { start, len, channels, plane_len, borrowed: PhantomData })
    }
}

impl PlaneBand<'_> {
    /// The rows of the band in the plane of `channel`.
    ///
    /// # Panics
    /// When there is no such channel.
    #[allow(unsafe_code)]
    pub(crate) fn plane(&mut self, channel: usize) -> &mut [f32] {
        assert!(channel < self.channels);
        // SAFETY: the rows lie in plane `channel` of the array that is borrowed for as long
        // as bands live. No other band has any of them, because each is handed out once and
        // bands do not overlap; no other plane of this band is alive, because this borrows
        // the band.
        unsafe {
            std::slice::from_raw_parts_mut(self.start.add(channel * self.plane_len), self.len)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_is_handed_out_once() {
        let (plane_len, channels) = (41, 3);
        let mut values = vec![0.0_f32; plane_len * channels];
        let taken: Vec<AtomicBool> = (0..7).map(|_| AtomicBool::new(false)).collect();
        let planes = SharedPlanes::new(&mut values, plane_len, 6, &taken);
        rayon::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|_| {
                    for mut band in (0..9).filter_map(|band| planes.take(band)) {
                        for channel in 0..channels {
                            band.plane(channel).iter_mut().for_each(|value| *value += 1.0);
                        }
                    }
                });
            }
        });
        assert!((0..9).all(|band| planes.take(band).is_none()));
        assert!(values.iter().all(|value| *value == 1.0));
    }
}
