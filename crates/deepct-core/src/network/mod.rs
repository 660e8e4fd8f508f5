//! The network: layers of 3x3 convolutions that turn a stack of images, one channel
//! per view, into an extinction field, one channel per level (Sde-Chen et al. 2021).

mod architecture;
mod batch_norm;
mod metadata;
mod weights;

pub use architecture::{Architecture, channels, receptive_field};
pub use batch_norm::{BATCH_NORM_EPSILON, BatchNorm};
pub use metadata::{FORMAT_VERSION, ImageLayout, Levels, Training, WeightsMetadata};
pub use weights::{LayerWeights, Weights};

#[cfg(test)]
mod fixture;
#[cfg(test)]
pub(crate) use fixture::weights;
