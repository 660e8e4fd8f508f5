//! `view`: pages with an interactive view in 3D, which notebooks show.

use crate::error::raise;
use crate::exchange::check_origin;
use crate::grid::Grid;
use crate::plot::Subject;
use crate::record::{Record, record};
use deepct_core::Error;
use deepct_core::report::{MAX_VOXELS, drawing_report};
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::{Path, PathBuf};

/// Upper limit of the number of voxels in what a notebook shows of an object: a field of 64 x 64 columns
/// with 32 levels is shown as it is, and larger ones are averaged over blocks.
const MOST_VOXELS_SHOWN: usize = 1 << 17;

/// Height of a page in a notebook (CSS pixels).
const HEIGHT: u32 = 720;

/// A page in HTML with an interactive view in 3D, which notebooks show. It contains all it shows.
///
/// Parameters
/// ----------
/// html : str
///     The contents of an HTML file.
#[pyclass(frozen, module = "deepct_py")]
pub(crate) struct Page {
    /// The contents of an HTML file.
    #[pyo3(get)]
    html: String,
}

record!(@picture Page);

impl Record for Page {
    fn arguments<'py>(of: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        let arguments = PyDict::new(of.py());
        arguments.set_item("html", &of.get().html)?;
        Ok(arguments)
    }

    fn shown<'py>(of: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        let shown = PyDict::new(of.py());
        shown.set_item("html", of.get().html.as_bytes())?;
        Ok(shown)
    }
}

#[pymethods]
impl Page {
    #[new]
    fn new(html: String) -> Self {
        Self { html }
    }

    /// Write an HTML file. A file that deepct did not write is replaced only with `overwrite`.
    #[pyo3(signature = (path, *, overwrite = false))]
    fn save(&self, path: PathBuf, overwrite: bool) -> PyResult<()> {
        check_name(&path)?;
        check_origin(&path, overwrite)?;
        deepct_core::files::write(&path, &self.html).map_err(raise)
    }

    /// Open the page in the browser, from a temporary file. Returns its path.
    fn open(&self, py: Python<'_>) -> PyResult<PathBuf> {
        let problem = |problem: std::io::Error| PyOSError::new_err(problem.to_string());
        let file = tempfile::Builder::new().prefix("deepct-").suffix(".html").tempfile();
        // The browser reads it later.
        let (_, path) = file.map_err(problem)?.keep().map_err(|lost| problem(lost.error))?;
        deepct_core::files::write(&path, &self.html).map_err(raise)?;
        let address =
            py.import("pathlib")?.call_method1("Path", (&path,))?.call_method0("as_uri")?;
        py.import("webbrowser")?.call_method1("open", (address,))?;
        Ok(path)
    }

    fn _repr_html_(&self) -> String {
        frame(&self.html)
    }
}

/// Make a page with an interactive view in 3D of a volume or a mask, alone or beside the truth, or with a
/// sheet of images: the page of `deepct view`.
///
/// Parameters
/// ----------
/// what : Cloud, Estimate, Reconstruction, Carved, Observation, array, str or path
///     A volume, a mask or images, or a file of one. An array is an extinction (1/km), [z, y, x].
/// truth : Cloud, array, str or path, optional
///     The true cloud, which is shown beside the volume, with scores and the difference. The extinction of
///     a cloud that is given by its droplets is the one in the light of the volume, if it is known.
/// grid : Grid, object or path, optional
///     The grid of an array.
/// title : str, optional
///     Title of the page. Default: the name of the file, or of the class.
/// out : str or path, optional
///     HTML file to write.
/// overwrite : bool
///     Replace a file that deepct did not write.
///
/// Returns
/// -------
/// Page
///     The page, which notebooks show; `open` opens it in the browser, and `save` writes it to a file.
///
/// Examples
/// --------
/// >>> cloud = deepct_py.generate_cloud(seed=3, width_km=0.4)
/// >>> page = deepct_py.view(cloud)
/// >>> page.html[:15]
/// '<!DOCTYPE html>'
#[pyfunction]
#[pyo3(signature = (what, truth = None, *, grid = None, title = None, out = None, overwrite = false))]
pub(crate) fn view(
    what: &Bound<'_, PyAny>,
    truth: Option<&Bound<'_, PyAny>>,
    grid: Option<Grid>,
    title: Option<String>,
    out: Option<PathBuf>,
    overwrite: bool,
) -> PyResult<Page> {
    if let Some(out) = &out {
        check_name(out)?;
        check_origin(out, overwrite)?;
    }
    let page = page(what, truth, grid, title, MAX_VOXELS)?;
    out.map_or(Ok(()), |out| page.save(out, overwrite))?;
    Ok(page)
}

fn page(
    what: &Bound<'_, PyAny>,
    truth: Option<&Bound<'_, PyAny>>,
    grid: Option<Grid>,
    title: Option<String>,
    most_voxels: usize,
) -> PyResult<Page> {
    let subject = Subject::of(what, grid)?;
    let truth = truth.map(|truth| subject.truth(truth)).transpose()?;
    let name = match subject.name() {
        "" => what.get_type().name()?.to_string(),
        name => name.to_owned(),
    };
    let title = title.unwrap_or(name);
    let (content, light) = (&subject.content, subject.light.as_ref());
    let report = what
        .py()
        .detach(|| drawing_report(&title, content, light, truth.as_ref(), most_voxels))
        .map_err(raise)?;
    Ok(Page { html: report.to_html() })
}

/// What a notebook shows of an object: a table, and the page of the object below it, if it can be made.
pub(crate) fn with_page(of: &Bound<'_, PyAny>, table: String) -> String {
    let page = page(of, None, None, None, MOST_VOXELS_SHOWN);
    page.map_or(table.clone(), |page| table + &frame(&page.html))
}

/// A page in a frame of its own, in which its styles and scripts do not meet those of the notebook.
fn frame(html: &str) -> String {
    let html = html.replace('&', "&amp;").replace('"', "&quot;");
    format!(
        "<iframe sandbox=\"allow-scripts\" style=\"width: 100%; height: {HEIGHT}px; border: 1px solid \
         #ddd; resize: vertical\" srcdoc=\"{html}\"></iframe>"
    )
}

/// Returns an error unless the path is the name of an HTML file.
fn check_name(path: &Path) -> PyResult<()> {
    if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("html")) {
        return Ok(());
    }
    let range = "the name of an HTML file, ending in .html";
    Err(raise(Error::out_of_range("out", path.display(), range)))
}
