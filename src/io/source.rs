//! Files to read.

use std::fs::File;
use std::path::Path;

use crate::{Error, Result};

/// Opens a regular file. A pipe could keep the reader waiting for ever, deaf to signals, and cannot be read twice.
pub fn open(path: &Path) -> Result<File> {
    refuse_pipe(path)?;
    File::open(path).map_err(Error::io(path, "cannot open"))
}

/// Refuses what is neither a file nor a folder, which readers refuse in their own words.
pub fn refuse_pipe(path: &Path) -> Result<()> {
    match std::fs::metadata(path) {
        Ok(metadata) if !metadata.is_file() && !metadata.is_dir() => {
            Err(Error::malformed(path, "input path", "a file", "a device or a pipe"))
        }
        _ => Ok(()),
    }
}
