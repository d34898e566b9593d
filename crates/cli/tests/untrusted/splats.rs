//! Small files of Gaussian splats, byte by byte.

use octobayes::glam::{Quat, Vec3};
use octobayes_splats::{RenderMode, Splats};

/// A file of every format that is known by its content.
pub fn files() -> Vec<Vec<u8>> {
    let plain = [spz_header(2, 1, 0), spz_parts(2, 1).concat()].concat();
    let version_1 = [spz_header(1, 0, 1), spz_parts(1, 0).concat()].concat();
    vec![ply(), compressed(true), compressed(false), plain.clone(), gzip(&plain), gzip(&version_1), spz_4()]
}

/// The original code's layout, with two properties more.
fn ply() -> Vec<u8> {
    let n = 3;
    let means = (0..n).map(|i| Vec3::new(i as f32, 0.5, -2.0)).collect();
    let (scales, rotations) = (vec![Vec3::new(-3.0, -4.0, -5.0); n], vec![Quat::IDENTITY; n]);
    let sh = (0..n * 12).map(|i| i as f32 / 40.0).collect();
    let splats = Splats::new(means, scales, rotations, vec![0.5; n], sh, 1, RenderMode::Mip).unwrap();
    super::samples::written("scene.ply", |path| {
        let (u, weight) = ([1.0_f32, 2.0, 3.0], [0.5_f32; 3]);
        splats.write_ply(path, &[("uncertainty", &u), ("weight", &weight)], &["by hand".into()]).unwrap();
    })
}

/// Two splats of a chunk.
fn compressed(has_sh: bool) -> Vec<u8> {
    let mut text = String::from("ply\nformat binary_little_endian 1.0\ncomment made here\nelement chunk 1\n");
    for group in [["x", "y", "z"], ["scale_x", "scale_y", "scale_z"], ["r", "g", "b"]] {
        for end in ["min", "max"] {
            group.iter().for_each(|name| text += &format!("property float {end}_{name}\n"));
        }
    }
    text += "element vertex 2\n";
    ["position", "rotation", "scale", "color"]
        .iter()
        .for_each(|name| text += &format!("property uint packed_{name}\n"));
    if has_sh {
        text += "element sh 2\n";
        (0..9).for_each(|i| text += &format!("property uchar f_rest_{i}\n"));
    }
    let mut bytes = (text + "end_header\n").into_bytes();
    for (low, high) in [(-1.0_f32, 1.0_f32), (-6.0, -2.0), (0.0, 1.0)] {
        [low, low, low, high, high, high].iter().for_each(|v| bytes.extend(v.to_le_bytes()));
    }
    for i in 0..8_u32 {
        bytes.extend((0x1357_9bdf_u32.wrapping_mul(i + 1)).to_le_bytes());
    }
    bytes.extend((0..18).take(if has_sh { 18 } else { 0 }));
    bytes
}

/// Header of versions 1 to 3, for two splats.
fn spz_header(version: u32, degree: u8, flags: u8) -> Vec<u8> {
    let mut bytes = [&b"NGSP"[..], &version.to_le_bytes(), &2_u32.to_le_bytes()].concat();
    bytes.extend([degree, 12, flags, 0]);
    bytes
}

fn spz_parts(version: u32, degree: u8) -> Vec<Vec<u8>> {
    let positions = if version == 1 { 12 } else { 18 };
    let rotations = if version < 3 { 6 } else { 8 };
    let higher = 2 * 3 * ((usize::from(degree) + 1).pow(2) - 1);
    let fill = |count: usize, from: u8| (0..count).map(|i| from + (i % 7) as u8).collect::<Vec<u8>>();
    let parts =
        vec![fill(positions, 1), fill(2, 90), fill(6, 120), fill(6, 100), fill(rotations, 60), fill(higher, 125)];
    parts.into_iter().filter(|part| !part.is_empty()).collect()
}

fn spz_4() -> Vec<u8> {
    let parts = spz_parts(4, 1);
    let mut bytes = spz_header(4, 1, 2);
    bytes[15] = parts.len() as u8;
    // The table comes after an extension: the axes of PLY files.
    bytes.extend(44_u32.to_le_bytes());
    bytes.extend([0; 12]);
    [0xadbe_0003_u32, 4, 6].iter().for_each(|word| bytes.extend(word.to_le_bytes()));
    // zstd frames of one block each, not compressed.
    let frame = |part: &[u8]| {
        let block = ((part.len() as u32) << 3 | 1).to_le_bytes();
        [&[0x28, 0xb5, 0x2f, 0xfd, 0x20, part.len() as u8][..], &block[..3], part].concat()
    };
    for part in &parts {
        bytes.extend((frame(part).len() as u64).to_le_bytes());
        bytes.extend((part.len() as u64).to_le_bytes());
    }
    parts.iter().for_each(|part| bytes.extend(frame(part)));
    bytes
}

/// A gzip stream of one block that is not compressed, so that damage reaches the content.
fn gzip(content: &[u8]) -> Vec<u8> {
    let length = content.len() as u16;
    let mut bytes = vec![0x1f, 0x8b, 8, 0, 0, 0, 0, 0, 0, 255, 1];
    bytes.extend([length, !length].iter().flat_map(|v| v.to_le_bytes()));
    bytes.extend(content);
    bytes.extend(crc32fast::hash(content).to_le_bytes());
    bytes.extend(u32::from(length).to_le_bytes());
    bytes
}
