//! Writes `.spz` files.

use std::io::Write;
use std::path::Path;

use flate2::Compression;
use flate2::write::GzEncoder;
use glam::Vec4;
use half::f16;
use ruzstd::encoding::{CompressionLevel, compress_to_vec};

use super::super::super::columns::Packing;
use super::super::super::{RenderMode, Splats};
use super::super::byte_of;
use super::turn::{STORED, Turn};
use super::{ANTIALIASED, HEADER_4, MAGIC, pack};
use octobayes::io::AtomicFile;
use octobayes::{Error, Result};

/// The version of files that were in another format, which all readers know.
const VERSION: u32 = 3;
/// Bits of a coordinate behind the point in such files, if the scene fits in the bits before it.
const FRACTIONAL_BITS: u8 = 12;
/// Bits of a coordinate but for its sign, and the most behind the point.
const BITS: i32 = 23;
const MOST_FRACTIONAL_BITS: i32 = 24;
/// Steps of higher coefficients in such files, of 256, as Niantic's writer has them: of the first degree, of others.
const STEPS: [u8; 2] = [8, 16];

/// The number of bits behind the point: twelve, or more in a scene smaller than 1, and no more than leave room for all
/// coordinates.
fn fractional_bits(splats: &Splats) -> u8 {
    let farthest = splats.means().iter().map(|x| f64::from(x.abs().max_element())).fold(f64::MIN_POSITIVE, f64::max);
    // The largest number is 2^23 − 1, which a coordinate just below a power of two would be rounded beyond.
    let before = (farthest * (1.0 + 1e-6)).log2().floor() as i32 + 1;
    let wanted = i32::from(FRACTIONAL_BITS) + (-before).max(0);
    wanted.min(BITS - before).clamp(0, MOST_FRACTIONAL_BITS) as u8
}

/// Writes splats in the version and with the steps of the file that they came from.
///
/// # Errors
/// If a coordinate is too large, or if the file cannot be written.
pub(in super::super) fn write(splats: &Splats, path: &Path) -> Result<()> {
    let largest = f64::from((1_u32 << BITS) - 1);
    let far = splats.means().iter().position(|x| f64::from(x.abs().max_element()) > largest);
    if let Some(i) = far {
        let expected = format!("coordinates up to {largest}, as `.spz` files can have them");
        return Err(Error::setting(format!("mean of splat {i}"), expected, splats.mean(i).to_string()));
    }
    let bytes = bytes(splats).map_err(Error::io(path, "cannot pack"))?;
    AtomicFile::write(path, &bytes)
}

fn bytes(splats: &Splats) -> std::io::Result<Vec<u8>> {
    let (version, bits, steps) = match splats.layout.packing {
        Packing::Spz { version, fractional_bits } => (version, fractional_bits, [1, 1]),
        _ => (VERSION, fractional_bits(splats), STEPS),
    };
    let parts = parts(splats, version, bits, steps);
    let mut header = [MAGIC, &version.to_le_bytes(), &(splats.len() as u32).to_le_bytes()].concat();
    let flags = if splats.mode() == RenderMode::Classic { 0 } else { ANTIALIASED };
    header.extend([splats.degree(), bits, flags, 0]);
    if version < 4 {
        let mut gzip = GzEncoder::new(Vec::new(), Compression::default());
        gzip.write_all(&header)?;
        parts.iter().try_for_each(|part| gzip.write_all(part))?;
        return gzip.finish();
    }
    let streams = parts.iter().filter(|part| !part.is_empty());
    let streams: Vec<(usize, Vec<u8>)> =
        streams.map(|part| (part.len(), compress_to_vec(&part[..], CompressionLevel::Fastest))).collect();
    header[15] = streams.len() as u8;
    header.extend((HEADER_4 as u32).to_le_bytes());
    header.resize(HEADER_4, 0);
    for (size, stream) in &streams {
        header.extend([stream.len() as u64, *size as u64].iter().flat_map(|size| size.to_le_bytes()));
    }
    streams.iter().for_each(|(_, stream)| header.extend(stream));
    Ok(header)
}

/// Positions, alphas, colours, scales, rotations and higher coefficients.
fn parts(splats: &Splats, version: u32, fractional_bits: u8, steps: [u8; 2]) -> [Vec<u8>; 6] {
    let turn = Turn::from(STORED);
    let unit = f64::from(fractional_bits).exp2();
    let positions = splats.means().iter().flat_map(|x| turn.position(*x).to_array());
    let positions = if version == 1 {
        positions.flat_map(|v| f16::from_f32(v).to_le_bytes()).collect()
    } else {
        positions.flat_map(|v| pack::to_fixed(f64::from(v) * unit)).collect()
    };
    let all = || 0..splats.len();
    let rotations = all().map(|i| turn.rotation(Vec4::from(splats.rotation(i))));
    let rotations = if version < 3 {
        rotations.flat_map(pack::to_first_three).collect()
    } else {
        rotations.flat_map(pack::to_smallest_three).collect()
    };
    let scale = |v: f32| ((v + 10.0) * 16.0).round().clamp(0.0, 255.0) as u8;
    let higher = |i: usize| splats.sh(i)[3..].iter().enumerate().map(move |(k, v)| (1 + k / 3, *v));
    [
        positions,
        all().map(|i| byte_of(splats.opacity(i))).collect(),
        all().flat_map(|i| [0, 1, 2].map(|channel| pack::to_constant(splats.sh(i)[channel]))).collect(),
        splats.log_scales().iter().flat_map(|s| s.to_array().map(scale)).collect(),
        rotations,
        all()
            .flat_map(higher)
            .map(|(harmonic, v)| pack::to_coefficient(turn.sh(harmonic) * v, steps[usize::from(harmonic > 3)]))
            .collect(),
    ]
}

#[cfg(test)]
mod tests {
    use glam::{Quat, Vec3};

    use super::super::super::tests::random;
    use super::*;

    fn read_again(splats: &Splats) -> Splats {
        super::super::read(Path::new("s.spz"), &bytes(splats).unwrap()).unwrap()
    }

    /// By how much q · q' is below 1 at most, half of |q − q'|². Three entries are off by d, half a step of 9 bits; the
    /// fourth, at least ½, by (|a| + |b| + |c|) d / ½ ≤ 3 d. And f32 rounds.
    fn turned_by_three() -> f32 {
        let d = 0.5 * std::f32::consts::FRAC_1_SQRT_2 / 511.0;
        0.5 * (3.0 * d * d + 9.0 * d * d) + 5e-7
    }

    /// The same of three bytes: x, y and z are off by d = 1/255, so that w² is by 2 (|x| + |y| + |z|) d ≤ 2 √3 d, and w by
    /// the root of that if it is 0.
    fn turned_by_first() -> f32 {
        let d = 1.0 / 255.0;
        0.5 * (3.0 * d * d + 2.0 * 3_f32.sqrt() * d)
    }

    fn packed_as(splats: &Splats, version: u32, fractional_bits: u8) -> Splats {
        let mut splats = splats.clone();
        splats.layout.packing = Packing::Spz { version, fractional_bits };
        splats
    }

    #[test]
    fn numbers_come_back_within_half_a_step() {
        for (degree, version) in [(0, 1), (1, 2), (2, 3), (3, 4), (3, 2), (0, 4), (3, 0)] {
            let splats = random(200, degree);
            let whole = if version == 0 { splats.clone() } else { packed_as(&splats, version, 12) };
            let again = read_again(&whole);
            assert_eq!((again.len(), again.degree(), again.mode()), (200, degree, RenderMode::Mip));
            // The half of 2⁻¹²; the half of 2⁻⁹, as f16 has 11 bits. Means are below 4.
            let position = if version == 1 { 0.5 / 512.0 } else { 0.5 / 4096.0 };
            let turned = if version == 0 || version > 2 { turned_by_three() } else { turned_by_first() };
            for i in 0..200 {
                assert!((again.mean(i) - splats.mean(i)).abs().max_element() <= position, "version {version}");
                assert!((again.log_scales()[i] - splats.log_scales()[i]).abs().max_element() <= 1.0 / 32.0 + 1e-6);
                assert!((again.opacity(i) - splats.opacity(i)).abs() < 0.5 / 255.0 + 1e-6);
                let dot = again.rotation(i).dot(splats.rotation(i)).abs();
                assert!(dot > 1.0 - turned, "version {version}: {dot}");
                for (k, (a, b)) in again.sh(i).iter().zip(splats.sh(i)).enumerate() {
                    let steps = if version == 0 { STEPS.map(f32::from) } else { [1.0; 2] };
                    let step = if k < 12 { steps[0] } else { steps[1] };
                    let limit = if k < 3 { 0.5 / 255.0 / 0.15 } else { 0.5 * step / 128.0 };
                    // The highest byte is a step below 1, and signs depend on axes.
                    let limit = if b.abs() > 1.0 - step / 128.0 { limit.max(step / 128.0) } else { limit };
                    assert!((a - b).abs() <= limit + 1e-6, "version {version}, coefficient {k}: {a} {b}");
                }
            }
        }
    }

    #[test]
    fn nothing_is_lost_a_second_time_and_the_version_stays() {
        for version in 1..=4 {
            let once = read_again(&packed_as(&random(300, 3), version, 10));
            assert_eq!(once.layout.packing, Packing::Spz { version, fractional_bits: 10 });
            let kept: Vec<bool> = (0..300).map(|i| i % 3 > 0).collect();
            let mut part = once.keep(&kept).unwrap();
            let again = read_again(&part);
            // Where two entries of a rotation are nearly the largest, the other one may be left out this time.
            let rotations = part.rotations.iter().zip(&again.rotations);
            let turned = if version > 2 { turned_by_three() } else { turned_by_first() };
            assert!(rotations.clone().all(|(a, b)| a.dot(*b).abs() > 1.0 - turned), "version {version}");
            assert!(rotations.filter(|(a, b)| a != b).count() < 10, "version {version}");
            part.rotations.clone_from(&again.rotations);
            assert!(again == part, "version {version}");
        }
    }

    #[test]
    fn coordinates_have_as_many_bits_as_the_scene_leaves() {
        let at = |x: f32| {
            let one = vec![Vec3::X * x];
            Splats::new(one, vec![Vec3::ONE], vec![Quat::IDENTITY], vec![0.0], vec![0.0; 3], 0, RenderMode::Mip)
                .unwrap()
        };
        let bits = [1.0, 0.5, 0.2, 1e-9, 2047.9, 2048.0, 8_388_607.0].map(|x| fractional_bits(&at(x)));
        assert_eq!(bits, [12, 12, 14, 24, 12, 11, 0]);
        for x in [-8_388_607.0, 4095.9, 1e-3] {
            let unit = f32::from(fractional_bits(&at(x))).exp2().recip();
            assert!((read_again(&at(x)).mean(0).x - x).abs() <= 0.5 * unit, "{x}");
        }
        let error = write(&at(1e7), Path::new("s.spz")).unwrap_err().to_string();
        assert!(error.starts_with("mean of splat 0: expected coordinates up to 8388607, as"), "{error}");
    }
}
