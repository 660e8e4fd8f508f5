//! `Network`: from images to extinction.

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

/// A network with its weights, ready to run. Made by `Network.load`.
#[pyclass(frozen, module = "deepct_py")]
pub(crate) struct Network(network::Network);

#[pymethods]
impl Network {
    /// A network from a weights file (safetensors), or from the module itself by name.
    ///
    /// Raises
    /// ------
    /// OSError
    ///     A file that cannot be read.
    /// DeepctError
    ///     A file that is damaged, or holds no weights of this program.
    #[staticmethod]
    fn load(py: Python<'_>, name_or_path: PathBuf) -> PyResult<Self> {
        py.detach(|| network::Network::new(&io::load_weights(&name_or_path)?))
            .map(Self)
            .map_err(raise)
    }

    /// The names that `load` takes instead of a file.
    #[staticmethod]
    fn built_in() -> Vec<&'static str> {
        io::built_in_weights().collect()
    }

    /// What the weights are for and where they come from, as the file says.
    #[getter]
    fn metadata<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let text = serde_json::to_string(self.0.metadata()).expect("plain numbers and text");
        Ok(py.import("json")?.call_method1("loads", (text,))?.cast_into()?)
    }

    /// The grid of the extinction that `infer` gives for images by `views`: one column of
    /// voxels for each pixel, around the point that the images show in their middle.
    fn grid(&self, views: ViewSequence) -> PyResult<Grid> {
        self.grid_of(&views.0).map(Grid).map_err(raise)
    }

    /// Infer the extinction of a cloud from its images.
    ///
    /// Parameters
    /// ----------
    /// radiance : array, [view, row, col]
    ///     Images (1/sr).
    /// views : Views or sequence of View
    ///     How they were taken.
    /// light : Light, optional
    ///     The light that they were taken in; Sun and wavelength count.
    /// mask : array of bool, [z, y, x], optional
    ///     Extinction is set to zero outside, such as outside what `carve` keeps.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray, float32, [z, y, x]
    ///     Extinction (1/km) on `grid(views)`.
    ///
    /// Raises
    /// ------
    /// ValueError
    ///     Images that are not what the weights are for, with the number that differs; a
    ///     mask of another shape.
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

    /// As `infer`, with the uncertainty.
    ///
    /// Returns
    /// -------
    /// extinction : numpy.ndarray, float32, [z, y, x]
    ///     Extinction (1/km) on `grid(views)`.
    /// uncertainty : numpy.ndarray, float32, [z, y, x], or None
    ///     Expected absolute error of the extinction of each voxel (1/km), where the weights
    ///     tell it.
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
