//! Computations without the interpreter lock, on threads of this process, which Ctrl-C can stop.

use crate::error::raise;
use deepct_core::stop::Stop;
use deepct_core::{Error, Result};
use pyo3::prelude::*;
use rayon::ThreadPool;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::mpsc::channel;
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

/// Runs a computation. If a signal handler of Python raises an exception, such as
/// `KeyboardInterrupt`, the computation is requested to stop and the exception is returned at once. A
/// computation that does not look for the request ends in the background, and its result is dropped.
pub(crate) fn compute<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce(&Stop) -> Result<T> + Send + 'static,
) -> PyResult<T> {
    let stop = Stop::default();
    let (sender, receiver) = channel();
    let stopped = stop.clone();
    pool()?.spawn(move || {
        let result = catch_unwind(AssertUnwindSafe(|| work(&stopped)));
        // If nobody receives the result, an exception is on its way.
        let _ = sender.send(result);
    });
    let receiver = Mutex::new(receiver);
    let next = || receiver.lock().unwrap_or_else(PoisonError::into_inner).recv_timeout(CHECKED);
    loop {
        match py.detach(next) {
            Ok(Ok(result)) => return result.map_err(raise),
            Ok(Err(panic)) => resume_unwind(panic),
            Err(_) => py.check_signals().inspect_err(|_| stop.request())?,
        }
    }
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
