//! Distribution of the output planes among threads, in bands of rows.

use std::marker::PhantomData;
use std::sync::atomic::{AtomicBool, Ordering};

/// An array `[channel, row, col]` whose bands of rows are each handed out once.
#[derive(Debug)]
pub(crate) struct SharedPlanes<'a> {
    values: *mut f32,
    channels: usize,
    plane_len: usize,
    band_len: usize,
    taken: &'a [AtomicBool],
    borrowed: PhantomData<&'a mut [f32]>,
}

// SAFETY: a shared array hands out disjoint bands, each at most once.
#[allow(unsafe_code)]
unsafe impl Sync for SharedPlanes<'_> {}

/// A band of rows in every plane, for exclusive use by one thread.
#[derive(Debug)]
pub(crate) struct PlaneBand<'a> {
    start: *mut f32,
    len: usize,
    channels: usize,
    plane_len: usize,
    borrowed: PhantomData<&'a mut [f32]>,
}

impl<'a> SharedPlanes<'a> {
    /// Share `values`, which consist of planes of length `plane_len`, in bands of length
    /// `band_len`. `taken` has a flag for each band, initially false.
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

    /// Band `band`; `None` if it has been taken already or does not exist.
    #[allow(unsafe_code)]
    pub(crate) fn take(&self, band: usize) -> Option<PlaneBand<'a>> {
        let start = band.checked_mul(self.band_len).filter(|start| *start < self.plane_len)?;
        if self.taken.get(band)?.swap(true, Ordering::Relaxed) {
            return None;
        }
        let Self { channels, plane_len, .. } = *self;
        let len = self.band_len.min(plane_len - start);
        // SAFETY: `start` is inside the first plane.
        let start = unsafe { self.values.add(start) };
        Some(PlaneBand { start, len, channels, plane_len, borrowed: PhantomData })
    }
}

impl PlaneBand<'_> {
    /// The rows of the band in the plane of `channel`.
    ///
    /// # Panics
    /// Panics if there is no such channel.
    #[allow(unsafe_code)]
    pub(crate) fn plane(&mut self, channel: usize) -> &mut [f32] {
        assert!(channel < self.channels);
        // SAFETY: the rows are in plane `channel` of the array, which is borrowed for the
        // lifetime of the bands. No other band contains any of them, because each band is handed
        // out once and bands do not overlap. No other slice of this band exists, because this
        // method borrows the band mutably.
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
