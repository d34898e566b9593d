//! Writes `.compressed.ply` files.

use std::path::Path;

use glam::{DVec3, Quat, Vec3};

use super::super::super::columns::Packing;
use super::super::super::{Splats, coefficients};
use super::super::ply::place_of_rest;
use super::super::{byte_of, color_of, without_largest};
use super::{CHUNK, REST};
use octobayes::Result;
use octobayes::io::AtomicFile;

/// Logarithms of scales beyond this are written as this: what is smaller or larger is drawn alike.
const LARGEST_LOG_SCALE: f32 = 20.0;
/// Bits of an axis in [`z_order`].
const ORDER_BITS: u32 = 21;

/// The lowest and highest of three numbers in a chunk.
struct Bounds([Vec3; 2]);

impl Bounds {
    fn of(splats: &[usize], value: &dyn Fn(usize) -> Vec3) -> Self {
        let end = |of: fn(Vec3, Vec3) -> Vec3| splats.iter().map(|&i| value(i)).reduce(of).unwrap_or_default();
        Self([end(Vec3::min), end(Vec3::max)])
    }

    /// Where three numbers lie between the ends, 0 to 1.
    fn shares(&self, value: Vec3) -> [f64; 3] {
        let [low, high] = [self.0[0].as_dvec3(), self.0[1].as_dvec3()];
        let width = high - low;
        let share = |axis: usize| {
            if width[axis] > 0.0 { (f64::from(value[axis]) - low[axis]) / width[axis] } else { 0.0 }
        };
        [share(0), share(1), share(2)]
    }
}

/// The nearest whole number of so many bits to a share of the largest.
fn whole(share: f64, bits: u32) -> u32 {
    (share.clamp(0.0, 1.0) * f64::from((1_u32 << bits) - 1)).round() as u32
}

/// Three shares in 11, 10 and 11 bits.
fn three(shares: [f64; 3]) -> u32 {
    whole(shares[0], 11) << 21 | whole(shares[1], 10) << 11 | whole(shares[2], 11)
}

/// A rotation: the number of the largest of w, x, y, z in two bits, and the other three in 10 bits each.
fn rotation(q: Quat) -> u32 {
    let (largest, others) = without_largest([q.w, q.x, q.y, q.z]);
    let entry = |v: f32| whole(f64::from(v) / std::f64::consts::SQRT_2 + 0.5, 10);
    others.into_iter().fold(largest as u32, |word, v| word << 10 | entry(v))
}

/// The byte of a higher coefficient: 1/256 of the range each.
fn coefficient(value: f32) -> u8 {
    ((f64::from(value) / REST + 1.0) * 128.0).floor().clamp(0.0, 255.0) as u8
}

/// The splats in an order in which those that follow each other are near: that of a curve through all cells of a grid
/// (Morton 1966).
fn z_order(splats: &Splats) -> Vec<usize> {
    let bounds = splats.bounds();
    let cells = f64::from((1_u32 << ORDER_BITS) - 1);
    let key = |i: &usize| {
        let at: DVec3 = (splats.mean(*i).as_dvec3() - bounds.min()) / bounds.size() * cells;
        let cell = at.to_array().map(|v| v.clamp(0.0, cells) as u64);
        let bit = |k: u32| cell.iter().enumerate().map(move |(axis, c)| (c >> k & 1) << (3 * k + axis as u32));
        (0..ORDER_BITS).flat_map(bit).sum::<u64>()
    };
    let mut order: Vec<usize> = (0..splats.len()).collect();
    order.sort_by_cached_key(key);
    order
}

/// Writes splats in their order if they came from such a file, else in one in which chunks are small.
pub(in super::super) fn write(splats: &Splats, path: &Path) -> Result<()> {
    let comments = splats.comments_with(&[], &[])?;
    let order = if splats.layout.packing == Packing::Chunks { (0..splats.len()).collect() } else { z_order(splats) };
    AtomicFile::write(path, &bytes(splats, &order, &comments))
}

fn header(splats: &Splats, comments: &[String]) -> String {
    let mut header = String::from("ply\nformat binary_little_endian 1.0\n");
    comments.iter().for_each(|comment| header += &format!("comment {comment}\n"));
    header += &format!("element chunk {}\n", splats.len().div_ceil(CHUNK));
    for names in [["x", "y", "z"], ["scale_x", "scale_y", "scale_z"], ["r", "g", "b"]] {
        for end in ["min", "max"] {
            names.iter().for_each(|name| header += &format!("property float {end}_{name}\n"));
        }
    }
    header += &format!("element vertex {}\n", splats.len());
    for name in ["position", "rotation", "scale", "color"] {
        header += &format!("property uint packed_{name}\n");
    }
    let rest = 3 * (coefficients(splats.degree()) - 1);
    if rest > 0 {
        header += &format!("element sh {}\n", splats.len());
        (0..rest).for_each(|i| header += &format!("property uchar f_rest_{i}\n"));
    }
    header + "end_header\n"
}

fn bytes(splats: &Splats, order: &[usize], comments: &[String]) -> Vec<u8> {
    let scale =
        |i: usize| splats.log_scales()[i].clamp(Vec3::splat(-LARGEST_LOG_SCALE), Vec3::splat(LARGEST_LOG_SCALE));
    let (mut chunks, mut vertices) = (Vec::new(), Vec::new());
    for chunk in order.chunks(CHUNK) {
        let color = |i: usize| color_of(splats.sh(i));
        let bounds = [Bounds::of(chunk, &|i| splats.mean(i)), Bounds::of(chunk, &scale), Bounds::of(chunk, &color)];
        let ends = bounds.iter().flat_map(|bounds| bounds.0).flat_map(|end| end.to_array());
        chunks.extend(ends.flat_map(f32::to_le_bytes));
        for &i in chunk {
            let [position, scale] = [bounds[0].shares(splats.mean(i)), bounds[1].shares(scale(i))].map(three);
            let rgb = bounds[2].shares(color(i)).map(|share| whole(share, 8));
            let packed = rgb[0] << 24 | rgb[1] << 16 | rgb[2] << 8 | u32::from(byte_of(splats.opacity(i)));
            let words = [position, rotation(splats.rotation(i)), scale, packed];
            vertices.extend(words.iter().flat_map(|word| word.to_le_bytes()));
        }
    }
    let k = coefficients(splats.degree());
    let rest = |&i: &usize| (0..3 * (k - 1)).map(move |entry| coefficient(splats.sh(i)[place_of_rest(entry, k)]));
    [header(splats, comments).into_bytes(), chunks, vertices, order.iter().flat_map(rest).collect()].concat()
}

#[cfg(test)]
mod tests {
    use super::super::super::tests::random;
    use super::*;

    fn read_again(splats: &Splats) -> Splats {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("s.compressed.ply");
        splats.write(&path).unwrap();
        Splats::read(&path).unwrap()
    }

    #[test]
    fn numbers_come_back_within_half_a_step_of_their_chunk() {
        for degree in 0..=3 {
            // Two chunks and a part of one. One chunk at a time has the ranges that are computed here.
            let splats = random(600, degree);
            let order = z_order(&splats);
            let again = read_again(&splats);
            assert_eq!((again.len(), again.degree(), again.mode()), (600, degree, splats.mode()));
            for (c, chunk) in order.chunks(CHUNK).enumerate() {
                let extent = |value: &dyn Fn(usize) -> Vec3| {
                    let Bounds([low, high]) = Bounds::of(chunk, value);
                    high - low
                };
                let steps = Vec3::new(2047.0, 1023.0, 2047.0);
                let means = extent(&|i| splats.mean(i)) / steps;
                let scales = extent(&|i| splats.log_scales()[i]) / steps;
                let colors = extent(&|i| color_of(splats.sh(i))) / 255.0;
                for (k, &i) in chunk.iter().enumerate() {
                    let found = c * CHUNK + k;
                    // Half a step, and the rounding of f32 at numbers below 8.
                    let is_near = |a: Vec3, b: Vec3, step: Vec3| (a - b).abs().cmple(0.5 * step + 1e-6).all();
                    assert!(is_near(again.mean(found), splats.mean(i), means), "mean of {i}");
                    assert!(is_near(again.log_scales()[found], splats.log_scales()[i], scales), "scale of {i}");
                    assert!(is_near(color_of(again.sh(found)), color_of(splats.sh(i)), colors), "color of {i}");
                    assert!((again.opacity(found) - splats.opacity(i)).abs() < 0.5 / 255.0 + 1e-6);
                    let turn = again.rotation(found).dot(splats.rotation(i)).abs();
                    // Three entries are off by d, half a step; the fourth, at least ½, by at most 3 d. 1 − q · q' is
                    // half of the sum of their squares, and f32 rounds.
                    let d = 0.5 * std::f32::consts::SQRT_2 / 1023.0;
                    assert!(turn > 1.0 - 0.5 * (3.0 * d * d + 9.0 * d * d) - 5e-7, "{turn}");
                    for (a, b) in again.sh(found)[3..].iter().zip(&splats.sh(i)[3..]) {
                        assert!((a - b).abs() <= 4.0 / 256.0 + 1e-6, "{a} {b}");
                    }
                }
            }
        }
    }

    #[test]
    fn files_that_came_compressed_keep_their_order() {
        let once = read_again(&random(300, 1));
        let twice = read_again(&once);
        // Ends of ranges are splats' own numbers, so that ranges and with them all words are the same.
        assert_eq!((once.means(), once.log_scales()), (twice.means(), twice.log_scales()));
        assert_eq!((once.opacity_logits(), &once.sh), (twice.opacity_logits(), &twice.sh));
    }
}
