//! Whole JPEGs. Decoders show as much as they find and fill the rest with grey, so that half a picture looks like one.
//!
//! Markers divide a file, so that lost scans and restart markers are found by counting. Whether the last scan has all
//! its blocks shows in how far the decoder reads: zeros replace the end marker, and a decoder that lacks blocks goes on
//! into them.

use std::cell::Cell;
use std::path::Path;

use image::{DynamicImage, ImageBuffer};
use zune_core::bytestream::{ZByteIoError, ZByteReaderTrait, ZCursor, ZSeekFrom};
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;

use super::sizes::Head;
use octobayes::{Error, Result};

const END: u8 = 0xD9;
/// Zeros in place of the end marker.
const ZEROS: usize = 16;
/// Bytes by which the decoder may look past the end of a whole scan: it holds at most 31 bits when it takes 32 more.
const AHEAD: u64 = 8;
/// What a whole file is, for people.
const WHOLE: &str = "a whole JPEG; copy or export the picture again";

/// How markers divide a file.
struct Layout {
    /// End of the last scan.
    end: usize,
    /// Whether it takes all scans to make the first pixel.
    has_scans: bool,
}

/// A component of a picture.
struct Component {
    id: u8,
    /// Samples along x and y of a block group.
    sampling: [usize; 2],
    /// For every coefficient, how many bits of it have not come; `u8::MAX` before any came.
    missing: [u8; 64],
}

/// Width, height and components.
struct Frame {
    size: [usize; 2],
    components: Vec<Component>,
    is_progressive: bool,
}

/// Decodes a JPEG of known size.
///
/// # Errors
/// If the file is damaged or not whole, or its size differs.
pub(super) fn decode(path: &Path, what: &str, mut bytes: Vec<u8>, resolution: [u32; 2]) -> Result<DynamicImage> {
    let wrong = |found: String| Error::malformed(path, what, "a PNG or JPEG", found);
    let options = DecoderOptions::default().set_strict_mode(false).set_max_width(65_535).set_max_height(65_535);
    let mut headers = JpegDecoder::new_with_options(ZCursor::new(bytes.as_slice()), options);
    headers.decode_headers().map_err(|e| wrong(e.to_string()))?;
    let (w, h) = headers.dimensions().ok_or_else(|| wrong("no size".into()))?;
    Head { size: [w, h].map(|side| side as u32), orientation: 1 }.check(path, what, resolution)?;
    let is_grey = headers.input_colorspace() == Some(ColorSpace::Luma);
    drop(headers);

    let torn = |found: String| Error::malformed(path, what, WHOLE, found);
    let layout = layout(&bytes).map_err(torn)?;
    bytes.truncate(layout.end);
    bytes.extend([0; ZEROS]);
    bytes.extend([0xFF, END]);
    let [furthest, in_scan] = [const { Cell::new(0) }; 2];
    let reader = Watched { bytes: ZCursor::new(bytes.as_slice()), furthest: &furthest, in_scan: &in_scan };
    let color = if is_grey { ColorSpace::Luma } else { ColorSpace::RGB };
    let mut decoder = JpegDecoder::new_with_options(reader, options.jpeg_set_out_colorspace(color));
    let pixels = decoder.decode().map_err(|e| wrong(e.to_string()))?;
    let end = layout.end as u64;
    if in_scan.get() > end + AHEAD {
        return Err(torn("an end before the last pixels".into()));
    }
    if furthest.get() < end {
        return Err(torn("pixels that cannot be decoded".into()));
    }
    let [w, h] = resolution;
    let image = if is_grey {
        ImageBuffer::from_raw(w, h, pixels).map(DynamicImage::ImageLuma8)
    } else {
        ImageBuffer::from_raw(w, h, pixels).map(DynamicImage::ImageRgb8)
    };
    image.ok_or_else(|| torn("fewer pixels than its size".into()))
}

/// Bytes that decoding takes at once beside the file, for a picture of this many pixels.
pub(super) fn working_memory(bytes: &[u8], pixels: u64) -> u64 {
    // Coefficients wait for the last scan, two bytes for each of three components.
    let has_scans = layout(bytes).is_ok_and(|layout| layout.has_scans);
    bytes.len() as u64 + pixels * if has_scans { 3 + 6 } else { 3 }
}

/// Follows the markers from the first to the end of the picture; what lies behind it, such as a preview, is no part of
/// it. Or returns what is missing.
fn layout(bytes: &[u8]) -> std::result::Result<Layout, String> {
    let cut = || format!("{} bytes without the end marker", bytes.len());
    let (mut at, mut end, mut scans, mut interval, mut frame) = (2, None, 0, 0, None::<Frame>);
    loop {
        let marker = next_marker(bytes, &mut at).ok_or_else(cut)?;
        match marker {
            END => break,
            // Without content.
            0x01 | 0xD0..=0xD8 => continue,
            _ => {}
        }
        let length = bytes.get(at..at + 2).map(|b| usize::from(u16::from_be_bytes([b[0], b[1]]))).ok_or_else(cut)?;
        let content = bytes.get(at + 2..at + length.max(2)).ok_or_else(cut)?;
        at += length.max(2);
        match marker {
            0xC0..=0xC2 => frame = Frame::new(content, marker == 0xC2),
            0xDD => interval = content.first_chunk().map_or(0, |b| usize::from(u16::from_be_bytes(*b))),
            0xDA => {
                let (stop, restarts) = scan(bytes, at).ok_or_else(cut)?;
                let blocks = frame.as_mut().and_then(|frame| frame.receive(content));
                let expected = blocks.filter(|_| interval > 0).map(|blocks| blocks.div_ceil(interval).max(1));
                // Some encoders end with one more.
                if let Some(expected) = expected.filter(|&expected| ![expected, expected - 1].contains(&restarts)) {
                    return Err(format!("{restarts} of {} restart markers in a scan", expected - 1));
                }
                (at, end, scans) = (stop, Some(stop), scans + 1);
            }
            _ => {}
        }
    }
    let end = end.ok_or("no scan")?;
    // Kinds of frames that are not known here are refused by the decoder.
    let components = frame.iter().flat_map(|frame| &frame.components);
    match components.enumerate().find(|(_, component)| component.missing.iter().any(|&bits| bits > 0)) {
        Some((i, _)) => Err(format!("an end before the last scan of component {i}")),
        None => Ok(Layout { end, has_scans: scans > 1 }),
    }
}

/// The next marker, and `at` behind it.
fn next_marker(bytes: &[u8], at: &mut usize) -> Option<u8> {
    let rest = bytes.get(*at..)?;
    let i = rest.windows(2).position(|pair| pair[0] == 0xFF && !matches!(pair[1], 0 | 0xFF))?;
    *at += i + 2;
    Some(rest[i + 1])
}

/// Where the scan that begins at `at` ends, and how many restart markers it has.
fn scan(bytes: &[u8], mut at: usize) -> Option<(usize, usize)> {
    let mut restarts = 0;
    while let 0xD0..=0xD7 = next_marker(bytes, &mut at)? {
        restarts += 1;
    }
    let mut end = at - 2;
    // A marker may follow any number of filling bytes.
    while bytes[end - 1] == 0xFF {
        end -= 1;
    }
    Some((end, restarts))
}

impl Frame {
    fn new(content: &[u8], is_progressive: bool) -> Option<Self> {
        let side = |i: usize| Some(usize::from(u16::from_be_bytes([*content.get(i)?, *content.get(i + 1)?])));
        let component = |c: &[u8; 3]| Component {
            id: c[0],
            sampling: [c[1] >> 4, c[1] & 15].map(|n| usize::from(n).max(1)),
            missing: [u8::MAX; 64],
        };
        let components = content.get(6..)?.as_chunks().0.iter().map(component).collect();
        Some(Self { size: [side(3)?, side(1)?], components, is_progressive })
    }

    /// Notes what a scan brings, and returns the number of its blocks, or of its groups of blocks.
    fn receive(&mut self, header: &[u8]) -> Option<usize> {
        let (&count, rest) = header.split_first()?;
        let (ids, rest) = rest.split_at_checked(2 * usize::from(count))?;
        let &[first, last, bits] = rest.first_chunk()?;
        // Only progressive scans have a part of the coefficients, whatever the header of others holds.
        let part = if self.is_progressive { (first.min(63), last.min(63), bits & 15) } else { (0, 63, 0) };
        let of = |sampling: fn(&Component) -> usize| self.components.iter().map(sampling).max().unwrap_or(1);
        let most = [of(|c| c.sampling[0]), of(|c| c.sampling[1])];
        let mut sampling = most.map(|n| [n, n]);
        for pair in ids.as_chunks::<2>().0 {
            let component = self.components.iter_mut().find(|component| component.id == pair[0])?;
            (part.0..=part.1).for_each(|k| component.missing[usize::from(k)] = part.2);
            // A component alone comes block by block.
            if count == 1 {
                sampling = [0, 1].map(|axis| [component.sampling[axis], most[axis]]);
            }
        }
        let groups = [0, 1].map(|axis| {
            let [own, most] = sampling[axis];
            if count == 1 { (self.size[axis] * own).div_ceil(8 * most) } else { self.size[axis].div_ceil(8 * most) }
        });
        Some(groups[0] * groups[1])
    }
}

/// A file, and how far it was read.
struct Watched<'a> {
    bytes: ZCursor<&'a [u8]>,
    /// Where the decoder stopped.
    furthest: &'a Cell<u64>,
    /// Where the last four bytes ended that it took at once, as it does for the blocks of a scan alone.
    in_scan: &'a Cell<u64>,
}

impl Watched<'_> {
    fn note<T>(&mut self, read: T) -> T {
        self.furthest.set(self.furthest.get().max(self.bytes.z_position().unwrap_or(0)));
        read
    }
}

impl ZByteReaderTrait for Watched<'_> {
    #[inline]
    fn read_byte_no_error(&mut self) -> u8 {
        let byte = self.bytes.read_byte_no_error();
        self.note(byte)
    }

    #[inline]
    fn read_exact_bytes(&mut self, buffer: &mut [u8]) -> std::result::Result<(), ZByteIoError> {
        self.bytes.read_exact_bytes(buffer)?;
        if buffer.len() == 4 {
            // Bytes with a marker among them are given back.
            if !buffer.contains(&0xFF) {
                self.in_scan.set(self.in_scan.get().max(self.bytes.z_position().unwrap_or(0)));
            }
            return Ok(());
        }
        self.note(Ok(()))
    }

    fn read_bytes(&mut self, buffer: &mut [u8]) -> std::result::Result<usize, ZByteIoError> {
        let read = self.bytes.read_bytes(buffer);
        self.note(read)
    }

    fn peek_bytes(&mut self, buffer: &mut [u8]) -> std::result::Result<usize, ZByteIoError> {
        self.bytes.peek_bytes(buffer)
    }

    fn peek_exact_bytes(&mut self, buffer: &mut [u8]) -> std::result::Result<(), ZByteIoError> {
        self.bytes.peek_exact_bytes(buffer)
    }

    fn z_seek(&mut self, from: ZSeekFrom) -> std::result::Result<u64, ZByteIoError> {
        self.bytes.z_seek(from)
    }

    fn is_eof(&mut self) -> std::result::Result<bool, ZByteIoError> {
        self.bytes.is_eof()
    }

    fn z_position(&mut self) -> std::result::Result<u64, ZByteIoError> {
        self.bytes.z_position()
    }

    fn read_remaining(&mut self, sink: &mut Vec<u8>) -> std::result::Result<usize, ZByteIoError> {
        let read = self.bytes.read_remaining(sink);
        self.note(read)
    }
}

#[cfg(test)]
mod tests;
