//! The interface between an inversion and a forward model.

use crate::error::Result;
use crate::grid::{Mask, Volume};
use crate::image::ViewStack;
use ndarray::Array3;

/// A model of the images of an extinction field, and of their derivatives.
pub trait ForwardModel {
    /// Computes the images of an extinction (1/km).
    ///
    /// # Errors
    /// The errors of the model.
    fn images(&mut self, extinction: &Volume) -> Result<ViewStack>;

    /// Computes the derivative of `sum(weights * images)` with respect to the extinction of each
    /// voxel, at the extinction of the last call of [`ForwardModel::images`].
    ///
    /// # Errors
    /// The errors of the model.
    fn gradient(&mut self, weights: &ViewStack) -> Result<Volume>;

    /// Forgets earlier evaluations, from which a model may start later ones. An inversion calls it
    /// where it can be resumed, so that a resumed inversion has the same results.
    fn forget(&mut self) {}
}

/// The conditions for which a model is created.
#[derive(Debug, Clone, Copy)]
pub struct Domain<'a> {
    /// The grid, which is that of the problem or one of blocks of its voxels, and the voxels in
    /// which the extinction may be positive.
    pub mask: &'a Mask,
    /// The approximate extinction (1/km) at which the iterations begin, on the same grid.
    pub expected: &'a Volume,
    /// Whether `expected` is an estimate of the solution, as opposed to a uniform field or a result
    /// on a coarser grid.
    pub near: bool,
    /// The pixels `[view, row, col]` that are included; the model may leave all others at 0.
    pub pixels: &'a Array3<bool>,
}

/// A source of forward models of the same images on any grid.
pub trait Models {
    /// Whether models created near the solution are more accurate than others, with the highest
    /// accuracy at the extinction for which they are created.
    fn are_corrected(&self) -> bool {
        false
    }

    /// Creates the model for a domain.
    ///
    /// # Errors
    /// The errors of the model.
    fn model(&mut self, domain: &Domain) -> Result<Box<dyn ForwardModel + '_>>;
}
