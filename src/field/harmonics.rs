//! Real spherical harmonics up to degree 3, with the order and the signs of instant-ngp and of splats.

use glam::DVec3;

/// Number of functions up to degree 3.
pub const COUNT: usize = 16;

/// The constant function.
pub const C0: f64 = 0.282_094_791_773_878_14;
// 1 / (2 √π) times 1, √3, √15, √5/2, √15/2, √70/4, √105, √42/4, √7/2 and √105/2.
const C1: f64 = 0.488_602_511_902_919_9;
const C2: f64 = 1.092_548_430_592_079_2;
const C2Z: f64 = 0.315_391_565_252_520_05;
const C2X: f64 = 0.546_274_215_296_039_6;
const C3Y: f64 = 0.590_043_589_926_643_5;
const C3: f64 = 2.890_611_442_640_554;
const C3M: f64 = 0.457_045_799_464_465_8;
const C3Z: f64 = 0.373_176_332_590_115_4;
const C3X: f64 = 1.445_305_721_320_277;

/// Their values at the unit vector (x, y, z) in f32, where x² + y² + z² = 1 saves work: the encoding of the viewing
/// direction in radiance fields.
#[inline(always)]
#[must_use]
pub fn spherical_harmonics(x: f32, y: f32, z: f32) -> [f32; COUNT] {
    // Their digits are part of every trained model.
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

/// Their values at d, as homogeneous polynomials in its components.
#[must_use]
pub fn values(d: DVec3) -> [f64; COUNT] {
    let DVec3 { x, y, z } = d;
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

/// Gradients of these polynomials by the components of d.
#[must_use]
pub fn gradients(d: DVec3) -> [DVec3; COUNT] {
    let DVec3 { x, y, z } = d;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        DVec3::ZERO,
        DVec3::new(0.0, -C1, 0.0),
        DVec3::new(0.0, 0.0, C1),
        DVec3::new(-C1, 0.0, 0.0),
        C2 * DVec3::new(y, x, 0.0),
        -C2 * DVec3::new(0.0, z, y),
        2.0 * C2Z * DVec3::new(-x, -y, 2.0 * z),
        -C2 * DVec3::new(z, 0.0, x),
        2.0 * C2X * DVec3::new(x, -y, 0.0),
        -3.0 * C3Y * DVec3::new(2.0 * x * y, xx - yy, 0.0),
        C3 * DVec3::new(y * z, x * z, x * y),
        -C3M * DVec3::new(-2.0 * x * y, 4.0 * zz - xx - 3.0 * yy, 8.0 * y * z),
        C3Z * DVec3::new(-6.0 * x * z, -6.0 * y * z, 6.0 * zz - 3.0 * xx - 3.0 * yy),
        -C3M * DVec3::new(4.0 * zz - 3.0 * xx - yy, -2.0 * x * y, 8.0 * x * z),
        C3X * DVec3::new(2.0 * x * z, -2.0 * y * z, xx - yy),
        -3.0 * C3Y * DVec3::new(xx - yy, -2.0 * x * y, 0.0),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn functions_are_orthonormal() {
        // Products of two are polynomials of degree 6 at most: Gauss-Legendre with 4 nodes and 8 angles is exact.
        let nodes =
            [(0.861_136_311_594_052_6, 0.347_854_845_137_453_9), (0.339_981_043_584_856_3, 0.652_145_154_862_546_1)];
        let mut products = [[0.0; COUNT]; COUNT];
        for (node, weight) in nodes.into_iter().flat_map(|(z, w)| [(z, w), (-z, w)]) {
            for step in 0..8 {
                let angle = f64::from(step) * std::f64::consts::FRAC_PI_4;
                let r = f64::sqrt(1.0 - node * node);
                let at = values(DVec3::new(r * angle.cos(), r * angle.sin(), node));
                for (i, row) in products.iter_mut().enumerate() {
                    for (j, sum) in row.iter_mut().enumerate() {
                        *sum += weight * std::f64::consts::FRAC_PI_4 * at[i] * at[j];
                    }
                }
            }
        }
        for (i, row) in products.iter().enumerate() {
            for (j, found) in row.iter().enumerate() {
                assert!((found - f64::from(u8::from(i == j))).abs() < 1e-14, "{i}, {j}: {found}");
            }
        }
    }

    #[test]
    fn gradients_are_those_of_the_values() {
        let h = 1e-5;
        for at in [DVec3::new(0.6, -0.48, 0.64), DVec3::new(-0.36, 0.48, -0.8)] {
            for (k, gradient) in gradients(at).into_iter().enumerate() {
                for axis in 0..3 {
                    let step = h * DVec3::AXES[axis];
                    let numeric = (values(at + step)[k] - values(at - step)[k]) / (2.0 * h);
                    // Third derivatives are below 20.
                    assert!((numeric - gradient[axis]).abs() < 4.0 * h * h + 1e-10, "{k}, {axis}: {numeric}");
                }
            }
        }
    }
}
