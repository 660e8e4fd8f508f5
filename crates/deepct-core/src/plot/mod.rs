//! Pictures for people: PNG figures of volumes, scores and images.
//!
//! Arrays grow to the north and to the east; a figure is turned north up as it is
//! drawn, and nowhere else. Lengths are in km, extinction in 1/km, radiance in 1/sr.
//! Colours are perceptually uniform: viridis for extinction, inferno for optical
//! depth, greys for radiance.

mod boxes;
mod page;
mod panel;
mod scatter;
mod shade;
mod sheet;
mod volume;

pub use boxes::{BoxGroup, box_figure};
pub use scatter::scatter_figure;
pub use sheet::contact_sheet;
pub use volume::volume_figure;
