//! The order in which the threads compute the bands of all layers.
//!
//! A task computes one band of one layer from three bands of the preceding layer. The bands are
//! grouped into blocks. A block of a layer is computed after the corresponding block of the
//! preceding layer and is offset from it by one band; the next block follows once a block has
//! passed through all layers:
//!
//! ```text
//! bands        0 1 2 3 4 5 6 7 8
//! layer 0      a a a a b b b b c        a, then b, then c; within each layer 0, 1, 2
//! layer 1      a a a b b b b c c
//! layer 2      a a b b b b c c c
//! ```
//!
//! The next layer reads the result of a block immediately, while it is in the cache. Only the
//! last two bands of a block are needed later, by the next block. For any length of the image,
//! memory therefore holds four such edge bands per layer and two layers of one block. A small
//! image is a single block.
//!
//! The threads share one list of tasks. Each thread takes a free task, first from its own part
//! of the block so that the data it wrote there are in its cache, and waits until the tasks on
//! which it depends are done. These come earlier in the list, so running threads have taken them
//! already; no thread waits for one that has not started.

use std::ops::Range;
use std::sync::atomic::{AtomicU8, Ordering};

/// Bands at the end of a block that the block below it reads.
const EDGE: usize = 2;

const FREE: u8 = 0;
const TAKEN: u8 = 1;
const DONE: u8 = 2;
/// Taken by a thread that panicked.
const LOST: u8 = 3;

/// The order of the tasks of one image. Layer 0 is the image itself; the last layer is not
/// stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Order {
    layers: usize,
    bands: usize,
    /// Number of bands of a block.
    block: usize,
}

/// A band of a layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Task {
    pub(super) layer: usize,
    pub(super) band: usize,
}

impl Order {
    /// The order that computes the image layer by layer.
    pub(super) fn whole(layers: usize, bands: usize) -> Self {
        Self::in_blocks(layers, bands, bands + layers + EDGE)
    }

    /// The order that computes the image in blocks of `block` bands, at least three.
    pub(super) fn in_blocks(layers: usize, bands: usize, block: usize) -> Self {
        Self { layers, bands, block }
    }

    /// Total number of tasks.
    pub(super) fn tasks(self) -> usize {
        self.layers * self.bands
    }

    /// Number of bands of a layer.
    pub(super) fn bands(self) -> usize {
        self.bands
    }

    /// Number of blocks.
    fn blocks(self) -> usize {
        (self.bands + self.layers - 1).div_ceil(self.block)
    }

    /// Number of bands of a layer that are stored while a block is computed. It is that of the
    /// block, although the edge bands are stored elsewhere: a slot becomes free two bands before
    /// it is written.
    fn passing(self) -> usize {
        self.block.min(self.bands)
    }

    /// Number of bands that must be stored.
    pub(super) fn slots(self) -> usize {
        let reaches_edge = self.bands + self.layers + EDGE > self.block + 1;
        let edges = if reaches_edge { 2 * EDGE * (self.layers - 1) } else { 0 };
        2 * self.passing() + edges
    }

    /// The block of a task and its position in the block.
    fn place(self, Task { layer, band }: Task) -> (usize, usize) {
        ((band + layer) / self.block, (band + layer) % self.block)
    }

    /// The index of a task among the edge bands of its block, if it is one of them.
    fn edge(self, task: Task) -> Option<usize> {
        (self.place(task).1 + EDGE).checked_sub(self.block)
    }

    /// The slot in which the band of a task is stored.
    pub(super) fn slot(self, task: Task) -> usize {
        let Task { layer, band } = task;
        match self.edge(task) {
            None => layer % 2 * self.passing() + band % self.passing(),
            Some(edge) => {
                let side = 2 * layer + self.place(task).0 % 2;
                2 * self.passing() + EDGE * side + edge
            }
        }
    }

    /// The bands of a layer in a block.
    fn range(self, block: usize, layer: usize) -> Range<usize> {
        let at = |block: usize| (block * self.block).saturating_sub(layer).min(self.bands);
        at(block)..at(block + 1)
    }

    /// The task whose band a task overwrites.
    fn overwritten(self, task: Task) -> Option<Task> {
        let Task { layer, band } = task;
        let (block, _) = self.place(task);
        if self.edge(task).is_some() {
            return Some(Task { layer, band: band.checked_sub(2 * self.block)? });
        }
        // Search backwards through the list over the layers that share the slots of this one.
        let kept = self.layers - 1;
        let same_block = (0..layer).rev().skip(1).step_by(2).map(|layer| (block, layer));
        let earlier = (0..block).rev().flat_map(move |block| {
            let layers = (0..kept).rev().filter(move |other| other % 2 == layer % 2);
            layers.map(move |layer| (block, layer))
        });
        same_block.chain(earlier).find_map(|(block, layer)| {
            let range = self.range(block, layer);
            let ahead = band + self.passing() - range.start % self.passing();
            let other = Task { layer, band: range.start + ahead % self.passing() };
            let there = range.contains(&other.band) && self.edge(other).is_none();
            there.then_some(other)
        })
    }

    /// The tasks of a layer at a band and its neighbours: those that read the band, or that it
    /// reads.
    fn neighbours(self, layer: usize, band: usize) -> impl Iterator<Item = Task> {
        let near = band.saturating_sub(1)..(band + 2).min(self.bands);
        near.map(move |band| Task { layer, band })
    }

    /// The tasks that must be done before a task: those whose bands it reads, and those that read
    /// the band that it overwrites.
    fn before(self, task: Task) -> impl Iterator<Item = Task> {
        let Task { layer, band } = task;
        let read = layer.checked_sub(1).map(|layer| self.neighbours(layer, band));
        let overwritten = if layer + 1 < self.layers { self.overwritten(task) } else { None };
        let readers = overwritten.map(|other| self.neighbours(other.layer + 1, other.band));
        read.into_iter().flatten().chain(readers.into_iter().flatten())
    }

    /// Run tasks until all have been taken. `states` has one value for each task, initially zero.
    pub(super) fn work(self, states: &[AtomicU8], part: Part, mut run: impl FnMut(Task)) {
        let state = |Task { layer, band }: Task| &states[layer * self.bands + band];
        for (block, layer) in (0..self.blocks()).flat_map(|b| (0..self.layers).map(move |l| (b, l)))
        {
            let all = self.range(block, layer);
            // The parts of a block are too short for a fixed assignment: any free thread takes
            // its bands.
            let own = if self.blocks() > 1 { all.clone() } else { part.of(&all) };
            let others = all.rev().filter(|band| !own.contains(band));
            for band in own.clone().chain(others) {
                let task = Task { layer, band };
                let taken =
                    state(task).compare_exchange(FREE, TAKEN, Ordering::Relaxed, Ordering::Relaxed);
                if taken.is_err() {
                    continue;
                }
                let taken = Taken(state(task));
                self.before(task).for_each(|task| wait_until_done(state(task)));
                run(task);
                taken.done();
            }
        }
    }
}

/// A task that this thread has taken. If the thread panics, the task is marked as lost, so that
/// no other thread waits for it indefinitely.
struct Taken<'a>(&'a AtomicU8);

impl Taken<'_> {
    fn done(self) {
        self.0.store(DONE, Ordering::Release);
        std::mem::forget(self);
    }
}

impl Drop for Taken<'_> {
    fn drop(&mut self) {
        self.0.store(LOST, Ordering::Release);
    }
}

/// The part of the work of one of several threads.
#[derive(Debug, Clone, Copy)]
pub(super) struct Part {
    pub(super) number: usize,
    pub(super) of: usize,
}

impl Part {
    fn of(self, all: &Range<usize>) -> Range<usize> {
        let at = |number: usize| all.start + number * all.len() / self.of;
        at(self.number)..at(self.number + 1)
    }
}

/// Wait until another thread has completed a task, which takes microseconds. Yield regularly in
/// case that thread has been suspended.
fn wait_until_done(state: &AtomicU8) {
    let mut looks = 0_u32;
    loop {
        match state.load(Ordering::Acquire) {
            DONE => return,
            LOST => panic!("another thread panicked in a task that this one depends on"),
            _ => {}
        }
        looks += 1;
        if looks.is_multiple_of(1 << 10) {
            std::thread::yield_now();
        }
        std::hint::spin_loop();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Run an order one task at a time and check the stored bands that each task reads.
    fn follow(order: Order) {
        let Order { layers, bands, .. } = order;
        let mut slots: Vec<Option<Task>> = vec![None; order.slots()];
        let mut done = Vec::new();
        let states: Vec<AtomicU8> = (0..order.tasks()).map(|_| AtomicU8::new(FREE)).collect();
        order.work(&states, Part { number: 0, of: 1 }, |task| {
            for read in task
                .layer
                .checked_sub(1)
                .into_iter()
                .flat_map(|layer| order.neighbours(layer, task.band))
            {
                assert_eq!(slots[order.slot(read)], Some(read), "{order:?} {task:?}");
            }
            assert!(order.before(task).all(|task| done.contains(&task)), "{order:?} {task:?}");
            if task.layer + 1 < layers {
                let before = slots[order.slot(task)].replace(task);
                assert_eq!(before, order.overwritten(task), "{order:?} {task:?}");
            }
            done.push(task);
        });
        assert_eq!(done.len(), layers * bands);
    }

    #[test]
    fn every_task_finds_what_it_reads_and_knows_what_it_overwrites() {
        for layers in 2..7 {
            for bands in 1..20 {
                follow(Order::whole(layers, bands));
                for block in 3..9 {
                    follow(Order::in_blocks(layers, bands, block));
                }
            }
        }
    }
}
