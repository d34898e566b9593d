//! Progress on stderr: a bar on a terminal, else a line now and then. Also the signals that stop the work.

mod lines;

use std::io::IsTerminal;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{HumanDuration, ProgressBar, ProgressState, ProgressStyle};
use signal_hook::consts::{SIGINT, SIGTERM};

use self::lines::Lines;
use octobayes::monitor::Monitor;

/// The progress of the current stage.
pub struct Bars {
    current: Mutex<Shown>,
    interrupted: Arc<AtomicBool>,
}

/// What shows the progress.
struct Shown {
    bar: ProgressBar,
    /// If stderr is no terminal.
    lines: Option<Lines>,
}

impl Bars {
    /// No stage yet.
    pub fn new() -> Self {
        let lines = (!std::io::stderr().is_terminal()).then(|| Lines::new(Instant::now()));
        let current = Mutex::new(Shown { bar: ProgressBar::hidden(), lines });
        Self { current, interrupted: Arc::new(AtomicBool::new(false)) }
    }

    /// From now on Ctrl-C and SIGTERM request the work to stop. Ctrl-C after either of them ends the process at once.
    /// SIGHUP keeps its effect: it ends the process, or under `nohup` does nothing.
    pub fn listen(&self) {
        for signal in [SIGINT, SIGTERM] {
            // Without a handler the signal still ends the process, and only temporary files stay behind.
            if signal == SIGINT {
                let _ = signal_hook::flag::register_conditional_shutdown(signal, 130, self.interrupted.clone());
            }
            let _ = signal_hook::flag::register(signal, self.interrupted.clone());
        }
    }

    /// Shows text about the current stage, to the right of the bar.
    pub fn message(&self, text: String) {
        let mut shown = self.shown();
        if let Some(lines) = &mut shown.lines {
            lines.message(text);
        } else {
            shown.bar.set_message(text);
        }
    }

    /// Prints a line to stderr, above the bar if there is one.
    pub fn line(&self, text: &str) {
        let mut shown = self.shown();
        if let Some(lines) = &mut shown.lines {
            lines.printed(Instant::now());
        }
        shown.bar.suspend(|| announce!("{text}"));
    }

    fn shown(&self) -> MutexGuard<'_, Shown> {
        self.current.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Monitor for Bars {
    fn begin(&self, stage: &str, total: u64) {
        let mut shown = self.shown();
        if let Some(lines) = &mut shown.lines {
            lines.begin(stage, total, Instant::now());
            return;
        }
        let left = |state: &ProgressState, out: &mut dyn std::fmt::Write| {
            let _ = match lines::left(f64::from(state.fraction()), state.elapsed()) {
                None => Ok(()),
                Some(left) => write!(out, "{:#} left", HumanDuration(left)),
            };
        };
        let style =
            ProgressStyle::with_template("{prefix:>12} [{bar:36}] {human_pos}/{human_len}  {per_sec}  {left}  {msg}")
                .unwrap_or_else(|_| ProgressStyle::default_bar())
                .with_key("left", left)
                .progress_chars("=> ");
        let bar = ProgressBar::new(total).with_style(style).with_prefix(stage.to_string());
        bar.enable_steady_tick(Duration::from_millis(200));
        shown.bar = bar;
    }

    fn advance(&self, units: u64) {
        let mut shown = self.shown();
        match &mut shown.lines {
            Some(lines) => lines.advance(units, Instant::now()).iter().for_each(|line| announce!("{line}")),
            None => shown.bar.inc(units),
        }
    }

    fn end(&self) {
        self.shown().bar.finish_and_clear();
    }

    fn interrupted(&self) -> bool {
        self.interrupted.load(Ordering::Relaxed)
    }
}

/// A file that exceeds the limit of its size (`ulimit -f`) is an error of writing, as a full disk is, and no signal
/// that ends the process before it can clear up and report it.
pub fn ignore_limit_of_files() {
    #[cfg(unix)]
    let _ = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, Arc::default());
}
