//! Progress reports: a progress bar on a terminal, plain lines otherwise.

use crate::global::Global;
use deepct_core::Result;
use deepct_core::inversion::{self, Checkpoint, Record};
use deepct_core::io::write_checkpoint;
use deepct_core::stop::Stop;
use deepct_core::transport::{self, Watch};
use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{LazyLock, Mutex};
use std::time::{Duration, Instant};

/// Counts the finished units of a long computation and shows the progress.
pub(crate) struct Progress {
    what: &'static str,
    total: u64,
    done: AtomicU64,
    bar: Option<ProgressBar>,
    lines: bool,
    start: Instant,
    last_line: Mutex<Instant>,
}

/// Longest interval between lines without a terminal; a line is also printed at every quarter of
/// the work.
const LINE_EVERY: Duration = Duration::from_secs(600);

impl Progress {
    /// Starts the report of `what`, which consists of `total` units.
    pub(crate) fn start(global: &Global, what: &'static str, total: u64) -> Self {
        let terminal = std::io::stderr().is_terminal();
        let bar = (terminal && !global.quiet).then(|| {
            let bar = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::stderr());
            let style = "{msg} [{bar:30}] {percent} % in {elapsed}, {eta} left";
            bar.set_style(ProgressStyle::with_template(style).expect("a fixed template"));
            bar.set_message(what);
            bar
        });
        let lines = !terminal && !global.quiet;
        let start = Instant::now();
        let last_line = Mutex::new(start);
        Self { what, total, done: AtomicU64::new(0), bar, lines, start, last_line }
    }

    /// Adds `units` to the finished units. May be called from any thread.
    pub(crate) fn advance(&self, units: u64) {
        self.advance_with(units, None);
    }

    /// Adds `units` to the finished units, and shows `text` with the progress.
    pub(crate) fn advance_with(&self, units: u64, text: Option<&str>) {
        let before = self.done.fetch_add(units, Ordering::Relaxed);
        if let Some(bar) = &self.bar {
            bar.inc(units);
            if let Some(text) = text {
                bar.set_message(format!("{}: {text}", self.what));
            }
        }
        if self.lines && self.is_due(before, before + units) {
            let done = before + units;
            let text = text.map_or_else(|| format!("{done} of {}", self.total), str::to_owned);
            note!("{}: {text}{}", self.what, self.left(done));
        }
    }

    /// Whether the next line is due.
    fn is_due(&self, before: u64, done: u64) -> bool {
        let quarter = |done: u64| (4 * done).checked_div(self.total).unwrap_or(0);
        let Ok(mut last_line) = self.last_line.lock() else { return false };
        let due = quarter(done) > quarter(before) || last_line.elapsed() > LINE_EVERY;
        if due {
            *last_line = Instant::now();
        }
        due
    }

    /// The remaining time as text, extrapolated from the finished units.
    fn left(&self, done: u64) -> String {
        if done == 0 || done >= self.total {
            return String::new();
        }
        let left = self.start.elapsed().mul_f64((self.total - done) as f64 / done as f64);
        format!(", {} left", HumanDuration(left))
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

/// Number of steps of the progress bar of a rendering.
const STEPS: u64 = 1000;

/// Requested when the user presses Ctrl-C.
static STOP: LazyLock<Stop> = LazyLock::new(Stop::default);

/// Whether a computation has noticed it, and will soon end with the results so far.
static NOTICED: AtomicBool = AtomicBool::new(false);

/// Time in which a computation has to notice Ctrl-C.
const PATIENCE: Duration = Duration::from_millis(800);

/// Installs a Ctrl-C handler: the first Ctrl-C stops the computation and keeps the results so far,
/// a second one ends the program, as does the first one where the computation does not notice it.
pub(crate) fn stop_when_asked() {
    // If no handler can be installed, Ctrl-C ends the program.
    let _ = ctrlc::set_handler(|| {
        if STOP.is_requested() {
            std::process::exit(130);
        }
        STOP.request();
        std::thread::spawn(|| {
            std::thread::sleep(PATIENCE);
            if !NOTICED.load(Ordering::Relaxed) {
                note!("deepct: interrupted");
                std::process::exit(130);
            }
        });
    });
}

/// Whether the user has pressed Ctrl-C. The caller then ends with the results so far.
pub(crate) fn stopped() -> bool {
    let stopped = STOP.is_requested();
    if stopped {
        NOTICED.store(true, Ordering::Relaxed);
    }
    stopped
}

/// The request that Ctrl-C makes, for a computation that polls it.
pub(crate) fn stop() -> Stop {
    STOP.clone()
}

/// Reports the progress of a rendering, with the noise reached so far. The first Ctrl-C stops the
/// rendering and keeps the images so far, a second one ends the program.
pub(crate) struct RenderProgress {
    progress: Progress,
}

impl RenderProgress {
    /// Starts the report of `what`.
    pub(crate) fn start(global: &Global, what: &'static str) -> Self {
        stop_when_asked();
        Self { progress: Progress::start(global, what, STEPS) }
    }
}

impl Watch for RenderProgress {
    fn reached(&self, reached: &transport::Progress) {
        let done = (reached.share * STEPS as f64) as u64;
        let before = self.progress.done.load(Ordering::Relaxed);
        let (samples, noise) = (reached.samples_per_pixel, 100.0 * reached.noise);
        let paths = format!("{samples} photon paths per pixel, noise {noise:.2} %");
        let text = if samples > 0 { paths } else { format!("{:.0} %", 100.0 * reached.share) };
        self.progress.advance_with(done.saturating_sub(before), Some(&text));
    }

    fn interrupted(&self) -> bool {
        stopped()
    }
}

/// Reports the progress of an inversion: the misfit and, if the truth is known, the errors. Prints
/// a line for each step if there is no terminal, or with `--verbose`. Every step is saved in the
/// checkpoint file, if there is one.
pub(crate) struct InversionProgress<'a> {
    progress: Progress,
    every_step: bool,
    checkpoint: Option<(&'a Path, &'a str)>,
}

impl<'a> InversionProgress<'a> {
    /// Starts the report of `what`, which takes at most `steps` steps. `checkpoint` is the path of
    /// the checkpoint file and the text that identifies the inversion.
    pub(crate) fn start(
        global: &Global,
        what: &'static str,
        steps: usize,
        checkpoint: Option<(&'a Path, &'a str)>,
    ) -> Self {
        stop_when_asked();
        let mut progress = Progress::start(global, what, steps as u64);
        let every_step = (progress.lines && !global.quiet) || global.verbose > 0;
        progress.lines = false;
        Self { progress, every_step, checkpoint }
    }

    /// The same report, without a line for each step if there is no terminal.
    pub(crate) fn quiet_without_terminal(self) -> Self {
        Self { every_step: false, ..self }
    }
}

impl inversion::Watch for InversionProgress<'_> {
    fn reached(&self, record: &Record) {
        let stage = record.stage + 1;
        let mut text = match record.block {
            1 => format!("stage {stage}, step {}", record.iteration),
            block => format!("stage {stage}, blocks of {block}, step {}", record.iteration),
        };
        text += &format!(", misfit {:.3}", record.misfit);
        if let (Some(epsilon), Some(delta)) = (record.relative_error, record.mass_error) {
            text += &format!(", epsilon {epsilon:.3}, delta {delta:.3}");
        }
        if self.every_step {
            note!("{}: {text}, {:.1} s", self.progress.what, record.seconds);
        }
        self.progress.advance_with(u64::from(record.iteration > 0), Some(&text));
    }

    fn has_members(&self, count: usize) {
        let text = format!("standard errors, member {count}");
        if self.every_step {
            note!("{}: {text}", self.progress.what);
        }
        self.progress.advance_with(0, Some(&text));
    }

    fn keep(&self, checkpoint: &Checkpoint) -> Result<()> {
        match self.checkpoint {
            Some((path, identity)) => write_checkpoint(path, checkpoint, identity),
            None => Ok(()),
        }
    }

    fn interrupted(&self) -> bool {
        stopped()
    }
}
