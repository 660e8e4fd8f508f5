//! The inner loops, one file for each instruction set, and the only part of the convolution
//! that is `unsafe`.
//!
//! The loops are generic over `vector::Vector`: products in `multiply`, Winograd's transforms
//! in `winograd`. The file of an instruction set defines its vector type and the number of rows
//! and vectors of sums that fit in its registers; `instantiate!` compiles the loops for it. The
//! portable kernel is plain Rust and the reference for the tests of the others. The tests at the
//! end of this file run on every kernel that the processor supports.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod instantiate;
mod multiply;
#[cfg(target_arch = "aarch64")]
mod neon;
mod planes;
mod scalar;
mod vector;
mod winograd;

use instantiate::{
    instantiate, instantiate_pairs, instantiate_products, instantiate_transform, with_constant,
};
pub(super) use multiply::{PointProducts, SegmentSum};
pub(super) use planes::SharedPlanes;
pub(super) use vector::{Pair, pair};
pub(super) use winograd::{ProductRow, TileRow, weights_four, weights_two};

use crate::conv::shape::even_parts;
use crate::error::{Error, Result};
use std::fmt;

/// A set of inner loops that the processor can run.
///
/// A value can be obtained only from [`Kernel::available`] and functions that use it, which
/// query the processor. Running a kernel is therefore safe.
#[derive(Clone, Copy)]
pub struct Kernel(&'static Loops);

/// The loops compiled for one instruction set.
struct Loops {
    name: &'static str,
    lanes: usize,
    vectors: usize,
    sum_segments: unsafe fn(&SegmentSum<'_>, &mut [f32]),
    products: ProductLoops<f32>,
    output: [unsafe fn(&ProductRow<'_>, &mut [f32]); 2],
}

/// Winograd's loops over matrices of element type `E`.
pub(super) struct ProductLoops<E: 'static> {
    /// Number of channels in an element.
    channels: usize,
    input: [unsafe fn(&TileRow<'_>, &mut [E]); 2],
    multiply: unsafe fn(&PointProducts<'_, E>, &mut [f32]),
}

/// The tile size of Winograd's filtering.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Tile {
    /// 2 x 2 pixels: F(2x2, 3x3).
    Two,
    /// 4 x 4 pixels: F(4x4, 3x3).
    Four,
}

impl Tile {
    /// Number of pixels along each side.
    pub(super) fn size(self) -> usize {
        match self {
            Self::Two => 2,
            Self::Four => 4,
        }
    }

    /// Number of products of a tile, which is the number of input pixels on which it depends.
    pub(super) fn points(self) -> usize {
        (self.size() + 2) * (self.size() + 2)
    }
}

impl Kernel {
    /// The kernels that this processor can run, slowest first.
    pub fn available() -> Vec<Self> {
        #[cfg_attr(not(any(target_arch = "x86_64", target_arch = "aarch64")), allow(unused_mut))]
        let mut kernels = vec![Self(&scalar::LOOPS)];
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                kernels.push(Self(&avx2::LOOPS));
            }
            if is_x86_feature_detected!("avx512f") {
                kernels.push(Self(&avx512::LOOPS));
            }
        }
        #[cfg(target_arch = "aarch64")]
        if std::arch::is_aarch64_feature_detected!("neon") {
            kernels.push(Self(&neon::LOOPS));
        }
        kernels
    }

    /// The fastest kernel that this processor can run.
    pub fn best() -> Self {
        Self::available().pop().unwrap_or(Self(&scalar::LOOPS))
    }

    /// The kernel with the given name.
    ///
    /// # Errors
    /// Returns an error if no kernel has this name or if this processor cannot run it.
    pub fn from_name(name: &str) -> Result<Self> {
        let kernels = Self::available();
        let named = kernels.iter().find(|kernel| kernel.name() == name);
        named.copied().ok_or_else(|| {
            let names: Vec<_> = kernels.iter().map(|kernel| kernel.name()).collect();
            let range = format!("one that this processor runs: {}", names.join(", "));
            Error::out_of_range("kernel of the convolution", name, range)
        })
    }

    /// The name: `portable`, `avx2`, `avx512` or `neon`.
    pub fn name(self) -> &'static str {
        self.0.name
    }

    /// Number of floats in a vector. Channels are padded to whole vectors.
    pub(super) fn lanes(self) -> usize {
        self.0.lanes
    }

    /// Largest number of vectors of output channels that are summed together.
    pub(super) fn vectors(self) -> usize {
        self.0.vectors
    }

    /// `out = relu(bias + sum over segments of left right)`.
    #[allow(unsafe_code)]
    pub(super) fn sum_segments(self, product: &SegmentSum<'_>, out: &mut [f32]) {
        multiply::check_segments(product, self.0.lanes, out);
        // SAFETY: the slices were checked, and the processor supports the instructions.
        unsafe { (self.0.sum_segments)(product, out) }
    }

    /// The loops over matrices of floats.
    pub(super) fn single(self) -> Products<f32> {
        Products { kernel: self, loops: &self.0.products }
    }

    /// The loops over matrices of bfloat16 numbers, if the kernel supports them.
    pub(super) fn bfloat16(self) -> Option<Products<Pair>> {
        let loops = match self.name() {
            "portable" => Some(&scalar::PAIR_LOOPS),
            #[cfg(target_arch = "x86_64")]
            "avx512" if is_x86_feature_detected!("avx512bf16") => Some(&avx512::PAIR_LOOPS),
            _ => None,
        };
        Some(Products { kernel: self, loops: loops? })
    }

    /// Apply Winograd's output transform to the products of a row of tiles, then add the bias
    /// and apply the ReLU.
    #[allow(unsafe_code)]
    pub(super) fn transform_output(self, tile: Tile, source: &ProductRow<'_>, out: &mut [f32]) {
        winograd::check_products(source, self.0.lanes, tile.size(), out);
        // SAFETY: the slices were checked, and the processor supports the instructions.
        unsafe { (self.0.output[tile as usize])(source, out) }
    }
}

/// Winograd's loops of one kernel over matrices of element type `E`.
pub(super) struct Products<E: 'static> {
    kernel: Kernel,
    loops: &'static ProductLoops<E>,
}

impl<E> Products<E> {
    /// Number of channels in an element.
    pub(super) fn channels(&self) -> usize {
        self.loops.channels
    }

    /// `out = left right` for every point.
    #[allow(unsafe_code)]
    pub(super) fn multiply(&self, products: &PointProducts<'_, E>, out: &mut [f32]) {
        multiply::check_points(products, self.kernel.lanes(), out);
        // SAFETY: the slices were checked, and the processor supports the instructions.
        unsafe { (self.loops.multiply)(products, out) }
    }

    /// Apply Winograd's input transform to a row of tiles.
    #[allow(unsafe_code)]
    pub(super) fn transform_input(&self, tile: Tile, source: &TileRow<'_>, out: &mut [E]) {
        winograd::check_tiles(source, self.kernel.lanes(), tile.size(), (out, self.channels()));
        // SAFETY: the slices were checked, and the processor supports the instructions.
        unsafe { (self.loops.input[tile as usize])(source, out) }
    }
}

impl fmt::Debug for Kernel {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_tuple("Kernel").field(&self.name()).finish()
    }
}

impl PartialEq for Kernel {
    fn eq(&self, other: &Self) -> bool {
        self.name() == other.name()
    }
}

impl Eq for Kernel {}

/// The last of an ascending sequence of numbers.
const fn largest(numbers: &[usize]) -> usize {
    numbers[numbers.len() - 1]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values(count: usize, step: usize) -> Vec<f32> {
        (0..count).map(|index| ((index * step + 3) % 31) as f32 / 16.0 - 1.0).collect()
    }

    fn assert_close(found: f32, expected: f64, what: &str) {
        assert!((f64::from(found) - expected).abs() < 1e-4, "{what}: {found} {expected}");
    }

    /// Compare the kernel for all numbers of rows and vectors with a direct sum in f64.
    fn sums_segments(kernel: Kernel) {
        for vectors in 1..=kernel.vectors() {
            for rows in 1..20 {
                let (width, depth, pitch) = (vectors * kernel.lanes(), 5, 7);
                let sides: Vec<_> = (0..3).map(|side| values(rows * pitch, 11 + side)).collect();
                let segments: Vec<&[f32]> = sides.iter().map(Vec::as_slice).collect();
                let (right, bias) = (values(3 * depth * width, 13), values(width, 5));
                let mut out = vec![f32::NAN; rows * width];
                let product = SegmentSum {
                    segments: &segments,
                    left_pitch: pitch,
                    rows,
                    depth,
                    vectors,
                    right: &right,
                    bias: &bias,
                    relu: true,
                    out_pitch: width,
                };
                kernel.sum_segments(&product, &mut out);
                for (at, found) in out.iter().enumerate() {
                    let (row, channel) = (at / width, at % width);
                    let terms = (0..3 * depth).map(|k| {
                        f64::from(segments[k / depth][row * pitch + k % depth])
                            * f64::from(right[k * width + channel])
                    });
                    let expected = f64::from(bias[channel]) + terms.sum::<f64>();
                    assert_close(*found, expected.max(0.0), kernel.name());
                }
            }
        }
    }

    fn multiplies_points(kernel: Kernel) {
        for vectors in 1..=kernel.vectors() {
            for rows in 1..20 {
                let (points, width, depth) = (3, vectors * kernel.lanes(), 6);
                let left = values(points * rows * depth, 7);
                let right = values(points * depth * width, 11);
                let mut out = vec![f32::NAN; points * rows * width];
                let products = PointProducts {
                    points,
                    rows,
                    depth,
                    vectors,
                    left: &left,
                    left_pitch: [rows * depth, depth],
                    right: &right,
                    out_pitch: [rows * width, width],
                };
                kernel.single().multiply(&products, &mut out);
                for (at, found) in out.iter().enumerate() {
                    let (row, channel) = (at / width, at % width);
                    let terms = (0..depth).map(|k| {
                        let point = row / rows;
                        f64::from(left[row * depth + k])
                            * f64::from(right[(point * depth + k) * width + channel])
                    });
                    assert_close(*found, terms.sum(), kernel.name());
                }
            }
        }
    }

    /// Check that the input transform, the product with transformed weights and the output
    /// transform together give the correlation with those weights.
    fn filters(kernel: Kernel, tile: Tile) {
        let (lanes, size) = (kernel.lanes(), tile.size());
        let (tiles, seen) = (3, size + 2);
        let cols = tiles * size + 2;
        let input = values(seen * cols * lanes, 17);
        let rows: Vec<&[f32]> = input.chunks_exact(cols * lanes).collect();
        let taps: [f32; 9] = std::array::from_fn(|tap| values(9, 5)[tap]);
        let weights = match tile {
            Tile::Two => weights_two(&taps).to_vec(),
            Tile::Four => weights_four(&taps).to_vec(),
        };
        let pitch = [tiles * lanes, lanes];
        let mut points = vec![f32::NAN; tile.points() * tiles * lanes];
        let source =
            TileRow { rows: &rows, tiles, column_pitch: lanes, vectors: 1, out_pitch: pitch };
        kernel.single().transform_input(tile, &source, &mut points);
        for (values, weight) in points.chunks_exact_mut(tiles * lanes).zip(weights) {
            values.iter_mut().for_each(|value| *value *= weight);
        }
        let mut out = vec![f32::NAN; size * tiles * size * lanes];
        let bias = values(lanes, 3);
        let source = ProductRow {
            products: &points,
            pitch,
            tiles,
            vectors: 1,
            bias: &bias,
            relu: false,
            out_pitch: [tiles * size * lanes, lanes],
        };
        kernel.transform_output(tile, &source, &mut out);
        for (at, found) in out.iter().enumerate() {
            let (pixel, lane) = (at / lanes, at % lanes);
            let (row, col) = (pixel / (tiles * size), pixel % (tiles * size));
            let terms = (0..9).map(|tap| {
                let seen = rows[row + tap / 3][(col + tap % 3) * lanes + lane];
                f64::from(taps[tap]) * f64::from(seen)
            });
            assert_close(*found, f64::from(bias[lane]) + terms.sum::<f64>(), kernel.name());
        }
    }

    #[test]
    fn every_kernel_does_what_it_says() {
        for kernel in Kernel::available() {
            sums_segments(kernel);
            multiplies_points(kernel);
            filters(kernel, Tile::Two);
            filters(kernel, Tile::Four);
        }
        assert_eq!(Kernel::available()[0].name(), "portable");
        assert_eq!(Kernel::available().last(), Some(&Kernel::best()));
        assert_eq!(Kernel::from_name("portable").unwrap(), Kernel::available()[0]);
        let error = Kernel::from_name("mmx").unwrap_err().to_string();
        assert!(error.contains("portable"), "{error}");
    }
}
