//! Splats on an image, and the way back: from the derivatives by their ellipses to those by their parameters.
//!
//! Letters as in `splats::render`: t centre in camera axes (x right, y down, z forward), m its image, W covariance in
//! camera axes, J Jacobian of m by t with x/z and y/z limited, Σ₂ = J W Jᵀ + 0.3 I, A = Σ₂⁻¹. The code is its own, in
//! f32.

use glam::{Mat3, Vec2, Vec3};

use super::cloud::{LOGIT, MEAN, ROTATION, Row, SCALE, SH, WIDTH, opacity, rotation, three};
use super::harmonics;
use crate::geometry::Camera;

/// Variance by which every splat grows on the image, pixels².
const DILATION: f32 = 0.3;
/// Splats nearer than this are not drawn, scene units along the view axis.
const NEAR: f32 = 0.2;
/// Half angles to which the Jacobian's x/z and y/z are limited.
const BEYOND: f32 = 1.3;
/// Least opacity that is drawn.
pub const FAINTEST: f32 = 1.0 / 255.0;

/// A splat on the image.
#[derive(Debug, Clone, Copy)]
pub struct Ellipse {
    /// Index of the splat.
    pub splat: u32,
    /// m, pixels.
    pub mean: Vec2,
    /// A₀₀, A₀₁, A₁₁.
    pub conic: [f32; 3],
    /// Half width and height of what is drawn, pixels.
    pub extent: Vec2,
    pub opacity: f32,
    pub depth: f32,
    pub color: Vec3,
}

/// Sums over the pixels p of an ellipse, with d = m − p and s = α ∂L/∂α (0 where α is limited): s times 1, d₀, d₁, d₀²,
/// d₀d₁ and d₁², then w ∂L/∂C for each channel.
pub type Moments = [f32; 9];

/// A camera as splats need it.
pub struct View {
    eye: Vec3,
    /// Scene to camera: rows right, down, forward.
    rotation: Mat3,
    focal: Vec2,
    center: Vec2,
    limits: [Vec2; 2],
    resolution: Vec2,
    /// Degree of the spherical harmonics that are shown.
    degree: u8,
}

/// A splat in camera axes.
struct Shape {
    t: Vec3,
    /// Limited x/z and y/z.
    tangent: Vec2,
    is_limited: [bool; 2],
    /// Rows of J.
    j: [Vec3; 2],
    /// The splat's axes times their deviations, in camera axes: W = M Mᵀ.
    m: Mat3,
    w: Mat3,
}

impl View {
    pub fn new(camera: &Camera, degree: u8) -> Self {
        let [right, up, back] = [camera.axes.x_axis, camera.axes.y_axis, camera.axes.z_axis];
        let vec2 = |v: [f64; 2]| Vec2::new(v[0] as f32, v[1] as f32);
        let (focal, center) = (vec2(camera.focal), vec2(camera.center));
        let resolution = vec2(camera.resolution.map(f64::from));
        let margin = (BEYOND - 1.0) * 0.5 * resolution / focal;
        Self {
            eye: camera.position.as_vec3(),
            rotation: Mat3::from_cols(right.as_vec3(), -up.as_vec3(), -back.as_vec3()).transpose(),
            focal,
            center,
            limits: [-center / focal - margin, (resolution - center) / focal + margin],
            resolution,
            degree,
        }
    }

    fn shape(&self, row: &Row) -> Option<Shape> {
        let t = self.rotation * (three(row, MEAN) - self.eye);
        if t.z <= NEAR {
            return None;
        }
        let ratio = Vec2::new(t.x, t.y) / t.z;
        let tangent = ratio.clamp(self.limits[0], self.limits[1]);
        let slope = self.focal / t.z;
        let j = [Vec3::new(slope.x, 0.0, -slope.x * tangent.x), Vec3::new(0.0, slope.y, -slope.y * tangent.y)];
        let scales = three(row, SCALE).exp();
        let m = self.rotation * Mat3::from_quat(rotation(row)) * Mat3::from_diagonal(scales);
        let is_limited = [tangent.x != ratio.x, tangent.y != ratio.y];
        Some(Shape { t, tangent, is_limited, j, m, w: m * m.transpose() })
    }

    /// Splat `i` on the image; `None` if no pixel shows it.
    pub fn ellipse(&self, i: usize, row: &Row) -> Option<Ellipse> {
        let Shape { t, j, w, .. } = self.shape(row)?;
        let mean = self.focal * Vec2::new(t.x, t.y) / t.z + self.center;
        let wj = [w * j[0], w * j[1]];
        let (a, b, c) = (j[0].dot(wj[0]) + DILATION, j[0].dot(wj[1]), j[1].dot(wj[1]) + DILATION);
        let determinant = a * c - b * b;
        let opacity = opacity(row);
        let reach = 2.0 * (opacity / FAINTEST).ln();
        if !(reach >= 0.0 && determinant > 0.0 && determinant.is_finite()) {
            return None;
        }
        let extent = Vec2::new((reach * a).sqrt(), (reach * c).sqrt());
        let is_inside = (mean + extent).cmpge(Vec2::ZERO).all() && (mean - extent).cmple(self.resolution).all();
        is_inside.then(|| {
            let values = harmonics::values((three(row, MEAN) - self.eye).normalize());
            Ellipse {
                splat: i as u32,
                mean,
                conic: [c / determinant, -b / determinant, a / determinant],
                extent,
                opacity,
                depth: t.z,
                color: self.color(row, &values).max(Vec3::ZERO),
            }
        })
    }

    fn color(&self, row: &Row, values: &[f32; harmonics::COUNT]) -> Vec3 {
        let shown = 0..harmonics::count(self.degree);
        shown.fold(Vec3::splat(0.5), |sum, k| sum + values[k] * three(row, SH + 3 * k))
    }

    /// Derivatives of the loss by the parameters of a splat, and by its place on the image: ∂L/∂m, 1 / pixel.
    pub fn pull_back(&self, row: &Row, ellipse: &Ellipse, sums: &Moments) -> (Row, Vec2) {
        let mut gradient = [0.0; WIDTH];
        let Some(Shape { t, tangent, is_limited, j, m, w }) = self.shape(row) else {
            return (gradient, Vec2::ZERO);
        };
        let [s, sx, sy, sxx, sxy, syy, ..] = *sums;
        let [a, b, c] = ellipse.conic;
        gradient[LOGIT] = s * (1.0 - ellipse.opacity);
        let by_mean = -Vec2::new(a * sx + b * sy, b * sx + c * sy);
        // ∂L/∂Σ₂ = ½ A S A, with the sums of s d dᵀ as S.
        let (p, q) = ([a * sxx + b * sxy, a * sxy + b * syy], [b * sxx + c * sxy, b * sxy + c * syy]);
        let h = [0.5 * (p[0] * a + p[1] * b), 0.5 * (p[0] * b + p[1] * c), 0.5 * (q[0] * b + q[1] * c)];
        // ∂L/∂W = Jᵀ H J and ∂L/∂J = 2 H J W.
        let hj = [h[0] * j[0] + h[1] * j[1], h[1] * j[0] + h[2] * j[1]];
        let outer = |u: Vec3, v: Vec3| Mat3::from_cols(u * v.x, u * v.y, u * v.z);
        let by_w = outer(j[0], hj[0]) + outer(j[1], hj[1]);
        let by_j = [2.0 * (w * hj[0]), 2.0 * (w * hj[1])];
        let by_m = 2.0 * (by_w * m);
        for k in 0..3 {
            gradient[SCALE + k] = m.col(k).dot(by_m.col(k));
        }
        let scales = three(row, SCALE).exp();
        let by_rotation = self.rotation.transpose() * by_m * Mat3::from_diagonal(scales);
        gradient[ROTATION..ROTATION + 4].copy_from_slice(&by_quaternion(row, &by_rotation));

        let z = t.z;
        let mut by_t = Vec3::new(self.focal.x * by_mean.x / z, self.focal.y * by_mean.y / z, 0.0);
        by_t.z = -(by_t.x * t.x + by_t.y * t.y) / z;
        for axis in 0..2 {
            let (f, free) = (self.focal[axis], f32::from(u8::from(!is_limited[axis])));
            by_t[axis] -= free * f / (z * z) * by_j[axis].z;
            by_t.z += f / (z * z) * ((1.0 + free) * tangent[axis] * by_j[axis].z - by_j[axis][axis]);
        }
        let mut by_center = self.rotation.transpose() * by_t;

        let away = three(row, MEAN) - self.eye;
        let (distance, direction) = (away.length(), away.normalize());
        let (values, slopes) = (harmonics::values(direction), harmonics::gradients(direction));
        let shown = self.color(row, &values);
        let by_color = Vec3::from_slice(&sums[6..]) * Vec3::from(shown.cmpgt(Vec3::ZERO));
        let mut by_direction = Vec3::ZERO;
        for k in 0..harmonics::count(self.degree) {
            let at = SH + 3 * k;
            gradient[at..at + 3].copy_from_slice(&(values[k] * by_color).to_array());
            by_direction += three(row, at).dot(by_color) * slopes[k];
        }
        by_center += (by_direction - by_direction.dot(direction) * direction) / distance;
        gradient[MEAN..MEAN + 3].copy_from_slice(&by_center.to_array());
        (gradient, by_mean)
    }
}

/// Derivative by a quaternion (x, y, z, w) of length 1, from that by its rotation matrix. Its length changes nothing.
fn by_quaternion(row: &Row, g: &Mat3) -> [f32; 4] {
    let q = rotation(row);
    let at = |i: usize, k: usize| g.col(k)[i];
    let (sum, difference) = (|i, k| at(i, k) + at(k, i), |i, k| at(i, k) - at(k, i));
    let by = [
        q.y * sum(0, 1) + q.z * sum(0, 2) + q.w * difference(2, 1) - 2.0 * q.x * (at(1, 1) + at(2, 2)),
        q.x * sum(0, 1) + q.z * sum(1, 2) + q.w * difference(0, 2) - 2.0 * q.y * (at(0, 0) + at(2, 2)),
        q.x * sum(0, 2) + q.y * sum(1, 2) + q.w * difference(1, 0) - 2.0 * q.z * (at(0, 0) + at(1, 1)),
        q.x * difference(2, 1) + q.y * difference(0, 2) + q.z * difference(1, 0),
    ];
    let unit = q.to_array();
    let along: f32 = (0..4).map(|k| by[k] * unit[k]).sum();
    std::array::from_fn(|k| 2.0 * (by[k] - along * unit[k]))
}
