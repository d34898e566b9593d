//! Files to read.

use std::fs::File;
use std::path::Path;

use crate::{Error, Result};

/// Opens a regular file. A pipe could keep the reader waiting for ever, deaf to signals, and cannot be read twice.
///
/// # Errors
/// If the file is missing or cannot be read, or if `path` is a device or a pipe.
pub fn open(path: &Path) -> Result<File> {
    refuse_pipe(path)?;
    File::open(path).map_err(Error::io(path, "cannot open"))
}

/// The content of a regular file.
///
/// # Errors
/// As [`open`].
pub fn read(path: &Path) -> Result<Vec<u8>> {
    refuse_pipe(path)?;
    std::fs::read(path).map_err(Error::io(path, "cannot read"))
}

/// Refuses what is neither a file nor a folder, which readers refuse in their own words.
///
/// # Errors
/// If `path` is a device or a pipe.
pub fn refuse_pipe(path: &Path) -> Result<()> {
    match std::fs::metadata(path) {
        Ok(metadata) if !metadata.is_file() && !metadata.is_dir() => {
            Err(Error::malformed(path, "input path", "a file", "a device or a pipe"))
        }
        _ => Ok(()),
    }
}
