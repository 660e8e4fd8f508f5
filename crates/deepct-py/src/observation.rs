//! `Observation`: images with their views and scene illumination, and images as arguments.

use crate::array::{check_pixels, copied, give, images, images_in_any_unit, marks};
use crate::error::raise;
use crate::exchange::{dataset, is_dataset, provenance, through_file, warn_of_incomplete, write};
use crate::light::Light;
use crate::lineage::Lineage;
use crate::record::{Record, attributes, record};
use crate::view::{ViewSequence, Views};
use deepct_core::image::ViewStack;
use deepct_core::{io, scene};
use numpy::PyArray3;
use numpy::ndarray::Array3;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::{Path, PathBuf};

/// Images of a scene with their cameras and scene illumination: the contents of a file of images.
///
/// All functions that take images accept an observation in place of the array, and then need no
/// further arguments about them.
///
/// Parameters
/// ----------
/// radiance : array [view, row, col], or list of arrays [row, col]
///     Images (1/sr, or the unit of the solar irradiance of the light per steradian). Pixels that are NaN,
///     masked or of an infinite standard error are missing. Images of different sizes become the middle
///     of images of one size, whose other pixels are missing.
/// views : Views or sequence of View
///     The camera of each image.
/// light : Light, optional
///     Scene illumination. Default: `Light()`.
/// standard_error : array, [view, row, col], optional
///     Standard error of each pixel (1/sr); infinite for pixels that are to be left out.
/// saturated : array of bool, [view, row, col], optional
///     The pixels that are saturated: they are at least as bright as their radiance.
/// lineage : Lineage, optional
///     Their time and history. Default: unknown.
///
/// Raises
/// ------
/// ValueError
///     The images do not match the views, or a radiance is not that of sunlight.
///
/// Examples
/// --------
/// >>> views = deepct_py.Views.load("cloudct-10", target=(0.8, 0.8, 1.12))
/// >>> images = deepct_py.Observation(np.full((10, 32, 32), 0.02), views)
/// >>> images.light.wavelength
/// 0.672
#[pyclass(frozen, subclass, module = "deepct_py")]
pub(crate) struct Observation {
    /// Images (1/sr), NaN for missing pixels: numpy.ndarray, float32, [view, row, col].
    #[pyo3(get)]
    radiance: Py<PyArray3<f32>>,
    /// The camera of each image.
    #[pyo3(get)]
    views: Views,
    /// Scene illumination of the images.
    #[pyo3(get)]
    light: Light,
    /// Standard error of each pixel (1/sr), infinite for missing pixels: numpy.ndarray, float32, [view,
    /// row, col]; None if it is unknown.
    #[pyo3(get)]
    standard_error: Option<Py<PyArray3<f32>>>,
    /// The pixels that are saturated: numpy.ndarray, bool, [view, row, col]; None if no pixel is known
    /// to be.
    #[pyo3(get)]
    saturated: Option<Py<PyArray3<bool>>>,
    /// Their time and history.
    #[pyo3(get)]
    lineage: Lineage,
}

record!(Observation);

/// The attributes that are the arguments of the constructor.
pub(crate) const PARTS: [&str; 6] =
    ["radiance", "views", "light", "standard_error", "saturated", "lineage"];

impl Record for Observation {
    fn arguments<'py>(of: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        attributes(of.as_any(), &PARTS)
    }
}

#[pymethods]
impl Observation {
    #[new]
    #[pyo3(signature = (
        radiance, views, light = None, *, standard_error = None, saturated = None, lineage = None,
    ))]
    pub(crate) fn new(
        radiance: &Bound<'_, PyAny>,
        views: ViewSequence,
        light: Option<Light>,
        standard_error: Option<Bound<'_, PyAny>>,
        saturated: Option<Bound<'_, PyAny>>,
        lineage: Option<Lineage>,
    ) -> PyResult<Self> {
        let given = Given { views: Some(views), light, standard_error, saturated };
        let observed = observation(radiance, given, |_| Ok(Light::from(scene::Light::default())))?;
        Ok(Self::give(radiance.py(), observed, lineage.unwrap_or_default()))
    }

    /// The images in a data set of xarray with the variables of a file of images.
    ///
    /// Raises
    /// ------
    /// DeepctError
    ///     The data set lacks a variable, or a variable is invalid; the message names it.
    #[staticmethod]
    fn from_dataset(dataset: &Bound<'_, PyAny>) -> PyResult<Self> {
        through_file(dataset, "", |path| Self::read(dataset.py(), path))
    }

    /// A copy in which some of `radiance`, `views`, `light`, `standard_error`, `saturated` and `lineage`
    /// are replaced.
    #[pyo3(signature = (**parts), text_signature = "($self, **parts)")]
    fn replace<'py>(
        slf: &Bound<'py, Self>,
        parts: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let arguments = attributes(slf.as_any(), &PARTS)?;
        for (name, part) in parts.into_iter().flatten() {
            arguments.set_item(name, part)?;
        }
        slf.py().get_type::<Self>().call((), Some(&arguments))
    }

    /// Write a netCDF file that all commands and `read_images` read. A file that deepct did not write is
    /// replaced only with `overwrite`.
    #[pyo3(signature = (path, *, title = "Images of a cloud", overwrite = false))]
    fn to_netcdf(
        &self,
        py: Python<'_>,
        path: PathBuf,
        title: &str,
        overwrite: bool,
    ) -> PyResult<()> {
        let observed = self.core(py)?;
        let provenance = provenance(title, &self.lineage);
        write(py, &path, overwrite, |path| io::write_observation(path, &observed, &provenance))
    }

    /// The images as a data set of xarray, with the variables of a file of images.
    fn to_xarray<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        dataset(py, |path| self.to_netcdf(py, path.into(), "Images of a cloud", false))
    }
}

impl Observation {
    /// The observation of the library as an object of Python.
    pub(crate) fn give(py: Python<'_>, observed: scene::Observation, lineage: Lineage) -> Self {
        let light = Light { core: observed.light, assumed: observed.assumed };
        Self {
            radiance: give(py, observed.images.values),
            views: Views(observed.views),
            light,
            standard_error: observed.standard_error.map(|errors| give(py, errors.values)),
            saturated: observed.saturated.map(|marks| give(py, marks)),
            lineage,
        }
    }

    fn read(py: Python<'_>, path: &Path) -> PyResult<Self> {
        Ok(Self::give(py, read(py, path)?, Lineage(io::read_lineage(path))))
    }

    /// The observation of the library.
    fn core(&self, py: Python<'_>) -> PyResult<scene::Observation> {
        let errors = self.standard_error.as_ref().map(|errors| copied(py, errors)).transpose()?;
        let marks = self.saturated.as_ref().map(|marks| copied(py, marks)).transpose()?;
        let radiance = copied(py, &self.radiance)?;
        assembled(radiance, self.views.0.clone(), self.light.clone(), errors, marks).map_err(raise)
    }
}

/// Read images from a netCDF file, with their cameras, scene illumination, standard errors and
/// saturated pixels.
///
/// Raises
/// ------
/// OSError
///     The file cannot be read.
/// DeepctError
///     The contents of the file are invalid; the message names the variable.
#[pyfunction]
pub(crate) fn read_images(py: Python<'_>, path: PathBuf) -> PyResult<Observation> {
    Observation::read(py, &path)
}

fn read(py: Python<'_>, path: &Path) -> PyResult<scene::Observation> {
    warn_of_incomplete(py, path)?;
    py.detach(|| io::read_observation(path)).map_err(raise)
}

/// The views of the images in a data set.
pub(crate) fn views_of(dataset: &Bound<'_, PyAny>) -> PyResult<Views> {
    Ok(Views(through_file(dataset, "", |path| read(dataset.py(), path))?.views))
}

/// What a call states about its images, which an observation states itself.
pub(crate) struct Given<'py> {
    pub(crate) views: Option<ViewSequence>,
    pub(crate) light: Option<Light>,
    pub(crate) standard_error: Option<Bound<'py, PyAny>>,
    pub(crate) saturated: Option<Bound<'py, PyAny>>,
}

impl Given<'_> {
    /// Returns an error if something is given that belongs to the images of each band.
    fn belongs_to_no_band(&self) -> PyResult<()> {
        let Self { views, light, standard_error, saturated } = self;
        let parts = standard_error.is_some() || saturated.is_some();
        if views.is_none() && light.is_none() && !parts {
            return Ok(());
        }
        Err(PyValueError::new_err(
            "views, light, standard_error and saturated belong to the images of each band: omit the \
             arguments",
        ))
    }
}

/// Whether an argument is that of images with all that belongs to them: an `Observation`, a data set of
/// xarray or the name of a file.
pub(crate) fn is_complete(radiance: &Bound<'_, PyAny>) -> PyResult<bool> {
    let is_own = radiance.cast::<Observation>().is_ok() || radiance.extract::<PathBuf>().is_ok();
    Ok(is_own || is_dataset(radiance)?)
}

/// The observation that a function takes as its first argument: complete images ([`is_complete`]), or an
/// array with further arguments about it, of which `default_light` is required if no light is
/// given.
///
/// # Errors
/// `ValueError` if something is stated twice, or if the views are missing.
pub(crate) fn observation(
    radiance: &Bound<'_, PyAny>,
    given: Given<'_>,
    default_light: impl FnOnce(&ViewStack) -> PyResult<Light>,
) -> PyResult<scene::Observation> {
    let py = radiance.py();
    if is_complete(radiance)? {
        let twice = [
            ("views", given.views.is_some()),
            ("light", given.light.is_some()),
            ("standard_error", given.standard_error.is_some()),
            ("saturated", given.saturated.is_some()),
        ];
        if let Some((name, _)) = twice.into_iter().find(|(_, is_given)| *is_given) {
            return Err(PyValueError::new_err(format!(
                "{name} belongs to the images: omit the argument, or use images.replace({name}=...)"
            )));
        }
        if let Ok(own) = radiance.cast::<Observation>() {
            return own.get().core(py);
        }
        return match radiance.extract::<PathBuf>() {
            Ok(path) => read(py, &path),
            Err(_) => through_file(radiance, "radiance", |path| read(py, path)),
        };
    }
    check_pixels(radiance, given.standard_error.as_ref(), "standard_error")?;
    check_pixels(radiance, given.saturated.as_ref(), "saturated")?;
    let is_relative = given.light.as_ref().is_none_or(|light| light.core.sun.irradiance == 1.0);
    let values = if is_relative { images } else { images_in_any_unit };
    let stack = ViewStack::with_missing(values(radiance, "radiance")?).map_err(raise)?;
    let views = given.views.ok_or_else(|| {
        PyTypeError::new_err("views is missing: give the camera of each image, or an Observation")
    })?;
    let light = given.light.map_or_else(|| default_light(&stack), Ok)?;
    let errors =
        given.standard_error.map(|errors| values(&errors, "standard_error")).transpose()?;
    let marks = given.saturated.map(|pixels| marks(&pixels, "saturated")).transpose()?;
    assembled(stack.values, views.0, light, errors, marks).map_err(raise)
}

/// The observations that a function takes as its first argument: those of a list or tuple of
/// `Observation`, or a single one as in [`observation`].
///
/// # Errors
/// As [`observation`].
pub(crate) fn observations(
    radiance: &Bound<'_, PyAny>,
    given: Given<'_>,
    default_light: impl FnOnce(&ViewStack) -> PyResult<Light>,
) -> PyResult<Vec<scene::Observation>> {
    match radiance.extract::<Vec<Bound<'_, Observation>>>() {
        Ok(bands) if !bands.is_empty() => {
            given.belongs_to_no_band()?;
            bands.iter().map(|band| band.get().core(radiance.py())).collect()
        }
        _ => match several_bands(radiance)? {
            Some(bands) => {
                given.belongs_to_no_band()?;
                Ok(bands)
            }
            None => Ok(vec![observation(radiance, given, default_light)?]),
        },
    }
}

/// The images of the first band, where there are several.
pub(crate) fn first_band<'py>(radiance: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    match radiance.extract::<Vec<Bound<'py, Observation>>>() {
        Ok(bands) if !bands.is_empty() => Ok(bands[0].clone().into_any()),
        _ => Ok(radiance.clone()),
    }
}

/// The images of a file with several bands.
fn several_bands(radiance: &Bound<'_, PyAny>) -> PyResult<Option<Vec<scene::Observation>>> {
    let Ok(path) = radiance.extract::<PathBuf>() else { return Ok(None) };
    let bands = io::read_observations(path).map_err(raise)?;
    Ok((bands.len() > 1).then_some(bands))
}

fn assembled(
    radiance: Array3<f32>,
    views: Vec<scene::View>,
    light: Light,
    standard_error: Option<Array3<f32>>,
    saturated: Option<Array3<bool>>,
) -> deepct_core::Result<scene::Observation> {
    let images = ViewStack::with_missing(radiance)?;
    let mut observed = scene::Observation::new(light.core, views, images)?;
    observed.assumed = light.assumed;
    if let Some(errors) = standard_error {
        observed = observed.with_standard_error(errors)?;
    }
    match saturated {
        None => Ok(observed),
        Some(marks) => observed.with_saturated(marks),
    }
}
