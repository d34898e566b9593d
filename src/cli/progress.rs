//! Progress bars on stderr, hidden if that is no terminal, and Ctrl-C.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

use crate::monitor::Monitor;

static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// The progress bar of the current stage.
pub struct Bars {
    current: Mutex<ProgressBar>,
}

impl Bars {
    /// No stage yet. The first Ctrl-C asks the work to stop; a second one ends the process at once.
    pub fn new() -> Self {
        // Without a handler Ctrl-C still ends the process, and only temporary files stay behind.
        let _ = ctrlc::set_handler(|| {
            if INTERRUPTED.swap(true, Ordering::Relaxed) {
                std::process::exit(130);
            }
        });
        Self { current: Mutex::new(ProgressBar::hidden()) }
    }

    /// Shows text about the current stage, to the right of the bar.
    pub fn message(&self, text: String) {
        self.bar().set_message(text);
    }

    /// Prints a line to stderr, above the bar if there is one.
    pub fn line(&self, text: &str) {
        self.bar().suspend(|| eprintln!("{text}"));
    }

    fn bar(&self) -> ProgressBar {
        self.current.lock().map_or_else(|poisoned| poisoned.into_inner().clone(), |bar| bar.clone())
    }
}

impl Monitor for Bars {
    fn begin(&self, stage: &str, total: u64) {
        let style = ProgressStyle::with_template(
            "{prefix:>12} [{bar:36}] {human_pos}/{human_len}  {per_sec}  {eta} left  {msg}",
        )
        .unwrap_or_else(|_| ProgressStyle::default_bar())
        .progress_chars("=> ");
        // `ProgressBar::new` draws to stderr, and only if that is a terminal.
        let bar = ProgressBar::new(total).with_style(style).with_prefix(stage.to_string());
        bar.enable_steady_tick(Duration::from_millis(200));
        if let Ok(mut current) = self.current.lock() {
            *current = bar;
        }
    }

    fn advance(&self, units: u64) {
        self.bar().inc(units);
    }

    fn end(&self) {
        self.bar().finish_and_clear();
    }

    fn interrupted(&self) -> bool {
        INTERRUPTED.load(Ordering::Relaxed)
    }
}
