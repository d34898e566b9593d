//! `.spz` of Niantic, versions 1 to 4: 16 to 20 bytes a splat and its higher coefficients, in one gzip stream or, from
//! version 4 on, in one zstd stream per parameter.
//!
//! Axes are x right, y up, z back. They are turned to those of PLY files, y down and z forward.

mod pack;
mod turn;
mod write;
mod xxh64;

use std::io::Read;
use std::ops::Range;
use std::path::Path;

use flate2::bufread::GzDecoder;
use glam::{Vec3, Vec4};
use half::f16;
use ruzstd::decoding::StreamingDecoder;

use self::turn::{STORED, Turn};
use self::xxh64::xxh64;
use super::super::columns::{Layout, Packing};
use super::super::{RenderMode, Splats, coefficients};
use super::raw::{Raw, logit};
use octobayes::{Error, Result};

pub(super) use self::write::write;

/// What every file begins with once it is unpacked.
const MAGIC: &[u8] = b"NGSP";
const GZIP: &[u8] = b"\x1f\x8b";
/// Header of versions 1 to 3, and what version 4 has in common with it.
const HEADER: usize = 16;
/// Header of version 4.
const HEADER_4: usize = 32;

/// The render mode is mip.
const ANTIALIASED: u8 = 1;
/// Records of other programs follow.
const EXTENSIONS: u8 = 2;

/// Unpacked content that is read whatever the size of the file, bytes.
const ALWAYS: u64 = 4 << 20;
/// Beyond that, unpacked bytes per byte of the file. Trained scenes have 1 to 4. In memory splats take up to eight
/// times as much as unpacked.
const LARGEST_RATIO: u64 = 32;
/// Smallest limit of a zstd window (RFC 8878 recommends 8 MB to decoders).
const WINDOW: u64 = 8 << 20;

/// The header.
struct Header {
    version: u32,
    count: usize,
    degree: u8,
    /// Bits of a coordinate behind the point.
    fractional_bits: u8,
    flags: u8,
}

/// Where the parameters lie in the unpacked bytes.
struct Parts {
    positions: Range<usize>,
    alphas: Range<usize>,
    colors: Range<usize>,
    scales: Range<usize>,
    rotations: Range<usize>,
    sh: Range<usize>,
}

impl Header {
    fn parse(path: &Path, bytes: &[u8], file_size: usize) -> Result<Self> {
        let wrong = |place: &str, expected: &str, found: String| Err(Error::malformed(path, place, expected, found));
        if bytes.len() < HEADER || !bytes.starts_with(MAGIC) {
            let found = format!("`{}`", bytes[..bytes.len().min(HEADER)].escape_ascii());
            return wrong("header", "`NGSP` and 12 bytes more", found);
        }
        let word = |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        let [degree, fractional_bits, flags] = [12, 13, 14].map(|at: usize| bytes[at]);
        let header = Self { version: word(4), count: word(8) as usize, degree, fractional_bits, flags };
        if !(1..=4).contains(&header.version) {
            return wrong("header, version", "1 to 4", header.version.to_string());
        }
        if degree > super::super::MAX_DEGREE {
            return wrong("header, degree of spherical harmonics", "0 to 3", degree.to_string());
        }
        if fractional_bits > 24 {
            return wrong("header, fractional bits", "at most 24", fractional_bits.to_string());
        }
        if flags & !(ANTIALIASED | EXTENSIONS) != 0 {
            return wrong("header, flags", "1 (antialiased) and 2 (extensions) alone", flags.to_string());
        }
        let (size, most) = (header.size() as u64, ALWAYS.max(LARGEST_RATIO * file_size as u64));
        if size > most {
            let expected = format!("splats of at most {most} bytes in a file of {file_size}");
            return wrong("header, number of splats", &expected, format!("{} ({size} bytes)", header.count));
        }
        Ok(header)
    }

    /// Bytes of a splat in each part.
    fn sizes(&self) -> [usize; 6] {
        let higher = 3 * (coefficients(self.degree) - 1);
        [if self.version == 1 { 6 } else { 9 }, 1, 3, 3, if self.version < 3 { 3 } else { 4 }, higher]
    }

    fn parts(&self) -> Parts {
        let mut end = 0;
        let [positions, alphas, colors, scales, rotations, sh] = self.sizes().map(|size| {
            let start = end;
            end += self.count * size;
            start..end
        });
        Parts { positions, alphas, colors, scales, rotations, sh }
    }

    /// Number of unpacked bytes after the header.
    fn size(&self) -> usize {
        self.count * self.sizes().iter().sum::<usize>()
    }
}

/// True for bytes that a file of this format begins with.
pub(super) fn is_spz(bytes: &[u8]) -> bool {
    bytes.starts_with(MAGIC) || bytes.starts_with(GZIP)
}

/// Reads the bytes of a `.spz` file.
pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<Splats> {
    if bytes.starts_with(GZIP) {
        let mut unpacked = GzDecoder::new(bytes);
        let left = |unpacked: &GzDecoder<&[u8]>| unpacked.get_ref().len();
        return one_stream(path, &mut unpacked, bytes.len(), &left);
    }
    let header = Header::parse(path, bytes, bytes.len())?;
    // Versions 1 to 3 are also found without gzip.
    if header.version < 4 { one_stream(path, &mut &*bytes, bytes.len(), &|_| 0) } else { streams(path, bytes, &header) }
}

/// Versions 1 to 3: header, parameters, extensions. `left` is how many bytes of the file are not yet unpacked.
fn one_stream<R: Read>(path: &Path, unpacked: &mut R, file_size: usize, left: &dyn Fn(&R) -> usize) -> Result<Splats> {
    let broken = |e: std::io::Error| Error::malformed(path, "gzip stream", "a whole stream", e.to_string());
    let mut start = Vec::new();
    unpacked.by_ref().take(HEADER as u64).read_to_end(&mut start).map_err(broken)?;
    let header = Header::parse(path, &start, file_size)?;
    if header.version > 3 {
        return Err(Error::malformed(path, "header, version", "1 to 3 in one stream", header.version.to_string()));
    }
    let (mut body, most) = (Vec::new(), header.size());
    unpacked.by_ref().take(most as u64).read_to_end(&mut body).map_err(broken)?;
    let mut rest = Vec::new();
    unpacked.by_ref().take(turn::MOST_EXTENSIONS + 1).read_to_end(&mut rest).map_err(broken)?;
    let has_extensions = header.flags & EXTENSIONS != 0;
    if body.len() < header.size() || (!rest.is_empty() && !has_extensions) {
        let expected = format!("{most} bytes after the header");
        let more = if rest.is_empty() { "" } else { " or more" };
        let found = format!("{}{more}", body.len() + rest.len());
        return Err(Error::malformed(path, "length", expected, found));
    }
    let stored = if has_extensions { turn::stored_axes(path, &rest)? } else { STORED };
    if left(unpacked) > 0 {
        let found = format!("{} bytes", left(unpacked));
        return Err(Error::malformed(path, "length", "nothing after the gzip stream", found));
    }
    splats(path, &header, &body, stored)
}

/// Version 4: header, extensions, table of streams, streams.
fn streams(path: &Path, bytes: &[u8], header: &Header) -> Result<Splats> {
    let wrong = |place: String, expected: String, found: String| Err(Error::malformed(path, place, expected, found));
    let sizes: Vec<usize> = header.sizes().into_iter().filter(|size| *size > 0).map(|s| s * header.count).collect();
    if bytes.len() < HEADER_4 {
        return wrong("header".into(), format!("{HEADER_4} bytes"), bytes.len().to_string());
    }
    if usize::from(bytes[15]) != sizes.len() {
        return wrong("header, number of streams".into(), sizes.len().to_string(), bytes[15].to_string());
    }
    let table = u32::from_le_bytes([bytes[16], bytes[17], bytes[18], bytes[19]]) as usize;
    let Some(entries) = bytes.get(table..).and_then(|rest| rest.get(..16 * sizes.len())).filter(|_| table >= HEADER_4)
    else {
        let expected = format!("{HEADER_4} to {}", bytes.len().saturating_sub(16 * sizes.len()));
        return wrong("header, offset of the table of streams".into(), expected, table.to_string());
    };
    let has_extensions = header.flags & EXTENSIONS != 0;
    if table > HEADER_4 && !has_extensions {
        let found = format!("{} bytes", table - HEADER_4);
        return wrong("header, flags".into(), "extensions, before the table of streams".into(), found);
    }
    let mut rest = &bytes[table + entries.len()..];
    let mut body = Vec::new();
    for (i, (entry, size)) in entries.chunks_exact(16).zip(sizes).enumerate() {
        let [packed, stated] = [0, 8].map(|at: usize| {
            let mut number = [0; 8];
            number.copy_from_slice(&entry[at..at + 8]);
            u64::from_le_bytes(number)
        });
        let place = |what: &str| format!("stream {i}{what}");
        if stated != size as u64 {
            return wrong(place(", unpacked size"), format!("{size} bytes"), stated.to_string());
        }
        let Some(stream) = usize::try_from(packed).ok().and_then(|packed| rest.get(..packed)) else {
            return wrong(place(", size"), format!("at most the {} bytes left", rest.len()), packed.to_string());
        };
        rest = &rest[stream.len()..];
        let before = body.len();
        unzstd(stream, size, &mut body)
            .map_err(|found| Error::malformed(path, place(""), format!("a zstd stream of {size} bytes"), found))?;
        if body.len() - before != size {
            return wrong(place(""), format!("{size} unpacked bytes"), (body.len() - before).to_string());
        }
    }
    if !rest.is_empty() {
        return wrong("length".into(), "nothing after the last stream".into(), format!("{} bytes", rest.len()));
    }
    let stored = if has_extensions { turn::stored_axes(path, &bytes[HEADER_4..table])? } else { STORED };
    splats(path, header, &body, stored)
}

/// Appends the content of a zstd stream, at most one byte more than `size`.
fn unzstd(stream: &[u8], size: usize, out: &mut Vec<u8>) -> std::result::Result<(), String> {
    let decoder = StreamingDecoder::new_with_max_window_size(stream, WINDOW.max(size as u64));
    let mut decoder = decoder.map_err(|e| e.to_string())?;
    let start = out.len();
    (&mut decoder).take(size as u64 + 1).read_to_end(out).map_err(|e| e.to_string())?;
    if out.len() - start > size {
        return Ok(());
    }
    if !decoder.get_ref().is_empty() {
        return Err(format!("{} bytes behind it", decoder.get_ref().len()));
    }
    let found = xxh64(&out[start..]) as u32;
    match decoder.decoder.get_checksum_from_data() {
        Some(stated) if stated != found => Err(format!("checksum {found:#010x} in place of {stated:#010x}")),
        _ => Ok(()),
    }
}

/// The splats of unpacked parameters that are stored in these axes.
fn splats(path: &Path, header: &Header, body: &[u8], stored: u32) -> Result<Splats> {
    let (n, k) = (header.count, coefficients(header.degree));
    let turn = Turn::from(stored);
    let parts = header.parts();
    let of = |part: &Range<usize>| &body[part.clone()];
    let positions: Vec<f32> = if header.version == 1 {
        of(&parts.positions).chunks_exact(2).map(|b| f16::from_le_bytes([b[0], b[1]]).to_f32()).collect()
    } else {
        let unit = (f64::from(header.fractional_bits)).exp2().recip() as f32;
        of(&parts.positions).chunks_exact(3).map(|b| pack::fixed([b[0], b[1], b[2]]) as f32 * unit).collect()
    };
    let rotations: Vec<Vec4> = if header.version < 3 {
        of(&parts.rotations).chunks_exact(3).map(|b| pack::first_three([b[0], b[1], b[2]])).collect()
    } else {
        of(&parts.rotations).chunks_exact(4).map(|b| pack::smallest_three([b[0], b[1], b[2], b[3]])).collect()
    };
    let (constants, higher) = (of(&parts.colors), of(&parts.sh));
    let mut sh = Vec::with_capacity(n * 3 * k);
    for i in 0..n {
        sh.extend(constants[3 * i..][..3].iter().map(|v| pack::constant(*v)));
        let coefficients = higher[i * 3 * (k - 1)..][..3 * (k - 1)].chunks_exact(3);
        for (j, rgb) in coefficients.enumerate() {
            sh.extend(rgb.iter().map(|v| turn.sh(j + 1) * pack::coefficient(*v)));
        }
    }
    let raw = Raw {
        means: positions.chunks_exact(3).map(|x| turn.position(Vec3::from_slice(x))).collect(),
        log_scales: of(&parts.scales)
            .chunks_exact(3)
            .map(|s| Vec3::new(s[0].into(), s[1].into(), s[2].into()) / 16.0 - 10.0)
            .collect(),
        rotations: rotations.into_iter().map(|q| turn.rotation(q)).collect(),
        opacity_logits: of(&parts.alphas).iter().map(|alpha| logit(f64::from(*alpha) / 255.0)).collect(),
        sh,
        degree: header.degree,
        mode: if header.flags & ANTIALIASED == 0 { RenderMode::Classic } else { RenderMode::Mip },
    };
    let packing = Packing::Spz { version: header.version, fractional_bits: header.fractional_bits };
    let layout = Layout { packing, ..Layout::original(header.degree, n) };
    raw.finish(path, Some(layout), Vec::new())
}

#[cfg(test)]
mod tests;
