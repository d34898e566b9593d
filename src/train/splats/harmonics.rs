//! Real spherical harmonics to degree 3 in f32, with the order and the signs of the original code, and their gradients.

use glam::Vec3;

/// Number of functions up to degree 3.
pub const COUNT: usize = 16;

/// Number of functions up to a degree.
pub const fn count(degree: u8) -> usize {
    (degree as usize + 1).pow(2)
}

const C0: f32 = 0.282_094_8;
const C1: f32 = 0.488_602_52;
const C2: f32 = 1.092_548_5;
const C2Z: f32 = 0.315_391_57;
const C2X: f32 = 0.546_274_24;
const C3Y: f32 = 0.590_043_6;
const C3: f32 = 2.890_611_4;
const C3M: f32 = 0.457_045_8;
const C3Z: f32 = 0.373_176_34;
const C3X: f32 = 1.445_305_7;

/// Coefficient of the constant function that shows a colour.
pub fn constant_of(color: f32) -> f32 {
    (color - 0.5) / C0
}

/// Values at a unit vector.
pub fn values(d: Vec3) -> [f32; COUNT] {
    let Vec3 { x, y, z } = d;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        C0,
        -C1 * y,
        C1 * z,
        -C1 * x,
        C2 * x * y,
        -C2 * y * z,
        C2Z * (2.0 * zz - xx - yy),
        -C2 * x * z,
        C2X * (xx - yy),
        -C3Y * y * (3.0 * xx - yy),
        C3 * x * y * z,
        -C3M * y * (4.0 * zz - xx - yy),
        C3Z * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -C3M * x * (4.0 * zz - xx - yy),
        C3X * z * (xx - yy),
        -C3Y * x * (xx - 3.0 * yy),
    ]
}

/// Gradients of the polynomials by the components of the vector.
pub fn gradients(d: Vec3) -> [Vec3; COUNT] {
    let Vec3 { x, y, z } = d;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        Vec3::ZERO,
        Vec3::new(0.0, -C1, 0.0),
        Vec3::new(0.0, 0.0, C1),
        Vec3::new(-C1, 0.0, 0.0),
        C2 * Vec3::new(y, x, 0.0),
        -C2 * Vec3::new(0.0, z, y),
        2.0 * C2Z * Vec3::new(-x, -y, 2.0 * z),
        -C2 * Vec3::new(z, 0.0, x),
        2.0 * C2X * Vec3::new(x, -y, 0.0),
        -3.0 * C3Y * Vec3::new(2.0 * x * y, xx - yy, 0.0),
        C3 * Vec3::new(y * z, x * z, x * y),
        -C3M * Vec3::new(-2.0 * x * y, 4.0 * zz - xx - 3.0 * yy, 8.0 * y * z),
        C3Z * Vec3::new(-6.0 * x * z, -6.0 * y * z, 6.0 * zz - 3.0 * xx - 3.0 * yy),
        -C3M * Vec3::new(4.0 * zz - 3.0 * xx - yy, -2.0 * x * y, 8.0 * x * z),
        C3X * Vec3::new(2.0 * x * z, -2.0 * y * z, xx - yy),
        -3.0 * C3Y * Vec3::new(xx - yy, -2.0 * x * y, 0.0),
    ]
}
