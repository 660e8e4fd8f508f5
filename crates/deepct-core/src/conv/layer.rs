//! One convolution layer: its packed weights and the computation of a band of its output.

use super::algorithm::{Algorithm, Method, Precision};
use super::kernels::{
    Kernel, Pair, PointProducts, ProductRow, Products, SegmentSum, Tile, TileRow, pair,
    weights_four, weights_two,
};
use super::shape::{Bands, SEEN, TAPS, even_parts};
use crate::error::{Error, Result};
use ndarray::{Array4, ArrayView1, ArrayView4};
use std::ops::Range;
use std::sync::OnceLock;

/// Number of tiles that are transformed, multiplied and transformed back together: their points
/// stay in the second-level cache.
const TILES_AT_ONCE: usize = 16;

/// Number of pixels whose columns im2col gathers together.
const PIXELS_AT_ONCE: usize = 24;

/// Padding between the points (floats). It prevents the points from mapping to the same few
/// cache sets.
const POINT_GAP: usize = 16;

/// A 3x3 convolution with padding 1, a bias and an optional ReLU.
#[derive(Debug, Clone)]
pub struct Conv2d {
    weight: Array4<f32>,
    /// One value per output channel, padded to whole vectors.
    bias: Vec<f32>,
    relu: bool,
    kernel: Kernel,
    packed: Packed,
}

/// The weights in the layouts of the algorithms, each packed on first use:
/// `[group of output channels, tap or point, input channel, output channel]`.
#[derive(Debug, Clone, Default)]
struct Packed {
    taps: OnceLock<Vec<f32>>,
    points: [OnceLock<Vec<f32>>; 2],
    /// Pairs of input channels.
    point_pairs: [OnceLock<Vec<Pair>>; 2],
}

/// Winograd's filtering with weights of element type `E`.
struct Filter<'a, E: 'static> {
    tile: Tile,
    products: Products<E>,
    weights: &'a [E],
}

/// Tiles of a row that are computed together.
struct TileRun<'a> {
    /// The input rows that they depend on, from the first column on.
    rows: &'a [&'a [f32]],
    tiles: usize,
    /// Length of a row of the output.
    row_len: usize,
}

/// The input from which a band of the output is computed.
#[derive(Debug)]
pub(super) struct BandInput<'a> {
    /// The memory layout of the image that contains the band.
    pub(super) bands: Bands,
    /// The input rows: one above the band, those of the band, and one below.
    pub(super) rows: [&'a [f32]; SEEN],
}

impl Conv2d {
    /// A layer for `kernel` from its weights `[output channel, input channel, 3, 3]` and
    /// biases. The sum is a correlation, as in PyTorch.
    ///
    /// # Errors
    /// Returns an error if the filters are not 3x3, if there are no channels, or if the number of
    /// biases differs from that of the output channels.
    pub fn new(
        weight: ArrayView4<'_, f32>,
        bias: ArrayView1<'_, f32>,
        relu: bool,
        kernel: Kernel,
    ) -> Result<Self> {
        let (outputs, _, height, width) = weight.dim();
        if (height, width) != (3, 3) || weight.is_empty() {
            let shape = format!("{:?}", weight.shape());
            let range = "[out, in, 3, 3] with at least one channel in and out";
            return Err(Error::out_of_range("shape of a convolution's weight", shape, range));
        }
        if bias.len() != outputs {
            let remedy = "give one bias for each output channel";
            return Err(Error::mismatch("length of bias", outputs, bias.len(), remedy));
        }
        let mut bias = bias.to_vec();
        bias.resize(outputs.next_multiple_of(kernel.lanes()), 0.0);
        let weight = weight.as_standard_layout().into_owned();
        Ok(Self { weight, bias, relu, kernel, packed: Packed::default() })
    }

    /// Number of input channels.
    pub fn input_channels(&self) -> usize {
        self.weight.dim().1
    }

    /// Number of output channels.
    pub fn output_channels(&self) -> usize {
        self.weight.dim().0
    }

    /// Number of floats of an input pixel: its channels, padded to whole vectors.
    pub(super) fn input_pitch(&self) -> usize {
        self.input_channels().next_multiple_of(self.kernel.lanes())
    }

    /// Number of floats of an output pixel.
    pub(super) fn output_pitch(&self) -> usize {
        self.bias.len()
    }

    /// The fastest method for this layer and an image.
    pub(super) fn fastest(&self, bands: Bands, precision: Precision) -> Method {
        let channels = [self.input_channels(), self.output_channels()];
        Method::fastest(self.kernel, bands, channels, precision)
    }

    /// The vectors of output channels, in groups that are summed together.
    fn groups(&self) -> impl Iterator<Item = Range<usize>> + use<> {
        even_parts(self.output_pitch() / self.kernel.lanes(), self.kernel.vectors())
    }

    /// Pack the weights for a method unless they are packed already.
    pub(super) fn prepare(&self, method: Method) {
        match (method.tile(), method.precision) {
            (None, _) => _ = self.taps(),
            (Some(tile), Precision::Single) => _ = self.points(tile),
            (Some(tile), Precision::Bfloat16) => _ = self.point_pairs(tile),
        }
    }

    fn taps(&self) -> &[f32] {
        self.packed.taps.get_or_init(|| self.pack::<1, TAPS, f32>(|taps| *taps, |[value]| value))
    }

    fn points(&self, tile: Tile) -> &[f32] {
        self.packed.points[tile as usize].get_or_init(|| match tile {
            Tile::Two => self.pack(weights_two, |[value]| value),
            Tile::Four => self.pack(weights_four, |[value]| value),
        })
    }

    fn point_pairs(&self, tile: Tile) -> &[Pair] {
        self.packed.point_pairs[tile as usize].get_or_init(|| match tile {
            Tile::Two => self.pack(weights_two, |[low, high]| pair(low, high)),
            Tile::Four => self.pack(weights_four, |[low, high]| pair(low, high)),
        })
    }

    /// Pack the weights. `of` maps the nine taps of an input and an output channel to points,
    /// and `join` combines `CHANNELS` input channels into an element.
    fn pack<const CHANNELS: usize, const POINTS: usize, E>(
        &self,
        of: impl Fn(&[f32; TAPS]) -> [f32; POINTS],
        join: impl Fn([f32; CHANNELS]) -> E,
    ) -> Vec<E> {
        let (taps, _) = self.weight.as_slice().expect("the layout was made standard").as_chunks();
        let points: Vec<[f32; POINTS]> = taps.iter().map(of).collect();
        let inputs = self.input_channels();
        let value = |point: usize, input: usize, output: usize| {
            let inside = input < inputs && output < self.output_channels();
            if inside { points[output * inputs + input][point] } else { 0.0 }
        };
        let mut packed = Vec::new();
        for group in self.groups() {
            let outputs = group.start * self.kernel.lanes()..group.end * self.kernel.lanes();
            for point in 0..POINTS {
                for input in (0..inputs).step_by(CHANNELS) {
                    let element = |output: usize| {
                        join(std::array::from_fn(|channel| value(point, input + channel, output)))
                    };
                    packed.extend(outputs.clone().map(element));
                }
            }
        }
        packed
    }

    /// Length of the scratch memory of one thread (floats).
    pub(super) fn scratch_len(&self, method: Method) -> usize {
        let lanes = self.kernel.lanes();
        let widest = self.groups().map(|group| group.len()).max().unwrap_or(0);
        let winograd = |tile: Tile| {
            let tile_len = self.input_pitch() + widest * lanes;
            tile.points() * (TILES_AT_ONCE * tile_len + 2 * POINT_GAP)
        };
        match method.algorithm {
            Algorithm::Im2col => PIXELS_AT_ONCE * TAPS * self.input_channels(),
            Algorithm::Direct => 0,
            Algorithm::WinogradF2 => winograd(Tile::Two),
            Algorithm::WinogradF4 => winograd(Tile::Four),
        }
    }

    /// Compute a band of the output, `[row, column, channel]`, including the column of zeros at
    /// the left. The caller sets the border.
    pub(super) fn run_band(
        &self,
        method: Method,
        input: &BandInput<'_>,
        output: &mut [f32],
        scratch: &mut [f32],
    ) {
        match (method.tile(), method.precision) {
            (None, _) if method.algorithm == Algorithm::Im2col => {
                self.im2col(input, output, scratch);
            }
            (None, _) => self.direct(input, output),
            (Some(tile), Precision::Single) => {
                let products = self.kernel.single();
                let filter = Filter { tile, products, weights: self.points(tile) };
                self.winograd(&filter, input, output, scratch);
            }
            (Some(tile), Precision::Bfloat16) => {
                let products = self.kernel.bfloat16().expect("the stack has checked the kernel");
                let weights = self.point_pairs(tile);
                let filter = Filter { tile, products, weights };
                self.winograd(&filter, input, output, scratch);
            }
        }
    }

    /// Gather the columns of each pixel as a row of a matrix and multiply it with the weights.
    fn im2col(&self, input: &BandInput<'_>, output: &mut [f32], scratch: &mut [f32]) {
        let (pitch, inputs) = (self.input_pitch(), self.input_channels());
        let depth = TAPS * inputs;
        for (row, out) in
            output.chunks_exact_mut(input.bands.row_len(self.output_pitch())).enumerate()
        {
            for pixels in even_parts(input.bands.whole_cols(), PIXELS_AT_ONCE) {
                let gathered = scratch.chunks_exact_mut(depth).zip(pixels.clone());
                for (columns, pixel) in gathered {
                    for (tap, column) in columns.chunks_exact_mut(inputs).enumerate() {
                        let from = (pixel + tap % 3) * pitch;
                        column.copy_from_slice(&input.rows[row + tap / 3][from..from + inputs]);
                    }
                }
                self.sum([&*scratch], [depth, depth], pixels, out);
            }
        }
    }

    /// As [`Conv2d::im2col`], but reads the columns of a tap in place, as the pixels of a row are
    /// contiguous.
    fn direct(&self, input: &BandInput<'_>, output: &mut [f32]) {
        let pitch = self.input_pitch();
        for (row, out) in
            output.chunks_exact_mut(input.bands.row_len(self.output_pitch())).enumerate()
        {
            let seen = |tap: usize| &input.rows[row + tap / 3][tap % 3 * pitch..];
            let segments: [&[f32]; TAPS] = std::array::from_fn(seen);
            self.sum(segments, [pitch, self.input_channels()], 0..input.bands.whole_cols(), out);
        }
    }

    /// Write `pixels` of a row of the output: the sums over `segments`, of the given pitch and
    /// depth, of their products with the weights.
    fn sum<const SEGMENTS: usize>(
        &self,
        segments: [&[f32]; SEGMENTS],
        [left_pitch, depth]: [usize; 2],
        pixels: Range<usize>,
        out: &mut [f32],
    ) {
        let (lanes, out_pitch) = (self.kernel.lanes(), self.output_pitch());
        let mut packed = self.taps();
        for group in self.groups() {
            let right;
            (right, packed) = packed.split_at(SEGMENTS * depth * group.len() * lanes);
            let product = SegmentSum {
                segments: &segments,
                left_pitch,
                rows: pixels.len(),
                depth,
                vectors: group.len(),
                right,
                bias: &self.bias[group.start * lanes..],
                relu: self.relu,
                out_pitch,
            };
            let from = (1 + pixels.start) * out_pitch + group.start * lanes;
            self.kernel.sum_segments(&product, &mut out[from..]);
        }
    }

    /// Apply Winograd's minimal filtering to a few tiles at a time: transform their input,
    /// multiply point by point, and transform back.
    fn winograd<E: bytemuck::Pod>(
        &self,
        filter: &Filter<'_, E>,
        input: &BandInput<'_>,
        output: &mut [f32],
        scratch: &mut [f32],
    ) {
        let (in_pitch, out_pitch) = (self.input_pitch(), self.output_pitch());
        let (size, row_len) = (filter.tile.size(), input.bands.row_len(out_pitch));
        let seen = input.rows.windows(size + 2).step_by(size);
        for (rows, output) in seen.zip(output.chunks_exact_mut(size * row_len)) {
            for tiles in even_parts(input.bands.whole_cols() / size, TILES_AT_ONCE) {
                let first = tiles.start * size;
                let rows: [&[f32]; SEEN] = std::array::from_fn(|row| {
                    rows.get(row).map_or(&[][..], |values| &values[first * in_pitch..])
                });
                let pixels = &mut output[(1 + first) * out_pitch..];
                let run = TileRun { rows: &rows[..size + 2], tiles: tiles.len(), row_len };
                self.winograd_tiles(filter, &run, pixels, scratch);
            }
        }
    }

    /// Compute the tiles of `run`; `output` starts at their first pixel.
    fn winograd_tiles<E: bytemuck::Pod>(
        &self,
        filter: &Filter<'_, E>,
        &TileRun { rows, tiles, row_len }: &TileRun<'_>,
        output: &mut [f32],
        scratch: &mut [f32],
    ) {
        let Filter { tile, products: ref loops, mut weights } = *filter;
        let channels = loops.channels();
        let (lanes, in_pitch, out_pitch) =
            (self.kernel.lanes(), self.input_pitch(), self.output_pitch());
        let left_pitch = [tiles * in_pitch / channels + POINT_GAP, in_pitch / channels];
        let (left, products) = scratch.split_at_mut(tile.points() * left_pitch[0]);
        let left = bytemuck::cast_slice_mut(left);
        let source = TileRow {
            rows,
            tiles,
            column_pitch: in_pitch,
            vectors: in_pitch / lanes,
            out_pitch: left_pitch,
        };
        loops.transform_input(tile, &source, left);
        let depth = self.input_channels().div_ceil(channels);
        for group in self.groups() {
            let width = group.len() * lanes;
            let product_pitch = [tiles * width + POINT_GAP, width];
            let right;
            (right, weights) = weights.split_at(tile.points() * depth * width);
            let vectors = group.len();
            let multiplied = PointProducts {
                points: tile.points(),
                rows: tiles,
                depth,
                vectors,
                left,
                left_pitch,
                right,
                out_pitch: product_pitch,
            };
            loops.multiply(&multiplied, products);
            let source = ProductRow {
                products,
                pitch: product_pitch,
                tiles,
                vectors,
                bias: &self.bias[group.start * lanes..],
                relu: self.relu,
                out_pitch: [row_len, out_pitch],
            };
            self.kernel.transform_output(tile, &source, &mut output[group.start * lanes..]);
        }
    }
}
