//! `Network`: estimation of the extinction by the neural network.

use crate::array::{Floats, IMAGES, VOLUME, booleans, check_on_grid, give};
use crate::compute::compute;
use crate::error::raise;
use crate::grid::Grid;
use crate::light::{Light, or_default};
use crate::view::ViewSequence;
use deepct_core::grid::Mask;
use deepct_core::image::ViewStack;
use deepct_core::network::{Estimator, TrainedWeights};
use deepct_core::scene::{self, Observation, View, imaging_geometry};
use deepct_core::{Error, Result, io};
use numpy::PyArray3;
use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::collections::BTreeMap;
use std::ffi::CString;
use std::path::PathBuf;
use std::sync::Arc;

/// Values of a volume, `[z, y, x]`.
type Field = Py<PyArray3<f32>>;

/// A neural network with its weights. Construct it with `Network.load`.
#[pyclass(frozen, module = "deepct_py")]
pub(crate) struct Network(Arc<Estimator>);

#[pymethods]
impl Network {
    /// Load a network from a weights file (safetensors), or a built-in network by its name.
    ///
    /// Parameters
    /// ----------
    /// name_or_path : str or path
    ///     "general" (the default) estimates clouds from the images of any formation under any Sun.
    ///     "cloudct-10" and "pearls-32" are for one formation and one Sun.
    /// force : bool
    ///     Also use general weights for a formation, Sun, pixel or voxel size outside the range of
    ///     their training.
    ///
    /// Raises
    /// ------
    /// OSError
    ///     The file cannot be read.
    /// DeepctError
    ///     The file is damaged or does not contain weights of deepct.
    #[staticmethod]
    #[pyo3(signature = (name_or_path = PathBuf::from(io::GENERAL_WEIGHTS), *, force = false))]
    fn load(py: Python<'_>, name_or_path: PathBuf, force: bool) -> PyResult<Self> {
        let weights = compute(py, move |_| io::load_trained_weights(&name_or_path))?;
        let estimator = Estimator::new(weights);
        Ok(Self(Arc::new(if force { estimator.outside_training() } else { estimator })))
    }

    /// The names of the built-in networks, which `load` accepts in place of a file.
    #[staticmethod]
    fn built_in() -> Vec<&'static str> {
        io::built_in_weights().collect()
    }

    /// The metadata of the weights file: view geometry, grid, training data and scores.
    #[getter]
    fn metadata<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let text = match self.0.weights() {
            TrainedWeights::Formation(weights) => serde_json::to_string(&weights.metadata),
            TrainedWeights::General(weights) => serde_json::to_string(&weights.metadata),
        };
        let text = text.expect("plain numbers and text");
        Ok(py.import("json")?.call_method1("loads", (text,))?.cast_into()?)
    }

    /// The grid of the extinction that `infer` returns for images with the geometry `views` if no
    /// other is requested. It has one column of voxels for each pixel and is centred horizontally
    /// on the target. For general weights, voxels are as wide as the smallest pixel at the target,
    /// and 32 levels are centred on it.
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
    ///     Scene illumination of the images; only Sun and wavelength are used. Required for general
    ///     weights; others accept one Sun only, by default that of `Light()`.
    /// mask : array of bool, [z, y, x], optional
    ///     Cloud mask, for example from `carve`. The extinction is set to zero outside the mask.
    /// grid : Grid, optional
    ///     The grid of the estimate. General weights accept any grid. Default: `grid(views)`.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray, float32, [z, y, x]
    ///     Extinction (1/km) on the grid.
    ///
    /// Raises
    /// ------
    /// ValueError
    ///     The images do not have the geometry that the network was trained for (the message
    ///     states the value that differs), or the mask has the wrong shape.
    #[pyo3(signature = (radiance, views, light = None, *, mask = None, grid = None))]
    fn infer(
        &self,
        py: Python<'_>,
        radiance: &Bound<'_, PyAny>,
        views: ViewSequence,
        light: Option<Light>,
        mask: Option<&Bound<'_, PyAny>>,
        grid: Option<Grid>,
    ) -> PyResult<Field> {
        let estimate = self.estimate(py, radiance, views, light, mask, grid)?;
        Ok(estimate.0)
    }

    /// Statistics of images, for general weights. `estimate` and `infer` warn if one of them is
    /// outside its range in the training. The parameters are those of `infer`.
    ///
    /// Returns
    /// -------
    /// dict of str to float
    ///     "background" and "brightest": the radiance below which a tenth of all pixels lies and
    ///     the largest radiance, over the cosine of the solar zenith angle (1/sr). "equal": the
    ///     largest share of the pixels of a view that have the largest radiance of the view.
    ///     "explained", or "explained_few" for at most five views: the mean over the views of the
    ///     correlation of the image with 1 - exp(-t / 8), where t is the optical depth of the
    ///     estimate along the lines of sight.
    #[pyo3(signature = (radiance, views, light = None, *, grid = None))]
    fn image_statistics(
        &self,
        py: Python<'_>,
        radiance: &Bound<'_, PyAny>,
        views: ViewSequence,
        light: Option<Light>,
        grid: Option<Grid>,
    ) -> PyResult<BTreeMap<String, f64>> {
        let radiance = Floats::new(radiance, "radiance", IMAGES)?.to_owned();
        let light = self.light(light)?;
        let network = self.inner();
        compute(py, move |_| {
            let observation = Observation::new(light, views.0, ViewStack::new(radiance)?)?;
            let geometry = observation.imaging_geometry()?;
            let grid = grid.as_ref().map(|grid| &grid.0);
            let estimate = network.estimate(&observation.images, &geometry, grid)?;
            network.image_statistics(&observation.images, &geometry, &estimate)
        })
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
    #[pyo3(signature = (radiance, views, light = None, *, mask = None, grid = None))]
    fn estimate(
        &self,
        py: Python<'_>,
        radiance: &Bound<'_, PyAny>,
        views: ViewSequence,
        light: Option<Light>,
        mask: Option<&Bound<'_, PyAny>>,
        grid: Option<Grid>,
    ) -> PyResult<(Field, Option<Field>)> {
        let radiance = Floats::new(radiance, "radiance", IMAGES)?.to_owned();
        grid.as_ref().map_or(Ok(()), |grid| check_on_grid(&grid.0, &[(mask, "mask")]))?;
        let mask = mask.map(|mask| booleans(mask, "mask", VOLUME)).transpose()?;
        let light = self.light(light)?;
        let network = self.inner();
        let (estimate, unusual) = compute(py, move |_| {
            let observation = Observation::new(light, views.0, ViewStack::new(radiance)?)?;
            let geometry = observation.imaging_geometry()?;
            let grid = grid.as_ref().map(|grid| &grid.0);
            let mut estimate = network.estimate(&observation.images, &geometry, grid)?;
            let unusual = network.unusual(&observation.images, &geometry, &estimate)?;
            if let Some(mask) = mask {
                let mask = Mask::new(estimate.extinction.grid, mask)?;
                mask.apply(&mut estimate.extinction)?;
                estimate.uncertainty.as_mut().map_or(Ok(()), |values| mask.apply(values))?;
            }
            Ok((estimate, unusual))
        })?;
        for unusual in unusual {
            let text = format!("the network was not trained on such images: {unusual}");
            let text = CString::new(text).expect("no zero byte");
            PyErr::warn(py, &py.get_type::<PyUserWarning>(), &text, 1)?;
        }
        let uncertainty = estimate.uncertainty.map(|volume| give(py, volume.values));
        Ok((give(py, estimate.extinction.values), uncertainty))
    }

    fn __repr__(&self) -> String {
        let (formation, layers) = match self.0.weights() {
            TrainedWeights::Formation(weights) => {
                (weights.metadata.formation.as_str(), weights.metadata.architecture.layers())
            }
            TrainedWeights::General(weights) => ("any", weights.metadata.architecture.layers),
        };
        format!("Network(formation=\"{formation}\", layers={layers})")
    }
}

impl Network {
    /// The given light, or the default one for weights that accept no other Sun than its.
    pub(crate) fn light(&self, light: Option<Light>) -> PyResult<scene::Light> {
        if light.is_none() && self.0.weights().formation().is_none() {
            let range = "given: general weights need the direction of the Sun";
            return Err(raise(Error::out_of_range("light", "missing", range)));
        }
        Ok(or_default(light))
    }

    /// The network of the library.
    pub(crate) fn inner(&self) -> Arc<Estimator> {
        self.0.clone()
    }

    fn grid_of(&self, views: &[View]) -> Result<deepct_core::grid::Grid> {
        let geometry = imaging_geometry(&scene::Light::default(), views)?;
        self.0.grid(&geometry, [views[0].rows, views[0].cols])
    }
}
