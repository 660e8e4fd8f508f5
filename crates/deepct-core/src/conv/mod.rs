//! The hand-written two-dimensional convolution: 3x3, padding 1, bias and ReLU fused.
//!
//! ```text
//! Stack      layers one after another: run() computes a band of four rows at a time
//! Source     what the first layer reads: an array, or what is made when it is wanted
//! Lane       the memory of one image on its way through the layers
//! Order      which thread computes which band of which layer, and when
//! Conv2d     a layer, its weights packed once for an algorithm and a kernel
//! Algorithm  im2col, direct, or Winograd's minimal filtering with tiles of 2x2 or 4x4
//! Kernel     the inner loops, compiled for the instructions that the processor has
//! ```
//!
//! Between layers a pixel's channels lie side by side in whole vectors, so that every loop
//! works on vectors of channels and no tap ever wants a shifted one.

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
