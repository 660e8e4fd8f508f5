//! In which order the bands of all layers are computed, and by which thread.
//!
//! A task is a band of a layer. It reads three bands of the layer before and writes one.
//! Small images are run layer by layer: two sets of bands are enough, and both stay in the
//! cache. Large ones are run as a wave: each layer follows two bands behind the one before
//! it, so four bands of each layer are all that memory has to hold, however long the image.
//!
//! Threads share one list of tasks. Each takes a task that nobody has, from its own part of
//! the step first so that it finds in its cache what it wrote there, and waits until the
//! tasks that it depends on are done. Those come earlier in the list, so they were taken by
//! threads that run; a thread that never comes is never waited for.

use std::ops::Range;
use std::sync::atomic::{AtomicU8, Ordering};

/// Bands that a layer is behind the one before it in a wave. With two, all tasks of a step
/// are independent.
const LAG: usize = 2;

/// Bands of a layer that a wave needs at a time: one being written, and the last one that
/// the next layer still reads is three behind it.
const KEPT: usize = LAG + 2;

const FREE: u8 = 0;
const TAKEN: u8 = 1;
const DONE: u8 = 2;

/// The order of the tasks of one image. Layer 0 is the image itself; the last one is not
/// kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Order {
    layers: usize,
    bands: usize,
    wave: bool,
}

/// A band of a layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Task {
    pub(super) layer: usize,
    pub(super) band: usize,
}

impl Order {
    /// Layer by layer, or as a wave.
    pub(super) fn new(layers: usize, bands: usize, wave: bool) -> Self {
        Self { layers, bands, wave }
    }

    /// Number of tasks, done and to do.
    pub(super) fn tasks(self) -> usize {
        self.layers * self.bands
    }

    /// Number of bands of a layer.
    pub(super) fn bands(self) -> usize {
        self.bands
    }

    /// Number of bands that must be kept.
    pub(super) fn slots(self) -> usize {
        if self.wave { (self.layers - 1) * KEPT } else { 2 * self.bands }
    }

    /// Where the band of a task is kept.
    pub(super) fn slot(self, Task { layer, band }: Task) -> usize {
        if self.wave { layer * KEPT + band % KEPT } else { layer % 2 * self.bands + band }
    }

    /// Number of steps.
    fn steps(self) -> usize {
        if self.wave { self.bands + LAG * (self.layers - 1) } else { self.layers }
    }

    /// Number of tasks of a step; some may be of no band.
    fn width(self) -> usize {
        if self.wave { self.layers } else { self.bands }
    }

    /// A task of a step.
    fn task(self, step: usize, index: usize) -> Option<Task> {
        let task = if self.wave {
            Task { layer: index, band: step.checked_sub(LAG * index)? }
        } else {
            Task { layer: step, band: index }
        };
        (task.band < self.bands).then_some(task)
    }

    /// The tasks that must be done before: those that are read, and the last one that reads
    /// what is overwritten.
    fn before(self, Task { layer, band }: Task) -> impl Iterator<Item = Task> {
        let read = band.saturating_sub(1)..(band + 2).min(self.bands);
        let read = read.filter_map(move |band| Some(Task { layer: layer.checked_sub(1)?, band }));
        let overwritten = (self.wave && band + 1 >= KEPT && layer + 1 < self.layers)
            .then(|| Task { layer: layer + 1, band: band + 1 - KEPT });
        read.chain(overwritten)
    }

    /// Do tasks until none are left that nobody has taken. `states` has a value for each
    /// task, all zero at first.
    pub(super) fn work(self, states: &[AtomicU8], part: Part, mut run: impl FnMut(Task)) {
        let state = |Task { layer, band }: Task| &states[layer * self.bands + band];
        let own = part.of(self.width());
        for step in 0..self.steps() {
            let others = (0..self.width()).rev().filter(|index| !own.contains(index));
            for task in own.clone().chain(others).filter_map(|index| self.task(step, index)) {
                let taken =
                    state(task).compare_exchange(FREE, TAKEN, Ordering::Relaxed, Ordering::Relaxed);
                if taken.is_err() {
                    continue;
                }
                self.before(task).for_each(|task| wait_until_done(state(task)));
                run(task);
                state(task).store(DONE, Ordering::Release);
            }
        }
    }
}

/// The part of one of several threads.
#[derive(Debug, Clone, Copy)]
pub(super) struct Part {
    pub(super) number: usize,
    pub(super) of: usize,
}

impl Part {
    fn of(self, count: usize) -> Range<usize> {
        self.number * count / self.of..(self.number + 1) * count / self.of
    }
}

/// Another thread is at it and needs microseconds; should it have been stopped, let it go on.
fn wait_until_done(state: &AtomicU8) {
    let mut looks = 0_u32;
    while state.load(Ordering::Acquire) != DONE {
        looks += 1;
        if looks.is_multiple_of(1 << 10) {
            std::thread::yield_now();
        }
        std::hint::spin_loop();
    }
}
