//! `Network`: estimation of the extinction by the neural network.

use crate::compute::quickly;
use crate::error::raise;
use crate::estimate::Estimate;
use crate::field;
use crate::grid::Grid;
use crate::light::{Light, warn};
use crate::lineage::Lineage;
use crate::observation::{Given, first_band, observation, observations};
use crate::record::{Record, record};
use crate::view::ViewSequence;
use deepct_core::grid::Mask;
use deepct_core::inversion::network_estimate;
use deepct_core::network::{Estimator, TrainedWeights};
use deepct_core::scene::{self, Observation, View, imaging_geometry};
use deepct_core::{Error, io};
use numpy::PyArray3;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A neural network with its weights. Construct it with `Network.load`.
///
/// Examples
/// --------
/// >>> network = deepct_py.Network.load("cloudct-10")
/// >>> network.metadata["formation"]
/// 'cloudct-10'
#[pyclass(frozen, module = "deepct_py")]
pub(crate) struct Network {
    estimator: Arc<Estimator>,
    source: Source,
    force: bool,
}

/// What the weights of a network can be read from again.
#[derive(Clone)]
enum Source {
    /// The name of built-in weights.
    BuiltIn(String),
    /// The contents of a file.
    Bytes(Vec<u8>),
}

record!(Network);

impl Record for Network {
    fn arguments<'py>(of: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        let arguments = PyDict::new(of.py());
        match &of.get().source {
            Source::BuiltIn(name) => arguments.set_item("weights", name)?,
            Source::Bytes(bytes) => {
                arguments.set_item("weights", PyBytes::new(of.py(), bytes))?;
            }
        }
        arguments.set_item("force", of.get().force)?;
        Ok(arguments)
    }
}

/// The first row or column of a range, and the one after the last.
type Ends = (usize, usize);

/// Rows, columns, grid and pixels of a tile.
type TileParts = (Ends, Ends, Grid, Option<(Ends, Ends)>);

impl Network {
    fn of(weights: TrainedWeights, source: Source, force: bool) -> Self {
        let estimator = Estimator::new(weights);
        let estimator = if force { estimator.outside_training() } else { estimator };
        Self { estimator: Arc::new(estimator), source, force }
    }
}

#[pymethods]
impl Network {
    /// A network from the name or path that `load` accepts, or from the contents of a weights file.
    #[new]
    #[pyo3(
        signature = (weights = Weights::Name(io::GENERAL_WEIGHTS.into()), *, force = false),
        text_signature = "(weights='general', *, force=False)",
    )]
    fn new(py: Python<'_>, weights: Weights, force: bool) -> PyResult<Self> {
        match weights {
            Weights::Name(name) => Self::load(py, name, force),
            Weights::Contents(bytes) => {
                let parse = || io::parse_trained_weights(&bytes, Path::new("weights"));
                let weights = quickly(py, parse)?;
                Ok(Self::of(weights, Source::Bytes(bytes), force))
            }
        }
    }

    /// The contents of the weights file (safetensors), from which `Network` makes the network again.
    #[getter]
    fn contents<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        let bytes = match &self.source {
            Source::BuiltIn(name) => {
                io::built_in_contents(name).expect("a name of built-in weights")
            }
            Source::Bytes(bytes) => bytes,
        };
        PyBytes::new(py, bytes)
    }

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
    #[pyo3(
        signature = (name_or_path = PathBuf::from(io::GENERAL_WEIGHTS), *, force = false),
        text_signature = "(name_or_path='general', *, force=False)",
    )]
    pub(crate) fn load(py: Python<'_>, name_or_path: PathBuf, force: bool) -> PyResult<Self> {
        let name = name_or_path.to_string_lossy().into_owned();
        let is_built_in = io::built_in_weights().any(|known| known == name);
        let (weights, source) = quickly(py, || {
            let weights = io::load_trained_weights(&name_or_path)?;
            Ok((
                weights,
                match is_built_in {
                    true => Source::BuiltIn(name),
                    false => Source::Bytes(
                        std::fs::read(&name_or_path).map_err(Error::io(&name_or_path))?,
                    ),
                },
            ))
        })?;
        Ok(Self::of(weights, source, force))
    }

    /// The names of the built-in networks, which `load` accepts in place of a file.
    #[staticmethod]
    fn built_in() -> Vec<&'static str> {
        io::built_in_weights().collect()
    }

    /// The metadata of the weights file: view geometry, grid, training data and scores.
    #[getter]
    fn metadata<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let text = match self.estimator.weights() {
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

    /// Division of a grid into tiles that can be estimated by themselves.
    ///
    /// Parameters
    /// ----------
    /// views : Views or sequence of View
    ///     The views of the whole images.
    /// grid : Grid, object or path
    ///     Grid of the whole estimate.
    /// side : int
    ///     Largest number of rows and columns of a tile.
    ///
    /// Returns
    /// -------
    /// list of (rows, cols, around, pixels)
    ///     For each tile: its rows and columns, each as (first, end); the grid of the tile and of the
    ///     columns around it that the network reads; and the rows and columns of the images that show this
    ///     grid, or None.
    fn tiles(&self, views: ViewSequence, grid: Grid, side: usize) -> PyResult<Vec<TileParts>> {
        let halo = self.estimator.halo(&grid.0);
        let tiles = scene::Tile::all(&views.0, &grid.0, side, halo).map_err(raise)?;
        let ends = |range: &Range<usize>| (range.start, range.end);
        let parts = |tile: scene::Tile| {
            let pixels = tile.pixels.as_ref().map(|[rows, cols]| (ends(rows), ends(cols)));
            (ends(&tile.rows), ends(&tile.cols), Grid(tile.around), pixels)
        };
        Ok(tiles.into_iter().map(parts).collect())
    }

    /// Estimate the extinction of a cloud from its images.
    ///
    /// Parameters
    /// ----------
    /// radiance : Observation, array [view, row, col], str or path, or list of Observation
    ///     Images (1/sr). Weights for several bands need a list with the images of each band, in the order
    ///     of `metadata["wavelength_um"]`, or a file with a dimension wavelength.
    /// views : Views or sequence of View, optional
    ///     The camera geometry of each image, unless the images are an observation.
    /// light : Light, optional
    ///     Scene illumination of the images, unless they are an observation; only Sun and wavelength
    ///     are used. Required for general weights; others accept one Sun only, by default that of
    ///     `Light()`.
    /// mask : array of bool [z, y, x], Carved, str or path, optional
    ///     Cloud mask, for example from `carve`. The extinction is set to zero outside the mask.
    /// grid : Grid, object or path, optional
    ///     The grid of the estimate: a `Grid`, an object or a file that has one. General weights accept
    ///     any grid. Default: `grid(views)`.
    ///
    /// Returns
    /// -------
    /// Estimate
    ///     The extinction and, if the network estimates them, its uncertainty and the effective radius.
    ///
    /// Raises
    /// ------
    /// ValueError
    ///     The images do not have the geometry that the network was trained for (the message
    ///     states the value that differs), or the mask has the wrong shape.
    ///
    /// Examples
    /// --------
    /// >>> cloud = deepct_py.generate_cloud(seed=3, width_km=0.4)
    /// >>> images = deepct_py.render(cloud, views="cloudct-10", solver="ordinates")
    /// >>> estimate = deepct_py.Network.load("cloudct-10").estimate(images)
    /// >>> estimate.extinction.shape == estimate.grid.shape
    /// True
    #[pyo3(signature = (radiance, views = None, light = None, *, mask = None, grid = None))]
    fn estimate(
        &self,
        radiance: &Bound<'_, PyAny>,
        views: Option<ViewSequence>,
        light: Option<Light>,
        mask: Option<&Bound<'_, PyAny>>,
        grid: Option<Grid>,
    ) -> PyResult<Estimate> {
        let py = radiance.py();
        let bands = self.observations(radiance, views, light)?;
        let masked = mask.map(|values| field::mask(values, "mask")).transpose()?;
        let (mut estimate, unusual) = quickly(py, || {
            let grid = grid.as_ref().map(|grid| &grid.0);
            let estimate = network_estimate(&self.estimator, &bands, grid)?;
            let mut unusual = Vec::new();
            for band in &bands {
                let ideal = band.on_ideal_cameras()?;
                let geometry = ideal.imaging_geometry()?;
                unusual.extend(self.estimator.unusual(&ideal.images, &geometry, &estimate)?);
            }
            Ok((estimate, unusual))
        })?;
        if let Some(masked) = masked {
            let grid = estimate.extinction.grid;
            let mask = Mask::new(grid, masked.on(grid)?).map_err(raise)?;
            estimate.apply(&mask).map_err(raise)?;
        }
        for unusual in unusual {
            warn(py, &format!("the network was not trained on such images: {unusual}"))?;
        }
        let Some(Observation { light, assumed, .. }) = bands.into_iter().next() else {
            return Err(raise(Error::out_of_range("number of bands", 0, "at least 1")));
        };
        let light = Light { core: light, assumed };
        let lineage = Lineage::after(&first_band(radiance)?, "infer")?;
        Ok(Estimate::give(py, estimate, Some(light), lineage))
    }

    /// The extinction of `estimate`, with the same parameters.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray, float32, [z, y, x]
    ///     Extinction (1/km) on the grid.
    #[pyo3(signature = (radiance, views = None, light = None, *, mask = None, grid = None))]
    fn infer(
        &self,
        radiance: &Bound<'_, PyAny>,
        views: Option<ViewSequence>,
        light: Option<Light>,
        mask: Option<&Bound<'_, PyAny>>,
        grid: Option<Grid>,
    ) -> PyResult<Py<PyArray3<f32>>> {
        Ok(self.estimate(radiance, views, light, mask, grid)?.into_extinction())
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
    #[pyo3(signature = (radiance, views = None, light = None, *, grid = None))]
    fn image_statistics(
        &self,
        radiance: &Bound<'_, PyAny>,
        views: Option<ViewSequence>,
        light: Option<Light>,
        grid: Option<Grid>,
    ) -> PyResult<BTreeMap<String, f64>> {
        let given = Given { views, light, standard_error: None, saturated: None };
        let observation = observation(radiance, given, |_| self.default_light())?;
        quickly(radiance.py(), || {
            let one = std::slice::from_ref(&observation);
            let estimate =
                network_estimate(&self.estimator, one, grid.as_ref().map(|grid| &grid.0))?;
            let ideal = observation.on_ideal_cameras()?;
            self.estimator.image_statistics(&ideal.images, &ideal.imaging_geometry()?, &estimate)
        })
    }
}

/// A network as an argument: itself, or the name or file of its weights.
#[derive(FromPyObject)]
pub(crate) enum NetworkChoice<'py> {
    Network(Bound<'py, Network>),
    Name(PathBuf),
}

impl<'py> NetworkChoice<'py> {
    pub(crate) fn network(self, py: Python<'py>) -> PyResult<Bound<'py, Network>> {
        match self {
            Self::Network(network) => Ok(network),
            Self::Name(name) => Bound::new(py, Network::load(py, name, false)?),
        }
    }
}

/// What weights are read from.
#[derive(FromPyObject)]
enum Weights {
    Name(PathBuf),
    Contents(Vec<u8>),
}

impl Network {
    /// The light of an argument that is not given: the default one for weights that accept no other
    /// Sun than its.
    pub(crate) fn default_light(&self) -> PyResult<Light> {
        if self.estimator.weights().formation().is_none() {
            let range = "given: general weights need the direction of the Sun";
            return Err(raise(Error::out_of_range("light", "missing", range)));
        }
        Ok(scene::Light::default().into())
    }

    /// The network of the library.
    pub(crate) fn inner(&self) -> Arc<Estimator> {
        self.estimator.clone()
    }

    /// The images of each band of an argument, for this network.
    fn observations(
        &self,
        radiance: &Bound<'_, PyAny>,
        views: Option<ViewSequence>,
        light: Option<Light>,
    ) -> PyResult<Vec<Observation>> {
        let given = Given { views, light, standard_error: None, saturated: None };
        observations(radiance, given, |_| self.default_light())
    }

    fn grid_of(&self, views: &[View]) -> deepct_core::Result<deepct_core::grid::Grid> {
        let geometry = imaging_geometry(&scene::Light::default(), views)?;
        self.estimator.grid(&geometry, [views[0].rows, views[0].cols])
    }
}
