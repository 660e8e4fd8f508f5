//! Shapes of a convolution and memory layout of the bands in which it is computed.

use std::ops::Range;

/// Number of taps of a 3x3 kernel.
pub(super) const TAPS: usize = 9;

/// The shape of one 3x3 convolution with padding 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Conv2dShape {
    /// Number of input channels.
    pub input_channels: usize,
    /// Number of output channels.
    pub output_channels: usize,
    /// Number of rows of the input and output images.
    pub rows: usize,
    /// Number of columns of the input and output images.
    pub cols: usize,
}

impl Conv2dShape {
    /// Number of input values.
    pub fn input_len(&self) -> usize {
        self.input_channels * self.rows * self.cols
    }

    /// Number of output values.
    pub fn output_len(&self) -> usize {
        self.output_channels * self.rows * self.cols
    }

    /// Number of floating-point operations of the direct sum. A multiplication and an addition
    /// count as two, and products with the zero padding are included.
    pub fn operations(&self) -> u64 {
        2 * (TAPS * self.input_channels) as u64 * self.output_len() as u64
    }
}

/// Number of image rows that are computed together: two rows of F(2x2) tiles or one row of
/// F(4x4) tiles.
pub(super) const BAND: usize = 4;

/// Number of input rows that a band of the output depends on.
pub(super) const SEEN: usize = BAND + 2;

/// Memory layout of an image between the layers: bands of [`BAND`] rows, each
/// `[row, column, channel]` with the channels padded to whole vectors.
///
/// There is one column of zeros to the left of the image and at least one to the right, up to
/// the end of the last tile of four columns. Rows of the last band beyond the image are also
/// zero. The loops therefore need no special case at the border, and tiles may extend beyond it.
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

    /// Number of columns of the image, rounded up to whole tiles.
    pub(super) fn whole_cols(self) -> usize {
        self.cols.next_multiple_of(BAND)
    }

    /// Length of a row (floats) for pixels of `pitch` floats.
    pub(super) fn row_len(self, pitch: usize) -> usize {
        (self.whole_cols() + 2) * pitch
    }

    /// Length of a band (floats) for pixels of `pitch` floats.
    pub(super) fn len(self, pitch: usize) -> usize {
        BAND * self.row_len(pitch)
    }

    /// Set the values of a band outside the image to zero.
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

/// Divide `0..count` as evenly as possible into the fewest parts of at most `most` each.
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
