//! Tests of the compiled program on the command line: its files, its output and its exit status.

mod carve;
mod cloud;
mod convert;
mod dataset;
mod demo;
mod frame;
mod images;
mod infer;
mod invert;
mod plot;
mod program;
mod render;
mod score;
mod sense;
// Signals and links.
#[cfg(unix)]
mod stopped;
mod validate;
mod view;
mod wrong;
