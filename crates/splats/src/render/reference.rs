//! The same images, slowly: every pixel evaluates every splat, in f64, by the formulas as they are written in the
//! papers. No code is shared with the fast version.

use crate::{RenderMode, Splats};
use octobayes::geometry::Camera;

type Matrix = [[f64; 3]; 3];

/// A splat in f64, so that it can be moved by little.
#[derive(Clone)]
pub struct Gaussian {
    /// Scene units.
    pub mean: [f64; 3],
    /// Natural logarithms of scene units.
    pub log_scale: [f64; 3],
    /// w, x, y, z.
    pub quaternion: [f64; 4],
    /// 0 to 1.
    pub opacity: f64,
    /// `[coefficients]`.
    pub sh: Vec<[f64; 3]>,
}

/// What a pixel shows.
#[derive(Debug, Clone, PartialEq)]
pub struct Shown {
    /// Without background.
    pub color: [f64; 3],
    /// Σ w.
    pub opacity: f64,
    /// Σ w z / Σ w.
    pub depth: f64,
    /// Splats, front to back, each with whether its α is limited.
    pub hits: Vec<(usize, bool)>,
}

/// Splats as they are evaluated here.
#[must_use]
pub fn gaussians(splats: &Splats) -> Vec<Gaussian> {
    let of = |i: usize| {
        let rotation = splats.rotation(i);
        Gaussian {
            mean: splats.mean(i).to_array().map(f64::from),
            log_scale: splats.log_scales()[i].to_array().map(f64::from),
            quaternion: [rotation.w, rotation.x, rotation.y, rotation.z].map(f64::from),
            opacity: 1.0 / (1.0 + f64::exp(-f64::from(splats.opacity_logits()[i]))),
            sh: splats.sh(i).chunks(3).map(|c| [0, 1, 2].map(|k| f64::from(c[k]))).collect(),
        }
    };
    (0..splats.len()).map(of).collect()
}

fn multiply(a: &Matrix, b: &Matrix) -> Matrix {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..3).map(|k| a[i][k] * b[k][j]).sum()))
}

fn transposed(a: &Matrix) -> Matrix {
    std::array::from_fn(|i| std::array::from_fn(|j| a[j][i]))
}

/// Rotation matrix of a quaternion of any length.
fn rotation([w, x, y, z]: [f64; 4]) -> Matrix {
    let s = 2.0 / (w * w + x * x + y * y + z * z);
    [
        [1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
        [s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x)],
        [s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y)],
    ]
}

/// The polynomials as the original code's `computeColorFromSH` has them.
fn color(sh: &[[f64; 3]], [x, y, z]: [f64; 3]) -> [f64; 3] {
    let (xx, yy, zz, xy, yz, xz) = (x * x, y * y, z * z, x * y, y * z, x * z);
    let basis = [
        0.28209479177387814,
        -0.4886025119029199 * y,
        0.4886025119029199 * z,
        -0.4886025119029199 * x,
        1.0925484305920792 * xy,
        -1.0925484305920792 * yz,
        0.31539156525252005 * (2.0 * zz - xx - yy),
        -1.0925484305920792 * xz,
        0.5462742152960396 * (xx - yy),
        -0.5900435899266435 * y * (3.0 * xx - yy),
        2.890611442640554 * xy * z,
        -0.4570457994644658 * y * (4.0 * zz - xx - yy),
        0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -0.4570457994644658 * x * (4.0 * zz - xx - yy),
        1.445305721320277 * z * (xx - yy),
        -0.5900435899266435 * x * (xx - 3.0 * yy),
    ];
    std::array::from_fn(|k| (0.5 + sh.iter().zip(basis).map(|(c, f)| c[k] * f).sum::<f64>()).max(0.0))
}

/// What image point `p` shows of `splats` in front of `background`.
#[must_use]
pub fn shown(splats: &[Gaussian], mode: RenderMode, camera: &Camera, background: [f64; 3], p: [f64; 2]) -> Shown {
    let axes = [camera.axes.x_axis, -camera.axes.y_axis, -camera.axes.z_axis].map(|axis| axis.to_array());
    let eye = camera.position.to_array();
    let half: [f64; 2] = std::array::from_fn(|k| 0.5 * f64::from(camera.resolution[k]) / camera.focal[k]);
    let mut seen = Vec::new();
    for (i, splat) in splats.iter().enumerate() {
        let away: [f64; 3] = std::array::from_fn(|k| splat.mean[k] - eye[k]);
        let t: [f64; 3] = std::array::from_fn(|row| (0..3).map(|k| axes[row][k] * away[k]).sum());
        if t[2] <= 0.2 {
            continue;
        }
        let m: [f64; 2] = std::array::from_fn(|k| camera.focal[k] * t[k] / t[2] + camera.center[k]);
        // The principal point is the image's centre in every scene of the tests.
        let limited: [f64; 2] = std::array::from_fn(|k| (t[k] / t[2]).clamp(-1.3 * half[k], 1.3 * half[k]) * t[2]);
        let j = [
            [camera.focal[0] / t[2], 0.0, -camera.focal[0] * limited[0] / (t[2] * t[2])],
            [0.0, camera.focal[1] / t[2], -camera.focal[1] * limited[1] / (t[2] * t[2])],
            [0.0; 3],
        ];
        let r = rotation(splat.quaternion);
        let scaled: Matrix = std::array::from_fn(|i| std::array::from_fn(|k| r[i][k] * splat.log_scale[k].exp()));
        let sigma = multiply(&scaled, &transposed(&scaled));
        let to_image = multiply(&j, &axes);
        let raw = multiply(&multiply(&to_image, &sigma), &transposed(&to_image));
        let dilation = if mode == RenderMode::MipSplatting { 0.1 } else { 0.3 };
        let (a, b, c) = (raw[0][0] + dilation, raw[0][1], raw[1][1] + dilation);
        let determinant = a * c - b * b;
        let mut opacity = splat.opacity;
        if mode != RenderMode::Classic {
            opacity *= ((raw[0][0] * raw[1][1] - b * b).max(0.0) / determinant).sqrt();
        }
        let d = [m[0] - p[0], m[1] - p[1]];
        let q = (c * d[0] * d[0] - 2.0 * b * d[0] * d[1] + a * d[1] * d[1]) / determinant;
        let free = opacity * (-0.5 * q).exp();
        if free < 1.0 / 255.0 {
            continue;
        }
        let length = away.iter().map(|v| v * v).sum::<f64>().sqrt();
        seen.push((t[2], i, free, color(&splat.sh, away.map(|v| v / length))));
    }
    seen.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let (mut transmittance, mut color, mut depth, mut hits) = (1.0, [0.0; 3], 0.0, Vec::new());
    for (z, i, free, of_splat) in seen {
        let alpha = f64::min(0.99, free);
        if transmittance * (1.0 - alpha) < 1e-4 {
            break;
        }
        (0..3).for_each(|k| color[k] += transmittance * alpha * of_splat[k]);
        depth += transmittance * alpha * z;
        hits.push((i, free >= 0.99));
        transmittance *= 1.0 - alpha;
    }
    (0..3).for_each(|k| color[k] += transmittance * background[k]);
    let opacity = 1.0 - transmittance;
    Shown { color, opacity, depth: depth / opacity, hits }
}
