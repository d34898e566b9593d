//! Whole files, as bytes or as text.

use std::path::Path;

use super::refuse_pipe;
use crate::{Error, Result};

/// The content of a regular file.
pub fn read(path: &Path) -> Result<Vec<u8>> {
    refuse_pipe(path)?;
    std::fs::read(path).map_err(Error::io(path, "cannot read"))
}

/// Reads a text file, without the byte order mark that some editors put at its start.
pub fn read_text(path: &Path) -> Result<String> {
    text_of(path, read(path)?)
}

/// The text of a file with these bytes, without its byte order mark.
pub fn text_of(path: &Path, bytes: Vec<u8>) -> Result<String> {
    let mut text = String::from_utf8(bytes).map_err(|e| {
        let at = e.utf8_error().valid_up_to();
        Error::malformed(path, format!("byte {at}"), "text in UTF-8", format!("{:#04x}", e.as_bytes()[at]))
    })?;
    if text.starts_with('\u{feff}') {
        text.drain(..'\u{feff}'.len_utf8());
    }
    Ok(text)
}
