//! Computations without the interpreter lock, on threads of this process, which report their progress
//! and which Ctrl-C can stop.

use crate::error::raise;
use crate::number::whole_if_given;
use deepct_core::stop::Stop;
use deepct_core::{Error, Result, inversion, transport};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict};
use rayon::ThreadPool;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Time between two checks whether Ctrl-C was pressed.
pub(crate) const CHECKED: Duration = Duration::from_millis(50);

/// The largest number of threads that may be asked for.
const MOST_THREADS: usize = 4096;

/// The threads, and the process that they belong to.
static POOL: Mutex<Option<(u32, Arc<ThreadPool>)>> = Mutex::new(None);

/// The number of threads; 0 is one per processor.
static THREADS: Mutex<usize> = Mutex::new(0);

/// Set the number of threads on which this process computes. Results do not depend on it.
///
/// Parameters
/// ----------
/// count : int, optional
///     Number of threads. Default: one per processor, or the environment variable
///     `RAYON_NUM_THREADS` when the module computes for the first time.
#[pyfunction]
#[pyo3(signature = (count = None))]
pub(crate) fn set_threads(count: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
    let count: Option<usize> = whole_if_given(count, "count")?;
    if let Some(count) = count.filter(|count| !(1..=MOST_THREADS).contains(count)) {
        let range = format!("from 1 to {MOST_THREADS}");
        return Err(PyValueError::new_err(format!("count is {count}, but must be {range}")));
    }
    *THREADS.lock().unwrap_or_else(PoisonError::into_inner) = count.unwrap_or(0);
    // Computations that are in progress keep their threads.
    let previous = POOL.lock().unwrap_or_else(PoisonError::into_inner).take();
    forget_foreign(previous);
    Ok(())
}

/// Drops the threads, unless they are those of the parent of this process: dropping these would wait
/// for ever.
fn forget_foreign(pool: Option<(u32, Arc<ThreadPool>)>) {
    if let Some((owner, threads)) = pool.filter(|(owner, _)| *owner != std::process::id()) {
        std::mem::forget((owner, threads));
    }
}

/// The threads of this process. A child that was forked has none of those of its parent and would
/// wait for them for ever, so that it starts its own.
fn pool() -> PyResult<Arc<ThreadPool>> {
    let mut pool = POOL.lock().unwrap_or_else(PoisonError::into_inner);
    let process = std::process::id();
    match &*pool {
        Some((owner, threads)) if *owner == process => return Ok(threads.clone()),
        _ => {}
    }
    let count = *THREADS.lock().unwrap_or_else(PoisonError::into_inner);
    let threads =
        rayon::ThreadPoolBuilder::new().num_threads(count).build().map_err(|problem| {
            raise(Error::out_of_range(
                "number of threads",
                problem,
                "one that the machine can start",
            ))
        })?;
    let threads = Arc::new(threads);
    forget_foreign(pool.replace((process, threads.clone())));
    Ok(threads)
}

/// Runs a short computation.
pub(crate) fn quickly<T: Send>(
    py: Python<'_>,
    work: impl FnOnce() -> Result<T> + Send,
) -> PyResult<T> {
    let pool = pool()?;
    py.detach(|| pool.install(work)).map_err(raise)
}

/// The argument `progress`: what receives the reports of a computation.
pub(crate) enum Progress {
    /// A function of Python.
    Callback(Py<PyAny>),
    /// A line on the standard error, which is closed at the end.
    Line(Py<PyAny>),
    /// Nothing.
    None,
}

impl FromPyObject<'_, '_> for Progress {
    type Error = PyErr;

    fn extract(object: Borrowed<'_, '_, PyAny>) -> PyResult<Self> {
        if let Ok(is_wanted) = object.cast::<PyBool>() {
            let module = object.py().import("deepct_py._progress")?;
            return Ok(match is_wanted.is_true() {
                true => Self::Line(module.call_method0("Line")?.unbind()),
                false => Self::None,
            });
        }
        if object.is_callable() {
            return Ok(Self::Callback(object.to_owned().unbind()));
        }
        Err(PyTypeError::new_err("progress must be True, False or a function of one argument"))
    }
}

impl Progress {
    fn report(&self, py: Python<'_>, reports: Vec<Report>) -> PyResult<()> {
        let (Self::Callback(receiver) | Self::Line(receiver)) = self else { return Ok(()) };
        for report in reports {
            receiver.call1(py, (report.status(py)?,))?;
        }
        Ok(())
    }

    fn end(&self, py: Python<'_>) -> PyResult<()> {
        let Self::Line(line) = self else { return Ok(()) };
        line.call_method0(py, "close").map(|_| ())
    }
}

/// The state of a computation.
#[derive(Clone, Copy)]
enum Report {
    Rendering(transport::Progress),
    Inversion(inversion::Record),
}

impl Report {
    fn status<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        match self {
            Self::Rendering(progress) => {
                let status = PyDict::new(py);
                status.set_item("share", progress.share)?;
                status.set_item("samples", progress.samples_per_pixel)?;
                status.set_item("noise", progress.noise)?;
                Ok(status.into_any())
            }
            Self::Inversion(record) => {
                let text = serde_json::to_string(record).expect("plain numbers");
                py.import("json")?.call_method1("loads", (text,))
            }
        }
    }
}

/// What a computation has to do with those who wait for it.
#[derive(Default)]
pub(crate) struct Watch {
    /// The request to stop it.
    pub(crate) stop: Stop,
    reports: Mutex<Vec<Report>>,
}

impl Watch {
    fn reports(&self) -> std::sync::MutexGuard<'_, Vec<Report>> {
        self.reports.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl transport::Watch for Watch {
    fn reached(&self, progress: &transport::Progress) {
        // Only the latest state matters.
        *self.reports() = vec![Report::Rendering(*progress)];
    }

    fn interrupted(&self) -> bool {
        self.stop.is_requested()
    }
}

impl inversion::Watch for Watch {
    fn reached(&self, record: &inversion::Record) {
        self.reports().push(Report::Inversion(*record));
    }

    fn interrupted(&self) -> bool {
        self.stop.is_requested()
    }
}

/// Runs a computation that may take long. If `progress` or a signal handler of Python raises an
/// exception, such as `KeyboardInterrupt`, the computation is requested to stop and the exception is
/// returned at once. A computation that does not look for the request ends in the background, and its
/// result is dropped.
pub(crate) fn at_length<T: Send + 'static>(
    py: Python<'_>,
    progress: &Progress,
    work: impl FnOnce(&Watch) -> Result<T> + Send + 'static,
) -> PyResult<T> {
    let watch = Arc::new(Watch::default());
    let (sender, receiver) = channel();
    let watched = watch.clone();
    pool()?.spawn(move || {
        let result = catch_unwind(AssertUnwindSafe(|| work(&watched)));
        // If nobody receives the result, an exception is on its way.
        let _ = sender.send(result);
    });
    let receiver = Mutex::new(receiver);
    let next = || receiver.lock().unwrap_or_else(PoisonError::into_inner).recv_timeout(CHECKED);
    let result = loop {
        let found = py.detach(next);
        let reports = std::mem::take(&mut *watch.reports());
        if let Err(exception) = py.check_signals().and_then(|()| progress.report(py, reports)) {
            watch.stop.request();
            return Err(exception);
        }
        match found {
            Ok(Ok(result)) => break result,
            Ok(Err(panic)) => resume_unwind(panic),
            Err(_) => {}
        }
    };
    progress.end(py)?;
    result.map_err(raise)
}

/// Runs a computation of which nothing is reported, as [`at_length`] does.
pub(crate) fn interruptibly<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce() -> Result<T> + Send + 'static,
) -> PyResult<T> {
    at_length(py, &Progress::None, |_| work())
}
