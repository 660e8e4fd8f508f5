//! Shape arithmetic of a convolution and of the planes that it works on.

/// Number of taps of a 3x3 kernel.
pub(super) const TAPS: usize = 9;

/// Planes start on multiples of a cache line of 16 floats.
pub(super) const LINE: usize = 16;

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

/// One channel with a border of zeros, laid out so that a tap is an offset.
///
/// Rows follow each other at a distance of `cols + 1`: the one zero after a row is the
/// right border of that row and the left border of the next. A row of zeros comes
/// before and one after. The plane is then a line of numbers, and the value that tap
/// `(ky, kx)` wants for the pixel at `position(row, col) = row * pitch + col` stands at
/// `position + ky * pitch + kx`, for the borders too.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Plane {
    pub(super) rows: usize,
    pub(super) cols: usize,
}

/// The most pixels that a kernel takes at once; planes are so long that a panel may start
/// at any position.
pub(super) const MAX_PANEL: usize = 64;

impl Plane {
    /// Distance between rows.
    pub(super) fn pitch(self) -> usize {
        self.cols + 1
    }

    /// Where pixel `[0, 0]` stands in the plane.
    pub(super) fn head(self) -> usize {
        self.pitch() + 1
    }

    /// Number of positions that are computed: the pixels and the zero after each row.
    pub(super) fn positions(self) -> usize {
        self.rows * self.pitch()
    }

    /// Length of the plane. An odd number of cache lines, lest the channels of one
    /// pixel compete for the same few places of the cache.
    pub(super) fn len(self) -> usize {
        let reach = self.positions() + MAX_PANEL + 2 * self.pitch() + 2;
        let lines = reach.div_ceil(LINE);
        (lines + 1 - lines % 2) * LINE
    }

    /// Copy an image into a plane and set the zeros around it.
    pub(super) fn pad(self, image: &[f32], plane: &mut [f32]) {
        self.clear_border(plane);
        let inside = plane[self.head()..].chunks_exact_mut(self.pitch());
        for (source, row) in image.chunks_exact(self.cols).zip(inside) {
            row[..self.cols].copy_from_slice(source);
            row[self.cols] = 0.0;
        }
    }

    /// Set the zeros before the first pixel and after the last.
    pub(super) fn clear_border(self, plane: &mut [f32]) {
        plane[..self.head()].fill(0.0);
        plane[self.head() + self.positions()..].fill(0.0);
    }

    /// Copy the pixels of a plane into an image.
    pub(super) fn unpad(self, plane: &[f32], image: &mut [f32]) {
        let inside = plane[self.head()..].chunks_exact(self.pitch());
        for (row, target) in inside.zip(image.chunks_exact_mut(self.cols)) {
            target.copy_from_slice(&row[..self.cols]);
        }
    }
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
    fn a_tap_is_an_offset_and_the_border_is_zero() {
        for (rows, cols) in [(1, 1), (3, 5), (1, 4), (31, 16)] {
            let plane = Plane { rows, cols };
            let image: Vec<f32> = (1..=rows * cols).map(|value| value as f32).collect();
            let mut padded = vec![f32::NAN; plane.len()];
            plane.pad(&image, &mut padded);
            for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
                for (ky, kx) in (0..3).flat_map(|ky| (0..3).map(move |kx| (ky, kx))) {
                    let (y, x) = (row + ky, col + kx);
                    let inside = (1..=rows).contains(&y) && (1..=cols).contains(&x);
                    let expected = if inside { image[(y - 1) * cols + x - 1] } else { 0.0 };
                    let position = row * plane.pitch() + col;
                    assert_eq!(padded[position + ky * plane.pitch() + kx], expected);
                }
            }
            let mut back = vec![0.0; image.len()];
            plane.unpad(&padded, &mut back);
            assert_eq!(back, image);
        }
    }
}
