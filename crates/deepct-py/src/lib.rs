//! The Python module of deepct: the stages of the library as functions on NumPy arrays.
//!
//! The functions contain no physics. Each converts its arguments, releases the global interpreter
//! lock, calls the library function of the same name and returns the resulting arrays without a
//! copy. The doc comments are the docstrings that `help()` shows; the type annotations are in
//! `python/deepct_py/__init__.pyi`.

mod array;
mod carve;
mod cloud;
mod compute;
mod error;
mod estimate;
mod exchange;
mod field;
mod grid;
mod invert;
mod light;
mod lineage;
mod network;
mod number;
mod observation;
mod page;
mod plot;
mod record;
mod render;
mod renderer;
mod score;
mod sense;
mod view;

use pyo3::prelude::*;

/// The module that `python/deepct_py/__init__.py` re-exports.
#[pymodule]
mod _deepct {
    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }

    #[pymodule_export]
    use crate::carve::{Carved, carve, read_mask};
    #[pymodule_export]
    use crate::cloud::{Cloud, generate_cloud, import_cloud, read_cloud};
    #[pymodule_export]
    use crate::compute::set_threads;
    #[pymodule_export]
    use crate::error::DeepctError;
    #[pymodule_export]
    use crate::estimate::{Estimate, read_volume};
    #[pymodule_export]
    use crate::grid::{Grid, grid_from};
    #[pymodule_export]
    use crate::invert::{Reconstruction, hybrid, invert};
    #[pymodule_export]
    use crate::light::Light;
    #[pymodule_export]
    use crate::lineage::Lineage;
    #[pymodule_export]
    use crate::network::Network;
    #[pymodule_export]
    use crate::observation::{Observation, read_images};
    #[pymodule_export]
    use crate::page::{Page, view};
    #[pymodule_export]
    use crate::plot::{Figure, plot};
    #[pymodule_export]
    use crate::render::{Rendering, render};
    #[pymodule_export]
    use crate::renderer::{Renderer, side_by_side};
    #[pymodule_export]
    use crate::score::{Scores, score};
    #[pymodule_export]
    use crate::sense::{Exposure, Sensed, Sensor, sense};
    #[pymodule_export]
    use crate::view::{View, Views, camera_from_ecef};
}
