//! The library's errors and remarks as Python's.

use std::io::ErrorKind;

use octobayes::Error;
use octobayes::monitor::Message;
use octobayes_session::in_flags;
use pyo3::exceptions::{
    PyFileNotFoundError, PyFloatingPointError, PyKeyboardInterrupt, PyOSError, PyPermissionError, PyValueError,
};
use pyo3::prelude::*;

/// What a user should know, and whether it is only a note.
pub type Said = (String, bool);

/// What a remark says, in Python's words.
pub fn said(remark: Message) -> Said {
    match remark {
        Message::Note(text) => (in_arguments(&text), true),
        Message::Warning(text) => (in_arguments(&text), false),
    }
}

/// Values of options that are words.
const WORDS: [&str; 7] = ["auto", "block", "data", "dense", "density", "paper", "ray-count"];

/// The command line's options in a text as arguments: `--rays 4` is `rays=4`, `--scale data` is `scale='data'`,
/// `--box` alone is `box=`, and without the sign where it is what an error is about.
fn in_arguments(text: &str) -> String {
    let (mut out, mut rest) = (String::new(), text);
    while let Some(at) = rest.find("--") {
        let (before, flag) = (&rest[..at], &rest[at + 2..]);
        let is_name = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
        let (name, after) = flag.split_at(flag.find(|c| !is_name(c)).unwrap_or(flag.len()));
        out.push_str(before);
        // Inside a word it is part of the name of a file.
        if before.ends_with(|c: char| c.is_alphanumeric() || "/-_.".contains(c)) || name.is_empty() {
            (out, rest) = (out + "--", flag);
            continue;
        }
        // Keywords of Python have an underscore behind them.
        let name = if ["lambda", "for"].contains(&name) { format!("{name}_") } else { name.replace('-', "_") };
        let word = after.strip_prefix(' ').and_then(|after| after.split(|c| !is_name(c)).next()).unwrap_or_default();
        let is_number = !word.is_empty() && word.bytes().all(|byte| byte.is_ascii_digit());
        let is_value = is_number || WORDS.contains(&word) || (name == "for_" && !word.is_empty());
        let end = match (is_value, is_number) {
            (true, true) => format!("={word}"),
            (true, false) => format!("='{word}'"),
            (false, _) if out.is_empty() && after.starts_with(':') => String::new(),
            (false, _) => "=".into(),
        };
        (out, rest) = (out + &name + &end, if is_value { &after[1 + word.len()..] } else { after });
    }
    out + rest
}

/// The exception that says what `error` says.
pub fn to_python(error: Error) -> PyErr {
    let error = in_flags(error);
    let text = in_arguments(&error.to_string());
    match &error {
        Error::Io { source, .. } => match source.kind() {
            ErrorKind::NotFound => PyFileNotFoundError::new_err(text),
            ErrorKind::PermissionDenied => PyPermissionError::new_err(text),
            _ => PyOSError::new_err(text),
        },
        Error::NonFinite { .. } => PyFloatingPointError::new_err(text),
        Error::Interrupted | Error::InterruptedAfter { .. } | Error::Stopped { .. } => {
            PyKeyboardInterrupt::new_err(text)
        }
        _ => PyValueError::new_err(text),
    }
}

/// Turns the library's results into Python's.
pub trait OrRaise<T> {
    /// The value, or the exception.
    fn or_raise(self) -> PyResult<T>;
}

impl<T> OrRaise<T> for octobayes::Result<T> {
    fn or_raise(self) -> PyResult<T> {
        self.map_err(to_python)
    }
}
