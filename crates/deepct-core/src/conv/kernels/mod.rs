//! The inner loops, one file for each set of instructions, and the only place of the
//! convolution that is `unsafe`.
//!
//! A kernel is two functions of a panel of `pixels()` pixels: one gathers the columns,
//! the other adds the product of a block of weights with them to the sums of up to
//! `channels()` output channels, all of which it holds in registers. Both numbers are
//! chosen so that the sums, the columns and a weight just fill the registers.
//!
//! The portable kernel is plain Rust and the twin that the others are tested against;
//! one suite, at the end of this file, runs on every kernel that the processor has.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod scalar;
mod tiles;

use crate::conv::im2col::Panel;
#[cfg(target_arch = "x86_64")]
use crate::conv::shape::LINE;
pub(super) use tiles::{Cut, Tile, Tiles};

/// A set of inner loops that the processor can run.
///
/// A value can only be had from [`Kernel::available`] and [`Kernel::best`], which ask
/// the processor; that is why running one is safe.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Kernel(Instructions);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Instructions {
    Portable,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Kernel {
    /// The kernels that this processor can run, slowest first.
    pub fn available() -> Vec<Self> {
        let mut kernels = vec![Self(Instructions::Portable)];
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                kernels.push(Self(Instructions::Avx2));
            }
            if is_x86_feature_detected!("avx512f") {
                kernels.push(Self(Instructions::Avx512));
            }
        }
        kernels
    }

    /// The fastest kernel that this processor can run.
    pub fn best() -> Self {
        Self::available().pop().unwrap_or(Self(Instructions::Portable))
    }

    /// Its name: `portable`, `avx2` or `avx512`.
    pub fn name(self) -> &'static str {
        match self.0 {
            Instructions::Portable => "portable",
            #[cfg(target_arch = "x86_64")]
            Instructions::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            Instructions::Avx512 => "avx512",
        }
    }

    /// Number of pixels in a panel.
    pub(super) fn pixels(self) -> usize {
        match self.0 {
            Instructions::Portable => scalar::PIXELS,
            #[cfg(target_arch = "x86_64")]
            Instructions::Avx2 => avx2::PIXELS,
            #[cfg(target_arch = "x86_64")]
            Instructions::Avx512 => avx512::PIXELS,
        }
    }

    /// The most output channels in a block.
    pub(super) fn channels(self) -> usize {
        match self.0 {
            Instructions::Portable => scalar::CHANNELS,
            #[cfg(target_arch = "x86_64")]
            Instructions::Avx2 => avx2::CHANNELS,
            #[cfg(target_arch = "x86_64")]
            Instructions::Avx512 => avx512::CHANNELS,
        }
    }

    /// Write the columns of a panel, `[channel, tap, pixel]`.
    #[allow(unsafe_code)]
    pub(super) fn gather(self, panel: Panel<'_>, columns: &mut [f32]) {
        match self.0 {
            Instructions::Portable => scalar::gather(panel, columns),
            // SAFETY: this value exists only where the processor has these instructions.
            #[cfg(target_arch = "x86_64")]
            Instructions::Avx2 => unsafe { avx2::gather(panel, columns) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Instructions::Avx512 => unsafe { avx512::gather(panel, columns) },
        }
    }

    /// Ask the cache for the input that `panel` is the first to see: its lowest row.
    pub(super) fn prefetch_panel(self, panel: Panel<'_>) {
        let lowest = panel.first + 2 * panel.plane.pitch();
        for channel in panel.channels {
            self.prefetch(panel.planes, channel * panel.plane.len() + lowest);
        }
    }

    /// Ask the cache for the values of a panel from position `from` on. Positions beyond
    /// the end are allowed, and where there is no such instruction nothing is done.
    #[allow(unsafe_code)]
    pub(super) fn prefetch(self, values: &[f32], from: usize) {
        #[cfg(target_arch = "x86_64")]
        for line in (from..from + self.pixels() + LINE).step_by(LINE) {
            use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
            // SAFETY: a prefetch reads nothing that the program can see and may name any
            // address.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(values.as_ptr().wrapping_add(line).cast()) };
        }
        #[cfg(not(target_arch = "x86_64"))]
        let _ = (values, from);
    }

    /// Add to `sums`, `[output channel, pixel]`, the product of `weights`,
    /// `[column, output channel]`, and `columns`, `[column, pixel]`. The number of
    /// output channels follows from the length of `sums`.
    #[allow(unsafe_code)]
    pub(super) fn accumulate(self, columns: &[f32], weights: &[f32], sums: &mut [f32]) {
        match self.0 {
            Instructions::Portable => scalar::accumulate(columns, weights, sums),
            // SAFETY: this value exists only where the processor has these instructions.
            #[cfg(target_arch = "x86_64")]
            Instructions::Avx2 => unsafe { avx2::accumulate(columns, weights, sums) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Instructions::Avx512 => unsafe { avx512::accumulate(columns, weights, sums) },
        }
    }
}

/// Call `$function::<N>($arguments)` with `N` the number of output channels of a block.
macro_rules! for_block {
    ($channels:expr, $function:ident $arguments:tt, $($n:literal)*) => {
        match $channels {
            $($n => $function::<$n> $arguments,)*
            channels => unreachable!("a block of {channels} channels"),
        }
    };
}
use for_block;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conv::shape::Plane;

    fn values(count: usize, step: usize) -> Vec<f32> {
        (0..count).map(|index| ((index * step + 3) % 31) as f32 / 16.0 - 1.0).collect()
    }

    /// Every size of block and several numbers of columns against a plain f64 sum.
    fn accumulates(kernel: Kernel) {
        let pixels = kernel.pixels();
        for channels in 1..=kernel.channels() {
            for depth in [1, 9, 288] {
                let (columns, weights) = (values(depth * pixels, 7), values(depth * channels, 11));
                let before = values(channels * pixels, 5);
                let mut sums = before.clone();
                kernel.accumulate(&columns, &weights, &mut sums);
                for (at, (sum, before)) in sums.iter().zip(before).enumerate() {
                    let (channel, pixel) = (at / pixels, at % pixels);
                    let terms = (0..depth).map(|k| {
                        f64::from(weights[k * channels + channel])
                            * f64::from(columns[k * pixels + pixel])
                    });
                    let expected = f64::from(before) + terms.sum::<f64>();
                    assert!((f64::from(*sum) - expected).abs() < 1e-4, "{sum} {expected}");
                }
            }
        }
    }

    /// The columns against the definition of a plane.
    fn gathers(kernel: Kernel) {
        let plane = Plane { rows: 5, cols: 13 };
        let planes = values(4 * plane.len(), 13);
        let (pixels, pitch) = (kernel.pixels(), plane.pitch());
        let mut columns = vec![f32::NAN; 2 * 9 * pixels];
        let panel = Panel { planes: &planes, plane, channels: 1..3, first: 4 };
        kernel.gather(panel, &mut columns);
        for (at, value) in columns.iter().enumerate() {
            let (channel, tap, pixel) = (1 + at / pixels / 9, at / pixels % 9, at % pixels);
            let from = channel * plane.len() + 4 + pixel + tap / 3 * pitch + tap % 3;
            assert_eq!(*value, planes[from]);
        }
    }

    #[test]
    fn every_kernel_does_what_it_says() {
        for kernel in Kernel::available() {
            accumulates(kernel);
            gathers(kernel);
        }
        assert_eq!(Kernel::available()[0].name(), "portable");
        assert_eq!(Kernel::available().last(), Some(&Kernel::best()));
    }
}
