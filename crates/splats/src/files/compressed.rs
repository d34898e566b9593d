//! `.compressed.ply` of PlayCanvas: splats in chunks of 256, each number within the range of its chunk.

mod write;

use std::path::Path;

use glam::{Vec3, Vec4};

use super::super::columns::{Layout, Packing, Scalar};
use super::super::{RenderMode, Splats, coefficients};
use super::constant_of;
use super::header::{Element, OF_SPLATS, Ply, Property};
use super::ply::place_of_rest;
use super::raw::{Raw, logit};
use octobayes::{Error, Result};

pub(super) use self::write::write;

/// Splats of a chunk.
const CHUNK: usize = 256;
/// Largest absolute value of a coefficient.
const REST: f64 = 4.0;

/// Properties that have a range in each chunk: the lowest and the highest value of three numbers.
struct Range<'a>([(&'a Property, &'a Property); 3]);

impl<'a> Range<'a> {
    fn find(chunk: &'a Element, names: [&str; 3]) -> Option<Self> {
        let [a, b, c] = names.map(|name| {
            let end = |which: &str| chunk.property(&format!("{which}_{name}"));
            Some((end("min")?, end("max")?))
        });
        Some(Self([a?, b?, c?]))
    }

    /// The numbers that these shares of the range of a chunk mean.
    fn at(&self, chunk: &[u8], shares: [f64; 3]) -> [f64; 3] {
        [0, 1, 2].map(|i| {
            let (min, max) = self.0[i];
            min.number(chunk) * (1.0 - shares[i]) + max.number(chunk) * shares[i]
        })
    }
}

/// A share of the largest number of so many bits, of the lowest bits of a word.
fn share(word: u32, bits: u32) -> f64 {
    let largest = (1 << bits) - 1;
    f64::from(word & largest) / f64::from(largest)
}

/// Three shares of 11, 10 and 11 bits.
fn three(word: u32) -> [f64; 3] {
    [share(word >> 21, 11), share(word >> 11, 10), share(word, 11)]
}

/// A rotation x, y, z, w from its three smaller entries of 10 bits; two bits are the number of the largest of w, x, y,
/// z.
fn rotation(word: u32) -> Vec4 {
    let small = [20, 10, 0].map(|shift| (share(word >> shift, 10) - 0.5) * std::f64::consts::SQRT_2);
    let largest = (1.0 - small.iter().map(|v| v * v).sum::<f64>()).max(0.0).sqrt();
    let mut wxyz = small.to_vec();
    wxyz.insert((word >> 30) as usize, largest);
    Vec4::new(wxyz[1] as f32, wxyz[2] as f32, wxyz[3] as f32, wxyz[0] as f32)
}

/// A coefficient from its byte. The first and the last mean the ends of the range, the others the middle of a step.
fn coefficient(byte: u8) -> f32 {
    let share = match byte {
        0 => 0.0,
        255 => 1.0,
        _ => (f64::from(byte) + 0.5) / 256.0,
    };
    ((2.0 * share - 1.0) * REST) as f32
}

/// Reads the elements of a compressed file.
pub(super) fn read(path: &Path, ply: &Ply, mode: RenderMode) -> Result<Splats> {
    let element = |name: &str| ply.elements.iter().find(|element| element.name == name);
    let missing = |what: String| Error::malformed(path, "header", what, "none");
    let lacks = |name: &str| missing(format!("an element `{name}` of compressed splats"));
    let vertex = element("vertex").ok_or_else(|| lacks("vertex"))?;
    let chunks = element("chunk").ok_or_else(|| lacks("chunk"))?;
    if let Some(other) = ply.elements.iter().find(|e| !OF_SPLATS.contains(&e.name.as_str()) && e.count > 0) {
        let expected = "elements `chunk`, `vertex` and `sh` of compressed splats";
        return Err(Error::malformed(path, "header", expected, format!("an element `{}`", other.name)));
    }
    let n = vertex.count;
    if chunks.count != n.div_ceil(CHUNK) {
        let expected = format!("{} rows for {n} splats", n.div_ceil(CHUNK));
        return Err(Error::malformed(path, "element `chunk`", expected, chunks.count.to_string()));
    }
    let packed = |name: &str| {
        let property = vertex.property(name).filter(|property| property.kind == Scalar::U32);
        property.ok_or_else(|| missing(format!("a property `uint {name}` of element `vertex`")))
    };
    let words =
        [packed("packed_position")?, packed("packed_rotation")?, packed("packed_scale")?, packed("packed_color")?];
    if let Some(other) = vertex.properties.iter().find(|property| !property.name.starts_with("packed_")) {
        let expected = "packed properties alone in element `vertex`";
        return Err(Error::malformed(path, "header", expected, format!("`{}`", other.name)));
    }
    let range = |names: [&str; 3]| {
        let lacks = || missing(format!("properties `min_{}` and the like of element `chunk`", names[0]));
        Range::find(chunks, names).ok_or_else(lacks)
    };
    let (means, scales) = (range(["x", "y", "z"])?, range(["scale_x", "scale_y", "scale_z"])?);
    // Files of earlier versions have none; their colours are in 0..1.
    let colors = if chunks.property("min_r").is_some() { Some(range(["r", "g", "b"])?) } else { None };
    let (degree, higher) = higher_of(path, element("sh"), n)?;
    let sh_rows = element("sh").map_or(&[][..], |sh| sh.rows);
    let k = coefficients(degree);
    let mut raw = Raw {
        means: Vec::with_capacity(n),
        log_scales: Vec::with_capacity(n),
        rotations: Vec::with_capacity(n),
        opacity_logits: Vec::with_capacity(n),
        sh: vec![0.0; n * 3 * k],
        degree,
        mode,
    };
    for (i, row) in vertex.rows.chunks_exact(vertex.stride).enumerate() {
        let chunk = &chunks.rows[i / CHUNK * chunks.stride..][..chunks.stride];
        let [position, turned, scale, color] = words.map(|word| word.number(row) as u32);
        raw.means.push(Vec3::from_array(means.at(chunk, three(position)).map(|v| v as f32)));
        raw.log_scales.push(Vec3::from_array(scales.at(chunk, three(scale)).map(|v| v as f32)));
        raw.rotations.push(rotation(turned));
        raw.opacity_logits.push(logit(share(color, 8)));
        let rgb = [24, 16, 8].map(|shift| share(color >> shift, 8));
        let rgb = colors.as_ref().map_or(rgb, |range| range.at(chunk, rgb));
        raw.sh[i * 3 * k..][..3].copy_from_slice(&rgb.map(constant_of));
        for (entry, property) in higher.iter().enumerate() {
            let byte = property.of(&sh_rows[i * higher.len()..])[0];
            raw.sh[i * 3 * k + place_of_rest(entry, k)] = coefficient(byte);
        }
    }
    let layout = Layout { packing: Packing::Chunks, ..Layout::original(degree, n) };
    let splats = raw.finish(path, Some(layout), Vec::new())?;
    Ok(splats.with_comments(ply.comments.clone()))
}

/// The degree of the higher coefficients, and their properties in order.
fn higher_of<'a>(path: &Path, sh: Option<&'a Element>, n: usize) -> Result<(u8, Vec<&'a Property>)> {
    let Some(sh) = sh else { return Ok((0, Vec::new())) };
    let count = sh.properties.len();
    let degree = (1..=super::super::MAX_DEGREE).find(|degree| 3 * (coefficients(*degree) - 1) == count);
    let properties: Option<Vec<&Property>> = (0..count)
        .map(|i| sh.property(&format!("f_rest_{i}")).filter(|property| property.kind == Scalar::U8))
        .collect();
    let (Some(degree), Some(properties)) = (degree, properties) else {
        let expected = "9, 24 or 45 properties `uchar f_rest_…`";
        return Err(Error::malformed(path, "element `sh`", expected, format!("{count} properties")));
    };
    if sh.count != n {
        let expected = format!("{n} rows, one per splat");
        return Err(Error::malformed(path, "element `sh`", expected, sh.count.to_string()));
    }
    Ok((degree, properties))
}

#[cfg(test)]
mod tests {
    use super::super::ply;
    use super::*;

    /// A file of `n` splats, all of which are the same words, with chunks from −1 to i + 1.
    fn file(n: usize, words: [u32; 4], has_colors: bool, rest: usize) -> Vec<u8> {
        let mut names: Vec<String> = Vec::new();
        let groups: &[[&str; 3]] = &[["x", "y", "z"], ["scale_x", "scale_y", "scale_z"], ["r", "g", "b"]];
        for group in &groups[..if has_colors { 3 } else { 2 }] {
            for end in ["min", "max"] {
                names.extend(group.iter().map(|name| format!("{end}_{name}")));
            }
        }
        let chunks = n.div_ceil(CHUNK);
        let mut header = format!("ply\nformat binary_little_endian 1.0\ncomment c\nelement chunk {chunks}\n");
        names.iter().for_each(|name| header += &format!("property float {name}\n"));
        header += &format!("element vertex {n}\n");
        ["position", "rotation", "scale", "color"]
            .iter()
            .for_each(|w| header += &format!("property uint packed_{w}\n"));
        if rest > 0 {
            header += &format!("element sh {n}\n");
            (0..rest).for_each(|i| header += &format!("property uchar f_rest_{i}\n"));
        }
        let mut bytes = (header + "end_header\n").into_bytes();
        for i in 0..chunks {
            for name in &names {
                let value = if name.starts_with("min") { -1.0 } else { i as f32 + 1.0 };
                bytes.extend(value.to_le_bytes());
            }
        }
        (0..n).for_each(|_| words.iter().for_each(|word| bytes.extend(word.to_le_bytes())));
        (0..n * rest).for_each(|i| bytes.push((i % rest) as u8));
        bytes
    }

    fn read_file(bytes: &[u8]) -> Result<Splats> {
        ply::read(Path::new("s.compressed.ply"), bytes)
    }

    #[test]
    fn words_are_shares_of_the_range_of_their_chunk() {
        // x at its lowest, y at its highest, z at 1023 of 2047.
        let position = 1023 << 11 | 1023;
        let words = [position, 1 << 30 | 1023 << 20 | 512 << 10, u32::MAX, 0xff00_8033];
        let splats = read_file(&file(300, words, true, 9)).unwrap();
        assert_eq!((splats.len(), splats.degree()), (300, 1));
        // 256 splats have the first chunk's range.
        for (i, high) in [(0, 1.0_f32), (255, 1.0), (256, 2.0), (299, 2.0)] {
            let third = -1.0 + (high + 1.0) * 1023.0 / 2047.0;
            assert!((splats.mean(i) - Vec3::new(-1.0, high, third)).length() < 1e-6, "{}", splats.mean(i));
            assert_eq!(splats.log_scales()[i], Vec3::splat(high));
            assert!((splats.opacity(i) - 0.2).abs() < 1e-6);
            let color = 0.5 + 0.282_094_8 * Vec3::from_slice(splats.sh(i));
            let expected = Vec3::new(high, -1.0, -1.0 + (high + 1.0) * 128.0 / 255.0);
            assert!((color - expected).length() < 1e-6, "{color} {expected}");
        }
        // The second of w, x, y, z is the largest: w = √½, y nearly 0, z = −√½ leave nothing for x.
        let q = splats.rotation(0);
        assert!((q.w - 0.5_f32.sqrt()).abs() < 1e-3 && (q.z + 0.5_f32.sqrt()).abs() < 1e-3 && q.x.abs() < 0.01, "{q}");
        // f_rest_3 is green's first higher coefficient.
        assert_eq!(splats.sh(5)[3 + 1], (2.0 * 3.5 / 256.0 - 1.0) * 4.0);
        assert_eq!([0, 255].map(coefficient), [-4.0, 4.0]);
        // Without a range, colours are in 0..1.
        let plain = read_file(&file(1, words, false, 0)).unwrap();
        assert!((0.5 + 0.282_094_8 * plain.sh(0)[0] - 1.0).abs() < 1e-6 && plain.degree() == 0);
    }

    #[test]
    fn elements_that_do_not_fit_are_refused() {
        let good = file(2, [0; 4], true, 9);
        let changed = |from: &str, to: &str| {
            let at = good.windows(from.len()).position(|window| window == from.as_bytes()).unwrap();
            let bytes = [&good[..at], to.as_bytes(), &good[at + from.len()..]].concat();
            read_file(&bytes).expect_err(to).to_string()
        };
        for (from, to, expected) in [
            ("element chunk 1", "element hunk 1", "an element `chunk` of compressed splats, found none"),
            ("uint packed_scale", "float packed_scale", "a property `uint packed_scale`"),
            ("min_scale_x", "min_scale_u", "`min_scale_x` and the like of element `chunk`"),
            ("max_b", "max_a", "`min_r` and the like"),
            ("uchar f_rest_8", "uchar f_rest_9", "9, 24 or 45 properties `uchar f_rest_…`, found 9 properties"),
            ("element sh", "element hs", "elements `chunk`, `vertex` and `sh` of compressed splats"),
        ] {
            let error = changed(from, to);
            assert!(error.contains(expected), "{to}: {error}");
        }
        // Lengths that fit, counts that do not.
        let mut chunks = file(2, [0; 4], false, 0);
        let at = chunks.windows(15).position(|w| w == b"element chunk 1").unwrap();
        chunks[at + 14] = b'2';
        chunks.extend([0; 48]);
        let error = read_file(&chunks).unwrap_err().to_string();
        assert!(error.contains("element `chunk`: expected 1 rows for 2 splats, found 2"), "{error}");
    }
}
