//! `Lineage`: the time of a field, and what was done to it before.

use crate::exchange::{is_dataset, through_circumstances};
use crate::record::{Record, record};
use deepct_core::io::{self, Time};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::{Path, PathBuf};

/// The time of a field and its history, which files keep. Objects with equal values are equal whatever their
/// lineage is.
///
/// Parameters
/// ----------
/// time : float, optional
///     The time of the field, in `units`.
/// units : str
///     The units of the time, such as "seconds since 2004-01-01".
/// calendar : str
///     The calendar of the time, as in the CF conventions.
/// history : str
///     One line for each step by which the field was made, the last one first.
///
/// Examples
/// --------
/// >>> cloud = deepct_py.generate_cloud(seed=3, width_km=0.4)
/// >>> images = deepct_py.render(cloud, views="cloudct-10", samples=2)
/// >>> images.lineage.history.split(": ")[1]
/// 'render'
#[pyclass(frozen, from_py_object, module = "deepct_py")]
#[derive(Clone, Default)]
pub(crate) struct Lineage(pub(crate) io::Lineage);

record!(Lineage);

impl Record for Lineage {
    fn arguments<'py>(of: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        let arguments = PyDict::new(of.py());
        let lineage = of.get();
        if let Some(time) = lineage.time() {
            arguments.set_item("time", time)?;
        }
        let texts = [
            ("units", lineage.units()),
            ("calendar", lineage.calendar()),
            ("history", lineage.history()),
        ];
        for (name, text) in texts.into_iter().filter(|(_, text)| !text.is_empty()) {
            arguments.set_item(name, text)?;
        }
        Ok(arguments)
    }
}

#[pymethods]
impl Lineage {
    #[new]
    #[pyo3(
        signature = (*, time = None, units = String::new(), calendar = String::new(), history = String::new()),
        text_signature = "(*, time=None, units='', calendar='', history='')",
    )]
    fn new(time: Option<f64>, units: String, calendar: String, history: String) -> Self {
        Self(io::Lineage { time: time.map(|value| Time { value, units, calendar }), history })
    }

    /// The lineage of what a step makes of the field: `step` is the first line of its history.
    fn then(&self, step: &str) -> Self {
        Self(self.0.clone().then(step))
    }

    /// The time of the field in `units`; None if it is unknown.
    #[getter]
    fn time(&self) -> Option<f64> {
        self.0.time.as_ref().map(|time| time.value)
    }

    /// The units of the time; empty if they are unknown.
    #[getter]
    fn units(&self) -> &str {
        self.0.time.as_ref().map_or("", |time| &time.units)
    }

    /// The calendar of the time; empty if it is unknown.
    #[getter]
    fn calendar(&self) -> &str {
        self.0.time.as_ref().map_or("", |time| &time.calendar)
    }

    /// One line for each step by which the field was made, the last one first.
    #[getter]
    fn history(&self) -> &str {
        &self.0.history
    }
}

impl Lineage {
    /// The lineage of an argument: an object of this module, a data set of xarray or a file. That of
    /// arrays is empty.
    pub(crate) fn of(object: &Bound<'_, PyAny>) -> PyResult<Self> {
        if let Ok(path) = object.extract::<PathBuf>() {
            return Ok(Self(io::read_lineage(path)));
        }
        if is_dataset(object)? {
            let read = |path: &Path| Ok(Self(io::read_lineage(path)));
            return Ok(through_circumstances(object, read)?.unwrap_or_default());
        }
        let own = object.getattr("lineage").and_then(|lineage| Ok(lineage.extract::<Self>()?));
        Ok(own.unwrap_or_default())
    }

    /// The lineage of what a stage makes of an argument.
    pub(crate) fn after(object: &Bound<'_, PyAny>, stage: &str) -> PyResult<Self> {
        let path = object.extract::<PathBuf>().unwrap_or_default();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        Ok(Self::of(object)?.then(format!("{stage} {name}").trim_end()))
    }
}
