//! The numbers of `.spz` files.

use std::f32::consts::FRAC_1_SQRT_2;

use glam::Vec4;

use super::super::without_largest;

/// A whole number of 24 bits with its sign.
pub(super) const fn fixed(bytes: [u8; 3]) -> i32 {
    // The sign bit comes to the top, and is copied downwards.
    i32::from_le_bytes([0, bytes[0], bytes[1], bytes[2]]) >> 8
}

/// The constant coefficient of a colour channel.
pub(super) fn constant(byte: u8) -> f32 {
    (f32::from(byte) / 255.0 - 0.5) / 0.15
}

/// A higher coefficient.
pub(super) fn coefficient(byte: u8) -> f32 {
    (f32::from(byte) - 128.0) / 128.0
}

/// A rotation (x, y, z, w) of versions 1 and 2: x, y and z; w is what is left, and positive.
pub(super) fn first_three(bytes: [u8; 3]) -> Vec4 {
    let [x, y, z] = bytes.map(|byte| f32::from(byte) / 127.5 - 1.0);
    Vec4::new(x, y, z, (1.0 - (x * x + y * y + z * z)).max(0.0).sqrt())
}

/// A rotation (x, y, z, w) from version 3 on: which entry is the largest, and the others with sign and 9 bits.
pub(super) fn smallest_three(bytes: [u8; 4]) -> Vec4 {
    const LARGEST: u32 = (1 << 9) - 1;
    let mut word = u32::from_le_bytes(bytes);
    let largest = (word >> 30) as usize;
    let mut q = [0.0_f32; 4];
    for i in (0..4).rev().filter(|i| *i != largest) {
        let size = FRAC_1_SQRT_2 * (word & LARGEST) as f32 / LARGEST as f32;
        q[i] = if word >> 9 & 1 == 1 { -size } else { size };
        word >>= 10;
    }
    q[largest] = (1.0 - q.iter().map(|v| v * v).sum::<f32>()).max(0.0).sqrt();
    Vec4::from_array(q)
}

/// The nearest whole number of 24 bits with its sign.
pub(super) fn to_fixed(value: f64) -> [u8; 3] {
    let most = f64::from((1 << 23) - 1);
    let [a, b, c, _] = (value.round().clamp(-most - 1.0, most) as i32).to_le_bytes();
    [a, b, c]
}

/// The byte of a constant coefficient.
pub(super) fn to_constant(value: f32) -> u8 {
    ((value * 0.15 + 0.5) * 255.0).round().clamp(0.0, 255.0) as u8
}

/// The byte of a higher coefficient, a multiple of `step`.
pub(super) fn to_coefficient(value: f32, step: u8) -> u8 {
    let (step, byte) = (f32::from(step), value * 128.0 + 128.0);
    ((byte / step).round() * step).clamp(0.0, 255.0) as u8
}

/// The three bytes of a rotation (x, y, z, w) in versions 1 and 2.
pub(super) fn to_first_three(q: Vec4) -> [u8; 3] {
    let q = if q.w < 0.0 { -q } else { q };
    [q.x, q.y, q.z].map(|v| ((v + 1.0) * 127.5).round().clamp(0.0, 255.0) as u8)
}

/// The four bytes of a rotation (x, y, z, w) from version 3 on.
pub(super) fn to_smallest_three(q: Vec4) -> [u8; 4] {
    let (largest, others) = without_largest(q.to_array());
    let entry = |v: f32| {
        let size = (v.abs() / FRAC_1_SQRT_2 * 511.0).round().min(511.0) as u32;
        u32::from(v < 0.0) << 9 | size
    };
    others.into_iter().fold(largest as u32, |word, v| word << 10 | entry(v)).to_le_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_unpacked() {
        assert_eq!([[1, 0, 0], [0, 0x10, 0], [0xff; 3], [0, 0, 0x80]].map(fixed), [1, 4096, -1, -(1 << 23)]);
        assert!((constant(255) - 0.5 / 0.15).abs() < 1e-6 && constant(0) == -constant(255));
        assert_eq!([0, 128, 192].map(coefficient), [-1.0, 0.0, 0.5]);
    }

    #[test]
    fn rotations_are_unpacked() {
        let half = FRAC_1_SQRT_2;
        let close = |a: Vec4, b: Vec4| assert!((a - b).length() < 0.01, "{a} {b}");
        close(first_three([255, 128, 127]), Vec4::X);
        close(first_three([128, 218, 128]), Vec4::new(0.0, half, 0.0, half));
        // The largest is y; x, z and w follow from the top.
        let word: u32 = 1 << 30 | (1 << 9 | 511) << 20;
        close(smallest_three(word.to_le_bytes()), Vec4::new(-half, half, 0.0, 0.0));
        let word: u32 = 3 << 30 | 511 << 10;
        close(smallest_three(word.to_le_bytes()), Vec4::new(0.0, half, 0.0, half));
        // Three entries that are too large leave nothing for the fourth.
        let word: u32 = 511 << 20 | 511 << 10 | 511;
        assert_eq!(smallest_three(word.to_le_bytes()).x, 0.0);
    }
}
