//! Encoding of the viewing direction in radiance fields.

/// Real spherical harmonics up to degree 3 of the unit vector (x, y, z), in instant-ngp's order and signs.
#[inline(always)]
pub fn spherical_harmonics(x: f32, y: f32, z: f32) -> [f32; 16] {
    // 1 / (2 √π) times √3, √15, √5/2, √15/2, √70/4, √105, √42/4, √7/2 and √105/2.
    const C0: f32 = 0.282_094_8;
    const C1: f32 = 0.488_602_5;
    const C2: f32 = 1.092_548_4;
    const C2Z: f32 = 0.315_391_57;
    const C2X: f32 = 0.546_274_2;
    const C3Y: f32 = 0.590_043_6;
    const C3: f32 = 2.890_611_4;
    const C3M: f32 = 0.457_045_8;
    const C3Z: f32 = 0.373_176_33;
    const C3X: f32 = 1.445_305_7;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        C0,
        -C1 * y,
        C1 * z,
        -C1 * x,
        C2 * x * y,
        -C2 * y * z,
        C2Z * (3.0 * zz - 1.0),
        -C2 * x * z,
        C2X * (xx - yy),
        C3Y * y * (yy - 3.0 * xx),
        C3 * x * y * z,
        C3M * y * (1.0 - 5.0 * zz),
        C3Z * z * (5.0 * zz - 3.0),
        C3M * x * (1.0 - 5.0 * zz),
        C3X * z * (xx - yy),
        C3Y * x * (3.0 * yy - xx),
    ]
}
