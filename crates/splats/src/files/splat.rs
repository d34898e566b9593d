//! `.splat`: 32 bytes a splat, as antimatter15's viewer reads them. Colours have no direction and 8 bits.

use std::path::Path;

use glam::{Vec3, Vec4};

use super::super::columns::Scalar;
use super::super::{RenderMode, Splats};
use super::raw::{Raw, logit};
use super::{byte_of, color_of, constant_of};
use octobayes::io::AtomicFile;
use octobayes::{Error, Result};

/// Mean and scales as f32, colour and opacity, rotation.
const SIZE: usize = 32;

/// Reads the bytes of a `.splat` file.
pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<Splats> {
    if !bytes.len().is_multiple_of(SIZE) {
        let expected = format!("a multiple of {SIZE} bytes");
        return Err(Error::malformed(path, "length", expected, format!("{} bytes", bytes.len())));
    }
    let n = bytes.len() / SIZE;
    let mut raw = Raw {
        means: Vec::with_capacity(n),
        log_scales: Vec::with_capacity(n),
        rotations: Vec::with_capacity(n),
        opacity_logits: Vec::with_capacity(n),
        sh: Vec::with_capacity(3 * n),
        degree: 0,
        mode: RenderMode::Classic,
    };
    for splat in bytes.chunks_exact(SIZE) {
        let number = |at: usize| Scalar::F32.decode(&splat[at..at + 4]) as f32;
        let vector = |at: usize| Vec3::new(number(at), number(at + 4), number(at + 8));
        raw.means.push(vector(0));
        raw.log_scales.push(vector(12).map(f32::ln));
        raw.sh.extend(splat[24..27].iter().map(|v| constant_of(f64::from(*v) / 255.0)));
        raw.opacity_logits.push(logit(f64::from(splat[27]) / 255.0));
        let [w, x, y, z] = [28, 29, 30, 31].map(|at: usize| (f32::from(splat[at]) - 128.0) / 128.0);
        raw.rotations.push(Vec4::new(x, y, z, w));
    }
    raw.finish(path, None, Vec::new())
}

/// Writes splats without what depends on the direction.
pub(super) fn write(splats: &Splats, path: &Path) -> Result<()> {
    let mut bytes = Vec::with_capacity(SIZE * splats.len());
    for i in 0..splats.len() {
        let numbers = splats.mean(i).to_array().into_iter().chain(splats.scale(i).to_array());
        bytes.extend(numbers.flat_map(f32::to_le_bytes));
        bytes.extend(color_of(splats.sh(i)).to_array().map(byte_of));
        bytes.push(byte_of(splats.opacity(i)));
        let q = splats.rotation(i);
        // −1 has a byte, 1 has none; q and −q are one rotation.
        let sign = if q.to_array().iter().any(|v| v * 128.0 > 127.5) { -1.0 } else { 1.0 };
        bytes.extend([q.w, q.x, q.y, q.z].map(|v| (sign * v * 128.0 + 128.0).round().clamp(0.0, 255.0) as u8));
    }
    AtomicFile::write(path, &bytes)
}

#[cfg(test)]
mod tests {
    use glam::Quat;

    use super::*;

    #[test]
    fn the_numbers_of_a_splat_are_where_the_format_has_them() {
        let mut bytes = Vec::new();
        for v in [1.0_f32, -2.0, 3.0, 0.5, 1.0, 0.0] {
            bytes.extend(v.to_le_bytes());
        }
        bytes.extend([255, 0, 51, 204, 128, 128, 255, 128]);
        let splats = read(Path::new("s.splat"), &bytes).unwrap();
        assert_eq!((splats.mean(0), splats.degree(), splats.len()), (Vec3::new(1.0, -2.0, 3.0), 0, 1));
        assert_eq!(splats.log_scales()[0].truncate(), Vec3::new(0.5, 1.0, 1.0).map(f32::ln).truncate());
        assert!((splats.opacity(0) - 0.8).abs() < 1e-6);
        // Colour is ½ + 0.282 f.
        let colors = [0, 1, 2].map(|c| 0.5 + 0.282_094_8 * splats.sh(0)[c]);
        for (found, expected) in colors.into_iter().zip([1.0, 0.0, 0.2]) {
            assert!((found - expected).abs() < 1e-6, "{found} {expected}");
        }
        assert_eq!(splats.rotation(0), Quat::from_xyzw(0.0, 1.0, 0.0, 0.0));
        let error = read(Path::new("s.splat"), &bytes[..31]).unwrap_err().to_string();
        assert_eq!(error, "s.splat: length: expected a multiple of 32 bytes, found 31 bytes");
        assert!(read(Path::new("s.splat"), &[]).is_err());
        // A negative scale has no logarithm.
        bytes[15] |= 0x80;
        let error = read(Path::new("s.splat"), &bytes).unwrap_err().to_string();
        assert!(error.contains("splat 0, log scale: expected numbers") && error.contains("NaN"), "{error}");
    }
}
