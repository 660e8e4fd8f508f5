//! The network: a chain of 3x3 convolutions that computes an extinction field from a stack of
//! images, with one output channel per level (Sde-Chen et al. 2021).
//!
//! The images are either used as the cameras recorded them, one channel per view, or the network
//! first resamples them onto horizontal planes, so that one pixel of every channel corresponds to
//! one column of voxels ([`ImageLayout`]).

mod architecture;
mod batch_norm;
mod estimate;
mod estimator;
mod general;
mod inference;
mod layout;
mod metadata;
mod resample;
mod surface;
mod unusual;
mod weights;

pub use architecture::{Architecture, channels, receptive_field};
pub use batch_norm::{BATCH_NORM_EPSILON, BatchNorm};
pub use estimate::Estimate;
pub use estimator::{Estimator, TrainedWeights};
pub use general::{
    GeneralArchitecture, GeneralLevels, GeneralMetadata, GeneralWeights, Linear, Perceptron, Ranges,
};
pub use inference::{BandImages, Network, Scratch};
pub use layout::{ImageLayout, Planes};
pub use metadata::{FORMAT_VERSION, Levels, NetworkOutput, Training, WeightsMetadata};
pub use unusual::Unusual;
pub use weights::{LayerWeights, Weights};

#[cfg(test)]
mod fixture;
#[cfg(test)]
pub(crate) use fixture::weights;
