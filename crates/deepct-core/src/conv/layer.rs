//! One convolution: its weights packed for a kernel, and how a panel runs through it.

use super::Kernel;
use super::im2col::Panel;
use super::kernels::{Cut, Tile, Tiles};
use super::shape::{LINE, Plane, TAPS};
use crate::error::{Error, Result};
use ndarray::{ArrayView1, ArrayView4};
use rayon::prelude::*;
use std::ops::Range;

/// Input channels whose columns are gathered at once: with the widest panel 54 KiB,
/// which the second level of cache holds while the output channels pass over it.
const CHANNELS_AT_ONCE: usize = 32;

/// Panels that a thread takes at a time when there are many of them: neighbours share
/// most of the input that they read.
const PANELS_AT_ONCE: usize = 16;

/// A 3x3 convolution with padding 1, a bias and an optional ReLU.
#[derive(Debug, Clone)]
pub struct Conv2d {
    input_channels: usize,
    output_channels: usize,
    relu: bool,
    kernel: Kernel,
    bias: Vec<f32>,
    /// For each run of input channels, for each block of output channels: the weights
    /// `[input channel, tap, output channel]`.
    packed: Vec<f32>,
}

impl Conv2d {
    /// A layer from its weights `[output channel, input channel, 3, 3]` and biases,
    /// packed for `kernel`. The sum is a correlation, as in PyTorch.
    ///
    /// # Errors
    /// Kernels that are not 3x3, no channels, or another number of biases than of
    /// output channels.
    pub fn new(
        weight: ArrayView4<'_, f32>,
        bias: ArrayView1<'_, f32>,
        relu: bool,
        kernel: Kernel,
    ) -> Result<Self> {
        let (output_channels, input_channels, height, width) = weight.dim();
        if (height, width) != (3, 3) || weight.is_empty() {
            let shape = format!("{:?}", weight.shape());
            let range = "[out, in, 3, 3] with at least one channel in and out";
            return Err(Error::out_of_range("shape of a convolution's weight", shape, range));
        }
        if bias.len() != output_channels {
            let remedy = "give one bias for each output channel";
            return Err(Error::mismatch("length of bias", output_channels, bias.len(), remedy));
        }
        let mut layer = Self {
            input_channels,
            output_channels,
            relu,
            kernel,
            bias: bias.to_vec(),
            packed: Vec::with_capacity(weight.len()),
        };
        for inputs in layer.input_runs() {
            for outputs in layer.output_blocks() {
                for (input, tap) in inputs.clone().flat_map(|i| (0..TAPS).map(move |t| (i, t))) {
                    let at = |output| weight[[output, input, tap / 3, tap % 3]];
                    layer.packed.extend(outputs.clone().map(at));
                }
            }
        }
        Ok(layer)
    }

    /// Channels read.
    pub fn input_channels(&self) -> usize {
        self.input_channels
    }

    /// Channels written.
    pub fn output_channels(&self) -> usize {
        self.output_channels
    }

    /// The input channels, in runs whose columns are gathered at once.
    fn input_runs(&self) -> impl Iterator<Item = Range<usize>> + use<> {
        even_parts(self.input_channels, CHANNELS_AT_ONCE)
    }

    /// The output channels, in blocks that a kernel computes at once.
    fn output_blocks(&self) -> impl Iterator<Item = Range<usize>> + use<> {
        even_parts(self.output_channels, self.kernel.channels())
    }

    /// Length of the scratch of one thread: the columns and the sums of a panel.
    pub(super) fn worker_scratch_len(&self) -> usize {
        let columns = TAPS * self.input_channels.min(CHANNELS_AT_ONCE);
        ((columns + self.output_channels) * self.kernel.pixels()).next_multiple_of(LINE)
    }

    /// Run the layer from planes to planes. Each of the workers' parts of `scratch`
    /// serves one thread.
    pub(super) fn run(
        &self,
        plane: Plane,
        input: &[f32],
        output: &mut [f32],
        scratch: &mut [f32],
        workers: usize,
    ) {
        let panels = plane.positions().div_ceil(self.kernel.pixels());
        let at_once = (panels / (8 * workers)).clamp(1, PANELS_AT_ONCE);
        let positions = plane.head()..plane.head() + plane.positions();
        let cut = Cut { plane_len: plane.len(), positions, tile: at_once * self.kernel.pixels() };
        let tiles = Tiles::new(&mut output[..self.output_channels * plane.len()], cut);
        let part = scratch.len() / workers / LINE * LINE;
        scratch.par_chunks_exact_mut(part).for_each(|scratch| {
            while let Some(mut tile) = tiles.next() {
                for first in (0..tile.len).step_by(self.kernel.pixels()) {
                    self.run_panel(plane, input, &mut tile, first, scratch);
                }
            }
        });
    }

    /// Compute the panel of `tile` that starts at its position `first`.
    fn run_panel(
        &self,
        plane: Plane,
        input: &[f32],
        tile: &mut Tile<'_>,
        first: usize,
        scratch: &mut [f32],
    ) {
        let pixels = self.kernel.pixels();
        let (sums, scratch) = scratch.split_at_mut(self.output_channels * pixels);
        for (sums, bias) in sums.chunks_exact_mut(pixels).zip(&self.bias) {
            sums.fill(*bias);
        }
        let mut packed = &self.packed[..];
        for channels in self.input_runs() {
            let depth = TAPS * channels.len();
            let columns = &mut scratch[..depth * pixels];
            let shares = even_shares(channels.clone(), self.output_blocks().count());
            let panel = Panel { planes: input, plane, channels, first: tile.first + first };
            let next = Panel { first: panel.first + pixels, ..panel.clone() };
            self.kernel.gather(panel, columns);
            for (block, channels) in self.output_blocks().zip(shares) {
                // While this block is computed, what the next panel reads and writes is on
                // its way into the cache.
                self.kernel.prefetch_panel(Panel { channels, ..next.clone() });
                for output in block.clone() {
                    self.kernel.prefetch(tile.row(output), first + pixels);
                }
                let weights;
                (weights, packed) = packed.split_at(depth * block.len());
                let sums = &mut sums[block.start * pixels..block.end * pixels];
                self.kernel.accumulate(columns, weights, sums);
            }
        }
        self.store(plane, sums, tile, first);
    }

    /// Write the sums of a panel through the ReLU, and the zero after each row.
    fn store(&self, plane: Plane, sums: &[f32], tile: &mut Tile<'_>, first: usize) {
        let pixels = self.kernel.pixels();
        let len = pixels.min(tile.len - first);
        // Where in the panel the first row ends.
        let row_end = plane.cols - (tile.first + first) % plane.pitch();
        for (channel, sums) in sums.chunks_exact(pixels).enumerate() {
            let target = &mut tile.row(channel)[first..first + len];
            if self.relu {
                for (target, sum) in target.iter_mut().zip(sums) {
                    *target = sum.max(0.0);
                }
            } else {
                target.copy_from_slice(&sums[..len]);
            }
            for zero in target.iter_mut().skip(row_end).step_by(plane.pitch()) {
                *zero = 0.0;
            }
        }
    }
}

/// `0..count` in as few parts as hold at most `most` each, as even as can be.
fn even_parts(count: usize, most: usize) -> impl Iterator<Item = Range<usize>> {
    even_shares(0..count, count.div_ceil(most))
}

/// A range in that many parts, as even as can be; some are empty when it is short.
fn even_shares(range: Range<usize>, parts: usize) -> impl Iterator<Item = Range<usize>> {
    let at = move |part: usize| range.start + part * range.len() / parts;
    (0..parts).map(move |part| at(part)..at(part + 1))
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
