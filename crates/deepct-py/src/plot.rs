//! `plot`: figures of volumes and of images.

use crate::error::raise;
use crate::exchange::{check_origin, is_dataset};
use crate::field;
use crate::grid::Grid;
use crate::light::Light;
use crate::observation::{Given, Observation, observation};
use crate::record::{Record, record};
use deepct_core::grid::Volume;
use deepct_core::io::{Drawing, Field};
use deepct_core::network::Estimate;
use deepct_core::plot::{VolumeFields, contact_sheet, volume_figure};
use deepct_core::{Error, io, scene};
use pyo3::exceptions::{PyOSError, PyTypeError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use std::path::{Path, PathBuf};

/// A picture, which notebooks show.
///
/// Parameters
/// ----------
/// png : bytes
///     The contents of a PNG file.
#[pyclass(frozen, module = "deepct_py")]
pub(crate) struct Figure(Vec<u8>);

record!(@picture Figure);

impl Record for Figure {
    fn arguments<'py>(of: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        let arguments = PyDict::new(of.py());
        arguments.set_item("png", of.get().png(of.py()))?;
        Ok(arguments)
    }
}

#[pymethods]
impl Figure {
    #[new]
    fn new(png: Vec<u8>) -> Self {
        Self(png)
    }

    /// The contents of a PNG file.
    #[getter]
    fn png<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &self.0)
    }

    /// Write a PNG file. A file of another format is replaced only with `overwrite`.
    #[pyo3(signature = (path, *, overwrite = false))]
    fn save(&self, path: PathBuf, overwrite: bool) -> PyResult<()> {
        check_name(&path)?;
        check_origin(&path, overwrite)?;
        deepct_core::files::write(&path, &self.0).map_err(raise)
    }

    fn _repr_png_<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        self.png(py)
    }
}

/// Draw a volume, alone or with the truth, or a sheet of images: the figure of `deepct plot`. The
/// uncertainty of an estimate, and the mask in a file, are drawn too.
///
/// Parameters
/// ----------
/// what : Cloud, Estimate, Reconstruction, Observation, array, str or path
///     A volume or images, or a file of either. An array is an extinction (1/km), [z, y, x].
/// truth : Cloud, array, str or path, optional
///     The true cloud, which is drawn beside the volume and in a scatter plot against it. The extinction
///     of a cloud that is given by its droplets is the one in the light of the volume, if it is known.
/// grid : Grid, object or path, optional
///     The grid of an array.
/// title : str, optional
///     Title of the figure. Default: the name of the file.
/// out : str or path, optional
///     PNG file to write.
/// overwrite : bool
///     Replace a file of another format.
///
/// Returns
/// -------
/// Figure
///     The picture, which notebooks show; `save` writes it to a file.
///
/// Examples
/// --------
/// >>> cloud = deepct_py.generate_cloud(seed=3, width_km=0.4)
/// >>> figure = deepct_py.plot(cloud, title="Cloud 3")
/// >>> figure.png[1:4]
/// b'PNG'
#[pyfunction]
#[pyo3(signature = (what, truth = None, *, grid = None, title = None, out = None, overwrite = false))]
pub(crate) fn plot(
    what: &Bound<'_, PyAny>,
    truth: Option<&Bound<'_, PyAny>>,
    grid: Option<Grid>,
    title: Option<String>,
    out: Option<PathBuf>,
    overwrite: bool,
) -> PyResult<Figure> {
    let py = what.py();
    if let Some(out) = &out {
        check_name(out)?;
        check_origin(out, overwrite)?;
    }
    let file: Option<PathBuf> = what.extract().ok();
    let name = file.as_deref().and_then(Path::file_name).unwrap_or_default().to_string_lossy();
    let title = title.unwrap_or_else(|| name.into_owned());
    let (content, light) = match &file {
        Some(path) => {
            let read = py.detach(|| io::read_drawing(path, &scene::Light::default()));
            let (content, light) = read.map_err(raise)?;
            (content, light.unwrap_or_default())
        }
        None => content_of(what, grid)?,
    };
    let folder = tempfile::tempdir().map_err(|problem| PyOSError::new_err(problem.to_string()))?;
    let path = folder.path().join("figure.png");
    match content {
        Drawing::Images(_) if truth.is_some() => {
            let problem = "images cannot be compared with a truth: omit it, or give a volume";
            return Err(PyTypeError::new_err(problem));
        }
        Drawing::Images(images) => {
            let (geometry, wavelength) = (images.geometry(), images.light.wavelength);
            py.detach(|| contact_sheet(&path, &images.images, &geometry, wavelength, &[], &title))
                .map_err(raise)?;
        }
        Drawing::Field(field) => {
            let grid = Some(*field.grid());
            let truth = truth.map(|truth| extinction(truth, "truth", grid, &light));
            let truth = truth.transpose()?;
            let estimate = field.estimate.as_ref();
            let fields = VolumeFields {
                extinction: estimate.map(|estimate| &estimate.extinction),
                truth: truth.as_ref(),
                uncertainty: estimate.and_then(|estimate| estimate.uncertainty.as_ref()),
                mask: field.mask.as_ref(),
            };
            py.detach(|| volume_figure(&path, &fields, &title)).map_err(raise)?;
        }
    }
    let figure = Figure(std::fs::read(&path).map_err(Error::io(&path)).map_err(raise)?);
    out.map_or(Ok(()), |out| figure.save(out, overwrite))?;
    Ok(figure)
}

/// What an object shows, and its scene illumination.
fn content_of(what: &Bound<'_, PyAny>, grid: Option<Grid>) -> PyResult<(Drawing, scene::Light)> {
    let light = Light::of(what)?.map_or_else(scene::Light::default, |light| light.core);
    let is_images =
        what.cast::<Observation>().is_ok() || (is_dataset(what)? && what.contains("radiance")?);
    if is_images {
        let given = Given { views: None, light: None, standard_error: None, saturated: None };
        let images = observation(what, given, |_| Ok(Light::from(scene::Light::default())))?;
        return Ok((Drawing::Images(Box::new(images)), light));
    }
    let volume = extinction(what, "extinction", grid.map(|Grid(grid)| grid), &light)?;
    let uncertainty = what.getattr("uncertainty").ok().filter(|values| !values.is_none());
    let uncertainty = uncertainty
        .map(|values| extinction(&values, "uncertainty", Some(volume.grid), &light))
        .transpose()?;
    let field = Field::from(Estimate { extinction: volume, uncertainty });
    Ok((Drawing::Field(Box::new(field)), light))
}

/// The extinction of an argument on a grid.
fn extinction(
    object: &Bound<'_, PyAny>,
    name: &str,
    grid: Option<deepct_core::grid::Grid>,
    light: &scene::Light,
) -> PyResult<Volume> {
    let values = field::extinction(object, name, light)?;
    Volume::new(values.grid(grid)?, values.values).map_err(raise)
}

/// Returns an error unless the path is the name of a PNG file.
fn check_name(path: &Path) -> PyResult<()> {
    if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png")) {
        return Ok(());
    }
    let range = "the name of a PNG file, ending in .png";
    Err(raise(Error::out_of_range("out", path.display(), range)))
}
