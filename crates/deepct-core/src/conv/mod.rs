//! The hand-written two-dimensional convolution: 3x3, padding 1, bias and ReLU fused.
//!
//! A layer is a matrix product: each output channel is the sum, over 9 taps of every
//! input channel, of a weight times the image shifted by that tap. The images are cut
//! into panels of a few dozen pixels. For one panel the shifted pixels are gathered as
//! the columns of a matrix (im2col), small enough to stay in the cache of the core that
//! made it, and a [`Kernel`] multiplies it with the weights, a block of output channels
//! at a time whose sums all live in registers. Panels are shared out among threads.
//!
//! ```text
//! Conv2d   the weights of a layer, packed once for a kernel
//! Stack    layers one after another, and the scratch that they run in
//! Kernel   the inner loops, chosen by what the processor can do
//! ```
//!
//! Between layers the channels lie in padded planes, in which a shift
//! by a tap is an offset: no border case is left in any loop.

mod im2col;
pub mod kernels;
mod layer;
mod shape;
mod stack;

pub use kernels::Kernel;
pub use layer::Conv2d;
pub use shape::Conv2dShape;
pub use stack::Stack;
