//! The interface between an inversion and a forward model.

use crate::error::Result;
use crate::grid::{Mask, Volume};
use crate::image::ViewStack;
use crate::transport::Derivatives;
use ndarray::Array3;

/// The fields that determine the images of a cloud.
#[derive(Debug, Clone, PartialEq)]
pub struct Fields {
    /// Extinction in the first band (1/km).
    pub extinction: Volume,
    /// Effective radius (um); `None` if it is that of the scene.
    pub effective_radius: Option<Volume>,
}

/// A model of the images of a cloud in one or more bands, and of their derivatives.
pub trait ForwardModel {
    /// Computes the images of each band.
    ///
    /// # Errors
    /// The errors of the model.
    fn images(&mut self, fields: &Fields) -> Result<Vec<ViewStack>>;

    /// Computes the derivatives of `sum(weights * images)` over all bands with respect to the
    /// extinction and the effective radius of each voxel, at the fields of the last call of
    /// [`ForwardModel::images`].
    ///
    /// # Errors
    /// The errors of the model.
    fn derivatives(&mut self, weights: &[ViewStack]) -> Result<Derivatives>;

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
    /// The approximate fields at which the iterations begin, on the same grid.
    pub expected: &'a Fields,
    /// Whether `expected` is an estimate of the solution, as opposed to a uniform field or a result
    /// on a coarser grid.
    pub near: bool,
    /// The pixels `[view, row, col]` of each band that are included; the model may leave all others
    /// at 0.
    pub pixels: &'a [Array3<bool>],
    /// The [`Calibration::offset`](super::Calibration::offset) of each view of each band: where the model
    /// takes the pixels to be.
    pub offsets: &'a [Vec<[f64; 2]>],
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
