//! One error type for the crate: every message names the file, the place, what was expected and what was found.

use std::io;
use std::path::{Path, PathBuf};

/// What can go wrong; printed as one line. The command line exits with [`Error::exit_code`].
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The operating system refused: missing file, full disk, read-only folder.
    #[error("{path}: {action}: {source}", path = path.display())]
    Io {
        /// The file or folder concerned.
        path: PathBuf,
        /// What was being done, e.g. "cannot open".
        action: &'static str,
        /// The system's own reason.
        source: io::Error,
    },
    /// A file's content is not what its format says.
    #[error("{path}: {place}: expected {expected}, found {found}", path = path.display())]
    Malformed {
        /// The file concerned.
        path: PathBuf,
        /// Where in the file: a key, an array, a byte offset, a line.
        place: String,
        /// What the format asks for there.
        expected: String,
        /// What is there.
        found: String,
    },
    /// A setting that makes no sense, or settings that do not go together.
    #[error("{what}: expected {expected}, found {found}")]
    Setting {
        /// The setting's name as the user knows it.
        what: String,
        /// The accepted range or form.
        expected: String,
        /// The value given.
        found: String,
    },
    /// The field returned NaN, ∞ or a negative density for too large a share of the rays.
    #[error(
        "the field is not finite: {dropped} of {rays} rays dropped (limit {limit_percent} %), first at position \
         [{}, {}, {}]", first[0], first[1], first[2]
    )]
    NonFinite {
        /// Rays dropped because a sample was NaN, infinite or of negative density.
        dropped: u64,
        /// Rays drawn so far.
        rays: u64,
        /// Largest accepted share, in percent.
        limit_percent: f64,
        /// Scene position of the first offending sample.
        first: [f32; 3],
    },
    /// Ctrl-C during training: the model so far was written.
    #[error("interrupted; {path} holds the model after {steps} steps, --resume goes on", path = path.display())]
    Stopped {
        /// The model's file.
        path: PathBuf,
        /// Steps so far.
        steps: u64,
    },
    /// Ctrl-C: the work stopped between two batches and removed its temporary files.
    #[error("interrupted; no output was written")]
    Interrupted,
}

/// The crate's result type.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// Exit code of the command line: 130 after Ctrl-C (the shell's convention for SIGINT), otherwise 2.
    #[must_use]
    pub const fn exit_code(&self) -> u8 {
        match self {
            Self::Interrupted | Self::Stopped { .. } => 130,
            _ => 2,
        }
    }

    /// A closure for `map_err` that names the file and the action.
    pub fn io(path: &Path, action: &'static str) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_path_buf();
        move |source| Self::Io { path, action, source }
    }

    /// Content that does not follow its format.
    pub fn malformed(
        path: &Path,
        place: impl Into<String>,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> Self {
        Self::Malformed {
            path: path.to_path_buf(),
            place: place.into(),
            expected: expected.into(),
            found: found.into(),
        }
    }

    /// A setting outside its range.
    pub fn setting(what: impl Into<String>, expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self::Setting { what: what.into(), expected: expected.into(), found: found.into() }
    }
}
