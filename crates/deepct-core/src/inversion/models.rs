//! What an inversion needs of a forward model.

use crate::error::Result;
use crate::grid::{Mask, Volume};
use crate::image::ViewStack;
use ndarray::Array3;

/// The images of an extinction, and how they depend on it.
pub trait ForwardModel {
    /// The images of an extinction (1/km).
    ///
    /// # Errors
    /// Those of the model.
    fn images(&mut self, extinction: &Volume) -> Result<ViewStack>;

    /// The derivative of `sum(weights * images)` with respect to the extinction of each
    /// voxel, at the extinction of the last [`ForwardModel::images`].
    ///
    /// # Errors
    /// Those of the model.
    fn gradient(&mut self, weights: &ViewStack) -> Result<Volume>;
}

/// What a model is made for.
#[derive(Debug, Clone, Copy)]
pub struct Domain<'a> {
    /// The grid, that of the problem or one of blocks of its voxels, and where on it extinction is
    /// not 0.
    pub mask: &'a Mask,
    /// The extinction (1/km) that steps begin at, about, on the same grid.
    pub expected: &'a Volume,
    /// Whether that is an estimate of the answer, and not the same everywhere or of a coarser grid.
    pub near: bool,
    /// The pixels `[view, row, col]` that count; others may be left at 0.
    pub pixels: &'a Array3<bool>,
}

/// Models of the same images on any grid.
pub trait Models {
    /// Whether models near the answer are more accurate than others, and most so at the extinction
    /// that they are made for.
    fn are_corrected(&self) -> bool {
        false
    }

    /// The model for a domain.
    ///
    /// # Errors
    /// Those of the model.
    fn model(&mut self, domain: &Domain) -> Result<Box<dyn ForwardModel + '_>>;
}
