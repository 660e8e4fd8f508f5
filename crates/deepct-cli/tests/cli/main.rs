//! The real program, driven as a user does: its files, its words, its exit status.

mod carve;
mod cloud;
mod dataset;
mod demo;
mod frame;
mod infer;
mod invert;
mod plot;
mod program;
mod render;
mod score;
mod sense;
mod validate;
