//! The columns of a panel: for a run of pixels, what each tap of each channel sees.

use super::shape::Plane;
use std::ops::Range;

/// A panel of a padded input: which channels, from which position on.
#[derive(Debug, Clone)]
pub(crate) struct Panel<'a> {
    /// All planes of the input, one after another.
    pub(super) planes: &'a [f32],
    /// The layout of a plane.
    pub(super) plane: Plane,
    /// The channels wanted.
    pub(super) channels: Range<usize>,
    /// Position of the first pixel.
    pub(super) first: usize,
}

/// Write the columns of `panel`: for each channel and tap, in the order of the weights,
/// the `PIXELS` values that the tap sees.
///
/// Inlined into each kernel's own version, so that the copies use its registers.
#[inline(always)]
pub(super) fn gather<const PIXELS: usize>(panel: Panel<'_>, columns: &mut [f32]) {
    let (plane_len, pitch) = (panel.plane.len(), panel.plane.pitch());
    let (columns, _) = columns.as_chunks_mut::<PIXELS>();
    let (columns, _) = columns.as_chunks_mut::<9>();
    for (taps, channel) in columns.iter_mut().zip(panel.channels) {
        let seen = &panel.planes[channel * plane_len + panel.first..];
        for (tap, column) in taps.iter_mut().enumerate() {
            let from = tap / 3 * pitch + tap % 3;
            column.copy_from_slice(&seen[from..from + PIXELS]);
        }
    }
}
