//! PNG figures of volumes, scores and images.
//!
//! Array indices increase northwards and eastwards; figures are flipped so that north is up only
//! when they are drawn. Lengths are in km, extinction in 1/km, radiance in 1/sr. The colour maps
//! are perceptually uniform: viridis for extinction, inferno for optical depth, greys for radiance.

mod boxes;
mod page;
mod panel;
mod scatter;
mod shade;
mod sheet;
mod volume;

pub use boxes::{BoxGroup, box_figure};
pub use scatter::scatter_figure;
pub use sheet::{contact_sheet, view_labels};
pub use volume::volume_figure;
