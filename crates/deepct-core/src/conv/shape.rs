//! Shape arithmetic of a convolution and of the bands that it works on.

use std::ops::Range;

/// Number of taps of a 3x3 kernel.
pub(super) const TAPS: usize = 9;

/// The shape of one 3x3 convolution with padding 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Conv2dShape {
    /// Channels read.
    pub input_channels: usize,
    /// Channels written.
    pub output_channels: usize,
    /// Rows of an image, in and out.
    pub rows: usize,
    /// Columns of an image, in and out.
    pub cols: usize,
}

impl Conv2dShape {
    /// Number of values read.
    pub fn input_len(&self) -> usize {
        self.input_channels * self.rows * self.cols
    }

    /// Number of values written.
    pub fn output_len(&self) -> usize {
        self.output_channels * self.rows * self.cols
    }

    /// Multiplications and additions, counted as two operations, of the plain sum;
    /// those with the zeros beyond the border are counted too.
    pub fn operations(&self) -> u64 {
        2 * (TAPS * self.input_channels) as u64 * self.output_len() as u64
    }
}

/// Rows of an image that are computed together: two rows of tiles of F(2x2), one of
/// F(4x4).
pub(super) const BAND: usize = 4;

/// Rows of the input that a band of the output depends on.
pub(super) const SEEN: usize = BAND + 2;

/// How an image lies in memory between the layers: in bands of [`BAND`] rows, each
/// `[row, column, channel]` with the channels in whole vectors.
///
/// One column of zeros stands left of the image and at least one right of it, where the
/// last tile of four columns ends. Rows that the last band has beyond the image are zeros
/// too. So no loop knows a border, and a tile may end anywhere.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Bands {
    pub(super) rows: usize,
    pub(super) cols: usize,
}

impl Bands {
    /// Number of bands.
    pub(super) fn count(self) -> usize {
        self.rows.div_ceil(BAND)
    }

    /// Number of rows of the image in band `band`.
    pub(super) fn rows_of(self, band: usize) -> usize {
        BAND.min(self.rows - band * BAND)
    }

    /// Columns of the image and those that the last tile has beyond it.
    pub(super) fn whole_cols(self) -> usize {
        self.cols.next_multiple_of(BAND)
    }

    /// Length of a row of pixels of `pitch` floats.
    pub(super) fn row_len(self, pitch: usize) -> usize {
        (self.whole_cols() + 2) * pitch
    }

    /// Length of a band of pixels of `pitch` floats.
    pub(super) fn len(self, pitch: usize) -> usize {
        BAND * self.row_len(pitch)
    }

    /// Set the zeros of a band around the pixels of the image.
    pub(super) fn clear_border(self, band: usize, pitch: usize, values: &mut [f32]) {
        let rows = self.rows_of(band);
        let (inside, below) = values.split_at_mut(rows * self.row_len(pitch));
        for row in inside.chunks_exact_mut(self.row_len(pitch)) {
            row[..pitch].fill(0.0);
            row[(1 + self.cols) * pitch..].fill(0.0);
        }
        below.fill(0.0);
    }
}

/// `0..count` in as few parts as hold at most `most` each, as even as can be.
pub(super) fn even_parts(count: usize, most: usize) -> impl Iterator<Item = Range<usize>> {
    let parts = count.div_ceil(most);
    let at = move |part: usize| part * count / parts;
    (0..parts).map(move |part| at(part)..at(part + 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_paper_s_network_has_its_number_of_operations() {
        let shape = Conv2dShape { input_channels: 32, output_channels: 32, rows: 32, cols: 32 };
        // 0.62 GFLOP for 33 layers.
        assert!((33.0 * shape.operations() as f64 / 1e9 - 0.62).abs() < 0.005);
        assert_eq!((shape.input_len(), shape.output_len()), (32_768, 32_768));
    }

    #[test]
    fn parts_are_even_and_cover_everything() {
        for count in 1..40 {
            for most in 1..9 {
                let parts: Vec<_> = even_parts(count, most).collect();
                assert_eq!(parts.len(), count.div_ceil(most));
                assert!(parts.iter().all(|part| (1..=most).contains(&part.len())));
                let all: Vec<_> = parts.into_iter().flatten().collect();
                assert_eq!(all, (0..count).collect::<Vec<_>>());
            }
        }
    }

    #[test]
    fn only_pixels_of_the_image_keep_their_values() {
        let (bands, pitch) = (Bands { rows: 6, cols: 5 }, 2);
        assert_eq!((bands.count(), bands.whole_cols(), bands.row_len(pitch)), (2, 8, 20));
        let mut values = vec![1.0; bands.len(pitch)];
        bands.clear_border(1, pitch, &mut values);
        for (at, value) in values.iter().enumerate() {
            let (row, col) = (at / 20, at % 20 / pitch);
            let inside = row < 2 && (1..=5).contains(&col);
            assert_eq!(*value, f32::from(u8::from(inside)));
        }
    }
}
