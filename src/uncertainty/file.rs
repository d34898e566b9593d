//! The field file, `.oct`.
//!
//! ```text
//! 8 bytes   magic "OCTOBAY\n"
//! 3 × u32   format version, header length, CRC-32 of the header
//! header    bincode: protocol, lattice, kind of support, and for each section its length in bytes and CRC-32
//! sections  raw little-endian, one after the other, nothing behind the last:
//!           masks        u8         child masks of the octree, breadth first (empty for a dense grid)
//!           deviations   f32        σ_v, vertices in Morton order (octree) or x slowest (dense)
//!           information  f64 × 6    S_v, or empty
//!           surface      f32 × 3    points on visible surfaces
//! ```
//!
//! The octree is rebuilt from its masks, so a file cannot hold an inconsistent one. A reader refuses what is truncated, altered,
//! longer than it says, or newer.

use std::fs::File;
use std::io::{BufReader, Read, Write};
use std::path::Path;

use super::{Protocol, Support, UncertaintyField, vertex_count};
use crate::geometry::{Aabb, Lattice};
use crate::io::AtomicFile;
use crate::octree::Octree;
use crate::posterior::Information;
use crate::{Error, Result};

/// Version that this crate writes, and the newest that it reads.
pub const FORMAT_VERSION: u32 = 1;
const MAGIC: &[u8; 8] = b"OCTOBAY\n";
/// Headers are a few hundred bytes; the only variable part is the source's name.
const MAX_HEADER: usize = 1 << 16;

#[derive(serde::Serialize, serde::Deserialize)]
struct Header {
    protocol: Protocol,
    lattice: Lattice,
    kind: Kind,
    /// Length in bytes and CRC-32 of the four sections.
    sections: [(u64, u32); 4],
}

#[derive(serde::Serialize, serde::Deserialize)]
enum Kind {
    Dense,
    Octree { root_split: bool },
}

/// A section: little-endian numbers of one type, written and read in chunks.
trait Item: Copy {
    const SIZE: usize;
    fn put(self, out: &mut Vec<u8>);
    fn take(bytes: &[u8]) -> Self;
}

impl Item for u8 {
    const SIZE: usize = 1;
    fn put(self, out: &mut Vec<u8>) {
        out.push(self);
    }
    fn take(bytes: &[u8]) -> Self {
        bytes[0]
    }
}

impl Item for f32 {
    const SIZE: usize = 4;
    fn put(self, out: &mut Vec<u8>) {
        out.extend(self.to_le_bytes());
    }
    fn take(bytes: &[u8]) -> Self {
        Self::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])
    }
}

impl Item for [f32; 3] {
    const SIZE: usize = 12;
    fn put(self, out: &mut Vec<u8>) {
        self.iter().for_each(|v| v.put(out));
    }
    fn take(bytes: &[u8]) -> Self {
        std::array::from_fn(|k| f32::take(&bytes[4 * k..]))
    }
}

impl Item for Information {
    const SIZE: usize = 48;
    fn put(self, out: &mut Vec<u8>) {
        self.iter().for_each(|v| out.extend(v.to_le_bytes()));
    }
    fn take(bytes: &[u8]) -> Self {
        std::array::from_fn(|k| f64::from_le_bytes(std::array::from_fn(|i| bytes[8 * k + i])))
    }
}

/// Items per chunk: between 16 KiB and 768 KiB.
const CHUNK: usize = 1 << 14;

/// The section's bytes in chunks.
fn chunks<T: Item>(items: &[T], mut visit: impl FnMut(&[u8]) -> std::io::Result<()>) -> std::io::Result<()> {
    let mut bytes = Vec::with_capacity(CHUNK * T::SIZE);
    for chunk in items.chunks(CHUNK) {
        bytes.clear();
        chunk.iter().for_each(|item| item.put(&mut bytes));
        visit(&bytes)?;
    }
    Ok(())
}

/// Length and checksum of a section.
fn describe<T: Item>(items: &[T]) -> (u64, u32) {
    let mut crc = crc32fast::Hasher::new();
    chunks(items, |bytes| {
        crc.update(bytes);
        Ok(())
    })
    .expect("the visitor cannot fail");
    ((items.len() * T::SIZE) as u64, crc.finalize())
}

fn read_section<T: Item>(file: &mut impl Read, path: &Path, name: &str, (length, crc): (u64, u32)) -> Result<Vec<T>> {
    if !length.is_multiple_of(T::SIZE as u64) {
        let expected = format!("a multiple of {} bytes", T::SIZE);
        return Err(Error::malformed(path, format!("section `{name}`"), expected, format!("{length} bytes")));
    }
    // The caller has compared the lengths with the file's, so this allocates no more than is there.
    let mut left = (length / T::SIZE as u64) as usize;
    let mut items = Vec::with_capacity(left);
    let mut hasher = crc32fast::Hasher::new();
    let mut bytes = vec![0; CHUNK * T::SIZE];
    while left > 0 {
        let n = left.min(CHUNK);
        let bytes = &mut bytes[..n * T::SIZE];
        file.read_exact(bytes).map_err(Error::io(path, "cannot read"))?;
        hasher.update(bytes);
        items.extend(bytes.chunks_exact(T::SIZE).map(T::take));
        left -= n;
    }
    if hasher.finalize() == crc {
        Ok(items)
    } else {
        Err(Error::malformed(path, format!("section `{name}`"), "its stored checksum", "altered data"))
    }
}

impl UncertaintyField {
    /// Writes the field; the file appears complete or not at all.
    ///
    /// # Errors
    /// If the folder cannot be written or the disk is full.
    pub fn write(&self, path: &Path) -> Result<()> {
        let (kind, masks) = match &self.support {
            Support::Dense => (Kind::Dense, &[][..]),
            Support::Octree(octree) => {
                let (root_split, masks) = octree.cells().raw();
                (Kind::Octree { root_split }, masks)
            }
        };
        let information = self.information.as_deref().unwrap_or_default();
        let header = Header {
            protocol: self.protocol.clone(),
            lattice: self.lattice,
            kind,
            sections: [describe(masks), describe(&self.deviations), describe(information), describe(&self.surface)],
        };
        let header = bincode::serde::encode_to_vec(&header, bincode::config::standard())
            .map_err(|e| Error::malformed(path, "header", "an encodable header", e.to_string()))?;
        if header.len() > MAX_HEADER {
            return Err(Error::malformed(
                path,
                "header",
                format!("at most {MAX_HEADER} bytes"),
                header.len().to_string(),
            ));
        }
        let mut file = AtomicFile::create(path)?;
        let mut write = || {
            file.write_all(MAGIC)?;
            for word in [FORMAT_VERSION, header.len() as u32, crc32fast::hash(&header)] {
                file.write_all(&word.to_le_bytes())?;
            }
            file.write_all(&header)?;
            chunks(masks, |bytes| file.write_all(bytes))?;
            chunks(&self.deviations, |bytes| file.write_all(bytes))?;
            chunks(information, |bytes| file.write_all(bytes))?;
            chunks(&self.surface, |bytes| file.write_all(bytes))
        };
        write().map_err(Error::io(path, "cannot write"))?;
        file.commit()
    }

    /// Reads a field.
    ///
    /// # Errors
    /// If the file is missing, or is not a complete, unaltered field of a version that is known.
    pub fn read(path: &Path) -> Result<Self> {
        let file = File::open(path).map_err(Error::io(path, "cannot open"))?;
        let length = file.metadata().map_err(Error::io(path, "cannot read"))?.len();
        let mut file = BufReader::with_capacity(1 << 16, file);
        let header = read_header(&mut file, path, length)?;
        // Deserialising bypasses the constructors' checks.
        let bounds = Aabb::new(header.lattice.bounds().min(), header.lattice.bounds().max());
        let lattice = bounds
            .and_then(|bounds| Lattice::new(bounds, header.lattice.level()))
            .map_err(|e| Error::malformed(path, "header", "a valid box and level", e.to_string()))?;
        let protocol = header.protocol;
        if !(protocol.lambda > 0.0 && protocol.lambda.is_finite() && protocol.rays > 0) {
            let found = format!("lambda {}, rays {}", protocol.lambda, protocol.rays);
            return Err(Error::malformed(path, "header", "positive lambda and rays", found));
        }
        let [masks, deviations, information, surface] = header.sections;
        let masks: Vec<u8> = read_section(&mut file, path, "masks", masks)?;
        let deviations: Vec<f32> = read_section(&mut file, path, "deviations", deviations)?;
        let information: Vec<Information> = read_section(&mut file, path, "information", information)?;
        let surface = read_section(&mut file, path, "surface", surface)?;

        let support =
            match header.kind {
                Kind::Dense => Support::Dense,
                Kind::Octree { root_split } => Octree::from_raw(lattice.level(), root_split, &masks)
                    .map(Support::Octree)
                    .map_err(|problem| Error::malformed(path, "section `masks`", "a balanced octree", problem))?,
            };
        let vertices = vertex_count(&lattice, &support);
        let counts = [("deviations", deviations.len()), ("information", information.len())];
        for (name, count) in counts {
            if count as u64 != vertices && !(name == "information" && count == 0) {
                let expected = format!("{vertices} entries, one per vertex");
                return Err(Error::malformed(path, format!("section `{name}`"), expected, count.to_string()));
            }
        }
        if let Some(i) = deviations.iter().position(|&d| !(d > 0.0 && d.is_finite())) {
            let found = deviations[i].to_string();
            return Err(Error::malformed(path, format!("section `deviations`, entry {i}"), "a positive number", found));
        }
        let information = (!information.is_empty()).then_some(information);
        Ok(Self { protocol, lattice, support, deviations, information, surface })
    }
}

/// Reads everything before the sections and checks that the file is as long as it says.
fn read_header(file: &mut impl Read, path: &Path, length: u64) -> Result<Header> {
    let mut start = [0; 20];
    let truncated = |_| Error::malformed(path, "start", "an octobayes field", "a file that ends early");
    file.read_exact(&mut start).map_err(truncated)?;
    if &start[..8] != MAGIC {
        return Err(Error::malformed(path, "start", "an octobayes field (`OCTOBAY`)", "other bytes"));
    }
    let word = |at: usize| u32::from_le_bytes([start[at], start[at + 1], start[at + 2], start[at + 3]]);
    let (version, header_length, crc) = (word(8), word(12) as usize, word(16));
    if version == 0 || version > FORMAT_VERSION {
        let expected = format!("version 1 to {FORMAT_VERSION}");
        return Err(Error::malformed(
            path,
            "format",
            expected,
            format!("version {version}; a newer octobayes may read it"),
        ));
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
    let config = bincode::config::standard().with_limit::<MAX_HEADER>();
    let (header, read) = bincode::serde::decode_from_slice::<Header, _>(&header, config)
        .map_err(|e| Error::malformed(path, "header", "a field's description", e.to_string()))?;
    if read != header_length {
        return Err(Error::malformed(path, "header", format!("{header_length} bytes"), format!("{read} used")));
    }
    let expected = header.sections.iter().try_fold(20 + header_length as u64, |sum, s| sum.checked_add(s.0));
    if expected != Some(length) {
        let expected = expected.map_or("a possible length".into(), |n| format!("{n} bytes"));
        return Err(Error::malformed(path, "length", expected, format!("{length} bytes (truncated or altered)")));
    }
    Ok(header)
}
