//! A progress bar on a terminal, plain lines elsewhere.

use crate::global::Global;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::sync::atomic::{AtomicU64, Ordering};

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
        let before = self.done.fetch_add(units, Ordering::Relaxed);
        if let Some(bar) = &self.bar {
            bar.inc(units);
        }
        let quarter = |done: u64| (4 * done).checked_div(self.total).unwrap_or(0);
        if self.lines && quarter(before + units) > quarter(before) {
            eprintln!("{}: {} of {}", self.what, before + units, self.total);
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
