//! The computation of all layers for one image or a strip of one.

use super::kernels::SharedPlanes;
use super::layer::BandInput;
use super::layers::Layers;
use super::schedule::{Order, Part, Task};
use super::shape::{BAND, Bands, SEEN};
use super::source::{Source, SourceRow};
use rayon::prelude::*;
use std::ops::{Deref, DerefMut, Range};
use std::sync::atomic::{AtomicBool, AtomicU8};
use std::sync::{LockResult, PoisonError, RwLock};

/// The buffers for passing one image through the layers.
#[derive(Debug)]
pub(super) struct Lane {
    order: Order,
    lengths: Lengths,
    /// The bands of the layers, in the slots that the order assigns. No thread waits for a
    /// lock, because the order permits writing a band only when no thread reads it.
    bands: Vec<RwLock<Aligned>>,
    /// The state of each task.
    states: Vec<AtomicU8>,
    /// Flags of the output bands that have been handed out.
    written: Vec<AtomicBool>,
    /// A row of zeros that stands for the rows above and below the image.
    zeros: Vec<f32>,
    /// The buffers of each thread.
    workers: Vec<Worker>,
}

/// The buffers of one thread.
#[derive(Debug)]
struct Worker {
    /// A band of the last layer before it is copied to the output.
    last: Aligned,
    /// The scratch memory of a layer.
    layer: Aligned,
}

/// Lengths of the parts of a lane, in floats.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Lengths {
    pub(super) band: usize,
    pub(super) last: usize,
    pub(super) layer: usize,
}

/// Columns of an image that are computed together.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Strip {
    pub(super) computed: Range<usize>,
    /// The columns that the edges of the strip inside the image do not affect.
    pub(super) kept: Range<usize>,
}

/// The task of a lane: the layers, the strip and its input.
#[derive(Clone, Copy)]
pub(super) struct Work<'a> {
    pub(super) layers: &'a Layers,
    /// The size of the image.
    pub(super) image: Bands,
    pub(super) strip: &'a Strip,
    /// The input of the first layer.
    pub(super) source: &'a dyn Source,
    /// The index of the image in the source.
    pub(super) number: usize,
}

impl Lane {
    pub(super) fn new(order: Order, lengths: Lengths, threads: usize) -> Self {
        let worker =
            || Worker { last: Aligned::new(lengths.last), layer: Aligned::new(lengths.layer) };
        Self {
            order,
            lengths,
            bands: (0..order.slots()).map(|_| RwLock::new(Aligned::new(lengths.band))).collect(),
            states: (0..order.tasks()).map(|_| AtomicU8::new(0)).collect(),
            written: (0..order.bands()).map(|_| AtomicBool::new(false)).collect(),
            zeros: vec![0.0; lengths.band / BAND],
            workers: (0..threads).map(|_| worker()).collect(),
        }
    }

    /// Whether the lane was allocated for this order and these lengths.
    pub(super) fn fits(&self, order: Order, lengths: Lengths) -> bool {
        (self.order, self.lengths) == (order, lengths)
    }

    /// The size in bytes.
    pub(super) fn bytes(&self) -> usize {
        let Lengths { band, last, layer } = self.lengths;
        let floats =
            self.bands.len() * band + self.workers.len() * (last + layer) + self.zeros.len();
        floats * size_of::<f32>() + self.states.len() + self.written.len()
    }

    /// Compute the strip and write its valid columns to `output`, `[channel, row, col]` of the
    /// whole image.
    pub(super) fn run(&mut self, work: Work<'_>, output: &mut [f32]) {
        self.states.iter_mut().for_each(|state| *state.get_mut() = 0);
        self.written.iter_mut().for_each(|written| *written.get_mut() = false);
        let Self { order, bands, states, written, zeros, workers, .. } = self;
        let Bands { rows, cols } = work.image;
        let output = &SharedPlanes::new(output, rows * cols, BAND * cols, written);
        let (order, of) = (*order, workers.len());
        let shared = Shared { order, bands, zeros, work, output };
        let run = |(number, worker): (usize, &mut Worker)| {
            order.work(states, Part { number, of }, |task| shared.run(task, worker));
        };
        match &mut workers[..] {
            [worker] => run((0, worker)),
            // Threads that are busy elsewhere do not take part; the others then do their part of
            // the work.
            workers => workers.par_iter_mut().enumerate().with_max_len(1).for_each(run),
        }
    }
}

/// The data that all threads share.
#[derive(Clone, Copy)]
struct Shared<'a> {
    order: Order,
    bands: &'a [RwLock<Aligned>],
    zeros: &'a [f32],
    work: Work<'a>,
    output: &'a SharedPlanes<'a>,
}

impl Shared<'_> {
    /// The layout of the strip as a separate image.
    fn strip(&self) -> Bands {
        Bands { rows: self.work.image.rows, cols: self.work.strip.computed.len() }
    }

    fn run(&self, task: Task, worker: &mut Worker) {
        let layers = &self.work.layers.layers;
        let Some(layer) = task.layer.checked_sub(1) else {
            let mut band = unpoisoned(self.bands[self.order.slot(task)].write());
            return self.take_in(task.band, layers[0].input_pitch(), &mut band);
        };
        if layer + 1 == layers.len() {
            self.run_layer(layer, task.band, &mut worker.last, &mut worker.layer);
            self.give_out(task.band, layers[layer].output_pitch(), &worker.last);
        } else {
            let mut band = unpoisoned(self.bands[self.order.slot(task)].write());
            self.run_layer(layer, task.band, &mut band, &mut worker.layer);
        }
    }

    /// Compute a band of layer `layer`.
    fn run_layer(&self, layer: usize, band: usize, output: &mut [f32], scratch: &mut [f32]) {
        let Work { layers, image, .. } = self.work;
        let (strip, convolution) = (self.strip(), &layers.layers[layer]);
        let row_len = strip.row_len(convolution.input_pitch());
        let read = |band: usize| {
            let slot = self.order.slot(Task { layer, band });
            (band < strip.count()).then(|| unpoisoned(self.bands[slot].read()))
        };
        let seen = [band.checked_sub(1).and_then(read), read(band), read(band + 1)];
        // Row `index` of the input, counted from the first row of the band above.
        let row = |index: usize| match &seen[index / BAND] {
            Some(band) => &band[index % BAND * row_len..][..row_len],
            None => &self.zeros[..row_len],
        };
        let rows: [&[f32]; SEEN] = std::array::from_fn(|index| row(BAND - 1 + index));
        let pitch = convolution.output_pitch();
        let output = &mut output[..strip.len(pitch)];
        let method = layers.method(convolution, image);
        convolution.run_band(method, &BandInput { bands: strip, rows }, output, scratch);
        strip.clear_border(band, pitch, output);
    }

    /// Read a band of the image from the source and arrange it by pixels.
    fn take_in(&self, band: usize, pitch: usize, values: &mut [f32]) {
        let Work { source, number, strip: Strip { computed, .. }, .. } = self.work;
        let strip = self.strip();
        let rows = values.chunks_exact_mut(strip.row_len(pitch)).take(strip.rows_of(band));
        for (row, pixels) in rows.enumerate() {
            pixels.fill(0.0);
            let row = band * BAND + row;
            let row = SourceRow { image: number, row, columns: computed.clone(), pitch };
            // The first pixel is the column of zeros to the left of the image.
            source.read(&row, &mut pixels[pitch..][..computed.len() * pitch]);
        }
        strip.clear_border(band, pitch, &mut values[..strip.len(pitch)]);
    }

    /// Copy a band of the last layer to the output, arranged by channels.
    fn give_out(&self, band: usize, pitch: usize, values: &[f32]) {
        let Strip { computed, kept } = self.work.strip;
        let (strip, cols) = (self.strip(), self.work.image.cols);
        let scale = self.work.layers.scales.output;
        let mut output = self.output.take(band).expect("the order runs each task once");
        for channel in 0..self.work.layers.output_channels() {
            let rows = output.plane(channel).chunks_exact_mut(cols);
            for (row, pixels) in rows.zip(values.chunks_exact(strip.row_len(pitch))) {
                let first = (1 + kept.start - computed.start) * pitch + channel;
                let pixels = pixels[first..].iter().step_by(pitch);
                row[kept.clone()]
                    .iter_mut()
                    .zip(pixels)
                    .for_each(|(to, value)| *to = scale * value);
            }
        }
    }
}

/// The value behind a lock, even if it is poisoned: values left by a thread that panicked are
/// overwritten before they are read.
pub(super) fn unpoisoned<T>(guarded: LockResult<T>) -> T {
    guarded.unwrap_or_else(PoisonError::into_inner)
}

/// A buffer of floats that is aligned to a cache line.
#[derive(Debug)]
pub(super) struct Aligned {
    values: Vec<f32>,
    start: usize,
}

const LINE: usize = 16;

impl Aligned {
    fn new(len: usize) -> Self {
        let values = vec![0.0; len + LINE];
        let start = values.as_ptr().align_offset(LINE * size_of::<f32>()).min(LINE);
        Self { values, start }
    }
}

impl Deref for Aligned {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        &self.values[self.start..self.start + self.values.len() - LINE]
    }
}

impl DerefMut for Aligned {
    fn deref_mut(&mut self) -> &mut [f32] {
        let end = self.start + self.values.len() - LINE;
        &mut self.values[self.start..end]
    }
}
