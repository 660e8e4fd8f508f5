//! A two-dimensional 3x3 convolution with padding 1 and fused bias and ReLU.
//!
//! ```text
//! Stack      a sequence of layers: run() computes bands of four rows
//! Source     the input of the first layer: an array, or values computed on demand
//! Lane       the buffers of one image while it passes through the layers
//! Order      the order in which the threads compute the bands of all layers
//! Conv2d     one layer; its weights are packed once for an algorithm and a kernel
//! Algorithm  im2col, direct, or Winograd's minimal filtering with tiles of 2x2 or 4x4
//! Kernel     the inner loops, compiled for the instruction set of the processor
//! ```
//!
//! Between layers, the channels of a pixel are contiguous and padded to whole vectors. Every
//! loop therefore works on vectors of channels, and no tap needs a shifted vector.

mod algorithm;
pub mod kernels;
mod lane;
mod layer;
mod layers;
mod schedule;
mod settings;
mod shape;
mod source;
mod stack;

pub use algorithm::{Algorithm, Precision};
pub use kernels::Kernel;
pub use layer::Conv2d;
pub use settings::{Scales, Settings};
pub use shape::Conv2dShape;
pub use source::{Source, SourceRow};
pub use stack::{Scratch, Stack};
