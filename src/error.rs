//! One error type for the crate: every message names the file, the place, what was expected and what was found.

use std::path::{Path, PathBuf};
use std::{fmt, io};

/// Everything that can go wrong, printed as one line. The command line exits with [`Error::exit_code`].
#[derive(Debug)]
#[non_exhaustive]
pub enum Error {
    /// The operating system refused: missing file, full disk, read-only folder.
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What was attempted, e.g. "cannot open".
        action: &'static str,
        /// The system's own reason.
        source: io::Error,
    },
    /// A file's content does not follow its format.
    Malformed {
        /// The file.
        path: PathBuf,
        /// Where in the file: a key, an array, a byte offset, a line.
        place: String,
        /// What the format requires there.
        expected: String,
        /// What is there.
        found: String,
    },
    /// A setting makes no sense, or settings do not go together.
    Setting {
        /// The setting's name as the user sees it.
        what: String,
        /// The accepted range or form.
        expected: String,
        /// The value given.
        found: String,
    },
    /// The field returned NaN, ∞ or a negative density on too large a share of the rays.
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
    /// Ctrl-C during training; the model so far was written.
    Stopped {
        /// The model's file.
        path: PathBuf,
        /// Training steps so far.
        steps: u64,
    },
    /// Ctrl-C; the work stopped between two of its results, and the first ones are there.
    InterruptedAfter {
        /// What is there.
        finished: String,
    },
    /// Ctrl-C; the work stopped between two batches and removed its temporary files.
    Interrupted,
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Io { path, action, source } => write!(f, "{}: {action}: {source}", shown(path)),
            Self::Malformed { path, place, expected, found } => {
                write!(f, "{}: {place}: expected {expected}, found {found}", shown(path))
            }
            Self::Setting { what, expected, found } => write!(f, "{what}: expected {expected}, found {found}"),
            Self::NonFinite { dropped, rays, limit_percent, first: [x, y, z] } => write!(
                f,
                "the field is not finite: {dropped} of {rays} rays dropped (limit {limit_percent} %), first at \
                 position [{x}, {y}, {z}]"
            ),
            Self::Stopped { path, steps } => {
                write!(f, "interrupted; {} holds the model after {steps} steps", shown(path))
            }
            Self::InterruptedAfter { finished } => write!(f, "interrupted; {finished}"),
            Self::Interrupted => write!(f, "interrupted; no output was written"),
        }
    }
}

impl std::error::Error for Error {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Io { source, .. } => Some(source),
            _ => None,
        }
    }
}

/// The crate's result type.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// Exit code of the command line: 130 after Ctrl-C (the shell's convention for SIGINT) and SIGTERM,
    /// otherwise 2.
    #[must_use]
    pub const fn exit_code(&self) -> u8 {
        match self {
            Self::Interrupted | Self::InterruptedAfter { .. } | Self::Stopped { .. } => 130,
            _ => 2,
        }
    }

    /// A closure for `map_err` that names the file and the action.
    pub fn io(path: &Path, action: &'static str) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_path_buf();
        move |source| Self::Io { path, action, source }
    }

    /// [`Error::Malformed`] from its parts, each made fit for one line on a terminal.
    pub fn malformed(
        path: &Path,
        place: impl Into<String>,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> Self {
        Self::Malformed {
            path: path.to_path_buf(),
            place: printable(&place.into()),
            expected: cut_printable(&expected.into(), LONGEST_OWN),
            found: printable(&found.into()),
        }
    }

    /// [`Error::Malformed`] of a file whose name does not end as it should.
    #[doc(hidden)]
    pub fn extension(path: &Path, expected: impl Into<String>) -> Self {
        let found = path.extension().map_or("none".into(), |found| format!("`.{}`", found.display()));
        Self::malformed(path, "file name", expected, found)
    }

    /// [`Error::Setting`] from its parts, each made fit for one line on a terminal.
    pub fn setting(what: impl Into<String>, expected: impl Into<String>, found: impl Into<String>) -> Self {
        let expected = cut_printable(&expected.into(), LONGEST_OWN);
        Self::Setting { what: printable(&what.into()), expected, found: printable(&found.into()) }
    }
}

/// Longest text quoted in a message, characters.
const LONGEST: usize = 300;

/// Longest text of the program itself, which a list of causes makes long; characters. What is expected comes from here,
/// what is found from files.
const LONGEST_OWN: usize = 2000;

/// Longest path that systems open, bytes: longer ones are cut.
const LONGEST_PATH: usize = 4096;

/// A number of things in words, such as `1 frame` and `2 frames`.
#[doc(hidden)]
#[must_use]
pub fn counted(count: usize, noun: &str) -> String {
    let plural = if count == 1 { "" } else { "s" };
    format!("{count} {noun}{plural}")
}

/// Makes a text that may quote an untrusted file fit for one line on a terminal.
///
/// Control characters, which could clear the screen, are escaped. Texts longer than [`LONGEST`] are cut.
#[doc(hidden)]
#[must_use]
pub fn printable(text: &str) -> String {
    cut_printable(text, LONGEST)
}

/// The same for a path, which may come from a camera file. It is whole, so that it can be found.
fn shown(path: &Path) -> String {
    cut_printable(&path.display().to_string(), LONGEST_PATH)
}

fn cut_printable(text: &str, longest: usize) -> String {
    let mut out = String::with_capacity(text.len().min(4 * longest));
    for (n, c) in text.chars().enumerate() {
        match c {
            _ if n == longest => {
                out.push('…');
                break;
            }
            // The others turn the direction of writing, or end a line.
            c if c.is_control() || matches!(c, '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}') => {
                out.extend(c.escape_default());
            }
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quotations_are_one_short_line() {
        let text = format!("a\n\u{1b}[2Jé{}", "x".repeat(10_000));
        let error = Error::malformed(Path::new("f"), text.as_str(), "b", text.as_str()).to_string();
        assert!(error.starts_with("f: a\\n\\u{1b}[2Jéxxx") && error.ends_with("x…"), "{error}");
        assert!(error.chars().count() < 2 * LONGEST + 50 && !error.contains('\n'), "{error}");
    }

    #[test]
    fn what_is_expected_is_told_to_its_end() {
        let causes = format!("one of {}the last", "another cause, or ".repeat(40));
        for error in
            [Error::setting("cameras", &causes, "none"), Error::malformed(Path::new("f"), "x", &causes, "none")]
        {
            assert!(error.to_string().ends_with("the last, found none"), "{error}");
        }
    }

    #[test]
    fn paths_are_one_line_too() {
        let path = format!("a\n\u{1b}[2J\u{9b}m\u{202e}é/{}.png", "x".repeat(1000));
        let missing = || io::Error::from(io::ErrorKind::NotFound);
        for error in [
            Error::malformed(Path::new(&path), "b", "c", "d"),
            Error::io(Path::new(&path), "cannot open")(missing()),
            Error::Stopped { path: path.clone().into(), steps: 1 },
        ] {
            let error = error.to_string();
            let expected = format!("a\\n\\u{{1b}}[2J\\u{{9b}}m\\u{{202e}}é/{}.png", "x".repeat(1000));
            assert!(error.contains(&expected), "{error}");
        }
        let endless = "x".repeat(10 * LONGEST_PATH);
        let error = Error::io(Path::new(&endless), "cannot open")(missing()).to_string();
        assert!(error.chars().count() < LONGEST_PATH + 100, "{}", error.len());
    }
}
