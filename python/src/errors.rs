//! The library's errors as Python's.

use std::io::ErrorKind;

use octobayes::Error;
use pyo3::exceptions::{
    PyFileNotFoundError, PyFloatingPointError, PyKeyboardInterrupt, PyOSError, PyPermissionError, PyValueError,
};
use pyo3::prelude::*;

/// The exception that says what `error` says.
pub fn to_python(error: &Error) -> PyErr {
    let text = error.to_string();
    match error {
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
        self.map_err(|error| to_python(&error))
    }
}
