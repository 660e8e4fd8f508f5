//! `Network`: estimation of the extinction by the neural network.

use crate::array::{Floats, IMAGES, VOLUME, booleans, give};
use crate::error::raise;
use crate::grid::Grid;
use crate::light::{Light, or_default};
use crate::view::ViewSequence;
use deepct_core::grid::Mask;
use deepct_core::image::ViewStack;
use deepct_core::scene::{Observation, View, target};
use deepct_core::{Result, io, network};
use numpy::PyArray3;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;

/// Values of a volume, `[z, y, x]`.
type Field = Py<PyArray3<f32>>;

/// A neural network with its weights. Construct it with `Network.load`.
#[pyclass(frozen, module = "deepct_py")]
pub(crate) struct Network(network::Network);

#[pymethods]
impl Network {
    /// Load a network from a weights file (safetensors), or a built-in network by its name.
    ///
    /// Raises
    /// ------
    /// OSError
    ///     The file cannot be read.
    /// DeepctError
    ///     The file is damaged or does not contain weights of deepct.
    #[staticmethod]
    fn load(py: Python<'_>, name_or_path: PathBuf) -> PyResult<Self> {
        py.detach(|| network::Network::new(&io::load_weights(&name_or_path)?))
            .map(Self)
            .map_err(raise)
    }

    /// The names of the built-in networks, which `load` accepts in place of a file.
    #[staticmethod]
    fn built_in() -> Vec<&'static str> {
        io::built_in_weights().collect()
    }

    /// The metadata of the weights file: view geometry, grid, training data and scores.
    #[getter]
    fn metadata<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let text = serde_json::to_string(self.0.metadata()).expect("plain numbers and text");
        Ok(py.import("json")?.call_method1("loads", (text,))?.cast_into()?)
    }

    /// The grid of the extinction that `infer` returns for images with the geometry `views`. It
    /// has one column of voxels for each pixel and is centred horizontally on the target.
    fn grid(&self, views: ViewSequence) -> PyResult<Grid> {
        self.grid_of(&views.0).map(Grid).map_err(raise)
    }

    /// Estimate the extinction of a cloud from its images.
    ///
    /// Parameters
    /// ----------
    /// radiance : array, [view, row, col]
    ///     Images (1/sr).
    /// views : Views or sequence of View
    ///     The camera geometry of each image.
    /// light : Light, optional
    ///     Scene illumination of the images; only Sun and wavelength are used.
    /// mask : array of bool, [z, y, x], optional
    ///     Cloud mask, for example from `carve`. The extinction is set to zero outside the mask.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray, float32, [z, y, x]
    ///     Extinction (1/km) on `grid(views)`.
    ///
    /// Raises
    /// ------
    /// ValueError
    ///     The images do not have the geometry that the network was trained for (the message
    ///     states the value that differs), or the mask has the wrong shape.
    #[pyo3(signature = (radiance, views, light = None, *, mask = None))]
    fn infer(
        &self,
        py: Python<'_>,
        radiance: &Bound<'_, PyAny>,
        views: ViewSequence,
        light: Option<Light>,
        mask: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Field> {
        let estimate = self.estimate(py, radiance, views, light, mask)?;
        Ok(estimate.0)
    }

    /// Estimate the extinction and its uncertainty. The parameters are those of `infer`.
    ///
    /// Returns
    /// -------
    /// extinction : numpy.ndarray, float32, [z, y, x]
    ///     Extinction (1/km) on `grid(views)`.
    /// uncertainty : numpy.ndarray, float32, [z, y, x], or None
    ///     Expected absolute error of the extinction of each voxel (1/km); None if the network
    ///     does not estimate it.
    #[pyo3(signature = (radiance, views, light = None, *, mask = None))]
    fn estimate(
        &self,
        py: Python<'_>,
        radiance: &Bound<'_, PyAny>,
        views: ViewSequence,
        light: Option<Light>,
        mask: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<(Field, Option<Field>)> {
        let radiance = Floats::new(radiance, "radiance", IMAGES)?.to_owned();
        let mask = mask.map(|mask| booleans(mask, "mask", VOLUME)).transpose()?;
        let light = or_default(light);
        let estimate = py
            .detach(|| {
                let observation = Observation::new(light, views.0, ViewStack::new(radiance)?)?;
                let geometry = observation.imaging_geometry()?;
                let mut estimate = self.0.estimate(&observation.images, &geometry)?;
                if let Some(mask) = mask {
                    let mask = Mask::new(estimate.extinction.grid, mask)?;
                    mask.apply(&mut estimate.extinction)?;
                    estimate.uncertainty.as_mut().map_or(Ok(()), |values| mask.apply(values))?;
                }
                Ok(estimate)
            })
            .map_err(raise)?;
        let uncertainty = estimate.uncertainty.map(|volume| give(py, volume.values));
        Ok((give(py, estimate.extinction.values), uncertainty))
    }

    fn __repr__(&self) -> String {
        let (metadata, layers) = (self.0.metadata(), self.0.metadata().architecture.layers());
        format!("Network(formation=\"{}\", layers={layers})", metadata.formation)
    }
}

impl Network {
    /// The network of the library.
    pub(crate) fn inner(&self) -> &network::Network {
        &self.0
    }

    fn grid_of(&self, views: &[View]) -> Result<deepct_core::grid::Grid> {
        let target = target(views)?;
        self.0.grid([target.x, target.y], [views[0].rows, views[0].cols])
    }
}
