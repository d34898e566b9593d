//! Containers of older versions: a bincode header, and sections identified by position.

use std::collections::VecDeque;
use std::path::Path;

use serde::de::DeserializeOwned;

use super::container::{Described, Format, MAX_HEADER, Reader, Start};
use crate::{Error, Result};

/// Opens a file of `format` or an older version. Files of version 1 have all but the last few of the sections
/// `names`; each later version has one more.
///
/// # Errors
/// If the file is missing, of another format or newer, or if its header or length is damaged.
pub fn open<H: DeserializeOwned>(path: &Path, format: Format, names: &[&str]) -> Result<(H, Reader)> {
    let start = Start::open(path, format)?;
    let config = bincode::config::standard().with_limit::<MAX_HEADER>();
    let ((header, described), read) =
        bincode::serde::decode_from_slice::<(H, Vec<(u64, u32)>), _>(&start.header, config)
            .map_err(|e| Error::malformed(path, "header", "a description of the file", e.to_string()))?;
    let count = names.len() - (format.1 - start.version) as usize;
    if read != start.header.len() || described.len() != count {
        let expected = format!("{} bytes and {count} sections", start.header.len());
        return Err(Error::malformed(path, "header", expected, format!("{read} and {}", described.len())));
    }
    // Sections that a version did not have yet are present but empty: the checksum of nothing is 0.
    let described = described.into_iter().chain(std::iter::repeat((0, 0)));
    let named = names.iter().zip(described);
    let sections = named.map(|(name, (bytes, crc32))| Described { name: (*name).into(), bytes, crc32 });
    Ok((header, start.sections(sections.collect::<VecDeque<_>>())?))
}
