//! Text files.

use std::path::Path;

use crate::{Error, Result};

/// Reads a text file, without the byte order mark that some editors put at its start.
///
/// # Errors
/// If the file is missing or is not UTF-8.
pub fn read_text(path: &Path) -> Result<String> {
    text_of(path, super::read(path)?)
}

/// The text of a file with these bytes, without its byte order mark.
///
/// # Errors
/// If it is not UTF-8.
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
