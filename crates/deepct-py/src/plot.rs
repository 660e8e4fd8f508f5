//! `plot`: figures of volumes and of images.

use crate::carve::Carved;
use crate::error::raise;
use crate::exchange::{check_origin, is_dataset};
use crate::field;
use crate::grid::Grid;
use crate::invert::Reconstruction;
use crate::light::Light;
use crate::observation::{Given, Observation, observation};
use crate::record::{Record, record};
use deepct_core::grid::{Mask, Volume};
use deepct_core::io::{Drawing, Field};
use deepct_core::math::DVec3;
use deepct_core::network::Estimate;
use deepct_core::plot as figures;
use deepct_core::plot::{Format, VolumeFields, contact_sheet, volume_figure};
use deepct_core::{Result, io, scene};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use std::path::{Path, PathBuf};

/// A picture, which notebooks show.
///
/// Parameters
/// ----------
/// png, pdf : bytes
///     The contents of a PNG file and of a PDF file.
/// svg : str
///     The contents of an SVG file.
#[pyclass(frozen, module = "deepct_py")]
pub(crate) struct Figure {
    png: Vec<u8>,
    /// The contents of an SVG file.
    #[pyo3(get)]
    svg: String,
    pdf: Vec<u8>,
}

record!(@picture Figure);

impl Record for Figure {
    fn arguments<'py>(of: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        let arguments = PyDict::new(of.py());
        arguments.set_item("png", of.get().png(of.py()))?;
        arguments.set_item("svg", &of.get().svg)?;
        arguments.set_item("pdf", of.get().pdf(of.py()))?;
        Ok(arguments)
    }

    fn shown<'py>(of: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        let shown = Self::arguments(of)?;
        shown.set_item("svg", of.get().svg.as_bytes())?;
        Ok(shown)
    }
}

#[pymethods]
impl Figure {
    #[new]
    fn new(png: Vec<u8>, svg: String, pdf: Vec<u8>) -> Self {
        Self { png, svg, pdf }
    }

    /// The contents of a PNG file.
    #[getter]
    fn png<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &self.png)
    }

    /// The contents of a PDF file.
    #[getter]
    fn pdf<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &self.pdf)
    }

    /// Write a file in the format of its ending: .png, .svg or .pdf. A file of another format is replaced
    /// only with `overwrite`.
    #[pyo3(signature = (path, *, overwrite = false))]
    fn save(&self, path: PathBuf, overwrite: bool) -> PyResult<()> {
        let contents = match format(&path)? {
            Format::Svg => self.svg.as_bytes(),
            Format::Pdf => &self.pdf,
            _ => &self.png,
        };
        check_origin(&path, overwrite)?;
        deepct_core::files::write(&path, contents).map_err(raise)
    }

    fn _repr_png_<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        self.png(py)
    }
}

impl Figure {
    fn of(figure: &figures::Figure) -> Result<Self> {
        let svg = String::from_utf8_lossy(&figure.encode(Format::Svg)?).into_owned();
        Ok(Self { png: figure.encode(Format::Png)?, svg, pdf: figure.encode(Format::Pdf)? })
    }
}

/// Draw a volume or a mask, alone or with the truth, or a sheet of images: the figure of `deepct plot`. The
/// uncertainty of an estimate, and the mask in a file, are drawn too.
///
/// Parameters
/// ----------
/// what : Cloud, Estimate, Reconstruction, Carved, Observation, array, str or path
///     A volume, a mask or images, or a file of one. An array is an extinction (1/km), [z, y, x].
/// truth : Cloud, array, str or path, optional
///     The true cloud, which is drawn beside the volume and in a scatter plot against it. The extinction
///     of a cloud that is given by its droplets is the one in the light of the volume, if it is known.
/// grid : Grid, object or path, optional
///     The grid of an array.
/// through : (x, y, z), optional
///     The point through which the slices are taken (km). Default: each is the one with the most
///     extinction.
/// title : str, optional
///     Title of the figure. Default: the name of the file.
/// out : str or path, optional
///     File to write: .png, .svg or .pdf.
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
#[pyo3(signature = (
    what, truth = None, *, grid = None, through = None, title = None, out = None, overwrite = false
))]
pub(crate) fn plot(
    what: &Bound<'_, PyAny>,
    truth: Option<&Bound<'_, PyAny>>,
    grid: Option<Grid>,
    through: Option<[f64; 3]>,
    title: Option<String>,
    out: Option<PathBuf>,
    overwrite: bool,
) -> PyResult<Figure> {
    let py = what.py();
    if let Some(out) = &out {
        format(out)?;
        check_origin(out, overwrite)?;
    }
    let subject = Subject::of(what, grid)?;
    let title = title.unwrap_or_else(|| subject.name().to_owned());
    let truth = truth.map(|truth| subject.truth(truth)).transpose()?;
    let drawn = match &subject.content {
        Drawing::Images(_) if through.is_some() => {
            return Err(PyTypeError::new_err(
                "images have no slices; omit through, or give a volume",
            ));
        }
        Drawing::Images(images) => {
            let (geometry, wavelength) = (images.geometry(), images.light.wavelength);
            py.detach(|| contact_sheet(&images.images, &geometry, wavelength, &[], &title))
        }
        Drawing::Field(field) => {
            let estimate = field.estimate.as_ref();
            let fields = VolumeFields {
                extinction: estimate.map(|estimate| &estimate.extinction),
                truth: truth.as_ref(),
                uncertainty: estimate.and_then(|estimate| estimate.uncertainty.as_ref()),
                mask: field.mask.as_ref(),
                through: through.map(DVec3::from_array),
            };
            py.detach(|| volume_figure(&fields, &title))
        }
    };
    let figure = drawn.and_then(|drawn| Figure::of(&drawn)).map_err(raise)?;
    out.map_or(Ok(()), |out| figure.save(out, overwrite))?;
    Ok(figure)
}

/// What figures and pages show: an object or the contents of a file.
pub(crate) struct Subject {
    pub(crate) content: Drawing,
    /// The scene illumination, if it is known.
    pub(crate) light: Option<scene::Light>,
    file: Option<PathBuf>,
}

impl Subject {
    /// `grid` is that of an array.
    pub(crate) fn of(what: &Bound<'_, PyAny>, grid: Option<Grid>) -> PyResult<Self> {
        let file: Option<PathBuf> = what.extract().ok();
        let (content, light) = match &file {
            Some(path) => {
                let read = || io::read_drawing(path, &scene::Light::default());
                what.py().detach(read).map_err(raise)?
            }
            None => {
                let light = Light::of(what)?.map(|light| light.core);
                (content_of(what, grid, light.clone().unwrap_or_default())?, light)
            }
        };
        Ok(Self { content, light, file })
    }

    /// The name of the file; empty for an object.
    pub(crate) fn name(&self) -> &str {
        let name = self.file.as_deref().and_then(Path::file_name).unwrap_or_default();
        name.to_str().unwrap_or_default()
    }

    /// The true extinction, in the light and on the grid of the subject.
    ///
    /// # Errors
    /// Images as the subject; a truth on another grid.
    pub(crate) fn truth(&self, truth: &Bound<'_, PyAny>) -> PyResult<Volume> {
        let Drawing::Field(field) = &self.content else {
            let problem = "images cannot be compared with a truth: omit it, or give a volume";
            return Err(PyTypeError::new_err(problem));
        };
        let light = self.light.clone().unwrap_or_default();
        extinction(truth, "truth", Some(*field.grid()), &light)
    }
}

/// What an object shows.
fn content_of(
    what: &Bound<'_, PyAny>,
    grid: Option<Grid>,
    light: scene::Light,
) -> PyResult<Drawing> {
    let is_dataset = is_dataset(what)?;
    let is_images =
        what.cast::<Observation>().is_ok() || (is_dataset && what.contains("radiance")?);
    if is_images {
        let given = Given { views: None, light: None, standard_error: None, saturated: None };
        let images = observation(what, given, |_| Ok(Light::from(scene::Light::default())))?;
        return Ok(Drawing::Images(Box::new(images)));
    }
    let is_mask = what.cast::<Carved>().is_ok();
    let has_mask = is_mask
        || what.cast::<Reconstruction>().is_ok()
        || (is_dataset && what.contains("mask")?);
    let has_extinction = !is_mask && (!has_mask || !is_dataset || what.contains("extinction")?);
    let grid = grid.map(|Grid(grid)| grid);
    let mask = has_mask.then(|| {
        let placed = field::mask(what, "mask")?;
        Mask::new(placed.grid(grid)?, placed.values).map_err(raise)
    });
    let estimate = has_extinction.then(|| {
        let extinction = self::extinction(what, "extinction", grid, &light)?;
        let uncertainty = what.getattr("uncertainty").ok().filter(|values| !values.is_none());
        let on_grid =
            |values| self::extinction(&values, "uncertainty", Some(extinction.grid), &light);
        let uncertainty = uncertainty.map(on_grid).transpose()?;
        Ok::<_, PyErr>(Estimate { uncertainty, ..extinction.into() })
    });
    let (estimate, mask) = (estimate.transpose()?, mask.transpose()?);
    Ok(Drawing::Field(Box::new(Field { estimate, mask, has_droplets: false })))
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

/// The format of the ending of a path.
fn format(path: &Path) -> PyResult<Format> {
    Format::of(path, "out").map_err(raise)
}
