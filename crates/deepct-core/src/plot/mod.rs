//! PNG figures of volumes, scores and images.
//!
//! Array indices increase northwards and eastwards; figures are flipped so that north is up only
//! when they are drawn. Lengths are in km, extinction in 1/km, radiance in 1/sr. The colour maps
//! are perceptually uniform: viridis for extinction, inferno for optical depth, magma for
//! uncertainty, blue to red for differences, greys for radiance and masks.

mod boxes;
mod page;
mod panel;
mod photograph;
mod scatter;
mod shade;
mod sheet;
mod volume;

pub use boxes::{BoxGroup, box_figure};
pub use photograph::photograph_figure;
pub use scatter::scatter_figure;
pub use sheet::contact_sheet;
pub use volume::{VolumeFields, volume_figure};
