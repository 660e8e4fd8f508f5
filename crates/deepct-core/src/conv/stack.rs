//! A sequence of convolutions.

use super::lane::{Lane, Lengths, Strip, Work, unpoisoned};
use super::layers::Layers;
use super::schedule::Order;
use super::shape::{BAND, Bands};
use super::source::{Planes, Source};
use super::{Algorithm, Conv2d, Scales, Settings};
use crate::error::{Error, Result};
use rayon::prelude::*;
use std::sync::Mutex;

/// If there are several images and the layers of one take no more than this (bytes), each thread
/// computes whole images: its data then stay in its own cache.
const SMALL: usize = 1 << 20;

/// Images whose layers take no more than this (bytes) are computed layer by layer: two layers of
/// a thread's part of the image then fit in the cache.
const CACHED: usize = 24 << 20;

/// Target size of one layer of a block in larger images (bytes), and the minimum number of bands
/// of a block, below which the overhead of its edges dominates.
const BLOCK: usize = 2 << 20;
const SHORTEST_BLOCK: usize = 10;

/// A sequence of convolution layers.
#[derive(Debug, Clone)]
pub struct Stack(Layers);

/// Memory for [`Stack::run`], allocated by [`Stack::scratch`] and reusable.
#[derive(Debug)]
pub struct Scratch {
    /// The size `[image, row, col]` for which it was allocated.
    size: [usize; 3],
    /// One lane for each image that is computed at the same time.
    lanes: Vec<Mutex<Lane>>,
}

impl Scratch {
    /// The size in bytes.
    pub fn bytes(&self) -> usize {
        self.lanes.iter().map(|lane| unpoisoned(lane.lock()).bytes()).sum()
    }
}

/// The schedule for images of a given size.
#[derive(Debug, Clone, Copy)]
struct Plan {
    image: Bands,
    order: Order,
    /// Number of columns of a strip.
    strip: usize,
    /// Number of columns at each side of a strip that the neighbouring strip also computes.
    overlap: usize,
}

impl Stack {
    /// A stack of layers, first to last.
    ///
    /// # Errors
    /// Returns an error if there are no layers, if the number of input channels of a layer differs
    /// from the number of output channels of the preceding one, or if bfloat16 is requested and
    /// the kernel or the algorithm does not support it.
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
        Ok(Self(Layers { layers, scales: Scales::default(), settings }))
    }

    /// The same layers with other input and output scales.
    pub fn with_scales(self, scales: Scales) -> Self {
        Self(Layers { scales, ..self.0 })
    }

    /// Scale factors of input and output.
    pub fn scales(&self) -> Scales {
        self.0.scales
    }

    /// Number of input channels of the first layer.
    pub fn input_channels(&self) -> usize {
        self.0.layers[0].input_channels()
    }

    /// Number of output channels of the last layer.
    pub fn output_channels(&self) -> usize {
        self.0.output_channels()
    }

    /// The algorithm of each layer for images of `[rows, cols]`.
    pub fn algorithms(&self, [rows, cols]: [usize; 2]) -> impl Iterator<Item = Algorithm> + '_ {
        let image = Bands { rows, cols };
        self.0.layers.iter().map(move |layer| self.0.method(layer, image).algorithm)
    }

    /// Allocate memory for [`Stack::run`] on images of the given size, `[image, row, col]`, by
    /// the threads of the current thread pool. Also packs the weights for the algorithms of that
    /// size unless they are packed already.
    ///
    /// # Errors
    /// Returns an error if a dimension is zero or if the size exceeds the address space.
    pub fn scratch(&self, size: [usize; 3]) -> Result<Scratch> {
        let [count, rows, cols] = size;
        let channels = self.input_channels().max(self.output_channels());
        let values = size.iter().try_fold(channels, |product, n| product.checked_mul(*n));
        if values.is_none_or(|values| values == 0 || values > isize::MAX as usize / 64) {
            let range = "at least 1 each, and countable";
            return Err(Error::out_of_range("size [image, row, col]", format!("{size:?}"), range));
        }
        let plan = self.plan(Bands { rows, cols });
        let prepare = |layer: &Conv2d| layer.prepare(self.0.method(layer, plan.image));
        self.0.layers.par_iter().for_each(prepare);
        let lengths = self.lengths(plan);
        let threads = rayon::current_num_threads();
        let small = plan.order.slots() * lengths.band * size_of::<f32>() <= SMALL;
        let (lanes, workers) = if small && count >= threads { (threads, 1) } else { (1, threads) };
        let lane = || Lane::new(plan.order, lengths, workers);
        Ok(Scratch { size, lanes: (0..lanes).map(|_| Mutex::new(lane())).collect() })
    }

    /// Run all layers on `input`, `[image, input channel, row, col]`, and write `output`,
    /// `[image, output channel, row, col]`. The contents of `scratch` are irrelevant before and
    /// after the call. The function does not allocate memory. The result depends neither on the
    /// number of threads nor on the memory limit.
    ///
    /// # Errors
    /// Returns an error if the slices do not have these shapes for the size of the scratch memory,
    /// or if another stack allocated the scratch memory.
    pub fn run(&self, input: &[f32], output: &mut [f32], scratch: &mut Scratch) -> Result<()> {
        let [_, rows, cols] = scratch.size;
        let channels = self.input_channels();
        check_length("number of values of the input", channels, input.len(), scratch.size)?;
        let scale = self.0.scales.input;
        self.run_from(&Planes { values: input, channels, rows, cols, scale }, output, scratch)
    }

    /// As [`Stack::run`], with the input from `source`, which must already be scaled.
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
            let remedy = "use the scratch memory of the same stack";
            return Err(Error::mismatch("scratch", "one for these layers", "another", remedy));
        }
        let outputs = output.par_chunks_exact_mut(self.output_channels() * rows * cols);
        let lanes = &scratch.lanes;
        let run = |(number, output): (usize, &mut [f32])| {
            let thread = rayon::current_thread_index().unwrap_or(number);
            let mut lane = unpoisoned(lanes[thread % lanes.len()].lock());
            for strip in plan.strips() {
                let image = plan.image;
                lane.run(Work { layers: &self.0, image, strip: &strip, source, number }, output);
            }
        };
        let images = outputs.enumerate();
        if lanes.len() > 1 {
            images.with_max_len(1).for_each(run);
        } else {
            // All threads work on one image after another: a thread that waits for a part of one
            // image must not begin another.
            images.with_min_len(usize::MAX).for_each(run);
        }
        Ok(())
    }

    /// Images are computed layer by layer if the layers fit in the cache, and otherwise in blocks
    /// of bands. If the blocks exceed the memory limit, the image is divided into strips.
    fn plan(&self, image: Bands) -> Plan {
        let layers = self.0.layers.len();
        let pitch = self.widest_pitch();
        let band = |cols| Bands { rows: image.rows, cols }.len(pitch) * size_of::<f32>();
        let order = |cols| {
            let whole = Order::whole(layers + 1, image.count());
            let block = (BLOCK / band(cols)).max(SHORTEST_BLOCK);
            let blocks = Order::in_blocks(layers + 1, image.count(), block);
            if whole.slots() * band(cols) <= CACHED { whole } else { blocks }
        };
        // The error at the edge of a strip spreads by one tile per layer.
        let overlap = layers * BAND;
        let mut strip = image.cols.next_multiple_of(BAND);
        let taken = |cols| order(cols).slots() * band(cols);
        while strip > 2 * overlap + BAND && taken(strip) > self.0.settings.memory {
            strip -= BAND;
        }
        Plan { image, order: order(strip), strip, overlap }
    }

    fn widest_pitch(&self) -> usize {
        let pitch = |layer: &Conv2d| layer.input_pitch().max(layer.output_pitch());
        self.0.layers.iter().map(pitch).max().unwrap_or(0)
    }

    fn lengths(&self, plan: Plan) -> Lengths {
        let strip = Bands { rows: plan.image.rows, cols: plan.strip };
        let last = &self.0.layers[self.0.layers.len() - 1];
        let layer = |layer: &Conv2d| layer.scratch_len(self.0.method(layer, plan.image));
        Lengths {
            band: strip.len(self.widest_pitch()),
            last: strip.len(last.output_pitch()),
            layer: self.0.layers.iter().map(layer).max().unwrap_or(0),
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
    /// The strips of the image. All but the last have the maximum width.
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
mod tests;
