//! How long work reports progress and receives the request to stop, and its messages. The library itself never
//! prints.

use std::fmt;

/// Receives progress, and may stop the work. The command line implements it with progress bars.
pub trait Monitor: Sync {
    /// A new stage of `total` units begins.
    fn begin(&self, stage: &str, total: u64);
    /// `units` more units of the current stage are done.
    fn advance(&self, units: u64);
    /// The current stage is done.
    fn end(&self);
    /// True once the user has requested a stop. Work then returns [`crate::Error::Interrupted`] at the next safe point.
    fn interrupted(&self) -> bool;
}

/// A monitor that shows nothing and never stops the work.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Monitor for Silent {
    fn begin(&self, _stage: &str, _total: u64) {}
    fn advance(&self, _units: u64) {}
    fn end(&self) {}
    fn interrupted(&self) -> bool {
        false
    }
}

/// Returns [`crate::Error::Interrupted`] if the user has requested a stop.
///
/// # Errors
/// [`crate::Error::Interrupted`] only.
pub fn check(monitor: &dyn Monitor) -> crate::Result<()> {
    if monitor.interrupted() { Err(crate::Error::Interrupted) } else { Ok(()) }
}

/// A message to the user, one sentence.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Message {
    /// What was assumed or left out.
    Note(String),
    /// What is probably wrong.
    Warning(String),
}

impl fmt::Display for Message {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Note(text) => write!(f, "note: {text}"),
            Self::Warning(text) => write!(f, "warning: {text}"),
        }
    }
}
