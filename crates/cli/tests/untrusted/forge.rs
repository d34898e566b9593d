//! Files whose checksums and lengths are right, whatever they hold.
//!
//! A byte changed at random in a file with checksums only ever tests the checksum. So a file of such a kind is
//! taken apart into its contents, these are changed, and a new file is built around them. This is what an attacker
//! can do, or another program that writes the format and errs.
//!
//! A *recipe* holds such contents in one row of bytes. If its first byte is even, a whole file follows. If it is
//! odd, parts follow, each with its length (u32, little-endian) before it.

use std::io::{Cursor, Read, Write};

use super::{Kind, torch};

/// Sections of containers, in the order of their parts.
const FIELD: [&str; 10] =
    ["masks", "deviations", "rays", "factors", "exact", "surface", "ray_coverage", "counted", "limits", "errors"];
const CHECKPOINT: [&str; 5] = ["run", "keys", "sums", "surface", "ray_coverage"];

/// Arrays that archives may have, in the order of their parts.
const SAMPLES: [&str; 5] = ["positions", "jacobian", "ray", "rays_total", "weight"];
const VOXELS: [&str; 3] = ["box", "density", "color"];

/// Most zeros at the end of a forged `.safetensors` file: more than an MLP NeRF needs.
const MOST_WEIGHTS: usize = 1 << 20;

/// Builds the file that a recipe describes.
pub fn file(kind: Kind, recipe: &[u8]) -> Vec<u8> {
    let Some((&first, rest)) = recipe.split_first() else { return Vec::new() };
    if first % 2 == 0 {
        return rest.to_vec();
    }
    let parts = split(rest);
    let part = |i: usize| parts.get(i).copied().unwrap_or_default();
    match kind {
        Kind::Field => container(b"OCTOBAY\n", 1, &FIELD, &parts),
        Kind::Checkpoint => container(b"OCTOCHK\n", 3, &CHECKPOINT, &parts),
        Kind::Samples => archive(&SAMPLES, &parts),
        Kind::Voxels => archive(&VOXELS, &parts),
        Kind::Safetensors => {
            let zeros = part(1).iter().fold(0_usize, |n, &b| n << 8 | usize::from(b)) % MOST_WEIGHTS;
            let length = (part(0).len() as u64).to_le_bytes();
            [&length[..], part(0), &vec![0; zeros]].concat()
        }
        Kind::Torch => torch::archive(part(0)),
        _ => rest.to_vec(),
    }
}

/// A recipe that names every content of a valid file separately, if the kind has parts; otherwise the file as it
/// is.
pub fn recipe(kind: Kind, file: &[u8]) -> Vec<u8> {
    let parts = match kind {
        Kind::Field => container_parts(&FIELD, file),
        Kind::Checkpoint => container_parts(&CHECKPOINT, file),
        Kind::Samples => archive_parts(&SAMPLES, file),
        Kind::Voxels => archive_parts(&VOXELS, file),
        Kind::Safetensors => {
            let header = u64::from_le_bytes(file[..8].try_into().unwrap()) as usize;
            let data = (file.len() - 8 - header) as u32;
            vec![file[8..8 + header].to_vec(), data.to_be_bytes().to_vec()]
        }
        Kind::Torch if file.starts_with(b"PK") => vec![torch::pickle_of(file)],
        _ => return raw(file),
    };
    join(&parts)
}

/// The files of a COLMAP model in one: the first byte is odd if they are binary, then follow `cameras`, `images`
/// and `points3D`, each with its length before it.
pub fn colmap(is_binary: bool, files: [&[u8]; 3]) -> Vec<u8> {
    let mut bytes = join(&files.map(<[u8]>::to_vec));
    bytes[0] = is_binary.into();
    bytes
}

/// A recipe for exactly this file.
pub fn raw(file: &[u8]) -> Vec<u8> {
    [&[0], file].concat()
}

/// The parts of a recipe after its first byte. A length beyond the end means all that is left.
pub fn split(mut bytes: &[u8]) -> Vec<&[u8]> {
    let mut parts = Vec::new();
    while let Some((length, rest)) = bytes.split_first_chunk::<4>() {
        let (part, rest) = rest.split_at((u32::from_le_bytes(*length) as usize).min(rest.len()));
        parts.push(part);
        bytes = rest;
    }
    parts
}

/// The recipe of these parts.
pub fn join(parts: &[Vec<u8>]) -> Vec<u8> {
    let mut recipe = vec![1];
    for part in parts {
        recipe.extend((part.len() as u32).to_le_bytes());
        recipe.extend(part);
    }
    recipe
}

/// A container with this header content (JSON), followed by the sections of these names.
fn container(magic: &[u8; 8], version: u32, names: &[&str], parts: &[&[u8]]) -> Vec<u8> {
    let part = |i: usize| parts.get(i).copied().unwrap_or_default();
    let sections: Vec<&[u8]> = (1..=names.len()).map(part).collect();
    let described = names.iter().zip(&sections).map(|(name, bytes)| {
        format!(r#"{{"name":"{name}","bytes":{},"crc32":{}}}"#, bytes.len(), crc32fast::hash(bytes))
    });
    let described: Vec<String> = described.collect();
    // The content may be anything, JSON or not.
    let header =
        [br#"{"content":"#, part(0), format!(r#","sections":[{}]}}"#, described.join(",")).as_bytes()].concat();
    let mut file = magic.to_vec();
    for word in [version, header.len() as u32, crc32fast::hash(&header)] {
        file.extend(word.to_le_bytes());
    }
    file.extend(header);
    sections.iter().for_each(|s| file.extend(*s));
    file
}

/// The header content and the sections of a valid container; empty ones that it does not have.
fn container_parts(names: &[&str], file: &[u8]) -> Vec<Vec<u8>> {
    let length = u32::from_le_bytes(file[12..16].try_into().unwrap()) as usize;
    let (header, mut rest) = file[20..].split_at(length);
    let header: serde_json::Value = serde_json::from_slice(header).unwrap();
    let mut parts = vec![Vec::new(); 1 + names.len()];
    parts[0] = header["content"].to_string().into_bytes();
    for section in header["sections"].as_array().unwrap() {
        let (own, behind) = rest.split_at(section["bytes"].as_u64().unwrap() as usize);
        let place = names.iter().position(|name| section["name"] == *name);
        parts[1 + place.expect("a section of a known name")] = own.to_vec();
        rest = behind;
    }
    parts
}

/// A zip archive with the first few of these arrays, stored without compression.
pub fn archive(names: &[&str], parts: &[&[u8]]) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let options = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    for (name, part) in names.iter().zip(parts) {
        zip.start_file(format!("{name}.npy"), options).unwrap();
        zip.write_all(part).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

fn archive_parts(names: &[&str], file: &[u8]) -> Vec<Vec<u8>> {
    let mut zip = zip::ZipArchive::new(Cursor::new(file)).unwrap();
    let mut parts = Vec::new();
    for name in names {
        let Ok(mut member) = zip.by_name(&format!("{name}.npy")) else { break };
        let mut part = Vec::new();
        member.read_to_end(&mut part).unwrap();
        parts.push(part);
    }
    parts
}
