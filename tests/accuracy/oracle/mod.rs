//! An independent brute-force computation of H in f64. It is written for reading, from the formulas of the method,
//! and shares no code with the pipeline that it checks.
//!
//! Both must agree on the *rule*:
//!
//! - Which pixels are drawn, and with which jitter, is taken from the pipeline's sequence, as picks.
//! - Samples lie at `t = entry + (k + jitter) δ`, k = 0, 1, … while t < exit. Here [entry, exit] is the part of
//!   the ray with t ≥ 0 in the closed box. Each sample's interval is δ.
//! - The pixel's centre is at ½.
//! - R counts all rays drawn.
//! - A ray is left out of the sums if it meets an invalid density before T falls to 1e-6.
//!
//! Everything else is done in another way. No sample is left out and no ray ends early. T is the exponential of a
//! sum. Rays and positions stay f64. The field is written again in f64 ([`ground`]), and its gradients are exact
//! (or differences over ±h in f64, to check a run that uses them). The sums run over a plain dense grid.

pub mod dual;
pub mod ground;

use glam::{DMat3, DVec3};
use octobayes::geometry::Camera;
use octobayes::rays::PixelSample;
use rayon::prelude::*;

use ground::{Ground, Jet};

/// Where the field's derivatives come from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Derivatives {
    Exact,
    /// Central differences over ± this length along each axis, clipped to the box.
    Differences(DVec3),
}

/// The computation and its settings.
pub struct Oracle<'a> {
    pub ground: &'a Ground,
    pub cameras: &'a [Camera],
    /// δ, the distance between samples.
    pub interval: f64,
    pub background: DVec3,
    pub derivatives: Derivatives,
    /// M, cells per axis.
    pub cells: usize,
}

/// Σ_r JᵀJ at the (M + 1)³ lattice points, x slowest, and the number of rays left out.
pub struct Sums {
    pub information: Vec<DMat3>,
    pub dropped: u64,
}

/// A sample of one ray.
struct Sample {
    x: DVec3,
    jet: Jet,
}

impl Oracle<'_> {
    /// The ray of a pick: origin and unit direction.
    pub fn ray(&self, pick: &PixelSample) -> (DVec3, DVec3) {
        let camera = &self.cameras[pick.camera];
        let right = (f64::from(pick.pixel[0]) + 0.5 - camera.center[0]) / camera.focal[0];
        let down = (f64::from(pick.pixel[1]) + 0.5 - camera.center[1]) / camera.focal[1];
        let [x, y, z] = [camera.axes.x_axis, camera.axes.y_axis, camera.axes.z_axis];
        (camera.position, (right * x - down * y - z).normalize())
    }

    /// Distances of the samples along a ray.
    pub fn distances(&self, origin: DVec3, direction: DVec3, jitter: f64) -> Vec<f64> {
        let (mut entry, mut exit) = (0.0_f64, f64::INFINITY);
        for axis in 0..3 {
            let (low, high) = (self.ground.min[axis] - origin[axis], self.ground.max[axis] - origin[axis]);
            if direction[axis] == 0.0 {
                if low > 0.0 || high < 0.0 {
                    return Vec::new();
                }
            } else {
                let (a, b) = (low / direction[axis], high / direction[axis]);
                (entry, exit) = (entry.max(a.min(b)), exit.min(a.max(b)));
            }
        }
        (0..).map(|k| entry + (f64::from(k) + jitter) * self.interval).take_while(|&t| t < exit).collect()
    }

    /// Value and derivatives at x. The density is invalid if the value, or a value used by a difference, is
    /// invalid.
    fn jet(&self, x: DVec3) -> Jet {
        match self.derivatives {
            Derivatives::Exact => self.ground.jet(x),
            Derivatives::Differences(h) => {
                let (density, color) = self.ground.value(x);
                let (mut slope, mut columns, mut worst) = (DVec3::ZERO, [DVec3::ZERO; 3], density);
                for axis in 0..3 {
                    let (mut up, mut down) = (x, x);
                    up[axis] = (x[axis] + h[axis]).min(self.ground.max[axis]);
                    down[axis] = (x[axis] - h[axis]).max(self.ground.min[axis]);
                    let ((a, p), (b, q)) = (self.ground.value(up), self.ground.value(down));
                    slope[axis] = (a - b) / (up[axis] - down[axis]);
                    columns[axis] = (p - q) / (up[axis] - down[axis]);
                    for v in [a, b] {
                        if !(v >= 0.0 && v.is_finite()) {
                            worst = f64::NAN;
                        }
                    }
                }
                Jet { density: worst, slope, color, color_slope: DMat3::from_cols(columns[0], columns[1], columns[2]) }
            }
        }
    }

    /// ∂C/∂x of the samples of a ray (rows colour, columns axis). Ends before an invalid density that nobody can
    /// see; `None` if it can be seen.
    fn jacobians(&self, samples: &[Sample]) -> Option<Vec<DMat3>> {
        let delta = self.interval;
        // Optical depth before each sample, and after the last.
        let mut depth = vec![0.0];
        for sample in samples {
            if !sample.jet.is_valid() {
                if depth[depth.len() - 1] < -(1e-6_f64).ln() {
                    return None;
                }
                // Less than a millionth of the pixel lies behind.
                break;
            }
            depth.push(depth[depth.len() - 1] + sample.jet.density * delta);
        }
        let transmittance: Vec<f64> = depth.iter().map(|d| (-d).exp()).collect();
        // Colour of what is behind each sample, by definition.
        let seen = depth.len() - 1;
        let mut behind = vec![transmittance[seen] * self.background; seen + 1];
        for i in (0..seen).rev() {
            let weight = transmittance[i] * -(-samples[i].jet.density * delta).exp_m1();
            behind[i] = behind[i + 1] + weight * samples[i].jet.color;
        }
        let jacobian = |i: usize| {
            let jet = &samples[i].jet;
            let weight = transmittance[i] * -(-jet.density * delta).exp_m1();
            // More density at i shows more of its colour, and less of everything behind it.
            let by_density = delta * (transmittance[i + 1] * jet.color - behind[i + 1]);
            DMat3::from_cols(by_density * jet.slope.x, by_density * jet.slope.y, by_density * jet.slope.z)
                + weight * jet.color_slope
        };
        Some((0..seen).map(jacobian).collect())
    }

    /// The lattice points around x, with the values of their hat functions.
    pub fn hats(&self, x: DVec3) -> [(usize, f64); 8] {
        let n = self.cells;
        let u = (x - self.ground.min) / (self.ground.max - self.ground.min) * n as f64;
        let low = u.floor().min(DVec3::splat((n - 1) as f64)).max(DVec3::ZERO);
        std::array::from_fn(|corner| {
            let point = low + DVec3::new((corner & 1) as f64, (corner >> 1 & 1) as f64, (corner >> 2) as f64);
            let hat = (1.0 - (u - point).abs()).max(DVec3::ZERO);
            let index = point.to_array().iter().fold(0, |index, &i| index * (n + 1) + i as usize);
            (index, hat.x * hat.y * hat.z)
        })
    }

    /// J_v of one ray at every vertex that it touches. `None` if the ray is left out.
    pub fn vertex_jacobians(&self, pick: &PixelSample) -> Option<Vec<(usize, DMat3)>> {
        let (origin, direction) = self.ray(pick);
        let distances = self.distances(origin, direction, pick.jitter);
        let at = |&t: &f64| origin + t * direction;
        let samples: Vec<Sample> = distances.iter().map(at).map(|x| Sample { x, jet: self.jet(x) }).collect();
        let jacobians = self.jacobians(&samples)?;
        let mut shares: Vec<(usize, DMat3)> = Vec::new();
        for (sample, jacobian) in samples.iter().zip(jacobians) {
            if jacobian != DMat3::ZERO {
                shares.extend(self.hats(sample.x).map(|(vertex, hat)| (vertex, hat * jacobian)));
            }
        }
        shares.sort_by_key(|share| share.0);
        let mut sums: Vec<(usize, DMat3)> = Vec::new();
        for (vertex, share) in shares {
            match sums.last_mut().filter(|last| last.0 == vertex) {
                Some(last) => last.1 += share,
                None => sums.push((vertex, share)),
            }
        }
        Some(sums)
    }

    /// The sums over all rays of `picks`.
    pub fn sums(&self, picks: &[PixelSample]) -> Sums {
        let mut sums = Sums { information: vec![DMat3::ZERO; (self.cells + 1).pow(3)], dropped: 0 };
        for part in picks.chunks(256) {
            let rays: Vec<_> = part.par_iter().map(|pick| self.vertex_jacobians(pick)).collect();
            for ray in rays {
                let Some(ray) = ray else {
                    sums.dropped += 1;
                    continue;
                };
                for (vertex, j) in ray {
                    sums.information[vertex] += j.transpose() * j;
                }
            }
        }
        sums
    }

    /// The colour of a ray when the vertex `moved` is displaced by `by`. This composites the model itself,
    /// `x → x + φ_v(x) θ`.
    pub fn color_with_displaced_vertex(&self, pick: &PixelSample, moved: usize, by: DVec3) -> DVec3 {
        let (origin, direction) = self.ray(pick);
        let (mut color, mut depth) = (DVec3::ZERO, 0.0_f64);
        for t in self.distances(origin, direction, pick.jitter) {
            let x = origin + t * direction;
            let hat: f64 = self.hats(x).iter().filter(|(vertex, _)| *vertex == moved).map(|(_, hat)| hat).sum();
            let (density, c) = self.ground.value(x + hat * by);
            let next = depth + density * self.interval;
            color += ((-depth).exp() - (-next).exp()) * c;
            depth = next;
        }
        color + (-depth).exp() * self.background
    }
}

/// (2/R) S + 2λ I.
pub fn hessian(information: &DMat3, rays: u64, lambda: f64) -> DMat3 {
    *information * (2.0 / rays as f64) + DMat3::from_diagonal(DVec3::splat(2.0 * lambda))
}

/// Eigenvalues of a symmetric matrix by Jacobi rotations. Small ones are right to 1e-16 of the largest.
pub fn eigenvalues(m: &DMat3) -> [f64; 3] {
    let mut a = m.to_cols_array_2d();
    for _ in 0..20 {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            if a[p][q] == 0.0 {
                continue;
            }
            let theta = 0.5 * (a[q][q] - a[p][p]) / a[p][q];
            let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
            let c = 1.0 / (t * t + 1.0).sqrt();
            let s = t * c;
            // a ← rotationᵀ a rotation
            for row in &mut a {
                (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
            }
            let (rp, rq) = (a[p], a[q]);
            for k in 0..3 {
                (a[p][k], a[q][k]) = (c * rp[k] - s * rq[k], s * rp[k] + c * rq[k]);
            }
            (a[p][q], a[q][p]) = (0.0, 0.0);
        }
    }
    [a[0][0], a[1][1], a[2][2]]
}

/// Standard deviations read off H: `diagonal`, `trace`, `block`, by the README's table.
pub fn readings(information: &DMat3, rays: u64, lambda: f64) -> [f64; 3] {
    let h = hessian(information, rays, lambda);
    let diagonal = (0..3).map(|k| 1.0 / h.col(k)[k]).sum::<f64>();
    let trace = (0..3).map(|k| information.col(k)[k]).sum::<f64>() / rays as f64 + lambda;
    // Rounding must not put an eigenvalue below the prior's.
    let block = eigenvalues(&h).iter().map(|e| 1.0 / e.max(2.0 * lambda)).sum::<f64>();
    [diagonal.sqrt(), (1.0 / trace).sqrt(), block.sqrt()]
}
