//! Splats as a camera sees them: ellipses on the image, and how these move when a splat does.
//!
//! Letters: `t` centre in camera axes (x right, y down, z forward), m = (fx x/z + cx, fy y/z + cy) its image in pixels;
//! W covariance in camera axes; J Jacobian of m by t, with x/z and y/z limited to 1.3 half angles, so that splats
//! beside the image do not fill it; Σ₂ = J W Jᵀ + δ I with the mode's dilation δ; A = Σ₂⁻¹ the conic (Zwicker et al.
//! 2001, "EWA Volume Splatting"; Kerbl et al. 2023). Everything is f64: an image of a million splats still takes less
//! time to project than to composite.

use glam::{DMat3, DVec2, DVec3, Quat, Vec3};
use rayon::prelude::*;

use super::colors;
use crate::{RenderMode, Splats};
use octobayes::geometry::Camera;

/// Splats nearer than this are not drawn, scene units along the view axis: as in the original code.
pub const NEAR: f64 = 0.2;
/// Half angles to which the Jacobian's x/z and y/z are limited.
pub const FRUSTUM_MARGIN: f64 = 1.3;
/// Least opacity that is drawn.
pub const FAINTEST: f64 = 1.0 / 255.0;

/// A splat on the image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Footprint {
    /// Index of the splat.
    pub splat: u32,
    /// m, pixels.
    pub mean: DVec2,
    /// A₀₀, A₀₁, A₁₁, 1 / pixel².
    pub conic: [f64; 3],
    /// Half width and height of the ellipse in which the splat is drawn, pixels.
    pub extent: DVec2,
    /// What q is at its edge.
    pub reach: f64,
    /// Opacity at the centre, with the mode's compensation.
    pub opacity: f64,
    /// z, scene units.
    pub depth: f64,
    /// W₂₂, its variance along the view axis, scene units².
    pub thickness: f64,
    /// Colour in this view, 0 or more.
    pub color: DVec3,
}

/// How a splat's share of a pixel changes as its centre moves: ∂α/∂μ = α Σ_k `of_alpha[k]` n_k with n = (v₀, v₁, v₀²,
/// v₀v₁, v₁², 1), v = A (m − p).
///
/// f32: each entry is a number by itself, so that rounding is relative to it. Vectors have a fourth entry of 0, because
/// processors compute with four numbers at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slope {
    /// `[6]`, scene axes.
    pub of_alpha: [[f32; 4]; 6],
    /// ∂c/∂μ: row = channel, column = axis; 1 / scene unit.
    pub of_color: [[f32; 4]; 3],
}

/// A camera as splats need it.
pub struct Projector {
    eye: DVec3,
    /// Scene to camera: rows right, down, forward.
    pub rotation: DMat3,
    /// Focal lengths, pixels.
    pub focal: DVec2,
    center: DVec2,
    /// Least and largest x/z and y/z of the Jacobian.
    limits: [DVec2; 2],
    resolution: DVec2,
}

/// A splat's covariances in a view.
pub struct Shape {
    /// From the eye to the centre, scene axes.
    pub away: DVec3,
    /// Centre in camera axes, scene units.
    pub t: DVec3,
    /// Rows of J.
    pub j: [DVec3; 2],
    is_limited: [bool; 2],
    /// x/z and y/z as limited.
    tangent: DVec2,
    /// Standard deviations along the splat's axes.
    pub scales: DVec3,
    /// The splat's axes times these, in camera axes: W = M Mᵀ.
    pub m: DMat3,
    /// From world axes to those of the camera.
    pub w: DMat3,
    /// J W Jᵀ: its entries 00, 01, 11.
    raw: [f64; 3],
}

/// Entries of the derivatives of a row of J by t; the others are 0.
pub struct Bend {
    /// By the row's own x or y: the entry z.
    pub own: f64,
    /// By z: the row's own entry, and the entry z.
    pub by_z: [f64; 2],
}

impl Shape {
    /// How row `axis` of J changes with t, with the focal length `f` of that axis.
    #[must_use]
    pub fn bend(&self, axis: usize, f: f64) -> Bend {
        let (z, free) = (self.t.z, f64::from(u8::from(!self.is_limited[axis])));
        // ∂J₀₂/∂z of −f x/z², where x/z is either x over z or a limit.
        let by_z = [-f / (z * z), (1.0 + free) * f * self.tangent[axis] / (z * z)];
        Bend { own: -free * f / (z * z), by_z }
    }
}

/// Inverse of a symmetric 2×2 matrix, and its determinant.
fn inverse([a, b, c]: [f64; 3]) -> ([f64; 3], f64) {
    let determinant = a * c - b * b;
    ([c / determinant, -b / determinant, a / determinant], determinant)
}

fn dilated([a, b, c]: [f64; 3], by: f64) -> [f64; 3] {
    [a + by, b, c + by]
}

impl Projector {
    /// For a camera without distortion.
    pub fn new(camera: &Camera) -> Self {
        let [right, up, back] = [camera.axes.x_axis, camera.axes.y_axis, camera.axes.z_axis];
        let [focal, center] = [camera.focal, camera.center].map(DVec2::from);
        let resolution = DVec2::new(f64::from(camera.resolution[0]), f64::from(camera.resolution[1]));
        let margin = (FRUSTUM_MARGIN - 1.0) * 0.5 * resolution / focal;
        Self {
            eye: camera.position,
            rotation: DMat3::from_cols(right, -up, -back).transpose(),
            focal,
            center,
            limits: [-center / focal - margin, (resolution - center) / focal + margin],
            resolution,
        }
    }

    /// The number of splats whose centres are on the image, and how many of them are too near to be drawn.
    #[must_use]
    pub fn too_near(&self, splats: &Splats) -> [usize; 2] {
        let counted = |mean: &Vec3| {
            let t = self.rotation * (mean.as_dvec3() - self.eye);
            let at = self.focal * DVec2::new(t.x, t.y) / t.z + self.center;
            let is_on_image = t.z > 0.0 && at.cmpge(DVec2::ZERO).all() && at.cmplt(self.resolution).all();
            [is_on_image, is_on_image && t.z <= NEAR].map(usize::from)
        };
        let sum = |[a, b]: [usize; 2], [c, d]: [usize; 2]| [a + c, b + d];
        splats.means().par_iter().map(counted).reduce(|| [0, 0], sum)
    }

    /// A splat in this view; `None` if it is too near.
    #[must_use]
    pub fn shape(&self, mean: Vec3, log_scales: Vec3, rotation: Quat) -> Option<Shape> {
        let away = mean.as_dvec3() - self.eye;
        let t = self.rotation * away;
        if t.z <= NEAR {
            return None;
        }
        let ratio = DVec2::new(t.x, t.y) / t.z;
        let tangent = ratio.clamp(self.limits[0], self.limits[1]);
        let slope = self.focal / t.z;
        let j = [DVec3::new(slope.x, 0.0, -slope.x * tangent.x), DVec3::new(0.0, slope.y, -slope.y * tangent.y)];
        let scales = log_scales.as_dvec3().exp();
        let axes = DMat3::from_quat(rotation.as_dquat().normalize());
        let m = self.rotation * axes * DMat3::from_diagonal(scales);
        let w = m * m.transpose();
        let raw = [j[0].dot(w * j[0]), j[0].dot(w * j[1]), j[1].dot(w * j[1])];
        let is_limited = [tangent.x != ratio.x, tangent.y != ratio.y];
        Some(Shape { away, t, j, is_limited, tangent, scales, m, w, raw })
    }

    fn shape_of(&self, splats: &Splats, i: usize) -> Option<Shape> {
        self.shape(splats.mean(i), splats.log_scales()[i], splats.rotation(i))
    }

    /// Splat `i` on the image; `None` if no pixel shows it.
    #[must_use]
    pub fn footprint(&self, splats: &Splats, i: usize) -> Option<Footprint> {
        let shape = self.shape_of(splats, i)?;
        let opacity = 1.0 / (1.0 + (-f64::from(splats.opacity_logits()[i])).exp());
        let color = || colors::color(splats.sh(i), shape.away.normalize());
        self.drawn(&shape, i as u32, opacity, splats.mode(), color)
    }

    /// A shape on the image, with its opacity before the mode's compensation; `None` if no pixel shows it.
    pub fn drawn(
        &self,
        shape: &Shape,
        splat: u32,
        mut opacity: f64,
        mode: RenderMode,
        color: impl FnOnce() -> DVec3,
    ) -> Option<Footprint> {
        let mean = self.focal * DVec2::new(shape.t.x, shape.t.y) / shape.t.z + self.center;
        let covariance = dilated(shape.raw, mode.dilation());
        let (conic, determinant) = inverse(covariance);
        if mode.is_compensated() {
            opacity *= (inverse(shape.raw).1.max(0.0) / determinant).sqrt();
        }
        // exp(−q/2) o ≥ 1/255 is an ellipse in q.
        let reach = 2.0 * (opacity / FAINTEST).ln();
        if !(reach >= 0.0 && determinant > 0.0 && determinant.is_finite()) {
            return None;
        }
        let extent = DVec2::new((reach * covariance[0]).sqrt(), (reach * covariance[2]).sqrt());
        let is_inside = (mean + extent).cmpge(DVec2::ZERO).all() && (mean - extent).cmple(self.resolution).all();
        let (depth, thickness) = (shape.t.z, shape.w.z_axis.z);
        is_inside.then(|| Footprint { splat, mean, conic, extent, reach, opacity, depth, thickness, color: color() })
    }

    /// How a splat that is on the image changes it by moving.
    ///
    /// With v = A (m − p): ∂α/∂t = α (−J₀ᵀ v + Q(v)), Q_k(v) = vᵀ (∂J/∂t_k) W Jᵀ v, where J₀ is J without limits. In
    /// mip mode the compensation adds ½ ∂ ln(det Σ₂raw / det Σ₂): vvᵀ becomes vvᵀ + Σ₂raw⁻¹ − Σ₂⁻¹.
    #[must_use]
    pub fn slope(&self, splats: &Splats, footprint: &Footprint) -> Slope {
        let i = footprint.splat as usize;
        let shape = self.shape_of(splats, i).expect("a splat with a footprint is in front of the camera");
        let Shape { away, t, j, w, raw, .. } = shape;
        let z = t.z;
        let [fx, fy] = self.focal.to_array();
        // Columns of W Jᵀ.
        let p = [w * j[0], w * j[1]];
        // Rows of (∂J/∂t_k) W Jᵀ for k = x, y, z.
        let row = |of: &dyn Fn(DVec3) -> f64| [of(p[0]), of(p[1])];
        let zero = [0.0; 2];
        let [x, y] = [shape.bend(0, fx), shape.bend(1, fy)];
        let by_axis = [
            [row(&|p| x.own * p.z), zero],
            [zero, row(&|p| y.own * p.z)],
            [row(&|p| x.by_z[0] * p.x + x.by_z[1] * p.z), row(&|p| y.by_z[0] * p.y + y.by_z[1] * p.z)],
        ];
        let entry = |of: &dyn Fn(&[[f64; 2]; 2]) -> f64| DVec3::from(std::array::from_fn(|k| of(&by_axis[k])));
        let constant = if splats.mode().is_compensated() {
            let (inner, outer) = (inverse(raw).0, footprint.conic);
            let m: [f64; 3] = std::array::from_fn(|k| inner[k] - outer[k]);
            entry(&|b| m[0] * b[0][0] + m[1] * (b[0][1] + b[1][0]) + m[2] * b[1][1])
        } else {
            DVec3::ZERO
        };
        let of_alpha = [
            -DVec3::new(fx / z, 0.0, -fx * t.x / (z * z)),
            -DVec3::new(0.0, fy / z, -fy * t.y / (z * z)),
            entry(&|b| b[0][0]),
            entry(&|b| b[0][1] + b[1][0]),
            entry(&|b| b[1][1]),
            constant,
        ];
        let to_scene = self.rotation.transpose();
        let rows = colors::color_jacobian(splats.sh(i), footprint.color, away.normalize(), away.length());
        let wide = |v: DVec3| v.as_vec3().extend(0.0).to_array();
        Slope { of_alpha: of_alpha.map(|column| wide(to_scene * column)), of_color: rows.map(wide) }
    }
}
