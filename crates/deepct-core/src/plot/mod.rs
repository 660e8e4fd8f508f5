//! Figures of volumes, scores and images, which are written as PNG, SVG or PDF.
//!
//! Array indices increase northwards and eastwards; figures are flipped so that north is up only
//! when they are drawn. Lengths are in km, extinction in 1/km, radiance in 1/sr. The colour maps
//! are perceptually uniform: viridis for extinction, inferno for optical depth, magma for
//! uncertainty, blue to red for differences, greys for radiance and masks.

mod boxes;
mod figure;
mod panel;
mod pdf;
mod photograph;
mod raster;
mod scatter;
mod shade;
mod sheet;
mod svg;
mod volume;

pub use boxes::{BoxGroup, box_figure};
pub use figure::{Figure, Format};
pub use photograph::photograph_figure;
pub use scatter::scatter_figure;
pub use sheet::contact_sheet;
pub use volume::{VolumeFields, volume_figure};
