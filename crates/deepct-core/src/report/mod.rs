//! Reports: HTML pages that contain everything they show.
//!
//! A page has tables, pictures and an interactive view of volumes in 3D and in slices (`viewer.js`).
//! It refers to no other file and to no network.

mod contents;
mod exhibit;
mod folder;
mod markdown;
mod page;

pub use contents::{MAX_VOXELS, drawing_report, file_report};
pub use folder::folder_report;
pub use page::Report;
