//! Computations without the interpreter lock, on threads of this process, which Ctrl-C can stop.

use crate::error::raise;
use deepct_core::stop::Stop;
use deepct_core::{Error, Result};
use pyo3::prelude::*;
use rayon::ThreadPool;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Time between two checks whether Ctrl-C was pressed.
const CHECKED: Duration = Duration::from_millis(50);

/// The threads, and the process that they belong to.
static POOL: Mutex<Option<(u32, Arc<ThreadPool>)>> = Mutex::new(None);

/// The threads of this process. A child that was forked has none of those of its parent and would
/// wait for them for ever, so that it starts its own.
fn pool() -> PyResult<Arc<ThreadPool>> {
    let mut pool = POOL.lock().unwrap_or_else(PoisonError::into_inner);
    let process = std::process::id();
    match &*pool {
        Some((owner, threads)) if *owner == process => return Ok(threads.clone()),
        _ => {}
    }
    let threads = rayon::ThreadPoolBuilder::new().build().map_err(|problem| {
        raise(Error::out_of_range("number of threads", problem, "one that the machine can start"))
    })?;
    let threads = Arc::new(threads);
    // Dropping the pool of the parent would wait for its threads as well.
    std::mem::forget(pool.replace((process, threads.clone())));
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

/// Runs a computation that may take long. If a signal handler of Python raises an exception, such
/// as `KeyboardInterrupt`, the computation is stopped and the exception is returned.
pub(crate) fn at_length<T: Send>(
    py: Python<'_>,
    work: impl FnOnce(&Stop) -> Result<T> + Send,
) -> PyResult<T> {
    let (pool, stop) = (pool()?, Stop::default());
    let (sender, receiver) = channel();
    std::thread::scope(|scope| {
        let stopped = &stop;
        scope.spawn(move || {
            // If nobody receives the result, an exception is on its way.
            let _ = sender.send(pool.install(|| work(stopped)));
        });
        let receiver = Mutex::new(receiver);
        let next = || receiver.lock().unwrap_or_else(PoisonError::into_inner).recv_timeout(CHECKED);
        loop {
            match py.detach(next) {
                Ok(result) => return result.map_err(raise),
                Err(RecvTimeoutError::Timeout) => {
                    if let Err(exception) = py.check_signals() {
                        stop.request();
                        // The thread must end before the scope, and must not wait for Python.
                        py.detach(|| while matches!(next(), Err(RecvTimeoutError::Timeout)) {});
                        return Err(exception);
                    }
                }
                // The computation has panicked; the scope passes this on.
                Err(RecvTimeoutError::Disconnected) => {
                    let problem = "the computation has ended without a result";
                    return Err(pyo3::exceptions::PyRuntimeError::new_err(problem));
                }
            }
        }
    })
}

/// The progress callback of a computation that a request stops.
pub(crate) struct Stopped<'a>(pub(crate) &'a Stop);

impl deepct_core::transport::Watch for Stopped<'_> {
    fn interrupted(&self) -> bool {
        self.0.is_requested()
    }
}

impl deepct_core::inversion::Watch for Stopped<'_> {
    fn interrupted(&self) -> bool {
        self.0.is_requested()
    }
}
