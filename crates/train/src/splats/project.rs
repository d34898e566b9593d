//! Splats on an image, and the way back: from the derivatives by their ellipses to those by their parameters.
//!
//! Letters as in [`octobayes_splats`]' renderer, which projects: t centre in camera axes (x right, y down, z forward),
//! m its image, W covariance in camera axes, J Jacobian of m by t with x/z and y/z limited, Σ₂ = J W Jᵀ + 0.3 I, A =
//! Σ₂⁻¹. Projecting takes f64 numbers and compositing f32: a splat has many pixels.

use glam::{DMat3, DVec2, DVec3, Vec2, Vec3};

use super::cloud::{LOGIT, MEAN, ROTATION, Row, SCALE, SH, WIDTH, opacity, rotation, three};
use octobayes::field::harmonics;
use octobayes::geometry::Camera;
use octobayes_splats::{Footprint, Projector, RenderMode, Shape};

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
    projector: Projector,
    /// Number of spherical harmonics that are shown.
    harmonics: usize,
}

impl View {
    /// Of a camera, with spherical harmonics up to a degree.
    pub fn new(camera: &Camera, degree: u8) -> Self {
        Self { projector: Projector::new(camera), harmonics: (usize::from(degree) + 1).pow(2) }
    }

    fn shape(&self, row: &Row) -> Option<Shape> {
        self.projector.shape(three(row, MEAN), three(row, SCALE), rotation(row))
    }

    /// Splat `i` on the image; `None` if no pixel shows it.
    pub fn ellipse(&self, i: usize, row: &Row) -> Option<Ellipse> {
        let shape = self.shape(row)?;
        let color = || self.color(row, &harmonics::values(shape.away.normalize())).max(DVec3::ZERO);
        let footprint = self.projector.drawn(&shape, i as u32, f64::from(opacity(row)), RenderMode::Classic, color)?;
        let Footprint { splat, mean, conic, extent, opacity, depth, color, .. } = footprint;
        Some(Ellipse {
            splat,
            mean: mean.as_vec2(),
            conic: conic.map(|v| v as f32),
            extent: extent.as_vec2(),
            opacity: opacity as f32,
            depth: depth as f32,
            color: color.as_vec3(),
        })
    }

    fn color(&self, row: &Row, values: &[f64; harmonics::COUNT]) -> DVec3 {
        let shown = 0..self.harmonics;
        shown.fold(DVec3::splat(0.5), |sum, k| sum + values[k] * three(row, SH + 3 * k).as_dvec3())
    }

    /// Derivatives of the loss by the parameters of a splat, and by its place on the image: ∂L/∂m, 1 / pixel.
    pub fn pull_back(&self, row: &Row, ellipse: &Ellipse, sums: &Moments) -> (Row, Vec2) {
        let mut gradient = [0.0; WIDTH];
        let Some(shape) = self.shape(row) else {
            return (gradient, Vec2::ZERO);
        };
        let Shape { away, t, j, scales, m, w, .. } = shape;
        gradient[LOGIT] = sums[0] * (1.0 - ellipse.opacity);
        let [_, sx, sy, sxx, sxy, syy, by_color @ ..] = sums.map(f64::from);
        let [a, b, c] = ellipse.conic.map(f64::from);
        let by_mean = -DVec2::new(a * sx + b * sy, b * sx + c * sy);
        // ∂L/∂Σ₂ = ½ A S A, with the sums of s d dᵀ as S.
        let (p, q) = ([a * sxx + b * sxy, a * sxy + b * syy], [b * sxx + c * sxy, b * sxy + c * syy]);
        let h = [0.5 * (p[0] * a + p[1] * b), 0.5 * (p[0] * b + p[1] * c), 0.5 * (q[0] * b + q[1] * c)];
        // ∂L/∂W = Jᵀ H J and ∂L/∂J = 2 H J W.
        let hj = [h[0] * j[0] + h[1] * j[1], h[1] * j[0] + h[2] * j[1]];
        let outer = |u: DVec3, v: DVec3| DMat3::from_cols(u * v.x, u * v.y, u * v.z);
        let by_w = outer(j[0], hj[0]) + outer(j[1], hj[1]);
        let by_j = [2.0 * (w * hj[0]), 2.0 * (w * hj[1])];
        let by_m = 2.0 * (by_w * m);
        for k in 0..3 {
            gradient[SCALE + k] = m.col(k).dot(by_m.col(k)) as f32;
        }
        let to_scene = self.projector.rotation.transpose();
        let by_rotation = to_scene * by_m * DMat3::from_diagonal(scales);
        gradient[ROTATION..LOGIT].copy_from_slice(&by_quaternion(row, &by_rotation));

        let mut by_t = (self.projector.focal * by_mean / t.z).extend(0.0);
        by_t.z = -(by_t.x * t.x + by_t.y * t.y) / t.z;
        for axis in 0..2 {
            let bend = shape.bend(axis, self.projector.focal[axis]);
            by_t[axis] += bend.own * by_j[axis].z;
            by_t.z += bend.by_z[0] * by_j[axis][axis] + bend.by_z[1] * by_j[axis].z;
        }

        let direction = away.normalize();
        let (values, slopes) = (harmonics::values(direction), harmonics::gradients(direction));
        let is_shown = self.color(row, &values).cmpgt(DVec3::ZERO);
        let by_color = DVec3::select(is_shown, DVec3::from(by_color), DVec3::ZERO);
        let mut by_direction = DVec3::ZERO;
        for k in 0..self.harmonics {
            let at = SH + 3 * k;
            gradient[at..at + 3].copy_from_slice(&(values[k] * by_color).as_vec3().to_array());
            by_direction += three(row, at).as_dvec3().dot(by_color) * slopes[k];
        }
        let by_center = to_scene * by_t + (by_direction - by_direction.dot(direction) * direction) / away.length();
        gradient[MEAN..SCALE].copy_from_slice(&by_center.as_vec3().to_array());
        (gradient, by_mean.as_vec2())
    }
}

/// Derivative by a quaternion (x, y, z, w) of length 1, from that by its rotation matrix. Its length changes nothing.
fn by_quaternion(row: &Row, g: &DMat3) -> [f32; 4] {
    let q = rotation(row).as_dquat();
    let at = |i: usize, k: usize| g.col(k)[i];
    let (sum, difference) = (|i, k| at(i, k) + at(k, i), |i, k| at(i, k) - at(k, i));
    let by = [
        q.y * sum(0, 1) + q.z * sum(0, 2) + q.w * difference(2, 1) - 2.0 * q.x * (at(1, 1) + at(2, 2)),
        q.x * sum(0, 1) + q.z * sum(1, 2) + q.w * difference(0, 2) - 2.0 * q.y * (at(0, 0) + at(2, 2)),
        q.x * sum(0, 2) + q.y * sum(1, 2) + q.w * difference(1, 0) - 2.0 * q.z * (at(0, 0) + at(1, 1)),
        q.x * difference(2, 1) + q.y * difference(0, 2) + q.z * difference(1, 0),
    ];
    let unit = q.to_array();
    let along: f64 = (0..4).map(|k| by[k] * unit[k]).sum();
    std::array::from_fn(|k| (2.0 * (by[k] - along * unit[k])) as f32)
}
