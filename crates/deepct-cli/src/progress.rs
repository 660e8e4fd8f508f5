//! A progress bar on a terminal, plain lines elsewhere.

use crate::global::Global;
use deepct_core::transport::{self, Watch};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Counts finished units of a long work and shows how far it is.
pub(crate) struct Progress {
    what: &'static str,
    total: u64,
    done: AtomicU64,
    bar: Option<ProgressBar>,
    lines: bool,
}

impl Progress {
    /// Start showing `what`, of which there are `total` units.
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
        Self { what, total, done: AtomicU64::new(0), bar, lines }
    }

    /// Note that `units` more are finished. May be called from any thread.
    pub(crate) fn advance(&self, units: u64) {
        self.advance_with(units, None);
    }

    /// Note that `units` more are finished, and say something more of them.
    fn advance_with(&self, units: u64, text: Option<&str>) {
        let before = self.done.fetch_add(units, Ordering::Relaxed);
        if let Some(bar) = &self.bar {
            bar.inc(units);
            if let Some(text) = text {
                bar.set_message(format!("{}: {text}", self.what));
            }
        }
        let quarter = |done: u64| (4 * done).checked_div(self.total).unwrap_or(0);
        if self.lines && quarter(before + units) > quarter(before) {
            match text {
                Some(text) => eprintln!("{}: {text}", self.what),
                None => eprintln!("{}: {} of {}", self.what, before + units, self.total),
            }
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

/// Steps of the bar of a rendering.
const STEPS: u64 = 1000;

/// Set when the user asked to stop, by Ctrl-C.
static STOPPED: AtomicBool = AtomicBool::new(false);

/// Watches a rendering: a bar that tells the noise reached so far. Ctrl-C ends the
/// rendering with what is there; a second one ends the program.
pub(crate) struct RenderProgress {
    progress: Progress,
}

impl RenderProgress {
    /// Start showing `what`.
    pub(crate) fn start(global: &Global, what: &'static str) -> Self {
        // Where there is no such signal, or another handler, the program just ends.
        let _ = ctrlc::set_handler(|| {
            if STOPPED.swap(true, Ordering::Relaxed) {
                std::process::exit(130);
            }
        });
        Self { progress: Progress::start(global, what, STEPS) }
    }
}

impl Watch for RenderProgress {
    fn reached(&self, reached: &transport::Progress) {
        let done = (reached.share * STEPS as f64) as u64;
        let before = self.progress.done.load(Ordering::Relaxed);
        let (samples, noise) = (reached.samples_per_pixel, 100.0 * reached.noise);
        let text = format!("{samples} light paths a pixel, noise {noise:.2} %");
        self.progress.advance_with(done.saturating_sub(before), Some(&text));
    }

    fn interrupted(&self) -> bool {
        STOPPED.load(Ordering::Relaxed)
    }
}
