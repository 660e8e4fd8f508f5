//! Convolutions one after another.

use super::algorithm::Method;
use super::lane::{Lane, Lengths, Work, unpoisoned};
use super::schedule::Order;
use super::shape::{BAND, Bands};
use super::source::{Planes, Source};
use super::{Algorithm, Conv2d, Scales, Settings};
use crate::error::{Error, Result};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Mutex;

/// Images whose layers take no more than this (bytes) are computed one by each thread when
/// there are several: what a thread works on stays in its own cache.
const SMALL: usize = 1 << 20;

/// Images whose layers take no more than this (bytes) are computed layer by layer: each thread
/// finds two layers of its part of the image in the cache.
const CACHED: usize = 24 << 20;

/// What a layer of a block should take (bytes) in larger images, and the fewest bands that
/// pay for the edges of a block.
const BLOCK: usize = 2 << 20;
const SHORTEST_BLOCK: usize = 10;

/// Layers that feed each other.
#[derive(Debug, Clone)]
pub struct Stack {
    layers: Vec<Conv2d>,
    scales: Scales,
    settings: Settings,
}

/// Memory for [`Stack::run`], made once by [`Stack::scratch`] and used as often as wanted.
#[derive(Debug)]
pub struct Scratch {
    /// `[image, row, col]` that it was made for.
    size: [usize; 3],
    /// One for each image that is computed at a time.
    lanes: Vec<Mutex<Lane>>,
}

impl Scratch {
    /// Its size in bytes.
    pub fn bytes(&self) -> usize {
        self.lanes.iter().map(|lane| unpoisoned(lane.lock()).bytes()).sum()
    }
}

/// How images of a size are run.
#[derive(Debug, Clone, Copy)]
struct Plan {
    image: Bands,
    order: Order,
    /// Columns of a strip, and how many of them at each side lie in the next one too.
    strip: usize,
    overlap: usize,
}

/// Columns of an image that are computed together.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Strip {
    pub(super) computed: Range<usize>,
    /// Those that no border but the image's own has reached.
    pub(super) kept: Range<usize>,
}

impl Stack {
    /// A stack of layers, first to last.
    ///
    /// # Errors
    /// No layers, or one that does not read as many channels as the one before writes;
    /// bfloat16 on a kernel or with an algorithm that has no such products.
    pub fn new(layers: Vec<Conv2d>, settings: Settings) -> Result<Self> {
        if layers.is_empty() {
            return Err(Error::out_of_range("number of layers", 0, "at least 1"));
        }
        for (index, pair) in layers.windows(2).enumerate() {
            let (written, read) = (pair[0].output_channels(), pair[1].input_channels());
            if written != read {
                let what = format!("number of channels into layer {}", index + 1);
                let remedy = "let each layer read what the one before it writes";
                return Err(Error::mismatch(what, written, read, remedy));
            }
        }
        settings.check()?;
        Ok(Self { layers, scales: Scales::default(), settings })
    }

    /// The same layers between other scales.
    pub fn with_scales(self, scales: Scales) -> Self {
        Self { scales, ..self }
    }

    /// Factors of what goes in and of what comes out.
    pub fn scales(&self) -> Scales {
        self.scales
    }

    /// Channels that the first layer reads.
    pub fn input_channels(&self) -> usize {
        self.layers[0].input_channels()
    }

    /// Channels that the last layer writes.
    pub fn output_channels(&self) -> usize {
        self.layers[self.layers.len() - 1].output_channels()
    }

    /// The algorithm of each layer for images of `[rows, cols]`.
    pub fn algorithms(&self, [rows, cols]: [usize; 2]) -> impl Iterator<Item = Algorithm> + '_ {
        self.layers.iter().map(move |layer| self.method(layer, Bands { rows, cols }).algorithm)
    }

    /// The layers, first to last.
    pub(super) fn layers(&self) -> &[Conv2d] {
        &self.layers
    }

    /// How a layer is computed for an image.
    pub(super) fn method(&self, layer: &Conv2d, image: Bands) -> Method {
        let Settings { algorithm, precision, .. } = self.settings;
        let fastest = || layer.fastest(image, precision);
        algorithm.map_or_else(fastest, |algorithm| Method { algorithm, precision })
    }

    /// Memory for [`Stack::run`] on as many images of a size, `[image, row, col]`, by the
    /// threads of the pool that this is called in. The weights are packed here for the
    /// algorithms of that size, if they were not before.
    ///
    /// # Errors
    /// A size of nothing, or one that no memory can hold.
    pub fn scratch(&self, size: [usize; 3]) -> Result<Scratch> {
        let [count, rows, cols] = size;
        let channels = self.input_channels().max(self.output_channels());
        let values = size.iter().try_fold(channels, |product, n| product.checked_mul(*n));
        if values.is_none_or(|values| values == 0 || values > isize::MAX as usize / 64) {
            let range = "at least 1 each, and countable";
            return Err(Error::out_of_range("size [image, row, col]", format!("{size:?}"), range));
        }
        let plan = self.plan(Bands { rows, cols });
        for layer in &self.layers {
            layer.prepare(self.method(layer, plan.image));
        }
        let lengths = self.lengths(plan);
        let threads = rayon::current_num_threads();
        let small = plan.order.slots() * lengths.band * size_of::<f32>() <= SMALL;
        let (lanes, workers) = if small && count >= threads { (threads, 1) } else { (1, threads) };
        let lane = || Lane::new(plan.order, lengths, workers);
        Ok(Scratch { size, lanes: (0..lanes).map(|_| Mutex::new(lane())).collect() })
    }

    /// Run all layers on `input`, `[image, input channel, row, col]`, and write `output`,
    /// `[image, output channel, row, col]`. What is in `scratch` does not matter, before or
    /// after. Nothing is allocated. The result depends neither on the number of threads nor
    /// on the memory allowed.
    ///
    /// # Errors
    /// Slices that are not of these shapes for the size that the scratch was made for, or
    /// a scratch that another stack made.
    pub fn run(&self, input: &[f32], output: &mut [f32], scratch: &mut Scratch) -> Result<()> {
        let [_, rows, cols] = scratch.size;
        let channels = self.input_channels();
        check_length("number of values of the input", channels, input.len(), scratch.size)?;
        let scale = self.scales.input;
        self.run_from(&Planes { values: input, channels, rows, cols, scale }, output, scratch)
    }

    /// As [`Stack::run`], on what `source` gives, which must be scaled already.
    ///
    /// # Errors
    /// As [`Stack::run`].
    pub fn run_from(
        &self,
        source: &dyn Source,
        output: &mut [f32],
        scratch: &mut Scratch,
    ) -> Result<()> {
        let [_, rows, cols] = scratch.size;
        let channels = self.output_channels();
        check_length("number of values of the output", channels, output.len(), scratch.size)?;
        let plan = self.plan(Bands { rows, cols });
        if scratch
            .lanes
            .iter_mut()
            .any(|lane| !unpoisoned(lane.get_mut()).fits(plan.order, self.lengths(plan)))
        {
            let remedy = "take the scratch from the stack that runs";
            return Err(Error::mismatch("scratch", "one for these layers", "another", remedy));
        }
        let outputs = output.par_chunks_exact_mut(self.output_channels() * rows * cols);
        let lanes = &scratch.lanes;
        let run = |(number, output): (usize, &mut [f32])| {
            let thread = rayon::current_thread_index().unwrap_or(number);
            let mut lane = unpoisoned(lanes[thread % lanes.len()].lock());
            for strip in plan.strips() {
                let image = plan.image;
                lane.run(Work { stack: self, image, strip: &strip, source, number }, output);
            }
        };
        let images = outputs.enumerate();
        if lanes.len() > 1 {
            images.with_max_len(1).for_each(run);
        } else {
            // One after another, all threads at each: a thread that waits for a part of one
            // image must not begin another.
            images.with_min_len(usize::MAX).for_each(run);
        }
        Ok(())
    }

    /// Layer by layer where the layers stay in the cache, in blocks of bands where they do
    /// not, in strips where even those take more memory than is allowed.
    fn plan(&self, image: Bands) -> Plan {
        let layers = self.layers.len();
        let pitch = self.widest_pitch();
        let band = |cols| Bands { rows: image.rows, cols }.len(pitch) * size_of::<f32>();
        let order = |cols| {
            let whole = Order::whole(layers + 1, image.count());
            let block = (BLOCK / band(cols)).max(SHORTEST_BLOCK);
            let blocks = Order::in_blocks(layers + 1, image.count(), block);
            if whole.slots() * band(cols) <= CACHED { whole } else { blocks }
        };
        // What is wrong at the end of a strip spreads by a tile a layer.
        let overlap = layers * BAND;
        let mut strip = image.cols.next_multiple_of(BAND);
        let taken = |cols| order(cols).slots() * band(cols);
        while strip > 2 * overlap + BAND && taken(strip) > self.settings.memory {
            strip -= BAND;
        }
        Plan { image, order: order(strip), strip, overlap }
    }

    fn widest_pitch(&self) -> usize {
        let pitch = |layer: &Conv2d| layer.input_pitch().max(layer.output_pitch());
        self.layers.iter().map(pitch).max().unwrap_or(0)
    }

    fn lengths(&self, plan: Plan) -> Lengths {
        let strip = Bands { rows: plan.image.rows, cols: plan.strip };
        let last = &self.layers[self.layers.len() - 1];
        let layer = |layer: &Conv2d| layer.scratch_len(self.method(layer, plan.image));
        Lengths {
            band: strip.len(self.widest_pitch()),
            last: strip.len(last.output_pitch()),
            layer: self.layers.iter().map(layer).max().unwrap_or(0),
        }
    }
}

fn check_length(
    what: &str,
    channels: usize,
    found: usize,
    [count, rows, cols]: [usize; 3],
) -> Result<()> {
    if count * channels * rows * cols == found {
        return Ok(());
    }
    let expected = format!("{count} x {channels} x {rows} x {cols}");
    let remedy = "give an array [image, channel, row, col] of the network's channels";
    Err(Error::mismatch(what, expected, found, remedy))
}

impl Plan {
    /// The strips of the image, all as wide as can be but for the last.
    fn strips(self) -> impl Iterator<Item = Strip> {
        let Self { image: Bands { cols, .. }, strip, overlap, .. } = self;
        let mut from = 0;
        std::iter::from_fn(move || {
            (from < cols).then(|| {
                let start = from.saturating_sub(overlap);
                let end = (start + strip).min(cols);
                let kept = from..if end == cols { cols } else { end - overlap };
                from = kept.end;
                Strip { computed: start..end, kept }
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conv::{Kernel, Precision};
    use ndarray::{Array1, Array4};

    fn value(index: usize) -> f32 {
        ((index * 7919 + 13) % 127) as f32 / 64.0 - 1.0
    }

    /// Weights of a layer, and whether a ReLU follows.
    type Layer = (Array4<f32>, Array1<f32>, bool);

    fn layers(channels: &[usize]) -> Vec<Layer> {
        let pairs = channels.windows(2).enumerate();
        pairs
            .map(|(index, pair)| {
                let scale = (2.0 / (9.0 * pair[0] as f32)).sqrt();
                let shape = [pair[1], pair[0], 3, 3];
                let count = shape.iter().product();
                let weight = (0..count).map(|at| scale * value(at + 31 * index)).collect();
                let bias = (0..pair[1]).map(|at| 0.3 * value(3 * at + index)).collect();
                let last = index + 2 == channels.len();
                (Array4::from_shape_vec(shape, weight).unwrap(), bias, !last)
            })
            .collect()
    }

    fn stack(layers: &[Layer], settings: Settings) -> Stack {
        let convolution = |(weight, bias, relu): &Layer| {
            Conv2d::new(weight.view(), bias.view(), *relu, settings.kernel).unwrap()
        };
        Stack::new(layers.iter().map(convolution).collect(), settings).unwrap()
    }

    /// Every kernel with every algorithm, and with the one it chooses, in every precision
    /// that they have.
    fn all_settings() -> Vec<Settings> {
        let mut all = Vec::new();
        for kernel in Kernel::available() {
            for algorithm in [None].into_iter().chain(Algorithm::ALL.map(Some)) {
                for precision in [Precision::Single, Precision::Bfloat16] {
                    all.push(Settings { kernel, algorithm, precision, ..Settings::default() });
                }
            }
        }
        all.retain(|settings| settings.check().is_ok());
        all
    }

    /// The definition, in f64: no padding tricks, no packing, no blocks.
    fn naive(layers: &[Layer], input: &[f32], [rows, cols]: [usize; 2]) -> Vec<f64> {
        let mut values: Vec<f64> = input.iter().copied().map(f64::from).collect();
        for (weight, bias, relu) in layers {
            let at = |channel: usize, row: isize, col: isize| {
                let inside = (0..rows as isize).contains(&row) && (0..cols as isize).contains(&col);
                let index = || (channel * rows + row as usize) * cols + col as usize;
                if inside { values[index()] } else { 0.0 }
            };
            let mut next = Vec::new();
            for output in 0..weight.dim().0 {
                for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
                    let mut sum = f64::from(bias[output]);
                    for ((o, input, ky, kx), w) in weight.indexed_iter() {
                        if o == output {
                            let (row, col) = ((row + ky) as isize - 1, (col + kx) as isize - 1);
                            sum += f64::from(*w) * at(input, row, col);
                        }
                    }
                    next.push(if *relu { sum.max(0.0) } else { sum });
                }
            }
            values = next;
        }
        values
    }

    fn run(stack: &Stack, input: &[f32], [rows, cols]: [usize; 2]) -> Vec<f32> {
        let count = input.len() / stack.input_channels() / rows / cols;
        let mut output = vec![f32::NAN; count * stack.output_channels() * rows * cols];
        let mut scratch = stack.scratch([count, rows, cols]).unwrap();
        stack.run(input, &mut output, &mut scratch).unwrap();
        output
    }

    /// The largest error over the largest value.
    fn error(found: &[f32], expected: &[f64]) -> f64 {
        let largest = expected.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
        let errors = found.iter().zip(expected).map(|(f, e)| (f64::from(*f) - e).abs());
        errors.fold(0.0, f64::max) / largest
    }

    /// What rounding may do in a few layers, over the largest value. F(4x4) multiplies and
    /// divides by up to 64 on its way; the numbers of bfloat16 have 8 bits.
    fn bound(settings: Settings) -> f64 {
        match (settings.precision, settings.algorithm) {
            (Precision::Bfloat16, Some(Algorithm::WinogradF2)) => 0.02,
            (Precision::Bfloat16, _) => 0.2,
            (_, Some(Algorithm::WinogradF4) | None) => 2e-5,
            _ => 2e-6,
        }
    }

    #[test]
    fn every_algorithm_on_every_kernel_equals_the_definition_for_any_shape() {
        let channels: [&[usize]; 7] = [
            &[1, 1],
            &[3, 5],
            &[10, 12, 14],
            &[32, 32, 32],
            &[7, 17, 9, 2],
            &[40, 33],
            &[2, 70, 3],
        ];
        for channels in channels {
            let layers = layers(channels);
            for size in [[1, 1], [1, 7], [6, 1], [5, 4], [3, 50], [13, 17]] {
                let count = channels[0] * size[0] * size[1];
                let input: Vec<f32> = (0..count).map(|at| value(at + 5)).collect();
                let expected = naive(&layers, &input, size);
                for settings in all_settings() {
                    let error = error(&run(&stack(&layers, settings), &input, size), &expected);
                    assert!(error < bound(settings), "{settings:?} {channels:?} {size:?}: {error}");
                }
            }
        }
    }

    /// Tiles and rows of sums end in every way at the end of the image.
    #[test]
    fn every_width_is_computed_whole() {
        let layers = layers(&[1, 2]);
        for cols in 1..90 {
            let size = [2, cols];
            let input: Vec<f32> = (0..2 * cols).map(value).collect();
            let expected = naive(&layers, &input, size);
            for settings in all_settings() {
                let error = error(&run(&stack(&layers, settings), &input, size), &expected);
                assert!(error < bound(settings), "{settings:?} {cols}: {error}");
            }
        }
    }

    /// Neither threads, nor a wave, nor strips, nor a batch change a bit.
    #[test]
    fn the_way_through_the_image_changes_no_bit() {
        let channels = [10, 12, 14, 16, 9];
        let layers = layers(&channels);
        for algorithm in Algorithm::ALL {
            let settings = Settings { algorithm: Some(algorithm), ..Settings::default() };
            let (narrow, whole) = (Settings { memory: 0, ..settings }, stack(&layers, settings));
            for size in [[13, 41], [70, 90], [3, 150], [500, 400]] {
                let input: Vec<f32> = (0..10 * size[0] * size[1]).map(value).collect();
                let expected = run(&whole, &input, size);
                for threads in [1, 5] {
                    let pool =
                        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                    assert_eq!(pool.install(|| run(&whole, &input, size)), expected);
                    let strips = pool.install(|| run(&stack(&layers, narrow), &input, size));
                    assert!(strips == expected, "{algorithm:?} {size:?} in strips");
                }
                let batch = run(&whole, &input.repeat(3), size);
                assert!(batch == expected.repeat(3), "{algorithm:?} {size:?} in a batch");
            }
        }
    }

    /// The instructions for bfloat16 and their portable twin round the same, but for the
    /// order of sums.
    #[test]
    fn bfloat16_is_the_same_on_every_kernel() {
        let layers = layers(&[33, 18, 20]);
        let size = [9, 14];
        let input: Vec<f32> = (0..33 * size[0] * size[1]).map(value).collect();
        let with = |kernel| {
            let precision = Precision::Bfloat16;
            let algorithm = Some(Algorithm::WinogradF2);
            let settings = Settings { kernel, algorithm, precision, ..Settings::default() };
            settings.check().is_ok().then(|| run(&stack(&layers, settings), &input, size))
        };
        let results: Vec<_> = Kernel::available().into_iter().filter_map(with).collect();
        let exact = naive(&layers, &input, size);
        let portable: Vec<f64> = results[0].iter().copied().map(f64::from).collect();
        assert!(error(&results[0], &exact) > 1e-4, "nothing was rounded");
        for result in &results {
            let error = error(result, &portable);
            assert!(error < 2e-3, "{error}");
        }
    }

    #[test]
    fn strips_overlap_and_keep_every_column_once() {
        let stack = stack(&layers(&[1, 1, 1]), Settings { memory: 0, ..Settings::default() });
        for cols in 1..200 {
            let plan = stack.plan(Bands { rows: 9, cols });
            let strips: Vec<Strip> = plan.strips().collect();
            let kept: Vec<usize> = strips.iter().flat_map(|strip| strip.kept.clone()).collect();
            assert_eq!(kept, (0..cols).collect::<Vec<_>>());
            for Strip { computed, kept } in strips {
                assert!(computed.len() <= plan.strip && computed.start.is_multiple_of(BAND));
                assert!(computed.start == 0 || kept.start >= computed.start + plan.overlap);
                assert!(computed.end == cols || kept.end + plan.overlap <= computed.end);
            }
        }
    }

    #[test]
    fn layers_and_slices_that_do_not_fit_are_refused() {
        let settings = Settings::default();
        let kernel = settings.kernel;
        let mut all = layers(&[2, 3, 4]);
        all.swap(0, 1);
        let chain: Vec<Conv2d> = all
            .iter()
            .map(|(w, b, relu)| Conv2d::new(w.view(), b.view(), *relu, kernel).unwrap())
            .collect();
        let error = Stack::new(chain, settings).unwrap_err().to_string();
        assert!(error.contains("channels into layer 1: expected 4, found 2"), "{error}");
        assert!(Stack::new(Vec::new(), settings).is_err());
        let (weight, bias, _) = &all[0];
        assert!(Conv2d::new(weight.view(), bias.slice(ndarray::s![..1]), true, kernel).is_err());
        let narrow = weight.slice(ndarray::s![.., .., .., ..2]);
        assert!(Conv2d::new(narrow, bias.view(), true, kernel).is_err());

        let rounded = |algorithm| {
            let precision = Precision::Bfloat16;
            Settings { kernel: Kernel::available()[0], algorithm, precision, ..settings }.check()
        };
        rounded(None).unwrap();
        let error = rounded(Some(Algorithm::Direct)).unwrap_err().to_string();
        assert!(error.contains("winograd-f2 or winograd-f4"), "{error}");

        let small = stack(&layers(&[2, 3]), settings);
        let mut scratch = small.scratch([1, 4, 4]).unwrap();
        let mut run = |stack: &Stack, input: usize, output: usize| {
            stack.run(&vec![0.0; input], &mut vec![0.0; output], &mut scratch)
        };
        run(&small, 32, 48).unwrap();
        assert!(run(&small, 31, 48).is_err());
        assert!(run(&small, 32, 47).is_err());
        let other = stack(&layers(&[2, 5, 3]), settings);
        let error = run(&other, 32, 48).unwrap_err().to_string();
        assert!(error.contains("take the scratch from the stack that runs"), "{error}");
        assert!(small.scratch([1, 0, 4]).is_err());
        assert!(small.scratch([1, usize::MAX, 2]).is_err());
    }
}
