//! The hand-written two-dimensional convolution.
