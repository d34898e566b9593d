//! Text files.

use std::path::Path;

use super::refuse_pipe;
use crate::{Error, Result};

/// Reads a text file, without the byte order mark that some editors put at its start.
///
/// # Errors
/// If the file is missing or is not UTF-8.
pub fn read_text(path: &Path) -> Result<String> {
    refuse_pipe(path)?;
    let mut text = std::fs::read_to_string(path).map_err(Error::io(path, "cannot read"))?;
    if text.starts_with('\u{feff}') {
        text.drain(..'\u{feff}'.len_utf8());
    }
    Ok(text)
}
