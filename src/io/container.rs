//! The container of this crate's own files: a header that describes named sections, all checksummed.
//!
//! ```text
//! 8 bytes   magic
//! 3 × u32   format version, header length, CRC-32 of the header
//! header    JSON: { "content": the content's own header, "sections": [{ "name", "bytes", "crc32" }, …] }
//! sections  raw little-endian, one after the other; nothing follows the last
//! ```
//!
//! The header names what it holds, so a new setting breaks no old file. Unknown fields and sections are skipped, and
//! optional ones may be missing. The version is raised only when an older program would misread the file.
//!
//! A reader refuses files that are truncated, altered, of another version, or longer than their header states. It
//! allocates no more than the file holds.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{BufReader, Read, Write};
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::AtomicFile;
use crate::{Error, Result};

/// Largest accepted header, bytes. Headers take a few kilobytes; only a source's name and the number of draws
/// vary.
const MAX_HEADER: usize = 1 << 20;
/// Items read or written at a time, between 16 KiB and 768 KiB.
const CHUNK: usize = 1 << 14;

/// What identifies a kind of file: `(magic, version)`.
pub type Format = (&'static [u8; 8], u32);

/// What a section consists of.
pub trait Item: Copy {
    /// Bytes of one item.
    const SIZE: usize;
    /// Appends the little-endian bytes.
    fn put(self, out: &mut Vec<u8>);
    /// Reads the first [`Item::SIZE`] bytes.
    fn take(bytes: &[u8]) -> Self;
}

macro_rules! number {
    ($($type:ty),*) => { $(
        impl Item for $type {
            const SIZE: usize = size_of::<Self>();
            fn put(self, out: &mut Vec<u8>) {
                out.extend(self.to_le_bytes());
            }
            fn take(bytes: &[u8]) -> Self {
                Self::from_le_bytes(std::array::from_fn(|i| bytes[i]))
            }
        }
    )* };
}

number!(u8, u16, u32, u64, f32, f64);

impl<T: Item, const N: usize> Item for [T; N] {
    const SIZE: usize = N * T::SIZE;
    fn put(self, out: &mut Vec<u8>) {
        self.into_iter().for_each(|v| v.put(out));
    }
    fn take(bytes: &[u8]) -> Self {
        std::array::from_fn(|k| T::take(&bytes[T::SIZE * k..]))
    }
}

/// Calls `visit` with the bytes of `items`, piece by piece.
fn pieces<T: Item>(items: &[T], mut visit: impl FnMut(&[u8]) -> std::io::Result<()>) -> std::io::Result<()> {
    let mut bytes = Vec::with_capacity(CHUNK.min(items.len()) * T::SIZE);
    for chunk in items.chunks(CHUNK) {
        bytes.clear();
        chunk.iter().for_each(|item| item.put(&mut bytes));
        visit(&bytes)?;
    }
    Ok(())
}

/// A section to be written.
pub trait Section {
    /// Calls `visit` with the section's bytes, piece by piece.
    fn visit(&self, visit: &mut dyn FnMut(&[u8]) -> std::io::Result<()>) -> std::io::Result<()>;
}

impl<T: Item> Section for Vec<T> {
    fn visit(&self, visit: &mut dyn FnMut(&[u8]) -> std::io::Result<()>) -> std::io::Result<()> {
        self.as_slice().visit(visit)
    }
}

impl<T: Item> Section for &[T] {
    fn visit(&self, visit: &mut dyn FnMut(&[u8]) -> std::io::Result<()>) -> std::io::Result<()> {
        pieces(self, visit)
    }
}

/// How a file begins: the content's own header, and a description of the sections that follow.
#[derive(Serialize, Deserialize)]
struct Header<H> {
    content: H,
    sections: VecDeque<Described>,
}

/// A section as the header describes it.
#[derive(Serialize, Deserialize)]
struct Described {
    name: String,
    bytes: u64,
    crc32: u32,
}

/// Writes a file. It appears complete or not at all.
pub fn write(path: &Path, format: Format, content: &impl Serialize, sections: &[(&str, &dyn Section)]) -> Result<()> {
    let mut described = VecDeque::new();
    for (name, section) in sections {
        let (mut bytes, mut crc) = (0_u64, crc32fast::Hasher::new());
        let described_all = section.visit(&mut |piece| {
            bytes += piece.len() as u64;
            crc.update(piece);
            Ok(())
        });
        described_all.map_err(Error::io(path, "cannot describe"))?;
        described.push_back(Described { name: (*name).into(), bytes, crc32: crc.finalize() });
    }
    let header = serde_json::to_vec(&Header { content, sections: described })
        .map_err(|e| Error::malformed(path, "header", "an encodable header", e.to_string()))?;
    if header.len() > MAX_HEADER {
        return Err(Error::malformed(path, "header", format!("at most {MAX_HEADER} bytes"), header.len().to_string()));
    }
    let mut file = AtomicFile::create(path)?;
    let mut write = || {
        file.write_all(format.0)?;
        for word in [format.1, header.len() as u32, crc32fast::hash(&header)] {
            file.write_all(&word.to_le_bytes())?;
        }
        file.write_all(&header)?;
        sections.iter().try_for_each(|(_, section)| section.visit(&mut |bytes| file.write_all(bytes)))
    };
    write().map_err(Error::io(path, "cannot write"))?;
    file.commit()
}

/// A file being read. Its sections are taken in order.
pub struct Reader {
    file: BufReader<File>,
    path: PathBuf,
    sections: VecDeque<Described>,
}

impl Reader {
    /// Opens a file of this `format`, and reads its header. Checks the lengths of its sections against the file's.
    pub fn open<H: DeserializeOwned>(path: &Path, format: Format) -> Result<(H, Self)> {
        let file = super::open(path)?;
        let length = file.metadata().map_err(Error::io(path, "cannot read"))?.len();
        let mut file = BufReader::with_capacity(1 << 16, file);
        let magic = String::from_utf8_lossy(format.0).trim().to_string();

        let mut start = [0; 20];
        let truncated =
            |_| Error::malformed(path, "start", format!("a file of format `{magic}`"), "a file that ends early");
        file.read_exact(&mut start).map_err(truncated)?;
        if &start[..8] != format.0 {
            return Err(Error::malformed(path, "start", format!("a file of format `{magic}`"), "other bytes"));
        }
        let word = |at: usize| u32::take(&start[at..]);
        let (version, header_length, crc) = (word(8), word(12) as usize, word(16));
        if version != format.1 {
            let newer = if version > format.1 { "; a newer octobayes may read it" } else { "" };
            let found = format!("version {version}{newer}");
            return Err(Error::malformed(path, "format", format!("version {}", format.1), found));
        }
        if header_length > MAX_HEADER {
            let expected = format!("at most {MAX_HEADER} bytes");
            return Err(Error::malformed(path, "header", expected, header_length.to_string()));
        }
        let mut header = vec![0; header_length];
        file.read_exact(&mut header).map_err(truncated)?;
        if crc32fast::hash(&header) != crc {
            return Err(Error::malformed(path, "header", "its stored checksum", "altered data"));
        }
        let Header { content, sections } = serde_json::from_slice::<Header<H>>(&header)
            .map_err(|e| Error::malformed(path, "header", "a description of the file", e.to_string()))?;
        let expected = sections.iter().try_fold(20 + header.len() as u64, |sum, s| sum.checked_add(s.bytes));
        if expected != Some(length) {
            let expected = expected.map_or("a possible length".into(), |n| format!("{n} bytes"));
            let found = format!("{length} bytes (truncated or altered)");
            return Err(Error::malformed(path, "length", expected, found));
        }
        Ok((content, Self { file, path: path.to_path_buf(), sections }))
    }

    /// Bytes of the next section of this name; 0 if none follows.
    #[must_use]
    pub fn bytes(&self, name: &str) -> u64 {
        self.sections.iter().find(|section| section.name == name).map_or(0, |section| section.bytes)
    }

    /// Reads and checks the next section of this name. Sections of other names before it are skipped.
    pub fn section<T: Item>(&mut self, name: &str) -> Result<Vec<T>> {
        let mut items = Vec::new();
        self.pieces::<T>(name, |bytes, left| {
            // The lengths were checked against the file's, so this allocates no more than the file holds.
            items.reserve_exact(left);
            items.extend(bytes.chunks_exact(T::SIZE).map(T::take));
            Ok(())
        })?;
        Ok(items)
    }

    /// Reads the next section of this name piece by piece, and checks it. Calls `visit` with each piece, whole items,
    /// and how many items are left with those. Sections of other names before it are skipped.
    pub fn pieces<T: Item>(&mut self, name: &str, mut visit: impl FnMut(&[u8], usize) -> Result<()>) -> Result<()> {
        let path = &self.path;
        let missing = || Error::malformed(path, "header", format!("a section `{name}`"), "none");
        let at = self.sections.iter().position(|section| section.name == name).ok_or_else(missing)?;
        let unknown = self.sections.drain(..at).map(|section| section.bytes).sum::<u64>();
        // The sum of their lengths is below the file's length, so it fits.
        self.file.seek_relative(unknown as i64).map_err(Error::io(path, "cannot read"))?;
        let Described { bytes: length, crc32, .. } = self.sections.pop_front().ok_or_else(missing)?;
        if !length.is_multiple_of(T::SIZE as u64) {
            let expected = format!("a multiple of {} bytes", T::SIZE);
            return Err(Error::malformed(path, format!("section `{name}`"), expected, format!("{length} bytes")));
        }
        let mut left = (length / T::SIZE as u64) as usize;
        let mut hasher = crc32fast::Hasher::new();
        let mut bytes = vec![0; CHUNK.min(left) * T::SIZE];
        while left > 0 {
            let n = left.min(CHUNK);
            let bytes = &mut bytes[..n * T::SIZE];
            self.file.read_exact(bytes).map_err(Error::io(path, "cannot read"))?;
            hasher.update(bytes);
            visit(bytes, left)?;
            left -= n;
        }
        if hasher.finalize() == crc32 {
            Ok(())
        } else {
            Err(Error::malformed(path, format!("section `{name}`"), "its stored checksum", "altered data"))
        }
    }
}
